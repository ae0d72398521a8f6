"""Whatever comes and whatever fails: memory stays bounded, the recording whole."""

import gc
import random
import struct
import threading
import time
import tracemalloc
import weakref
from collections import deque

import pytest
from fastcrc import crc16

from gcs_sysid.errors import InputError
from gcs_sysid.live.flight_coach import Coach, CoachOptions
from gcs_sysid.live.live_estimate import Duty, LiveOptions
from gcs_sysid.live.live_session import LiveSession
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.results.snapshot import LinkState
from gcs_sysid.telemetry import tlog_writer
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.link import Link, ReceivedBytes
from gcs_sysid.telemetry.tlog import TlogReader
from gcs_sysid.telemetry.urls import LinkUrl

MEGABYTE = 2**20
AT_ONCE = 1000


class FakeLink(Link):
    """Datagrams as a test lays them ready."""

    datagrams = True

    def __init__(self):
        super().__init__(LinkUrl("udpin", "udpin:nowhere"))
        self.ready = deque()
        self.sent = 0
        self._arrived = threading.Event()  # never: it only waits

    def receive(self, timeout):
        if not self.ready and timeout:
            self._arrived.wait(min(timeout, 0.005))
        return [self.ready.popleft() for _ in range(len(self.ready))]

    def send(self, data):
        self.sent += 1

    def close(self):
        self.ended = True


def frame(message_id, payload, system=1, component=1, sequence=0, extra=None):
    """A frame of version 2, of any type and sender."""
    message = mavlink.mavlink_map.get(message_id)
    if extra is None:
        extra = 0 if message is None else message.crc_extra
    head = struct.pack("<BBBBBB", len(payload), 0, 0, sequence % 256, system, component)
    body = head + message_id.to_bytes(3, "little") + payload
    return b"\xfd" + body + crc16.mcrf4xx(body + bytes([extra])).to_bytes(2, "little")


PACKER = mavlink.MAVLink(None)


def packed(message, **sender):
    """A frame of the dialect."""
    raw = bytes(message.pack(PACKER))
    return frame(message.get_msgId(), raw[10:-2], **sender)


BEAT = bytes(mavlink.MAVLink_heartbeat_message(2, 12, 128, 0, 4, 3).pack(PACKER))[10:-2]


def heartbeat(**sender):
    return frame(0, BEAT, **sender)


def imu(time_us, rng, **sender):
    values = [rng.gauss(0.0, 1.0) for _ in range(6)]
    return packed(
        mavlink.MAVLink_highres_imu_message(
            time_us, *values, 0.0, 0.0, 0.0, 1013.0, 0.0, 0.0, 20.0, 63, 0
        ),
        **sender,
    )


def senders(rng, n):
    """Every (sysid, compid) that there is, all of them autopilots."""
    return heartbeat(system=n >> 8 & 255, component=n & 255, sequence=n)


def types(rng, n):
    """A new message type each time, in the vehicle's name."""
    return frame(100_000 + n, rng.randbytes(8), sequence=n)


def parameters(rng, n):
    name = f"P{n}".encode()
    return packed(mavlink.MAVLink_param_value_message(name, float(n), 9, 65535, 1), sequence=n)


def texts(rng, n):
    return packed(mavlink.MAVLink_statustext_message(2, f"text {n}".encode()), sequence=n)


def stamps(rng, n):
    """The clock jumps about: outages, reboots, wraps, microseconds and years."""
    far = rng.choice([0, 1, 1000, 900_000, 2**32 - 1, 2**40, 2**60])
    return imu((10**7 + n * rng.choice([1, 4000]) + far) % 2**64, rng, sequence=n)


