"""A log's records in whole windows, or cut anywhere, give the same."""

from itertools import groupby, pairwise

import numpy as np
import pytest

from gcs_sysid.model.airframe import ScaleReference, load_airframe
from gcs_sysid.session.analysis import take_log
from gcs_sysid.session.chain import Chain, ChainOptions
from gcs_sysid.session.origin import Origin
from gcs_sysid.signals.columns import IntakeEvent, RecordBlock, Track
from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.telemetry.logs import open_log
from gcs_sysid.telemetry.tlog import read_tlog
from gcs_sysid.telemetry.tlog_writer import TlogWriter, reset_mark

pytestmark = pytest.mark.slow

MEMS = ("--noise", "mems", "--rate", "250")


def analyzed(path, airframe, *, windows, mass=None, history=None):
    """The result, the chain, and the blocks of samples that it learnt from."""
    anchor = None if mass is None else ScaleReference("mass", mass)
    options = ChainOptions(history_interval=history)
    log = open_log(path)
    chain = Chain(load_airframe(airframe), options, anchor, Origin(log, str(path)))
    take, grid = chain.take, []
    chain.observers.append(grid.append)
    if not windows:
        chain.take = lambda window: [take(part) for part in in_parts(window)]
    take_log(chain, log)
    return chain.finish(), chain, grid


def in_parts(window):
    """A window cut anywhere, as frames come over a link: a few at a time."""
    rng = np.random.default_rng(1)
    orders = np.unique(np.concatenate([[0], *(track.order for track in window.tracks)]))
    cuts = orders[np.cumsum(rng.integers(1, 40, len(orders))) % len(orders)]
    cuts = np.unique([0, *cuts, orders[-1] + 1])
    for first, stop in pairwise(cuts.tolist()):
        tracks = (track.between(first, stop) for track in window.tracks)
        parameters = tuple(told for told in window.parameters if first <= told[0] < stop)
        yield RecordBlock(tuple(track for track in tracks if len(track.t)), parameters)


class Counted(tuple):
    """A tuple that counts how often it is gone through."""

    times = 0

    def __iter__(self):
        Counted.times += 1
        return super().__iter__()


def test_parameters_cost_no_time_for_each_window():
    order = np.arange(0, 4000, 4)
    track = Track(Stream.IMU, 0.01 * order, np.zeros((1000, 6)), order=order)
    told = [(n, Record(Stream.PARAMETER, 0.01 * n, ("NAME", 1.0))) for n in range(1, 4000, 4)]
    events = [(n, IntakeEvent(0.01 * n, "reset", "")) for n in range(2, 4000, 40)]
    block = RecordBlock((track,), Counted(told), Counted(events))
    Counted.times = 0
    windows = list(block.windows())
    assert Counted.times < 10
    assert [entry for window in windows for entry in window.parameters] == told
    assert [event for window in windows for event in window.events] == events
    assert np.concatenate([part.order for w in windows for part in w.tracks]).tolist() == [*order]
    assert all(len(window.parameters) <= 1 for window in windows)
    known = [(window.events[0][0], window.tracks) for window in windows if window.events]
    assert all(part.order[0] > number for number, tracks in known for part in tracks)


def assert_same_grid(blocks, others):
    """What the estimator is given is the same to the last bits."""
    for name in ("t", "flying"):
        whole, cut = (np.concatenate([getattr(b, name) for b in some]) for some in (blocks, others))
        np.testing.assert_array_equal(whole, cut)
    for name in ("gyro", "speeds", "force", "velocity", "apart", "rates", "attitude"):
        whole, cut = (
            np.concatenate([getattr(b.samples, name) for b in some]) for some in (blocks, others)
        )
        # The complementary filter's sums are grouped by blocks.
        np.testing.assert_allclose(
            whole, cut, rtol=0.0, atol=1e-13 if name in ("rates", "attitude") else 0.0
        )
    sources = [
        [b.rotors and (b.rotors.name, b.rotors.why) for b in some] for some in (blocks, others)
    ]
    assert [key for key, _ in groupby(sources[0])] == [key for key, _ in groupby(sources[1])]


