"""A log's records in whole windows, or cut anywhere, give the same."""

from itertools import groupby, pairwise

import numpy as np
import pytest

from gcs_sysid.model.airframe import ScaleReference, load_airframe
from gcs_sysid.session.analysis import take_log
from gcs_sysid.session.chain import Chain, ChainOptions
from gcs_sysid.session.origin import Origin
from gcs_sysid.signals.columns import RecordBlock
from gcs_sysid.telemetry.logs import open_log

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
    others = [number for number, _ in (*window.parameters, *window.events)]
    orders = np.unique(np.concatenate([[0], others, *(track.order for track in window.tracks)]))
    cuts = orders[np.cumsum(rng.integers(1, 40, len(orders))) % len(orders)]
    cuts = np.unique([0, *cuts, orders[-1] + 1]).astype(int)
    for first, stop in pairwise(cuts.tolist()):
        tracks = (track.between(first, stop) for track in window.tracks)
        parameters, events = (
            tuple(told for told in some if first <= told[0] < stop)
            for some in (window.parameters, window.events)
        )
        yield RecordBlock(tuple(track for track in tracks if len(track.t)), parameters, events)


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
    for what in ("imu_rotation", "rotor_offsets"):
        found, as_expected = said.pop(what, None), expected.pop(what, None)
        assert (found is None) == (as_expected is None)
        for name in found or ():
            # An angle about one axis may be next to none of that about another.
            near = share * float(np.max(np.abs(as_expected[name])))
            np.testing.assert_allclose(found[name], as_expected[name], rtol=0.0, atol=near)
    assert said == expected
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


@pytest.mark.thorough  # one in `make test`: test_size_of_blocks_does_not_matter of test_chain
@pytest.mark.parametrize("name", FLIGHTS)
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
