"""Parameters of the locomotion mode prediction, for any walker."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from stridetwin.streams.errors import ConfigError, check_numbers

_ORDERED = (("lift_n", "touch_n"), ("grid_m", "behind_m"), ("kerb_m", "riser_max_m"), ("two_paces_m", "one_pace_m"))


@dataclass(frozen=True, kw_only=True)
class LocomotionModeParameters:
    """One set serves every walker, mount, pattern and terrain.

    Lengths and times of steps, insole loads and dimensions of buildings are usual values; the others, and all from
    `history_s` on, are hand-chosen on simulated walks of tuning seeds (below 1000).

    Attributes:
        lift_n: A foot whose load falls below this has left the ground, N over the unloaded insole.
        lift_share: Or whose load falls below this share of its largest load.
        touch_n: A foot whose load rises above this has touched down, N.
        creep_nps: Largest rate at which an insole's zero rises, N/s.
        swing_min_s: Shortest swing; a foot that returns sooner has not left the ground.
        steps: Number of predicted steps.
        step_m: Prior step length; its standard deviation is `step_sd` times this value.
        step_s: Prior step time, likewise.
        step_sd: Relative standard deviation of length and time between walkers.
        step_drift: Relative random walk of length and time per step.
        step_noise: Relative standard deviation of single steps.
        outlier_sd: Standard deviations beyond which a step gets less weight in these.
        asymmetry_sd: Relative standard deviation of left steps' excess over the mean.
        width_m: Lateral distance between left and right footprints.
        width_sd_m: Lateral standard deviation of a footprint.
        lean_rad: At touch-down the body is ahead of the middle between the feet by this share of its height.
        climb_lean: Additional lead uphill on a ramp, as a share of height and slope, rad/rad.
        body_sd_m: Standard deviation of that lead.
        top_sd_m: Standard deviation of the body's rise over the stance foot, relative to level ground.
        edge_ahead_m: Distance of the foot ahead of the body after a step over an edge as long as a usual tread.
        edge_ahead_sd_m: Its standard deviation.
        edge_ahead_share: Its growth with the length of the step beyond a usual tread, relative to that: 0.10 m
            over two treads at a time on five walks of tuning seeds.
        heel_m: Distance from the heel's centre back to the sole's end.
        toe_m: Distance from the heel's centre to the sole's front end.
        overhang_m: How far a sole may extend over a free edge without penalty.
        overhang_sd_m: Standard deviation of a larger overhang.
        clearance_sd_m: Standard deviation of a sole's apparent depth inside a riser.
        across_sd_m: Standard deviation of a sole's length beyond a slope break.
        edge_step: Mean length of a step over an edge, as a share of the level step.
        edge_step_sd_m: Its standard deviation.
        skip: Probability that a step takes one more tread than usual.
        joiners: Share of walkers who put both feet on each tread.
        joiner_joins: Probability that such a walker's foot joins the one that has crossed an edge.
        other_joins: The same of any other walker.
        two_at_a_time: Share of walkers who take two treads at a time on the way up.
        one_per_tread: Share of all others who never set a second foot on a tread, however deep.
        against_habit: Weight of a step that such walkers hardly ever take.
        habit_change: Probability that the walker chooses anew, at each edge crossed.
        habit_min: A less probable habit does not affect predictions.
        two_paces_m: Shallowest tread with room for a second step.
        one_pace_m: Deepest tread that walkers cross in one pace.
        beside_sd_m: Standard deviation of the distance along the path between a foot and the one that joins it.
        joined_ahead_m: Distance of the body ahead of both at touch-down: 0.15 m up and 0.12 m down on five walks of
            tuning seeds.
        joined_ahead_sd_m: Its standard deviation.
        adapt_sd: Relative standard deviation of the common change of all steps up to the next edge.
        kerb_m: Smallest riser: between a kerb of 40 mm and the lowest stair, 70 mm.
        stair_m: Smallest riser of a step up or down stairs: 70 mm (Zhao et al. 2023), less a margin.
        riser_sd_m: Smallest standard deviation of a riser.
        flight_riser_sd_m: Standard deviation of a flight's riser in addition to the map's.
        place_sd_m: Smallest standard deviation of the distance to a change.
        riser_m: A usual riser.
        tread_m: A usual tread.
        riser_max_m: Largest riser.
        tread_min_m: Shortest tread.
        tread_max_m: Longest tread; longer flat ground is a landing.
        occluded_edge_sd_m: Standard deviation of an occluding edge.
        ramp_rad: Smallest slope of a ramp: the gentlest ramps of building codes have 2.9°, 1:20.
        slope_sd_rad: Smallest standard deviation of a slope.
        map_sd_m: Standard deviation of the mapped height of one end of a plane over the other, by drift of the poses.
        flat_sd_rad: Standard deviation of the slope of ground built level.
        level_sd_rad: The same where nothing is known of the ground.
        ramp_sd_rad: The same of ramps, about level.
        level_share: Share of level ground among planes too long for a tread.
        false_break: Weight of a slope break between two segments that are both level.
        lean_sd_rad: Standard deviation of the map's lean along the path.
        lean_reach_sd: Largest lean, in standard deviations.
        change_m: Mean distance between changes of unobserved ground.
        ramp_step: Prior ratio of step lengths on ramps to those on level ground.
        ramp_step_sd: Its standard deviation.
        climb_sd: Standard deviation of half the ratio's difference between uphill and downhill.
        grid_m: Cell of the density over the next footprints.
        behind_m: Start of the density, behind the body.
        reach_m: End of the density, ahead of the body.
        still_m: A walker who moved less within a stride is taken to walk in the camera's viewing direction.
        history_s: Time for which the body's positions are stored.
        history_period_s: Time between stored positions.
        view_time_s: Time constant of the camera's viewing direction.
        jump_m: Poses farther apart have jumped.
        max_gap_s: After a longer gap poses may be in another frame.
        stale_s: An older pose is not used.
        velocity_s: Time span of the velocity estimate.
        usual_height_m: Prior height of neck and waist over the ground.
        tallest_m: Largest height of a camera.
        back_m: How far behind the body the ground is read from the map.
        standing_sd_m: Standard deviation of the first foot about the body, at the start.
        walking_sd_m: The same after a reset during the walk.
        rotation_rad: From this rotation on, the foot's lateral position gives its position along the new path.
        rotation_sd_rad: A step that rotates by more does not update the step statistics.
        lateral_sd_m: Lateral standard deviation of the foot from the body's path.
        height_sd_m: Largest standard deviation of a usable body height.
        missed_steps: Step times after which a second touch-down of one foot implies a missed step of the other.
        bounce_share: Share of a step time within which a touch-down is a bounce.
        over_foot_share: Share of a step time after which the body has passed over the foot.
        pause_steps: Usual step times after which a touch-down does not update the rhythm.
        longest_step_m: Longest step.
        force_max_n: A larger load counts as lost.
        peak_load_s: Time after which the largest load of an insole is discarded.
        flight_match_m: An edge this near to an edge of a flight belongs to it.
        flight_cosine: Smallest cosine between the path and the direction of a flight.
        tread_sd_share: Factor on the error of distances between edges of one flight, which share most of their error.
        tread_down_factor: Factor on the error of descending treads, of which the camera sees only strips.
        hidden_riser_sd: Relative standard deviation of unobserved risers from usual ones.
        hidden_tread_sd: The same for treads.
        alike_riser_sd: The same for risers of stairs like the last observed ones.
        alike_tread_sd: The same for their treads.
        alike_fall_m: Largest difference between a height drop and a whole number of those risers.
        known_riser_sd_m: Standard deviation below which a riser is well known.
        known_tread_sd_m: The same for a tread.
        under_m: Ground first observed farther ahead of the body than this begins there.
        begin_sd_m: Standard deviation of that beginning.
        hidden_per_sd: Length occluded behind an edge, divided by the edge's standard deviation in the map.
        max_speed_mps: Poses of the body that move faster have jumped.
        soon_s: Shortest predicted time to a landing.
        segments_max: Largest number of terrain segments; farther ones are omitted.
        treads_max: Largest number of extrapolated treads.
        edge_sd_min_m: Smallest standard deviation of an edge in the probability that a sole is beyond it.
        elevation_sd_m: Standard deviation of the map's height differences where an exoskeleton measured them.
        slope_match_sd_rad: The same for slopes.
        likelihood_floor: Lower limit of a position's likelihood: the map may be wrong under the foot, and people duck.
        top_asymmetry_sd_m: Standard deviation of half the difference of the body's top over the left and right foot.
        top_drift_m: Random walk of that top per step.
        top_noise_m: Standard deviation of a single step's top.
        weight_floor: Lower limit of a foothold's weight: an unexpected step must not leave the density empty.
        density_min: Smaller densities are not propagated.
        tail_sd: Standard deviations beyond which a density is taken as zero: it is far below `density_min`.
    """

    lift_n: float = 12.0
    lift_share: float = 0.1
    touch_n: float = 30.0
    creep_nps: float = 4.0
    swing_min_s: float = 0.12
    steps: int = 4
    step_m: float = 0.60
    step_s: float = 0.58
    step_sd: float = 0.15
    step_drift: float = 0.05
    step_noise: float = 0.05
    outlier_sd: float = 2.0
    asymmetry_sd: float = 0.03
    width_m: float = 0.12
    width_sd_m: float = 0.03
    lean_rad: float = 0.032
    climb_lean: float = 0.12
    body_sd_m: float = 0.035
    top_sd_m: float = 0.035
    edge_ahead_m: float = 0.05
    edge_ahead_sd_m: float = 0.07
    edge_ahead_share: float = 0.35
    heel_m: float = 0.045
    toe_m: float = 0.21
    overhang_m: float = 0.03
    overhang_sd_m: float = 0.03
    clearance_sd_m: float = 0.02
    across_sd_m: float = 0.05
    edge_step: float = 0.60
    edge_step_sd_m: float = 0.15
    skip: float = 0.01
    joiners: float = 0.1
    joiner_joins: float = 0.97
    other_joins: float = 0.005
    two_at_a_time: float = 0.03
    one_per_tread: float = 0.5
    against_habit: float = 0.003
    habit_change: float = 0.05
    habit_min: float = 0.01
    two_paces_m: float = 0.40
    one_pace_m: float = 0.65
    beside_sd_m: float = 0.05
    joined_ahead_m: float = 0.13
    joined_ahead_sd_m: float = 0.05
    adapt_sd: float = 0.06
    kerb_m: float = 0.055
    stair_m: float = 0.068
    riser_sd_m: float = 0.008
    flight_riser_sd_m: float = 0.0025
    place_sd_m: float = 0.008
    riser_m: float = 0.18
    tread_m: float = 0.30
    riser_max_m: float = 0.33
    tread_min_m: float = 0.22
    tread_max_m: float = 0.60
    occluded_edge_sd_m: float = 0.04
    ramp_rad: float = 0.0436
    slope_sd_rad: float = 0.0055
    map_sd_m: float = 0.015
    flat_sd_rad: float = 0.006
    level_sd_rad: float = 0.0175
    ramp_sd_rad: float = 0.12
    level_share: float = 0.85
    false_break: float = 0.1
    lean_sd_rad: float = 0.009
    lean_reach_sd: float = 4.0
    change_m: float = 2.0
    ramp_step: float = 0.80
    ramp_step_sd: float = 0.12
    climb_sd: float = 0.06
    grid_m: float = 0.03
    behind_m: float = 1.2
    reach_m: float = 3.6
    still_m: float = 0.15
    history_s: float = 2.0
    history_period_s: float = 0.02
    view_time_s: float = 1.5
    jump_m: float = 0.5
    max_gap_s: float = 1.0
    stale_s: float = 0.2
    velocity_s: float = 0.1
    usual_height_m: float = 1.3
    tallest_m: float = 2.2
    back_m: float = 2.4
    standing_sd_m: float = 0.08
    walking_sd_m: float = 0.25
    rotation_rad: float = 0.2
    rotation_sd_rad: float = 0.25
    lateral_sd_m: float = 0.10
    height_sd_m: float = 0.05
    missed_steps: float = 1.4
    bounce_share: float = 0.6
    over_foot_share: float = 0.6
    pause_steps: float = 3.0
    longest_step_m: float = 1.35
    force_max_n: float = 5000.0
    peak_load_s: float = 5.0
    flight_match_m: float = 0.15
    flight_cosine: float = 0.8
    tread_sd_share: float = 0.7
    tread_down_factor: float = 2.0
    hidden_riser_sd: float = 0.40
    hidden_tread_sd: float = 0.15
    alike_riser_sd: float = 0.05
    alike_tread_sd: float = 0.05
    alike_fall_m: float = 0.03
    known_riser_sd_m: float = 0.01
    known_tread_sd_m: float = 0.03
    under_m: float = 0.5
    begin_sd_m: float = 0.1
    hidden_per_sd: float = 4.0
    max_speed_mps: float = 5.0
    soon_s: float = 0.05
    segments_max: int = 10
    treads_max: int = 6
    edge_sd_min_m: float = 0.01
    elevation_sd_m: float = 0.01
    slope_match_sd_rad: float = 0.0175
    likelihood_floor: float = 1e-3
    top_asymmetry_sd_m: float = 1e-3
    top_drift_m: float = 0.005
    top_noise_m: float = 0.01
    weight_floor: float = 1e-9
    density_min: float = 1e-10
    tail_sd: float = 8.0

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number above 0, or two of them exclude each other."""
        check_numbers("LocomotionModeParameters", asdict(self))
        for low, high in _ORDERED:
            if getattr(self, low) >= getattr(self, high):
                raise ConfigError("LocomotionModeParameters", low, getattr(self, low), f"less than {high}")
