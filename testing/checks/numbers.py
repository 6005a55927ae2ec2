"""Numbers of the estimates: finite, and covariances, standard deviations and probabilities that can be such."""

from __future__ import annotations

import numpy as np

from stridetwin.streams.samples import Array
from stridetwin.testing.leaves import Leaf
from stridetwin.testing.subject import ConformanceError, Subject

_SYMMETRY = 1e-6  # tolerance of a covariance's symmetry, relative to its largest entry
_EIGENVALUE = 1e-9  # tolerance of a correlation's least eigenvalue, per row of the matrix
_SUM = 1e-6  # tolerance of a probability above 1, and of a sum of probabilities


def check_finite(subject: Subject) -> None:
    """No estimate on the walk has a NaN or an infinite number."""
    for returned in subject.reference:
        for leaf in returned.leaves:
            # the numbers of an uncertainty are left to `check_covariance`
            if not _describes_uncertainty(leaf) and not leaf.is_finite:
                raise ConformanceError(
                    f"{leaf.path or 'the estimate'} at {returned.t_ns * 1e-9:.3f} s is not finite: return None until "
                    "the value is known"
                )


def check_covariance(subject: Subject) -> None:
    """Covariances are positive semidefinite, standard deviations positive; probabilities sum to 1.

    Raises:
        ConformanceError: One of them cannot be such a number; the message says where and why.
    """
    for returned in subject.reference:
        for leaf in returned.leaves:
            if _describes_uncertainty(leaf) and (problem := _find_problem(leaf)):
                raise ConformanceError(f"{leaf.path} at {returned.t_ns * 1e-9:.3f} s {problem}")


def _describes_uncertainty(leaf: Leaf) -> bool:
    """Whether a value is a covariance, a standard deviation or a probability."""
    return leaf.is_covariance or leaf.is_standard_deviation or leaf.name in ("probability", "probabilities")


def _find_problem(leaf: Leaf) -> str:
    """Why a covariance, standard deviation or probability cannot be one, in words; "" if it can."""
    if leaf.value is None or isinstance(leaf.value, str):
        return ""
    value = np.asarray(leaf.value, float)
    if leaf.may_be_unknown and not np.isfinite(value).all():
        return ""
    if not leaf.is_finite:
        return "is not finite: return None for what is unknown, or inf for a standard deviation"
    if leaf.is_covariance:
        return _find_covariance_problem(value)
    if leaf.is_standard_deviation:  # what follows is about a probability
        return "" if (value > 0.0).all() else f"is {value.min():.3g}: a standard deviation is positive"
    if value.size and (value.min() < 0.0 or value.max() > 1.0 + _SUM):
        return f"is outside 0 to 1: {value.min():.6g} to {value.max():.6g}"
    if leaf.name == "probabilities" and value.ndim == 1 and value.size and abs(value.sum() - 1.0) > _SUM:
        return f"sums to {value.sum():.6g}: probabilities sum to 1"
    return ""


def _find_covariance_problem(matrix: Array) -> str:
    """Why a matrix cannot be a covariance, in words; "" if it is symmetric and has no negative eigenvalue.

    Args:
        matrix: (N, N).
    """
    largest = np.abs(matrix).max(initial=0.0)
    if np.abs(matrix - matrix.T).max(initial=0.0) > _SYMMETRY * largest:
        return "is not symmetric: average it with its transpose after each update"
    deviations = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    # the eigenvalues are those of the correlation, which has no units, since metres may stand beside radians; a
    # variance of 0 or less stays as it is
    units = np.where(deviations > 0.0, deviations, 1.0)
    least = np.linalg.eigvalsh(0.5 * (matrix + matrix.T) / np.outer(units, units)).min(initial=0.0)
    if (np.diag(matrix) < 0.0).any() or least < -_EIGENVALUE * len(matrix):
        return (
            f"has a negative eigenvalue (of the correlation: {least:.3g}): use the Joseph form, or bound it from below"
        )
    return ""
