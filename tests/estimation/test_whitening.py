"""Whiteners, rows of one step, and what they are for: no bias under feedback."""

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.noise.whitening import (
    WhitenerBank,
    averaged,
    bank_for,
    gauss_markov,
    leak,
)
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record import whitened_record
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.estimation.record.whitened_record import WhitenedRecord
from gcs_sysid.estimation.rows.actuator_dynamics import SIGNALS, ActuatorDynamics
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.one_step import OneStep, step_for
from testbed.rate_loop import DISTURBANCES, EXCITATIONS, Vehicle, fly

T = 0.004
WHITENED, WINDOW = EstimatorTuning(), EstimatorTuning(smoother="window")


@pytest.mark.parametrize("rho_d", [1e-6, 1e-3, 0.1])
@pytest.mark.parametrize("rho_u", [0.0, 0.02, 1.0])
@pytest.mark.parametrize("lags", [1, 2])
def test_a_disturbance_is_whitened_exactly(rho_d, rho_u, lags):
    f_d, f_u = rho_d ** (0.5 / (1 + lags)) / (2.0 * np.pi * T), rho_u**0.5 / (2.0 * np.pi * T)
    whitener, omega = gauss_markov(T, f_d, f_u, lags=lags), np.linspace(0.0, np.pi, 200)
    z = np.exp(-1j * omega)
    noise = rho_d / abs(1.0 - np.exp(-T) * z) ** (2 * lags) + rho_u + abs(1.0 - z) ** 2
    np.testing.assert_allclose(whitener.power(omega) * noise * whitener.gyro_share, 1.0, rtol=1e-7)
    assert np.all(abs(np.roots([1.0, *whitener.denominator])) < 1.0)


@pytest.mark.parametrize("lags", [1, 2])
def test_innovations_of_the_process_are_white(lags):
    rng = np.random.default_rng(3)
    n, tau, r = 40_000, (1.0, 0.15)[lags - 1], 1.0
    process = gauss_markov(T, 8.0, tau=tau, lags=lags)
    rho_d = (2.0 * np.pi * 8.0 * T) ** (2 + 2 * lags)
    gyro, moment = np.sqrt(r) * rng.standard_normal(n + 1), rng.standard_normal(n)
    for _ in range(lags):
        moment = lfilter([1.0], [1.0, -np.exp(-T / tau)], moment)
    moment *= np.sqrt(rho_d * r)
    left = (moment + np.diff(gyro))[:, None]
    right, wrong = WhitenerBank([process, leak(T, 0.3)]).update(left)[:, 200:, 0]

    def correlations(w):
        return np.array([w[lag:] @ w[:-lag] for lag in (1, 2, 5, 20, 60)]) / (w @ w)

    assert np.abs(correlations(right)).max() < 4.0 / np.sqrt(n)
    assert np.abs(correlations(wrong)).max() > 20.0 / np.sqrt(n)
    assert right.var() < wrong.var()
    assert process.gyro_share * right.var() == pytest.approx(r, rel=0.03)
    assert moment.var() == pytest.approx(process.strength * r, rel=0.1)


@pytest.mark.parametrize("samples", [1, 2])
def test_both_sides_of_a_step_agree_on_cubics(samples):
    t = np.arange(60) * T
    signals = np.column_stack([3.0 * (t - 0.1) ** 2, (t - 0.1) ** 3])
    rows = OneStep(T, samples=samples).update(signals, 1)
    np.testing.assert_allclose(rows.average[:, 0], rows.derivative[:, 1], atol=1e-12)


def test_late_signals_are_put_right():
    t = np.arange(80) * T
    true, late = np.sin(9.0 * t), np.sin(9.0 * (t - 3 * T))
    rows = OneStep(T, (-1, 0, 3)).update(np.column_stack([late, true]), 1)
    np.testing.assert_allclose(rows.late_average[2, :, 0], rows.average[:, 1], atol=1e-12)


