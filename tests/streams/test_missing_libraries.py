"""An optional library that is not installed is reported with the extra that brings it."""

import importlib

import pytest

from stridetwin.streams.errors import StrideTwinError, explain_import_error


def test_what_is_missing_and_how_to_get_it():
    with (
        pytest.raises(StrideTwinError, match=r"^no_such_library is not installed; a mesh needs it: pip install "),
        explain_import_error("a mesh needs it", "twin"),
    ):
        importlib.import_module("no_such_library")


def test_a_missing_module_of_the_project_is_no_missing_library():
    with pytest.raises(ModuleNotFoundError), explain_import_error("a mesh needs it", "twin"):
        importlib.import_module("stridetwin.no_such_module")


@pytest.mark.parametrize(
    ("library", "extra"), [("mujoco", "twin"), ("dm_control.rl", "closed-loop"), ("joblib", "closed-loop")]
)
def test_an_experiment_names_the_extra_that_brings_its_library(monkeypatch, library, extra):
    from stridetwin.cli import studies
    from stridetwin.studies import experiment

    def missing(name):
        raise ModuleNotFoundError(f"No module named {library!r}", name=library)

    monkeypatch.setattr(experiment, "experiment", missing)
    options = studies.ExperimentOptions(experiment="assistance")
    with pytest.raises(StrideTwinError, match=rf"pip install '\.\[{extra}\]'"):
        studies.experiment_command(options, lambda *_: None)
