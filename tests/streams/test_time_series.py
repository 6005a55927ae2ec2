"""Sums and values between the samples of a stream."""

import numpy as np

from stridetwin.streams.time_series import accumulate, interpolate


def test_means_add_up_to_the_integral():
    t = np.array([0.0, 0.5, 0.6, 2.0])
    integral = np.column_stack((t**2, 3 * t))
    means = np.diff(integral, axis=0) / np.diff(t)[:, None]
    np.testing.assert_allclose(accumulate(np.diff(t), means), integral, atol=1e-12)


def test_values_lie_on_the_line_between_two_samples_at_times_of_any_shape():
    t = np.array([0.0, 1.0, 3.0])
    values = np.column_stack((2 * t, -t))
    at = np.array([[0.25, 2.0], [-1.0, 9.0]])
    inside = np.clip(at, 0.0, 3.0)  # constant beyond the ends
    np.testing.assert_allclose(interpolate(at, t, values), np.stack((2 * inside, -inside), axis=-1))
