"""The offline estimate: likeliest noise, rows at any delay, what it says of itself."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.changes.tracking import Tracker
from gcs_sysid.estimation.fit.problem import residual_maker
from gcs_sysid.estimation.fit.whitened_fit import fit_whitened
from gcs_sysid.estimation.noise.whitening import (
    WhitenedMoments,
    averaged,
    corrected,
    gauss_markov,
    torque_noise,
)
from gcs_sysid.estimation.offline import prediction_error
from gcs_sysid.estimation.offline.kept_rows import SpeedRows, at_delay
from gcs_sysid.estimation.offline.likeliest_noise import innovations, likeliest
from gcs_sysid.estimation.offline.offline import fit_offline
from gcs_sysid.estimation.offline.prediction_error import estimate
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.model import rigid_body as rb
from testbed.rate_loop import DISTURBANCES, EXCITATIONS, Vehicle, fly

T = 0.004
SILENT = np.zeros((5, 5))


def residuals_of(whitener, n, seed):
    """(n,) changes of a rate with the noise that a whitener is for."""
    drawn = np.random.default_rng(seed).standard_normal(n + 2000)
    return lfilter([1.0, *whitener.denominator], [1.0, *whitener.numerator], drawn)[2000:]


@pytest.mark.parametrize(
    "true",
    [
        averaged(gauss_markov(T, 8.4, tau=0.4), 0.5),
        gauss_markov(T, 9.3, 21.8),
        averaged(torque_noise(T, 28.0), 0.3),
        corrected(T, 26.0, 0.1),
    ],
    ids=["moment, averaged gyro", "moment and torque noise", "torque noise", "corrected gyro"],
)
def test_the_likeliest_noise_is_that_of_the_record(true):
    runs = [residuals_of(true, 8000, seed) for seed in (1, 2)]
    best, calm, numbers = likeliest(runs, [np.ones(8000, dtype=bool)] * 2, T)
    powers = [
        np.mean([np.mean(innovations(run, whitener) ** 2) for run in runs])
        for whitener in (true, best)
    ]
    # No filter makes innovations weaker, but by what each unknown takes.
    assert (1.0 - 1e-3) * powers[0] < powers[1] < (1.0 + 1e-3) * powers[0]
    assert best.disturbed == true.disturbed
    assert not calm.disturbed
    # A search from where that one ended stays there.
    again = likeliest(runs, [np.ones(8000, dtype=bool)] * 2, T, numbers).best
    np.testing.assert_allclose(again.denominator, best.denominator, atol=3e-3)


def test_a_corrected_gyro_is_whitened_exactly():
    whitener, z = corrected(T, 26.0, 12.0), np.exp(-1j * np.linspace(0.01, np.pi, 50))
    gyro = np.abs((1.0 - z) ** 2 / (1.0 - np.exp(-26.0 * T) * z)) ** 2
    white = whitener.power(np.linspace(0.01, np.pi, 50)) * (gyro + (2.0 * np.pi * 12.0 * T) ** 2)
    # What is left is the variance of an innovation, of which the gyro's is 1.
    np.testing.assert_allclose(white, 1.0 / whitener.gyro_share)


@pytest.mark.parametrize("every", [1, 10])
def test_rows_are_exact_at_any_delay(truth, flight, every):
    """At 20 Hz too, where the fastest signal turns by half a radian a sample."""
    dt = 0.005 * every
    late = 0.4 * dt
    n = np.arange(len(flight.gyro))
    moved = [np.interp(n - late / 0.005, n, column) for column in flight.speeds.T]
    samples = replace(flight, speeds=np.stack(moved, axis=1)).part(slice(None, None, every))
    rows = SpeedRows([samples], truth.geometry, dt, late, 0.0, SILENT)
    (run,) = rows.made(rows.basis(at_delay(late)))
    Q = rb.forward_matrix(truth.theta)
    left = run @ (residual_maker(Q) @ rows.basis(at_delay(late)).map_at(at_delay(late))).T
    scale = run[:, -3:].std(axis=0)
    # Linear interpolation of this test leaves most of that.
    assert (left.std(axis=0) / scale).max() < 3e-3


def test_gaps_split_the_record_and_short_pieces_are_left_out(truth, flight):
    gone = np.zeros(len(flight.gyro), dtype=bool)
    gone[400:440] = gone[800:810] = gone[820:830] = True
    holed = replace(flight, gyro=np.where(gone[:, None], np.nan, flight.gyro))
    rows = SpeedRows([holed], truth.geometry, 0.005, 0.0, 0.0, SILENT)
    runs = rows.made(rows.basis(at_delay(0.0)))
    assert [len(run) for run in runs][:2] == [391, 351]
    assert len(runs) == 3


def test_known_noise_of_the_speeds_is_what_it_adds_to_rows(truth, flight):
    covariance = np.diag([1.0, 2.0, 3.0, 4.0, 5.0]) ** 2
    rows = SpeedRows([flight], truth.geometry, T, 0.001, 0.0, covariance)
    basis, whitener = rows.basis(at_delay(0.001)), torque_noise(T, 6.0)
    taps = rows.taps(basis)
    drawn = np.random.default_rng(3).standard_normal(40_000)
    row = np.stack([np.convolve(drawn, tap) for tap in taps.T], axis=1)
    power = np.mean(innovations(row, whitener)[: len(drawn)] ** 2, axis=0)
    noise = np.diag(rows.noise(basis, [whitener])[0])
    np.testing.assert_allclose(noise[[3, 4, 10, 11]], power * [16.0, 25.0, 16.0, 25.0], rtol=0.05)


def test_batches_weigh_by_more_than_chance():
    counts = np.full(400, 5)
    data = WhitenedMoments((np.ones((400, 1, 2, 2)),), counts, np.zeros((1, 2, 2)), (), T, 5)
    chance = np.exp(np.log(np.random.default_rng(1).chisquare(5, (400, 3)) / 5).mean(axis=1))
    assert np.ptp(data.weighed(chance).counts) <= 3
    gusty = np.where(np.arange(400) % 2, 4.0, 1.0)
    assert set(data.weighed(gusty).counts) == {3, 7}


# ---- whole flights ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def gusty():
    """13 s of doublets in gusts at 250 Hz, gyro samples means of two, and what was made of them.

    Samples are missing twice, a sixth of a second apart.
    """
    vehicle = Vehicle()
    (flight,) = fly(
        vehicle, EXCITATIONS["doublets"], DISTURBANCES["ou3.5"],
        flights=1, seconds=13.0, rate=250.0, seed=3,
    )  # fmt: skip
    gyro = flight.gyro.copy()
    gyro[1500:1530] = gyro[1572:1600] = np.nan
    flight = replace(flight, gyro=gyro)
    tracker = Tracker(vehicle.geometry, T, EstimatorTuning(), keep=True)
    tracker.update(T * np.arange(len(flight.gyro)), flight)
    return vehicle, tracker, tracker.fit()


@pytest.mark.slow
def test_in_disturbed_air_the_noise_is_looked_for(gusty):
    vehicle, tracker, online = gusty
    heard = []
    found = fit_offline(tracker, online, lambda what, share: heard.append((what, share)))
    fit = found.fit.rotation
    for axis in (0, 1):
        assert abs(fit.theta[axis] - vehicle.theta[axis]) < 3.0 * fit.std[axis]
        assert fit.std[axis] < 1.1 * online.rotation.std[axis]
        bound = found.bounding_fit.rotation.std[axis]
        assert 0.0 < bound <= fit.std[axis]
    assert fit.disturbance[:2].min() > 1.0
    assert heard[0] == ("prediction error of 3250 samples", 0.0)
    assert heard[-1][1] == 1.0
    assert found.fit.validation.r_squared[:2].min() > 0.3


@pytest.mark.slow
def test_noise_that_spares_low_frequencies_is_used_at_20_hz(truth, flight):
    """And speeds stamped late by a share of a sample."""
    samples, dt = flight.part(slice(None, None, 10)), 0.05
    drawn = np.random.default_rng(5).standard_normal((len(samples.gyro) + 200, 3))
    noise = 0.02 * lfilter([1.0, -1.0], [1.0, -np.exp(-5.0 * dt)], drawn, axis=0)[200:]
    noisy = replace(samples, gyro=samples.gyro + noise, rates=samples.rates + noise)
    tracker = Tracker(truth.geometry, dt, EstimatorTuning(), keep=True)
    tracker.update(dt * np.arange(len(noisy.gyro)), noisy)
    online = tracker.fit().rotation
    rows = SpeedRows([noisy], truth.geometry, dt, online.delay, 0.009, SILENT)
    fit = estimate(rows, online).fit.rotation
    assert np.abs((fit.theta - truth.theta) / fit.std).max() < 4.0
    assert abs(fit.delay) < 4.0 * fit.delay_std
    assert np.median(fit.std / online.std) < 0.9
    # These speeds are exact. Noise that is not there is not taken out.
    signals = samples.speeds**2 @ rb.mixer(truth.geometry)
    silent = SpeedRows([noisy], truth.geometry, dt, 0.0, 0.0, SILENT)
    rounded = np.diag([*(1e-4 * signals.std(axis=0) ** 2), 0.0])
    loud = SpeedRows([noisy], truth.geometry, dt, 0.0, 0.0, rounded)
    np.testing.assert_array_equal(*(estimate(r, online).fit.rotation.theta for r in (silent, loud)))


def test_a_search_that_does_not_converge_goes_on_where_it_went(truth, flight, monkeypatch):
    """About the motors that are known at first no fit may converge with what truly lags."""
    samples, starts = flight.part(slice(None, None, 10)), []
    noisy = samples.gyro + 0.01 * np.random.default_rng(6).standard_normal(samples.gyro.shape)
    tracker = Tracker(truth.geometry, 0.05, EstimatorTuning(), keep=True)
    tracker.update(0.05 * np.arange(len(noisy)), replace(samples, gyro=noisy, rates=noisy))
    online = tracker.fit().rotation
    rows = SpeedRows(tracker.kept, truth.geometry, 0.05, online.delay, 0.009, SILENT)
    whole = estimate(rows, online).fit.rotation
    # Beside what is far likelier it is enough that rows stayed: nothing is compared any more.
    assert not estimate(rows, online, rival=-np.inf).whitened.data.judges

    def lost_at_first(*args):
        fit = fit_whitened(*args)
        starts.append((args[2], fit.rotation))
        return replace(fit, rotation=replace(fit.rotation, converged=len(starts) > 2))

    monkeypatch.setattr(prediction_error, "fit_whitened", lost_at_first)
    found = estimate(rows, online).fit.rotation
    assert found.converged
    assert starts[1][0].theta is starts[0][1].theta
    assert np.abs((found.theta - whole.theta) / whole.std).max() < 0.2


def test_why_there_is_no_offline_estimate_is_said(truth, flight):
    tracker = Tracker(truth.geometry, 0.005, EstimatorTuning(), keep=True)
    assert "online estimate to start from" in fit_offline(tracker, Fit(None, None, 0.0))
    tracker.update(0.005 * np.arange(1000), flight.part(slice(1000)))
    online = tracker.fit()
    tracker.kept[:] = [flight.part(slice(20))]
    assert fit_offline(tracker, online) == "the prediction error of 20 samples found no estimate"
    sparse = Tracker(truth.geometry, 0.02, EstimatorTuning(speed_interval=0.02), keep=True)
    part, times = flight.part(slice(0, 1000, 4)), 0.02 * np.arange(250)
    jumping = part.speeds * np.where(times % 0.2 < 0.01, 1.1, 1.0)[:, None] ** [1, 0, 0, 0]
    sparse.update(times, replace(part, speeds=jumping))
    assert "speeds are 20 ms apart" in fit_offline(sparse, sparse.fit())
