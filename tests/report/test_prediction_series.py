"""The report's own prediction agrees with the estimator's validation, and its noise is noise."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from gcs_sysid.live.acceleration_prediction import Model, RotationSamples
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.parameters import AXES
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.report.data import predict, predicted
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import ChainOptions
from gcs_sysid.twin.measured_flight import FlightRecorder


def agreement(prediction):
    """(3,) R squared on the rows not fitted; NaN without any."""
    rows = prediction.held_out
    if not rows.any():
        return np.full(3, np.nan)
    y, z = prediction.measured[rows], prediction.predicted[rows]
    return 1.0 - np.mean((y - z) ** 2, axis=0) / np.mean(y**2, axis=0)


def analyzed(path, airframe):
    """The result, and what it predicts."""
    recorder = FlightRecorder()
    result = analyze_log(Path(path), airframe, options=ChainOptions(), observers=[recorder])
    prediction = predicted(result, recorder, airframe)
    recorder.close()
    return result, prediction


@pytest.mark.slow
@pytest.mark.parametrize(
    "flight",
    [
        ("--mission", "paper", "--noise", "paper", "--sigma", "0.02", "--rate", "20"),
        ("--mission", "all-axes", "--noise", "mems", "--rate", "100", "--duration", "24"),
    ],
)
def test_agrees_with_the_validation(fly, flight):
    result, prediction = analyzed(fly(*flight, "--seed", "1").tlog, load_airframe("paper"))
    r_squared = agreement(prediction)
    for axis, name in enumerate(AXES):
        told = result.validation
        assert r_squared[axis] == pytest.approx(told["r_squared"][name], abs=5e-4)
    share = prediction.held_out.sum() / np.isfinite(prediction.predicted[:, 0]).sum()
    assert share == pytest.approx(1.0 - told["fitted_share"], abs=2e-3)


@pytest.mark.thorough
def test_after_a_change_the_segment_in_force_is_predicted(fly):
    flight = ("--mission", "all-axes", "--noise", "mems", "--rate", "100")
    log = fly(*flight, "--seed", "1", "--mass-step", "30:1.2").tlog
    result, prediction = analyzed(log, load_airframe("paper"))
    (segment,) = result.segments
    there = np.isfinite(prediction.predicted[:, 0])
    assert prediction.t[there].min() >= segment["end"]
    told = result.validation["r_squared"]
    assert agreement(prediction) == pytest.approx(list(told.values()), abs=2e-3)


def still(n, dt, rotors=4, gyro_std=0.01, seed=1):
    """A vehicle that hangs still, with a white gyro."""
    gyro = np.random.default_rng(seed).normal(0.0, gyro_std, (n, 3))
    return RotationSamples(dt * np.arange(n), gyro, np.zeros((n, 3)), np.full((n, rotors), 100.0))


@pytest.fixture
def model():
    theta = np.zeros(rb.N_THETA)
    theta[:3] = 80.0, 85.0, 140.0
    theta[rb.MOMENT_RATIO] = 0.03
    return Model(
        rb.forward_matrix(theta),
        np.array([0.0, 0.0, 1.0]),
        load_airframe("paper").geometry,
        RotorInput.SPEED,
    )


def test_pieces_do_not_matter_and_gaps_are_left_out(model):
    dt = 0.004
    whole = still(5000, dt)
    whole.gyro[2000:2010] = np.nan
    edges = [0, 17, 1999, 2600, 5000]
    parts = [
        RotationSamples(*(getattr(whole, name)[a:b] for name in ("t", "gyro", "rates", "rotors")))
        for a, b in pairwise(edges)
    ]
    one, many = (
        predict(p, dt, model, -np.inf, np.inf, np.array([[0.6, 1.0]])) for p in ([whole], parts)
    )
    np.testing.assert_allclose(many.measured, one.measured, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(many.held_out, one.held_out)
    missing = np.isnan(one.predicted[:, 0]) & np.isfinite(one.t)
    assert missing.any()
    assert np.all(np.abs(one.t[missing] - 2005 * dt) < 0.15)


def test_without_a_model_the_rates_are_there(model):
    found = predict([still(2000, 0.004)], 0.004, None, -np.inf, np.inf, np.empty((0, 2)))
    assert np.isfinite(found.rates).all()
    assert not found.held_out.any()
    assert found.spectrum is None
    assert np.isnan(agreement(found)).all()
