"""Recorded flights sent again are identified live as `analyze` identifies them.

The sender is held back by what the session has taken, not by a clock.
"""

import contextlib
import math
import os
import threading
from dataclasses import dataclass

import pytest

from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.live import LiveOptions, LiveSession
from gcs_sysid.telemetry.link import SerialLink, TcpLink, UdpLink
from gcs_sysid.telemetry.tlog import read_tlog
from gcs_sysid.telemetry.urls import LinkUrl
from sim_bridge.links import open_link
from sim_bridge.playback import play

LISTEN = LiveOptions(listen_only=True, refit_interval=10.0)
LONGEST = 300.0
"""s; a session that has not ended by then never will."""
IN_FLIGHT = 100
"""Datagrams sent and not yet taken: what the smallest receive buffer holds."""


class Counted(UdpLink):
    """Tells how many datagrams were taken off it."""

    def __init__(self):
        super().__init__(LinkUrl("udpin", "udpin:127.0.0.1", host="127.0.0.1", port=0))
        self.taken = 0
        self.more = threading.Condition()

    def receive(self, timeout):
        chunks = super().receive(timeout)
        with self.more:
            self.taken += len(chunks)
            self.more.notify_all()
        return chunks


class AsTaken:
    """Waits for the other side instead of the clock; notes the times asked for."""

    def __init__(self, link):
        self.link = link
        self.times = []

    def wait(self, flown):
        self.times.append(flown)
        with self.link.more:
            there = self.link.more.wait_for(
                lambda: len(self.times) - self.link.taken < IN_FLIGHT, LONGEST
            )
        assert there, "datagrams were lost"


class AtOnce:
    """Never waits: a stream of bytes holds its sender back by itself."""

    def wait(self, flown):
        pass


@dataclass(frozen=True)
class Sender:
    """What plays, and the session's end of the link."""

    link: object
    url: str
    pace: object


def pty_pair(closing):
    """Two serial ports with a wire from the first to the second."""
    (one, port_one), (two, port_two) = os.openpty(), os.openpty()
    name = os.ttyname(port_two)
    link = SerialLink(LinkUrl("serial", name, device=name, baud=921600))

    def wire():
        with contextlib.suppress(OSError):  # the sender has closed its port
            while data := os.read(one, 4096):
                while data:
                    data = data[os.write(two, data) :]

    thread = threading.Thread(target=wire, daemon=True)
    thread.start()

    def close():
        os.close(port_one)
        thread.join(LONGEST)
        for end in (one, two, port_two):
            os.close(end)

    closing.append(close)
    return Sender(link, os.ttyname(port_one), AtOnce())


@pytest.fixture(params=["udp", "tcp", "serial"])
def sender(request):
    closing = []
    if request.param == "udp":
        link = Counted()
        made = Sender(link, f"udpout:127.0.0.1:{link.port}", AsTaken(link))
    elif request.param == "tcp":
        link = TcpLink(LinkUrl("tcpin", "tcpin:127.0.0.1", host="127.0.0.1", port=0))
        made = Sender(link, f"tcp:127.0.0.1:{link.port}", AtOnce())
    else:
        if not hasattr(os, "openpty"):
            pytest.skip("no pseudo terminals here")
        made = pty_pair(closing)
    yield made
    made.link.close()
    for close in closing:
        close()


def live(sender, recording, airframe, path=None):
    """Play a recording to a live session that only listens; its final result."""
    sent = threading.Event()
    session = LiveSession(sender.link, airframe, LISTEN, path, sender_gone=sent.is_set)
    session.start()
    out = open_link(sender.url, 115200)
    play(read_tlog(recording), out, sender.pace)
    sent.set()
    ended = session.join(LONGEST)
    out.close()
    session.stop()
    assert ended
    assert session.problem is None
    return session.final


def numbers(value, name=""):
    """All numbers in a result's JSON by where they stand."""
    if isinstance(value, dict):
        parts = [(f"{name}.{key}", inner) for key, inner in value.items()]
    elif isinstance(value, list):
        parts = [(f"{name}[{i}]", inner) for i, inner in enumerate(value)]
    else:
        return {name: value}
    return {k: v for at, inner in parts for k, v in numbers(inner, at).items()}


ONLY_THERE = {".source", ".telemetry.clock_drift_ppm"}
"""The one differs by its nature, the other is told by the recording's own times alone."""


def assert_same(first, second):
    a, b = numbers(first.as_json()), numbers(second.as_json())
    assert a.keys() - ONLY_THERE == b.keys() - ONLY_THERE
    for name in a.keys() - ONLY_THERE:
        x, y = a[name], b[name]
        if isinstance(x, float) and isinstance(y, float):
            assert math.isclose(x, y, rel_tol=1e-9, abs_tol=0.0), (name, x, y)
        else:
            assert x == y, name


def test_a_recording_played_over_any_link_gives_the_same_numbers(sender, paper_flight, tmp_path):
    airframe, path = load_airframe("paper"), tmp_path / "again.tlog"
    final = live(sender, paper_flight.tlog, airframe, path)
    assert final.verdict == "identified"
    assert_same(final, analyze_log(paper_flight.tlog, airframe))
    assert_same(final, analyze_log(path, airframe))
    before, after = ([f.raw for _, f in read_tlog(p)] for p in (paper_flight.tlog, path))
    assert before == after


RECORDED = {
    "px4-sih-default.tlog": ("px4-sih", 1.0),
    "ardupilot-sitl.tlog": ("ardupilot-quad-x", 1.6),
}


@pytest.mark.slow
@pytest.mark.parametrize("sender", ["udp"], indirect=True)
@pytest.mark.parametrize(("name", "vehicle"), RECORDED.items(), ids=RECORDED.keys())
def test_recorded_flights_of_real_autopilots_give_live_what_analyze_gives(
    sender, name, vehicle, shared_logs
):
    airframe = load_airframe(vehicle[0]).with_anchor("mass", vehicle[1])
    final = live(sender, shared_logs / name, airframe)
    assert final.telemetry["used_seconds"] > 100.0
    assert_same(final, analyze_log(shared_logs / name, airframe))
    span = [time_us for time_us, _ in read_tlog(shared_logs / name)]
    assert sender.pace.times[-1] == pytest.approx(1e-6 * (span[-1] - span[0]), abs=1e-3)
