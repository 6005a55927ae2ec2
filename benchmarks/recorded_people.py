"""Recorded people in the twin: markers, soles on the ground, terrain, and the vertical force against force plates.

`python -m benchmarks.recorded_people [NAME ...] [--height 1.75] [--loop 60] [--json]`. The recordings are those of
`mocap` among the real recordings (`benchmarks.real_walks`). The force that a motion needs is the mass times gravity and
the vertical acceleration of the whole body's centre. It is compared in those times in which every foot on the ground
stands on plates: a stance does if, while the foot stands alone, the centre of pressure of all plates lies within its
sole and their force is at least `_LEAST_LOAD` of the body weight; a foot that never stands alone needs a plate of its
own. Forces are in body weights; the body weight is the one with which the motion fits the plates best in these times.
Landings show whether the plates' clock is late (`find_plate_delays`); the comparison with the forces in step is given,
too. The walk is also fitted to the joint angles that the laboratory computed, and its soles are compared with those by
markers. Nothing but the person's height is given. Times are those of the processor, as on a core that nobody else uses.
"""

from __future__ import annotations

import itertools
import sys
import time
from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.ndimage import binary_dilation
from scipy.signal import butter, sosfiltfilt

from benchmarks.command import answer, command
from benchmarks.real_walks import data_folder
from stridetwin.sim.config import SIDES, Level, Motion, Person, Route, TwinConfig
from stridetwin.sim.motion.feet import sole_points
from stridetwin.sim.motion.fit import FittedWalk, fit_markers, fit_segments, track_feet
from stridetwin.sim.motion.ik import point_errors
from stridetwin.sim.motion.opensim import read_opensim
from stridetwin.sim.motion.read import NumberTable, read_markers, read_number_table
from stridetwin.sim.motion.rests import FootTrack
from stridetwin.sim.motion.skeleton import Skeleton
from stridetwin.sim.motion.source import apply_motion
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.body import add_wearer, compile_model
from stridetwin.sim.wearer.dimensions import Shoe
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.samples import Array, Block, Imu

RECORDINGS = ("stair_up", "opencap_walking", "level_turn")
ASKED: dict[str, dict[str, float]] = {
    "stair_up": {
        "markers_mm": 9.0,
        "slide_mm": 2.0,
        "depth_995_mm": 5.0,
        "depth_max_mm": 10.0,
        "cpu_ms_per_frame": 8.0,
    },
    "opencap_walking": {"force_rms_bw": 0.05, "force_r": 0.98, "cpu_ms_per_frame": 8.0},
    "level_turn": {
        "force_rms_bw": 0.05,
        "force_r": 0.98,
        "by_angles_heel_mm": 15.0,
        "by_angles_middle_mm": 15.0,
        "by_angles_ball_mm": 15.0,
        "cpu_ms_per_frame": 8.0,
    },
}
"""What is wanted: at most, of `force_r` at least."""
_PRESSED_N = 20.0  # force of a plate on which something stands
_LEAST_LOAD = 0.4  # of the body weight, on plates that bear a person on one foot
_AROUND_SOLE_M = 0.05  # by which a centre of pressure may be beside the sole: errors of plates and of the fit
_ON_PLATE_SHARE = 0.95  # of the time of a single support
_LOW_M, _SLOW_MPS = 0.03, 0.6  # of a corner of a sole that may press on the ground
_UNSURE_S = 0.04  # by which touch-downs and toe-offs of the fit may be wrong
_ENDS_S = 0.04  # at both ends of a recording, three time constants of the filter of 12 Hz
# Landings that show whether the plates' clock is that of the cameras: of a filter on the heel's marker, half a window
# around the first force, and how sharp the force has to rise and the heel has to stop.
_HEEL_HZ, _AROUND_LANDING_S, _SHARP_NPS, _SHARP_MPS2 = 40.0, 0.06, 2e4, 20.0
_ACCELERATION_STEP_S = 0.001


