"""Moments that nobody models, carried on into the stretches that are judged."""

import numpy as np
import pytest

from gcs_sysid.twin.prediction_errors import NOTHING_CARRIED, choose_carried

DT = 0.004


def left_by(acceleration, noise, seed):
    """(n, 3) sums of what one step leaves: an acceleration, and noise of the rates."""
    random = np.random.default_rng(seed)
    return np.cumsum(acceleration * DT, axis=0) + noise * random.standard_normal(acceleration.shape)


def ornstein_uhlenbeck(n, rms, tau, seed):
    a = np.exp(-DT / tau)
    out = rms * np.random.default_rng(seed).standard_normal(n)
    for k in range(1, n):
        out[k] = a * out[k - 1] + np.sqrt(1.0 - a * a) * out[k]
    return out


def test_what_lasts_is_carried_and_predicts_flight_that_was_not_seen():
    n, axis = 10_000, 1
    acceleration = np.zeros((n, 3))
    acceleration[:, axis] = ornstein_uhlenbeck(n, 2.0, 2.0, 4)
    left = left_by(acceleration, 0.003, 5)
    seen, unseen = left[: n // 2], left[n // 2 :]
    carried = choose_carried([seen], DT)
    assert carried.any
    assert carried.memory[axis] > 0.0
    assert carried.fading[axis] >= 1.0
    assert not carried.memory[[0, 2]].any()
    assert carried.rms[axis] == pytest.approx(2.0, rel=0.4)
    steps = 75  # 0.3 s
    starts = np.arange(500, len(unseen) - steps, 25)
    forecast = carried.forecast(carried.at(unseen, DT)[starts], steps, DT)
    assert forecast.shape == (len(starts), steps, 3)
    rise = unseen[starts + steps] - unseen[starts]
    error = rise - DT * forecast.sum(axis=1)
    assert np.std(error[:, axis]) < 0.6 * np.std(rise[:, axis])
    assert "pitch" in carried.says
    assert "roll" not in carried.says


def test_of_noise_alone_nothing_is_carried():
    for seed in range(20):
        left = left_by(0.05 * np.random.default_rng(seed).standard_normal((3000, 3)), 0.003, seed)
        assert not choose_carried([left], DT).any


def test_what_is_known_at_a_start_does_not_come_from_later():
    left = left_by(np.ones((2000, 3)), 0.003, 1)
    carried = choose_carried([left], DT)
    assert carried.memory.all()
    later = left.copy()
    later[1001:] += 5.0
    assert np.array_equal(carried.at(left, DT)[:1001], carried.at(later, DT)[:1001])
    assert carried.at(left, DT)[1000] == pytest.approx(np.ones(3), abs=0.1)


def test_a_part_too_short_to_judge_by_carries_nothing():
    assert choose_carried([np.ones((50, 3))], DT) is NOTHING_CARRIED
    assert choose_carried([], DT) is NOTHING_CARRIED
