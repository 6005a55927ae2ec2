"""Actuation modules of the exoskeleton: motor and strain wave gear beside a hip or knee (Shim et al. 2019, 2.1.3).

Each is bolted to the link above its joint. An unpowered module still acts on the joint: its rotor turns with the
joint, and its gear has friction.
"""

from __future__ import annotations

from stridetwin.sim.config import SIDES, Exo
from stridetwin.sim.exo_description import Module
from stridetwin.streams.errors import ConfigError

JOINTS = tuple(f"{joint}_{side}" for joint in ("hip", "knee") for side in SIDES)
FRICTION_SPEED_RADPS = 0.2
"""Joint speed at which dry friction reaches three quarters of its full value."""


# Gears, motors (Kollmorgen TBMS-6025-B and -6013-B, Harmonic Drive SHD-20-2SH) and the 6.0 kg of all four are the
# paper's; it gives no figures of the parts. The rotors are estimated as steel rings of 18 by 31 mm, 5 mm longer than
# the stacks (25 and 13 mm): 1.9e-5 and 1.1e-5 kg m², plus 0.9e-5 for the wave generator. The friction is of the
# order at which gears of this size can be driven backwards; torque and speed (6500 rpm in) are typical of their class.
HIP = Module(
    gear=100, rotor_inertia=2.8e-5, friction_nm=4.0, viscous_nms=1.5, torque_max_nm=57, speed_max_radps=6.8,
    mass_kg=1.6,
)  # fmt: skip
KNEE = Module(
    gear=80, rotor_inertia=2.0e-5, friction_nm=3.5, viscous_nms=1.0, torque_max_nm=53, speed_max_radps=8.5,
    mass_kg=1.4,
)  # fmt: skip

_CHOICES: dict[int, tuple[tuple[str, ...], ...]] = {
    0: ((),),
    1: (JOINTS,),
    2: (("hip_l", "hip_r"), ("knee_l", "knee_r")),
    3: (("hip_l", "knee_l"), ("hip_r", "knee_r")),
    4: tuple((joint,) for joint in JOINTS),
}


def modules(exo: Exo) -> dict[str, Module]:
    """Modules by joint (`hip_l`, `knee_r`, ...) of an exoskeleton in its mode (figure 12 of the paper).

    Raises:
        ConfigError: Unknown mode, joints that the mode does not power, or assistance of hips that have no modules.
    """
    if exo.own is not None:
        if exo.drive == "assist" and not {"hip_l", "hip_r"} <= set(exo.own.modules):
            raise ConfigError("exo", "drive", exo.drive, f"idle, or motors.hip_l and .hip_r in {exo.own.rig}")
        return dict(exo.own.modules)
    if exo.mode not in _CHOICES:
        raise ConfigError("exo", "mode", exo.mode, ", ".join(map(str, _CHOICES)))
    choices = _CHOICES[exo.mode]
    chosen = exo.joints or (choices[0] if len(choices) == 1 else ())
    if set(chosen) not in map(set, choices) or len(set(chosen)) != len(chosen):
        valid = " or ".join(f"[{', '.join(choice)}]" for choice in choices)
        raise ConfigError("exo", "joints", list(exo.joints), f"{valid} in mode {exo.mode}")
    if exo.drive == "assist" and not {"hip_l", "hip_r"} <= set(chosen):
        raise ConfigError("exo", "drive", exo.drive, "idle, or a mode that powers both hips")
    return {joint: HIP if joint.startswith("hip") else KNEE for joint in chosen}
