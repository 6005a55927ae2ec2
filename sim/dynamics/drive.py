"""What drives the actuation modules: a law from joint angles and speeds to motor torques, a hundred times a second.

`transparent` takes most of a module's own friction off the wearer. `assist` helps both hips besides, by delayed output
feedback (after Lim et al. 2019, IEEE Trans. Robotics 35:1055): how far the legs were apart a quarter of a stride ago
tells how fast they pass each other now.
"""

from __future__ import annotations

import math
from collections import deque

import mujoco
import numpy as np

from stridetwin.sim.actuation import FRICTION_SPEED_RADPS, modules
from stridetwin.sim.config import Exo
from stridetwin.streams.samples import Array

PERIOD_S = 0.01
_COMPENSATED = 0.8  # of the friction: more than there is would make the joint run away
_ASSIST_NM = 8.0  # for legs one radian apart
_QUARTER_STRIDE_S = 0.25
_SMOOTHING_S = 0.05


class Drive:
    """Motors of an exoskeleton.

    Args:
        model: Model of the wearer with it.
        exo: Its modules, and the law that drives them.
    """

    def __init__(self, model: mujoco.MjModel, exo: Exo | None) -> None:
        mounted = {} if exo is None or exo.drive == "idle" else modules(exo)
        hinges = [model.joint("exo_{}_flexion_{}".format(*joint.split("_"))) for joint in mounted]
        self._angle = np.array([hinge.qposadr[0] for hinge in hinges], dtype=int)
        self._dof = np.array([hinge.dofadr[0] for hinge in hinges], dtype=int)
        self._friction = np.array([module.friction_nm for module in mounted.values()])
        self._viscous = np.array([module.viscous_nms for module in mounted.values()])
        self._most = np.array([module.torque_max_nm for module in mounted.values()])
        self._fastest = np.array([module.speed_max_radps for module in mounted.values()])
        names = list(mounted)
        both = exo is not None and exo.drive == "assist" and {"hip_l", "hip_r"} <= set(names)
        self._hips = [names.index("hip_l"), names.index("hip_r")] if both else []
        self._apart = deque([0.0] * round(_QUARTER_STRIDE_S / PERIOD_S), maxlen=round(_QUARTER_STRIDE_S / PERIOD_S))
        self._coming = np.zeros(model.nv)

    def torques(self, data: mujoco.MjData) -> Array:
        """(nv,) N m of the motors until the next call, `PERIOD_S` later: what the call before has asked for."""
        acting, self._coming = self._coming, np.zeros(len(self._coming))
        speed = data.qvel[self._dof]
        torque = _COMPENSATED * (self._friction * np.tanh(speed / FRICTION_SPEED_RADPS) + self._viscous * speed)
        if self._hips:
            left, right = data.qpos[self._angle[self._hips]]
            last = self._apart[-1]
            help_nm = -_ASSIST_NM * self._apart[0]
            self._apart.append(last + (math.sin(right) - math.sin(left) - last) * PERIOD_S / _SMOOTHING_S)
            torque[self._hips] += [-help_nm, help_nm]
        torque[np.abs(speed) > self._fastest] = 0.0
        self._coming[self._dof] = np.clip(torque, -self._most, self._most)
        return acting