@pytest.mark.slow
def test_known_noise_is_what_noise_adds():
    rng = np.random.default_rng(6)
    step = step_for(T)
    basis = ActuatorDynamics(step.delays, half_width=None, dt=T)
    record = WhitenedRecord(basis, step, bank_for(T), T, 1.0)
    noise = rng.standard_normal((60_000, SIGNALS))  # of roll, pitch, thrust, yaw, and of H
    rows = step.update(noise, SIGNALS)
    elements = rows.late_average.copy()
    elements[..., -1] = rows.late_derivative[..., -1]
    n = SIGNALS * len(step.delays)
    white = WhitenerBank(bank_for(T)[::4]).update(
        np.swapaxes(elements, 0, 1).reshape(len(rows.average), n)
    )
    told = record.noise(np.eye(5))[:, :n, :n]
    for w, expected in zip(white, told[::4], strict=True):
        size = np.sqrt(np.diag(expected))
        scaled = (w.T @ w / len(w) - expected) / np.outer(size, size)
        # Leaks leave few independent sums in such a record.
        assert np.abs(scaled).max() < 0.2
        assert np.abs(scaled).mean() < 0.02


@pytest.fixture(scope="module")
def disturbed():
    """A flight at 250 Hz under a strong moment."""
    vehicle = Vehicle()
    return vehicle, fly(
        vehicle,
        EXCITATIONS["aggressive"],
        DISTURBANCES["ou7"],
        flights=1,
        seconds=20.0,
        rate=250.0,
        seed=11,
    )


def fitted(samples, tuning, size=5000):
    estimator = OnlineEstimator(Vehicle().geometry, T, tuning)
    for start in range(0, len(samples.gyro), size):
        estimator.update(samples.part(slice(start, start + size)))
    return estimator.fit()


@pytest.mark.slow
def test_no_bias_under_feedback(disturbed):
    vehicle, flights = disturbed
    for samples in flights:
        old, new = (fitted(samples, t).rotation for t in (WINDOW, WHITENED))
        error, before = (np.abs(f.theta[:2] / vehicle.theta[:2] - 1.0) for f in (new, old))
        assert np.all(error < 0.03)
        assert np.all(before > 0.08)
        assert np.all(error < 3.0 * new.std[:2] / vehicle.theta[:2])
        assert np.all(new.disturbance[:2] > 50.0)


@pytest.mark.slow
def test_nothing_is_detected_where_nothing_disturbs(calm):
    fit = fitted(calm, WHITENED)
    assert np.all(fit.rotation.disturbance < 1.0)
    assert fit.validation is not None
    assert np.all(np.abs(fit.validation.whiteness - 1.0) < 0.5)
    truth = Vehicle().theta
    assert np.all(np.abs(fit.rotation.theta[:2] / truth[:2] - 1.0) < 0.01)
    gyro = calm.gyro.copy()
    gyro[-750:] += np.random.default_rng(1).normal(5.0, 3.0, (750, 3))
    crashed = fitted(type(calm)(gyro, gyro, *calm.signals[2:]), WHITENED)
    assert np.all(crashed.validation.r_squared > 0.5)
    assert np.all(np.abs(crashed.rotation.theta[:2] / truth[:2] - 1.0) < 0.01)


@pytest.mark.slow
def test_shocks_are_left_out(disturbed):
    samples = disturbed[1][0].part(slice(0, 3000))
    gyro = samples.gyro.copy()
    gyro[1500:1560, 0] += 4.0 * np.sin(np.linspace(0.0, 40.0, 60))
    struck = type(samples)(gyro, gyro, *samples.signals[2:])
    clean, hit = (fitted(s, WHITENED).rotation for s in (samples, struck))
    assert hit.rows < clean.rows
    assert abs(hit.theta[0] - clean.theta[0]) < clean.std[0]


