"""Rows and fits on flights whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter, sosfilt

from gcs_sysid.estimation.fit import translation
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record.article_estimator import ArticleEstimator
from gcs_sysid.estimation.record.input_noise import SpeedNoise
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics
from gcs_sysid.estimation.rows.regression import LeakySums, NormalEquations, RowMaker
from gcs_sysid.estimation.rows.rotor_signals import RotorPath
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.smoothers import DifferentiatorSmoother, WindowSmoother
from gcs_sysid.signals.stream_buffer import interpolate
from tests.estimation.rows_fit import fit_rows
from tests.known_theta import sizes

DT = 0.005
WINDOW = EstimatorTuning(smoother="window")
"""Exact without noise; whitened rows are trapezoids, and need noise to be weighed by."""


def noisy(samples, sigma, seed):
    noise = sigma * np.random.default_rng(seed).standard_normal(samples.gyro.shape)
    return replace(samples, gyro=samples.gyro + noise, rates=samples.rates + noise)


def row_maker(truth, smoother):
    basis = ActuatorDynamics(smoother.delays)
    return RowMaker(RotorPath(truth.geometry, DT, basis), basis, smoother)


def bank_of(truth, samples, smoother, memory=0.0):
    """What the rotational fit takes, without noise of the rotor speeds: one leak, all delays."""
    rows = row_maker(truth, smoother).update(samples).rotation
    rows = LeakySums(smoother.step * DT, [memory]).update(rows)
    basis = ActuatorDynamics(smoother.delays)
    moments = NormalEquations((1, basis.width, basis.width), 40)
    moments.add(rows[:, 0])
    noise = np.zeros((1, basis.width, basis.width))
    return moments.batches, moments.counts, basis, noise


def rotation_fit(truth, samples, smoother, memory=0.0):
    return fit_rows(*bank_of(truth, samples, smoother, memory))


SIZE = sizes(80.0, 80.0, 140.0, 7.0, 12.0, 8.0, 0.1, 0.05, 0.03, 20.0, 0.3)
"""Rough size of theta's entries: what an error is measured against."""


@pytest.mark.slow
@pytest.mark.parametrize("memory", [0.0, 0.3])
@pytest.mark.parametrize(
    ("smoother", "bar"),
    [
        # The window is exact for all that it resolves; what is left is the minimizer's own floor.
        (lambda: WindowSmoother(DT, 20), 1e-5),
        # The differentiator draws straight lines between samples: (w dt)^2 / 12 = 2e-4 at 9 rad/s,
        # the same on both sides but for what is left of its start.
        (lambda: DifferentiatorSmoother(DT, 10.0), 2e-3),
    ],
    ids=["window", "td"],
)
def test_rotation_is_recovered_without_noise(truth, flight, smoother, bar, memory):
    fit = rotation_fit(truth, flight, smoother(), memory)
    assert fit.converged
    assert np.abs((fit.theta - truth.theta) / SIZE).max() < bar
    np.testing.assert_allclose(fit.r_squared, 1.0, atol=1e-5)


def test_intervals_hold_the_truth_with_noise(truth, flight):
    inside = []
    for seed in range(12):
        samples = noisy(flight, 0.02, seed)
        fit = rotation_fit(truth, samples, WindowSmoother(DT, 20))
        assert fit.converged
        inside.append(np.abs(fit.theta - truth.theta) < 1.96 * fit.std)
    # 132 verdicts, correlated within a seed: 95 % wanted, 85 to 100 % allowed.
    assert 0.85 <= np.mean(inside) <= 1.0
    # and the intervals are of use: Ixx and Iyy to better than 2 %
    assert np.all(fit.std[:2] < 0.01 * fit.theta[:2])


