"""Transforms between named frames, each from a frame to its parent, as /tf_static and calibration files give them."""

from __future__ import annotations

import numpy as np

from stridetwin.streams.samples import Array


class TransformTree:
    """Poses of frames in their parents, which combine to the pose of any frame in another one."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Array]] = {}  # by frame: its parent and T_parent_frame (4, 4), m

    def add(self, parent: str, frame: str, T_parent_frame: Array) -> None:
        """Adds the pose (4, 4), m, of a frame in its parent; a second pose of a frame replaces the first."""
        self._parents[frame.strip("/")] = (parent.strip("/"), T_parent_frame)

    def find_transform(self, target: str, source: str) -> Array | None:
        """T_target_source (4, 4), m; None if the frames are not connected, or one is unnamed."""
        target_chain, source_chain = (self._transform_to_root(frame.strip("/")) for frame in (target, source))
        if target_chain is None or source_chain is None or not target or not source:
            return None
        (target_root, T_root_target), (source_root, T_root_source) = target_chain, source_chain
        if target_root != source_root:
            return None
        R_target_root = T_root_target[:3, :3].T
        T = np.eye(4)  # T_root_target⁻¹ T_root_source
        T[:3, :3] = R_target_root @ T_root_source[:3, :3]
        T[:3, 3] = R_target_root @ (T_root_source[:3, 3] - T_root_target[:3, 3])
        return T

    def _transform_to_root(self, frame: str) -> tuple[str, Array] | None:
        """The root of the tree above a frame, and T_root_frame; None if the transforms form a loop.

        A frame that no transform leads up from is its own root.
        """
        T, visited = np.eye(4), {frame}
        while frame in self._parents:
            frame, T_parent_frame = self._parents[frame]
            T = T_parent_frame @ T
            if frame in visited:
                return None
            visited.add(frame)
        return frame, T
