"""The exoskeleton's leaf files: MuJoCo loads them, and they fit a person as the template before them did."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from stridetwin.sim.config import Exo, Person
from stridetwin.sim.wearer.body import add_wearer, compile_model, fit_wearer
from stridetwin.sim.wearer.exo_body import back_panel, leg_of
from stridetwin.sim.wearer.exoskeleton import EXO_LEG_JOINTS, RANGE_RAD, ExoLinks

LEAVES = Path(__file__).parents[2] / "assets/mjcf"
MEAN = Person(height_m=1.741, mass_kg=73.0)
TALL = {  # mass, kg; its place and inertia, kg m²; geoms, and the sums of their sizes and distances along the axes, m
    "exo_back": (3.5, [-0.18, 0, 0.09], [0.06, 0.03, 0.05], 18, 1.48600217469, 4.83605674995),
    "exo_hip_abduction": (0.4, [-0.108, 0.084, 0.048], [0.003, 0.005, 0.004], 4, 0.290622577483, 0.998),
    "exo_hip_rotation": (0.4, [0, 0, -0.025], [0.0008, 0.0008, 0.0006], 2, 0.081, 0.073),
    "exo_thigh": (0.9, [0, 0, -0.2021], [0.012, 0.012, 0.001], 14, 1.02215861309, 5.22036420828),
    "exo_shank": (0.7, [0, 0, -0.2009], [0.009, 0.009, 0.0006], 14, 0.969383264162, 4.76502154284),
    "exo_ankle": (0.2, [-0.026, 0.056, 0], [0.001, 0.0006, 0.0012], 3, 0.141518015094, 0.3875),
    "exo_foot": (0.4, [0.03, 0, -0.05], [0.001, 0.0012, 0.0012], 9, 0.376762574219, 1.062),
    "exo_knee_module": (1.4, [0, 0, 0], [0.00168, 0.00196, 0.00168], 2, 0.108, 0.028),
    "exo_hip_module": (1.6, [0, 0, 0], [0.00192, 0.00224, 0.00192], 2, 0.108, 0.028),
}
"""The exoskeleton in mode 1 on a person of 1.95 m and 110 kg, composed from the former template."""


@pytest.mark.parametrize("path", sorted(LEAVES.glob("*.xml")), ids=lambda path: path.stem)
def test_mujoco_opens_every_leaf(path: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.ngeom > 0


def test_exoskeleton_of_a_tall_person_is_as_before() -> None:
    spec = mujoco.MjSpec()
    add_wearer(spec, Person(height_m=1.95, mass_kg=110), Exo(mode=1))
    model = compile_model(spec)
    for name, (mass, place, inertia, count, size, distance) in TALL.items():
        for side, mirror in (("", 1),) if name == "exo_back" else (("_l", 1), ("_r", -1)):
            body = model.body(f"{name}{side}")
            own = model.geom_bodyid == body.id
            assert body.mass[0] == mass
            np.testing.assert_allclose(body.ipos, np.array(place) * [1, mirror, 1], atol=1e-15)
            np.testing.assert_allclose(body.inertia, inertia, rtol=1e-15)
            assert own.sum() == count
            assert model.geom_size[own].sum() == pytest.approx(size, abs=1e-11)
            assert np.abs(model.geom_pos[own]).sum() == pytest.approx(distance, abs=1e-11)


@pytest.mark.parametrize("fit", [back_panel, leg_of])
def test_leaf_is_that_of_the_mean_person(fit) -> None:  # type: ignore[no-untyped-def]
    """Fitting it to the person whose it is leaves every number as the file has it."""
    links = fit_wearer(MEAN).exo
    assert isinstance(links, ExoLinks)
    name = {back_panel: "exo_back", leg_of: "exo_leg"}[fit]
    file, fitted = mujoco.MjModel.from_xml_path(str(LEAVES / f"{name}.xml")), fit(links, 1.0).compile()
    for array in ("body_pos", "body_ipos", "body_inertia", "geom_pos", "geom_quat", "geom_size", "jnt_axis"):
        np.testing.assert_allclose(getattr(fitted, array), getattr(file, array), atol=2e-6, err_msg=array)


def test_ranges_of_the_leaf_are_those_that_the_planner_uses() -> None:
    leg = mujoco.MjModel.from_xml_path(str(LEAVES / "exo_leg.xml"))
    assert [leg.joint(i).name for i in range(leg.njnt)] == list(EXO_LEG_JOINTS)
    assert np.array_equal(leg.jnt_range, RANGE_RAD)
