"""What one stream keeps, sample by sample."""

import numpy as np
import pytest

from gcs_sysid.signals.stream_buffer import StreamBuffer


def filled(width=2, n=20, dt=0.01):
    """A buffer with n samples of (k, -k)."""
    buffer = StreamBuffer(width)
    count = np.arange(float(n))
    buffer.extend(dt * count, np.column_stack([count, -count]))
    return buffer


@pytest.mark.parametrize(
    ("t", "first"),
    [
        ([0.20, 0.21, 0.22], 3),
        ([], 0),
        ([0.20, 0.20, 0.21], 3),  # the same stamp again changes nothing
        ([0.20, 0.22, 0.21], 2),
        ([0.18, 0.20], 0),  # before the newest of all
    ],
)
def test_the_first_sample_that_comes_late(t, first):
    assert filled().first_irregular(np.array(t), np.zeros((len(t), 2))) == first


def test_wider_samples_leave_those_before_in_place():
    buffer = filled()
    t = 0.20 + 0.01 * np.arange(10.0)
    buffer.extend(t, np.column_stack([np.full(10, 7.0), np.full(10, 8.0), np.full(10, 9.0)]))
    buffer.look()
    grid = np.array([0.145, 0.155, 0.25])
    values = buffer.at(grid, np.zeros(3, np.int64))
    np.testing.assert_allclose(values[:, 0], [14.5, 15.5, 7.0])
    np.testing.assert_allclose(values[:, 1], [-14.5, -15.5, 8.0])
    np.testing.assert_allclose(values[:, 2], [np.nan, np.nan, 9.0])


def test_narrower_samples_lack_their_last_values():
    buffer = filled(n=30)
    buffer.extend(0.30 + 0.01 * np.arange(10.0), np.full((10, 1), 5.0))
    buffer.look()
    values = buffer.at(np.array([0.25, 0.35]), np.zeros(2, np.int64))
    np.testing.assert_allclose(values, [[25.0, -25.0], [5.0, np.nan]])
