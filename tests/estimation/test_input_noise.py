"""Noise of rotor speeds and of commands: how large, and what rows see of it."""

import numpy as np
import pytest

from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.record.command_noise import CommandNoise, missed_and_seen
from gcs_sysid.estimation.record.input_noise import (
    ROUNDING_STD,
    SpeedNoise,
    is_sparse,
    with_sparse_readings,
)
from gcs_sysid.estimation.rows.actuator_dynamics import PLAIN, ActuatorDynamics, motor_filter
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.smoothers import WindowSmoother, leaky

GEOMETRY = np.array([[0.25, -0.25, 0.25, -0.25], [0.25, -0.25, -0.25, 0.25], [1, 1, -1, -1]])
LEVEL = 130.0
STD = np.array([0.5, 1.0, 2.0, 4.0])


def followed(noise_of, dt, std=STD, n=20_000, motion=True, common=0.0):
    rng = np.random.default_rng(1)
    t = np.arange(n)[:, None] * dt
    slow = 20.0 * np.sin(2.0 * np.pi * 0.5 * t) if motion else 0.0
    white = rng.standard_normal((n, 4)) * std + common * rng.standard_normal((n, 1))
    found = noise_of(GEOMETRY, dt)
    found.update(LEVEL + slow + white)
    return found


def test_noise_of_speeds_is_what_a_parabola_leaves():
    # 20 000 third differences, of which neighbors share most, tell a deviation to 1 %.
    np.testing.assert_allclose(followed(SpeedNoise, 0.004).std, STD, rtol=0.03)


def test_rounding_is_the_least():
    # A uniform error of one turn a minute: 2 pi / 60 / sqrt(12).
    assert pytest.approx(0.0302, rel=2e-3) == ROUNDING_STD
    std = followed(SpeedNoise, 0.004, std=np.array([0.0, 0.01, 0.0302, 1.0]), motion=False).std
    np.testing.assert_allclose(std, [ROUNDING_STD, ROUNDING_STD, 0.0304, 1.0], rtol=0.03)
    np.testing.assert_allclose(SpeedNoise(GEOMETRY, 0.004).std, ROUNDING_STD)


@pytest.mark.parametrize(
    ("dt", "share", "doubt"),
    [
        (0.004, 1.0, 0.0),
        (0.012, 1.0, 0.0),
        (0.013, 0.25, 0.5),
        (0.025, 0.25, 0.5),
        (0.026, 0.0, 0.0),
    ],
)
def test_how_much_is_missed_follows_the_sample_time(dt, share, doubt):
    found = followed(SpeedNoise, dt, common=1.0, motion=False)
    assert found.doubt == doubt
    diagonal = np.maximum(share * (STD**2 + 1.0), ROUNDING_STD**2)
    np.testing.assert_allclose(np.diag(found.covariance), diagonal, rtol=0.06)
    # Sensors err one by one; what slow samples miss, the loop does to all rotors at once.
    together = share if share < 1.0 else 0.0
    assert found.covariance[0, 1] == pytest.approx(together, rel=0.15, abs=1e-9)


@pytest.mark.parametrize(("n", "told"), [(102, False), (103, True)])
def test_a_hundred_differences_are_enough(n, told):
    """Of n samples there are n - 3."""
    assert bool(followed(SpeedNoise, 0.004, n=n).std[3] > 1.0) is told


def test_what_is_missing_breaks_the_row():
    rng = np.random.default_rng(2)
    whole, broken = SpeedNoise(GEOMETRY, 0.004), SpeedNoise(GEOMETRY, 0.004)
    values = LEVEL + rng.standard_normal((4000, 4))
    values[2000:] += 500.0  # another level after the gap
    holed = np.insert(values, 2000, np.nan, axis=0)
    for start in range(0, 4001, 7):
        broken.update(holed[start : start + 7])
    np.testing.assert_allclose(broken.std, 1.0, rtol=0.06)
    whole.update(values)
    assert whole.std[0] > 3.0
    again = SpeedNoise(GEOMETRY, 0.004)
    again.update(values[:2000])
    again.restart()
    again.update(values[2000:])
    np.testing.assert_allclose(again.std, broken.std)


