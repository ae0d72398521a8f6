"""The recent samples of one stream: order, rate, gaps, and values in between."""

from copy import deepcopy
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gcs_sysid.signals.stream_buffer import (
    BREAK,
    FAR,
    STEP_SAMPLES,
    StreamBuffer,
    interpolate,
    neighbours,
    usual_gap,
    usual_interval,
)


def filled(times, **options):
    buffer = StreamBuffer(1, **options)
    for t in times:
        buffer.push(float(t), (float(t),))
    return buffer


def kept(buffer):
    """Times of all samples that are there."""
    t, values = buffer._arrays()
    np.testing.assert_array_equal(values[:, 0], t)
    assert len(buffer) == len(t)
    return t.tolist()


@pytest.mark.parametrize(
    ("interval", "gap"),
    [
        (0.0025, 0.04),  # never shorter than 40 ms
        (0.01, 0.052),  # four lost and a fifth of a step
        (0.012, 0.052),  # as long as that stays within 52 ms
        (0.02, 0.064),  # two lost
        (0.03, 0.078),  # one lost, always
        (0.05, 0.13),
        (0.2, 0.52),
    ],
)
def test_how_many_lost_samples_are_bridged(interval, gap):
    assert usual_gap(interval) == pytest.approx(gap + 5e-7, abs=1e-9)


def test_a_stream_may_be_told_to_bridge_more():
    buffer = filled(0.02 * np.arange(100), bridged=0.3)
    assert buffer.gap == 0.3
    assert filled(0.02 * np.arange(100), bridged=0.01).gap == pytest.approx(0.064, abs=1e-6)


def test_outer_neighbours_are_looked_for_where_gaps_are_long():
    assert neighbours(0.0701, 0.02) == FAR == 4
    assert neighbours(0.07, 0.02) == 2


@pytest.mark.parametrize(
    ("steps", "interval"),
    [
        ([0.02], 0.02),
        ([0.02] * 7 + [0.04] * 3, 0.02),  # a few are skipped
        ([0.02] * 6 + [0.04] * 4, 0.028),  # too many to be skipped: the mean of all
        ([0.0025, 0.005] * 8, 0.00375),
        ([0.016, 0.02, 0.024], 0.02),  # alike are those within a quarter
        ([0.0151, 0.02, 0.02, 0.0249], 0.02),
        ([0.02] * 8 + [0.0149, 0.0251], 0.02),
    ],
)
def test_the_usual_interval(steps, interval):
    assert usual_interval(steps) == pytest.approx(interval)


def test_the_interval_is_known_after_as_many_steps_as_it_is_taken_from():
    buffer = filled(0.02 * np.arange(STEP_SAMPLES - 1))
    assert not buffer.knows_interval
    assert not buffer.is_settled
    buffer.push(0.02 * (STEP_SAMPLES - 1), (0.0,))
    assert buffer.knows_interval
    assert buffer.is_settled
    assert buffer.interval == pytest.approx(0.02)


@pytest.mark.parametrize(("step", "settled"), [(0.0235, True), (0.025, False), (0.0155, False)])
def test_a_stream_is_settled_while_the_last_sixteen_come_at_its_rate(step, settled):
    # The interval is renewed with the sixteenth: of 64 steps, 16 are the new ones.
    times = np.cumsum([0.02] * 64 + [step] * 15)
    assert filled(times).is_settled is settled


@pytest.mark.parametrize(("lost", "kept_step"), [(0, True), (40, True), (48, False)])
def test_a_stream_keeps_its_step_while_three_in_ten_are_of_it(lost, kept_step):
    steps = np.full(64, 0.02)
    steps[:lost] = 0.05
    buffer = filled(np.cumsum(steps) + 1.0)
    assert buffer.keeps_step(0.02) is kept_step
    for near in (0.0161, 0.0266):  # within a quarter of it
        assert buffer.keeps_step(near) is kept_step
    for far in (0.0159, 0.0268):
        assert not buffer.keeps_step(far)


def test_the_interval_is_renewed_every_sixteenth_sample():
    buffer = filled(0.02 * np.arange(64))
    t = 63 * 0.02
    for k in range(1, 49):
        t += 0.04
        buffer.push(t, (0.0,))
        # With the 64th step, the 80th, the 96th: 17 of 64 are skipped, of 33 the mean counts.
        assert buffer.interval == pytest.approx(0.02 if k < 33 else (33 * 0.04 + 31 * 0.02) / 64)


def test_a_long_silence_is_no_interval_but_of_states():
    times = [*(0.02 * np.arange(20)), 0.39 + BREAK, 0.41 + BREAK]
    assert max(filled(times)._steps) < 0.03
    assert pytest.approx(BREAK + 0.01) in filled(times, hold=True)._steps
    assert BREAK == 1.0


