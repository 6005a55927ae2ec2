"""Gait phase on short twin walks: accuracy, symmetry, standing, and what arrives broken."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks.gait_phase import FootWalk, estimate, simulate, to_series
from stridetwin.estimators.base import Options
from stridetwin.estimators.gait_phase import GaitPhase, GaitPhaseParameters, PhaseEstimate
from stridetwin.estimators.gait_phase.estimate import UNKNOWN_PHASE_SD
from stridetwin.estimators.gait_phase.stride import StrideFilter
from stridetwin.estimators.gait_phase.template import N_STRIDE_KINDS
from stridetwin.outputs.gait_phase.scores import find_touch_downs, phase_scores
from stridetwin.sim.faults.faults import Fault, arrivals, plan_faults
from stridetwin.sim.faults.sample_faults import Dropout, Nan, Repeat, Saturation
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.recording.ros_samples import block_of
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, Imu
from tests.estimators.imu_faults import IMU_FAULTS, TOPIC


@lru_cache(maxsize=8)
def walk_on(terrain: str, seed: int) -> list[FootWalk]:
    return simulate(terrain, seed)


def rms(walks: list[FootWalk], name: str) -> float:
    """Root of the mean of the walks' squared scores."""
    scores = [phase_scores(to_series(estimate(walk)), walk.strides) for walk in walks]
    assert all(s["missed"] == s["extra"] == 0.0 for s in scores)
    return float(np.sqrt(np.mean([s[name] ** 2 for s in scores])))


@pytest.mark.parametrize(
    ("terrain", "seed", "score", "limit_pct"),
    [
        ("level", 10, "rmse_steady_pct", 3.0),
        ("level", 10, "rmse_level_pct", 3.0),
        ("level", 20, "rmse_steady_pct", 3.0),
        ("turns", 1, "rmse_steady_pct", 3.0),
        ("stairs", 2, "rmse_stairs_pct", 5.0),
        ("stairs", 7, "rmse_stairs_pct", 5.0),
        ("ramps", 3, "rmse_ramp_pct", 5.0),
        ("mixed", 4, "rmse_pct", 5.0),
    ],
)
def test_phase_is_accurate(terrain: str, seed: int, score: str, limit_pct: float) -> None:
    assert rms(walk_on(terrain, seed), score) < limit_pct


def test_the_reported_deviation_holds() -> None:
    walks = [*walk_on("level", 10), *walk_on("stairs", 2)]
    scores = [phase_scores(to_series(estimate(walk)), walk.strides) for walk in walks]
    assert 85.0 < np.mean([s["within_95_pct"] for s in scores]) <= 100.0


def test_touch_downs_are_found_within_a_sample_or_two() -> None:
    for walk in walk_on("level", 10):
        scores = phase_scores(to_series(estimate(walk)), walk.strides)
        assert scores["touch_down_error_ms"] < 10.0


def test_estimates_are_valid_and_equal_in_every_run() -> None:
    walk = walk_on("stairs", 2)[0]
    estimates = estimate(walk)
    assert len(estimates) == len(walk.imu)
    assert estimates == estimate(walk)
    check(estimates)
    swings = np.array([e.swing for e in estimates if e.walking])
    assert 0.2 < swings.mean() < 0.5


def check(estimates: list[PhaseEstimate]) -> None:
    """Every estimate is finite and within its bounds, and times increase."""
    assert np.all(np.diff([e.t_ns for e in estimates]) > 0)
    for e in estimates:
        assert 0.0 <= e.phase < 1.0
        assert 0.0 <= e.phase_sd <= UNKNOWN_PHASE_SD
        assert 0.0 <= e.rate < 3.0
        assert e.touch_down_ns <= e.t_ns
        if not e.walking:
            assert (e.phase, e.phase_sd, e.rate) == (0.0, UNKNOWN_PHASE_SD, 0.0)


