"""Both smoothers: any grouping of samples, missing samples, and what rows hold."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gcs_sysid.signals.smoothers import (
    DAMPING,
    DifferentiatorSmoother,
    LinearDifferentiator,
    WindowSmoother,
    cosine_window,
    noise_gains,
)

DT = 0.02
N = 400
HALF = 9
BANDWIDTH = 12.0


def make(kind):
    return WindowSmoother(DT, HALF) if kind == "window" else DifferentiatorSmoother(DT, BANDWIDTH)


KINDS = pytest.mark.parametrize("kind", ["window", "td"])


def signals(missing=()):
    v = np.random.default_rng(1).normal(size=(N, 3)).cumsum(axis=0)
    for sample, column in missing:
        v[sample, column] = np.nan
    return v


def rows_of(kind, v, cuts=()):
    """Averages and derivatives."""
    smoother = make(kind)
    edges = [0, *sorted(cuts), len(v)]
    parts = [smoother.update(v[a:b], 0) for a, b in pairwise(edges)]
    return (
        np.concatenate([p.average for p in parts]),
        np.concatenate([p.derivative for p in parts]),
    )


def test_window_rows_are_the_window_at_every_step():
    v = signals()
    window, step = cosine_window(HALF, DT), max(1, HALF // 4)
    assert make("window").step == step == 2
    average, derivative = rows_of("window", v)
    starts = range(0, N - window.length + 1, step)
    assert len(average) == len(starts)
    for taps, rows in ((window.average, average), (window.derivative, derivative)):
        expected = np.array([taps @ v[k : k + window.length] for k in starts])
        np.testing.assert_allclose(rows, expected, rtol=0.0, atol=1e-11 * np.abs(v).max())


def test_differentiator_rows_are_the_filter_at_every_step():
    v = signals()
    filter_ = LinearDifferentiator(DT, BANDWIDTH, DAMPING)
    smoother = make("td")
    assert smoother.step == round(0.25 / (BANDWIDTH * DT)) == 1
    slow = DifferentiatorSmoother(DT, 2.0)
    assert slow.step == 6
    for s, bandwidth in ((smoother, BANDWIDTH), (slow, 2.0)):
        expected = LinearDifferentiator(DT, bandwidth, DAMPING).update(v)
        settled = np.arange(N) >= LinearDifferentiator(DT, bandwidth, DAMPING).settling - 1
        rows = s.update(v, 0)
        found = rows.average, rows.derivative
        for a, b in zip(found, expected, strict=True):
            np.testing.assert_array_equal(a, np.where(settled[:, None], b, np.nan)[:: s.step])
    assert filter_.settling < N


def test_missing_samples_spoil_the_window_that_holds_them_and_no_other():
    hole = 150
    plain, holed = rows_of("window", signals()), rows_of("window", signals([(hole, 1)]))
    starts = np.arange(len(plain[0])) * 2
    touched = (starts <= hole) & (hole <= starts + 2 * HALF)
    assert touched.any()
    for a, b in zip(plain, holed, strict=True):
        np.testing.assert_array_equal(np.isnan(b[:, 1]), touched)
        np.testing.assert_array_equal(b[~touched], a[~touched])
        np.testing.assert_array_equal(b[:, [0, 2]], a[:, [0, 2]])


def test_missing_samples_spoil_the_differentiator_until_it_has_settled():
    hole = 150
    settling = LinearDifferentiator(DT, BANDWIDTH, DAMPING).settling
    plain, holed = rows_of("td", signals()), rows_of("td", signals([(hole, 1)]))
    index = np.arange(N)
    unsettled = (index < settling - 1) | ((index >= hole) & (index < hole + settling))
    jump = np.abs(np.diff(signals()[:, 1])).max()
    for a, b, unit in zip(plain, holed, (1.0, BANDWIDTH), strict=True):
        np.testing.assert_array_equal(np.isnan(b[:, 1]), unsettled)
        there = ~unsettled
        # 1e-4 of the step that the held value made.
        assert np.abs(b[there, 1] - a[there, 1]).max() < 1e-3 * jump * unit
        np.testing.assert_array_equal(b[:, [0, 2]], a[:, [0, 2]])


DELAYS = (-0.01, 0.0, 0.03)


@settings(max_examples=20, deadline=None)
@given(cuts=st.lists(st.integers(0, N), max_size=6))
def test_late_signals_are_taken_at_every_delay(cuts):
    t = np.arange(N)[:, None] * DT
    phase = np.array([0.0, 1.0, 2.0])
    stamped_late = [np.sin(3.0 * (t - delay) + phase) for delay in DELAYS]
    plain = WindowSmoother(DT, HALF, DELAYS).update(stamped_late[1], 2)
    for k, v in enumerate(stamped_late):
        smoother = WindowSmoother(DT, HALF, DELAYS)
        edges = [0, *sorted(cuts), N]
        parts = [smoother.update(v[a:b], 2) for a, b in pairwise(edges)]
        for name in ("average", "derivative"):
            late = np.concatenate([getattr(p, f"late_{name}") for p in parts], axis=1)
            assert late.shape == (len(DELAYS), len(plain.average), 2)
            # Put right by its own delay, the signal gives what it gives without any.
            expected = getattr(plain, name)[:, :2]
            np.testing.assert_allclose(late[k], expected, rtol=0.0, atol=1e-5)
            for other in set(range(len(DELAYS))) - {k}:
                assert np.abs(late[other] - expected).max() > 1e-2


@KINDS
@pytest.mark.parametrize("memory", [0.0, 0.3])
def test_noise_gains_are_those_of_white_noise(kind, memory):
    smoother = make(kind)
    rows = smoother.update(np.random.default_rng(3).standard_normal((400, 200)), 0)
    gains = noise_gains(smoother, DT, memory)
    for gain, found in zip(gains, (rows.average, rows.derivative), strict=True):
        if memory:
            summed = np.zeros_like(found)
            first = np.flatnonzero(np.isfinite(found[:, 0]))[0]
            decay = np.exp(-smoother.step * DT / memory)
            for k in range(first, len(found)):
                summed[k] = decay * summed[k - 1] + found[k]
            found = summed
        # 200 signals at one instant: their variance scatters by 10 %, over four instants by 5 %.
        late = found[[-1, -len(found) // 4, -len(found) // 3, -len(found) // 2]]
        assert np.var(late) == pytest.approx(gain, rel=0.25)
