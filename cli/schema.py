"""`schema`: the JSON Schemas of configuration files, for editors."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Annotated

import typer

from stridetwin.cli.options import Options, Outcome, Progress, one_of

SCHEMAS = {
    "scenario": "stridetwin.scenarios.scenario_model:ScenarioFile",
    "campaign": "stridetwin.scenarios.campaign.campaign_file:CampaignFile",
    "placement": "stridetwin.studies.placement.problem_file:PlacementFile",
    "study": "stridetwin.studies.study_file.study:StudyFile",
    "part": "stridetwin.sim.parts.library:PartFile",
    "own_exo": "stridetwin.sim.wearer.own_exo_rig:OwnExoFile",
    "exo_geometry": "stridetwin.estimators.contact_terrain.geometry:ExoskeletonFile",
}
"""Kinds of files that users write, and the type of each; imported when it is asked for."""


@dataclass(frozen=True, kw_only=True)
class SchemaOptions(Options):
    """Print the JSON Schema of a kind of file, for editors."""

    kind: Annotated[str, typer.Argument(metavar="KIND", help=f"{', '.join(SCHEMAS)}.", **one_of(tuple(SCHEMAS)))]


def schema_command(arguments: SchemaOptions, progress: Progress) -> Outcome:
    """`schema`."""
    from stridetwin.streams.json_schema import schema_file

    found = schema_file(resolve_name(SCHEMAS[arguments.kind]))
    return Outcome(data=found, lines=json.dumps(found, indent=1, ensure_ascii=False).splitlines())