@dataclass(frozen=True, kw_only=True, eq=False)
class Plates:
    """Force plates in the world of a fitted walk, at its frames.

    Attributes:
        up: (N, K) N, vertical force of each plate on the person.
        centres: (N, K, 2) m, centres of pressure in the plane.
    """

    up: Array
    centres: Array

    @classmethod
    def of(cls, table: NumberTable, walk: FittedWalk, t: Array) -> Plates:
        """Plates of an OpenSim file, y up, at (N,) s of its clock."""
        number, up, centres = 1, [], []
        while f"ground_force_{number}_vy" in table.names:
            vertical, x, z = (
                np.interp(t, table.t, table.column(f"ground_force_{number}_{name}")) for name in ("vy", "px", "pz")
            )
            up.append(vertical)
            centres.append(walk.placement.points(np.stack([x, -z, np.zeros_like(x)], axis=1))[:, :2])
            number += 1
        return cls(up=np.stack(up, axis=1), centres=np.stack(centres, axis=1))

    def centre(self) -> Array:
        """(N, 2) m, common centre of pressure; NaN where no plate is pressed."""
        force = np.where(self.up > _PRESSED_N, self.up, 0.0)
        total = force.sum(1, keepdims=True)
        return np.sum(self.centres * force[..., None], axis=1) / np.where(total > 0.0, total, np.nan)


def vertical_force(skeleton: Skeleton, person: Person, x: Array, dt: float) -> Array:
    """(N,) body weights, vertical force of the ground in a motion whose (N, D) coordinates are joined by splines."""
    spec = mujoco.MjSpec()
    add_wearer(spec, person, None)
    model = compile_model(spec)
    share = model.body_mass[1:] / model.body_mass[1:].sum()
    splines, t = make_interp_spline(np.arange(len(x)) * dt, x, k=5), np.arange(len(x)) * dt
    bodies = np.arange(len(skeleton.bodies))
    heights = []
    for late in (-_ACCELERATION_STEP_S, 0.0, _ACCELERATION_STEP_S):
        centres = skeleton.points(skeleton.poses(splines(t + late)), bodies, model.body_ipos[1:])
        heights.append(centres[..., 2] @ share)
    before, now, after = heights
    return 1.0 + (before - 2.0 * now + after) / _ACCELERATION_STEP_S**2 / NOMINAL_GRAVITY_MPS2


def rows_on_plates(walk: FittedWalk, plates: Plates) -> NDArray[np.bool_]:
    """(N,) whether every foot on the ground stands on plates."""
    n, shoe = len(walk.x), walk.skeleton.size.shoe
    row, unsure = np.arange(n), round(_UNSURE_S / walk.dt)
    tracks = {track.side: track for track in track_feet(walk.skeleton, walk.x)}
    spans = [(max(0, rest.ground[0] - unsure), min(n, rest.ground[1] + unsure)) for rest in walk.rests]
    down = {side: np.zeros(n, dtype=bool) for side in SIDES}
    for rest, (begin, end) in zip(walk.rests, spans):
        down[rest.side][begin:end] = True
    is_off = np.zeros(n, dtype=bool)
    for side, track in tracks.items():  # the push-off of a foot whose rest was before the recording
        is_off |= binary_dilation(_is_near_ground(walk, track) & ~down[side], iterations=unsure)
    load = plates.up.sum(1) / (walk.person.mass_kg * NOMINAL_GRAVITY_MPS2)
    for rest, (begin, end) in zip(walk.rests, spans):
        inner = (row >= begin + 2 * unsure) & (row < end - 2 * unsure)
        alone = inner & ~down["r" if rest.side == "l" else "l"]
        if alone.any():
            under = _is_under_sole(plates.centre()[:, None], tracks[rest.side], shoe)[:, 0] & (load > _LEAST_LOAD)
            on = np.mean(under[alone]) >= _ON_PLATE_SHARE
        else:  # a person who stands: a plate of its own
            under = np.any(_is_under_sole(plates.centres, tracks[rest.side], shoe) & (plates.up > _PRESSED_N), axis=1)
            on = inner.any() and np.mean(under[inner]) >= _ON_PLATE_SHARE
        if not on:
            is_off[begin:end] = True
    ends = round(_ENDS_S / walk.dt)
    return ~is_off & (down["l"] | down["r"]) & (row >= ends) & (row < n - ends)


