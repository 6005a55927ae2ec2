"""Slope and step height on a short walk of the twin: accuracy, properties, faults."""

from dataclasses import replace

import numpy as np
import pytest
from exo_walk import dropped, level_walk, remounted, turned
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import Options
from stridetwin.estimators.contact_terrain import METHODS, ContactTerrain, PublishedParameters
from stridetwin.estimators.contact_terrain.estimate import (
    height_beyond_slopes,
    mode_probabilities,
    most_likely,
    ramp_probability,
)
from stridetwin.estimators.contact_terrain.footfall import CellLoads
from stridetwin.estimators.contact_terrain.geometry import Compliance, DhRow, parse_exoskeleton, to_text
from stridetwin.estimators.contact_terrain.leg import OFFSETS
from stridetwin.estimators.contact_terrain.offsets import (
    Offsets,
    StepFigures,
    _plane_residual,
    _plane_residual_jacobian,
    _update,
)
from stridetwin.estimators.contact_terrain.parameters import ContactTerrainParameters
from stridetwin.outputs.steps.scores import score_steps
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Ahrs, Encoder, Insole
from tests.pinned import SAME_WALK, assert_pinned, columns

PARAMETERS = ContactTerrainParameters()


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def estimator(exo, method="proposed"):
    return ContactTerrain(Rig(), options=Options(method=method), exoskeleton=exo)


def table(steps):
    return np.array([[s.slope, s.elevation, *s.p_sole_in_world] for s in steps])


@pytest.fixture(scope="module")
def walk():
    return level_walk()


@pytest.fixture(scope="module")
def ours(walk):
    exo, samples, _ = walk
    return estimator(exo).run(samples)


@pytest.fixture(scope="module")
def tables(walk):
    """The steps of each method, by its name."""
    exo, samples, _ = walk
    return {method: table(estimator(exo, method).run(samples)) for method in METHODS}


def test_proposed_estimates_a_level_walk_as_level(walk, ours):
    _, _, footprints = walk
    steps = score_steps(footprints, ours)
    assert all(s.estimated_mode == "LG" for s in steps)
    assert rms([s.elevation_error for s in steps]) < 0.0065
    assert rms([s.slope_error for s in steps]) < np.radians(0.8)
    assert np.mean([abs(s.elevation_error) < 1.96 * s.elevation_sd for s in steps]) > 0.85
    moved = np.diff([s.estimated_place for s in steps], axis=0) - np.diff([s.place for s in steps], axis=0)
    assert rms(moved.mean(axis=0)) < 0.007


def test_published_errs_as_on_people(walk):
    exo, samples, footprints = walk
    steps = [s for s in score_steps(footprints, estimator(exo, "published").run(samples)) if s.is_matched]
    assert 0.003 < rms([s.elevation_error for s in steps]) < 0.015
    assert np.radians(0.3) < rms([s.slope_error for s in steps]) < np.radians(2.5)


@pytest.mark.parametrize("method", METHODS)
def test_a_turned_world_has_the_same_slopes(walk, tables, method):
    exo, samples, _ = walk
    plain = tables[method]
    other = table(estimator(exo, method).run(turned(samples, Rotation.from_euler("z", 2.0))))
    assert other[:, :2] == pytest.approx(plain[:, :2], abs=1e-6)
    assert np.linalg.norm(np.diff(other[:, 2:4], axis=0), axis=1) == pytest.approx(
        np.linalg.norm(np.diff(plain[:, 2:4], axis=0), axis=1), abs=1e-6
    )


@pytest.mark.parametrize("method", METHODS)
def test_the_same_legs_described_by_another_table_walk_the_same(walk, tables, method):
    exo, samples, _ = walk
    plain = tables[method]
    turn = Rotation.from_euler("xyz", [0.4, -1.0, 2.0])
    legs = {}
    for side, leg in exo.legs.items():
        still = DhRow(alpha=0.0, a=0.0, d=0.0, theta=0.0, turns=False)  # one more frame, at the knee
        thigh, knee = leg.rows[:5], leg.rows[5:]
        mount = replace(leg.thigh, R_frame_sensor=leg.thigh.R_frame_sensor @ turn.as_matrix())
        legs[side] = replace(
            leg,
            rows=(*thigh, replace(still, a=0.1), replace(knee[0], a=knee[0].a - 0.1), *knee[1:]),
            thigh=mount,
            knee=replace(leg.knee, frame=7),
        )
    moved = list(samples)
    for side in "lr":
        moved = remounted(tuple(moved), f"/exo/thigh_{side}/ahrs", turn)
    other = parse_exoskeleton(to_text(replace(exo, legs=legs)), "other.yaml")
    # lengths that the filter thinks may be off are measured along the bones: they are as they were
    assert table(estimator(other, method).run(moved)) == pytest.approx(plain, abs=1e-5)


