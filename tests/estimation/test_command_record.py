"""Rows of commands are made again no more often, and with no more whiteners, than it takes."""

from copy import deepcopy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gcs_sysid.coach.information import predicted_information, prior_noise, prior_vehicle
from gcs_sysid.estimation.fit.priors import COORDINATE_STD, Unknown
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record import command_record
from gcs_sysid.estimation.record.command_record import CommandRecord
from gcs_sysid.estimation.record.tuning import COMMANDS
from gcs_sysid.estimation.rows.actuator_dynamics import Coordinate
from gcs_sysid.estimation.rows.motor_linearization import LocalDynamics
from gcs_sysid.estimation.rows.thrust_drift import Drift
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.rotor_input import RotorInput

DT = 0.005
LAG = 0.05
SECONDS = 12.0


@pytest.fixture(scope="module")
def samples(flight):
    """On commands in which thrust is linear, and whose motors' speeds lag."""
    full = 1.2 * (flight.speeds**2).max()
    kept = np.exp(-DT / LAG)
    before = np.vstack([flight.speeds[:1], flight.speeds[:-1]])
    commands = ((flight.speeds - kept * before) / (1.0 - kept)) ** 2 / full
    gyro = flight.gyro + 0.001 * np.random.default_rng(1).standard_normal(flight.gyro.shape)
    every = replace(flight, gyro=gyro, rates=gyro, speeds=commands)
    return every.part(slice(0, round(SECONDS / DT)))


def flown(truth, samples):
    estimator = OnlineEstimator(truth.geometry, DT, COMMANDS)
    estimator.update(samples)
    return estimator


def outcome(estimator):
    """Estimates and their standard deviations, with what the other places of the lag add."""
    fit = estimator.fit().rotation
    return fit.unknowns, np.sqrt(np.diag(fit.full_covariance))


@pytest.fixture(scope="module")
def usual(truth, samples):
    """Flown once for all that follow: the estimator and its outcome."""
    estimator = flown(truth, samples)
    return SimpleNamespace(estimator=estimator, outcome=outcome(deepcopy(estimator)))


@pytest.fixture
def estimator(usual):
    """One that has flown."""
    return deepcopy(usual.estimator)


@pytest.fixture
def commands(estimator):
    """Its rows of commands."""
    return estimator.record.commands


def test_motors_are_found_where_slow_motion_is_the_airs(truth, samples, usual):
    t = DT * np.arange(len(samples.gyro))[:, None]
    turned = samples.gyro + 4.0 * np.sin(2.0 * np.pi * 0.4 * t + np.arange(3.0))
    estimator = flown(truth, replace(samples, gyro=turned, rates=turned))
    fit = estimator.fit().rotation
    found, std = fit.unknowns, np.sqrt(np.diag(fit.full_covariance))
    for place in (0, 1):  # Ixx, Iyy
        assert abs(found[place] - usual.outcome[0][place]) < 4.0 * std[place]
        assert std[place] < 0.5 * found[place]
    assert fit.of_steps


def test_a_flight_that_ends_before_motors_are_looked_for_has_them_at_its_end(truth, samples, usual):
    short = flown(truth, samples.part(slice(0, round(5.0 / DT))))
    assert short.record.commands.white is None
    fit = short.fit().rotation
    found, std = fit.unknowns, np.sqrt(np.diag(fit.full_covariance))
    assert fit.of_steps
    for place in (0, 1):  # Ixx, Iyy
        assert abs(found[place] - usual.outcome[0][place]) < 3.0 * std[place]
        assert std[place] < 0.3 * found[place]


def test_quick_samples_are_averaged(truth, samples):
    totals = []
    for n in (1, 2):
        record = CommandRecord(truth.geometry, DT / n, 1.0)
        parts = (np.repeat(part, n, axis=0) for part in (samples.speeds, samples.gyro))
        commands, gyro = parts
        still = np.zeros(len(gyro))
        for start in range(0, len(gyro), 701):
            piece = slice(start, start + 701)
            record.add_samples(
                commands[piece], gyro[piece], gyro[piece], Drift(still[piece], still[piece])
            )
        record.tune(float(commands.mean()))
        totals.append(record.white.total)
    np.testing.assert_allclose(totals[1], totals[0], rtol=1e-9, atol=1e-9 * totals[0].max())


def test_what_lags_is_asked_again_at_every_look(commands, monkeypatch):
    monkeypatch.setattr(command_record, "_SURE", 0.0)
    now = commands._now
    assert now.basis.lag_place.of == "speed"
    commands._now = commands._converged(now.basis.at, "command", now.maker.hover, now)
    assert commands._now.basis.lag_place.of == "command"
    commands.tune(now.maker.hover)
    assert commands._now.basis.lag_place.of == "speed"


def record_about(estimator, share):
    """The commands of a flight, with rows about a share of the lag found."""
    record = deepcopy(estimator).record.commands
    now = record._now
    at = now.fit.rotation.coordinates.copy()
    at[Coordinate.LAG] *= share
    basis = LocalDynamics(record._rounded(at), now.basis.lag_place.of, DT)
    maker, white = record._made(basis, now.maker.hover)
    fit = record._fitted(white, basis)
    record._now = replace(now, basis=basis, maker=maker, white=white, fit=fit)
    return record


def test_a_fit_far_from_its_rows_knows_curve_and_lag_as_before_the_flight(estimator):
    right, wrong = (record_about(estimator, share) for share in (1.0, 0.5))
    near, far = (record._now.fit.rotation for record in (right, wrong))
    assert not right.distance_doubt(near).any()
    doubt = wrong.distance_doubt(far)
    std, own = np.sqrt(np.diag(doubt)), far.full_covariance
    along = own[:, Unknown.LAG] / own[Unknown.LAG, Unknown.LAG] * COORDINATE_STD[1]
    assert std[Unknown.LAG] >= COORDINATE_STD[1]
    assert np.all(std >= np.abs(along))
    assert std[Unknown.CURVE] >= COORDINATE_STD[2]


@pytest.mark.parametrize("curves", [COMMANDS.curves, (0.0,)])
def test_the_coach_predicts_from_fits_to_whitened_commands(truth, samples, curves):
    """They estimate more of the motors than those of the window, which it predicts."""
    estimator = OnlineEstimator(truth.geometry, DT, replace(COMMANDS, curves=curves))
    estimator.update(samples)
    fit = estimator.fit()
    assert fit.rotation.of_steps
    known = prior_vehicle(load_airframe("paper"), RotorInput.COMMAND)
    noise = prior_noise(known.craft)
    before = predicted_information(
        Fit(None, None, 0.0), known, noise, estimator.record.basis.free
    ).after()
    after = predicted_information(fit, known, noise, estimator.record.basis.free).after()
    assert (after.rotation.std < before.rotation.std).all()


def test_a_body_that_is_not_rigid_has_motors_as_uncertain_as_any(estimator):
    """Its lag came out twice too large, with an interval of 2 %."""
    rigid = estimator.fit().rotation
    other = estimator.rotation.fit(None, estimator.prior, rigid=False)
    assert other.lag_place is not None
    for place in (Unknown.LAG, Unknown.DELAY):
        assert other.full_covariance[place, place] >= 0.9 * rigid.lag_doubt[place, place] > 0.0
