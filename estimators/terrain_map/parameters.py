"""Public parameters of the terrain map: noise, voxels, gates on poses, and dimensions of ramps and stairs.

Every other number of the map is a constant of the module that uses it.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from stridetwin.streams.errors import ConfigError, check_numbers

# pairs of parameters of which the first must be less than the second
_ORDERED = (
    ("voxel_size_m", "truncation_m"), ("min_range_m", "max_range_m"), ("min_riser_m", "max_riser_m"),
    ("min_tread_m", "max_tread_m"), ("max_level_slope_rad", "max_tread_slope_rad"),
    ("max_tread_slope_rad", "max_ramp_slope_rad"),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class TerrainMapParameters:
    """Parameters of `TerrainMap`; the defaults serve every camera, mount and terrain.

    Each attribute says what it is, where its default comes from, and what happens if it is doubled. "Tuned": chosen by
    hand on simulated walks of seeds below 1000. "Buildings": dimensions that are usual in buildings. Effects were seen
    on stairs with risers of 90-160 mm, on ramps of 4° and 9° and on a table, at 10 images per second; where none is
    named, nothing changed there.

    Attributes:
        voxel_size_m: Edge of a voxel and of a column of the ground, m; less than `truncation_m`. Tuned. Doubled, both:
            an image takes a third of the time, and risers of 90 mm are lost where treads merge to ramps.
        truncation_m: t of docs/terrain_map.md (2), m: the layer above and below a surface in which distances are
            averaged. Tuned. Doubled: edges seen from above, on the way down, lie 1 cm farther out.
        max_weight: W_max of docs/terrain_map.md (4), in images taken from 1 m. Tuned. Doubled: what has moved, and what
            was mapped with an erroneous pose, takes up to twice as long to vanish.
        min_range_m: Smaller depths are invalid, m. Tuned. Doubled: the ground within 0.7 m of the camera is not mapped.
        max_range_m: Larger depths are invalid, m. Tuned. Doubled: a twentieth more blocks and no more ground, because
            planes are extracted up to 3.7 m ahead of the camera.
        depth_noise_per_m: Standard deviation of a depth divided by its square, 1/m. Tuned. Doubled: a ramp of 4° is
            recognised 0.1 m later.
        plane_noise_m: Largest standard deviation of a column's height, and largest change of a height, m, within one
            plane; a third of it is the smallest. Tuned. Doubled: a ramp of 4° is recognised 0.4 m later.
        plane_sd_m: Standard deviation of a plane's height by errors of pose and sensor, m, in docs/terrain_map.md (8).
            Tuned. Doubled: the standard deviation of risers nearly doubles.
        slope_sd_rad: Standard deviation of a plane's slope by the same errors, rad, in docs/terrain_map.md (8). Tuned.
            Doubled: the standard deviation of ramps doubles, and the prediction is less certain of their mode.
        edge_sd_m: Standard deviation of the position of a whole edge by the same errors, m, in docs/terrain_map.md
            (10). Tuned. Doubled: the standard deviation of treads doubles.
        max_level_slope_rad: A plane with a smaller slope is level, rad. Buildings: the gentlest ramps of building codes
            have 2.9° (1:20). Doubled, with the next one: ramps up to 5° are level ground.
        max_tread_slope_rad: A plane with a smaller slope may be a tread, rad. Tuned. Doubled: so may planes up to 10°.
        max_ramp_slope_rad: Largest slope of a ramp, and of any plane, rad. Tuned. Doubled: planes up to 50° are ramps.
        min_riser_m: Smallest riser of stairs, m. Zhao et al. 2023. Doubled: risers of 90 mm are not stairs, and the
            prediction is less certain of those of 150 mm.
        max_riser_m: Largest riser of stairs, m. Buildings. Doubled: a table of 0.55 m is a stair.
        min_tread_m: Smallest distance between neighbouring edges of one flight, m. Buildings. Doubled: stairs with
            treads of 0.3 m are single steps without a tread.
        max_tread_m: Largest distance between neighbouring edges of one flight, m; a longer flat plane is level ground.
            Buildings. Doubled: landings up to 1.2 m within a flight are treads.
        min_slope_break_rad: Smallest change of slope that is a slope break, rad. Tuned. Doubled: ramps below 3° have
            neither beginning nor end.
        period_s: Shortest time between two plane extractions, s; every image is integrated. Tuned. Doubled: at 30 Hz
            every third image gives an estimate, instead of every second.
        max_pose_age_s: An older pose is not used for an image, s. Tuned. Doubled: a pose is extrapolated by its
            velocity for up to 0.1 s.
        max_gap_s: After a longer gap in the poses they may be in another frame, s: map and prediction start anew.
            Tuned. Doubled: they survive longer failures of the odometry.
        max_speed_mps: A pose that moves faster has jumped, m/s: map and prediction start anew. Tuned. Doubled: ground
            before and after a smaller jump is in one map, which does not fit.
    """

    voxel_size_m: float = 0.02
    truncation_m: float = 0.04
    max_weight: float = 12.0
    min_range_m: float = 0.35
    max_range_m: float = 4.5
    depth_noise_per_m: float = 0.004
    plane_noise_m: float = 0.012
    plane_sd_m: float = 0.003
    slope_sd_rad: float = 0.004
    edge_sd_m: float = 0.005
    max_level_slope_rad: float = math.radians(2.5)
    max_tread_slope_rad: float = math.radians(5.0)
    max_ramp_slope_rad: float = math.radians(25.0)
    min_riser_m: float = 0.07
    max_riser_m: float = 0.33
    min_tread_m: float = 0.18
    max_tread_m: float = 0.60
    min_slope_break_rad: float = math.radians(1.5)
    period_s: float = 0.045
    max_pose_age_s: float = 0.05
    max_gap_s: float = 1.0
    max_speed_mps: float = 5.0

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number above 0, or two of them exclude each other."""
        check_numbers("TerrainMapParameters", asdict(self))
        for low, high in _ORDERED:
            if getattr(self, low) >= getattr(self, high):
                raise ConfigError("TerrainMapParameters", low, getattr(self, low), f"less than {high}")