def crowded(rng, n):
    """An IMU that claims a sample each microsecond, then most of a second at once."""
    return imu(10**7 + n + 900_000 * (n // 100), rng, sequence=n)


def rotors(rng, n):
    """Speeds of rotors that nobody has, the IMU being silent."""
    speeds = [rng.randrange(9000) for _ in range(4)]
    message = mavlink.MAVLink_esc_status_message(n % 256, 10**7 + n, speeds, [0.0] * 4, [0.0] * 4)
    return packed(message, sequence=n)


def landings(rng, n):
    """In the air, on the ground, by turns."""
    return packed(mavlink.MAVLink_extended_sys_state_message(0, 1 + n % 2), sequence=n)


def garbage(rng, n):
    return rng.randbytes(rng.randrange(1, 80))


def scraps(rng, n):
    """Frames cut short, and headers that promise more than comes."""
    whole = imu(10**7 + n, rng, sequence=n)
    return whole[: rng.randrange(1, len(whole))]


# Some cost more to take, and more to make.
COUNTS = {"senders": 66_000, "parameters": 4000}


@pytest.fixture
def session():
    """Not running: the tests drive its rounds themselves."""
    link = FakeLink()
    session = LiveSession(link, load_airframe("paper"), LiveOptions(duration=1e9))
    session._publish(LinkState.WAITING)
    link.ready.append(ReceivedBytes(heartbeat(), ("10.0.0.1", 14550)))
    rounds(session)
    session.link = link
    return session


@pytest.fixture
def traced():
    """Memory is counted, also what a session has from its start and gives up later."""
    gc.collect()
    tracemalloc.start()
    yield
    tracemalloc.stop()


def rounds(session):
    """What the session's thread does, once."""
    session._turn(session._source.next_items(0.0), time.monotonic())
    session._publish(LinkState.CONNECTED)


def flood(session, link, make, count, rng):
    """Send so many; the most memory in use afterwards beyond what there was, bytes, by halves."""
    grown = []
    before = tracemalloc.get_traced_memory()[0]
    for start in range(0, count, AT_ONCE):
        link.ready.extend(
            ReceivedBytes(make(rng, n), (f"10.0.{n >> 8 & 255}.{n & 255}", 1024 + n % 60_000))
            for n in range(start, min(start + AT_ONCE, count))
        )
        rounds(session)
        grown.append(tracemalloc.get_traced_memory()[0] - before)
    half = len(grown) // 2
    return max(grown[:half]), max(grown[half:])


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [
        *(
            pytest.param(make, marks=pytest.mark.thorough)
            for make in (senders, types, crowded, landings, garbage, stamps, texts, scraps, rotors)
        ),
        parameters,
    ],
    ids=lambda make: make.__name__,
)
def test_memory_stays_flat_whatever_comes(traced, session, make):
    rng = random.Random(3)
    count = COUNTS.get(make.__name__, 4000)
    first, second = flood(session, session.link, make, count, rng)
    # What is kept is kept by then: the second half adds nothing, and all of it is little.
    assert second < first + 0.3 * MEGABYTE
    assert second < 48 * MEGABYTE  # a grid of 10 kHz takes most, and what loads only then
    assert session.problem is None
    assert session._estimate.duty is Duty.IDENTIFY


def test_wishes_wait_in_a_bounded_queue(session):
    for n in range(64):
        session.mark(f"mark {n}")
    with pytest.raises(InputError, match="busy"):
        session.mark("one more")
    with pytest.raises(InputError, match="busy"):
        session.toggle_recording()


def test_a_recording_that_is_being_started_is_not_stopped_by_haste(session, monkeypatch, tmp_path):
    """Both presses would be told that it starts."""
    monkeypatch.chdir(tmp_path)
    assert session.toggle_recording().startswith("recording to")
    with pytest.raises(InputError, match="try again"):
        session.toggle_recording()
    session._commands.grant(session._estimate.note)
    session._turn(session._source.next_items(0.0), time.monotonic())
    assert session.toggle_recording().endswith("stopped")
    session._source.close()


def recorded(path):
    return [frame.raw for _, frame in TlogReader(path)]


def flown(link, count, start=0):
    """Lay ready what a vehicle sends; the frames."""
    rng = random.Random(5)
    raws = [heartbeat(sequence=start)]
    raws += [imu(10**7 + 4000 * n, rng, sequence=n) for n in range(start + 1, start + count)]
    link.ready.extend(ReceivedBytes(raw, ("10.0.0.1", 14550)) for raw in raws)
    return raws


def until(session, said):
    """Wait until a running session shows something."""
    for _ in range(3000):
        if said(session.latest()) or session.join(0.01):
            break
    assert said(session.latest()), session.latest()


@pytest.fixture
def running(tmp_path):
    """A session on a fake link that records; stopped in the end."""
    link = FakeLink()
    session = LiveSession(link, load_airframe("paper"), LiveOptions(), tmp_path / "flight.tlog")
    yield session, link, tmp_path / "flight.tlog"
    session.stop()


def broken(*_arguments, **_named):
    raise ZeroDivisionError("a defect")


@pytest.mark.parametrize(
    ("where", "name", "watched"),
    [
        ("chain", "take", True),
        ("chain", "result", True),
        ("intake", "block", False),
        ("intake", "health", False),
    ],
)
def test_a_defect_costs_the_estimate_and_not_the_recording(running, where, name, watched):
    """The flight goes on being recorded, and being asked for as far as that can be told."""
    session, link, path = running
    session.start()
    first = flown(link, 50)
    until(session, lambda s: s.link.received == 50)
    setattr(getattr(session._estimate, where), name, broken)
    second = flown(link, 50, start=50)
    until(session, lambda s: any("a defect" in event.text for event in s.events))
    third = flown(link, 50, start=100)
    if watched:
        until(session, lambda s: s.link.received >= 100)  # some of the second may not be counted
        asked = link.sent
        until(session, lambda s: link.sent > asked)  # heartbeats, at least
    for _ in range(6000):
        if not link.ready:
            break
        session.join(0.01)
    session.stop()
    assert recorded(path) == first + second + third
    assert isinstance(session.problem, ZeroDivisionError)
    assert link.ended
    latest = session.latest()
    assert latest.link.state is LinkState.ENDED
    told = [event.text for event in latest.events if "a defect" in event.text]
    assert told[0].startswith("internal error (ZeroDivisionError: a defect): the estimate ends")
    assert any("its last good one" in reason for reason in session.final.reasons)
    assert session.recordings() == [f"recorded to {path}"]


def test_an_ended_session_leaves_nothing_for_the_garbage_collector(tmp_path, monkeypatch):
    """Its estimator has tens of megabytes, which must not wait for a collection."""
    link = FakeLink()
    options = LiveOptions(coach=CoachOptions(), predict=True)
    session = LiveSession(link, load_airframe("paper"), options, tmp_path / "own.tlog")
    chain = weakref.ref(session._estimate.chain)
    # Its coach is in the middle of a thought.
    monkeypatch.setattr(Coach, "look", lambda _: None)
    monkeypatch.setattr(Coach, "think", lambda _: None)
    session._estimate._coach._begin(chain().fit, {"Ixx": None, "Iyy": None})
    gc.collect()
    gc.disable()
    try:
        session.start()
        flown(link, 50)
        until(session, lambda shown: shown.link.received >= 50)
        session.stop()
        del session
        assert chain() is None
    finally:
        gc.enable()


def test_what_a_user_asks_for_may_be_defective(running):
    session, link, _ = running
    session.start()
    flown(link, 50)
    until(session, lambda s: s.link.received == 50)
    session._estimate.chain.reset = broken
    session.reset()
    until(session, lambda s: any("not done: internal error" in e.text for e in s.events))
    flown(link, 50, start=50)
    until(session, lambda s: s.link.received == 100)
    session.stop()
    assert isinstance(session.problem, ZeroDivisionError)


def test_a_disk_that_does_not_answer_stalls_neither_link_nor_screen(running, monkeypatch):
    """Neither while frames come, nor when the user stops a recording and starts another."""
    session, link, _ = running
    answers = threading.Event()
    real = tlog_writer.io.FileIO.write

    class Stuck(tlog_writer.io.FileIO):
        def write(self, data):
            assert answers.wait(60.0)
            return real(self, data)

    monkeypatch.setattr(tlog_writer, "open_file", Stuck)
    session.start()
    flown(link, 50)
    until(session, lambda s: s.link.received == 50)
    session.toggle_recording()
    until(session, lambda s: not s.link.recording)
    said = session.toggle_recording()
    until(session, lambda s: s.link.recording)
    raws = flown(link, 50, start=50)
    until(session, lambda s: s.link.received == 100)
    answers.set()
    session.stop()
    second = said.removeprefix("recording to ")
    assert recorded(second) == raws
    assert session.final.telemetry.get("recording") is None
    assert len(session.recordings()) == 2
