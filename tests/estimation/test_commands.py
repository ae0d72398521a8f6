"""Commands as the rotors' input: lag, curve and delay are found with everything else."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record.input_noise import CommandNoise
from gcs_sysid.estimation.record.record import FlightRecord
from gcs_sysid.estimation.record.tuning import COMMANDS
from gcs_sysid.estimation.rows.actuator_dynamics import SIGNALS, LagPlace
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.records import Samples
from gcs_sysid.signals.stream_buffer import interpolate
from tests.estimation.rows_fit import fit_rows

DT = 0.005
FULL = 1.2
"""Of the greatest thrust flown, what full command gives."""


def commands_of(flight, truth, lag, curve):
    """(n, rotors) commands that give the flight's thrusts, and T_max / k_T."""
    shares = flight.speeds**2
    full = FULL * shares.max()
    shares = shares / full
    w = (
        shares
        if curve == 0.0
        else (np.sqrt((1.0 - curve) ** 2 + 4.0 * curve * shares) - (1.0 - curve)) / (2.0 * curve)
    )
    a = np.exp(-DT / lag)
    before = np.vstack([w[:1], w[:-1]])
    # A command acts until the next; what the motor reaches at a stamp is what was flown there.
    return (w - a * before) / (1.0 - a), full


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lag", "curve"),
    [
        pytest.param(0.03, 0.0, marks=pytest.mark.thorough),
        (0.05, 0.4),
        pytest.param(0.09, 1.0, marks=pytest.mark.thorough),
    ],
)
def test_lag_and_curve_are_found_with_the_rest(truth, flight, lag, curve):
    commands, full = commands_of(flight, truth, lag, curve)
    gyro = flight.gyro + 0.01 * np.random.default_rng(1).standard_normal(flight.gyro.shape)
    estimator = OnlineEstimator(truth.geometry, DT, COMMANDS)
    samples = replace(flight, gyro=gyro, rates=gyro, speeds=commands)
    estimator.update(samples.part(slice(0, 4000)))
    fit = estimator.fit().rotation
    found_delay, found_lag, found_curve, *_ = fit.coordinates
    assert found_lag == pytest.approx(lag, abs=0.001)
    # These commands are in force from half a step before their stamps on, in the mean.
    assert found_delay == pytest.approx(0.5 * DT, abs=0.001)
    assert found_curve == pytest.approx(curve, abs=0.02)
    # Everything is relative to T_max instead of k_T; lengths are what they were.
    relative = truth.theta.copy()
    relative[[0, 1, 2, 3, 4, 5, 9]] /= full
    error = np.abs(fit.theta - relative)
    assert np.all(error[:2] < 0.01 * relative[:2])
    assert error[2] < 0.03 * relative[2]
    assert np.all(error[6:8] < 1e-4)


def commands_of_speed(flight, lag):
    """Commands, on which thrust is linear, whose motors' speeds lag; and T_max / k_T."""
    full = FULL * (flight.speeds**2).max()
    a = np.exp(-DT / lag)
    before = np.vstack([flight.speeds[:1], flight.speeds[:-1]])
    return ((flight.speeds - a * before) / (1.0 - a)) ** 2 / full, full


@pytest.mark.slow
def test_a_lag_of_speed_is_told_from_one_of_the_command(truth, flight):
    """Thrust is its square: taken for a lag of the command, Izz would go astray."""
    commands, full = commands_of_speed(flight, 0.06)
    gyro = flight.gyro + 0.005 * np.random.default_rng(1).standard_normal(flight.gyro.shape)
    samples = replace(flight, gyro=gyro, rates=gyro, speeds=commands)
    Izz = truth.theta[2] / full
    estimator = OnlineEstimator(truth.geometry, DT, COMMANDS)
    estimator.update(samples.part(slice(0, 4000)))
    fit = estimator.fit().rotation
    assert fit.lag_place.of == "speed"
    assert fit.coordinates[1] == pytest.approx(0.06, abs=0.001)
    assert abs(fit.theta[2] / Izz - 1.0) < 0.03


@pytest.mark.parametrize(
    ("of", "lagged"),
    [
        ("command", lambda u, share, mean: share(mean(u))),
        ("thrust", lambda u, share, mean: mean(share(u))),
        ("speed", lambda u, share, mean: mean(np.sqrt(share(u))) ** 2),
    ],
)
@pytest.mark.parametrize("curve", [0.0, 0.4, 1.0])
def test_bends_make_the_mean_thrust_of_a_lag_without_end(of, lagged, curve):
    """Such a lag leaves the mean of what lags; the bend is the commands' variance."""
    u = np.random.default_rng(2).normal(0.4, 0.08, 20_000)

    def share(u):
        return (1.0 - curve) * u + curve * u * u

    place = LagPlace(of, float(u.mean()), float(u.std()))
    k, slope = (float(part[0]) for part in place.bend(np.array([curve])))
    assert share(u.mean()) + k * u.var() == pytest.approx(lagged(u, share, np.mean), abs=2e-4)
    if 0.0 < curve < 1.0:
        ahead, behind = (place.bend(np.array([curve + h]))[0][0] for h in (1e-5, -1e-5))
        assert slope == pytest.approx((ahead - behind) / 2e-5, abs=1e-6)


