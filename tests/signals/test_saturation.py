"""A sensor at the limit of its range is known by its flat tops, whatever the range is."""

import numpy as np
import pytest

from gcs_sysid.signals.imu_checks import Saturation

STEP = 1e-3
T = 0.004 * np.arange(20_000)


def found(samples, block=97):
    saturation = Saturation()
    rounded = STEP * np.round(samples / STEP)
    t = 0.004 * np.arange(len(samples))
    for start in range(0, len(rounded), block):
        saturation.update(t[start : start + block], rounded[start : start + block])
    return saturation.found()


def motion(seed):
    """(n, 6) gyro and accelerometer of a sine in roll, gusts elsewhere, 1 g."""
    rng = np.random.default_rng(seed)
    out = rng.normal(0.0, [0.05] * 3 + [0.5] * 3, (len(T), 6))
    out[:, 0] = 5.0 * np.sin(3.0 * T)
    out[:, 5] -= 9.81
    return out


@pytest.mark.parametrize("seed", range(2))
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


@pytest.mark.parametrize("reading", [0.0, np.nan])
def test_an_accelerometer_that_reads_nothing_is_none(reading):
    samples = motion(1)
    samples[:, 3:] = reading
    (one,) = found(samples)
    assert one.absent
    assert one.sensor == "accelerometer"


@pytest.mark.parametrize("share", [0.8, 0.97])
def test_less_than_gravity_on_average_is_a_wrong_scale(share):
    samples = motion(1)
    samples[:, 3:] *= share
    assert [(one.sensor, one.low) for one in found(samples)] == [("accelerometer", True)] * (
        share < 0.9
    )
    # A fall may last for seconds.
    assert found(samples[:1000]) == ()


@pytest.mark.parametrize("block", [pytest.param(5, marks=pytest.mark.thorough), 97, 5000])
@pytest.mark.parametrize(("axis", "limit"), [(0, 4.0), (5, 12.5)])
def test_what_goes_on_from_the_other_end_wraps_around(axis, limit, block):
    samples = motion(1)
    samples[:, 5] += 6.0 * np.sin(5.0 * T)
    beyond = np.abs(samples[:, axis]) > limit
    samples[:, axis] = (samples[:, axis] + limit) % (2.0 * limit) - limit
    (one,) = found(samples, block)
    assert one.wraps
    assert one.sensor == ("gyro" if axis == 0 else "accelerometer")
    assert one.limit == pytest.approx(limit, rel=1e-2)
    assert one.share == pytest.approx(beyond.mean(), rel=0.1)


@pytest.mark.parametrize("period", [2.1, 3.0, 5.0, 40.0])
def test_reversals_and_glitches_do_not_wrap(period):
    samples = motion(1)
    n = np.arange(len(T))
    samples[:, 0] = 5.0 * np.sin(2.0 * np.pi * n / period) * (1.0 + 0.1 * np.sin(0.01 * n))
    samples[:, 1] += np.where(n % 700 == 0, 35.0, np.where(n % 900 == 0, -35.0, 0.0))
    samples[:, 2] = 4.0 * np.sign(np.sin(0.03 * n)) + 0.5 * samples[:, 3]
    assert not any(one.wraps for one in found(samples))
