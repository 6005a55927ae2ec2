"""Files that are no baseline."""

import json

import pytest

from stridetwin.cli.main import main
from stridetwin.gate.score_table import read_table, table_of
from stridetwin.streams.errors import StrideTwinError

GOOD = {"a": {"ape_rmse_m": 0.1}}
LONG = 10**399


def walks(**entry):
    return {"estimators": GOOD, "recordings": [{"estimators": GOOD, **entry}]}


def scored(value):
    return {"estimators": {"a": {"ape_rmse_m": value}}}


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ({"estimators": {}}, "at least one comparable score"),
        ({"estimators": {"a": {"distance_m": 3.0}}}, "estimators: invalid {'a': {'distance_m': 3.0}}"),
        ({"estimators": GOOD, "recordings": [{"estimators": {}}]}, "recordings: invalid [{'estimators': {}}]"),
        ({"estimators": GOOD, "recordings": [1, "a", None]}, "recordings[0]: invalid 1: expected a walk"),
        ({"estimators": GOOD, "recordings": [{}, "a"]}, "recordings[1]: invalid 'a'"),
        ({"estimators": GOOD, "recordings": {}}, "recordings: invalid {}: expected a list"),
        ({"recordings": []}, "estimators: invalid None: expected estimators, each with its scores"),
        (walks(estimators=5), "recordings[0].estimators: invalid 5"),
        (walks(sha256=[1]), "recordings[0].sha256: invalid [1]: expected text"),
        (walks(sha256="\ud800"), r"recordings[0].sha256: invalid '\ud800'"),
        (walks(failed=["a"]), "recordings[0].failed: invalid ['a']"),
        (walks(failed={"foot_ins_l": 5}), "recordings[0].failed.foot_ins_l: invalid 5: expected text"),
        (scored("x"), "estimators.a.ape_rmse_m: invalid 'x': expected a number"),
        (scored(None), "estimators.a.ape_rmse_m: invalid None"),
        (scored(True), "estimators.a.ape_rmse_m: invalid True"),
        (scored(float("nan")), "estimators.a.ape_rmse_m: invalid nan"),
        (scored(float("inf")), "estimators.a.ape_rmse_m: invalid inf"),
        (scored(-1e308), "estimators.a.ape_rmse_m: invalid -1e+308: expected a number, 0 or of 1e-100 to 1e+100"),
        (scored(1e-320), "estimators.a.ape_rmse_m: invalid 1e-320"),
        (scored(LONG), f"estimators.a.ape_rmse_m: invalid {LONG}"),
        ({"estimators": {"a": 3}}, "estimators.a: invalid 3: expected scores by name"),
        ({"estimators": {"x\ud800": {}}}, r"estimators: invalid 'x\ud800': expected names in UTF-8"),
        ({"estimators": {"a": {"\ud800": 1}}}, r"estimators.a: invalid '\ud800': expected names in UTF-8"),
        ({"estimators": {"n" * 401: {}}}, "n...: expected names in UTF-8, of up to 400"),
        ([1], "invalid [1]: expected what `stridetwin score --json` prints"),
        ("[" * 100_000, "is not JSON: maximum recursion depth"),
        ("[" * 900 + "]" * 900, "base.json: "),
        ("x", "is not JSON: Expecting value"),
    ],
)
def test_a_file_that_is_no_baseline_is_one_error_with_the_field(tmp_path, capsys, document, said):
    file = tmp_path / "base.json"
    file.write_text(document if isinstance(document, str) else json.dumps(document))
    assert main(["score", "no-such.mcap", "--baseline", str(file)]) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"stridetwin: error: {file}: ")
    assert said in message
    assert len(message) < len(str(file)) + 650


def test_current_scores_may_be_empty_and_those_of_run_have_no_walks(tmp_path):
    assert table_of({"estimators": {}, "recordings": [{"estimators": {}, "failed": {"a": "no"}}]}, "now").walks
    file = tmp_path / "scores.json"
    file.write_text(json.dumps({"estimators": GOOD, "recordings": [{"scenario": "level", "seed": 1}]}))
    assert read_table(file).walks == {}
    file.write_text(json.dumps(walks(sha256=None)))
    assert list(read_table(file).walks) == ["recording 0"]
    file.write_bytes(b"\xff\xfe")
    with pytest.raises(StrideTwinError, match=r"scores\.json: is not JSON"):
        read_table(file)
