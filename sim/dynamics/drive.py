"""What drives the actuation modules: a law from joint angles to motor torques, a hundred times a second.

`assist` helps both hips by delayed output feedback (after Lim et al. 2019, IEEE Trans. Robotics 35:1055): how far the
legs were apart a quarter of a stride ago tells how fast they pass each other now. It does not push against the modules'
friction: told the joint's speed a period late, that sets the rotors swinging on the straps, knees by 30° at 3 Hz.
"""

from __future__ import annotations

import math
from collections import deque

import mujoco
import numpy as np

from stridetwin.sim.actuation import modules
from stridetwin.sim.config import SIDES, Exo
from stridetwin.streams.samples import Array

PERIOD_S = 0.01
_ASSIST_NM = 8.0  # for legs one radian apart
_QUARTER_STRIDE_S = 0.25
_SMOOTHING_S = 0.05


class Drive:
    """Motors of an exoskeleton.

    Args:
        model: Model of the wearer with it.
        exo: Its modules, and the law that drives them.

    Raises:
        ConfigError: As `modules`.
    """

    def __init__(self, model: mujoco.MjModel, exo: Exo | None) -> None:
        mounted = {} if exo is None or exo.drive == "idle" else modules(exo)
        hips = [f"hip_{side}" for side in SIDES] if mounted else []
        hinges = [model.joint("exo_{}_flexion_{}".format(*hip.split("_"))) for hip in hips]
        self._angle = np.array([hinge.qposadr[0] for hinge in hinges], dtype=int)
        self._dof = np.array([hinge.dofadr[0] for hinge in hinges], dtype=int)
        self._most = np.array([mounted[hip].torque_max_nm for hip in hips])
        self._fastest = np.array([mounted[hip].speed_max_radps for hip in hips])
        self._apart = deque([0.0] * round(_QUARTER_STRIDE_S / PERIOD_S), maxlen=round(_QUARTER_STRIDE_S / PERIOD_S))
        self._coming = np.zeros(model.nv)

    def torques(self, data: mujoco.MjData) -> Array:
        """(nv,) N m of the motors until the next call, `PERIOD_S` later: what the call before has asked for."""
        acting, self._coming = self._coming, np.zeros(len(self._coming))
        if len(self._dof):
            left, right = data.qpos[self._angle]
            last = self._apart[-1]
            help_nm = -_ASSIST_NM * self._apart[0]
            self._apart.append(last + (math.sin(right) - math.sin(left) - last) * PERIOD_S / _SMOOTHING_S)
            torque = np.array([-help_nm, help_nm])
            torque[np.abs(data.qvel[self._dof]) > self._fastest] = 0.0
            self._coming[self._dof] = np.clip(torque, -self._most, self._most)
        return acting