def test_given_lag_and_curve_are_kept(truth, flight):
    commands, _ = commands_of(flight, truth, 0.05, 0.4)
    given = replace(COMMANDS, lags=(0.05,), curves=(0.4,))
    estimator = OnlineEstimator(truth.geometry, DT, given)
    estimator.update(replace(flight, speeds=commands).part(slice(0, 3000)))
    fit = estimator.fit().rotation
    assert fit.coordinates[1:].tolist() == [0.05, 0.4, 0.0, 0.0]
    assert fit.coordinates_std[1:].tolist() == [0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("dt", "apart"),
    [
        (0.012, None),
        (0.02, None),
        (0.05, None),
        (0.02, 0.0),
        (0.02, 0.005),
        (0.02, 0.008),
        (0.02, 0.014),
    ],
)
def test_what_commands_miss_follows_the_rate_loops_low_pass(dt, apart):
    """Noise held from sample to sample has more power than the noise it stands for.

    The mean of two streams, the second sampled later and taken at the first one's times, misses
    what neither has.
    """
    cutoff, fine, span = 40.0, 0.001, 0.6
    white = np.random.default_rng(5).normal(0.0, 0.01, (600_000, 4))
    noise = sosfilt(butter(2, cutoff, fs=1.0 / fine, output="sos"), white, axis=0)
    each = round(dt / fine)
    seen = CommandNoise(np.ones((3, 4)), dt, cutoff)
    commands, told = noise[::each], None
    if apart is not None:
        t = np.arange(len(commands)) * dt
        second = interpolate(t + apart, noise[round(apart / fine) :: each], t, 2.0 * dt)
        second[:2] = commands[:2]
        commands, told = 0.5 * (commands + second), np.full(len(t), dt - apart)
    seen.update(0.5 + commands, told)
    true = noise.reshape(-1, round(span / fine), 4).mean(axis=1)
    held = commands.reshape(-1, round(span / dt), 4).mean(axis=1)
    excess = (held * (held - true)).mean()
    missed = (seen.std**2).mean() / round(span / dt)
    assert missed == pytest.approx(excess, rel=0.2, abs=0.06 * (held * held).mean())


ROLL = np.array([-1.0, 1.0, 1.0, -1.0])
"""Commands that turn the vehicle about one axis alone."""


@pytest.mark.slow
def test_known_noise_of_commands_leaves_the_estimate_where_it_was(truth, flight):
    """Moments with it give what those without it gave."""
    every, dt = 4, 0.02
    commands, _ = commands_of(flight, truth, 0.05, 0.0)
    estimator = OnlineEstimator(truth.geometry, dt, replace(COMMANDS, curves=(0.0,)))
    estimator.update(replace(flight, speeds=commands).part(slice(None, None, every)))
    estimator.fit()
    record = estimator.record
    noise = CommandNoise(truth.geometry, dt)
    noise.update(np.random.default_rng(7).normal(0.5, 0.02, (5000, 4)))
    added = np.stack(
        [noise.row_moments(record.basis, record._smoother, m) for m in record.memories]
    )
    moments, counts = record.rotation.batches, record.rotation.counts
    noisy = moments + counts[:, None, None, None] * added
    clean, untold, told = (
        fit_rows(batches, counts, record.basis, n, doubt=noise.doubt)
        for batches, n in ((moments, 0.0 * added), (noisy, 0.0 * added), (noisy, added))
    )
    names = [0, 1, 2, rb.MOMENT_RATIO]
    off = np.abs(untold.theta / clean.theta - 1.0)[names]
    left = np.abs(told.theta / clean.theta - 1.0)[names]
    assert off.min() > 0.1
    assert left.max() < 0.2 * off.max()
    # That the noise is not known to a fifth is in the interval.
    assert np.all((told.std > 0.1 * np.abs(untold.theta - told.theta))[names])


@pytest.mark.slow
def test_elements_show_noise_as_their_filters_let_it_pass(truth):
    """Moments of rows made of noise alone, against what is said of them."""
    dt = 0.02
    tuning = replace(COMMANDS, loop_cutoff=None)
    record = FlightRecord(truth.geometry, dt, tuning)
    n = 30_000
    commands = 0.5 + np.random.default_rng(3).normal(0.0, 0.01, (n, 1)) * ROLL
    still = np.zeros((n, 3))
    level = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    for _ in record.add_samples(Samples(still, still, commands, level, still, still)):
        pass
    record.flush()
    roll = [k for k in range(record.basis.late) if k % SIGNALS == 0]
    for leak in range(len(tuning.leaks)):
        seen = record.rotation.total[leak] / record.rotation.rows
        said = record.whitened_noise([leak])[0]
        np.testing.assert_allclose(seen[np.ix_(roll, roll)], said[np.ix_(roll, roll)], rtol=0.1)
        # Nothing of it is in yaw.
        assert np.abs(said[3]).max() < 1e-9 * said[0, 0]
