"""The offline estimate in disturbed air: likeliest noise, instruments, what it says of itself."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.changes.tracking import Tracker
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.noise.whitening import averaged, gauss_markov, torque_noise
from gcs_sysid.estimation.offline import instrumental_variables, likelihood, offline
from gcs_sysid.estimation.offline.filter_error import (
    ResidualRun,
    innovations,
    likeliest_noise,
    offline_bank,
)
from gcs_sysid.estimation.offline.instrumental_variables import (
    InstrumentFit,
    combined,
    fit_by_instruments,
)
from gcs_sysid.estimation.offline.likelihood import most_passes
from gcs_sysid.estimation.offline.offline import fit_offline
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from testbed.rate_loop import DISTURBANCES, EXCITATIONS, Vehicle, fly

T = 0.004
GIVEN = gauss_markov(T, 4.0)


def residuals_of(whitener, n, seed):
    """(n, 3) noise whose innovations under a whitener are white and of unit variance."""
    drawn = np.random.default_rng(seed).standard_normal((n, 3))
    return lfilter([1.0, *whitener.factor], [1.0, -whitener.a], drawn, axis=0)


def run_of(residual, slope=None, setpoint=None):
    n = len(residual)
    return ResidualRun(
        residual,
        np.zeros((n, 2)) if slope is None else slope,
        np.full((n, 3), np.nan) if setpoint is None else setpoint,
        np.ones(n, dtype=bool),
    )


@pytest.mark.parametrize(
    "true",
    [
        averaged(gauss_markov(T, 9.0, tau=0.4), 0.5),
        gauss_markov(T, 13.0, 25.0),
        averaged(torque_noise(T, 30.0), 0.3),
    ],
    ids=lambda whitener: whitener.name,
)
def test_the_likeliest_noise_is_that_of_the_record(true):
    residual = residuals_of(true, 8000, 1)
    found = likeliest_noise([run_of(residual[:4000]), run_of(residual[4000:])], T, [GIVEN] * 3)
    for axis, model in enumerate(found):
        white = innovations(residual[:, axis], model.whitener)
        # No filter makes innovations weaker, but by what each unknown takes: half a nat or so.
        least = np.mean(innovations(residual[:, axis], true) ** 2)
        assert (1.0 - 3e-3) * least < np.mean(white**2) < (1.0 + 5e-4) * least
        assert model.whitener.disturbed == true.disturbed
        assert model.whitener.b == pytest.approx(true.b, abs=0.06)
        assert model.gain > 0.0
        assert not model.calm.disturbed


def test_the_banks_whitener_stays_where_nothing_is_likelier():
    residual = residuals_of(GIVEN, 8000, 2)
    models = likeliest_noise([run_of(residual)], T, [GIVEN] * 3)
    assert [model.whitener for model in models] == [GIVEN] * 3
    assert [model.gain for model in models] == [0.0] * 3
    bank = offline_bank(T, models, [GIVEN] * 3)
    assert bank.own == bank.judges == (GIVEN,) * 3
    assert set(bank.own) <= set(bank.whiteners)
    disturbed = [whitener.disturbed for whitener in bank.whiteners]
    assert disturbed == sorted(disturbed)  # those without come first


def fit_with(disturbance=(9.0, 9.0, 9.0), std=0.02):
    """A fit of nothing, by whiteners that assume too little of a disturbance."""
    theta = Vehicle().theta
    return RotationFit(
        theta,
        np.diag((std * np.maximum(np.abs(theta), 1e-3)) ** 2),
        np.eye(3),
        np.full(3, 0.8),
        1000,
        converged=True,
        whiteners=(torque_noise(T, 6.0),) * 3,
        disturbance=np.array(disturbance),
    )


def asked_and_answered(seed, *, answering):
    """A run where torque answers gusts, and the setpoint too if it is `answering`."""
    rng = np.random.default_rng(seed)
    n = 12_000
    gust = lfilter([1.0], [1.0, -0.99], rng.standard_normal(n))
    asked = np.repeat(rng.choice([-1.0, 0.0, 1.0], n), rng.integers(20, 200, n))[:n]
    if answering:
        asked = asked + 0.05 * np.concatenate([np.zeros(5), np.cumsum(gust[:-5]) * 0.01])
    slope = lfilter([6.0, -6.0], [1.0, -1.9, 0.905], asked)
    slope -= 0.6 * lfilter([0.0, 0.1], [1.0, -0.9], gust)
    residual = 0.08 * slope + gust
    return run_of(
        np.tile(residual[:, None], 3),
        np.tile(slope[:, None], 2),
        np.tile(asked[:, None], 3),
    )


def test_instruments_are_free_of_what_the_loop_answered():
    run, fit = asked_and_answered(1, answering=False), fit_with()
    e, s = (
        innovations(column, fit.whiteners[0]) for column in (run.residual[:, 0], run.slope[:, 0])
    )
    least_squares = float(s @ e / (s @ s))
    found = fit_by_instruments([run], fit, T)
    for by in found:
        assert by.believed
        assert by.delta == pytest.approx(0.08, abs=3.0 * by.std)
        assert abs(least_squares - 0.08) > 4.0 * by.std
        assert by.std < 0.02


def test_setpoints_that_answer_the_vehicle_are_no_instruments():
    found = fit_by_instruments([asked_and_answered(2, answering=True)], fit_with(), T)
    assert not any(by.believed for by in found)
    assert all(by.strength > instrumental_variables.RULES.least_f for by in found)


def test_without_setpoints_there_are_no_instruments():
    run = replace(asked_and_answered(1, answering=False), setpoint=np.full((12_000, 3), np.nan))
    assert fit_by_instruments([run], fit_with(), T) == (None, None)
    still = replace(run, setpoint=np.zeros((12_000, 3)))
    assert fit_by_instruments([still], fit_with(), T) == (None, None)


def test_instruments_move_a_fit_as_far_as_there_is_evidence():
    fit = fit_with(std=0.02)
    strong = {"strength": 50.0, "answer": 1.0}
    far, near = InstrumentFit(0.3, 0.03, **strong), InstrumentFit(0.02, 0.03, **strong)
    moved, by_them = combined(fit, (far, near))
    assert by_them
    # Nearly all of the way, and no surer than the instruments are.
    assert np.log(moved.theta[0] / fit.theta[0]) == pytest.approx(0.3, rel=0.01)
    assert 0.03 < moved.std[0] / fit.theta[0] < 0.04
    # What chance explains moves nothing.
    assert moved.theta[1] == fit.theta[1]
    assert moved.std[1] == fit.std[1]
    assert moved.full_covariance[0, 0] == moved.covariance[0, 0]


@pytest.mark.parametrize("by", [
    None,
    InstrumentFit(0.3, 0.03, strength=3.0, answer=1.0),
    InstrumentFit(0.3, 0.03, strength=50.0, answer=9.0),
])  # fmt: skip
def test_weak_or_answering_setpoints_move_nothing(by):
    fit = fit_with()
    assert combined(fit, (by, by)) == (fit, False)


def test_calm_air_needs_no_instruments():
    far = InstrumentFit(0.3, 0.03, strength=50.0, answer=1.0)
    fit = fit_with(disturbance=(0.2, 0.2, 0.2))
    assert combined(fit, (far, far)) == (fit, False)


@pytest.fixture(scope="module")
def gusty():
    """20 s of doublets in gusts at 250 Hz, gyro samples means of two, and what was made of them."""
    vehicle = Vehicle()
    (flight,) = fly(
        vehicle, EXCITATIONS["doublets"], DISTURBANCES["ou3.5"],
        flights=1, seconds=20.0, rate=250.0, seed=3,
    )  # fmt: skip
    tracker = Tracker(vehicle.geometry, T, EstimatorTuning(), keep=True)
    tracker.update(T * np.arange(len(flight.gyro)), flight)
    return vehicle, tracker, tracker.fit()


@pytest.mark.slow
def test_in_disturbed_air_the_noise_is_looked_for(gusty):
    vehicle, tracker, online = gusty
    told = []
    found = fit_offline(tracker, online, lambda what, share: told.append((what, share)))
    fit = found.fit.rotation
    assert found.method.startswith("filter error")
    assert any("likeliest" in whitener.name for whitener in fit.whiteners)
    for axis in (0, 1):
        assert abs(fit.theta[axis] - vehicle.theta[axis]) < 3.0 * fit.std[axis]
        assert fit.std[axis] < 1.1 * online.rotation.std[axis]
        bound = found.bounding_fit.rotation.std[axis]
        assert 0.0 < bound <= fit.std[axis]
    assert fit.disturbance[:2].min() > 1.0
    assert told[0] == ("filter error over 5000 samples", 0.0)
    assert told[-1][1] == 1.0
    assert found.fit.validation.r_squared[:2].min() > 0.3


@pytest.mark.slow
def test_a_record_beyond_the_budget_keeps_the_online_estimate(monkeypatch, truth, flight):
    monkeypatch.setattr(likelihood, "_BUDGET", 20_000)
    assert most_passes(1000) == 20
    assert most_passes(2000) == 0
    tracker = Tracker(truth.geometry, 0.005, EstimatorTuning(), keep=True)
    part = flight.part(slice(0, 2000))
    tracker.update(0.005 * np.arange(2000), part)
    whole = tracker.fit()
    # Slow rows are those of the window, which filter error is not for.
    plain = replace(whole, rotation=replace(whole.rotation, whiteners=()))
    said = fit_offline(tracker, plain)
    assert said == (
        "maximum likelihood of 2000 samples is beyond its budget: analyze a part of the flight "
        "(--start, --end)"
    )


def test_a_search_out_of_budget_says_so(monkeypatch, truth, flight):
    tracker = Tracker(truth.geometry, 0.005, EstimatorTuning(), keep=True)
    part = flight.part(slice(0, 600))
    tracker.update(0.005 * np.arange(600), part)
    whole = tracker.fit()
    plain = replace(whole, rotation=replace(whole.rotation, whiteners=()))
    unfinished = SimpleNamespace(converged=False, passes=25)
    monkeypatch.setattr(offline, "maximize_likelihood", lambda *_, **__: unfinished)
    assert fit_offline(tracker, plain) == (
        "the maximum likelihood of 600 samples ran out of its budget of 25 passes"
    )
    unfinished.passes = 7
    assert fit_offline(tracker, plain) == "the maximum-likelihood search did not converge"
