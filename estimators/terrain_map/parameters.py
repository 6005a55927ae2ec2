"""Parameters of the terrain map, for any camera and any building."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import NamedTuple

from stridetwin.streams.errors import ConfigError, check_numbers

_ORDERED = (
    ("range_min_m", "range_max_m"), ("riser_min_m", "riser_max_m"), ("tread_min_m", "tread_max_m"),
    ("level_rad", "flat_rad"), ("flat_rad", "bent_rad"), ("bent_rad", "ramp_rad"), ("voxel_size_m", "truncation_m"),
)  # fmt: skip


class TsdfParameters(NamedTuple):
    """Integration of depth images (`tsdf_integration`), in the form for compiled code."""

    pixel_stride: int = 8
    """Every eighth pixel in both directions allocates blocks: at 4.5 m these are 6 cm apart, a block is 16 cm wide."""
    descent_min: float = 0.3
    """Height over depth of the shallowest line of sight along which distances are converted to heights."""
    near_m: float = 0.05
    """Closer voxels are out of view."""
    free_lambda: float = 0.5
    """Space with a λ below the negative of this is certainly free."""
    noise_gate_sd: float = 3.0
    """Standard deviations of the depth by which a surface may be missed straight above a voxel."""


class RayParameters(NamedTuple):
    """Ray casting (`ray_casting`), in the form for compiled code."""

    weight_min: float = 0.1
    """Smallest weight of an observed voxel, in frames taken at 1 m."""
    lambda_max: float = 0.5
    """Beyond this |λ| the distance is unknown: the surface between two such voxels is taken in the middle."""
    neighbour_share: float = 0.5
    """Smallest weight of a column, as a share of its neighbours' weight: flying pixels have less."""
    weight_floor: float = 0.05
    """Lower limit of the weight in a column's standard deviation."""


class ClusterParameters(NamedTuple):
    """Plane extraction (`plane_extraction`), in the form for compiled code."""

    valid_share: float = 0.7
    """Smallest share of valid points in a cell, and of full cells in a large plane."""
    tilt_gate_sd: float = 2.0
    """Largest difference in tilt between two merged planes, in standard deviations."""
    distance_gate_sd: float = 3.0
    """Largest distance of a column from its plane, or from its neighbour in a strip, in standard deviations."""
    cells_min: int = 4
    """Smallest number of cells of a large plane."""
    strip_variance: float = 4.0
    """Largest mean squared distance of a strip's columns from their plane, divided by their variance."""


class EdgeParameters(NamedTuple):
    """Edges of steps (`stairs`, `plane_fit`), in the form for compiled code."""

    lanes: int = 28
    """Lines across an edge along which it is measured in the voxels."""
    inside_m: float = 0.06
    """Their start on the upper plane, before its last column."""
    beyond_m: float = 0.14
    """Their end beyond it."""
    gap_m: float = 0.12
    """Longest unobserved stretch between the last solid and the first free position."""
    points_min: int = 6
    """Smallest number of points of an edge."""
    outlier_m: float = 0.02
    """Largest distance of a lane's end from the median."""
    line_m: float = 0.06
    """Largest distance of a column from the edge's median line."""
    open_side: float = 0.4
    """Smallest mean of the unit vectors toward the lower plane: less where that plane surrounds the upper one."""
    direction_ratio: float = 0.5
    """Smallest ratio, across to along, at which an edge is long enough to have a direction."""
    trim_pct: float = 3.0
    """Share of an edge's points, at either end, outside which it is not measured in the voxels, %."""
    extent_pct: float = 2.0
    """Share of a flight's points, at either side, beyond its reported lateral extent, %."""
    border_m: float = 0.25
    """Width of a plane's border, half of which is free space, where its height is not evaluated."""


class ProfileParameters(NamedTuple):
    """The ground along a line (`profile`)."""

    step_m: float = 0.02
    """Distance between samples: a voxel."""
    half_width_m: float = 0.24
    """The line is as wide as a person walks, to either side."""
    lane_m: float = 0.04
    """Distance between parallel lanes."""
    lanes_min: int = 4
    """Smallest number of lanes on a plane, or with a known height, of 13."""
    samples_min: int = 3
    """Smallest number of samples on a plane for it to count."""
    slope_break_m: float = 0.15
    """Largest distance of a slope break from the gap between two planes."""
    cosine_min: float = 0.3
    """Smallest cosine between line and ascent at which the line crosses an edge."""
    edge_sd_min_m: float = 0.005
    """Smallest standard deviation of a measured edge."""


class BendParameters(NamedTuple):
    """Bends of one plane along a line (`bends`), hand-chosen on tuning walks over ramps of 2-6°."""

    bin_m: float = 0.1
    """Heights are averaged over this length."""
    fewest_bins: int = 5
    """A straight stretch is no shorter."""
    noise_m: float = 0.004
    """Standard deviation of a bin's height over a straight line."""
    least_rad: float = math.radians(1.5)
    """Smallest bend."""
    least_sd: float = 5.0
    """Its smallest number of standard deviations."""
    misfit_max_sd: float = 2.0
    """Where heights scatter more about a stretch, the ground jumps or bulges there, and nothing is cut."""
    passes: int = 4
    """How often each bend is placed again between its neighbours."""


_GROUPS = ("tsdf", "rays", "clusters", "edges", "profile", "bends")


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
        level_rad: A plane with a smaller slope is level: the gentlest ramps of building codes have 2.9°, 1:20.
        flat_rad: A plane with a smaller slope may be a tread.
        bent_rad: Largest apparent slope of a flat plane that pose errors have bent.
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
        winding_rad: Mean difference from edge to edge above which a flight winds.
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
        slope_break_sd: Its smallest number of standard deviations.
        tsdf, rays, clusters, edges, profile, bends: Parameters of the stages.

    All, and those of the stages, are hand-chosen on twin walks of tuning seeds (below 1000), except dimensions of
    buildings.
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
    level_rad: float = math.radians(2.5)
    flat_rad: float = math.radians(5.0)
    bent_rad: float = math.radians(10.0)
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
    winding_rad: float = math.radians(8.0)
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
    slope_break_rad: float = math.radians(1.5)
    slope_break_sd: float = 4.0
    tsdf: TsdfParameters = field(default_factory=TsdfParameters)
    rays: RayParameters = field(default_factory=RayParameters)
    clusters: ClusterParameters = field(default_factory=ClusterParameters)
    edges: EdgeParameters = field(default_factory=EdgeParameters)
    profile: ProfileParameters = field(default_factory=ProfileParameters)
    bends: BendParameters = field(default_factory=BendParameters)

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number above 0, or two of them exclude each other."""
        values = asdict(self)
        for name in _GROUPS:
            check_numbers(f"TerrainMapParameters.{name}", values.pop(name)._asdict())
        check_numbers("TerrainMapParameters", values)
        for low, high in _ORDERED:
            if getattr(self, low) >= getattr(self, high):
                raise ConfigError("TerrainMapParameters", low, getattr(self, low), f"less than {high}")