def _is_near_ground(walk: FittedWalk, track: FootTrack) -> NDArray[np.bool_]:
    """(N,) whether a corner of a sole is low and slow enough to press on the ground."""
    corners = sole_points(track, walk.skeleton.size.shoe)
    height = corners[..., 2] - Terrain.from_route(walk.ground.route).height(corners[..., :2])
    speed = np.linalg.norm(np.gradient(corners, walk.dt, axis=0), axis=2)
    return np.any((height < _LOW_M) & (speed < _SLOW_MPS), axis=1)


def _is_under_sole(centres: Array, track: FootTrack, shoe: Shoe) -> NDArray[np.bool_]:
    """(N, K) whether centres of pressure (N, K, 2) are under a sole, or nearly."""
    local = np.einsum("nij,nki->nkj", track.R[:, :2, :2], centres - track.p[:, None, :2])
    low = np.array([shoe.heel_back_x, -shoe.half_width]) - _AROUND_SOLE_M
    high = np.array([shoe.toe_tip_x, shoe.half_width]) + _AROUND_SOLE_M
    return np.all((local > low) & (local < high), axis=2)


def compare_force(motion: Array, plates: Array) -> tuple[float, float, float]:
    """Body weight in N that fits best, RMS difference in body weights, and correlation, of forces at the same times.

    Args:
        motion: (N,) body weights.
        plates: (N,) N.
    """
    weight = float(motion @ plates / (motion @ motion))
    return weight, float(np.sqrt(np.mean((motion - plates / weight) ** 2))), float(np.corrcoef(motion, plates)[0, 1])


def find_plate_delays(walk: FittedWalk, table: NumberTable, begin_s: float) -> list[float]:
    """Delay of the plates after the markers in s, of each landing on a plate, whatever the force of the whole body.

    A force that stops a heel is there while it stops it: in step are the steepest rise of a plate's force and the
    largest upward acceleration of the heel's marker.

    Args:
        walk: The fitted walk, with its markers.
        table: Forces, y up.
        begin_s: Time of the first frame on the plates' clock.
    """
    t = begin_s + np.arange(len(walk.x)) * walk.dt
    heels = []
    for side in SIDES:
        on_foot = np.flatnonzero(walk.points.bodies == walk.skeleton.index(f"foot_{side}"))
        heel = on_foot[np.argmin(walk.points.places[on_foot, 0])]
        heights = walk.points.paths[:, heel, 2]
        seen = np.isfinite(heights)
        smooth = sosfiltfilt(butter(2, _HEEL_HZ, fs=1.0 / walk.dt, output="sos"), np.interp(t, t[seen], heights[seen]))
        heels.append(np.gradient(np.gradient(smooth, walk.dt), walk.dt))
    delays, around = [], round(_AROUND_LANDING_S / walk.dt)
    for number in itertools.count(1):
        if f"ground_force_{number}_vy" not in table.names:
            break
        force = np.interp(t, table.t, table.column(f"ground_force_{number}_vy"))
        pressed = force > _PRESSED_N
        for row in np.flatnonzero(pressed[1:] & ~pressed[:-1]) + 1:
            rows = slice(row - around, row + around)
            if row < around or row + around > len(t) or pressed[row - around : row].any():
                continue
            rise = np.gradient(force[rows], walk.dt)
            stops = [heel[rows] for heel in heels]
            stop = max(stops, key=np.max)
            if rise.max() > _SHARP_NPS and stop.max() > _SHARP_MPS2:
                delays.append(float(_peak_row(rise) - _peak_row(stop)) * walk.dt)
    return delays


def _peak_row(values: Array) -> float:
    """Row of the largest value, between rows by a parabola."""
    k = int(np.clip(np.argmax(values), 1, len(values) - 2))
    before, at, after = values[k - 1 : k + 2]
    bend = before - 2.0 * at + after
    return k if bend == 0.0 else k + float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5))


