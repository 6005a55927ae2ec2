"""What the prediction of locomotion modes believes about any walker."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from stridetwin.streams.errors import ConfigError, check_numbers

_ORDERED = (("lift_n", "touch_n"), ("grid_m", "behind_m"), ("kerb_m", "riser_max_m"))


@dataclass(frozen=True, kw_only=True)
class LocomotionModeParameters:
    """One set serves every walker, mount, pattern and terrain.

    Attributes:
        lift_n: A foot whose load falls below has left the ground, N over the unloaded insole.
        lift_share: Or to less than this share of the most that it bore.
        touch_n: A foot whose load rises above has touched down, N.
        creep_nps: How fast an insole's zero may rise, N/s.
        swing_min_s: A foot that is back on the ground sooner never left it.
        steps: Coming steps that are told.
        step_m: Step length of someone of whom nothing is known; its deviation is `step_sd` of it.
        step_s: Step time, likewise.
        step_sd: Share of length and time that walkers differ by.
        step_drift: Share by which length and time change from step to step, slowly.
        step_noise: Share by which single steps differ.
        asymmetry_sd: Share by which steps of the left foot are longer than the mean.
        width_m: Between left and right footprints.
        width_sd_m: Of a footprint across the way.
        lean_rad: At touch-down the body is ahead of the middle between the feet by this share of its height.
        climb_lean: Further ahead on the way up a ramp, by this share of its height and slope, rad/rad.
        body_sd_m: Deviation of that.
        top_sd_m: How much less or more the body rises over the standing foot than on level ground.
        edge_ahead_m: After a step over an edge the foot is this far ahead of the body.
        edge_ahead_sd_m: Deviation of that.
        heel_m: From the heel's centre back to the sole's end.
        toe_m: From there to the front end.
        overhang_m: How far a sole reaches over a free edge without being unlikely.
        overhang_sd_m: How much further it may.
        clearance_sd_m: How deep a sole may seem to be inside a riser.
        across_sd_m: How much of a sole may lie beyond a knee.
        edge_step: Mean length of a step over an edge, as a share of the level step.
        edge_step_sd_m: Its deviation.
        skip: How likely a step takes two treads.
        adapt_sd: Share by which all steps up to the next edge are lengthened or shortened together.
        kerb_m: A riser is one beyond this: between a kerb of 40 mm and the lowest stair, 70 mm.
        riser_sd_m: Least deviation of a riser.
        flight_riser_sd_m: Deviation of the riser of a flight, besides what the map tells.
        place_sd_m: Least deviation of the distance to a change.
        riser_m: A usual riser.
        tread_m: A usual tread.
        riser_max_m: No riser is higher.
        tread_min_m: No tread is shorter.
        tread_max_m: No tread is longer; flat ground that is, is a landing.
        brink_sd_m: Deviation of an edge behind which the ground is hidden.
        ramp_rad: Ground that slopes more is a ramp: half of the gentlest one that is built for walking, 5°.
        slope_sd_rad: Least deviation of a slope.
        flat_sd_rad: How level ground is that is built level.
        change_m: Ground that is not seen becomes another once in so many metres.
        ramp_step: Steps on ramps over those on level ground, before any was made.
        ramp_step_sd: Deviation of that.
        climb_sd: Deviation of half of what the ratio is larger uphill than downhill.
        grid_m: Cell of the density over the next footprints.
        behind_m: How far behind the body the density begins.
        reach_m: How far ahead of it it ends.
        still_m: Somebody who moved less within a stride goes where the camera looks.
        kept_s: Time for which the body's positions are kept.
        kept_period_s: Time between those.
        look_s: Time constant of the direction in which the camera looks.
        jump_m: Poses further apart have jumped.
        max_gap_s: Poses that come again after longer may be in another frame.
        stale_s: A pose older than this says nothing of now.
        velocity_s: Span over which the velocity is taken.
        usual_height_m: Of neck and waist over the ground, where it is not known.
        tallest_m: No camera is worn higher.
        back_m: How far behind the body ground is looked up.
        standing_sd_m: Of the first foot about the body, at the start.
        walking_sd_m: The same where all begins anew on the way.
        turned_rad: From this turn on the foot's place across the old way says where it is along the new one.
        turn_sd_rad: Steps that turn by more are no measure of others.
        beside_sd_m: Of the foot beside the body's way.
        height_sd_m: Deviation with which the body's height must be known to be of use.
        missed_steps: Step times after which a foot that touches down again has left out a step of the other.
        bounce_share: Share of a step time within which a touch-down is a bounce.
        over_foot_share: Share of a step time after which the body has passed over the foot.
        pause_steps: Usual step times after which a touch-down says nothing of the rhythm.
        longest_step_m: No step is longer.
        force_max_n: A larger load counts as lost.
        forget_s: Time after which the largest load of an insole is forgotten.
        flight_match_m: An edge this near to an edge of a flight belongs to it.
        flight_cosine: Least cosine between the way and the direction of a flight.
        tread_sd_share: Edges of one flight share their error: their distances are known better by this factor.
        tread_down_factor: Treads down are seen as strips: their depth is known worse by this factor.
        significant_sd: Deviations beyond which a slope is one.
        hidden_riser_sd: Share by which risers that were not seen may differ from usual ones.
        hidden_tread_sd: The same of treads.
        alike_riser_sd: The same of risers of stairs that are like those seen last.
        alike_tread_sd: And of their treads.
        alike_fall_m: By how much a fall may differ from so many risers of those.
        known_riser_sd_m: Deviation below which a riser is known well.
        known_tread_sd_m: The same of a tread.
        under_m: Ground that is seen only from so far before the body on begins there.
        begin_sd_m: Deviation of where.
        hidden_per_sd: Length of what is hidden behind an edge over the deviation of the edge in the map.

    From `kept_s` on all are hand-chosen on tuning seeds, below 1000.
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
    asymmetry_sd: float = 0.03
    width_m: float = 0.12
    width_sd_m: float = 0.03
    lean_rad: float = 0.032
    climb_lean: float = 0.12
    body_sd_m: float = 0.035
    top_sd_m: float = 0.035
    edge_ahead_m: float = 0.05
    edge_ahead_sd_m: float = 0.07
    heel_m: float = 0.045
    toe_m: float = 0.21
    overhang_m: float = 0.03
    overhang_sd_m: float = 0.03
    clearance_sd_m: float = 0.02
    across_sd_m: float = 0.05
    edge_step: float = 0.60
    edge_step_sd_m: float = 0.15
    skip: float = 0.01
    adapt_sd: float = 0.06
    kerb_m: float = 0.055
    riser_sd_m: float = 0.008
    flight_riser_sd_m: float = 0.0025
    place_sd_m: float = 0.008
    riser_m: float = 0.18
    tread_m: float = 0.30
    riser_max_m: float = 0.33
    tread_min_m: float = 0.22
    tread_max_m: float = 0.60
    brink_sd_m: float = 0.04
    ramp_rad: float = 0.0436
    slope_sd_rad: float = 0.0055
    flat_sd_rad: float = 0.0175
    change_m: float = 2.0
    ramp_step: float = 0.80
    ramp_step_sd: float = 0.12
    climb_sd: float = 0.06
    grid_m: float = 0.03
    behind_m: float = 1.2
    reach_m: float = 3.6
    still_m: float = 0.15
    kept_s: float = 2.0
    kept_period_s: float = 0.02
    look_s: float = 1.5
    jump_m: float = 0.5
    max_gap_s: float = 1.0
    stale_s: float = 0.2
    velocity_s: float = 0.1
    usual_height_m: float = 1.3
    tallest_m: float = 2.2
    back_m: float = 2.4
    standing_sd_m: float = 0.08
    walking_sd_m: float = 0.25
    turned_rad: float = 0.2
    turn_sd_rad: float = 0.25
    beside_sd_m: float = 0.10
    height_sd_m: float = 0.05
    missed_steps: float = 1.4
    bounce_share: float = 0.6
    over_foot_share: float = 0.6
    pause_steps: float = 3.0
    longest_step_m: float = 1.35
    force_max_n: float = 5000.0
    forget_s: float = 5.0
    flight_match_m: float = 0.15
    flight_cosine: float = 0.8
    tread_sd_share: float = 0.7
    tread_down_factor: float = 2.0
    significant_sd: float = 3.0
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

    def __post_init__(self) -> None:
        """Raises ConfigError where a value is not a finite number above 0, or two of them exclude each other."""
        check_numbers("LocomotionModeParameters", asdict(self))
        for low, high in _ORDERED:
            if getattr(self, low) >= getattr(self, high):
                raise ConfigError("LocomotionModeParameters", low, getattr(self, low), f"less than {high}")
