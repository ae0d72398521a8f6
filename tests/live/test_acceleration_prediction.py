"""What a live session shows of measured and predicted acceleration."""

import numpy as np
import pytest

from gcs_sysid.live.acceleration_prediction import (
    KEPT,
    LivePrediction,
    Model,
    Predictor,
    RotationSamples,
)
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.session.chain import Chain, ChainOptions
from tests.feeding import feed

SELDOM = ChainOptions(history_interval=1.0)


@pytest.fixture(scope="module")
def records(flight):
    return flight.records()


@pytest.fixture
def watched():
    chain = Chain(load_airframe("paper"), SELDOM)
    prediction = LivePrediction(chain)
    chain.observers.append(prediction.add_samples)
    return chain, prediction


@pytest.mark.slow
def test_the_last_seconds_are_foretold(watched, records):
    chain, prediction = watched
    assert prediction.acceleration() is None
    feed(chain, records, 64)  # rows are kept by the pieces that brought them
    found = prediction.acceleration()
    step = np.diff(found.t)
    assert chain.t - 1.5 < found.t[-1] < chain.t
    assert KEPT - 1.0 < found.t[-1] - found.t[0] <= KEPT + 0.5
    assert step.min() > 0.5 * np.median(step)
    assert step.max() < 1.6 * np.median(step)
    assert np.isfinite(found.measured).all()
    assert found.r_squared.min() > 0.9


@pytest.mark.slow
def test_each_row_is_predicted_by_the_fit_that_was_there_before_it(watched, records):
    """With a fit frozen beforehand, the rows are those of the same model over the whole flight."""
    chain, prediction = watched
    half = len(records) // 2
    feed(chain, records[:half])
    blocks = []
    fit = chain.fit
    since = chain.t

    def take(block):
        blocks.append(block)
        chain.fit = fit
        prediction.add_samples(block)

    chain.observers[:] = [take]
    feed(chain, records[half:])
    found = prediction.acceleration()
    rotation = fit.rotation
    model = Model(rotation.Q, rotation.coordinates, chain.airframe.geometry, RotorInput.SPEED)
    whole = Predictor(blocks[0].dt, model).rows(
        RotationSamples(
            np.concatenate([b.t for b in blocks]),
            np.concatenate([b.samples.gyro for b in blocks]),
            np.concatenate([b.samples.rates for b in blocks]),
            np.concatenate([b.samples.speeds for b in blocks]),
        )
    )
    later = found.t > since + 1.0
    known = np.isfinite(whole.predicted[:, 0])
    for name in ("measured", "predicted"):
        rows = getattr(found, name)[later]
        for axis in range(3):
            expected = np.interp(
                found.t[later], whole.t[known], getattr(whole, name)[known][:, axis]
            )
            tight = 0.02 * np.abs(rows[:, axis]).max() + 0.05
            np.testing.assert_allclose(rows[:, axis], expected, atol=8.0 * tight)
            assert np.median(np.abs(rows[:, axis] - expected)) < tight


@pytest.mark.slow
def test_after_a_reset_only_what_is_new_is_shown(watched, records):
    chain, prediction = watched
    half = len(records) // 2
    feed(chain, records[:half])
    last = prediction.acceleration().t[-1]
    chain.reset()
    feed(chain, records[half:])
    assert prediction.acceleration().t[-1] > last