def measure_soles(walk: FittedWalk) -> dict[str, float]:
    """Slide of heel and ball in flat rests, mm, and depth of the deepest corner of the soles in the ground, mm."""
    terrain, shoe = Terrain.from_route(walk.ground.route), walk.skeleton.size.shoe
    slides, rises, depths = [0.0], [0.0], []
    for track in track_feet(walk.skeleton, walk.x):
        corners = sole_points(track, shoe)
        depths.append(np.max(terrain.height(corners[..., :2]) - corners[..., 2], axis=1))
        for rest in walk.rests:
            if rest.side == track.side and rest.flat is not None:
                for point in (track.point(shoe.heel_back_x), track.ball(shoe)):
                    moved = np.ptp(point[slice(*rest.flat)], axis=0)
                    slides.append(float(moved[:2].max()))
                    rises.append(float(moved[2]))
    depth = 1e3 * np.concatenate(depths)
    return {
        "slide_mm": 1e3 * max(slides),
        "rise_in_rest_mm": 1e3 * max(rises),
        "depth_995_mm": float(np.percentile(depth, 99.5)),
        "depth_max_mm": float(depth.max()),
    }


def measure_walk(walk: FittedWalk, plates: NumberTable | None, begin_s: float) -> dict[str, Any]:
    """All figures of a fitted walk, whose first frame is at `begin_s` of the plates' clock."""
    figures: dict[str, Any] = {}
    for name, x in (("markers_unpinned_mm", walk.x_unpinned), ("markers_mm", walk.x)):
        errors = point_errors(walk.skeleton, walk.points, x)
        figures[name] = 1e3 * float(np.sqrt(np.nanmean(errors**2)))
    figures |= measure_soles(walk)
    figures |= {"risers_mm": list(walk.ground.riser_mm), "treads_mm": list(walk.ground.tread_mm)}
    if plates is not None:
        delays = find_plate_delays(walk, plates, begin_s)
        delay_s = float(np.median(delays)) if delays else 0.0
        figures |= {"landings": float(len(delays)), "plates_delay_ms": 1e3 * delay_s}
        motions = [vertical_force(walk.skeleton, walk.person, x, walk.dt) for x in (walk.x_unpinned, walk.x)]
        for clock, late_s in (("", 0.0), ("_in_step", delay_s)):
            at = Plates.of(plates, walk, begin_s + late_s + np.arange(len(walk.x)) * walk.dt)
            rows = rows_on_plates(walk, at)
            figures[f"force{clock}_s"] = float(rows.sum() * walk.dt)
            for name, motion in zip((f"force{clock}_unpinned", f"force{clock}"), motions):
                weight, rms, r = compare_force(motion[rows], at.up.sum(1)[rows])
                figures |= {f"{name}_rms_bw": rms, f"{name}_r": r, f"{name}_mass_kg": weight / NOMINAL_GRAVITY_MPS2}
    return figures


def measure(arguments: Namespace) -> dict[str, Any]:
    """Figures of every recording."""
    folder = data_folder("mocap")
    if folder is None:
        raise StrideTwinError("no recordings: set STRIDETWIN_DATA to the folder that holds mocap")
    summary = {}
    for name in arguments.names or RECORDINGS:
        path = folder / "mocap" / f"{name}.trc.gz"
        table = read_markers(path)
        begin = time.process_time()  # that of an idle core, whatever else runs
        walk = fit_markers(table, Person(height_m=arguments.height))
        ms = 1e3 * (time.process_time() - begin) / len(table.t)
        plates = _read_plates(path.with_name(f"{name}_grf.mot.gz"))
        summary[name] = measure_walk(walk, plates, float(table.t[0])) | {"cpu_ms_per_frame": ms}
        if arguments.loop:
            person = Person(height_m=arguments.height)
            summary[name] |= measure_loop(path, person, walk, arguments.loop)
        angles = path.with_name(f"{name}_ik.mot.gz")
        if angles.exists():
            person = Person(height_m=arguments.height)
            by_angles = fit_segments(read_opensim(read_number_table(angles), person), person)
            summary[name] |= compare_soles(walk, by_angles)
    return {"experiment": "recorded_people", "summary": summary, "band": ASKED, "paper": {}, "cases": []}


