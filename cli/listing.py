"""`list` and `schema`: the available choices, and the JSON Schemas of configuration files, for editors."""

from __future__ import annotations

import json
from dataclasses import asdict
from pkgutil import resolve_name
from typing import Any

from rich.table import Table

from stridetwin.cli.commands import SCHEMAS, ListOptions, SchemaOptions
from stridetwin.cli.console import table
from stridetwin.cli.options import Outcome, Progress
from stridetwin.estimators.registry import descriptions, output_descriptions
from stridetwin.scenarios.built_in import campaigns, catalogue, experiments, problems
from stridetwin.sim.choices import DEFAULT_SENSORS, FAULT_NAMES, KIND, PHYSICS, part_files
from stridetwin.sim.people import PEOPLE
from stridetwin.streams.json_schema import schema_file
from stridetwin.streams.yaml_file import read_entries


def list_command(arguments: ListOptions, progress: Progress) -> Outcome:
    """Runs `list`: names and descriptions of everything that a command accepts by name.

    Of the project's files only the descriptions are read, as the whole files would take long. The two arguments, which
    every command gets, are not used.
    """
    parts = {name: read_entries(path, "kind", "description") for name, path in part_files().items()}
    data: dict[str, Any] = {
        "scenarios": {name: read_entries(path, "description")["description"] for name, path in catalogue().items()},
        "campaigns": {name: read_entries(path, "campaign")["campaign"] for name, path in campaigns().items()},
        "placements": {name: read_entries(path, "placement")["placement"] for name, path in problems().items()},
        "sensors": list(KIND),
        "outputs": output_descriptions(),
        "estimators": descriptions(),
        "experiments": {name: read_entries(path, "study")["study"] for name, path in experiments().items()},
        "parts": parts,
        "faults": sorted(FAULT_NAMES),
        "physics": list(PHYSICS),
        "people": {name: asdict(person) for name, person in PEOPLE.items()},
    }
    lines: list[str | Table] = []
    files = {"scenarios": catalogue(), "campaigns": campaigns(), "placements": problems(), "parts": part_files()}
    data["folders"] = {title: str(next(iter(paths.values())).parent) for title, paths in files.items()}
    for title in ("scenarios", "campaigns", "placements", "outputs", "estimators", "experiments"):
        where = f" (files in {data['folders'][title]})" if title in data["folders"] else ""
        lines += [table(data[title].items(), title=f"{title.capitalize()}{where}", text_columns=2), ""]
    part_rows = [(name, part["kind"], part["description"]) for name, part in parts.items()]
    people = [(name, p.sex, f"{p.height_m:.3g} m", f"{p.mass_kg:.3g} kg") for name, p in PEOPLE.items()]
    sensors = [name if name in DEFAULT_SENSORS else f"{name} (off by default)" for name in KIND]
    lines += ["Sensors", ", ".join(sensors), ""]
    lines += [f"Parts (NAME-ideal: the part without errors; files in {data['folders']['parts']})"]
    lines += [table(part_rows, text_columns=3), ""]
    lines += ["Faults", ", ".join(sorted(FAULT_NAMES)), "", table(people, title="People", text_columns=2)]
    return Outcome(data=data, lines=lines)


def schema_command(arguments: SchemaOptions, progress: Progress) -> Outcome:
    """Runs `schema`: the JSON Schema of a kind of file, as `arguments.kind` names it; `progress` is not used."""
    schema = schema_file(resolve_name(SCHEMAS[arguments.kind]))
    return Outcome(data=schema, lines=json.dumps(schema, indent=1, ensure_ascii=False).splitlines())