def test_no_fit_without_data_or_response(truth, flight):
    assert (
        fit_rows(
            np.zeros((3, 1, 19, 19)),
            np.array([5, 5, 5]),
            ActuatorDynamics((0.0,)),
            np.zeros((1, 19, 19)),
        )
        is None
    )
    # Gyro noise alone, whatever the rotors do: nothing responds in the right sense or at all.
    still = replace(flight, gyro=-flight.gyro, rates=-flight.rates)
    fit = rotation_fit(truth, still, WindowSmoother(DT, 20))
    assert fit is None


@pytest.mark.slow
def test_missing_samples_are_left_out_of_whitened_rows(truth, flight):
    gone = (np.arange(len(flight.gyro)) % 800) < 100
    rpm = 2.0 * np.pi / 60.0
    measured = replace(noisy(flight, 0.005, 4), speeds=np.round(flight.speeds / rpm) * rpm)
    fits = []
    for lost in (np.zeros_like(gone), gone):
        estimator = OnlineEstimator(truth.geometry, DT, EstimatorTuning())
        holed = replace(measured, gyro=np.where(lost[:, None], np.nan, measured.gyro))
        estimator.update(holed)
        fits.append(estimator.fit())
    whole, holed = fits
    assert holed.rotation.rows == pytest.approx(0.86 * whole.rotation.rows, rel=0.03)
    off = np.abs(holed.rotation.theta - truth.theta)
    assert np.all(off < 3.5 * holed.rotation.std)
    assert np.all(holed.rotation.std[:3] < 2.0 * whole.rotation.std[:3])


@pytest.mark.parametrize("late", [0.0, 0.01])
def test_a_late_attitude_looks_like_so_much_drag(late):
    rng, t, kappa = np.random.default_rng(2), np.arange(0.0, 120.0, 0.02), 1.4e-4
    pace, phase = rng.uniform(1.0, 4.0, (2, 12)), rng.uniform(0.0, 6.28, (2, 12))

    def tilts(at):
        return 0.03 * np.sin(pace[..., None] * at + phase[..., None]).sum(axis=1)

    acceleration = 9.81 * tilts(t)
    velocity = -9.81 * 0.03 * (np.cos(pace[..., None] * t + phase[..., None]) / pace[..., None])
    rows = np.zeros((3, len(t), 4))
    rows[:2, :, 0] = -tilts(t - late) * 9.81 / kappa
    rows[2, :, 0] = 9.81 / kappa
    rows[:2, :, 1] = velocity.sum(axis=1)
    rows[2, :, 1] = 0.01 * rng.standard_normal(len(t))
    rows[..., 2] = 1.0
    rows[:2, :, 3] = acceleration
    rows[2, :, 3] = -9.81 + 0.3 * rng.standard_normal(len(t))
    moments = NormalEquations((3, 4, 4), 40)
    moments.add(rows)
    fit = translation.fit_momentum(moments.batches, moments.counts)
    assert fit.quickness == pytest.approx((acceleration**2).sum() / (rows[:2, :, 1] ** 2).sum())
    assert fit.delta == pytest.approx(late * fit.quickness, rel=0.1, abs=1e-3)


def test_without_velocity_the_accelerometer_serves(truth, flight):
    bias = 0.03
    blind = replace(
        flight,
        velocity=np.full_like(flight.velocity, np.nan),
        force=flight.force + np.array([0.0, 0.0, bias]),
    )
    estimator = OnlineEstimator(truth.geometry, DT, WINDOW)
    estimator.update(blind)
    fit = estimator.fit().translation
    assert fit.source == "accelerometer"
    assert np.isnan(fit.delta)
    kappa = truth.k_T / truth.m
    # A bias and the drag along z of a drifting vehicle are not in its model, but in its std.
    assert abs(fit.kappa - kappa) < 2.0 * fit.kappa_std
    assert fit.kappa_std < 0.035 * kappa


def article_fit(truth, samples, method, every=10):
    estimator = ArticleEstimator(truth.geometry, DT * every, method)
    estimator.update(samples.part(slice(None, None, every)))
    return estimator.fit()


