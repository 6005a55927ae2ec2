"""Corruptions of good walks as recorders, drivers and users cause them, each with what a right report says.

A corruption changes the arrays of a walk (`walks.Walk`); the formats' headers and calibrations still say what they said
before. The words of a right report are a regular expression: one of the reports must contain a match.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.implausible.files import FORMATS, Format
from benchmarks.implausible.walks import Inertial, Walk
from stridetwin.streams.gravity import STANDARD_GRAVITY_MPS2
from stridetwin.streams.samples import Array, Mask

Edit = Callable[[Walk, np.random.Generator], tuple[Walk, str]]
"""Gives the corrupted walk, and what was done to it."""
_HOUR_NS = 3600 * 10**9
"""An hour, ns."""
_RATE_FACTORS = {
    "°/s called rad/s": 180 / math.pi,
    "rad/s called °/s": math.pi / 180,
    "mrad/s called rad/s": 1000.0,
    "rad/s called mrad/s": 0.001,
}
"""Factors of rates in a unit that is mistaken for another one."""
_FORCE_FACTORS = {
    "g called m/s²": 1 / STANDARD_GRAVITY_MPS2,
    "m/s² called g": STANDARD_GRAVITY_MPS2,
    "mg called m/s²": 1000 / STANDARD_GRAVITY_MPS2,
    "cm/s² called m/s²": 100.0,
    "mm/s² called m/s²": 1000.0,
}
"""Factors of forces in a unit that is mistaken for another one."""
_LEAST_FACTOR = 1.1
"""A smaller factor on depth or intrinsics, or its inverse, is no gross mistake."""


@dataclass(frozen=True, kw_only=True)
class Corruption:
    """A kind of corruption.

    Attributes:
        edit: Changes a walk.
        report: What a right report contains, a regular expression.
        needs: What a format must have, see `files.Format.has`; one of several alternatives.
    """

    edit: Edit
    report: str
    needs: tuple[str, ...]

    def formats(self) -> list[str]:
        """Names of the formats that it can be in."""
        return [name for name, form in FORMATS.items() if self._fits(form)]

    def _fits(self, form: Format) -> bool:
        """Whether a format has what the corruption needs."""
        return any(set(alternative.split()) <= form.has for alternative in self.needs)

    def is_named_by(self, report: str) -> bool:
        """Whether a report names it."""
        return re.search(self.report, report, re.IGNORECASE) is not None


def _with_imu(walk: Walk, imu: Inertial) -> Walk:
    """The walk with other inertial samples."""
    return replace(walk, imu=imu)


def _with_views(walk: Walk, **changes: object) -> Walk:
    """The walk with changed fields of its views."""
    assert walk.views is not None
    return replace(walk, views=replace(walk.views, **changes))  # type: ignore[arg-type]


def _choose(factors: Mapping[str, float], rng: np.random.Generator) -> tuple[str, float]:
    """One of some factors, after its name."""
    name = str(rng.choice(list(factors)))
    return name, factors[name]


def scale_rates(walk: Walk, rng: np.random.Generator) -> tuple[Walk, str]:
    """Rates in another unit than the header says."""
    name, factor = _choose(_RATE_FACTORS, rng)
    return _with_imu(walk, replace(walk.imu, rate=factor * walk.imu.rate)), name


def scale_forces(walk: Walk, rng: np.random.Generator) -> tuple[Walk, str]:
    """Forces in another unit than the header says."""
    name, factor = _choose(_FORCE_FACTORS, rng)
    return _with_imu(walk, replace(walk.imu, force=factor * walk.imu.force)), name


def draw_axes(rng: np.random.Generator, kinds: Sequence[str]) -> tuple[Array, str]:
    """A matrix (3, 3) that swaps two axes, rotates all three, or mirrors one or all of them; and its description.

    Args:
        rng: Draws the kind and the axes.
        kinds: Some of `swapped`, `rotated`, `mirrored` and `negated`.
    """
    M = np.eye(3)
    kind = str(rng.choice(kinds))
    if kind == "swapped":
        a, b = rng.choice(3, 2, replace=False)
        M[[a, b]] = M[[b, a]]
    elif kind == "rotated":
        M = np.roll(M, int(rng.choice([1, 2])), axis=0)
    elif kind == "mirrored":
        axis = int(rng.integers(3))
        M[axis, axis] = -1.0
    else:
        M = -M
    axes = ", ".join(f"{'-' if row.sum() < 0 else ''}{'xyz'[int(np.argmax(np.abs(row)))]}" for row in M)
    return M, f"{kind}: {axes}"


def change_axes_of_rates(walk: Walk, rng: np.random.Generator) -> tuple[Walk, str]:
    """Rates with other axes than the forces."""
    M, name = draw_axes(rng, ["swapped", "rotated", "mirrored", "negated"])
    return _with_imu(walk, replace(walk.imu, rate=walk.imu.rate @ M.T)), name


def change_axes_of_forces(walk: Walk, rng: np.random.Generator) -> tuple[Walk, str]:
    """Forces with other axes than the rates; not all negated, which is the walk in a mirror: no IMU alone tells that.

    A reflection M of space turns forces f into M f and rates w into det(M) M w, so that f becomes -f and w stays.
    """
    M, name = draw_axes(rng, ["swapped", "rotated", "mirrored"])
    return _with_imu(walk, replace(walk.imu, force=walk.imu.force @ M.T)), name


def mirror_axes_of_both(walk: Walk, rng: np.random.Generator) -> tuple[Walk, str]:
    """Left-handed axes: one axis of rates and forces has the other sign, so that rates turn the wrong way."""
    axis = int(rng.integers(3))
    M = np.eye(3)
    M[axis, axis] = -1.0
    imu = replace(walk.imu, rate=walk.imu.rate @ M, force=walk.imu.force @ M)
    return _with_imu(walk, imu), f"{'xyz'[axis]} negated"


def take_gravity_out(walk: Walk, _: np.random.Generator) -> tuple[Walk, str]:
    """Forces without gravity, as phones give them by default ("linear acceleration")."""
    R_imu_world = Rotation.from_quat(walk.imu.q_world_imu, scalar_first=True).inv()
    force = walk.imu.force - R_imu_world.apply([0.0, 0.0, STANDARD_GRAVITY_MPS2])
    return _with_imu(walk, replace(walk.imu, force=force)), "gravity removed"


def draw_offset_ns(rng: np.random.Generator, most_ns: float = _HOUR_NS) -> int:
    """An offset of 50 ms to `most_ns`, evenly distributed by its logarithm, of either sign."""
    offset_ns = math.exp(rng.uniform(math.log(50e6), math.log(most_ns)))
    return round(offset_ns) * int(rng.choice([-1, 1]))


def shift_stamps_of_rates(walk: Walk, rng: np.random.Generator) -> tuple[Walk, str]:
    """Rates and forces with stamps of two clocks."""
    offset_ns = draw_offset_ns(rng)
    return _with_imu(walk, replace(walk.imu, t_ns=walk.imu.t_ns + offset_ns)), f"rates {offset_ns / 1e9:+.3g} s"


def delay_rates(walk: Walk, rng: np.random.Generator) -> tuple[Walk, str]:
    """Rows whose rates are of another instant than their forces, as with filters of different delay."""
    imu, offset_s = walk.imu, draw_offset_ns(rng, 300e6) * 1e-9
    t = (imu.t_ns - imu.t_ns[0]) * 1e-9
    rate = np.column_stack([np.interp(t - offset_s, t, imu.rate[:, k]) for k in range(3)])
    return _with_imu(walk, replace(imu, rate=rate)), f"rates {offset_s:+.3g} s"


def shift_stamps_of_images(walk: Walk, rng: np.random.Generator) -> tuple[Walk, str]:
    """Images stamped by another clock than the IMU."""
    assert walk.views is not None
    offset_ns = draw_offset_ns(rng)
    return _with_views(walk, t_ns=walk.views.t_ns + offset_ns), f"images {offset_ns / 1e9:+.3g} s"


def turn_mount(walk: Walk, rng: np.random.Generator) -> tuple[Walk, str]:
    """A mount in the calibration that is a right angle off, about one of the camera's axes."""
    assert walk.views is not None
    axis, sign = int(rng.integers(3)), int(rng.choice([-1, 1]))
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(sign * math.pi / 2 * np.eye(3)[axis]).as_matrix()
    name = f"{'-' if sign < 0 else ''}90° about {'xyz'[axis]}"
    return _with_views(walk, T_imu_cam=walk.views.T_imu_cam @ T), name


