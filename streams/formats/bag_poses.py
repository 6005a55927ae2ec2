"""Poses of motion capture in a bag: PoseStamped, PoseWithCovarianceStamped, TransformStamped."""

from __future__ import annotations

from typing import Any

POSES = frozenset(
    f"geometry_msgs/msg/{name}" for name in ("PoseStamped", "PoseWithCovarianceStamped", "TransformStamped")
)


def pose_of(message: Any) -> tuple[int, tuple[float, ...], tuple[float, ...]]:
    """Stamp (ns), position (m) and quaternion (w, x, y, z) of one message."""
    if hasattr(message, "transform"):
        p, q = message.transform.translation, message.transform.rotation
    else:
        pose = getattr(message.pose, "pose", message.pose)
        p, q = pose.position, pose.orientation
    stamp = message.header.stamp
    return stamp.sec * 1_000_000_000 + stamp.nanosec, (p.x, p.y, p.z), (q.w, q.x, q.y, q.z)