@pytest.mark.parametrize("memory", [0.0, 0.3])
def test_rows_show_noise_of_speeds_as_told(memory):
    """Moments of rows of noise alone: torques by 2 Omega, H' by the derivative."""
    dt, n = 0.01, 60_000
    rng = np.random.default_rng(3)
    speeds = LEVEL * np.array([1.0, 1.1, 0.9, 1.0]) + STD * rng.standard_normal((n, 4))
    found = SpeedNoise(GEOMETRY, dt)
    assert not found.row_moments(PLAIN, WindowSmoother(dt, 10), memory).any()
    found.update(speeds)
    smoother = WindowSmoother(dt, 10)
    said = found.row_moments(PLAIN, smoother, memory)
    mixer = rb.mixer(GEOMETRY)
    squares = speeds**2
    H = speeds @ GEOMETRY[2]
    rows = smoother.update(np.column_stack([squares @ mixer, H]), 0)
    summed = np.column_stack([rows.average[:, :4], rows.derivative[:, 4]])
    summed = summed - summed.mean(axis=0)
    if memory:
        keep = np.exp(-smoother.step * dt / memory)
        for k in range(1, len(summed)):
            summed[k] += keep * summed[k - 1]
    seen = summed[200:].T @ summed[200:] / len(summed[200:])
    dH = rb.SIGNALS.index("dH")
    at = [0, 1, 2, 3, dH]
    scale = np.sqrt(np.diag(seen))
    np.testing.assert_allclose(
        said[np.ix_(at, at)] / np.outer(scale, scale),
        seen / np.outer(scale, scale),
        atol=0.13 if memory else 0.06,
    )
    rest = np.delete(np.arange(len(said)), at)
    assert not said[rest].any()
    assert not said[:, rest].any()
    # Averages and derivatives of a symmetric window do not hang together.
    assert not said[:4, dH].any()


def test_noise_of_speeds_in_one_sample_is_what_signals_scatter():
    """Roll, pitch, thrust and yaw torque, and H, of samples of noise alone."""
    speeds = LEVEL + STD * np.random.default_rng(3).standard_normal((60_000, 4))
    found = SpeedNoise(GEOMETRY, 0.004)
    for empty in found.of_signals:
        assert not np.any(empty)
    torques, across, H = found.of_signals
    assert (torques.shape, across.shape, H) == ((4, 4), (4,), 0.0)
    found.update(speeds)
    torques, across, H = found.of_signals
    seen = np.cov(np.column_stack([speeds**2 @ rb.mixer(GEOMETRY), speeds @ GEOMETRY[2]]).T)
    said = np.block([[torques, across[:, None]], [across[None], np.array([[H]])]])
    scale = np.outer(*2 * [np.sqrt(np.diag(seen))])
    # 60 000 samples tell a covariance to 0.4 % of the scatter, half of it by third differences.
    np.testing.assert_allclose(said / scale, seen / scale, atol=0.04)


def fit_with_a_delay(std=1e-4):
    """A fit whose delay is known to so many s, and correlated with damping."""
    n = rb.N_THETA
    rng = np.random.default_rng(5)
    mixed = rng.normal(size=(N_UNKNOWNS, N_UNKNOWNS))
    full = mixed @ mixed.T
    full *= std**2 / full[Unknown.DELAY, Unknown.DELAY]
    theta = np.arange(1.0, n + 1.0)
    theta[:2] = 80.0, 110.0
    return RotationFit(theta, full[:n, :n], np.eye(3), np.ones(3), 100, True, full_covariance=full)


