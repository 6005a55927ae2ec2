"""What a scenario may choose by name, without the code behind the names, so that a listing needs no simulator."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

PHYSICS = ("kinematic", "dynamic")
# kind of part and default part of each group of sensors
_GROUPS = {
    "foot_imu": ("imu", "ADIS16485"),
    "foot_camera": ("camera", "acA800-200gc"),
    "sonar": ("sonar", "SRF08"),
    "insole": ("force_cell", "FlexiForce-A401"),
    "ahrs": ("ahrs", "MW-AHRSv1"),
    "exo_imu": ("imu", "MW-AHRSv1-imu"),
    "encoder": ("encoder", "AMT203"),
    "interaction": ("force_cell", "FlexiForce-A301"),
    "actuator": ("actuator", "actuation-module"),
    "head_imu": ("imu", "BMI055"),
    "head_camera": ("rgbd", "D455"),
    "body_imu": ("imu", "MPU-9250-wearable"),
}
KIND = {group: kind for group, (kind, _) in _GROUPS.items()}
"""The kind of part that each group uses."""
STANDARD = {group: name for group, (_, name) in _GROUPS.items()}
"""The default part of each group; the back's AHRS is `STANDARD_BACK_AHRS`."""
DEFAULT_SENSORS = tuple(group for group in KIND if group not in ("exo_imu", "body_imu"))
"""The groups that are on unless a scenario says otherwise."""
_SIDED_PLACES = ("upper_arm", "wrist", "hand", "thigh", "shank", "instep", "heel", "ankle")
BODY_PLACES = ("pelvis", "chest", "head", *(f"{place}_{side}" for place in _SIDED_PLACES for side in "lr"))
"""Places of the group `body_imu`; `wearer.imu_places` knows where they are."""
FAULT_NAMES = (
    "dropout",
    "freeze",
    "repeat",
    "interpolated",
    "nan",
    "late",
    "out_of_order",
    "clock_jump",
    "exchange",
    "saturation",
    "offset",
    "dead_cell",
    "restart",
    "occlusion",
    "lens_dirt",
    "passer_by",
    "darkness",
    "depth_noise",
    "high_view",
    "mirror_floor",
    "loose_strap",
    "miscalibration",
)
"""Names of the kinds of faults; `faults.catalogue` has their classes."""


def part_files() -> dict[str, Path]:
    """Name to file of the parts that come with the project, sorted by name."""
    folder = Path(str(resources.files("stridetwin.sim.parts")))
    return {p.stem: p for p in sorted(folder.glob("*.yaml"), key=lambda p: p.stem.lower())}
