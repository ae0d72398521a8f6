"""The history of quick fits: what a block gives at once, and what single fits give."""

from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record.tuning import COMMANDS, EstimatorTuning

DT = 0.005
STOP = 20
"""Samples from fit to fit."""


def measured(flight, *, commands=False):
    rng = np.random.default_rng(5)
    gyro = flight.gyro + 0.02 * rng.standard_normal(flight.gyro.shape)
    # A gap in all, and one in the velocity alone.
    gyro[2000:2100] = np.nan
    velocity = flight.velocity.copy()
    velocity[3000:3200] = np.nan
    speeds = flight.speeds
    if commands:
        speeds = (speeds / (1.2 * speeds.max())) ** 2
    return replace(flight, gyro=gyro, rates=gyro, speeds=speeds, velocity=velocity)


def series(truth, samples, block, tuning):
    estimator = OnlineEstimator(truth.geometry, DT, tuning)
    fits = []
    n = len(samples.gyro)
    for start in range(0, n, block):
        stop = min(start + block, n)
        stops = [k - start for k in range(STOP, n + 1, STOP) if start < k <= stop]
        fits += estimator.follow(samples.part(slice(start, stop)), stops)
    return fits


def single(truth, samples, tuning):
    estimator = OnlineEstimator(truth.geometry, DT, tuning)
    fits = []
    for start in range(0, len(samples.gyro) - STOP + 1, STOP):
        estimator.update(samples.part(slice(start, start + STOP)))
        fits.append(estimator.fit(quick=True))
    return fits


def assert_same(fits, others):
    assert len(fits) == len(others)
    for k, (a, b) in enumerate(zip(fits, others, strict=True)):
        assert a.seconds == b.seconds
        assert (a.rotation is None) == (b.rotation is None), k
        if a.rotation is not None:
            assert a.rotation.whiteners == b.rotation.whiteners, k
            difference = np.abs(a.rotation.unknowns - b.rotation.unknowns)
            std = np.sqrt(np.diag(b.rotation.full_covariance))
            # Sums in another order, which differs between processors. A search stops where steps
            # are shorter than 1e-4 deviations, or some steps after a leap, on its way.
            near = 1e-3 if b.rotation.converged else 2e-3
            assert np.all(difference <= near * std), (k, difference, std)
            # After a second the covariance is all but singular, and rounding counts.
            near = 3e-4 if a.seconds > 1.2 else 1e-3
            assert a.rotation.std == pytest.approx(b.rotation.std, rel=near)
        assert (a.translation is None) == (b.translation is None), k
        if a.translation is not None:
            assert a.translation.source == b.translation.source
            assert a.translation.kappa == pytest.approx(b.translation.kappa, rel=1e-6)
            assert a.translation.kappa_std == pytest.approx(b.translation.kappa_std, rel=1e-4)
        assert (a.rigid_body_test is None) == (b.rigid_body_test is None), k


@pytest.mark.slow
@pytest.mark.parametrize("smoother", ["window", pytest.param("td", marks=pytest.mark.thorough)])
def test_blocks_give_what_single_fits_give(truth, flight, smoother):
    samples, tuning = measured(flight).part(slice(3400)), EstimatorTuning(smoother=smoother)
    alone = single(truth, samples, tuning)
    fits = series(truth, samples, 250, tuning)
    assert sum(fit.rotation is not None for fit in fits) > 120
    assert_same(fits, alone)


@pytest.mark.slow
@pytest.mark.thorough
def test_blocks_of_commands_give_what_single_fits_give(truth, flight):
    samples = measured(flight, commands=True)
    # In the first seconds the valley of lag, delay and curve is flat, and rounding leads astray
    # until a search has come to its end.
    late = [
        [fit for fit in fits if fit.seconds > 8.0 and fit.rotation.converged]
        for fits in (series(truth, samples, 3000, COMMANDS), single(truth, samples, COMMANDS))
    ]
    # These motors have no lag, so that some searches are on their way to its bound.
    assert len(late[0]) > 100
    assert_same(*late)


def test_quick_fits_are_near_full_ones(truth, flight):
    samples = measured(flight)
    # Of whitened rows: test_quick_fits_stay_near_the_full_one.
    estimator = OnlineEstimator(truth.geometry, DT, EstimatorTuning(smoother="window"))
    off = []
    for k, start in enumerate(range(0, len(samples.gyro), 10 * STOP)):
        part = samples.part(slice(start, start + 10 * STOP))
        quick = estimator.follow(part, list(range(2 * STOP, len(part.gyro) + 1, 2 * STOP)))[-1]
        if k % 4 == 3 and quick.seconds > 6.0:
            full, quick = estimator.fit().rotation, quick.rotation
            off.append(np.abs((quick.theta - full.theta) / full.std))
    assert len(off) > 4
    assert np.max(off) < 0.1
