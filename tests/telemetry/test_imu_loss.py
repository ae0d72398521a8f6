"""What is missing of the IMU, by its stamps."""

import numpy as np
import pytest

from gcs_sysid.telemetry.monitor import SampleLoss

RNG = np.random.default_rng


def counted(t):
    loss = SampleLoss()
    loss.add_times(np.asarray(t))
    return loss.counts


def even(rate, seconds, start=10.0):
    return start + np.arange(round(rate * seconds)) / rate


@pytest.mark.parametrize("rate", [20.0, 50.0, 250.0, 1000.0])
@pytest.mark.parametrize("share", [0.005, 0.2, 0.5])
def test_samples_lost_at_random_are_counted(rate, share):
    t = even(rate, 20_000 / rate)
    there = RNG(1).random(len(t)) >= share
    there[[0, -1]] = True
    counts = counted(t[there])
    assert counts.received == np.count_nonzero(there)
    assert counts.missing == pytest.approx(np.count_nonzero(~there), rel=0.02, abs=3)


def test_bursts_beyond_any_sequence_number_are_counted():
    """Each loses 2 s of every 5 s: 40 %, which modulo 256 is next to nothing."""
    t = even(250.0, 502.0)
    counts = counted(t[(t - t[0]) % 5.0 < 3.0])
    assert counts.missing == 100 * 500
    assert counts.share == pytest.approx(0.4, abs=0.01)
    assert counts.longest == pytest.approx(2.0, abs=0.01)


def test_nothing_is_missing_where_nothing_is():
    steps = np.where(np.arange(4000) % 2, 0.0025, 0.005)  # ArduPilot at 250 Hz
    for t in (even(250.0, 20.0), 5.0 + np.cumsum(steps), even(20.0, 20.0)):
        assert counted(t)[1:3] == (0, 0.0)


def test_jitter_of_stamps_is_no_loss():
    t = even(250.0, 40.0)
    counts = counted(t + RNG(2).uniform(-0.0008, 0.0008, len(t)))
    assert counts.missing == 0


def test_another_rate_is_no_loss():
    fast, slow = even(250.0, 20.0), even(50.0, 20.0, 30.02)
    assert counted(np.concatenate([fast, slow])).missing <= 5
    assert counted(np.concatenate([slow - 30.0, fast + 10.02])).missing <= 5


def test_late_and_repeated_samples_are_no_lost_ones():
    t = even(250.0, 40.0)
    order = np.argsort(np.arange(len(t)) + RNG(3).uniform(0.0, 20.0, len(t)))
    counts = counted(np.repeat(t[order], 2))
    assert counts[:3] == (len(t), 0, 0.0)


def test_a_reboot_and_an_absence_are_no_loss():
    loss = SampleLoss()
    loss.add_times(even(250.0, 20.0))
    loss.add_times(even(250.0, 20.0, 60.0))
    loss.restart()
    loss.add_times(even(250.0, 20.0, 1.0))
    assert loss.counts[:3] == (15_000, 0, 0.0)
    assert loss.counts.latest_gaps == ((pytest.approx(29.996), pytest.approx(30.004)),)


@pytest.mark.parametrize("late", [0, 40])
def test_many_samples_at_once_are_counted_as_one_by_one(late):
    """With jitter, losses, a pause and another rate; late ones end what is settled at once."""
    random = RNG(4)
    steps = np.concatenate([np.full(4000, 0.004), np.full(2000, 0.0025)])
    t = np.cumsum(steps * np.exp(random.normal(0.0, 0.1, len(steps))))
    t[3000:] += 12.0
    t = t[random.random(len(t)) > 0.2]
    for k in random.integers(0, len(t) - 8, late):
        t[k : k + 8] = random.permutation(t[k : k + 8])
    single = SampleLoss()
    for start in range(0, len(t), 7):
        single.add_times(t[start : start + 7])
    whole = counted(t)
    assert whole._replace(seconds=0.0) == single.counts._replace(seconds=0.0)
    assert whole.seconds == pytest.approx(single.counts.seconds)
    assert single.counts.missing > 500