@pytest.mark.slow
def test_direct_form_with_central_differences_is_close_without_noise(truth, plain_flight):
    fit = article_fit(truth, plain_flight, "central-difference", every=1)
    error = np.abs((fit.theta[:9] - truth.theta[:9]) / SIZE[:9])
    # Central differences are short by (w dt)^2 / 6 = 3e-4 at 9 rad/s.
    assert error.max() < 3e-3


def test_direct_form_is_drawn_to_zero_by_noise(truth, plain_flight):
    """The third row has zero on its right: noise in the derivative pulls Izz and k_M to zero."""
    izz, km = 2, rb.MOMENT_RATIO
    shares = []
    for seed in range(3):
        fit = article_fit(truth, noisy(plain_flight, 0.02, seed), "central-difference")
        shares.append(fit.theta[[izz, km]] / truth.theta[[izz, km]])
        forward = rotation_fit(truth, noisy(plain_flight, 0.02, seed), WindowSmoother(DT, 20))
        assert np.abs(forward.theta[[izz, km]] / truth.theta[[izz, km]] - 1.0).max() < 0.1
    assert np.max(shares) < 0.8
    assert np.min(shares) > -0.2


BANK = tuple(0.01 * k - 0.015 for k in range(8))


@pytest.mark.parametrize("delay", [0.0, 0.01, 0.0234, 0.04])
def test_a_delay_of_the_rotors_is_found(truth, flight, delay):
    """Speeds stamped late, by whole samples and by parts of one."""
    t = np.arange(len(flight.speeds)) * DT
    late = CubicSpline(t, flight.speeds)(np.maximum(t - delay, 0.0))
    samples = noisy(replace(flight, speeds=late), 0.01, 1).part(slice(50, None))
    fit = rotation_fit(truth, samples, WindowSmoother(DT, 20, BANK))
    assert abs(fit.delay - delay) < 3.0 * fit.delay_std
    assert fit.delay_std < 1e-3
    # The small products of rates and rotor momentum are not moved along: up to 1.3 % (measured).
    assert np.all(np.abs(fit.theta - truth.theta) < 4.0 * fit.std + 0.02 * SIZE)
    if delay > 0.02:  # which matters: without it the estimate is far off
        plain = rotation_fit(truth, samples, WindowSmoother(DT, 20))
        assert abs(plain.theta[2] / truth.theta[2] - 1.0) > 0.05
        assert abs(fit.theta[2] / truth.theta[2] - 1.0) < 0.02


@pytest.mark.parametrize("lost", [0.0, 0.05])
def test_what_slow_speeds_miss_is_known_to_a_factor(truth, lost):
    """Noise of a rate loop behind motors of 40 ms, all rotors alike, at 50 Hz."""
    fine, each, lag = 0.002, 10, 0.04
    rng = np.random.default_rng(3)
    white = sosfilt(butter(2, 40.0, fs=1.0 / fine, output="sos"), rng.normal(0.0, 9.0, 400_000))
    noise = lfilter([fine / lag], [1.0, fine / lag - 1.0], white)
    t = np.arange(0, len(noise), each)
    kept = t[rng.random(len(t)) >= lost]
    seen = interpolate(fine * kept, noise[kept, None], fine * t, 0.07)[:, 0]
    seen[np.isnan(seen)] = 0.0
    follower = SpeedNoise(truth.geometry, fine * each)
    follower.update(600.0 + seen[:, None] * np.ones(4))
    held = seen.reshape(-1, 20).mean(axis=1)
    excess = 20.0 * np.mean((held - noise.reshape(-1, 20 * each).mean(axis=1)) ** 2)
    told = follower.covariance
    assert 0.5 * excess < told[0, 0] < 4.0 * excess
    np.testing.assert_allclose(told, told[0, 0], rtol=1e-3)
    assert follower.doubt > 0.0
