"""What drives the actuation modules: a law from joint angles to torques, and drivers that carry their rotors.

`assist` helps both hips by delayed output feedback (after Lim et al. 2019, IEEE Trans. Robotics 35:1055): how far the
legs were apart a quarter of a stride ago tells how fast they pass each other now, a hundred times a second.

Beneath the law each module's driver moves most of its own rotor, which the wearer's legs would else swing along on
their straps: acceleration feedback from the motor's encoder in the driver's own loop (after Aguirre-Ollinger et al.
2012, IEEE Trans. Neural Syst. Rehabil. Eng. 20:68), a transparent mode in the words of Shim et al. 2019. Friction is
left alone: it damps the frame on its straps.
"""

from __future__ import annotations

import math
from collections import deque

import mujoco
import numpy as np

from stridetwin.sim.actuation import modules
from stridetwin.sim.config import SIDES, Exo
from stridetwin.streams.samples import Array

PERIOD_S, DRIVER_S = 0.01, 0.001
_ASSIST_NM = 8.0  # for legs one radian apart
_QUARTER_STRIDE_S = 0.25
_SMOOTHING_S = 0.05
_CARRIED = 0.8  # share of the rotor; with 1.4 of it frame and straps begin to swing by themselves
_ACCELERATION_S = 0.005  # over which the driver smooths what its encoder tells


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
        hinges = [model.joint("exo_{}_flexion_{}".format(*joint.split("_"))) for joint in mounted]
        self._angle = np.array([hinge.qposadr[0] for hinge in hinges], dtype=int)
        self._dof = np.array([hinge.dofadr[0] for hinge in hinges], dtype=int)
        self._hips = [list(mounted).index(f"hip_{side}") for side in SIDES] if mounted else []
        self._most = np.array([module.torque_max_nm for module in mounted.values()])
        self._fastest = np.array([module.speed_max_radps for module in mounted.values()])
        self._carried = _CARRIED * np.array([module.reflected_inertia for module in mounted.values()])
        self._apart = deque([0.0] * round(_QUARTER_STRIDE_S / PERIOD_S), maxlen=round(_QUARTER_STRIDE_S / PERIOD_S))
        self._help, self._coming = np.zeros(len(mounted)), np.zeros(len(mounted))
        self._speed, self._acceleration = np.zeros(len(mounted)), np.zeros(len(mounted))
        self._calls, self._nv = 0, model.nv

    def torques(self, data: mujoco.MjData) -> Array:
        """(nv,) N m of the motors until the next call, `DRIVER_S` later."""
        given = np.zeros(self._nv)
        if len(self._dof):
            if self._calls % round(PERIOD_S / DRIVER_S) == 0:
                self._ask(data.qpos[self._angle])
            speed = data.qvel[self._dof]
            if self._calls:
                told = (speed - self._speed) / DRIVER_S
                self._acceleration += (told - self._acceleration) * DRIVER_S / (_ACCELERATION_S + DRIVER_S)
            self._speed = speed
            self._calls += 1
            torque = self._help + self._carried * self._acceleration
            torque[(np.abs(speed) > self._fastest) & (torque * speed > 0.0)] = 0.0  # there they can only brake
            given[self._dof] = np.clip(torque, -self._most, self._most)
        return given

    def _ask(self, angle: Array) -> None:
        """The law, once a `PERIOD_S`: the motors give what the call before has asked for."""
        self._help, self._coming = self._coming, np.zeros(len(angle))
        left, right = angle[self._hips]
        last = self._apart[-1]
        help_nm = -_ASSIST_NM * self._apart[0]
        self._apart.append(last + (math.sin(right) - math.sin(left) - last) * PERIOD_S / _SMOOTHING_S)
        self._coming[self._hips] = -help_nm, help_nm