def test_the_right_foot_gets_what_its_mirror_image_gets() -> None:
    walk = walk_on("level", 10)[0]
    mirror = np.diag([1.0, -1.0, 1.0])
    imu = walk.rig.imu("/foot_l/imu")
    T = imu.mount.T_body_sensor.copy()
    T[:3, :3] = mirror @ T[:3, :3] @ mirror
    T[1, 3] *= -1.0
    mirrored_imu = replace(imu, topic="/foot_r/imu", mount=replace(imu.mount, body="foot_r", T_body_sensor=T))
    columns = {
        "angular_rate": -walk.imu.columns["angular_rate"] @ mirror,  # an axial vector
        "specific_force": walk.imu.columns["specific_force"] @ mirror,
    }
    mirrored = replace(
        walk,
        foot="r",
        rig=Rig(imus={"/foot_r/imu": mirrored_imu}),
        imu=replace(walk.imu, topic="/foot_r/imu", columns=columns),
    )
    left, right = estimate(walk), estimate(mirrored)
    np.testing.assert_allclose([e.phase for e in left], [e.phase for e in right], atol=1e-9)


def test_a_mount_in_any_attitude_is_taken_from_the_rig() -> None:
    walk = walk_on("level", 10)[0]
    imu = walk.rig.imu("/foot_l/imu")
    R = Rotation.from_euler("xyz", [170.0, -35.0, 80.0], degrees=True).as_matrix()  # sensor axes in the former ones
    T = imu.mount.T_body_sensor.copy()
    T[:3, :3] = T[:3, :3] @ R
    turned = replace(
        walk,
        rig=Rig(imus={imu.topic: replace(imu, mount=replace(imu.mount, T_body_sensor=T))}),
        imu=replace(walk.imu, columns={name: v @ R for name, v in walk.imu.columns.items()}),
    )
    series = to_series(estimate(turned))
    assert phase_scores(series, walk.strides)["rmse_pct"] < 3.0


@pytest.mark.parametrize("error_deg", [(20.0, 0.0, 0.0), (0.0, 20.0, 0.0), (0.0, 0.0, 20.0)])
def test_a_mount_that_is_wrong_by_20_degrees_costs_little(error_deg: tuple[float, float, float]) -> None:
    walk = walk_on("level", 10)[0]
    R = Rotation.from_euler("xyz", error_deg, degrees=True).as_matrix()
    turned = replace(walk, imu=replace(walk.imu, columns={name: v @ R for name, v in walk.imu.columns.items()}))
    right, wrong = (phase_scores(to_series(estimate(w)), walk.strides)["rmse_pct"] for w in (walk, turned))
    assert wrong < right + 0.5


def test_a_standing_person_has_no_phase() -> None:
    walk = walk_on("level", 10)[0]
    estimates = estimate(walk)
    first, last = walk.strides[0].begin_ns, walk.strides[-1].end_ns
    assert not any(e.walking for e in estimates if e.t_ns < first - 50_000_000)
    assert all(e.walking for e in estimates if first + 50_000_000 < e.t_ns < last)
    estimator = GaitPhase(walk.rig, options=Options(foot="l"))
    still = [e for s in samples_at_rest(walk, 0, 5.0) if (e := estimator.update(s))]
    assert not any(e.walking for e in still)


def samples_at_rest(walk: FootWalk, after_ns: int, duration_s: float) -> list[Imu]:
    """Samples of a foot at rest."""
    rng = np.random.default_rng(3)
    force = walk.imu.columns["specific_force"][:20].mean(axis=0)
    return [
        Imu(
            topic=walk.imu.topic,
            t_ns=after_ns + (i + 1) * 8_333_333,
            angular_rate=0.003 * rng.standard_normal(3),
            specific_force=force + 0.05 * rng.standard_normal(3),
        )
        for i in range(int(duration_s * 120.0))
    ]


def test_a_stop_ends_the_phase_within_a_second_and_a_half() -> None:
    walk = walk_on("level", 10)[0]
    estimator = GaitPhase(walk.rig, options=Options(foot="l"))
    before = [e for s in walk.imu if s.t_ns <= walk.strides[5].begin_ns + 200_000_000 and (e := estimator.update(s))]
    assert before[-1].walking
    after = [e for s in samples_at_rest(walk, before[-1].t_ns, 4.0) if (e := estimator.update(s))]
    stopped = next(e for e in after if not e.walking)
    assert (stopped.t_ns - before[-1].t_ns) * 1e-9 < 1.5
    assert not any(e.walking for e in after if e.t_ns > stopped.t_ns)