@pytest.mark.parametrize(("interval", "late"), [(0.016, 1.6e-4), (0.04, 4e-4 * 2.0**1.5)])
def test_what_sparse_speeds_miss_moves_delay_and_damping_together(interval, late):
    """Of late torque, damping takes up t I <w'^2> / <w^2>, with the opposite sign."""
    fit, n = fit_with_a_delay(), rb.N_THETA
    rng = np.random.default_rng(2)
    rates, slope = rng.normal(size=(50, 3)), 7.0 * rng.normal(size=(50, 3))
    rows = np.zeros((50, rb.N_SIGNALS + 3))
    rows[:, [rb.SIGNALS.index(name) for name in "pqr"]] = rates
    rows[:, -3:] = slope
    wider = with_sparse_readings(fit, interval, rows.T @ rows)
    off = np.zeros(N_UNKNOWNS)
    off[Unknown.DELAY] = late
    off[rb.DAMPING] = -late * 95.0 * (slope[:, :2] ** 2).sum() / (rates[:, :2] ** 2).sum()
    expected = fit.full_covariance + np.outer(off, off)
    np.testing.assert_allclose(wider.full_covariance, expected)
    np.testing.assert_allclose(wider.extended_covariance, expected)
    np.testing.assert_allclose(wider.covariance, expected[:n, :n])
    np.testing.assert_allclose(wider.data_std, np.sqrt(np.diag(expected)[:n]))
    np.testing.assert_array_equal(wider.theta, fit.theta)
    # Nothing is said of what hardly turned, or of a delay that was given.
    assert with_sparse_readings(fit, interval, 0.0 * rows.T @ rows) is fit
    given = fit_with_a_delay(0.0)
    assert with_sparse_readings(given, interval, rows.T @ rows) is given
    assert with_sparse_readings(fit, 0.011, rows.T @ rows) is fit


def test_speeds_are_sparse_between_eighty_and_twenty_two_a_second():
    sparse = [is_sparse(interval) for interval in (0.0, 0.0119, 0.0121, 0.0449, 0.0451, 0.1)]
    assert sparse == [False, False, True, True, False, False]


def test_all_of_white_noise_is_missed_without_a_low_pass():
    np.testing.assert_array_equal(missed_and_seen(0.02, None), [1.0, 1.0])


@pytest.mark.parametrize("cutoff", [8.0, 30.0])
@pytest.mark.parametrize("apart", [None, 0.005])
def test_folding_by_an_integral(apart, cutoff):
    """Noise behind |H|^2 = 1 / (1 + (f / fc)^4), sampled: sums over the aliases, written out."""
    dt = 0.02
    missed, seen = missed_and_seen(dt, cutoff, apart)

    def power(f, k):
        turned = 1.0 if apart is None else np.cos(np.pi * k * apart / dt) ** 2
        return turned / (1.0 + ((f + k / dt) / cutoff) ** 4)

    folds = range(-200, 201)
    assert missed == pytest.approx(sum(power(0.0, k) for k in folds) - 1.0, rel=1e-3)
    f = np.linspace(0.0, 0.5 / dt, 2001)
    weight = np.sin(2.0 * np.pi * f * dt) ** 6
    total = sum(power(f, k) for k in folds)
    assert seen == pytest.approx((weight * total).sum() / weight.sum(), rel=2e-3)


def test_fast_commands_miss_nothing():
    found = followed(CommandNoise, 0.005, std=0.01 * np.ones(4))
    assert not found.covariance.any()
    assert found.doubt == 0.3


@pytest.mark.parametrize(("n", "told"), [(105, False), (106, True)])
def test_a_hundred_differences_of_commands_are_enough(n, told):
    """Three times two samples go before the first."""
    found = CommandNoise(GEOMETRY, 0.02)
    found.update(0.5 + 0.01 * np.random.default_rng(1).standard_normal((n, 4)))
    assert bool(found.covariance.any()) is told


@pytest.mark.parametrize("noise_of", [SpeedNoise, CommandNoise])
@pytest.mark.parametrize("block", [1, 3, 7, 100])
def test_grouping_of_inputs_does_not_matter(noise_of, block):
    values = 0.5 + 0.1 * np.random.default_rng(5).standard_normal((700, 4))
    whole, parts = noise_of(GEOMETRY, 0.02), noise_of(GEOMETRY, 0.02)
    whole.update(values)
    for start in range(0, len(values), block):
        parts.update(values[start : start + block])
    np.testing.assert_allclose(parts.covariance, whole.covariance, rtol=1e-12)


def test_noise_of_commands_is_told_with_what_rotors_share():
    found = followed(CommandNoise, 0.02, std=0.01 * np.ones(4), common=0.02, motion=False)
    expected = 0.01**2 * np.eye(4) + 0.02**2
    np.testing.assert_allclose(found.covariance, expected, rtol=0.07)
    np.testing.assert_allclose(found.std, np.sqrt(np.diag(found.covariance)))
    # Slow motion hardly shows in a difference over six samples.
    assert followed(CommandNoise, 0.02, std=np.full(4, 1.0)).std == pytest.approx(1.0, rel=0.06)


