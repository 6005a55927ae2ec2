import mujoco
import numpy as np
import pytest

from stridetwin.sim.config import Exo, Person
from stridetwin.sim.wearer.body import add_wearer, compile_model
from stridetwin.sim.wearer.limbs import NEAR_M, Limbs, find_shapes

BALL = {"kind": np.array([2]), "size": np.array([[0.1, 0.0, 0.0]]), "reach": np.array([0.1])}


def wearer():
    spec = mujoco.MjSpec()
    add_wearer(spec, Person(), Exo())
    return compile_model(spec)


def poses(model, count, rng):
    """Standing, and hinges anywhere within their ranges."""
    q = np.tile(model.qpos0, (count, 1))
    for joint in range(model.njnt):
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE and model.jnt_limited[joint]:
            low, high = model.jnt_range[joint]
            q[1:, model.jnt_qposadr[joint]] = rng.uniform(low / 2, high / 2, count - 1)
    return q


def test_lines_of_sight_are_hidden_where_mujocos_rays_meet_a_limb():
    model, rng = wearer(), np.random.default_rng(5)
    q = poses(model, 4, rng)
    limbs = Limbs.of(model, q, np.zeros((len(q), model.nv)))
    assert len(limbs.kind) == sum(model.geom_bodyid > 0)  # all of the wearer, shoes too
    rows = np.repeat(np.arange(len(q)), 60)
    eyes = rng.uniform([-0.8, -0.8, 0.0], [0.8, 0.8, 1.9], (len(rows), 3))
    targets = rng.uniform([-0.5, -0.5, 0.0], [0.5, 0.5, 1.8], (len(rows), 6, 3))
    hidden = limbs.occludes(rows, eyes, targets)
    data, compared, blocked = mujoco.MjData(model), 0, 0
    for row, eye, places, occluded in zip(rows, eyes, targets, hidden):
        data.qpos = q[row]
        mujoco.mj_kinematics(model, data)
        for place, by_us in zip(places, occluded):
            length = np.linalg.norm(place - eye)
            hit = mujoco.mj_ray(model, data, eye, (place - eye) / length, None, 1, -1, np.zeros(1, np.int32))
            away = hit if isinstance(hit, float) else hit[0]
            if 0 <= away < 2 * NEAR_M or abs(away - length) < 1e-6 or inside(limbs, row, eye):
                continue
            compared, blocked = compared + 1, blocked + by_us
            assert by_us == (0 <= away < length)
    assert compared > 1000
    assert 0.1 < blocked / compared < 0.9


def inside(limbs, row, eye):
    """Whether a place is within any limb's bounding ball, where rays of the two begin differently."""
    return bool((np.linalg.norm(limbs.p[row] - eye, axis=1) < limbs.reach).any())


@pytest.mark.parametrize(
    ("depth", "hidden"),
    [(-0.05, True), (-0.5 * NEAR_M, False), (0.5 * NEAR_M, False), (1.5 * NEAR_M, True)],
)
def test_shapes_nearer_than_images_show_hide_nothing_and_an_eye_may_be_a_little_inside_its_carrier(depth, hidden):
    ball = Limbs(**BALL, p=np.zeros((1, 1, 3)), R=np.eye(3)[None, None])
    eye, through = np.array([[-0.1 + depth, 0.0, 0.0]]), np.array([[[1.0, 0.0, 0.0]]])
    assert ball.occludes(np.array([0]), eye, through)[0, 0] == hidden


def test_shapes_of_a_foot_are_those_of_its_shoe():
    model = wearer()
    foot = find_shapes(model, {model.body("foot_l").id})
    assert len(foot) == 5
    assert min(shape.ray_distance(np.array([-1.0, 0.0, 0.05]), np.array([1.0, 0.0, 0.0])) for shape in foot) == (
        pytest.approx(1.0 - 0.042, abs=2e-3)
    )