def test_samples_that_are_late_find_their_place_and_repeated_ones_are_dropped():
    buffer = filled([1.0, 1.01, 1.03, 1.03, 1.02, 1.02, 1.01])
    assert kept(buffer) == [1.0, 1.01, 1.02, 1.03]
    assert buffer.repeated == 3
    # Before the oldest there is no place, nor far behind the newest.
    buffer.push(0.99, (0.99,))
    buffer.push(1.06, (1.06,))
    buffer.push(1.04, (1.04,))
    buffer.push(1.041, (1.041,))
    assert kept(buffer) == [1.0, 1.01, 1.02, 1.03, 1.041, 1.06]
    assert buffer.repeated == 5
    assert buffer.oldest == 1.0


def test_a_late_sample_has_room_in_arrays_that_are_full():
    buffer = filled([])
    buffer.extend(0.01 * np.arange(1, 257), 0.01 * np.arange(1.0, 257.0)[:, None])
    assert len(buffer._t) == 256
    buffer.push(2.555, (2.555,))
    assert kept(buffer)[-3:] == [pytest.approx(2.55), 2.555, pytest.approx(2.56)]
    assert len(buffer) == 257


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 50),
    cuts=st.lists(st.integers(1, 900), max_size=6),
    hold=st.booleans(),
    read=st.booleans(),
)
def test_samples_at_once_are_samples_one_by_one(seed, cuts, hold, read):
    rng = np.random.default_rng(seed)
    steps = rng.choice([0.004, 0.02, 0.021, 0.05, 1.5], 901, p=[0.1, 0.5, 0.3, 0.09, 0.01])
    t = np.cumsum(steps)
    single, blocks = StreamBuffer(1, hold=hold), StreamBuffer(1, hold=hold)
    edges = [0, *sorted(set(cuts)), len(t)]
    for k, (a, b) in enumerate(pairwise(edges)):
        for time in t[a:b].tolist():
            single.push(time, (time,))
        if k % 2 and not read:
            for time in t[a:b].tolist():
                blocks.push(time, (time,))
        else:
            assert blocks.extends(t[a:b], t[a:b, None])
            blocks.extend(t[a:b], t[a:b, None])
        assert blocks.interval == pytest.approx(single.interval, rel=1e-12)
        assert list(blocks._steps) == pytest.approx(list(single._steps))
        if read:
            single.forget_before(t[b - 1] - 0.5)
            blocks.forget_before(t[b - 1] - 0.5)
    assert kept(blocks) == kept(single)


def test_what_does_not_go_on_is_not_taken_at_once():
    buffer = filled([1.0, 1.02])
    ahead = np.array([1.04, 1.06])
    assert buffer.extends(ahead, ahead[:, None])
    assert not buffer.extends(ahead, np.zeros((2, 2)))
    assert not buffer.extends(ahead - 0.02, ahead[:, None])
    assert not buffer.extends(ahead[::-1], ahead[:, None])
    assert not buffer.extends(ahead[[0, 0]], ahead[:, None])


def test_eight_samples_stay_behind_the_grid():
    buffer = filled(0.02 * np.arange(50))
    buffer.forget_before(0.5)
    assert kept(buffer)[0] == pytest.approx(0.02 * (25 - 8))
    buffer.forget_before(0.1)  # nothing comes back, nothing more goes
    assert kept(buffer)[0] == pytest.approx(0.02 * 17)
    buffer.forget_before(99.0)
    assert len(buffer) == 8
    few = filled(0.02 * np.arange(50), keep=2)
    few.forget_before(0.5)
    assert kept(few)[0] == pytest.approx(0.02 * 23)


def test_memory_of_a_stream_that_nobody_takes_is_bounded():
    buffer = filled(0.001 * np.arange(9000))
    assert len(kept(buffer)) == 4096
    assert buffer.oldest == pytest.approx(0.001 * (9000 - 4096))
    assert len(buffer._new_t) == 0


def test_a_copy_is_filled_apart():
    buffer = filled(0.02 * np.arange(40))
    other = deepcopy(buffer)
    assert kept(other) == kept(buffer)
    other.push(0.9, (0.9,))
    other.push(0.785, (0.785,))
    assert len(other) == 42 - (0.9 - 0.785 > 0.02)
    assert len(buffer) == 40
    assert (other.interval, other.width, other.hold) == (buffer.interval, 1, False)
    assert list(buffer._steps) != list(other._steps)


