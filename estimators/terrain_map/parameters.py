"""Public parameters of the terrain map: noise, voxels, gates on poses, and dimensions of ramps and stairs.

Every other number of the map is a constant of the module that uses it.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from stridetwin.streams.errors import ConfigError, check_numbers

_ORDERED = (
    ("voxel_size_m", "truncation_m"), ("min_range_m", "max_range_m"), ("min_riser_m", "max_riser_m"),
    ("min_tread_m", "max_tread_m"), ("max_level_slope_rad", "max_tread_slope_rad"),
    ("max_tread_slope_rad", "max_ramp_slope_rad"),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class TerrainMapParameters:
    """Parameters of `TerrainMap`; the defaults serve every camera, mount and terrain.

    Each attribute says what it is, where its default comes from, and what happens if it is doubled. "Tuned": chosen
    by hand on simulated walks of seeds below 1000. Equations are those of docs/terrain_map.md.

    Attributes:
        voxel_size_m: Edge of a voxel, m. Tuned; `truncation_m` must be larger. Doubled (both): an eighth of the voxels,
            each column of the ground covers four times the area, and edges of stairs are located half as precisely.
        truncation_m: t of (2), m: distances to a surface saturate this far above and below it. Tuned, two voxels.
            Doubled: heights are averaged over a thicker layer; risers below it blur, and more blocks are in use.
        grid_rotation_rad: Angle between grid and world axes, rad. Tuned: edges across the walking direction are
            oblique to the grid, so that voxels do not round all points of an edge alike. Doubled: no visible effect.
        max_weight: W_max of (4), in images taken from 1 m. Tuned. Doubled: heights average over twice as many images;
            moved objects and corrected poses take twice as long to show.
        min_range_m: Smaller depths are invalid, m. Data sheet of the RealSense D455, rounded down. Doubled: the ground
            within 0.7 m of the camera is not mapped.
        max_range_m: Larger depths are invalid, m. Tuned: beyond, noise exceeds 8 cm. Doubled: ground is seen earlier,
            with noise above a riser's height, and an image takes longer.
        depth_noise_per_m: Standard deviation of a depth divided by its square, 1/m. Tuned, above the 0.003 of a
            RealSense D455. Doubled: distant columns tolerate more, low risers merge with their neighbours from afar.
        plane_noise_m: Largest distance of a column from its plane, m; a third of it is the noise of the nearest
            columns. Tuned. Doubled: risers below about 5 cm vanish in one plane.
        plane_sd_m: Standard deviation of a plane's height by errors of pose and sensor, m, in (8). Tuned. Doubled:
            reported standard deviations of risers grow; estimates hardly change.
        slope_sd_rad: Standard deviation of a plane's slope by the same errors, rad, in (8). Tuned. Doubled: reported
            ones grow, gentle ramps count as level, and slope breaks must bend more.
        edge_sd_m: Standard deviation of the position of a whole edge by the same errors, m, in (10). Tuned. Doubled:
            reported standard deviations of treads and edges grow.
        max_level_slope_rad: A plane with a smaller slope is level, rad. Building codes: the gentlest ramps have 2.9°
            (1:20). Doubled: ramps up to 5° are reported as level ground.
        max_tread_slope_rad: A plane with a smaller slope may be a tread, rad. Tuned. Doubled: strips of ramps become
            treads of stairs.
        max_ramp_slope_rad: Largest slope of a ramp, and of any ground, rad. Tuned, above the 20° of access ramps.
            Doubled: slanted walls and furniture become ramps.
        min_ramp_area_m2: Smallest area of a ramp, m². Tuned. Doubled: a ramp is reported later.
        min_riser_m: Smallest riser of stairs, m. Zhao et al. 2023. Doubled: low stairs are not reported, and the mode
            prediction takes them for level ground.
        max_riser_m: Largest riser of stairs, m. Building codes, with a margin. Doubled: tables and boxes become steps.
        min_tread_m: Smallest distance between neighbouring edges of one flight, m. Building codes, with a margin.
            Doubled: stairs with treads below 0.36 m are single steps without a tread.
        max_tread_m: Longest tread, m; a longer flat plane is level ground. Building codes, with a margin. Doubled:
            landings within a flight count as treads.
        min_slope_break_rad: Smallest change of slope that is reported as a slope break, rad. Tuned. Doubled: ramps
            below 3° have no beginning and no end.
        period_s: Shortest time between two plane extractions, s; every image is integrated. Tuned: every other image
            at 30 Hz. Doubled: half as many estimates, a third less CPU time.
        max_pose_age_s: An older pose is not used for an image, s. Tuned. Doubled: images after a lost pose are mapped
            from an extrapolated one.
        max_gap_s: After a longer gap poses may be in another frame, s: map and walker start anew. Tuned. Doubled: the
            map survives longer failures of the odometry.
        max_speed_mps: A pose that moves faster has jumped, m/s: map and walker start anew. Above any runner. Doubled:
            smaller jumps of the odometry tear the map without a restart.
    """

    voxel_size_m: float = 0.02
    truncation_m: float = 0.04
    grid_rotation_rad: float = 0.35
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
    min_ramp_area_m2: float = 0.15
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
