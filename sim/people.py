"""The person who walks, and the walkers of the papers by name.

A field with `MILLIMETRES` is in mm in scenario files, and so are its limits; its value here is in m.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from stridetwin.streams.fields import DEGREES, MILLIMETRES, Number, OneOf


@dataclass(frozen=True, kw_only=True)
class Segments:
    """A person's segments where they are known; lengths that are None follow from height and sex.

    Attributes:
        thigh_m: Hip centre to knee centre.
        shank_m: Knee centre to ankle centre.
        ankle_height_m: Ankle centre above the sole of the shoe.
        hip_width_m: Distance of the hip centres.
        trunk_m: Hip centres to the top of the head.
        shoulder_width_m: Distance of the shoulder centres.
        upper_arm_m: Shoulder centre to elbow centre.
        forearm_m: Elbow centre to wrist centre.
        shank_twist_rad: Turn of the foot outward against the knee, about the shank's long axis; None for 0.
    """

    thigh_m: Annotated[Number | None, Field(ge=280, le=560, alias="thigh_mm"), MILLIMETRES] = None
    shank_m: Annotated[Number | None, Field(ge=280, le=560, alias="shank_mm"), MILLIMETRES] = None
    ankle_height_m: Annotated[Number | None, Field(ge=60, le=150, alias="ankle_height_mm"), MILLIMETRES] = None
    hip_width_m: Annotated[Number | None, Field(ge=110, le=240, alias="hip_width_mm"), MILLIMETRES] = None
    trunk_m: Annotated[Number | None, Field(ge=600, le=1050, alias="trunk_mm"), MILLIMETRES] = None
    shoulder_width_m: Annotated[Number | None, Field(ge=240, le=500, alias="shoulder_width_mm"), MILLIMETRES] = None
    upper_arm_m: Annotated[Number | None, Field(ge=200, le=400, alias="upper_arm_mm"), MILLIMETRES] = None
    forearm_m: Annotated[Number | None, Field(ge=180, le=360, alias="forearm_mm"), MILLIMETRES] = None
    shank_twist_rad: Annotated[Number | None, Field(ge=-30, le=50, alias="shank_twist_deg"), DEGREES] = None


@dataclass(frozen=True, kw_only=True)
class Person:
    """The person who walks.

    Attributes:
        height_m: Standing height without shoes.
        mass_kg: Body mass.
        sex: `male` or `female` (de Leva's tables).
        shoe_m: Shoe size as the length of the foot that it fits (260 mm and the like); None derives it from the height.
        segments: Segments that differ from those of the tables; None for a person of the tables.
    """

    height_m: Annotated[Number, Field(ge=1.5, le=1.95)] = 1.75
    mass_kg: Annotated[Number, Field(ge=45, le=110)] = 75.0
    sex: Annotated[str, OneOf(("male", "female"))] = "male"
    shoe_m: Annotated[Number | None, Field(ge=200, le=320, alias="shoe_mm"), MILLIMETRES] = None
    segments: Segments | None = None


# Shim et al. 2019, table 3: sex, stature m, mass kg, shoe mm
_SHIM = (
    ("male", 1.70, 68, 260), ("male", 1.68, 74, 260), ("male", 1.76, 67, 265), ("male", 1.80, 74, 270),
    ("male", 1.76, 88, 275), ("female", 1.61, 60, 240), ("female", 1.65, 70, 250),
)  # fmt: skip
# Zhao et al. 2023, IV-A: statures alone, cm. Mass is set by a body mass index of 22.5 kg/m²; the sex is taken as male
_ZHAO_CM = {
    "i": (165.10, 165.50, 164.80),
    "ii": (170.80, 172.00, 171.10),
    "iii": (175.80, 175.20, 174.10),
    "iv": (181.50, 180.80, 183.10),
    "v": (188.00, 186.90, 188.20),
}
_ZHAO_BMI = 22.5  # kg/m²

PEOPLE: dict[str, Person] = {
    f"shim_s{i}": Person(sex=sex, height_m=height, mass_kg=float(mass), shoe_m=shoe * 1e-3)
    for i, (sex, height, mass, shoe) in enumerate(_SHIM, start=1)
} | {
    f"zhao_{group}_{i}": Person(height_m=cm * 1e-2, mass_kg=round(_ZHAO_BMI * (cm * 1e-2) ** 2, 1))
    for group, heights in _ZHAO_CM.items()
    for i, cm in enumerate(heights, start=1)
}
"""Subjects S1-S7 of Shim et al. as `shim_s1` ... and the 15 of Zhao et al. as `zhao_i_1` ... `zhao_v_3`."""