def test_where_a_second_stream_lies_is_counted_sample_by_sample():
    """Half of the samples with another stream a quarter of the time later, half alone."""
    dt, cutoff, n = 0.02, 30.0, 8000
    rng = np.random.default_rng(1)
    values = 0.5 + 0.01 * rng.standard_normal((n, 4))
    apart = np.where(np.arange(n) < n // 2, 0.25 * dt, np.nan)
    found = CommandNoise(GEOMETRY, dt, cutoff)
    found.update(values, apart)
    mixed = 0.5 * (missed_and_seen(dt, cutoff, 0.25 * dt) + missed_and_seen(dt, cutoff))
    plain = CommandNoise(GEOMETRY, dt)
    plain.update(values)
    np.testing.assert_allclose(found.covariance, mixed[0] / mixed[1] * plain.covariance)
    # A whole sample apart is none.
    whole = CommandNoise(GEOMETRY, dt, cutoff)
    whole.update(values, np.full(n, dt))
    together = missed_and_seen(dt, cutoff, 0.0)
    np.testing.assert_allclose(whole.covariance, together[0] / together[1] * plain.covariance)


def test_one_sample_is_its_own_level():
    found = CommandNoise(GEOMETRY, 0.02)
    found.update(np.full((1, 4), 0.4))
    assert found.level == pytest.approx((0.4, 0.0))


def test_level_of_commands_is_that_of_the_samples():
    """Each rotor about its own mean."""
    rng = np.random.default_rng(4)
    values = np.array([0.3, 0.4, 0.5, 0.8]) + rng.normal(size=(900, 4)) * [0.01, 0.02, 0.03, 0.1]
    found = CommandNoise(GEOMETRY, 0.02)
    assert found.level == (0.0, 0.0)
    for start in range(0, 900, 70):
        found.update(values[start : start + 70])
    mean, std = found.level
    assert mean == pytest.approx(values.mean())
    assert std == pytest.approx(np.sqrt(values.var(axis=0).mean()))


@pytest.mark.parametrize("memory", [0.0, 0.3])
def test_elements_hold_white_noise_through_lag_window_and_leak(memory):
    """Impulse responses written out, sample by sample."""
    dt, half = 0.02, 10
    basis = ActuatorDynamics((0.0, 0.02), (0.0, 0.05), (0.0, 1.0), motors=True, dt=dt)
    smoother = WindowSmoother(dt, half, delays=basis.delays)
    found = CommandNoise(GEOMETRY, dt)
    assert not found.row_moments(basis, smoother, memory).any()
    rng = np.random.default_rng(6)
    found.update(0.6 + 0.01 * rng.standard_normal((5000, 4)))
    said = found.row_moments(basis, smoother, memory)
    assert said[0, 0] > 0.0
    again = found.row_moments(basis, smoother, memory)
    np.testing.assert_array_equal(again, said)
    n = 400
    responses = []
    for element in basis.elements:
        taps = smoother.late_taps[element.delay]
        a, b0, b1 = motor_filter(dt, basis.lags[element.lag])
        out, w, u = np.zeros(n), 0.0, 0.0
        for k in range(n):
            now = taps[k] if k < len(taps) else 0.0
            w = a * w + b0 * now + b1 * u
            u = now
            out[k] = w
        responses.append(out)
    summed = leaky(np.array(responses), smoother.step, dt, memory)
    gains = np.array([1.0, 2.0 * found.level[0]])
    torques = np.zeros((5, 5))
    mixer = rb.mixer(GEOMETRY)
    torques[:4, :4] = mixer.T @ found.covariance @ mixer
    sets = np.outer(gains, gains)
    expected = np.einsum("ef,st,ij->esiftj", summed @ summed.T, sets, torques)
    late = expected.shape[0] * 10
    np.testing.assert_allclose(
        said[:late, :late], expected.reshape(late, late), rtol=1e-3, atol=1e-6 * said.max()
    )
    assert not said[late:].any()
    assert not said[:, late:].any()
