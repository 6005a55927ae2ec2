"""The example of a workflow is one, and its commands are ours."""

import shlex
from pathlib import Path

import yaml

from stridetwin.cli.main import parse

FILE = Path(__file__).parents[2] / "docs" / "examples" / "gate.yml"


def test_the_workflow_caches_its_baseline_and_asks_what_the_command_line_knows():
    workflow = yaml.safe_load(FILE.read_text())
    (job,) = workflow["jobs"].values()
    assert "pull_request" in workflow[True]  # YAML 1.1 takes `on` for a truth value
    assert [s["uses"] for s in job["steps"] if "cache" in s.get("uses", "")] == [
        "actions/cache/restore@v4",
        "actions/cache/save@v4",
    ]
    scripts = "\n".join(step.get("run", "") for step in job["steps"])
    commands = [line.strip() for line in scripts.replace("\\\n", " ").splitlines() if "stridetwin " in line]
    commands = [c for c in commands if c.startswith("stridetwin ")]
    kinds = []
    for command in commands:
        words = [w.replace("${{", "").replace("}}", "") for w in shlex.split(command.split(" > ")[0])[1:]]
        words = [w for w in words if w not in ("", "github.event.pull_request.head.sha")]
        if words[-1] == "--label":
            words.append("commit")
        call = parse(words)
        kinds.append((call.command, bool(getattr(call.options, "baseline", None))))
    assert kinds == [("generate", False), ("score", False), ("score", True)]


def test_the_baseline_is_made_where_the_code_of_the_pull_request_does_not_lie():
    (job,) = yaml.safe_load(FILE.read_text())["jobs"].values()
    (script,) = [step["run"] for step in job["steps"] if "> " in step.get("run", "") and "score" in step["run"]]
    lines = script.splitlines()
    place = lines.index("cd ../base")
    (score,) = [i for i, line in enumerate(lines) if line.startswith("stridetwin score")]
    assert place < score
    assert '"$GITHUB_WORKSPACE/gate/walks"' in lines[score]
    assert lines[score].endswith('> "$GITHUB_WORKSPACE/gate/baseline.json"')


def test_nothing_is_installed_from_an_index_that_does_not_have_it():
    assert 'pip install "stridetwin[twin] @ git+https://' in FILE.read_text()
    assert "pip install 'stridetwin" not in (FILE.parents[1] / "campaigns.md").read_text()
