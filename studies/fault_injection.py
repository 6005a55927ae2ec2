"""Fault studies: a recorded walk is replayed once per fault, and a table has one line per fault.

A study's faults are in a YAML file beside its module: name to `label` and `faults`, as in a scenario file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from stridetwin.scenarios.scenario_model import FaultList
from stridetwin.sim.faults.faults import Fault, FaultPlan, check_faults
from stridetwin.streams.fields import ReadAs, text
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Sample
from stridetwin.streams.validation import validated
from stridetwin.streams.yaml_file import read_yaml
from stridetwin.studies.tables import Column, table_lines

Samples = Iterator[Sample]


@dataclass(frozen=True, kw_only=True)
class FaultCase:
    """One line of a study's table: its label, and the faults that are injected together."""

    label: Annotated[str, text()]
    faults: Annotated[tuple[Fault, ...], ReadAs(FaultList)] = ()

    def plan(self, rig: Rig, seed: int, duration_s: float) -> FaultPlan:
        """The faults in a walk.

        Raises:
            ConfigError: A fault matches no sensor of the rig.
        """
        check_faults(self.label, self.faults, rig)
        return FaultPlan.of(self.faults, rig, seed, duration_s)


def read_cases(module: str) -> dict[str, FaultCase]:
    """The fault cases of a study, by name, from the YAML file beside its module (`__file__`)."""
    path = Path(module).with_suffix(".yaml")
    return validated(dict[str, FaultCase], read_yaml(path), path)


def by_fault(
    faults: Iterable[str], results: Sequence[Mapping[str, Any]], figures: Callable[[list[Any]], dict[str, Any]]
) -> dict[str, Any]:
    """`summary` and `paper` of a study: the figures of each fault over the rows of all cases; no paper has faults."""
    return {"summary": {name: figures([r["faults"][name] for r in results]) for name in faults}, "paper": {}}


def fault_table(
    faults: Mapping[str, FaultCase], summary: Mapping[str, Mapping[str, Any]], columns: Sequence[Column], width: int
) -> list[str]:
    """Lines of text from the cases and the summary of `by_fault`: one line per case."""
    return table_lines(columns, [(case.label, summary[name]) for name, case in faults.items()], width)
