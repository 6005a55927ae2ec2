"""Every experiment by name; separate from the runs, so that listing them does not import the simulator.

An experiment's module declares `SEEDS`, `run_case`, `collect` and `table`. A module of several experiments declares
`VARIANTS` instead of `SEEDS`: name to seeds and first argument of `run_case`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from types import ModuleType
from typing import Any

from stridetwin.estimators.base import MODES, PATH, STEPS
from stridetwin.streams.errors import StrideTwinError
from stridetwin.studies.case import Case


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One experiment of a paper.

    Attributes:
        seeds: One seed per case.
        run_case: From a case to a result that JSON can hold; runs in a process of its own.
        collect: From the results to `summary` and `paper`.
        table: From the result to lines of text.
        report: From the result to an HTML page with figures; None if there is none.
    """

    seeds: range
    run_case: Callable[[Case], dict[str, Any]]
    collect: Callable[[list[dict[str, Any]]], dict[str, Any]]
    table: Callable[[dict[str, Any]], list[str]]
    report: Callable[[dict[str, Any]], str] | None = None

    @property
    def source(self) -> tuple[str, str]:
        """The module of `run_case`, and its bound arguments."""
        run: Any = self.run_case
        if isinstance(run, partial):
            return str(run.func.__module__), repr((run.args, run.keywords))
        return str(run.__module__), ""


@dataclass(frozen=True)
class Study:
    """Declaration of an experiment.

    Attributes:
        description: One line for lists.
        module: Module that declares seeds and `run_case`.
        tables: Module with `collect` and `table`, and `report` if there is a page; "" if it is the same. Separate from
            `module` if several modules share it, so that a change of the tables does not invalidate the rows.
        report: Module with `report`, if it is another one.
        collect_by_name: `collect` takes the experiment's name first.
        kind: Kind of the installed estimators that can be run besides those of the study; "" if none can.
    """

    description: str
    module: str
    tables: str = ""
    report: str = ""
    collect_by_name: bool = False
    kind: str = ""

    def load(self, name: str) -> Experiment:
        """Imports the experiment's modules."""
        study, tables = _module(self.module), _module(self.tables or self.module)
        variants = getattr(study, "VARIANTS", None)
        if variants is None:
            seeds, run_case = study.SEEDS, study.run_case
        else:
            seeds, argument = variants[name]
            run_case = partial(study.run_case, argument)
        return Experiment(
            seeds=seeds,
            run_case=run_case,
            collect=partial(tables.collect, name) if self.collect_by_name else tables.collect,
            table=tables.table,
            report=getattr(_module(self.report) if self.report else tables, "report", None),
        )


def _module(name: str) -> ModuleType:
    return import_module(f"stridetwin.studies.{name}")


def _modes(description: str) -> Study:
    """A study of mode prediction on walks of Zhao et al. 2023."""
    return Study(
        description, "zhao2023.zhao_walks", tables="zhao2023.mode_results", collect_by_name=True, kind=MODES
    )  # fmt: skip


def _jao(description: str) -> Study:
    return Study(description, "jao2020.jao_walk", collect_by_name=True)


