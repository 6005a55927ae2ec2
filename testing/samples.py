"""What the checks do to samples: shift, overwrite, compare."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from stridetwin.streams.samples import Array, Odometry, Sample

_OVERWRITTEN = 77
"""Value that a reused buffer holds: finite, so that an estimator that reads it is wrong rather than stopped."""


def overwrite(sample: Sample) -> None:
    """Fills the arrays of a sample with another value in place, as a driver does that reuses its buffers."""
    for _, array in _arrays(sample):
        array.fill(_OVERWRITTEN)


def find_changed_field(sample: Sample, original: Sample) -> str:
    """Name of the first array of a sample that differs from that of the original; "" if none does."""
    originals = dict(_arrays(original))
    for name, array in _arrays(sample):
        if array.shape != originals[name].shape or array.tobytes() != originals[name].tobytes():
            return name
    return ""


def shift_sample(sample: Sample, by_ns: int, translation: Array) -> Sample:
    """A sample measured later, by a walker who is elsewhere.

    Args:
        sample: The sample.
        by_ns: Added to its stamp.
        translation: (3,) m, added to the position of a pose.
    """
    if isinstance(sample, Odometry):
        return replace(sample, t_ns=sample.t_ns + by_ns, p_frame_in_world=sample.p_frame_in_world + translation)
    return replace(sample, t_ns=sample.t_ns + by_ns)


def _arrays(sample: Sample) -> list[tuple[str, np.ndarray]]:
    """Name and value of each array of a sample."""
    values = ((f.name, getattr(sample, f.name)) for f in fields(sample))
    return [(name, value) for name, value in values if isinstance(value, np.ndarray)]
