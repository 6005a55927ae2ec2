"""A campaign of a few steps each, in a folder of its own."""

from pathlib import Path

SHORT = """
description: a few steps
terrain:
  - level: {length_m: 2}
gait: {stand_s: 0.5}
sensors: [foot_imu, insole]
"""
SMALL = """
campaign: A few steps of three people
walks: 3
seed: 3
scenarios:
  - scenario: short.yaml
    set:
      terrain[0].level.length_m: {uniform: [1.5, 2], step: 0.5}
people:
  - count: 3
    sex: female
    height_m: {uniform: [1.55, 1.8]}
    bmi: {normal: [24, 3], within: [19, 30]}
set:
  gait.speed_mps: {uniform: [0.9, 1.2]}
  sensors.foot_imu.part: MPU-9250
"""


def write(folder: Path, campaign: str = SMALL, short: str = SHORT) -> Path:
    """The campaign's file, and its scenario's beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "short.yaml").write_text(short)
    path = folder / "small.yaml"
    path.write_text(campaign)
    return path
