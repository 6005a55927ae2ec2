"""`list`: lists the available choices."""

from __future__ import annotations

import textwrap
from dataclasses import asdict, dataclass

from stridetwin.cli.options import Options
from stridetwin.cli.outcome import Outcome, Progress


@dataclass(frozen=True, kw_only=True)
class ListOptions(Options):
    """List scenarios, sensors, parts, estimators and experiments."""


def list_command(arguments: ListOptions, progress: Progress) -> Outcome:
    """`list`."""
    from stridetwin.estimators.registry import descriptions
    from stridetwin.scenarios.campaign.campaign_file import campaigns, read_campaign
    from stridetwin.scenarios.scenario_file import PHYSICS, SENSORS, catalogue, read_scenario
    from stridetwin.scenarios.scenario_model import FAULTS
    from stridetwin.sim.parts.library import kind_of, library, part
    from stridetwin.sim.wearer.anthropometry import PEOPLE
    from stridetwin.studies.catalogue import STUDIES
    from stridetwin.studies.placement.problem_file import problems, read_problem

    parts = {name: part(name) for name in library()}
    scenarios = {name: read_scenario(path).description for name, path in catalogue().items()}
    placements = {name: read_problem(path).description for name, path in problems().items()}
    many = {name: read_campaign(path).description for name, path in campaigns().items()}
    known = descriptions()
    data = {
        "scenarios": scenarios,
        "campaigns": many,
        "placements": placements,
        "sensors": list(SENSORS),
        "estimators": known,
        "experiments": {name: study.description for name, study in STUDIES.items()},
        "parts": {name: {"kind": kind_of(p), "description": p.description} for name, p in parts.items()},
        "faults": sorted(FAULTS),
        "physics": list(PHYSICS),
        "people": {name: asdict(person) for name, person in PEOPLE.items()},
    }
    lines = ["Scenarios", *(f"  {n:<16} {words}" for n, words in scenarios.items()), ""]
    lines += ["Campaigns", *(f"  {n:<16} {words}" for n, words in many.items()), ""]
    lines += ["Placements", *(f"  {n:<16} {words}" for n, words in placements.items()), "", "Estimators"]
    lines += [
        *(f"  {n:<16} {words}" for n, words in known.items()),
        "",
        "Experiments",
        *(f"  {n:<16} {study.description}" for n, study in STUDIES.items()),
        "",
        "Sensors",
        f"  {', '.join(SENSORS)}",
        "",
        "Parts (each has an ideal twin: its name with -ideal)",
        *(f"  {n:<16} {kind_of(p):<11} {p.description}" for n, p in parts.items()),
        "",
        "Faults",
        *textwrap.wrap(", ".join(sorted(FAULTS)), 110, initial_indent="  ", subsequent_indent="  "),
        "",
        "People",
        *(f"  {n:<16} {p.sex}, {p.height_m:.3g} m, {p.mass_kg:.3g} kg" for n, p in PEOPLE.items()),
    ]
    return Outcome(data=data, lines=lines)