@pytest.mark.parametrize("b", [0.4, 0.9])
def test_noise_of_an_averaged_gyro_is_whitened(b):
    """Moving averages, means over the samples sent and interpolation make neighbors alike."""
    rng = np.random.default_rng(8)
    n = 40_000
    own = rng.standard_normal(n + 2)
    gyro = own[1:] + b * own[:-1]
    plain = leak(T, 0.3)
    right, wrong = WhitenerBank([averaged(plain, b), plain]).update(np.diff(gyro)[:, None])[
        :, 500:, 0
    ]

    def correlations(w):
        return np.array([w[lag:] @ w[:-lag] for lag in (1, 2, 5)]) / (w @ w)

    # The leak itself takes T / 0.3 s of neighbors away.
    assert np.abs(correlations(right)).max() < 4.0 / np.sqrt(n) + T / 0.3
    assert correlations(wrong)[0] == pytest.approx(b / (1.0 + b * b), abs=0.03)
    assert right.var() < 0.95 * wrong.var()
    assert right.var() == pytest.approx(1.0, rel=0.04)
    # What is slow of it has the density of (1 + b)^2.
    assert averaged(plain, b).gyro_share == pytest.approx((1.0 + b) ** 2, rel=0.02)


@pytest.fixture(scope="module")
def calm():
    """30 s at 250 Hz inside the model."""
    flight = fly(
        Vehicle(), EXCITATIONS["doublets"], DISTURBANCES["none"],
        flights=1, seconds=30.0, rate=250.0, seed=21,
    )  # fmt: skip
    return flight[0]


@pytest.fixture
def learnt_early(monkeypatch):
    """As if 15 s told what whiteners a flight needs, in place of a minute."""
    monkeypatch.setattr(whitened_record, "_LEARNED", 15.0)


@pytest.mark.thorough
def test_narrowing_loses_next_to_nothing(calm, monkeypatch):
    found = []
    for learnt in (15.0, 1e9):
        monkeypatch.setattr(whitened_record, "_LEARNED", learnt)
        estimator = OnlineEstimator(Vehicle().geometry, T, WHITENED)
        estimator.update(calm)
        found.append((estimator.record.whitened, estimator.fit().rotation))
    (few, narrow), (many, wide) = found
    assert len(few.whiteners) < 0.6 * len(many.whiteners)
    assert len(few.basis.delays) == 4 < len(many.basis.delays)
    # The delay that was found lies between those kept.
    assert few.basis.delays[0] < narrow.coordinates[0] < few.basis.delays[-1]
    assert few.rows == many.rows
    moved = np.abs(narrow.theta - wide.theta)
    assert np.all(moved[: rb.ROTOR_INERTIA] < 0.5 * wide.std[: rb.ROTOR_INERTIA])
    # It goes with the delay, between fewer nodes of which others lie: within 1 % of a usual one.
    assert moved[rb.ROTOR_INERTIA] < 0.003
    np.testing.assert_allclose(narrow.std, wide.std, rtol=0.3)
    truth = Vehicle().theta
    assert np.all(np.abs(narrow.theta - truth) < 3.5 * narrow.std)


@pytest.mark.slow
def test_a_series_of_quick_fits_goes_on_over_the_narrowing(calm, learnt_early):
    """As a live session asks for them: before, over and after it, however samples come."""
    stops = range(3000, 7001, 500)
    whole = OnlineEstimator(Vehicle().geometry, T, WHITENED)
    course = whole.follow(calm.part(slice(0, 7000)), stops)
    parts, pieces = OnlineEstimator(Vehicle().geometry, T, WHITENED), []
    for start in range(0, 7000, 500):
        inside = [s - start for s in stops if start < s <= start + 500]
        pieces += parts.follow(calm.part(slice(start, start + 500)), inside)
    assert len(course) == len(pieces) == len(stops)
    assert len(whole.record.whitened.whiteners) < len(bank_for(T))
    truth = Vehicle().theta
    for fit, piece in zip(course, pieces, strict=True):
        std = fit.rotation.std
        assert np.all(np.abs(piece.rotation.theta - fit.rotation.theta) < 1e-3 * std)
        assert np.all(np.abs(fit.rotation.theta[:3] - truth[:3]) < 4.0 * std[:3])
