"""The defaults of both filters against the article's claims, on its own kind of motion.

benchmarks/filter_claims.py measures them over many seeds on the emulator's flight.
"""

import numpy as np
import pytest

from gcs_sysid.model import attitude
from gcs_sysid.signals.complementary import ComplementaryFilter
from gcs_sysid.signals.smoothers import LinearDifferentiator
from sim_bridge.missions import PITCH, ROLL, YAW
from sim_bridge.sensors import SENSORS, make_channels
from testbed.article import backward_difference, central_difference

SIGMA = 0.02
GAINS = (0.85, 0.2, 0.2)
"""rad/s rms about the three axes, as in the first flight mode."""


def motion(t):
    """Body rates and their derivatives, (n, 3) each."""
    swings = np.array([[tones(s) for tones in (ROLL, PITCH, YAW)] for s in t])
    return swings[..., 1] * GAINS, swings[..., 2] * GAINS


def noise(model, rate, seed, count):
    """Of gyro and attitude, (n, 3) each, as the emulator's sensors have it."""
    intervals = dict.fromkeys(SENSORS, 1.0 / rate)
    channels = make_channels(model, SIGMA, intervals, 4, np.random.SeedSequence(seed))
    return channels["gyro"].block(count), channels["attitude"].block(count)


@pytest.mark.parametrize("model", ["paper", "white"])
@pytest.mark.parametrize(("rate", "seconds", "seeds"), [(20, 60.0, 2), (250, 30.0, 2)])
def test_attitude_has_a_fifth_of_the_references_variance(model, rate, seconds, seeds):
    """Measured over 100 seeds: about 85 % less in the article's noise, 94 % in white noise."""
    count = round(seconds * rate)
    before = after = 0.0
    for seed in range(seeds):
        # At rest: the noise's share does not depend on the motion, the filter being linear.
        gyro, tilt = noise(model, rate, seed, count)
        out = ComplementaryFilter(1.0 / rate).update(gyro, attitude.from_rotation_vector(tilt))
        used = slice(2 * rate, None)
        before += np.sum(tilt[used] ** 2)
        after += np.sum(attitude.to_rotation_vector(out)[used] ** 2)
    assert after < 0.2 * before


def test_a_gyro_bias_does_not_spoil_the_attitude():
    """MEMS sensors with 0.01 rad/s of it, once the filter has had 20 s to find it."""
    rate, count = 50, 3000
    gyro, tilt = noise("mems", rate, 3, count)
    assert np.abs(gyro.mean(axis=0)).min() > 0.009
    out = ComplementaryFilter(1.0 / rate).update(gyro, attitude.from_rotation_vector(tilt))
    error = attitude.to_rotation_vector(out)[20 * rate :]
    assert np.mean(error**2) < 0.85 * np.mean(tilt[20 * rate :] ** 2)


@pytest.mark.parametrize(
    ("model", "rate", "seconds"),
    [("paper", 20, 20.0), ("white", 20, 20.0), ("paper", 250, 5.0), ("mems", 250, 5.0)],
)
def test_derivative_is_better_than_differences(model, rate, seconds):
    """At least 60 % below backward differences in squared error and in rms, and below central
    differences, with its own constant lag taken out; nothing else is known of the signal.
    """
    dt = 1.0 / rate
    t = np.arange(round(seconds * rate)) * dt
    filter_ = LinearDifferentiator(dt)
    rates, _ = motion(t)
    _, now = motion(t)
    _, late = motion(t - filter_.lag)
    used = slice(filter_.settling, -1)

    def square(derivative, truth):
        return np.mean((derivative - truth)[used] ** 2)

    td = backward = central = 0.0
    for seed in range(3):
        measured = rates + noise(model, rate, seed, len(t))[0]
        filter_.restart()
        td += square(filter_.update(measured)[1], late)
        backward += square(backward_difference(measured, dt), now)
        central += square(central_difference(measured, dt), now)
    assert td < 0.4**2 * backward
    assert td < central