def arrived(walk: FootWalk, faults: list[Fault], seed: int) -> FootWalk:
    planned = plan_faults(faults, walk.rig, seed, walk.imu.t_ns[-1] * 1e-9)
    samples = [s for a in arrivals([walk.imu], planned) for s in (a.item if isinstance(a.item, Block) else [a.item])]
    return replace(walk, imu=block_of(samples))


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    faults=IMU_FAULTS,
)
def test_under_any_faults_estimates_are_valid(seed: int, faults: list[Fault]) -> None:
    check(estimate(arrived(walk_on("level", 10)[0], faults, seed)))


@pytest.mark.parametrize(
    ("fault", "extra_pct"),
    [
        (Dropout(topic=TOPIC, rate_per_min=60, duration_s=0.02), 1.0),
        (Dropout(topic=TOPIC, rate_per_min=20, duration_s=0.1), 4.0),
        (Nan(topic=TOPIC, rate_per_min=60, duration_s=0.02), 1.0),
        (Repeat(topic=TOPIC, rate_per_min=60, duration_s=0.2), 1e-9),
        (Saturation(topic=TOPIC, at_s=0, fraction=0.7), 1.0),
    ],
    ids=lambda v: v.full_name if isinstance(v, Fault) else "",
)
def test_a_fault_costs_little(fault: Fault, extra_pct: float) -> None:
    walk = walk_on("level", 10)[0]
    broken = arrived(walk, [fault], 1)
    clean, under_fault = (phase_scores(to_series(estimate(w)), walk.strides)["rmse_pct"] for w in (walk, broken))
    assert under_fault < clean + extra_pct


def test_half_the_rate_is_enough() -> None:
    walk = walk_on("level", 10)[0]
    n = len(walk.imu) // 2 * 2
    columns = {k: v[:n].reshape(-1, 2, 3).mean(axis=1) for k, v in walk.imu.columns.items()}
    halved = replace(walk, imu=replace(walk.imu, t_ns=walk.imu.t_ns[1:n:2], columns=columns))
    assert phase_scores(to_series(estimate(halved)), walk.strides)["rmse_pct"] < 3.5


def test_a_missed_touch_down_costs_one_stride() -> None:
    walk = walk_on("level", 10)[0]
    lost = walk.strides[6].begin_ns
    kept = np.abs(walk.imu.t_ns - lost) > 350_000_000
    columns = {k: v[kept] for k, v in walk.imu.columns.items()}
    series = to_series(estimate(replace(walk, imu=replace(walk.imu, t_ns=walk.imu.t_ns[kept], columns=columns))))
    later = [s for s in walk.strides if s.begin_ns > lost + 2_500_000_000]
    assert phase_scores(series, later)["rmse_pct"] < 3.0
    assert len(find_touch_downs(series)) >= len(walk.strides)


def test_options_and_parameters_are_checked() -> None:
    rig = walk_on("level", 10)[0].rig
    with pytest.raises(ConfigError, match="foot"):
        GaitPhase(rig, options=Options(foot="x"))
    with pytest.raises(StrideTwinError, match="no IMU"):
        GaitPhase(Rig())
    with pytest.raises(ConfigError, match="stride_s"):
        GaitPhaseParameters(stride_s=0.0)
    assert len(asdict(GaitPhaseParameters())) <= 25
    assert [s.topic for s in GaitPhase.streams(rig, Options(foot="r"))] == ["/foot_r/imu"]


def test_a_sequence_of_landings_that_cannot_be_stays_finite() -> None:
    stride = StrideFilter(GaitPhaseParameters())
    for k, kind in enumerate(reversed(range(N_STRIDE_KINDS))):
        stride.begin((1 + k) * 1_200_000_000)
        for i in range(1, 100):
            stride.update((1 + k) * 1_200_000_000 + i * 10_000_000, 0.01, 2.0)
        stride.is_walking = True
        stride._belief.walk[:] = -5000.0
        stride._belief.walk[kind] = 0.0
    stride.begin((1 + N_STRIDE_KINDS) * 1_200_000_000)
    stride.update((1 + N_STRIDE_KINDS) * 1_200_000_000 + 10_000_000, 0.01, 0.0)
    assert np.isfinite([stride.phase, stride.phase_sd, stride.rate, stride.usual_s]).all()
