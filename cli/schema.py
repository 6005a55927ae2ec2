"""`schema`: the JSON Schemas of configuration files, for editors."""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import typer

from stridetwin.cli.options import Options, Outcome, Progress, one_of

SCHEMAS = ("scenario", "campaign", "placement", "part")


@dataclass(frozen=True, kw_only=True)
class SchemaOptions(Options):
    """Print the JSON Schema of a kind of file, for editors."""

    kind: Annotated[str, typer.Argument(metavar="KIND", help=f"{', '.join(SCHEMAS)}.", **one_of(SCHEMAS))]


def schema_command(arguments: SchemaOptions, progress: Progress) -> Outcome:
    """`schema`."""
    found = file_schema(arguments.kind)
    return Outcome(data=found, lines=as_text(found).splitlines())


def file_schema(kind: str) -> dict[str, Any]:
    """The JSON Schema of a kind of file, one of `SCHEMAS`."""
    from stridetwin.streams.json_schema import schema_of

    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | schema_of(_type(kind))


def as_text(schema: dict[str, Any]) -> str:
    """A schema as text of its file."""
    return json.dumps(schema, indent=1, ensure_ascii=False)


def shipped(kind: str) -> Path:
    """The built-in file of a schema."""
    return Path(str(resources.files("stridetwin.scenarios"))) / "schema" / f"{kind}.json"


def _type(kind: str) -> Any:
    if kind == "part":
        from stridetwin.sim.parts.library import PartFile

        return PartFile
    if kind == "campaign":
        from stridetwin.scenarios.campaign.campaign_file import CampaignFile

        return CampaignFile
    if kind == "placement":
        from stridetwin.studies.placement.problem_file import PlacementFile

        return PlacementFile
    from stridetwin.scenarios.scenario_model import ScenarioFile

    return ScenarioFile