def test_samples_one_by_one_and_in_another_order_at_one_instant_give_the_same(walk, ours):
    exo, samples, _ = walk
    shuffled = sorted(reversed(samples), key=lambda s: s.t_ns)
    assert table(estimator(exo).run(shuffled)) == pytest.approx(table(ours), abs=1e-12)


def cell_dead(samples, cell, value):
    def corrupted(s):
        force = s.force.copy()
        force[cell] = value
        return replace(s, force=force)

    return [corrupted(s) if s.topic == "/foot_l/insole" else s for s in samples]


def corrupted(samples):
    for i, s in enumerate(samples):
        if i % 29 == 0 and isinstance(s, Ahrs):
            yield replace(s, q_world_sensor=np.full(4, np.nan))
        elif i % 31 == 0 and isinstance(s, Encoder):
            yield replace(s, angle=np.nan)
        elif i % 37 == 0 and isinstance(s, Insole):
            yield replace(s, force=np.full(4, np.inf))
        else:
            yield s


FAULTS = {
    "heel cell dead": lambda s: cell_dead(s, 0, 0.0),
    "toe cell dead": lambda s: cell_dead(s, 3, 0.0),
    "ball cell stuck": lambda s: cell_dead(s, 1, 120.0),
    "5 % lost": lambda s: dropped(s, 0.05),
    "not finite": corrupted,
    "twice": lambda s: [x for sample in s for x in (sample, sample)],
    "foreign topics": lambda s: [x for sample in s for x in (sample, replace(sample, topic="/other"))],
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_leave_the_class_right_or_unknown(walk, fault):
    exo, samples, footprints = walk
    steps = score_steps(footprints, estimator(exo).run(FAULTS[fault](samples)))
    classified = [s for s in steps if s.estimated_mode not in ("", "unknown")]
    assert len(classified) >= 0.5 * len(steps)
    assert all(s.estimated_mode == "LG" for s in classified)
    assert rms([s.elevation_error for s in classified]) < 0.015


def sticking(samples, cell):
    """The left foot's cell repeats from mid-stance on its force at that time."""
    value = None
    for s in samples:
        if s.topic == "/foot_l/insole":
            if value is None and s.t_ns > 3e9 and s.force[cell] > 150.0:
                value = s.force[cell]
            force = s.force.copy()
            force[cell] = force[cell] if value is None else value
            s = replace(s, force=force)
        yield s


def low(samples):
    """Every cell's zero is 3 N low."""
    for s in samples:
        yield replace(s, force=s.force - 3.0) if isinstance(s, Insole) else s


def creeping(samples):
    for s in samples:
        yield replace(s, force=s.force + 4e-9 * s.t_ns) if s.topic == "/foot_l/insole" else s


@pytest.mark.parametrize("fault", [lambda s: sticking(s, 0), lambda s: sticking(s, 3), creeping, low])
def test_cells_that_stick_creep_or_are_low_hide_no_step(walk, fault):
    exo, samples, footprints = walk
    steps = score_steps(footprints, estimator(exo).run(fault(samples)))
    assert [s.estimated_mode for s in steps] == ["LG"] * len(steps)
    assert rms([s.elevation_error for s in steps]) < 0.01


def test_cells_live_through_a_swing_over_two_risers():
    cells, rest = CellLoads(), np.array([5.0, 3.0, 2.0, 8.0])
    for force, rate, seconds in ((rest, 2.0, 1.0), (rest + 100.0, 0.1, 0.7), (rest, 2.0, 1.25)):
        for _ in range(round(100 * seconds)):
            load = cells.update(force, rate, 0.01)
    assert cells.alive.all()
    assert np.allclose(load, 0.0)


def test_an_unknown_method_is_refused(walk):
    with pytest.raises(ConfigError, match="expected proposed or published"):
        estimator(walk[0], "best")


def test_compliance_survives_its_file_and_files_without_it_mean_the_defaults(walk):
    exo, _, _ = walk
    text = to_text(exo)
    assert parse_exoskeleton(text, "exo.yaml").compliance == exo.compliance == Compliance()
    other = replace(
        exo, compliance=Compliance(vector_sd_m=(0.01, 0.02, 0.0), slope_sd_rad=np.radians(6.0), spread_gain=0.0)
    )
    read = parse_exoskeleton(to_text(other), "exo.yaml").compliance
    assert read.slope_sd_rad == pytest.approx(other.compliance.slope_sd_rad, rel=4e-16)  # the file holds degrees
    assert replace(read, slope_sd_rad=other.compliance.slope_sd_rad) == other.compliance
    before = text[: text.index("compliance:")]
    assert parse_exoskeleton(before, "exo.yaml").compliance == Compliance()
    for line, said in (
        ("slope_sd_deg: -1", "compliance.slope_sd_deg: invalid -1"),
        ("slack_m: 0.1", "compliance: invalid .slack_m."),
    ):
        with pytest.raises(ConfigError, match=said):
            parse_exoskeleton(f"{before}compliance: {{{line}}}\n", "exo.yaml")


def test_a_more_compliant_exoskeleton_leads_to_larger_standard_deviations(walk, ours):
    exo, samples, _ = walk
    soft = replace(exo, compliance=Compliance(vector_sd_m=(0.03, 0.03, 0.02), slope_sd_rad=np.radians(2.0)))
    for firm, yielding in zip(ours, estimator(soft).run(samples)):
        assert yielding.slope_sd > firm.slope_sd
        assert yielding.elevation_sd > firm.elevation_sd


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("probability_min", 1.0, "probability_min: invalid 1.0: .* below 1"),
        ("left_n", 90.0, "left_n: invalid 90.0: .* landed_n"),
        ("riser_m", -0.1, "riser_m: invalid -0.1"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(name, value, said):
    with pytest.raises(ConfigError, match=said):
        ContactTerrainParameters(**{name: value})
    with pytest.raises(ConfigError, match="virtual_m"):
        PublishedParameters(virtual_m=0.0)


@pytest.mark.parametrize(
    ("slope", "height", "mode"),
    [
        (0.0, 0.0, "LG"),
        (0.0, 0.165, "SA"),
        (0.0, -0.165, "SD"),
        (5.0, 0.05, "RA"),
        (-5.0, -0.05, "RD"),
        (0.0, 0.04, "LG"),
        (-3.5, -0.18, "SD"),  # a tread on which the foot's frame leans
        (8.0, 0.30, "RA"),
    ],
)
def test_modes_follow_from_geometry(slope, height, mode):
    beyond = height_beyond_slopes(height, 0.6, np.radians(slope), np.radians(slope))
    probabilities = mode_probabilities(np.radians(slope), np.radians(0.5), beyond, 0.005, PARAMETERS)
    assert sum(probabilities.values()) == pytest.approx(1.0)
    assert most_likely(probabilities, PARAMETERS.probability_min)[0] == mode
    between = mode_probabilities(np.radians(2.5), np.radians(0.5), 0.0, 0.005, PARAMETERS)
    assert most_likely(between, PARAMETERS.probability_min)[0] == "unknown"


@pytest.mark.parametrize(("slope", "share"), [(0.0, 0.0), (2.5, 0.5), (-2.5, 0.5), (5.0, 1.0), (-14.0, 1.0)])
def test_ground_slopes_from_half_the_gentlest_ramp_on(slope, share):
    assert ramp_probability(np.radians(slope), np.radians(0.3), PARAMETERS.ramp_rad) == pytest.approx(share, abs=1e-6)


def test_an_update_that_may_not_hold_has_the_moments_of_the_mixture():
    z, P = np.array([0.3, -0.2]), np.array([[0.04, 0.01], [0.01, 0.09]])
    H, y, noise = np.array([[1.0, 0.5]]), np.array([0.6]), np.array([0.02])
    mean, covariance, share = _update(z, P, H, y, noise, 0.6, 2.0)
    S = (H @ P @ H.T)[0, 0] + noise[0]
    innovation = (y - H @ z)[0]
    density = np.exp(-0.5 * innovation**2 / S) / np.sqrt(2 * np.pi * S)
    assert share == pytest.approx(0.6 * density / (0.6 * density + 0.4 / 2.0))
    gain = (P @ H.T)[:, 0] / S
    held, moved = P - np.outer(gain, gain) * S, z + gain * innovation
    expected = share * moved + (1 - share) * z
    spread = share * np.outer(moved - expected, moved - expected) + (1 - share) * np.outer(z - expected, z - expected)
    np.testing.assert_allclose(mean, expected, atol=1e-12)
    np.testing.assert_allclose(covariance, share * held + (1 - share) * P + spread, atol=1e-12)


def test_what_is_believed_of_the_offsets_stays_sound_over_an_hour_of_walking():
    rng = np.random.default_rng(0)
    J_vector, J_slopes = rng.normal(0.0, 0.5, (2, 3, OFFSETS)), rng.normal(0.0, 1.0, (2, 3, OFFSETS))
    offsets, sd = Offsets(PARAMETERS, Compliance().sag_sd_m), np.array([0.006, 0.006, 0.002, 0.006, 0.006, 0.004])
    for k in range(7000):
        noise = rng.normal(0.0, 0.3 * sd)
        step = StepFigures(
            vector=np.array([0.6, 0.0, 0.0]) + noise[:3],
            J_vector=J_vector[k % 2],
            slopes=noise[3:5],
            J_slopes=J_slopes[k % 2, :2],
            tilt=float(noise[5]),
            J_tilt=J_slopes[k % 2, 2],
            left=np.array([0.0, 1.0]),
            turned=np.array([0.1, -0.1]),
            sd=sd,
        )
        posterior = offsets.posterior(step)
        offsets.store(posterior)
    assert np.abs(posterior.P - posterior.P.T).max() <= 1e-12 * np.abs(posterior.P).max()
    assert np.linalg.eigvalsh(posterior.P).min() > 0.0
    assert np.isfinite(posterior.values).all()


def tilted_step(gradient, heading, turned, foot):
    """A step of (0.6, ±0.12) m in its heading on a plane, as feet that point aside measure it without errors."""
    ahead = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-ahead[1], ahead[0]])
    toes = foot * np.array([turned, -turned])  # the left foot's to the left
    directions = np.cos(toes)[:, None] * ahead + np.sin(toes)[:, None] * left
    place = 0.6 * ahead + foot * 0.12 * left
    return StepFigures(
        vector=np.array([*place, gradient @ place]),
        J_vector=np.zeros((3, OFFSETS)),
        slopes=np.arctan(directions @ gradient),
        J_slopes=np.zeros((2, OFFSETS)),
        tilt=float(np.arctan(gradient @ left)),
        J_tilt=np.zeros(OFFSETS),
        left=left,
        turned=np.sin(toes),
        sd=np.array([0.006, 0.006, 0.002, 0.006, 0.006, 0.004]),
    )


