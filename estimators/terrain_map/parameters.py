"""What the terrain map believes about any camera and any building."""

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
        grid_turn_rad: Angle of the voxels against the world's axes, so that edges across the way never run along them.
        weight_max: W_max of eq. (22), in pictures taken at 1 m.
        range_min_m: Depth below this is none.
        range_max_m: Depth beyond this is none.
        headroom_m: Nothing higher than this above the camera is mapped.
        outline_share: Inverse depths that differ by this share within `outline_px` belong to two surfaces.
        outline_px: Reach of the test, pixels of a 640-pixel picture.
        depth_noise_per_m: Standard deviation of the depth over its square, 1/m.
        ahead_m: How far ahead of the camera the view from above is centred.
        flat_rad: A plane that slopes less is flat.
        ramp_rad: No ramp slopes more.
        ramp_area_m2: No ramp is smaller.
        strip_area_m2: No plane is smaller.
        plane_noise_m: How far a column of the map may lie off its plane.
        riser_min_m: Stairs begin here.
        riser_max_m: And end here.
        edge_min_m: No edge of stairs is shorter.
        tread_min_m: Shortest tread.
        tread_max_m: Longest tread; beyond it a flat plane is a level of its own.
        votes_max: A plane's votes stop here.
        plane_sd_m: What pose and sensor do to the height of a whole plane.
        slope_sd_rad: And to its slopes.
        edge_sd_m: And to the place of a whole edge.
        period_s: Every picture goes into the voxels; planes are looked for no more often than this.
        max_pose_age_s: A pose older than this says nothing about a picture.
        max_gap_s: Poses that come again after longer may be in another frame: the map begins anew.
        max_speed_mps: A pose that moves faster has jumped: the map begins anew.
        jump_m: A change of pose below this is no jump, however fast.
        below_m: How far under the camera the middle of the window lies: about a person's neck over the ground.
        stale_s: Voxels that were not seen for longer make room first.
        pixels_min: A depth image with fewer pixels says nothing.
        significant_sd: A slope within so many standard deviations of flat may be flat.
        kerb_m: What rises by less from side to side is no ramp: a kerb is 40 mm.
        hidden_m: Ground that a riser may hide from the camera: the longest shadow of a riser of 0.2 m.
        parallel_rad: Edges of one flight differ by less in direction.
        cell_angle_rad: Neighbouring cells of one plane differ by less in direction.
        slope_prior_sd_rad: Slope of ground without evidence.
        shared_columns: Columns that share their error: a pixel's neighbourhood, and one pose.
        same_iou: Planes are one where they share this part of their union.
        inside_share: Or where one has this share of its columns in the other.
        apart: Planes further apart than this many `plane_noise_m` are two.
        uneven_m: How far an edge may lie off the even ones of its flight.
        uneven_riser_m: The same of a riser.
        even_sd_m: Deviation of an edge that is taken from the others of its flight.
        gap_m: How far it may lie outside of where nothing is seen.
        edge_m: Jumps below this are none.
        knee_rad: Changes of slope below this are none.

    All are hand-chosen on twin walks of tuning seeds, below 1000, but for sizes of buildings.
    """

    voxel_size_m: float = 0.02
    truncation_m: float = 0.04
    grid_turn_rad: float = 0.35
    weight_max: float = 12.0
    range_min_m: float = 0.35
    range_max_m: float = 4.5
    headroom_m: float = 0.1
    outline_share: float = 0.04
    outline_px: float = 1.0
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
    knee_rad: float = math.radians(4.0)

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number above 0, or two of them exclude each other."""
        check_numbers("TerrainMapParameters", asdict(self))
        for low, high in _ORDERED:
            if getattr(self, low) >= getattr(self, high):
                raise ConfigError("TerrainMapParameters", low, getattr(self, low), f"less than {high}")
