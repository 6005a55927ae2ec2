"""Contact regions of the soles: heel, waist, ball and toes, small spheres that alone touch the ground.

The pairs of heel and waist sit on the foot, those of ball and toes on the toe body, so that the hinge between them
bends freely. The undersides of the spheres lie in the sole's plane; their compliance represents the sole's.
"""

from __future__ import annotations

import mujoco
import numpy as np

from stridetwin.sim.config import SIDES
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.streams.samples import Array

RADIUS_M = 0.006  # of a contact sphere
_HEEL_BLOCK_M = 0.065  # its front end bears load when the heel hangs over an edge
_LEAST_SHARE = 0.1  # of a foot's toe load that ball and tip each bear
FRICTION = 0.9  # coefficient of friction on the ground
PER_FOOT = 8  # contact points of a foot
HEEL_POINTS = 4  # of each foot's points, the first four
NEAR_M = 0.004  # a sole point this close to the ground is in contact
# about the plan, N m/rad and N m s/rad: forces alone do not control so light a body
TOE_STIFFNESS, TOE_DAMPING = 40.0, 1.0
_SOLREF = (0.008, 1.0)  # MuJoCo's time constant, s, and damping ratio of a contact
# MuJoCo's impedance of a contact: its values at no and at full penetration, the width of the transition, m, its
# midpoint and its power. Heel pad and shoe yield at first and stiffen as they are pressed (Aerts & De Clercq 1993, J.
# Sports Sci. 11); with 0.9 at no penetration, the damper makes the force jump by 0.4 body weights in the first
# millisecond, with 0.4 or less a sole bottoms out. A heel that bears half the body sinks in by 1.2 mm: two to three
# times as stiff as the 100-200 kN/m of shod heels, because on softer soles feet slip by more than 5 mm
_SOLIMP = (0.60, 0.98, 0.002, 0.5, 2.0)


def sole_points(size: Wearer) -> list[tuple[str, Array]]:
    """The eight contact points of a foot: body, `foot` or `toe`, and place in its frame, m, of each.

    They lie in the sole's plane, in pairs: back and front of the heel, then ball and tip of the toes.
    """
    shoe = size.shoe
    # m along each body: back and front of the heel in the foot's frame, ball and tip in the toe's, whose origin is its
    # hinge
    heel = (shoe.heel_back_x + RADIUS_M, shoe.heel_back_x + _HEEL_BLOCK_M)
    toe = (0.0, shoe.flat_tip_x - shoe.toe_hinge_x)
    # body by body, from back to front, the right point of each pair first
    return [
        (body, np.array([x, side * (shoe.half_width - RADIUS_M), z]))
        for body, along, z in (("foot", heel, 0.0), ("toe", toe, -shoe.toe_hinge_z))
        for x in along
        for side in (-1.0, 1.0)
    ]


def add_soles(spec: mujoco.MjSpec, size: Wearer) -> None:
    """Adds the contact spheres `sole_<side>_<i>` to a model's bodies; they touch nothing but terrain.

    They are massless and in geom group 3, which images do not show. Their lowest points lie on `sole_points`.
    """
    for side in SIDES:
        for i, (body, point) in enumerate(sole_points(size)):
            spec.body(f"{body}_{side}").add_geom(
                name=f"sole_{side}_{i}",
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                size=[RADIUS_M, 0, 0],
                pos=point + [0.0, 0.0, RADIUS_M],
                group=3,
                contype=0,
                conaffinity=1,
                mass=0.0,
                condim=3,
                friction=[FRICTION, 0.005, 0.0001],  # sliding; torsional and rolling, unused by contacts of condim 3
                solref=list(_SOLREF),
                solimp=list(_SOLIMP),
                priority=1,
                gap=NEAR_M,
            )


def toe_weights(size: Wearer, x: Array) -> Array:
    """(N, 4) weights of force at the two ball and two tip points of a foot, for a wanted centre of pressure.

    The controller minimises the weighted squares of the forces. Forces are therefore in inverse proportion to their
    weights. The tip gets the share (x − x_hinge) / (x_tip − x_hinge) of the load, and the ball gets the rest, each at
    least `_LEAST_SHARE`.

    Args:
        size: Wearer.
        x: (N,) m, wanted centre of pressure along the foot, from the origin of the foot's frame.
    """
    # (4,) m in front of the toe hinge: 0 for the two ball points, the same distance for the two tip points
    ahead = np.array([p[0] for body, p in sole_points(size) if body == "toe"])
    tip_share = np.clip((x - size.shoe.toe_hinge_x) / ahead.max(), _LEAST_SHARE, 1.0 - _LEAST_SHARE)[:, None]
    return 0.5 / np.where(ahead > 0.0, tip_share, 1.0 - tip_share)  # each of a pair bears half of its share