def move_mount(walk: Walk, rng: np.random.Generator) -> tuple[Walk, str]:
    """A lever arm in the calibration that is 0.3 m off."""
    assert walk.views is not None
    direction = rng.normal(size=3)
    T = walk.views.T_imu_cam.copy()
    T[:3, 3] += 0.3 * direction / np.linalg.norm(direction)
    return _with_views(walk, T_imu_cam=T), "0.3 m"


def draw_factor(rng: np.random.Generator, least: float, most: float) -> float:
    """A factor between two limits, evenly distributed by its logarithm, that is not nearly 1."""
    while True:
        factor = math.exp(rng.uniform(math.log(least), math.log(most)))
        if max(factor, 1 / factor) >= _LEAST_FACTOR:
            return factor


def scale_depth(walk: Walk, rng: np.random.Generator) -> tuple[Walk, str]:
    """Depth in another unit, as with a wrong number of units per metre."""
    assert walk.views is not None
    factor = draw_factor(rng, 0.2, 5.0)
    return _with_views(walk, depth_m=np.float32(factor) * walk.views.depth_m), f"times {factor:.3g}"


def scale_intrinsics(walk: Walk, rng: np.random.Generator) -> tuple[Walk, str]:
    """Focal lengths of another lens or resolution; the centre stays, so that the size of the images does not tell."""
    assert walk.views is not None
    factor = draw_factor(rng, 0.7, 1.4)
    fu, fv, pu, pv = walk.views.intrinsics
    return _with_views(walk, intrinsics=(factor * fu, factor * fv, pu, pv)), f"focal length times {factor:.3g}"


