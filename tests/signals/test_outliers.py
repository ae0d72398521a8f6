"""Outliers of the gyro: found and replaced, and nothing else touched."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gcs_sysid.signals.inertial_stream import AHEAD, BEHIND, JOLT, Standstill, despiked


def times(n, rate, jitter=0.0, seed=0):
    t = np.arange(n) / rate
    return t + jitter / rate * np.random.default_rng(seed).uniform(-1.0, 1.0, n)


def noise(n, sigma, seed=1):
    return sigma * np.random.default_rng(seed).normal(size=(n, 3))


def multisine(t):
    """What the article's missions fly: 0.3 to 2.7 Hz on every axis."""
    phases = np.random.default_rng(2).uniform(0.0, 2.0 * np.pi, (3, 9))
    tones = 2.0 * np.pi * np.arange(0.3, 2.8, 0.3)
    return 0.45 * np.sin(t[:, None, None] * tones + phases).sum(axis=2)


def doublets(t, size, rise):
    """Hard left, hard right, every two seconds; the rates change within `rise` seconds."""
    phase = t % 2.0
    knots = [0.0, 0.5, 0.5 + rise, 0.9, 0.9 + 2 * rise, 1.3, 1.3 + rise, 2.0]
    wave = np.interp(phase, knots, [0.0, 0.0, size, size, -size, -size, 0.0, 0.0])
    return np.stack([wave, np.roll(wave, 7), np.roll(wave, 13)], axis=1)


def run(t, x, rate):
    return despiked(t, x, max(2.6 / rate, 0.03), JOLT / rate)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [20.0, 50.0, 100.0, 250.0, 400.0])
@pytest.mark.parametrize("sigma", [0.0, 0.002, 0.02, 0.3])
@pytest.mark.parametrize("jitter", [0.0, 0.25])
def test_flight_and_noise_are_left_alone(rate, sigma, jitter):
    t = times(int(60 * rate), rate, jitter)
    vibrating = (
        0.5 * np.ones(3) * np.sin(2.0 * np.pi * 87.3 * t)[:, None] * (t % 10.0 > 5.0)[:, None]
    )
    for motion in (multisine(t), doublets(t, 3.0, 0.15), vibrating):
        x = motion + noise(len(t), sigma)
        cleaned, spikes = run(t, x, rate)
        # Vibration that begins out of nothing may cost its first sample, here on three axes.
        assert np.count_nonzero(spikes) <= 3 * (motion is vibrating)
        np.testing.assert_array_equal(cleaned[~spikes], x[~spikes])


@pytest.mark.parametrize(
    ("rate", "size"),
    # At 20 Hz the motion itself takes turns of up to 1 rad/s from sample to sample.
    [(20.0, 8.0), (20.0, 35.0), (50.0, 3.0), (50.0, 8.0), (250.0, 1.0), (250.0, 8.0)],
)
def test_spikes_are_found_and_replaced(rate, size):
    t = times(int(60 * rate), rate)
    clean = multisine(t) + noise(len(t), 0.01)
    rng = np.random.default_rng(3)
    struck = rng.random(clean.shape) < 0.004
    struck[:BEHIND] = struck[-AHEAD:] = False
    x = clean + np.where(struck, size * rng.choice([-1.0, 1.0], clean.shape), 0.0)
    cleaned, spikes = run(t, x, rate)
    assert np.mean(spikes[struck]) > (0.85 if rate == 20.0 else 0.94)
    assert np.count_nonzero(spikes & ~struck) <= 0.03 * np.count_nonzero(struck)
    # A cubic through the neighbors: noise, and what 2.7 Hz does between 50 ms.
    assert np.nanmax(np.abs(cleaned - clean)[spikes]) < (0.5 if rate == 20.0 else 0.08)


def test_spikes_side_by_side_and_in_turn():
    t = times(400, 250.0)
    clean = multisine(t) + noise(len(t), 0.002)
    for places, second in (([200, 201], -12.0), ([200, 201], 9.0), ([200, 202], 7.0)):
        x = clean.copy()
        x[places, 1] += [9.0, second]
        cleaned, spikes = run(t, x, 250.0)
        assert spikes[places, 1].all()
        assert not spikes[:, [0, 2]].any()
        np.testing.assert_allclose(cleaned, clean, atol=0.02)


def test_noise_that_begins_is_no_row_of_spikes():
    t = times(1000, 250.0)
    x = noise(1000, 0.01)
    x[500:] *= 200.0
    assert np.count_nonzero(run(t, x, 250.0)[1]) <= 2


def test_a_spike_beside_a_gap_goes_missing():
    t = times(200, 250.0)
    t[101:] += 1.0
    x = noise(200, 0.01)
    x[100, 0] = 9.0
    # Beside the gap only one side can speak, which is not enough; next to it both can.
    assert not run(t, x, 250.0)[1].any()
    x[100, 0], x[98, 0] = x[99, 0], 9.0
    cleaned, spikes = run(t, x, 250.0)
    assert np.argwhere(spikes).tolist() == [[98, 0]]
    assert abs(cleaned[98, 0]) < 0.1


@settings(max_examples=30, deadline=None)
@given(start=st.integers(0, 500), length=st.integers(1, 60), seed=st.integers(0, 5))
def test_a_verdict_rests_on_so_many_samples_around_alone(start, length, seed):
    rng = np.random.default_rng(seed)
    t = times(700, 250.0, 0.2, seed)
    x = multisine(t) + noise(700, 0.05, seed)
    x[rng.random(x.shape) < 0.03] += 7.0
    cleaned, spikes = run(t, x, 250.0)
    first, last = max(start - BEHIND, 0), start + length + AHEAD
    part, found = run(t[first:last], x[first:last], 250.0)
    inside = slice(start - first, start - first + length)
    np.testing.assert_array_equal(part[inside], cleaned[start : start + length])
    np.testing.assert_array_equal(found[inside], spikes[start : start + length])


def test_what_stands_still_repeats_all_columns():
    x = noise(40, 1.0)
    x[32] = x[31]
    x[33, 0] = x[32, 0]
    x[35:37] = [1.0, np.nan, np.nan]
    standstill = Standstill(3)
    t, parts = times(40, 500.0), (slice(32), slice(32, 36), slice(36, None))
    found = np.concatenate([standstill.update(t[part], x[part]) for part in parts])
    assert np.flatnonzero(found).tolist() == [32, 36]


def test_without_noise_values_stand_from_one_step_of_their_format_to_the_next():
    t = times(2000, 500.0)
    x = 0.1 * np.round(multisine(t) / 0.1)
    assert (np.diff(x, axis=0) == 0.0).all(axis=1).mean() > 0.6
    assert Standstill(3).update(t, x).mean() < 0.001
    assert Standstill(3).update(t, np.repeat(x[::8], 8, axis=0)).mean() > 0.6
    x[800:] = x[800] = x[799] + 0.1  # it stops one step on: a second shows that it did
    stands = Standstill(3).update(t, x)[800:]
    assert stands[501:].all()
    assert not stands[:500].any()


QUIET = 0.01 * np.resize([1.0, -1.0, 0.5, -0.5, 0.8, -1.2, 0.3], 140)
"""What disagreements are usual: a pattern without chance."""


def struck(size, at=100, rest=QUIET):
    x = rest[:, None].copy()
    x[at] += size
    return x