def assert_same(result, other, *, share=1e-5):
    assert result.verdict == other.verdict
    said, expected = dict(result.telemetry), dict(other.telemetry)
    turned, as_expected = said.pop("imu_rotation", None), expected.pop("imu_rotation", None)
    assert said == expected
    assert (turned is None) == (as_expected is None)
    for name in turned or ():
        np.testing.assert_allclose(turned[name], as_expected[name], rtol=share, atol=1e-12)
    assert len(result.segments) == len(other.segments)
    assert [e["kind"] for e in result.events] == [e["kind"] for e in other.events]
    for event, told in zip(result.events, other.events, strict=True):
        assert event["t"] == pytest.approx(told["t"], abs=0.1)
    for name, value in result.parameters.items():
        expected = other.parameters[name]
        assert value.status == expected.status, name
        if expected.value is not None:
            near = pytest.approx(expected.value, abs=share * (expected.std or 0.0), rel=1e-9)
            assert value.value == near, name
            assert value.std == pytest.approx(expected.std, rel=max(share, 1e-3)), name


ALL_AXES = ("--mission", "all-axes", "--duration", "25")
FLIGHTS = {
    "sound": ALL_AXES,
    "ground and two flights": (*ALL_AXES, "--trap", "ground=6", "--trap", "flights=2"),
    "a mass step": (*ALL_AXES, "--mass-step", "15:1.2"),
    "a reboot": (*ALL_AXES, "--trap", "reboot=12"),
    "skipped samples": (*ALL_AXES, "--trap", "skips"),
    "ArduPilot": (*ALL_AXES, "--autopilot", "ardupilot"),
}


@pytest.mark.parametrize(
    "name",
    [
        "a mass step",
        *(
            pytest.param(name, marks=pytest.mark.thorough)
            for name in FLIGHTS
            if name != "a mass step"
        ),
    ],
)
def test_windows_give_what_parts_give(fly, name):
    flight = fly(*MEMS, *FLIGHTS[name], "--rate", "50", "--seed", "3")
    result, _, grid = analyzed(flight.tlog, "paper", windows=True)
    other, _, same_grid = analyzed(flight.tlog, "paper", windows=False)
    assert_same(result, other)
    assert_same_grid(grid, same_grid)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["ardupilot-sitl.tlog", "px4-esc-cg.tlog", "px4-sih-default.ulg"])
def test_windows_of_recorded_flights(shared_logs, name):
    airframe, mass = ("px4-quad-x", 1.5) if "ardupilot" in name else ("px4-sih", 1.0)
    path = shared_logs / name
    result, _, grid = analyzed(path, airframe, windows=True, mass=mass)
    other, _, same_grid = analyzed(path, airframe, windows=False, mass=mass)
    assert_same(result, other)
    assert_same_grid(grid, same_grid)
    assert len(grid) < 0.1 * len(same_grid)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("after", [10001, 10017, 10050])
def test_a_reset_falls_between_the_same_samples(fly, tmp_path, after):
    flight = fly(*MEMS, *FLIGHTS["sound"], "--seed", "3")
    frames = list(read_tlog(flight.tlog))
    path = tmp_path / "reset.tlog"
    with TlogWriter(path) as writer:
        for number, (time_us, frame) in enumerate(frames):
            if number == after:
                writer.write(time_us, [reset_mark()])
            writer.write(time_us, [frame])
    result, chain, _ = analyzed(path, "paper", windows=True)
    assert_same(result, analyzed(path, "paper", windows=False)[0])
    seconds = 1e-6 * (frames[-1][0] - frames[after][0])
    assert 10.0 < chain.fit.seconds < seconds < 20.0


@pytest.mark.thorough
def test_the_course_in_windows_is_that_of_parts(fly):
    flight = fly(*MEMS, *FLIGHTS["a mass step"], "--seed", "4")
    histories = [
        analyzed(flight.tlog, "paper", windows=windows, history=0.1)[1].history
        for windows in (True, False)
    ]
    now, before = histories
    assert len(now.t) == len(before.t) > 200
    assert now.t == pytest.approx(before.t, abs=1e-9)
    for name in ("Ixx", "Izz", "k_M", "mass"):
        late = now.t > 10.0
        assert now.value[name][late] == pytest.approx(
            before.value[name][late], rel=1e-4, nan_ok=True
        )
