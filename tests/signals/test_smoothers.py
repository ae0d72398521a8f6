"""Both smoothers: any grouping of samples, missing samples, and what rows hold."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gcs_sysid.signals.differentiator import LinearDifferentiator
from gcs_sysid.signals.smoothers import (
    DAMPING,
    DifferentiatorSmoother,
    WindowSmoother,
    cosine_window,
    leaky,
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


@KINDS
@settings(max_examples=40, deadline=None)
@given(
    cuts=st.lists(st.integers(0, N), max_size=10),
    missing=st.lists(st.tuples(st.integers(0, N - 1), st.integers(0, 2)), max_size=4),
)
def test_grouping_of_samples_does_not_matter(kind, cuts, missing):
    v = signals(missing)
    for whole, parts in zip(rows_of(kind, v), rows_of(kind, v, cuts), strict=True):
        # Sums of the same terms, perhaps in another order.
        np.testing.assert_allclose(parts, whole, rtol=0.0, atol=1e-11 * np.nanmax(np.abs(v)))


@KINDS
def test_one_sample_at_a_time(kind):
    v = signals([(100, 0)])
    for whole, parts in zip(rows_of(kind, v), rows_of(kind, v, range(N)), strict=True):
        np.testing.assert_allclose(parts, whole, rtol=0.0, atol=1e-11 * np.nanmax(np.abs(v)))


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


@KINDS
def test_rows_after_a_restart_are_those_of_a_new_one(kind):
    v = signals()
    smoother = make(kind)
    smoother.update(v[:101], 0)
    smoother.restart()
    again = smoother.update(v[101:], 0)
    for a, b in zip((again.average, again.derivative), rows_of(kind, v[101:]), strict=True):
        assert len(a) > 0
        np.testing.assert_array_equal(a, b)


@KINDS
def test_both_sides_agree_on_smooth_signals(kind):
    t = np.arange(600)[:, None] * DT
    w = np.sin(2.0 * t)
    average, _ = rows_of(kind, 2.0 * np.cos(2.0 * t))
    _, derivative = rows_of(kind, w)
    # The window: next to exact. The differentiator: (w dt)^2 / 12 of straight pieces.
    np.testing.assert_allclose(
        derivative, average, rtol=0.0, atol=1e-9 if kind == "window" else 1e-3
    )
    assert np.isfinite(average).sum() > 100


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
    for gain, found in zip(
        smoother.noise_gains(memory), (rows.average, rows.derivative), strict=True
    ):
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


@KINDS
def test_how_many_rows_come_is_known_before(kind):
    smoother, v = make(kind), signals()
    for start, stop in ((0, 1), (1, 30), (30, 31), (31, 60), (60, 60), (60, 300)):
        expected = smoother.count_after(stop - start)
        rows = smoother.update(v[start:stop], 0)
        assert len(rows.average) == len(rows.derivative) == expected
        assert rows.late_average.shape == (1, expected, 0)


@pytest.mark.parametrize(("half", "step"), [(2, 1), (3, 1), (7, 1), (8, 2), (20, 5)])
def test_four_rows_come_in_half_a_window(half, step):
    assert WindowSmoother(DT, half).step == step


@pytest.mark.parametrize(("bandwidth", "step"), [(12.5, 1), (1.0, 12), (2.5, 5), (100.0, 1)])
def test_four_rows_come_in_a_time_constant(bandwidth, step):
    assert DifferentiatorSmoother(DT, bandwidth).step == step


def test_the_differentiator_is_critically_damped():
    assert DAMPING == 2.0
    step = DifferentiatorSmoother(DT, BANDWIDTH)
    v = np.ones((200, 1))
    v[:100] = 0.0
    rows = step.update(v, 0).average[:, 0]
    assert np.nanmax(rows) <= 1.0 + 1e-9  # no overshoot
    assert rows[-1] == pytest.approx(1.0, abs=1e-3)


@KINDS
def test_late_taps_are_the_response_to_one_sample(kind):
    """Averages of an impulse, row by row: the taps at every step, in the order of time."""
    smoother = make(kind)
    taps = smoother.late_taps
    assert taps.shape[0] == len(smoother.delays) == 1
    at = 150
    impulse = np.zeros((N, 1))
    impulse[at] = 1.0
    settled = 0 if kind == "window" else LinearDifferentiator(DT, BANDWIDTH, DAMPING).settling
    assert at > settled
    found = make(kind).update(impulse, 1).late_average[0, :, 0]
    first = taps.shape[1] - 1 if kind == "window" else 0
    for row, value in enumerate(found):
        age = first + row * smoother.step - at
        if 0 <= age < taps.shape[1]:
            assert value == pytest.approx(taps[0, age], abs=1e-12)
        else:  # the differentiator's response is cut off where it has settled
            assert np.isnan(value) or abs(value) < 1e-4
    assert np.nanmax(found) > 0.0


def test_late_taps_are_those_of_each_delay_in_the_order_of_time():
    smoother = WindowSmoother(DT, HALF, DELAYS)
    assert smoother.late_taps.shape == (3, 2 * (HALF + 2) + 1)
    # A stamp 30 ms late: the window waits as long for it, so that it answers sooner in its row.
    t = np.arange(smoother.late_taps.shape[1])
    centers = smoother.late_taps @ t
    np.testing.assert_allclose(centers, centers[1] - np.array(DELAYS) / DT, atol=1e-6)


def test_an_empty_block_gives_no_rows():
    for kind in ("window", "td"):
        rows = make(kind).update(np.zeros((0, 3)), 2)
        assert rows.average.shape == rows.derivative.shape == (0, 3)
        assert rows.late_average.shape == rows.late_derivative.shape == (1, 0, 2)


@pytest.mark.parametrize("rows", [8, 9])
def test_few_rows_and_many_are_made_alike(rows):
    """Up to eight by one product; a column that is missing throughout spoils no other."""
    smoother = WindowSmoother(DT, HALF, DELAYS)
    n = smoother._window.length + (rows - 1) * smoother.step
    v = signals()[:n]
    v[:, 2] = np.nan
    assert smoother.count_after(n) == rows
    found = smoother.update(v, 2)
    for k in range(rows):
        part = v[k * smoother.step : k * smoother.step + smoother._window.length, :2]
        np.testing.assert_allclose(found.average[k, :2], smoother._window.average @ part)
        np.testing.assert_allclose(found.derivative[k, :2], smoother._window.derivative @ part)
        np.testing.assert_allclose(
            found.late_average[:, k], smoother.late_taps[:, ::-1] @ part, atol=1e-12
        )
    assert np.isnan(found.average[:, 2]).all()


@pytest.mark.parametrize("memory", [0.3, 1.0])
def test_a_leaky_sum_of_responses_by_the_recursion(memory):
    step, n = 3, 40
    responses = np.random.default_rng(2).normal(size=(2, n))
    found = leaky(responses, step, DT, memory)
    # Every third row is added; each adds what the one before it holds, faded.
    expected = np.zeros_like(found)
    expected[:, :n] = responses
    for k in range(step, found.shape[1]):
        expected[:, k] += np.exp(-step * DT / memory) * expected[:, k - step]
    # Twelve time constants and more are carried on: 1e-5 is left.
    np.testing.assert_allclose(found[:, :-n], expected[:, :-n], atol=1e-12)
    assert found.shape[1] * DT > 12.0 * memory
    assert leaky(responses, step, DT, 0.0) is responses
