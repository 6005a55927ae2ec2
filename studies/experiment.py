"""The experiments of the catalogue: study files in `experiments/` whose figures and tables a Python module computes.

`stridetwin experiment NAME` runs them. A file says which walks are simulated, as every study file does (`design`); its
hooks name the module that turns one case into a row, and the one that makes the table of a paper from all rows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, cast

from pydantic import BeforeValidator, ConfigDict, Field

from stridetwin.batch.jobs import Row
from stridetwin.scenarios.built_in import experiments
from stridetwin.sim.config import TwinConfig
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.fields import FileModel
from stridetwin.streams.validation import validate
from stridetwin.streams.yaml_file import read_yaml
from stridetwin.studies.case import ExperimentCase, Setup
from stridetwin.studies.design import DesignFile, read_design
from stridetwin.studies.result import AnyResult, Collected
from stridetwin.studies.size import SAMPLED, Size, size_of
from stridetwin.studies.tables import Column, rows_table

_OF_TABLES = ("study", "tables", "report", "columns", "title", "kind", "estimates")
"""Keys of a file that do not change the rows: the other ones are `Experiment.content`."""


class Hook(FileModel):
    """A module of the studies; the other keys are arguments of its function.

    Attributes:
        module: Its name below `stridetwin.studies`.
    """

    model_config = ConfigDict(extra="allow", frozen=True)
    module: str

    def load(self) -> ModuleType:
        """Imports the module."""
        return import_module(f"stridetwin.studies.{self.module}")

    @property
    def arguments(self) -> dict[str, object]:
        """The other keys, which are arguments of the module's function."""
        return dict(self.model_extra or {})


# a text alone is the name of the module
HookInFile = Annotated[Hook, BeforeValidator(lambda node: {"module": node} if isinstance(node, str) else node)]