STUDIES = {
    "jao_simulation": Study("Jao et al. 2020, Table I: a hundred identical strides north", "jao2020.jao_simulation"),
    "jao_straight_53m": _jao("Jao et al. 2020, Table II: 53 m straight on the simulated walker, shoe cameras rendered"),
    "jao_loop_126m": _jao("Jao et al. 2020, Table III: 126 m loop on the simulated walker, shoe cameras rendered"),
    "stairs_16": _jao("sixteen risers up and down on the simulated walker, shoe cameras rendered"),
    "jao_faults": Study(
        "foot-to-foot filter under injected faults: cameras, IMUs, clock, mounts, exchanged shoes", "jao2020.jao_faults"
    ),
    "zhao_closed_loop": Study(
        "Zhao et al. 2023, Table V: a loop of 60 m with stairs, fifteen subjects, on head and chest",
        "zhao2023.zhao_closed_loop",
        kind=PATH,
    ),
    "zhao_closed_loop_stress": Study(
        "the same loop with plain walls, blur, heel strikes, and errors of clock and mount",
        "zhao2023.zhao_closed_loop",
        kind=PATH,
    ),
    "zhao_generality": _modes(
        "Zhao et al. 2023, Tables II and III: modes of coming steps over 540 walks, poses by odometry"
    ),
    "zhao_generality_given_poses": _modes("the same walks with their true poses"),
    "zhao_generality_shallow": _modes("the same walks with the camera 8 degrees down instead of 25"),
    "zhao_baselines": _modes("sixty of the same walks, with our prediction from single depth images, without a map"),
    "zhao_view": _modes(
        "Zhao et al. 2023, Fig. 3a: between walls and round a corner, with a head that looks about widely"
    ),
    "zhao_directions": _modes("Zhao et al. 2023, Fig. 3b: outdoors from stair to ramp to stair side by side"),
    "zhao_disturbance": _modes("Zhao et al. 2023, Fig. 3c: a stair while two people walk around the walker"),
    "mode_fusion": Study(
        "modes of coming steps by camera, by an exoskeleton's legs, and by both, in light and dark",
        "zhao2023.mode_fusion",
    ),
    "mode_not_fooled": Study(
        "false positives of stairs and ramps: paint, shadow, kerb, table, wall, legs, mirror",
        "zhao2023.mode_not_fooled",
    ),
    "mode_faults": Study(
        "mode prediction under injected faults: odometry lost, no depth, a dead insole, a bad view",
        "zhao2023.mode_faults",
    ),
    "terrain_zoo": Study(
        "modes over 34 kinds of ground, gait, camera and light, a quarter of which were never tuned on",
        "terrain_zoo.zoo_walk",
        tables="terrain_zoo.zoo_results",
        kind=MODES,
    ),
    "terrain_zoo_tuning": Study(
        "the kinds of terrain_zoo on which parameters may be tuned, other seeds",
        "terrain_zoo.zoo_walk",
        tables="terrain_zoo.zoo_results",
        kind=MODES,
    ),
    "terrain_zoo_level": Study(
        "straight level walks of 15 m: height and tilt of the odometry",
        "terrain_zoo.zoo_walk",
        tables="terrain_zoo.zoo_results",
        kind=MODES,
    ),
    "assistance": Study(
        "assistance by mode in closed loop: work saved with modes from legs, camera or truth", "assistance"
    ),
    "assistance_wrong": Study("falls in a hundred assisted walks in which 1 % of the modes are wrong", "assistance"),
    "dvio_bench": Study(
        "Zhao et al. 2023, Table IV: ten walks as difficult as the sequences of EuRoC, and the ablation",
        "zhao2023.dvio_bench",
        kind=PATH,
    ),
    "dvio_faults": Study(
        "visual-inertial odometry under injected faults: depth, camera, IMU, passers-by, calibration",
        "zhao2023.dvio_faults",
    ),
    "shim_table5": Study(
        "Shim et al. 2019, Table 5: slope and step height from the legs of seven subjects",
        "shim2019.shim_table5",
        report="shim2019.shim_figures",
        kind=STEPS,
    ),
    "shim_faults": Study(
        "contact terrain under injected faults: insoles, encoders, AHRS, wrong lengths, shuffling, modules",
        "shim2019.shim_faults",
    ),
}
_LOADED: dict[str, Experiment] = {}


def experiment(name: str) -> Experiment:
    """An experiment, with its modules imported.

    Raises:
        StrideTwinError: The name is not in `STUDIES`; the message lists the valid ones.
    """
    if name not in _LOADED:
        if name not in STUDIES:
            raise StrideTwinError(f"invalid experiment {name!r}: expected {', '.join(STUDIES)}")
        _LOADED[name] = STUDIES[name].load(name)
    return _LOADED[name]
