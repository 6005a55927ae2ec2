"""Assistance by mode: the modes, the observations and torques of the controller, and the cost of a walk."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from stridetwin.estimators.locomotion_mode import MODES
from stridetwin.sim.config import Exo, Gait, Level, Route, Stairs, TwinConfig
from stridetwin.sim.sensors.standard_rig import sensor_rig
from stridetwin.streams.samples import Insole
from stridetwin.studies import assistance
from stridetwin.studies.closed_loop.assistance_controller import ASSISTANCE, AssistanceController, AssistanceObserver
from stridetwin.studies.closed_loop.assisted_walk import (
    compute_costs,
    simulate_assisted_walk,
    simulate_bare_walk,
    true_modes_of,
)
from stridetwin.studies.closed_loop.recognition import CameraRecognition, Recognition, TrueModes

JOINTS = ("hip_l", "hip_r", "knee_l", "knee_r")
MOST = np.array([20.0, 20.0, 15.0, 15.0])
STAIR = TwinConfig(
    name="stair",
    gait=Gait(speed_mps=0.8, stand_s=0.5),
    route=Route(segments=(Level(length_m=0.8), Stairs(risers=3, riser_m=0.12, tread_m=0.32), Level(length_m=0.8))),
)


def insole(side: str, newtons: float, t_ns: int = 0) -> Insole:
    return Insole(t_ns=t_ns, topic=f"/foot_{side}/insole", force=np.full(4, newtons / 4))


def seen(speed: float, loaded: tuple[int, int], modes: tuple[str, str]) -> dict[str, np.ndarray]:
    found = {f"exo/{joint}/actuator": np.array([0.0, 0.0, speed]) for joint in JOINTS}
    return found | {"loaded": np.array(loaded, float), "mode": np.array([float(MODES.index(m)) for m in modes])}


def settled(observation: dict[str, np.ndarray]) -> np.ndarray:
    helper = AssistanceController(JOINTS, MOST)
    return [helper.torques(observation) for _ in range(200)][-1]


def test_torque_follows_the_joints_speed_with_the_share_of_the_mode() -> None:
    climbing = ("SA", "SA")
    assert settled(seen(-2.0, (1, 1), climbing)) == pytest.approx(-MOST)  # in stance both extend
    assert settled(seen(2.0, (0, 1), climbing)) == pytest.approx([20.0, 0.0, 15.0, 0.0])  # a loaded leg bends alone
    less = ASSISTANCE["LG"].share
    assert settled(seen(-2.0, (1, 1), ("LG", "LG"))) == pytest.approx(-less * MOST)
    assert settled(seen(-2.0, (1, 1), ("SA", "LG"))) == pytest.approx(-MOST * [1.0, less, 1.0, less])
    assert settled(seen(2.0, (1, 1), ("LG", "LG"))) == pytest.approx([20.0 * less, 20.0 * less, 0.0, 0.0])


def test_a_leg_that_swings_off_the_last_tread_is_assisted_as_on_the_stair() -> None:
    assert settled(seen(2.0, (0, 1), ("LG", "SA")))[0] == pytest.approx(20.0)


def test_no_torque_without_speed_or_before_the_first_sample() -> None:
    assert not settled(seen(0.0, (1, 1), ("SA", "SA"))).any()
    assert not settled(seen(np.nan, (1, 1), ("SA", "SA"))).any()


def test_motors_beside_those_of_hips_and_knees_are_left_alone() -> None:
    observation = seen(-2.0, (1, 0), ("SA", "SA"))
    for side in "lr":
        observation[f"exo/ankle_{side}/actuator"] = np.array([0.0, 0.0, -2.0])
    helper = AssistanceController((*JOINTS, "ankle_l", "ankle_r"), np.array([*MOST, 15.0, 15.0]))
    found = [helper.torques(observation) for _ in range(200)][-1]
    assert found == pytest.approx([*-MOST, 0.0, 0.0])


def test_help_grows_smoothly() -> None:
    helper = AssistanceController(JOINTS, MOST)
    found = np.array([helper.torques(seen(-2.0, (1, 1), ("SA", "SA")))[0] for _ in range(30)])
    assert -8.0 < found[0] < 0.0
    assert (np.diff(found) < 0.0).all()


def test_mode_is_that_of_the_current_step_or_the_next_one() -> None:
    class Fixed(Recognition):
        def __init__(self) -> None:
            self.current, self.upcoming = {"l": "LG", "r": "SA"}, {"l": "SD", "r": "RA"}

    rig = sensor_rig(replace(STAIR, exo=Exo(mode=1), sensors=("insole", "actuator"))).nominal(0)
    observer = AssistanceObserver(rig, Fixed)
    assert observer.observation()["mode"].tolist() == [0.0, 0.0]  # before a walk has begun
    observer.reset()
    observer.update([insole("l", 300.0), insole("r", 40.0)])
    assert observer.observation()["loaded"].tolist() == [1.0, 0.0]
    assert [MODES[int(m)] for m in observer.observation()["mode"]] == ["LG", "RA"]


def test_true_modes_change_step_by_step_and_are_corrupted_at_the_given_rate() -> None:
    steps = {"l": [(10**9, "SA"), (2 * 10**9, "LG")], "r": [(15 * 10**8, "SA")]}
    known = TrueModes(steps)
    found = []
    for t in (0.5, 1.05, 1.2, 1.9, 2.5):
        known.update(insole("l", 0.0, round(t * 1e9)))
        found.append((known.current["l"], known.upcoming["l"], known.current["r"]))
    assert found == [("LG", "SA", "LG"), ("SA", "SA", "LG"), ("SA", "LG", "LG"), ("SA", "LG", "SA"), ("LG", "LG", "SA")]
    many = {"l": [(k, "SA") for k in range(4000)], "r": []}
    corrupted = TrueModes(many, 0.01, np.random.default_rng(3))._modes["l"][1:-1]
    assert 20 < sum(mode != "SA" for mode in corrupted) < 60


def test_a_predicted_step_is_current_once_its_foot_is_down() -> None:
    def estimate(done: int, *coming: tuple[str, str]) -> SimpleNamespace:
        steps = [SimpleNamespace(step=done + 1 + k, foot=foot, mode=mode) for k, (foot, mode) in enumerate(coming)]
        return SimpleNamespace(step=done, steps=tuple(steps))

    predicted = CameraRecognition.__new__(CameraRecognition)
    Recognition.__init__(predicted)
    predicted._next = None
    predicted._update_modes(estimate(0, ("", "LG"), ("", "LG")))
    assert predicted.upcoming == {"l": "LG", "r": "LG"}
    predicted._update_modes(estimate(3, ("l", "SA"), ("r", "RA"), ("l", "SD")))
    assert (predicted.upcoming, predicted.current["l"]) == ({"l": "SA", "r": "RA"}, "LG")
    predicted._update_modes(estimate(4, ("r", "RA"), ("l", "SD"), ("r", "LG")))
    assert (predicted.upcoming, predicted.current) == ({"l": "SD", "r": "RA"}, {"l": "SA", "r": "LG"})


def test_a_stair_costs_less_with_assistance_than_with_compensation_alone() -> None:
    assisted = simulate_assisted_walk(STAIR, 3, lambda rig, twin: true_modes_of(twin))
    carried = simulate_assisted_walk(STAIR, 3, None)
    assert assisted.walk.fell_at is None
    own, more = compute_costs(assisted)["SA"], compute_costs(carried)["SA"]
    assert own["steps"] == more["steps"] == 3
    assert more["rest_j"] < own["work_j"] < 0.85 * more["work_j"]
    assert own["cuff_n"] > more["cuff_n"] > 1.0
    bare = compute_costs(simulate_bare_walk(STAIR, 3))["SA"]
    assert bare["cuff_n"] == 0.0
    assert bare["work_j"] < more["work_j"]


def test_the_table_lists_saved_work_and_falls() -> None:
    def row(seed: int, fell_at_s: float | None, **work: float) -> dict:
        ways = {
            way: {"fell_at_s": None, "modes": {"SA": {"steps": 2.0, "work_j": 2 * w, "rest_j": w, "cuff_n": 10.0}}}
            for way, w in work.items()
        }
        ways["known"]["fell_at_s"] = fell_at_s
        return {"seed": seed, "subject": "zhao_i_1", "ways": ways}

    rows = [
        row(1, None, none=100.0, carried=120.0, late=95.0, predicted=90.0, known=89.0),
        row(2, 3.0, none=100.0, carried=120.0, late=10.0, predicted=10.0, known=10.0),
    ]
    result = {"experiment": "assistance", "cases": rows, **assistance.collect(rows)}
    predicted = result["summary"]["predicted"]
    assert predicted["modes"]["SA"]["more_than_none_pct"] == pytest.approx(-10.0)
    assert predicted["gain_share"] == pytest.approx(5 / 6)
    assert result["summary"]["known"]["fell"] == 1
    text = "\n".join(assistance.table(result))
    assert "-10.0" in text
    assert "prediction gains 83%" in text
