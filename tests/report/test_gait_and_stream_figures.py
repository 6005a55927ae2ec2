"""Figures of a report: sensors by their names, loads of the carried weight, a colour for each estimate."""

from types import SimpleNamespace

import numpy as np
import pytest

from stridetwin.outputs.path.report import score_cards
from stridetwin.report.figures_gait import Stride, ground_reaction_figure
from stridetwin.report.figures_streams import describe_topic, scalar_topics
from stridetwin.streams.rig import Mount, OtherSensor, Rig
from stridetwin.streams.samples import Actuator, Encoder, Image, Imu
from tests.plots import figure


@pytest.mark.parametrize(
    ("topic", "name"),
    [
        ("/foot_l/imu", "Left foot IMU"),
        ("/exo/knee_r/encoder", "Exoskeleton, right knee encoder"),
        ("/exo/back/ahrs", "Exoskeleton, back AHRS"),
        ("/exo/thigh_l/interaction", "Exoskeleton, left thigh cuff"),
        ("/my_robot/temperature", "My robot temperature"),
    ],
)
def test_a_stream_is_named_by_its_sensor(topic, name):
    assert describe_topic(topic) == name


def test_joints_without_a_motor_have_no_figure():
    def actuator(joint, **parameters):
        topic = f"/exo/{joint}/actuator"
        return OtherSensor(
            topic=topic, kind="actuator", part="", rate_hz=100.0, mount=Mount(body="x"), parameters=parameters
        )

    sensors = [actuator("hip_l"), actuator("knee_l", torque_max_nm=15.0)]
    kinds = {s.topic: Actuator for s in sensors} | {"/exo/knee_l/encoder": Encoder, "/foot_l/imu": Imu, "/a": Image}
    topics = {topic: SimpleNamespace(kind=kind) for topic, kind in kinds.items()}
    recording = SimpleNamespace(topics=topics, has_rig=True, rig=Rig(others={s.topic: s for s in sensors}))
    assert scalar_topics(recording) == ["/foot_l/imu", "/exo/knee_l/actuator", "/exo/knee_l/encoder"]


@pytest.mark.parametrize(("speed_mps", "has_norm"), [(1.2, True), (0.4, False)])
def test_the_load_is_a_multiple_of_the_carried_weight_beside_the_range_of_people(speed_mps, has_norm):
    force = np.zeros((101, 3))
    force[:, 2] = 85.0 * 9.80665
    block = SimpleNamespace(t_ns=np.arange(101) * 10_000_000, columns={"force_in_world": force})
    recording = SimpleNamespace(topics=["/truth/foot_l/wrench"], block=lambda topic: block)
    strides = [Stride(foot="l", start_ns=0, end_ns=1_000_000_000, speed_mps=speed_mps)]
    drawn = figure(ground_reaction_figure(recording, strides, 85.0 * 9.80665))
    np.testing.assert_allclose(drawn.shapes("left strides")[0][:, 1], 1.0, rtol=1e-6)
    assert drawn.layout["yaxis"]["title"]["text"] == "force / carried weight"
    assert ("people, range" in drawn.labels) == has_norm
    if has_norm:
        assert [(box[:, 1].min(), box[:, 1].max()) for box in drawn.shapes("people, range")] == [
            (1.0, 1.25),
            pytest.approx((0.65, 0.9)),
            (1.0, 1.25),
        ]


def test_each_estimate_of_a_card_has_a_colour_of_its_own():
    def result(name, foot, label):
        estimate = SimpleNamespace(name=name, frame=f"foot_{foot}/imu", label=label)
        return SimpleNamespace(estimate=estimate, scores={"end_error_pct": 1.0})

    results = [result(f"{name}_{foot}", foot, label) for name, label in (("a", ""), ("b", "both")) for foot in "lr"]
    colors = score_cards(results).split("--dot: ")[1:]
    assert len({color[:7] for color in colors}) == len(colors) == 4
