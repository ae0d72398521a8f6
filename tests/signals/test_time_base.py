"""The time base: interpolation, order of arrival, gaps, repeats, and clocks that jump."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.signals.stream_buffer import FAR, interpolate
from gcs_sysid.signals.time_base import TimeBase
from tests.feeding import grid_of

IMU, ATTITUDE, SPEED = ((s, "", 0) for s in (Stream.IMU, Stream.ATTITUDE, Stream.ROTOR_SPEED))
VELOCITY = (Stream.VELOCITY, "", 0)
WIDTH = {
    Stream.IMU: 6,
    Stream.ATTITUDE: 4,
    Stream.ROTOR_SPEED: 4,
    Stream.ROTOR_COMMAND: 4,
    Stream.VELOCITY: 6,
    Stream.IN_AIR: 1,
}


def cubic(t, width):
    """A different cubic in every column; of size one for t up to 10 s."""
    x = np.asarray(t)[..., None] / 10.0
    k = np.arange(1, width + 1)
    return k + k * x - 0.5 * x**2 + (k - 2.0) * x**3


def record(stream, t):
    return Record(stream, t, tuple(cubic(t, WIDTH[stream])))


def stream(kind, rate, start=0.0, end=6.0, jitter=0.0, seed=1):
    t = np.arange(start, end, 1.0 / rate)
    t = t + jitter / rate * np.random.default_rng(seed).uniform(-1, 1, len(t))
    # Stamps are whole microseconds.
    return [record(kind, round(float(x), 6)) for x in t]


def usual(rate=250.0, end=6.0, start=0.0):
    """IMU, rotor speeds and attitude as an autopilot sends them, in order of their stamps."""
    records = [
        *stream(Stream.IMU, rate, start, end),
        *stream(Stream.ROTOR_SPEED, rate, start + 0.0013, end),
        *stream(Stream.ATTITUDE, min(rate, 100.0), start + 0.0021, end),
    ]
    return sorted(records, key=lambda r: r.t)


class Run:
    """The blocks that records make, joined."""

    def __init__(self, records, tick=0.1, at_once=20):
        self.base = TimeBase(tick)
        self.blocks = list(grid_of(self.base, records, at_once))
        self.t = np.concatenate([b.t for b in self.blocks])

    def values(self, key):
        width = WIDTH[key[0]]
        return np.concatenate(
            [b.values.get(key, np.full((len(b.t), width), np.nan)) for b in self.blocks]
        )


@cache
def run_of_usual():
    return Run(usual())


def same(a, b):
    np.testing.assert_array_equal(a.t, b.t)
    for key in (IMU, ATTITUDE, SPEED):
        np.testing.assert_array_equal(a.values(key), b.values(key))


@pytest.mark.parametrize("rate", [20.0, 50.0, 250.0])
def test_grid_is_uniform_at_the_imus_rate(rate):
    records = stream(Stream.IMU, rate, end=8.0, jitter=0.1)
    run = Run(records)
    # The median of jittered intervals.
    assert run.base.dt == pytest.approx(1.0 / rate, rel=0.05)
    np.testing.assert_allclose(np.diff(run.t), run.base.dt, rtol=0.0, atol=1e-9)
    assert run.t[0] == records[0].t
    assert records[-1].t - run.t[-1] < run.base.dt
    assert [b.fresh for b in run.blocks] == [True] + [False] * (len(run.blocks) - 1)


@pytest.mark.parametrize("rate", [20.0, 100.0, 250.0])
def test_interpolation_is_exact_for_cubics(rate):
    records = [
        *stream(Stream.IMU, rate, jitter=0.2),
        *stream(Stream.ATTITUDE, min(rate, 100.0), start=-0.05, end=6.2, jitter=0.2, seed=2),
    ]
    run = Run(sorted(records, key=lambda r: r.t))
    inside = (run.t > 0.2) & (run.t < 5.8)
    for key in (IMU, ATTITUDE):
        expected = cubic(run.t, WIDTH[key[0]])
        # Rounding, in units of values up to six.
        assert np.abs(run.values(key) - expected)[inside].max() < 1e-12


@pytest.mark.parametrize(("lost", "most"), [(0, 1.0), (1, 1.05), (2, 1.2), (4, 1.5), (10, 1.5)])
def test_bridging_lost_samples_multiplies_little_noise(lost, most):
    t = np.delete(np.arange(60), slice(30, 30 + lost)).astype(float)
    grid = np.linspace(29.0, 30.0 + lost, 41)
    # Each sample's share in each value: noise of 1 in all of them makes their length.
    shares = interpolate(t, np.eye(len(t)), grid, gap=20.0, among=FAR)
    noise = np.linalg.norm(shares, axis=1)
    assert noise.max() <= most + 1e-9
    cubic = t**3 - 70.0 * t**2
    assert shares @ cubic == pytest.approx(grid**3 - 70.0 * grid**2)


def test_no_other_samples_are_taken_beyond_a_gap():
    t = np.delete(np.arange(30.0), [10, 11, 12, 13, 16, 17])
    shares = interpolate(t, np.eye(len(t)), np.array([12.0]), gap=5.0, among=FAR)[0]
    assert set(t[shares != 0.0]) == {7.0, 9.0, 14.0, 18.0}
    beyond = interpolate(t, np.eye(len(t)), np.array([12.0]), gap=2.5, among=FAR)[0]
    assert np.isnan(beyond).all()


@pytest.mark.slow
@settings(max_examples=4)
@given(delays=st.lists(st.floats(0.0, 0.015), min_size=1, max_size=50))
def test_order_between_streams_does_not_matter_within_the_lag(delays):
    """The grid stays 40 ms behind: two attitudes at 100 Hz (20 ms) and 15 ms of delay fit in."""
    records = usual(end=2.0)
    arrival = [
        r.t + (0.0 if r.stream is Stream.IMU else delays[i % len(delays)])
        for i, r in enumerate(records)
    ]
    # Each stream keeps its own order.
    latest = dict.fromkeys(Stream, 0.0)
    for i, r in enumerate(records):
        latest[r.stream] = arrival[i] = max(arrival[i], latest[r.stream])
    order = sorted(range(len(records)), key=lambda i: arrival[i])
    last = records[-1].t - 0.06  # at the end there is no later sample to wait for
    straight, mixed = Run(records), Run([records[i] for i in order])
    upto = straight.t < last
    np.testing.assert_array_equal(mixed.t[: upto.sum()], straight.t[upto])
    for key in (IMU, ATTITUDE, SPEED):
        n = upto.sum()
        np.testing.assert_array_equal(mixed.values(key)[:n], straight.values(key)[:n])


def odd(seed):
    """All at once: losses, disorder, repeats, silence, spikes, a slow stream, a reboot."""
    rng = np.random.default_rng(seed)
    rate = float(rng.choice([100.0, 250.0]))
    sent = [
        *usual(rate, end=9.0),
        *stream(Stream.VELOCITY, float(rng.choice([4.0, 30.0])), 0.0007, 9.0),
        *stream(Stream.ROTOR_COMMAND, 45.0, 1.003, 9.0),
    ]
    came = [(r.t + 0.03 * rng.random() ** 4, r) for r in sent if rng.random() > 0.05]
    records = [r for _, r in sorted(came, key=lambda pair: pair[0])]
    for i in rng.integers(0, len(records), 20).tolist():
        spoilt = (*(10.0 * x for x in records[i].values[:3]), *records[i].values[3:])
        records[i] = records[i]._replace(values=spoilt)
    records = [r for r in records for _ in range(1 + (rng.random() < 0.02))]
    records = [r for r in records if not 3.0 < r.t < 3.0 + 0.3 * seed]
    stuck = next(r for r in records if r.stream is Stream.ROTOR_SPEED and r.t > 8.0)
    records = [
        r._replace(values=stuck.values) if r.stream is stuck.stream and 8.0 < r.t < 8.5 else r
        for r in records
    ]
    return [*records, *usual(rate, end=3.0)]


@cache
def one_by_one(seed):
    records = odd(seed)
    return records, Run(records, at_once=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [5, *(pytest.param(seed, marks=pytest.mark.thorough) for seed in (0, 1, 2, 3, 4, 6, 7))]
)
@pytest.mark.parametrize("at_once", [7, 300, 10**6])
def test_how_samples_are_cut_does_not_matter(seed, at_once):
    """Not even where something is unusual: to the last bit, and in every count."""
    records, one = one_by_one(seed)
    cut = Run(records, at_once=at_once)
    np.testing.assert_array_equal(one.t, cut.t)
    for key in {key for block in one.blocks for key in block.values}:
        np.testing.assert_array_equal(one.values(key), cut.values(key))
    for name in ("late", "repeated", "restarts", "faults", "wild_speeds", "still_speeds", "dt"):
        assert getattr(one.base, name) == getattr(cut.base, name), name
    assert one.base.still_speeds > 0
    assert one.base.restarts >= 1


@pytest.mark.slow
def test_gap_of_one_stream_is_marked_and_the_others_go_on():
    records = [r for r in usual() if r.stream is not Stream.ATTITUDE or not 2.0 < r.t < 2.5]
    run, whole = Run(records), run_of_usual()
    missing = np.isnan(run.values(ATTITUDE)).any(axis=1) & ~np.isnan(whole.values(ATTITUDE)).any(
        axis=1
    )
    gone = run.t[missing]
    # The last one before lies at 1.9921 + 0.0..0.01, the next after at 2.5 + 0.0021.
    assert 1.99 < gone.min() < 2.01
    assert 2.49 < gone.max() < 2.51
    assert len(gone) == pytest.approx(0.5 * 250, abs=4)
    np.testing.assert_array_equal(run.values(IMU), whole.values(IMU))
    np.testing.assert_allclose(
        run.values(ATTITUDE)[~missing & (run.t > 0.1)],
        whole.values(ATTITUDE)[~missing & (run.t > 0.1)],
        rtol=0.0,
        atol=1e-5,  # beside the gap a straight line instead of the cubic
    )
    assert run.base.restarts == 0


def lossy(share=0.2, scatter=0.02, seed=5):
    """What comes of a flight over a link that loses a fifth and mixes up the rest."""
    rng = np.random.default_rng(seed)
    sent = [*usual(100.0), *stream(Stream.VELOCITY, 50.0, 0.0007, 6.0)]
    came = [(r.t + scatter * rng.random(), r) for r in sent if rng.random() >= share]
    return [r for _, r in sorted(came, key=lambda pair: pair[0])]


@cache
def run_of_lossy(share):
    return Run(lossy(share))


@pytest.mark.slow
@pytest.mark.parametrize(("tick", "share"), [(0.001, 0.2), (0.3, 0.5)])
def test_what_is_bridged_does_not_depend_on_when_it_is_asked_for(tick, share):
    often, usually = Run(lossy(share), tick, at_once=1), run_of_lossy(share)
    upto = usually.t < 5.7
    for key in (IMU, ATTITUDE, VELOCITY):
        np.testing.assert_array_equal(often.values(key)[: upto.sum()], usually.values(key)[upto])


@pytest.mark.slow
@pytest.mark.parametrize("lost", [1, 4, 6])
def test_velocity_is_carried_over_lost_samples(lost):
    records = [*usual(), *stream(Stream.VELOCITY, 50.0, 0.0007, 6.0)]
    gone = (3.0, 3.0 + 0.02 * lost)
    came = [
        (r.t + (0.02 if r.stream is Stream.VELOCITY else 0.0), r)
        for r in records
        if r.stream is not Stream.VELOCITY or not gone[0] < r.t < gone[1]
    ]
    run = Run([r for _, r in sorted(came, key=lambda pair: pair[0])])
    inside = (run.t > 0.1) & (run.t < 5.9)
    assert np.abs(run.values(VELOCITY) - cubic(run.t, 6))[inside].max() < 1e-3


def test_a_velocity_that_is_gone_holds_nothing_up():
    records = [*usual(), *stream(Stream.VELOCITY, 50.0, 0.0007, 3.0)]
    base = TimeBase()
    behind = []
    for r in sorted(records, key=lambda r: r.t):
        behind += [(r.t, r.t - block.t[-1]) for block in grid_of(base, [r], finish=False)]
    late = [lag for t, lag in behind if t > 3.4]
    assert late
    assert max(late) < 0.06


def test_commands_come_with_their_own_stamps():
    """By which two streams of the same commands are told apart; nothing before the first."""
    commands = stream(Stream.ROTOR_COMMAND, 50.0, 0.208)
    run = Run(sorted([*stream(Stream.IMU, 50.0), *commands], key=lambda r: r.t))
    stamps = np.concatenate([b.stamps[Stream.ROTOR_COMMAND, "", 0] for b in run.blocks])
    early = run.t < 0.207
    assert np.isnan(stamps[early]).all()
    np.testing.assert_allclose((run.t - stamps)[~early], 0.012, atol=1e-6)


@pytest.mark.slow
def test_repeated_samples_are_dropped_and_counted():
    records = usual()
    doubled = [r for r in records for _ in range(2)]
    run = Run(doubled)
    same(run, run_of_usual())
    assert run.base.repeated == len(records)
    assert run_of_usual().base.repeated == 0


def test_imu_samples_that_swapped_places_are_no_reboot():
    records = stream(Stream.IMU, 250.0)
    records[700], records[701] = records[701], records[700]
    run = Run(records)
    assert run.base.restarts == run.base.repeated == 0
    same(run, Run(stream(Stream.IMU, 250.0)))


@pytest.mark.parametrize(("silence", "restarts"), [(0.9, 0), (1.5, 1)])
def test_imu_silence_of_more_than_a_second_starts_anew(silence, restarts):
    records = [r for r in usual() if not 3.0 < r.t < 3.0 + silence]
    run = Run(records)
    assert run.base.restarts == restarts
    assert sum(b.fresh for b in run.blocks) == 1 + restarts
    inside = (run.t > 3.01) & (run.t < 2.99 + silence)
    if restarts:
        assert not inside.any()
    else:
        assert inside.any()
        assert np.isnan(run.values(IMU)[inside]).all()
    after = run.t > 3.1 + silence
    assert np.isfinite(run.values(IMU)[after]).all()
    assert after.sum() > 100


@pytest.mark.parametrize("back_to", [0.0, 2.0])
def test_reboot_starts_anew_at_the_new_time(back_to):
    before, after = usual(end=4.0), usual(start=back_to, end=back_to + 3.0)
    run = Run([*before, *after])
    assert run.base.restarts == 1
    (at,) = [k for k, b in enumerate(run.blocks) if b.fresh and k]
    # 64 samples are needed to learn the step.
    assert run.blocks[at].t[0] == pytest.approx(back_to, abs=65 / 250)
    times = np.concatenate([b.t for b in run.blocks[at:]])
    tail = np.concatenate([b.values[IMU] for b in run.blocks[at:]])
    assert np.abs(tail - cubic(times, 6)).max() < 1e-9
    assert times[-1] == pytest.approx(back_to + 3.0, abs=0.01)


def test_a_clock_that_is_set_after_two_samples_makes_no_points_in_between():
    """GPS sets Unix time when it finds it: years after the first stamps."""
    run = Run([*stream(Stream.IMU, 250.0, 0.0, 0.008), *usual(start=3e7, end=3e7 + 2.0)])
    assert run.t[0] >= 3e7
    assert len(run.t) > 400


@pytest.mark.parametrize(("first", "second"), [(250.0, 100.0), (100.0, 250.0), (50.0, 20.0)])
def test_grid_follows_a_change_of_rate_before_flight(first, second):
    records = [*stream(Stream.IMU, first, end=4.0), *stream(Stream.IMU, second, 4.0, 12.0)]
    run = Run(records)
    assert run.base.dt == pytest.approx(1.0 / second, rel=1e-6)
    assert run.base.restarts == 1
    last = run.t > 10.0
    np.testing.assert_allclose(np.diff(run.t[last]), 1.0 / second, rtol=0.0, atol=1e-9)
    assert np.abs(run.values(IMU)[last] - cubic(run.t[last], 6)).max() < 1e-9


class Flown(Run):
    """A run of which so many seconds are flight when it begins."""

    def __init__(self, records, seconds):
        self.base = TimeBase()
        self.blocks = []
        for block in grid_of(self.base, records, 20):
            self.base.flown = seconds
            self.blocks.append(block)
        self.t = np.concatenate([b.t for b in self.blocks])


@pytest.mark.parametrize(
    ("first", "second", "seconds", "kept"),
    [
        (250.0, 100.0, 60.0, True),
        (250.0, 50.0, 5.0, True),
        (100.0, 250.0, 60.0, True),
        (50.0, 250.0, 20.0, False),  # four seconds bring as many samples at the new rate
        (250.0, 20.0, 60.0, True),  # too slow to go on with, but a minute is not given up
        (250.0, 20.0, 5.0, False),
    ],
)
def test_a_change_of_rate_in_flight_gives_up_no_more_than_it_brings(first, second, seconds, kept):
    records = [*stream(Stream.IMU, first, end=4.0), *stream(Stream.IMU, second, 4.0, 12.0)]
    run = Flown(records, seconds)
    assert run.base.dt == pytest.approx(1.0 / (first if kept else second), rel=1e-6)
    assert run.base.restarts == (0 if kept else 1)
    usable = second > 20.0 or not kept
    assert run.base.is_usable == usable
    last = (run.t > 8.0) & (run.t < 11.7)  # 64 samples later
    values = run.values(IMU)[last]
    if usable:
        assert np.abs(values - cubic(run.t[last], 6)).max() < 1e-9
    else:  # samples stand alone in their gaps
        assert np.isnan(values).any(axis=1).mean() > 0.8


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_step_is_the_usual_interval_where_samples_are_skipped(seed):
    """PX4 leaves out up to 2 % of them, a bad link more; the stamps stay on whole steps."""
    rng = np.random.default_rng(seed)
    records = [r for r in stream(Stream.IMU, 250.0) if rng.random() > 0.1]
    run = Run(records)
    assert run.base.dt == 0.004
    assert run.base.restarts == 0
    inside = (run.t > run.t[0] + 0.05) & (run.t < 5.9)
    assert np.abs(run.values(IMU) - cubic(run.t, 6))[inside].max() < 1e-4


def test_step_is_the_mean_of_intervals_that_alternate():
    """ArduPilot's 250 Hz leave on a loop of 400: after 2.5 and 5 ms by turns."""
    ticks = np.floor(np.arange(0.0, 6.0, 0.004) / 0.0025).astype(int)
    records = [record(Stream.IMU, round(0.0025 * float(k), 6)) for k in ticks]
    run = Run(records)
    assert run.base.dt == pytest.approx(0.004, rel=0.02)
    assert run.base.restarts == 0
    inside = (run.t > 0.05) & (run.t < 5.9)
    assert np.abs(run.values(IMU) - cubic(run.t, 6))[inside].max() < 1e-9


def test_states_hold_their_last_value():
    states = [Record(Stream.IN_AIR, t, (v,)) for t, v in ((0.5, 0.0), (2.0, 1.0), (3.0, 0.0))]
    run = Run(sorted([*stream(Stream.IMU, 100.0), *states], key=lambda r: r.t))
    held = run.values((Stream.IN_AIR, "", 0))[:, 0]
    assert np.isnan(held[run.t < 0.5]).all()
    np.testing.assert_array_equal(
        held[run.t >= 0.5], (run.t >= 2.0 - 1e-9)[run.t >= 0.5] & (run.t < 3.0 - 1e-9)[run.t >= 0.5]
    )


@pytest.mark.slow
def test_nothing_comes_out_without_an_imu_and_memory_stays_bounded():
    base = TimeBase()
    assert not list(grid_of(base, stream(Stream.ATTITUDE, 1000.0, end=7.0)))
    assert len(base._buffers[ATTITUDE]) < 5000
