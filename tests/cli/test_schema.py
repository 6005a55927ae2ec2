"""The JSON Schemas that come with the project are those of the code, and its files name and satisfy them."""

import json
import re
from pathlib import Path

import pytest

from stridetwin.cli.commands import SCHEMAS
from stridetwin.cli.main import main
from stridetwin.scenarios.campaign.campaign_file import campaigns
from stridetwin.scenarios.scenario_file import catalogue, load_scenario
from stridetwin.sim.choices import FAULT_NAMES, part_files
from stridetwin.sim.faults.catalogue import FAULTS
from stridetwin.sim.parts.library import kind_of, load_part
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.yaml_file import read_entries
from stridetwin.studies.placement.problem_file import problems

ROOT = Path(__file__).parents[2]
OWN_EXO = {"own_exo": ROOT / "examples" / "own_exo" / "my_exo.yaml"}
FILES = {
    "scenario": catalogue(),
    "campaign": campaigns(),
    "placement": problems(),
    "part": part_files(),
    "own_exo": OWN_EXO,
}
LINE = re.compile(r"# yaml-language-server: \$schema=(\S+)")


def shipped(kind):
    return ROOT / "scenarios" / "schema" / f"{kind}.json"


@pytest.mark.parametrize("kind", SCHEMAS)
def test_the_shipped_schema_is_that_of_the_code(kind, capsys):
    """Written by `stridetwin schema KIND > scenarios/schema/KIND.json`."""
    assert main(["schema", kind]) == 0
    assert shipped(kind).read_text(encoding="utf-8") == capsys.readouterr().out


@pytest.mark.parametrize(("kind", "path"), [(kind, p) for kind, files in FILES.items() for p in files.values()])
def test_every_file_of_the_project_names_its_schema_in_the_first_line(kind, path):
    found = LINE.fullmatch(path.read_text(encoding="utf-8").splitlines()[0])
    assert found
    assert (path.parent / Path(found[1])).resolve() == shipped(kind).resolve()


def test_the_command_prints_a_schema(capsys):
    assert main(["schema", "scenario"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert set(schema["required"]) == {"description"}  # a recorded motion finds its terrain
    assert schema["properties"]["width_m"] == {
        "default": 2.4,
        "description": "Width of the route, or of each lane.",
        "maximum": 10,
        "minimum": 1.2,
        "type": "number",
    }
    segments = schema["properties"]["terrain"]["anyOf"][0]["oneOf"][0]["items"]["oneOf"]
    stairs = next(s["properties"]["stairs"]["oneOf"][0] for s in segments if s["required"] == ["stairs"])
    assert stairs["required"] == ["risers", "direction"]
    assert stairs["properties"]["direction"]["enum"] == ["up", "down"]


def test_every_property_of_a_scenario_is_described():
    schema = json.loads(shipped("scenario").read_text(encoding="utf-8"))
    for name, made in {**schema["$defs"], "": schema}.items():
        for key, entry in made.get("properties", {}).items():
            assert key == "kind" or "description" in entry or name == "Sensors", (name, key)


def test_what_list_reads_is_what_the_code_has():
    """`list` reads names and first lines alone, without building the parts, faults and scenarios behind them."""
    assert set(FAULT_NAMES) == set(FAULTS)
    for name, path in part_files().items():
        part = load_part(name)
        assert read_entries(path, "kind", "description") == {"kind": kind_of(part), "description": part.description}
    for name, path in catalogue().items():
        assert read_entries(path, "description")["description"] == load_scenario(name).description


def test_an_entry_that_a_file_lacks_at_its_top_level_is_named(tmp_path):
    path = tmp_path / "part.yaml"
    path.write_text("inner: {kind: imu}\nlist: [kind, imu]\nkind: {imu: 1}\ndescription: >\n  two\n  lines\n")
    assert read_entries(path, "description") == {"description": "two lines\n"}
    with pytest.raises(ConfigError, match="expected the keys kind"):
        read_entries(path, "kind")
