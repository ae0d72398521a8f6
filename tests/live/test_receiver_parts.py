"""The pieces of a receiver's process: what it says, what it may ask, what it keeps waiting."""

import io
import os

import pytest

from gcs_sysid.live import receiver_main, receiver_process
from gcs_sysid.live.live_view import Backlog
from gcs_sysid.live.receiver_main import Outbox, RequestsDone
from gcs_sysid.live.receiver_process import RelayedRequests
from gcs_sysid.live.reception import (
    Ended,
    Failure,
    RecordingCut,
    RecordingReport,
    ResetMark,
    Toggled,
)
from gcs_sysid.telemetry.frames import read_frame
from gcs_sysid.telemetry.outgoing import Gate, NotAllowedError
from gcs_sysid.telemetry.signing import Refusal
from gcs_sysid.telemetry.tlog import TlogReader
from gcs_sysid.telemetry.transceiver import LinkReport, ReceivedFrames, Rival
from testbed.payloads import unpack

HERE = ("10.0.0.1", 14550)


@pytest.fixture
def frames(paper_flight):
    return [frame for _, frame in TlogReader(paper_flight.tlog)][:50]


def test_items_and_figures_arrive_as_they_were(frames):
    said = [
        ReceivedFrames(1_750_000_000_000_000, frames), ResetMark(7), RecordingCut(),
        Toggled("recording to ünüsual.tlog"), Failure("a defect"), Ended(),
    ]  # fmt: skip
    report = receiver_process.Report(
        LinkReport(
            breaks=2, dropped=3, rival=Rival((1, 1), HERE, ("10.6.6.6", 666)),
            accepted=4, refused={Refusal.WRONG_KEY: 5},
        ),
        RecordingReport(active=True, path="a.tlog", lines=("recorded to b.tlog",)), 6, ("told",),
    )  # fmt: skip
    pipe = io.BytesIO(b"".join(map(receiver_process.packed, (*said, report))))
    assert [receiver_process.read_message(pipe).content for _ in (*said, report)] == [*said, report]
    assert receiver_process.read_message(pipe) is None


@pytest.fixture
def relay():
    """A session's end, the vehicle's, and what was sent."""
    sent = []
    done = RequestsDone(Gate(sent.append))
    return RelayedRequests(done.ask), done, sent


def test_what_a_session_asks_goes_through_the_gate(relay):
    told, _, sent = relay
    told.heartbeat()
    told.version = 1
    told.set_message_interval((1, 1), 105, 4000)
    told.request_group((1, 1), 1, 50)
    told.read_parameter((1, 1), "SIH_MASS")
    frames = [read_frame(raw) for raw in sent]
    assert [frame.message_id for frame in frames] == [0, 76, 66, 20]
    assert [frame.version for frame in frames] == [2, 1, 1, 1]


@pytest.mark.parametrize(
    ("name", "arguments"),
    [("set_message_interval", ((0, 0), 105, 4000)), ("request_group", ((1, 1), 0, 50))],
)
def test_the_gate_refuses_there_what_it_refuses_here(relay, name, arguments):
    told, _, sent = relay
    with pytest.raises(NotAllowedError):
        getattr(told, name)(*arguments)
    assert sent == []


@pytest.mark.parametrize("name", ["send", "signing", "_command"])
def test_nothing_else_can_be_asked(relay, name):
    _, done, sent = relay
    with pytest.raises(KeyError):
        done.ask(name, 2, (1, 1), 400, 1)
    assert sent == []


def test_rates_that_are_asked_for_are_given_back(relay):
    told, done, sent = relay
    for message_id in (105, 30, 291):
        told.set_message_interval((1, 1), message_id, 4000)
    told.set_message_interval((1, 1), 30, 0)
    told.set_message_interval((1, 1), 32, 20000, 20408)
    told.set_message_interval((1, 1), 245, 500000, -1)
    told.set_message_interval((1, 1), 245, -1, -1)
    del sent[:]
    done.restore()
    done.restore()
    restored = [unpack(76, read_frame(raw).payload) for raw in sent]
    # Said twice: nobody is there to say it again.
    assert [(f["param1"], f["param2"]) for f in restored] == [(105, 0), (291, 0), (32, 20408)] * 2


@pytest.fixture
def outgoing():
    """Both ends of a pipe: where it is read, and where an outbox writes."""
    reads, writes = os.pipe()
    with os.fdopen(reads, "rb") as pipe, os.fdopen(writes, "wb", buffering=0) as out:
        yield pipe, out


def test_a_session_that_does_not_take_costs_it_data_and_not_the_recording(
    frames, outgoing, monkeypatch
):
    """Beyond some room frames are counted, and everything else waits."""
    pipe, out = outgoing
    outbox = Outbox(out)
    size = sum(len(frame.raw) for frame in frames)
    monkeypatch.setattr(receiver_main, "MOST_WAITING", 200_000)
    some = 400_000 // size
    outbox.put_items([ReceivedFrames(n, frames) for n in range(1, some + 1)])
    assert 0 < outbox.withheld < some * len(frames)
    outbox.put_items([RecordingCut(), Ended()])
    got = []
    while not got or not isinstance(got[-1], Ended):
        got.append(receiver_process.read_message(pipe).content)
    outbox.close()
    handed = sum(len(item.frames) for item in got if isinstance(item, ReceivedFrames))
    assert handed + outbox.withheld == some * len(frames)
    assert [type(item) for item in got[-2:]] == [RecordingCut, Ended]


def test_an_outbox_whose_reader_is_gone_waits_for_nobody(frames, outgoing):
    pipe, out = outgoing
    outbox = Outbox(out)
    pipe.close()
    outbox.put_items([ReceivedFrames(1, frames)])
    outbox.close()


class Source:
    """What a backlog looks at."""

    waiting, withheld, link_report = 0.0, 0, LinkReport()


def test_slowness_is_told_once_and_its_end_too():
    source = Source()
    backlog = Backlog(source)
    told, idle = [], []
    for now, waiting in enumerate([0.0, 0.4, 1.2, 3.0, 0.5, 0.09, 0.4]):
        source.waiting = waiting
        told += backlog.look(float(now))
        idle.append(backlog.is_idle)
    assert idle == [True, False, False, False, False, False, False]
    assert told[0].startswith("the computer is too slow: 1.2 s of data wait")
    assert told[1] == "caught up after 3.0 s, 3.0 s behind at most"
    assert len(told) == 2
    assert backlog.as_dict(9.0) == {
        "kernel_drops": 0, "longest_wait": 3.0, "too_slow_seconds": 3.0, "not_learnt": 0,
    }  # fmt: skip
    assert backlog.reasons == ()


def test_what_is_lost_for_want_of_speed_is_a_reason():
    source = Source()
    backlog = Backlog(source)
    source.withheld, source.link_report = 12, LinkReport(dropped=34)
    assert len(backlog.look(0.0)) == 1
    assert backlog.look(1.0) == []
    first, second = backlog.reasons
    assert first.startswith("12 messages were not used")
    assert second.startswith("the system dropped 34 datagrams")
