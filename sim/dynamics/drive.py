"""Drive of the actuation modules: a control law from joint angles to torques, and drivers that compensate their rotors.

`assist` helps both hips by delayed output feedback (after Lim et al. 2019, IEEE Trans. Robotics 35:1055): the angle
between the legs a quarter of a stride ago predicts how fast they pass each other now, a hundred times per second.

Below the control law, each module's driver compensates most of its own rotor's inertia; otherwise the wearer's legs
would have to swing the rotors through the cuffs. The driver uses acceleration feedback from the motor's encoder in its
own loop (after Aguirre-Ollinger et al. 2012, IEEE Trans. Neural Syst. Rehabil. Eng. 20:68), which Shim et al. 2019
call a transparent mode. With `assist`, friction is not compensated: it damps the frame on its cuffs. With an external
control law, friction is compensated, too, as the gear's model predicts it from the speed, and both up to a twentieth.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from stridetwin.sim.config import SIDES, Exo
from stridetwin.sim.wearer.exoskeleton import FRICTION_SPEED_RADPS, modules
from stridetwin.streams.samples import Array

PERIOD_S, DRIVER_S = 0.01, 0.001  # between two calls of the control law, and of the motors' drivers
_ASSIST_NM = 8.0  # torque per unit of sin q_r − sin q_l: for legs about one radian apart
_QUARTER_STRIDE_S = 0.25
_SMOOTHING_S = 0.05  # time constant of the filter of that difference
_ROTOR, _FRICTION = 0.8, 0.0  # compensated shares; at 1.4 times the rotors' inertia, frame and cuffs begin to oscillate
_ROTOR_EXTERNAL, _FRICTION_EXTERNAL = 0.95, 0.95  # likewise, with an external control law
_ACCELERATION_S = 0.005  # smoothing time of the driver's encoder signal


ControlLaw = Callable[[Array], Array]
"""Maps the angles (n,) rad of the powered joints to the torques (n,) N m that their motors should apply, once per
`PERIOD_S`; both in the order of `modules`."""


class DelayedFeedback:
    """Assistance of both hips in proportion to the angle between the legs a quarter of a stride ago.

    The torque on the left hip is 8 N m (sin q_r − sin q_l), smoothed and delayed by `_QUARTER_STRIDE_S`, where q_l and
    q_r are the flexion angles of the hips; the right hip gets the opposite.

    Args:
        joints: The powered joints; both hips are among them.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        """Starts with legs that have stood side by side for a quarter of a stride."""
        self._hips = [joints.index(f"hip_{side}") for side in SIDES]  # rows of left and right hip among the joints
        # smoothed sin q_r − sin q_l of the last quarter of a stride, the oldest first
        self._apart = deque([0.0] * round(_QUARTER_STRIDE_S / PERIOD_S), maxlen=round(_QUARTER_STRIDE_S / PERIOD_S))

    def __call__(self, angle: Array) -> Array:
        """(n,) N m, torques of the motors for (n,) rad, angles of the powered joints; call it once per `PERIOD_S`."""
        left, right = angle[self._hips]
        last = self._apart[-1]  # first-order smoothing goes on from here
        right_nm = -_ASSIST_NM * self._apart[0]  # the oldest entry is a quarter of a stride old
        self._apart.append(last + (math.sin(right) - math.sin(left) - last) * PERIOD_S / _SMOOTHING_S)
        torque = np.zeros(len(angle))
        torque[self._hips] = -right_nm, right_nm
        return torque


class Drive:
    """Motors of an exoskeleton; they apply the torque that the control law demanded one `PERIOD_S` ago.

    Args:
        model: Model of the wearer with the exoskeleton.
        exo: The exoskeleton with its modules and its drive; None without one.
        law: Control law in place of the drive of `exo`; the drivers then compensate friction, too.

    Raises:
        ConfigError: Unknown mode, joints that the mode does not power, or assistance of hips that have no modules.
    """

    def __init__(self, model: mujoco.MjModel, exo: Exo | None, law: ControlLaw | None = None) -> None:
        """Reads the modules' joints and limits; without a drive, all arrays are empty and no torque is applied."""
        # modules by powered joint, such as `hip_l`, whose hinge in the model is `exo_hip_flexion_l`
        mounted = {} if exo is None or (exo.drive == "idle" and law is None) else modules(exo)
        hinges = [model.joint("exo_{}_flexion_{}".format(*joint.split("_"))) for joint in mounted]
        # addresses of the hinges in qpos and in qvel
        self._angle = np.array([hinge.qposadr[0] for hinge in hinges], dtype=int)
        self._dof = np.array([hinge.dofadr[0] for hinge in hinges], dtype=int)
        self._law = DelayedFeedback(list(mounted)) if mounted and law is None else law
        self._max_torque = np.array([module.torque_max_nm for module in mounted.values()])
        self._max_speed = np.array([module.speed_max_radps for module in mounted.values()])
        # shares that the drivers compensate, then the compensated inertia, dry and viscous friction of each joint
        rotor, friction = (_ROTOR, _FRICTION) if law is None else (_ROTOR_EXTERNAL, _FRICTION_EXTERNAL)
        self._compensated = rotor * np.array([module.reflected_inertia for module in mounted.values()])
        self._dry = friction * np.array([module.friction_nm for module in mounted.values()])
        self._viscous = friction * np.array([module.viscous_nms for module in mounted.values()])
        # torques of the law: those that are applied now, and those demanded for the next period
        self._help, self._next_help = np.zeros(len(mounted)), np.zeros(len(mounted))
        # the drivers' encoder: speed at the last call, and smoothed acceleration
        self._speed, self._acceleration = np.zeros(len(mounted)), np.zeros(len(mounted))
        self._calls, self._nv = 0, model.nv

    def torques(self, data: mujoco.MjData) -> Array:
        """(nv,) N m, torques of the motors until the next call, which is due `DRIVER_S` later.

        A motor applies the law's torque and compensates shares of its rotor's inertia and of its friction, within its
        largest torque. At its highest speed it only brakes. The law is evaluated once per `PERIOD_S`, and its torques
        are applied one period later. Calls are counted, and speed and acceleration are kept for the next call.
        """
        torques = np.zeros(self._nv)
        if self._law is not None and len(self._dof):
            if self._calls % round(PERIOD_S / DRIVER_S) == 0:
                self._help = self._next_help  # demanded one period ago
                self._next_help = self._law(data.qpos[self._angle])
            speed = data.qvel[self._dof]
            if self._calls:  # the first call has no speed before it
                measured = (speed - self._speed) / DRIVER_S
                self._acceleration += (measured - self._acceleration) * DRIVER_S / (_ACCELERATION_S + DRIVER_S)
            self._speed = speed
            self._calls += 1
            friction = self._dry * np.tanh(speed / FRICTION_SPEED_RADPS) + self._viscous * speed
            torque = self._help + self._compensated * self._acceleration + friction
            too_fast = (np.abs(speed) > self._max_speed) & (torque * speed > 0.0)
            torque[too_fast] = 0.0  # beyond its highest speed a motor can only brake
            torques[self._dof] = np.clip(torque, -self._max_torque, self._max_torque)
        return torques
