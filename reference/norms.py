"""Reference values from the literature, read from the folder `reference`."""

from __future__ import annotations

import csv
from functools import cache
from importlib import resources
from typing import Literal, TypedDict, overload

import numpy as np
import yaml

from stridetwin.streams.samples import Array

_LEG_M = 0.9  # length of the leg that the speeds of the groups belong to
# speed groups from slow to fast: name, and speed below which a walker belongs to it, m/s
_GROUPS = (("VerySlow", 0.67), ("Slow", 1.08), ("Free", 1.49), ("Fast", 1.89), ("VeryFast", float("inf")))


class MeanAndSd(TypedDict):
    """A published mean with its standard deviation."""

    mean: float
    sd: float


class EndErrors(TypedDict, total=False):
    """Published figures of the end of walks, each by method.

    Attributes:
        mean_end_error_m: [left, right] foot.
        end_position_sd_m: [across, along, across, along] the walk: two of the left foot, then two of the right one.
    """

    mean_end_error_m: dict[str, list[float]]
    end_position_sd_m: dict[str, list[float]]


class Jao2020(TypedDict):
    """Figures of Jao, Wang and Shkel 2020 that experiments and reports show; the file has further ones."""

    jao_straight_53m: EndErrors
    jao_loop_126m: EndErrors
    jao_simulation: EndErrors


class Moments(MeanAndSd):
    """Mean, standard deviation and range of a quantity."""

    min: float
    max: float


class Generality(TypedDict):
    """Results of Zhao et al. 2023 over all conditions.

    Attributes:
        accuracy_pct: Share of right steps, over the walks.
        camera_pitch_rad: Pitch of the camera.
        speed_mps: Walking speed.
    """

    accuracy_pct: MeanAndSd
    camera_pitch_rad: Moments
    speed_mps: Moments


class Zhao2023(TypedDict):
    """Figures of Zhao et al. 2023 that experiments and reports show; the file has further ones.

    Attributes:
        generality: Over all conditions.
        external_disturbance_pct: Accuracy in this trial, as in the next two.
        unconventional_camera_view_pct: Accuracy in this trial.
        multi_direction_outdoor_pct: Accuracy in this trial.
        accuracy_by_condition_pct: By condition, [mean, standard deviation].
        dvio_bench: By method, `ape_rmse_m`, and sequence of EuRoC: position error, m.
        zhao_closed_loop_drift_m: By method, [x, y, z]; texts, such as `>10`, where no number is reported.
        time_ms: By what was timed.
    """

    generality: Generality
    external_disturbance_pct: MeanAndSd
    unconventional_camera_view_pct: MeanAndSd
    multi_direction_outdoor_pct: MeanAndSd
    accuracy_by_condition_pct: dict[str, list[float]]
    dvio_bench: dict[str, dict[str, dict[str, float]]]
    zhao_closed_loop_drift_m: dict[str, list[float] | list[str]]
    time_ms: dict[str, float]


class Huo(TypedDict):
    """Errors of Huo et al. by mode, such as `LW`, or modes, as Shim et al. quote them: [mean, standard deviation]."""

    slope_error_deg: dict[str, list[float]]
    elevation_error_mm: dict[str, list[float]]


class Shim2019(TypedDict):
    """Figures of Shim et al. 2019 that experiments show; the file has further ones.

    Attributes:
        slope_error_deg: By modes, [mean, standard deviation].
        elevation_error_mm: By mode, [mean, standard deviation].
        classification_accuracy_pct: Least accuracy of any motion and subject.
        huo_et_al: Errors of another paper that this one quotes.
    """

    slope_error_deg: dict[str, list[float]]
    elevation_error_mm: dict[str, list[float]]
    classification_accuracy_pct: float
    huo_et_al: Huo


@overload
def read_reference(name: Literal["jao2020"]) -> Jao2020: ...
@overload
def read_reference(name: Literal["zhao2023"]) -> Zhao2023: ...
@overload
def read_reference(name: Literal["shim2019"]) -> Shim2019: ...
@overload
def read_reference(name: Literal["gait_norms"]) -> dict[str, object]: ...
def read_reference(name: str) -> object:
    """The content of one YAML file of the reference folder.

    Args:
        name: Name of the file without `.yaml`.
    """
    file = resources.files("stridetwin.reference").joinpath(f"{name}.yaml")
    return yaml.safe_load(file.read_text(encoding="utf-8"))


def read_reference_rows(name: str) -> list[dict[str, str]]:
    """Rows of one CSV table of the reference folder, such as `zhao2023_table2`, as column to text.

    Lines that begin with # are skipped.
    """
    file = resources.files("stridetwin.reference").joinpath(f"{name}.csv")
    lines = (line for line in file.read_text(encoding="utf-8").splitlines() if not line.startswith("#"))
    return list(csv.DictReader(lines))


def speed_group(speed_mps: float, leg_m: float = _LEG_M) -> str:
    """The speed group of Schwartz et al. 2008 that a walker belongs to.

    Args:
        speed_mps: Walking speed.
        leg_m: Length of the walker's leg. The speed is scaled to the leg length of the groups by equal Froude number,
            speed / sqrt(g leg).

    Returns:
        VerySlow, Slow, Free, Fast or VeryFast.
    """
    scaled_speed_mps = speed_mps * float(np.sqrt(_LEG_M / leg_m))
    return next(name for name, below in _GROUPS if scaled_speed_mps < below)


@cache
def level_norm(group: str, quantity: str) -> tuple[Array, Array, Array]:
    """A level-walking curve of Schwartz, Rozumalski & Trost 2008, J. Biomech. 41(8):1639-1650.

    Args:
        group: VerySlow, Slow, Free, Fast or VeryFast.
        quantity: Such as `knee_flexion_deg`.

    Returns:
        Share of the gait cycle in % from heel contact, mean and SD, (51,) each.
    """
    rows = [r for r in read_reference_rows("gait_norms_level") if r["speed"] == group and r["quantity"] == quantity]
    # (51, 3): share of the gait cycle, mean, SD
    table = np.array([[float(r["cycle_pct"]), float(r["mean"]), float(r["sd"])] for r in rows])
    return table[:, 0], table[:, 1], table[:, 2]
