"""A sensor at the limit of its range is known by its flat tops, whatever the range is."""

import numpy as np
import pytest

from gcs_sysid.signals.saturation import Saturation

STEP = 1e-3
T = 0.004 * np.arange(20_000)


def found(samples, block=97):
    saturation = Saturation()
    rounded = STEP * np.round(samples / STEP)
    for start in range(0, len(rounded), block):
        saturation.update(rounded[start : start + block])
    return saturation.found()


def motion(seed):
    """(n, 6) gyro and accelerometer of a sine in roll, gusts elsewhere, 1 g."""
    rng = np.random.default_rng(seed)
    out = rng.normal(0.0, [0.05] * 3 + [0.5] * 3, (len(T), 6))
    out[:, 0] = 5.0 * np.sin(3.0 * T)
    out[:, 5] -= 9.81
    return out


@pytest.mark.parametrize("seed", range(5))
def test_tails_and_the_peaks_of_a_sine_are_no_limit(seed):
    samples = motion(seed)
    assert found(samples) == ()
    assert found(samples.repeat(5, axis=0)) == ()  # held readings


@pytest.mark.parametrize(
    ("axis", "limit", "sensor"), [(0, 4.0, "gyro"), (5, 12.5, "accelerometer")]
)
def test_flat_tops_are_found_with_their_share(axis, limit, sensor):
    samples = motion(1)
    samples[:, 5] *= 1.15
    beyond = np.abs(samples[:, axis]) > limit
    samples[:, axis] = np.clip(samples[:, axis], -limit, limit)
    (one,) = found(samples)
    assert (one.sensor, one.limit) == (sensor, pytest.approx(limit))
    assert one.share == pytest.approx(beyond.mean(), rel=0.05)


def test_blocks_of_any_size_count_the_same():
    samples = np.clip(motion(2), -4.0, 4.0)
    assert found(samples, 7) == found(samples, 5000)
