"""Links that come back, by an invented clock and over real sockets and pseudo terminals."""

import os

import pytest

from gcs_sysid.errors import LinkError
from gcs_sysid.telemetry.link import Link, PersistentLink, ReceivedBytes, open_link
from gcs_sysid.telemetry.outgoing import Gate
from gcs_sysid.telemetry.transceiver import Receiver
from gcs_sysid.telemetry.urls import LinkUrl


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        assert seconds >= 0.0
        self.now += max(seconds, 1e-3)


class Plug(Link):
    """Gives what it was made with, and then ends."""

    def __init__(self, *pieces):
        super().__init__(LinkUrl("serial", "/dev/x", device="/dev/x", baud=57600))
        self.pieces = list(pieces)
        self.sent = []
        self.closed = False

    def receive(self, _timeout):
        assert not self.ended
        if self.pieces:
            return [ReceivedBytes(self.pieces.pop(0), None)]
        self.ended = True
        self.breaks += 1
        return []

    def send(self, data):
        self.sent.append(data)

    def close(self):
        self.closed = True


@pytest.fixture
def clock():
    return Clock()


def persistent(first, plugs, clock):
    """`plugs`: what each attempt to open finds; None fails."""
    tries = []

    def reopen(_url):
        tries.append(clock.now)
        plug = plugs.pop(0) if plugs else None
        if plug is None:
            raise LinkError("no such device")
        return plug

    return PersistentLink(first, reopen, clock, clock.sleep), tries


def test_all_that_arrives_before_and_after_is_given(clock):
    first, second = Plug(b"one", b"two"), Plug(b"three")
    link, _ = persistent(first, [None, None, second], clock)
    got = []
    while clock.now < 110.0:
        got += [chunk.data for chunk in link.receive(0.05)]
        clock.now += 0.01
    assert got == [b"one", b"two", b"three"]
    assert first.closed
    assert link.breaks == 2
    assert not link.ended


def test_attempts_grow_rarer_but_not_too_rare(clock):
    link, tries = persistent(Plug(), [], clock)
    while clock.now < 160.0:
        link.receive(0.05)
        clock.now += 0.001
    pauses = [b - a for a, b in zip([100.0, *tries], tries, strict=False)]
    assert pauses[0] == pytest.approx(PersistentLink.FIRST_PAUSE, abs=0.06)
    assert pauses == pytest.approx(sorted(pauses), abs=0.06)
    assert max(pauses) == pytest.approx(PersistentLink.LONGEST_PAUSE, abs=0.06)
    assert len(tries) > 10


def test_one_that_hangs_up_at_once_every_time_is_called_ever_more_rarely(clock):
    silent = [Plug() for _ in range(8)]
    link, tries = persistent(Plug(), [*silent, Plug(b"one"), Plug()], clock)
    while len(tries) < 10:
        link.receive(0.05)
        clock.now += 0.001
    pauses = [b - a for a, b in zip([100.0, *tries], tries, strict=False)]
    assert pauses[:4] == pytest.approx(
        [PersistentLink.FIRST_PAUSE * 2**n for n in range(4)], abs=0.1
    )
    assert max(pauses) == pytest.approx(PersistentLink.LONGEST_PAUSE, abs=0.1)
    assert pauses[9] == pytest.approx(PersistentLink.FIRST_PAUSE, abs=0.1)  # data came


def test_what_is_sent_while_it_is_gone_is_lost_and_what_it_dropped_is_known(clock):
    second = Plug(b"x")
    second.dropped = 3
    link, _ = persistent(Plug(), [second], clock)
    link.receive(0.05)
    link.send(b"lost")
    while not link.open:
        link.receive(0.05)
    link.send(b"kept")
    assert second.sent == [b"kept"]
    link.receive(0.05)
    assert link.dropped == 3


def test_a_frame_cut_off_is_not_continued_by_the_next_connection(clock, stream):
    data, frames = stream
    half = len(frames[0].raw) // 2
    link, _ = persistent(Plug(data[:half]), [Plug(data)], clock)
    receiver = Receiver(link)
    got = []
    while clock.now < 103.0:
        got += receiver.poll(0.05)
        clock.now += 0.01
    assert got == frames
    assert receiver.garbage_bytes == half


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo terminals here")
def test_a_serial_port_pulled_out_and_plugged_in_again(clock, stream, tmp_path):
    data, expected = stream
    name = tmp_path / "ttyTest"

    def plug_in():
        vehicle, port = os.openpty()
        name.symlink_to(os.ttyname(port))
        return vehicle, port

    vehicle, port = plug_in()
    url = LinkUrl("serial", str(name), device=str(name), baud=921600)
    with PersistentLink(open_link(url), clock=clock, sleep=clock.sleep) as link:
        receiver = Receiver(link)
        for _ in range(2):
            os.close(port)
            got = []
            for at in range(0, len(data), 512):
                os.write(vehicle, data[at : at + 512])
                got += receiver.poll(0.01)
            got += until(receiver, lambda more, got=got: len(got) + len(more) >= len(expected))
            assert got == expected
            Gate(link.send).heartbeat()
            assert os.read(vehicle, 100)[0] == 0xFD
            breaks = link.breaks
            os.close(vehicle)
            name.unlink()
            until(receiver, lambda _, breaks=breaks: link.breaks > breaks)
            link.send(b"into the void")
            for _ in range(100):
                assert receiver.poll(0.01) == []
            vehicle, port = plug_in()
            until(receiver, lambda _: link.open)
        os.close(vehicle)
        os.close(port)


def until(receiver, done):
    got = []
    for _ in range(2000):
        got += receiver.poll(0.005)
        if done(got):
            return got
    pytest.fail("did not happen")