@pytest.mark.parametrize("foot", [1, -1])
@pytest.mark.parametrize("gradient", [(0.0, 0.0), (0.0, 0.087), (0.0, -0.05), (0.1, 0.0), (0.08, 0.06)])
def test_a_step_on_a_tilted_plane_stays_as_measured(gradient, foot):
    step = tilted_step(np.array(gradient), 0.0, 0.12, foot)
    residual = _plane_residual(np.array([*step.vector, *step.slopes, step.tilt]), step)
    assert (np.abs(residual) < [0.0015, 0.0005]).all(), residual  # of second order in the angles
    values = Offsets(PARAMETERS, Compliance().sag_sd_m).posterior(step).values
    np.testing.assert_allclose(values[:3], step.vector, atol=0.0015)


@pytest.mark.parametrize("seed", range(5))
def test_the_plane_has_the_derivative_of_its_residual(seed):
    rng = np.random.default_rng(seed)
    step = tilted_step(rng.normal(0, 0.1, 2), rng.uniform(-3, 3), 0.1, 1)
    m = np.array([*step.vector, *step.slopes, step.tilt])
    numeric = np.column_stack(
        [(_plane_residual(m + h, step) - _plane_residual(m - h, step)) / 2e-6 for h in 1e-6 * np.eye(6)]
    )
    np.testing.assert_allclose(_plane_residual_jacobian(m, step), numeric, atol=1e-7)


def test_pinned_numbers(ours, num_regression):
    assert_pinned(num_regression, columns(ours), SAME_WALK)


def test_pinned_numbers_of_the_published_method(walk, num_regression):
    exo, samples, _ = walk
    assert_pinned(num_regression, columns(estimator(exo, "published").run(samples)), SAME_WALK)
