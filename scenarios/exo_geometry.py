"""The geometry of the simulated exoskeleton, as the contact terrain estimator receives it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from fnmatch import fnmatchcase

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.contact_terrain import geometry
from stridetwin.sim.faults.faults import Fault
from stridetwin.sim.faults.sample_faults import Miscalibration
from stridetwin.sim.wearer.dimensions import Wearer
from stridetwin.sim.wearer.exoskeleton import DH_SIGNS, R_DH_BODY, RANGE_RAD, ExoLinks, dh_table
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import Rig

LINK_SD_M, MOUNT_SD_RAD = 0.002, math.radians(0.3)
"""Accuracy of the segment lengths and of the AHRS mounts after a laboratory calibration of a stationary wearer."""
_MEASUREMENT = 4  # key of the random numbers of the measurement, beside the walk's seed
_THIGH, _KNEE, _FOOT = 5, 6, 8  # numbers of frames in the D-H table
_SENSORS = {"ahrs", "encoder", "insole"}


def true_geometry(size: Wearer, rig: Rig) -> geometry.Exoskeleton:
    """True geometry of the exoskeleton on a wearer, in the form that `contact_terrain` reads.

    Args:
        size: The wearer with the links of the exoskeleton.
        rig: Mounts of AHRS and insoles.

    Raises:
        StrideTwinError: There is no exoskeleton with a D-H table.
    """
    links = size.exo
    if not isinstance(links, ExoLinks):
        raise StrideTwinError("the wearer has no exoskeleton, or one of the user's own, without a D-H table")

    def mount(topic: str, frame: int) -> geometry.Attitude:
        """The mount of the AHRS of a topic in the frame of the D-H table that carries it."""
        return geometry.Attitude(
            topic=topic, frame=frame, R_frame_sensor=R_DH_BODY[frame] @ rig.others[topic].mount.T_body_sensor[:3, :3]
        )

    # (4, 4) pose of the sole in the D-H frame of the foot; the body's axes are rotated into those of the D-H frame
    T_foot_sole = np.eye(4)
    T_foot_sole[:3, :3] = R_DH_BODY[_FOOT]
    T_foot_sole[:3, 3] = R_DH_BODY[_FOOT] @ [links.ankle1 - size.ankle_x, 0.0, -size.body.ankle_height_m]
    legs = {
        side: geometry.Leg(
            rows=tuple(
                geometry.DhRow(
                    alpha=row.alpha,
                    a=row.a,
                    d=row.d,
                    theta=row.theta,
                    turns=row.joint is not None,
                    stops=_stops(side, row.joint),
                )
                for row in dh_table(links, side)
            ),
            thigh=mount(f"/exo/thigh_{side}/ahrs", _THIGH),
            knee=geometry.Knee(topic=f"/exo/knee_{side}/encoder", frame=_KNEE, sign=1.0),
            foot=mount(f"/exo/foot_{side}/ahrs", _FOOT),
            sole=geometry.Sole(
                topic=f"/foot_{side}/insole",
                T_foot_sole=T_foot_sole,
                cells=np.array(rig.others[f"/foot_{side}/insole"].parameters["cells_m"]),
                heel_x=size.shoe.heel_back_x,
                hinge_x=size.shoe.toe_hinge_x,
                hinge_z=size.shoe.toe_hinge_z,
                tip_x=size.shoe.toe_tip_x,
            ),
        )
        for side in geometry.SIDES
    }
    return geometry.Exoskeleton(
        description="Exoskeleton of Shim et al. 2019, set to its wearer",
        back=mount("/exo/back/ahrs", 0),
        legs=legs,
        compliance=geometry.Compliance(),
    )


def _stops(side: str, joint: int | None) -> tuple[float, float]:
    """Range of a joint in the sign of the D-H table, rad; unlimited for a frame without a joint."""
    if joint is None:
        return -math.inf, math.inf
    # a negative sign exchanges the ends of the range
    low, high = sorted((DH_SIGNS[side][joint] * RANGE_RAD[joint]).tolist())
    return low, high


def geometry_metadata(size: Wearer, rig: Rig, seed: int, faults: Iterable[Fault] = ()) -> dict[str, str]:
    """The geometry of the exoskeleton that an estimator gets, as text under its key of a recording's metadata.

    It is empty without the exoskeleton, or without one of the kinds of sensors that the estimator needs (`_SENSORS`).

    Args:
        size: The wearer.
        rig: Calibration of the sensors.
        seed: Seed of the walk.
        faults: Faults of the walk.
    """
    if not ({sensor.kind for sensor in rig.others.values()} >= _SENSORS and isinstance(size.exo, ExoLinks)):
        return {}
    return {geometry.METADATA_KEY: geometry.to_text(nominal_geometry(size, rig, seed, faults))}


def nominal_geometry(size: Wearer, rig: Rig, seed: int, faults: Iterable[Fault] = ()) -> geometry.Exoskeleton:
    """Geometry of the exoskeleton that an estimator gets: measured with errors that the walk's seed determines.

    The true geometry is known to the simulation alone.

    Args:
        size: The wearer.
        rig: Nominal calibration; errors of the AHRS mounts pass on to the geometry.
        seed: Of the walk.
        faults: Those of the walk; errors of links among them apply.
    """
    exo = simulate_measurement(true_geometry(size, rig), np.random.default_rng([seed, _MEASUREMENT]))
    # a miscalibration of a knee's encoder also falsifies the lengths of that leg's thigh and shank
    legs = dict(exo.legs)
    for fault in faults:
        for side, leg in legs.items():
            if isinstance(fault, Miscalibration) and fnmatchcase(leg.knee.topic, fault.topic):
                rows = list(leg.rows)
                # row i is that of frame i + 1, at the far end of the segment
                for i, error_m in ((_THIGH, fault.thigh_m), (_KNEE, fault.shank_m)):
                    rows[i] = replace(rows[i], a=rows[i].a + error_m)
                legs[side] = replace(leg, rows=tuple(rows))
    return replace(exo, legs=legs)


def exo_from_recording(recording: Recording) -> geometry.Exoskeleton:
    """Nominal geometry of the exoskeleton from a recording's metadata.

    Raises:
        StrideTwinError: The metadata has none.
    """
    if geometry.METADATA_KEY not in recording.metadata:
        raise StrideTwinError(f"{recording.path}: no exoskeleton geometry; pass --exoskeleton FILE")
    return geometry.parse_exoskeleton(
        recording.metadata[geometry.METADATA_KEY], f"{recording.path}: {geometry.METADATA_KEY}"
    )


def simulate_measurement(exo: geometry.Exoskeleton, rng: np.random.Generator) -> geometry.Exoskeleton:
    """The exoskeleton as a laboratory measures it.

    Errors of segment lengths have the standard deviation `LINK_SD_M`, those of AHRS mounts `MOUNT_SD_RAD`.
    """

    def rotate(attitude: geometry.Attitude) -> geometry.Attitude:
        """The mount of an AHRS with a small random rotation in the frame that carries it."""
        error = Rotation.from_rotvec(MOUNT_SD_RAD * rng.standard_normal(3)).as_matrix()
        return replace(attitude, R_frame_sensor=error @ attitude.R_frame_sensor)

    def change_lengths(leg: geometry.Leg) -> geometry.Leg:
        """The leg with measurement errors of its thigh, its shank and both mounts."""
        rows = list(leg.rows)
        for i in (_THIGH, _KNEE):  # row i is that of frame i + 1, at the far end of the segment
            rows[i] = replace(rows[i], a=rows[i].a + LINK_SD_M * rng.standard_normal())
        return replace(leg, rows=tuple(rows), thigh=rotate(leg.thigh), foot=rotate(leg.foot))

    return replace(exo, back=rotate(exo.back), legs={side: change_lengths(leg) for side, leg in exo.legs.items()})