class ExperimentFile(DesignFile):
    """An experiment of the catalogue.

    Attributes:
        run: Module with `run_case`, from a case to its row.
        tables: Module with `collect`, from all rows to `summary` and `paper`, and with `table` or `rows` (lines, or
            labelled figures for `columns`) and `report` (an HTML page) if it has them; that of `run` by default.
        report: Module with `report`, if it is another one.
        columns: Of the table: header, width and format (`tables.Column`).
        title: Lines above the columns; `{count}` is the number of cases.
        sensors: Groups of sensors that are simulated; by default those of the scenarios.
        faults: Each is injected into the same walk, instead of being a factor.
        like: Name of another experiment, whose keys this one takes over.
        kind: Kind of the installed estimators that can be run besides those of the experiment; "" if none can.
        estimates: Number of estimates of each walk (and fault), for the time that is announced before the start.
    """

    run: HookInFile
    tables: HookInFile | None = None
    report: HookInFile | None = None
    columns: tuple[Column, ...] = ()
    title: str = ""
    sensors: tuple[str, ...] = Field(default=())
    kind: str = ""
    estimates: Annotated[int, Field(ge=1)] = 1


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """An experiment with its modules.

    Attributes:
        name: In the catalogue.
        description: What is compared, in one line.
        seeds: One seed per case.
        setup: What the cases walk; None if `run_case` makes its own walks.
        module: Name of the module of `run_case`.
        content: What determines a row beside the code.
        kind: See `ExperimentFile`.
        estimates: Number of estimates of each walk, with all faults.
        adjustable: Our estimators whose parameters `--set` changes in it: `ESTIMATORS` of the module of `run_case`.
        list_configs: From a case to the walks that `run_case` makes itself; None for those of `setup`, if there is any.
        run_case: From a case to a result that JSON can hold; runs in a process of its own.
        collect: From the results to `summary` and `paper`.
        table: From the result to lines of text.
        report: From the result to an HTML page with figures; None if there is none.
    """

    name: str
    description: str = ""
    seeds: tuple[int, ...]
    setup: Setup | None = None
    module: str = ""
    content: str = ""
    kind: str = ""
    estimates: int = 1
    adjustable: tuple[str, ...] = ()
    list_configs: Callable[[ExperimentCase], list[TwinConfig]] | None = None
    run_case: Callable[[ExperimentCase], Row]
    collect: Callable[[list[Row]], Collected[Mapping[str, object], Mapping[str, object]]]
    table: Callable[[AnyResult], list[str]]
    report: Callable[[AnyResult], str] | None = None

    def size(self, cases: Sequence[ExperimentCase]) -> Size:
        """What some cases, at least one, take: walks, estimates and time, estimated from a sample of them."""
        sampled_configs = []
        for case in cases[:: -(-len(cases) // SAMPLED)]:  # every n-th case, rounded up: at most `SAMPLED`
            if self.list_configs is not None:
                sampled_configs.append(self.list_configs(case))
            else:
                # without a setup no body walks
                sampled_configs.append([walk.config for walk in case.walks()] if case.setup is not None else [])
        return size_of(sampled_configs, len(cases), self.estimates + len(cases[0].estimators))

    def result(self, rows: list[Row]) -> AnyResult:
        """The result of an experiment as JSON holds it: `experiment`, `description`, `summary`, `paper` and `cases`."""
        figures = self.collect(rows)
        return {
            "experiment": self.name,
            "description": self.description,
            "summary": figures["summary"],
            "paper": figures["paper"],
            "cases": rows,
        }


_LOADED: dict[str, Experiment] = {}  # experiments that have been read, by name


def experiment(name: str) -> Experiment:
    """The experiment of a name in the catalogue, with its modules imported.

    Raises:
        StrideTwinError: The name is not one of `experiments`; the message lists the valid ones.
    """
    if name not in _LOADED:
        if name not in experiments():
            raise StrideTwinError(f"invalid experiment {name!r}: expected {', '.join(experiments())}")
        _LOADED[name] = read_experiment(experiments()[name])
    return _LOADED[name]


def read_experiment(path: Path) -> Experiment:
    """Reads an experiment's file and imports its modules.

    Raises:
        ConfigError: The message names the file, the field, the value and what is valid.
    """
    data = _read(path)
    file = validate(ExperimentFile, data, path)
    # without scenarios `run_case` makes its own walks
    has_walks = bool(file.scenarios or file.vary)
    design = read_design(file, data, path, cross_faults=False) if has_walks else None
    # `hook` names the module of `run_case`; `tables` that of `collect`, which is the same unless the file names another
    hook, tables = file.run, file.tables or file.run
    run_module, tables_module = hook.load(), tables.load()
    # what a module may lack: rows for `columns`, and the list of the walks that it makes itself
    rows = getattr(tables_module, "rows", None)
    list_configs = getattr(run_module, "list_configs", None)
    return Experiment(
        name=path.stem,
        description=file.study,
        seeds=file.seeds,
        setup=None if design is None else Setup(design=design, sensors=file.sensors, faults=file.faults),
        module=run_module.__name__,
        content=repr({key: value for key, value in data.items() if key not in _OF_TABLES}),
        kind=file.kind,
        estimates=file.estimates * max(1, len(file.faults)),  # a walk is estimated anew with each fault
        adjustable=getattr(run_module, "ESTIMATORS", ()),
        list_configs=None if list_configs is None else partial(list_configs, **hook.arguments),
        run_case=partial(run_module.run_case, **hook.arguments),
        collect=partial(tables_module.collect, **tables.arguments),
        table=partial(rows_table, file.title, file.columns, rows) if file.columns else tables_module.table,
        report=getattr(file.report.load() if file.report else tables_module, "report", None),
    )


def _read(path: Path) -> dict[str, Any]:
    """Plain data of an experiment's file; the key `like: NAME` adds the keys of another experiment."""
    data = cast("dict[str, Any]", read_yaml(path))  # the files are our own
    parent = data.pop("like", None)
    if parent is None:
        return data
    inherited = _read(experiments()[parent])
    # in these blocks single values are taken over; any other key replaces the inherited one
    merged = {key: inherited[key] | data[key] for key in ("set", "vary") if key in inherited and key in data}
    return inherited | data | merged