def draw_bursts(count: int, share: float, longest: int, rng: np.random.Generator) -> Mask:
    """Bursts of rows.

    Args:
        count: N.
        share: Share of the rows that are in a burst, about.
        longest: Most rows of a burst; those of two bursts may touch.
        rng: Draws the bursts.

    Returns:
        (N,) whether a row is in a burst; never the first and the last one.
    """
    is_in: Mask = np.zeros(count, bool)
    while is_in.mean() < share:
        first = int(rng.integers(1, count - 1))
        is_in[first : first + int(rng.integers(1, longest + 1))] = True
    is_in[0] = is_in[-1] = False
    return is_in


def lose_packets(walk: Walk, rng: np.random.Generator) -> tuple[Walk, str]:
    """Bursts of rows that never arrived: 2 to 30 %, up to a tenth of a second each, sometimes half a second."""
    share = rng.uniform(0.02, 0.3)
    rate_hz = 1e9 / float(np.median(np.diff(walk.imu.t_ns)))
    longest = max(2, round(rate_hz * float(rng.choice([0.1, 0.5]))))
    is_lost = draw_bursts(len(walk.imu), share, longest, rng)
    return _with_imu(walk, walk.imu[~is_lost]), f"{is_lost.mean():.0%} in bursts of up to {longest} rows"


def repeat_rows(walk: Walk, rng: np.random.Generator) -> tuple[Walk, str]:
    """Rows that are written twice with one stamp, as by a driver that publishes again what it has."""
    share = rng.uniform(0.02, 0.5)
    times = 1 + (rng.random(len(walk.imu)) < share)
    return _with_imu(walk, walk.imu[np.repeat(np.arange(len(walk.imu)), times)]), f"{share:.0%} written twice"


