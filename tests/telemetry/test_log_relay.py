"""A log that another process reads is the log itself, at every moment and however that one ends."""

import copy
import os
import threading

import numpy as np
import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.telemetry import tlog
from gcs_sysid.telemetry.log_relay import LogFigures, ObjectSender, RelayedLog, read_object, relayed
from gcs_sysid.telemetry.logs import open_log

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def small_windows(monkeypatch):
    monkeypatch.setattr(tlog, "WINDOW", 2**16)


@pytest.fixture
def pipe():
    """Both ends of one."""
    ours, theirs = os.pipe()
    with os.fdopen(ours, "rb") as source, os.fdopen(theirs, "wb") as sink:
        yield source, sink


def figures_of(log):
    """What a log says of itself now, as plain data."""
    figures = vars(copy.deepcopy(LogFigures.of(log)))
    return {**figures, "drift": vars(figures["drift"])}


def blocks_of(log):
    """(figures, arrays, parameters, events) of each block, then the figures at the end."""
    out = []
    for block in log.blocks():
        arrays = [(track.key, track.t, track.values, track.order) for track in block.tracks]
        out.append((figures_of(log), arrays, block.parameters, block.events))
    return [*out, (figures_of(log), [], (), ())]


def assert_same(one, other):
    assert len(one) == len(other)
    for mine, others in zip(one, other, strict=True):
        assert (mine[0], mine[2:]) == (others[0], others[2:])
        for (key, *arrays), (other_key, *other_arrays) in zip(mine[1], others[1], strict=True):
            assert key == other_key
            for a, b in zip(arrays, other_arrays, strict=True):
                np.testing.assert_array_equal(a, b)
                assert (a.dtype, a.strides, a.flags.writeable) == (b.dtype, b.strides, True)


def read_by_another(path, pipe, wanted=None):
    """The relayed log of a thread that reads."""
    source, sink = pipe

    def read():
        sender = ObjectSender(sink)
        for _ in relayed(open_log(path, wanted), sender):
            sender.wait(2)
        sender.close()

    thread = threading.Thread(target=read)
    thread.start()
    found = blocks_of(RelayedLog(path, wanted, lambda: read_object(source)))
    thread.join()
    return found


@pytest.mark.parametrize("wanted", [None, (77, None)])
def test_blocks_and_figures_are_those_of_the_log(paper_flight, pipe, wanted):
    here = blocks_of(open_log(paper_flight.tlog, wanted))
    assert len(here) > 5
    assert_same(read_by_another(paper_flight.tlog, pipe, wanted), here)


@pytest.mark.parametrize(
    "name",
    [
        "public/real-quad-copter33.bin",
        "public/px4-sitl.ulg",
        "real/LOG00269.BFL",
        "ap_euler_two_flights.tlog",
    ],
)
def test_likewise_of_every_kind_of_log(shared_logs, pipe, name):
    path = shared_logs / name
    assert_same(read_by_another(path, pipe), blocks_of(open_log(path)))


def ended():
    """What comes of a process that is gone."""
    raise EOFError


@pytest.mark.parametrize("parts", [0, 1, 2, 7])
def test_what_another_process_did_not_read_is_read_here(paper_flight, parts):
    here = blocks_of(open_log(paper_flight.tlog))
    kept = Kept()
    for _ in relayed(open_log(paper_flight.tlog), kept):
        pass
    left = iter(kept.parts[:parts])
    there = RelayedLog(paper_flight.tlog, None, lambda: next(left, None) or ended())
    assert_same(blocks_of(there), here)


class Kept:
    """In place of a sender."""

    def __init__(self):
        self.parts = []

    def put(self, part):
        self.parts.append(copy.deepcopy(part))


def test_what_the_other_cannot_read_is_an_error_here(paper_flight):
    answers = iter([InputError("cannot read it")])
    with pytest.raises(InputError, match="cannot read it"):
        next(RelayedLog(paper_flight.tlog, None, lambda: next(answers)).blocks())


def test_an_object_cut_short_is_an_end(pipe):
    source, sink = pipe
    sender = ObjectSender(sink)
    sender.put(np.arange(100.0))
    sender.close()
    whole = source.peek()
    assert read_object(source).tolist() == [*range(100)]
    ours, theirs = os.pipe()
    with os.fdopen(ours, "rb") as cut:
        os.write(theirs, whole[:-1])
        os.close(theirs)
        with pytest.raises(EOFError):
            read_object(cut)


def test_a_sender_whose_reader_is_gone_says_so_and_waits_no_more(pipe):
    source, sink = pipe
    source.close()
    sender = ObjectSender(sink)
    sender.put(1)
    sender.wait(0)
    with pytest.raises(BrokenPipeError):
        sender.put(2)
    sender.close()