def test_nothing_changes_any_more_before_the_newest_pair():
    buffer = filled(0.02 * np.arange(50))
    newest = 0.02 * 49
    # Between the last two a later sample may still have its part, as the outer neighbour.
    assert buffer.known_until(newest) == pytest.approx(newest - 0.02)
    # With a gap in between, what comes after it alone.
    split = filled([*(0.02 * np.arange(48)), 2.0])
    assert split.known_until(2.0) == 2.0
    # A stream that is silent for longer than its gap holds nothing up; nor does one without any.
    assert buffer.known_until(newest + 0.064) == pytest.approx(newest - 0.02)
    assert buffer.known_until(newest + 0.065) == np.inf
    assert filled([]).known_until(0.0) == np.inf


def test_states_hold_and_are_unknown_before_the_first():
    buffer = filled([1.0, 2.0, 4.0], hold=True)
    grid = np.array([0.5, 1.0, 1.0 - 4e-7, 1.9, 2.0, 3.9, 4.0, 9.0])
    np.testing.assert_array_equal(
        buffer.at(grid)[:, 0], [np.nan, 1.0, 1.0, 1.0, 2.0, 2.0, 4.0, 4.0]
    )
    np.testing.assert_array_equal(buffer.at(np.array([5.0, 6.0]))[:, 0], [4.0, 4.0])
    assert buffer.at(np.array([4.0])).shape == (1, 1)


def test_a_stream_without_samples_is_unknown():
    empty = StreamBuffer(3)
    assert np.isnan(empty.at(np.zeros(2))).all()
    assert empty.at(np.zeros(2)).shape == (2, 3)
    assert np.isnan(empty.stamps(np.zeros(2))).all()


def test_stamps_are_those_of_the_latest_samples():
    buffer = filled([1.0, 2.0, 4.0])
    np.testing.assert_array_equal(
        buffer.stamps(np.array([0.9, 1.0, 2.0 - 4e-7, 2.0 - 6e-7, 5.0])),
        [np.nan, 1.0, 2.0, 1.0, 4.0],
    )


def test_values_between_follow_the_streams_own_gap_unless_told():
    t = np.delete(0.02 * np.arange(100), [50, 51, 52])
    buffer = filled(t)
    grid = np.array([0.99, 1.02])
    assert np.isnan(buffer.at(grid)[1]).all()  # 80 ms are more than 64
    np.testing.assert_allclose(buffer.at(grid, gap=0.1)[:, 0], grid)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 400), among=st.sampled_from([2, 3, 4]))
def test_interpolation_by_polynomials_written_out(seed, among):
    """The cubic through two neighbours and the next on either side, one further out if near."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.choice([0.2, 1.0, 1.3, 3.0, 6.0], 14, p=[0.25, 0.4, 0.15, 0.1, 0.1]))
    v = rng.normal(size=(14, 2))
    grid = np.sort(np.append(rng.uniform(t[0] - 1.0, t[-1] + 1.0, 30), t[[3, 7]]))
    gap = 3.5
    found = interpolate(t, v, grid, gap, among)
    for x, value in zip(grid, found, strict=True):
        if (np.abs(t - x) < 5e-7).any():
            np.testing.assert_array_equal(value, v[np.argmin(np.abs(t - x))])
            continue
        right = int(np.searchsorted(t, x))
        if right in (0, len(t)) or t[right] - t[right - 1] > gap:
            assert np.isnan(value).all()
            continue
        left = right - 1
        first, last = max(left - 1, 0), min(right + 1, len(t) - 1)
        for k in range(2, among):
            # Nearer than two sevenths of the gap: one further out, unless that is too far.
            step = t[right] - t[left]
            near_left, near_right = (
                step > 3.5 * (t[left] - t[first]),
                step > 3.5 * (t[last] - t[right]),
            )
            outer = max(left - k, 0)
            if near_left and t[left] - t[outer] <= gap:
                first = outer
            outer = min(right + k, len(t) - 1)
            if near_right and t[outer] - t[right] <= gap:
                last = outer
        outside = (t[left] - t[first], t[last] - t[right])
        four = all(0.0 < width <= gap for width in outside)
        nodes = [first, left, right, last] if four else [left, right]
        shares = [np.prod([(x - t[m]) / (t[n] - t[m]) for m in nodes if m != n]) for n in nodes]
        np.testing.assert_allclose(value, np.array(shares) @ v[nodes], rtol=1e-7, atol=1e-9)


def test_two_samples_are_the_least():
    grid = np.array([0.0, 0.5, 1.0])
    assert np.isnan(interpolate(np.zeros(1), np.zeros((1, 2)), grid, 2.0)).all()
    two = interpolate(np.array([0.0, 1.0]), np.array([[1.0], [3.0]]), grid, 1.0)
    np.testing.assert_allclose(two[:, 0], [1.0, 2.0, 3.0])
    apart = interpolate(np.array([0.0, 1.0]), np.array([[1.0], [3.0]]), grid, 0.99)
    np.testing.assert_allclose(apart[:, 0], [1.0, np.nan, 3.0])