def hold_rows(walk: Walk, rng: np.random.Generator) -> tuple[Walk, str]:
    """Values that repeat those of the row before under new stamps: a sensor that is slower or stood still."""
    imu, count = walk.imu, len(walk.imu)
    if rng.random() < 0.5:
        every = int(rng.integers(2, 6))
        source, name = np.arange(count) // every * every, f"one value in {every} rows"
    else:
        is_held = draw_bursts(count, rng.uniform(0.05, 0.4), 60, rng)
        source = np.maximum.accumulate(np.where(is_held, 0, np.arange(count)))
        name = f"{is_held.mean():.0%} stood still"
    return _with_imu(walk, replace(imu, rate=imu.rate[source], force=imu.force[source])), name


def put_zeros(walk: Walk, rng: np.random.Generator) -> tuple[Walk, str]:
    """Rates, forces or both that are 0 where nothing was measured: in every k-th row or in bursts."""
    imu, count = walk.imu, len(walk.imu)
    what = str(rng.choice(["rates", "forces", "both"]))
    if rng.random() < 0.5:
        every = int(rng.integers(2, 10))
        is_zero, where = np.arange(count) % every == 1, f"in every {every}th row"
    else:
        is_zero, where = draw_bursts(count, rng.uniform(0.05, 0.4), 30, rng), "in bursts"
    keep = ~is_zero[:, None]
    rate = imu.rate * keep if what != "forces" else imu.rate
    force = imu.force * keep if what != "rates" else imu.force
    return _with_imu(walk, replace(imu, rate=rate, force=force)), f"{what} 0 {where}"


_AXES = r"\baxes\b|handed|mirror|swapped|exchanged"
_CLOCK = r"\bclocks?\b|overlap|earlier|later|stamped"
"""What reports of wrong axes, and of two clocks, contain."""
CORRUPTIONS: Mapping[str, Corruption] = {
    "unit of rates": Corruption(
        edit=scale_rates, report=r"°/s|rad/s|\bunit|times too (large|small)|twice too", needs=("imu",)
    ),
    "unit of forces": Corruption(
        edit=scale_forces, report=r"about 9\.8|milli-g|\bin g\b|cm/s²|mm/s²|\bunit", needs=("imu",)
    ),
    "axes of rates": Corruption(edit=change_axes_of_rates, report=_AXES, needs=("imu",)),
    "axes of forces": Corruption(edit=change_axes_of_forces, report=_AXES, needs=("imu",)),
    "left-handed axes": Corruption(edit=mirror_axes_of_both, report=_AXES, needs=("imu",)),
    "gravity removed": Corruption(edit=take_gravity_out, report=r"gravity", needs=("imu",)),
    "clock of rates": Corruption(edit=shift_stamps_of_rates, report=_CLOCK, needs=("imu parts",)),
    "delay of rates": Corruption(edit=delay_rates, report=_CLOCK, needs=("imu",)),
    "clock of images": Corruption(edit=shift_stamps_of_images, report=_CLOCK, needs=("imu camera",)),
    "mount by 90°": Corruption(edit=turn_mount, report=r"mount|T_cam_imu|extrinsic", needs=("imu camera",)),
    "mount by 0.3 m": Corruption(edit=move_mount, report=r"mount|T_cam_imu|extrinsic|lever", needs=("imu camera",)),
    "scale of depth": Corruption(
        edit=scale_depth, report=r"depth.*(scale|unit|times)|(scale|unit|times).*depth", needs=("depth",)
    ),
    "intrinsics": Corruption(edit=scale_intrinsics, report=r"intrinsics|focal", needs=("camera",)),
    "lost packets": Corruption(edit=lose_packets, report=r"\bgaps?\b|missing|\blost\b", needs=("imu",)),
    "rows twice": Corruption(edit=repeat_rows, report=r"repeat|twice", needs=("imu",)),
    "rows held": Corruption(edit=hold_rows, report=r"repeat|\bheld\b|stood still|same", needs=("imu",)),
    "zero rows": Corruption(
        edit=put_zeros, report=r"\bzeros?\b|no (rates|forces)|fill value|not measured", needs=("imu",)
    ),
}
"""The corruptions by their names."""
