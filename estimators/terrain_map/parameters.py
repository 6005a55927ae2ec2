"""Parameters of the terrain map, for any camera and any building."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from stridetwin.streams.errors import ConfigError, check_numbers

_ORDERED = (
    ("range_min_m", "range_max_m"), ("riser_min_m", "riser_max_m"), ("tread_min_m", "tread_max_m"),
    ("flat_rad", "ramp_rad"), ("voxel_size_m", "truncation_m"),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class TerrainMapParameters:
    """One set serves every camera, mount and terrain.

    Attributes:
        voxel_size_m: Edge of a voxel.
        truncation_m: t_δ of eq. (20), as a height over the surface.
        grid_rotation_rad: Angle between grid and world axes: edges across the walking direction are oblique to it.
        weight_max: W_max of eq. (22), in frames taken at 1 m.
        range_min_m: Smaller depths are invalid.
        range_max_m: Larger depths are invalid.
        headroom_m: Nothing higher above the camera is mapped.
        discontinuity_share: Inverse depths that differ by this share within `discontinuity_px` belong to two surfaces.
        discontinuity_px: Reach of the test, pixels of a 640-pixel image.
        depth_noise_per_m: Standard deviation of the depth divided by its square, 1/m.
        ahead_m: Distance ahead of the camera at which the top view is centred.
        flat_rad: A plane with a smaller slope is flat.
        ramp_rad: Largest slope of a ramp.
        ramp_area_m2: Smallest area of a ramp.
        strip_area_m2: Smallest area of a plane.
        plane_noise_m: Largest distance of a map column from its plane.
        riser_min_m: Smallest riser of stairs.
        riser_max_m: Largest riser of stairs.
        edge_min_m: Shortest edge of stairs.
        tread_min_m: Shortest tread.
        tread_max_m: Longest tread; a longer flat plane is level ground.
        votes_max: Upper limit of a plane's votes.
        plane_sd_m: Standard deviation of a plane's height from pose and sensor errors.
        slope_sd_rad: The same for its slopes.
        edge_sd_m: The same for the position of a whole edge.
        period_s: Shortest time between two plane extractions; every image is integrated.
        max_pose_age_s: An older pose is not used for an image.
        max_gap_s: After a longer gap poses may be in another frame: the map is reset.
        max_speed_mps: A pose that moves faster has jumped: the map is reset.
        jump_m: A smaller change of pose is not a jump, however fast.
        below_m: Distance of the window's middle below the camera: about a person's neck height.
        stale_s: Voxels not observed for longer are freed first.
        pixels_min: A depth image with fewer valid pixels is ignored.
        significant_sd: A slope within this many standard deviations of flat may be flat.
        kerb_m: A plane with less rise from side to side is not a ramp: a kerb is 40 mm.
        hidden_m: Length of ground that a riser may occlude: the longest shadow of a riser of 0.2 m.
        parallel_rad: Largest difference in direction between edges of one flight.
        cell_angle_rad: Largest angle between neighbouring cells of one plane.
        slope_prior_sd_rad: Prior standard deviation of the ground's slope.
        shared_columns: Number of columns that share their error: a pixel's neighbourhood, and one pose.
        same_iou: Two planes are the same if they share this part of their union.
        inside_share: Or if one has this share of its columns in the other.
        apart: Planes farther apart than this many `plane_noise_m` are distinct.
        uneven_m: Largest distance of an edge from the evenly spaced edges of its flight.
        uneven_riser_m: The same for a riser.
        even_sd_m: Standard deviation of an edge inferred from the others of its flight.
        gap_m: Largest distance of an inferred edge from the unobserved gap.
        edge_m: Smallest height step of an edge.
        slope_break_rad: Smallest slope change of a slope break.

    All are hand-chosen on twin walks of tuning seeds (below 1000), except building dimensions.
    """

    voxel_size_m: float = 0.02
    truncation_m: float = 0.04
    grid_rotation_rad: float = 0.35
    weight_max: float = 12.0
    range_min_m: float = 0.35
    range_max_m: float = 4.5
    headroom_m: float = 0.1
    discontinuity_share: float = 0.04
    discontinuity_px: float = 1.0
    depth_noise_per_m: float = 0.004
    ahead_m: float = 1.6
    flat_rad: float = math.radians(5.0)
    ramp_rad: float = math.radians(25.0)
    ramp_area_m2: float = 0.15
    strip_area_m2: float = 0.012
    plane_noise_m: float = 0.012
    riser_min_m: float = 0.07
    riser_max_m: float = 0.33
    edge_min_m: float = 0.3
    tread_min_m: float = 0.18
    tread_max_m: float = 0.60
    votes_max: float = 30.0
    plane_sd_m: float = 0.003
    slope_sd_rad: float = 0.004
    edge_sd_m: float = 0.005
    period_s: float = 0.045
    max_pose_age_s: float = 0.05
    max_gap_s: float = 1.0
    max_speed_mps: float = 5.0
    jump_m: float = 0.25
    below_m: float = 1.5
    stale_s: float = 1.0
    pixels_min: int = 500
    significant_sd: float = 2.0
    kerb_m: float = 0.04
    hidden_m: float = 0.30
    parallel_rad: float = math.radians(20.0)
    cell_angle_rad: float = math.radians(7.0)
    slope_prior_sd_rad: float = math.radians(6.0)
    shared_columns: float = 16.0
    same_iou: float = 0.3
    inside_share: float = 0.6
    apart: float = 1.5
    uneven_m: float = 0.06
    uneven_riser_m: float = 0.03
    even_sd_m: float = 0.015
    gap_m: float = 0.05
    edge_m: float = 0.04
    slope_break_rad: float = math.radians(4.0)

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number above 0, or two of them exclude each other."""
        check_numbers("TerrainMapParameters", asdict(self))
        for low, high in _ORDERED:
            if getattr(self, low) >= getattr(self, high):
                raise ConfigError("TerrainMapParameters", low, getattr(self, low), f"less than {high}")