def measure_loop(path: Path, person: Person, own: FittedWalk, duration_s: float) -> dict[str, float]:
    """Largest accelerations of a loop over those of its recording, and what its IMUs measure; every sensor but cameras.

    Args:
        path: The recording.
        person: The person.
        own: The recording itself.
        duration_s: Length of the loop.
    """
    config = TwinConfig(
        name=path.name,
        route=Route(segments=(Level(length_m=1.0),)),
        person=person,
        motion=Motion(file=str(path), duration_s=duration_s),
        sensors=tuple(group for group in TwinConfig.sensors if "camera" not in group),
    )
    config, looped = apply_motion(config)
    most = [np.abs(np.diff(walk.x, 2, axis=0)).max(0) / walk.dt**2 for walk in (own, looped)]
    figures = {
        "loop_s": looped.duration_s,
        "loop_pelvis_over_own": float(most[1][:3].max() / most[0][:3].max()),
        "loop_joints_over_own": float(most[1][6:].max() / most[0][6:].max()),
    }
    peaks: dict[str, float] = {}
    for blocks in Twin(config, 1000).blocks():
        for block in blocks:
            if isinstance(block, Block) and block.kind is Imu:
                force = float(np.linalg.norm(block.columns["specific_force"], axis=1).max())
                peaks[block.topic] = max(peaks.get(block.topic, 0.0), force)
    return figures | {f"loop_peak{topic.replace('/', '_')}_mps2": peak for topic, peak in sorted(peaks.items())}


def compare_soles(by_markers: FittedWalk, by_angles: FittedWalk) -> dict[str, float]:
    """RMS distances of points of the soles of two fits of one walk, mm, of the foot that differs more.

    The plane is that of the laboratory; heights are above the ground of each fit.
    """
    shoe = by_markers.skeleton.size.shoe
    places = {"heel": shoe.heel_back_x, "middle": 0.5 * (shoe.heel_back_x + shoe.toe_hinge_x), "ball": shoe.toe_hinge_x}
    figures = {}
    for name, along in places.items():
        soles = []
        for walk in (by_markers, by_angles):
            at = np.stack([track.point(along) for track in track_feet(walk.skeleton, walk.x)])
            plane = (at - walk.placement.shift) @ walk.placement.matrix
            soles.append(np.concatenate([plane[..., :2], at[..., 2:]], axis=-1))
        apart = np.sqrt(np.mean(np.sum((soles[0] - soles[1]) ** 2, axis=2), axis=1))
        figures[f"by_angles_{name}_mm"] = 1e3 * float(apart.max())
    return figures


def _read_plates(path: Path) -> NumberTable | None:
    return read_number_table(path) if path.exists() else None


def show(result: dict[str, Any]) -> None:
    """Prints a row per figure; a star marks what is worse than asked."""
    summary = result["summary"]
    print(f"{'':24}" + "".join(f"{name:>26}" for name in summary))
    for figure in dict.fromkeys(name for row in summary.values() for name in row):
        cells = []
        for name, row in summary.items():
            value = row.get(figure)
            if value is None or isinstance(value, list):
                text = ", ".join(f"{v:.0f}" for v in value) if value else "-"
            else:
                asked = ASKED.get(name, {}).get(figure)
                is_missed = asked is not None and (value < asked if figure.endswith("_r") else value > asked)
                text = f"{value:.3f}" if figure.endswith(("_bw", "_r")) else f"{value:.1f}"
                text += "" if asked is None else f" ({asked:g}){'*' if is_missed else ' '}"
            cells.append(f"{text:>26}")
        print(f"{figure:24}" + "".join(cells))


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(RECORDINGS)}")
    parser.add_argument("--height", type=float, default=1.75, help="of the person, m")
    parser.add_argument("--loop", type=float, default=0.0, metavar="S", help="also loop to this length, with sensors")
    return answer(parser, measure, show)


if __name__ == "__main__":
    sys.exit(main())
