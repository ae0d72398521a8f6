"""What keeps the data of a fast link waiting: turns of a session are kept short."""

import subprocess
import sys

import pytest

from gcs_sysid.live.live_estimate import LiveOptions
from gcs_sysid.live.live_session import LiveSession
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.session.chain import Chain
from gcs_sysid.telemetry.link import Link, ReceivedBytes
from gcs_sysid.telemetry.urls import LinkUrl

LOADS = """
import sys
from gcs_sysid.live.live_estimate import LiveOptions
from gcs_sysid.live.live_session import LiveSession
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.link import Link, ReceivedBytes
from gcs_sysid.telemetry.urls import LinkUrl

class Sender(Link):
    datagrams = True
    receive = lambda self, timeout: [ReceivedBytes(data, ("127.0.0.1", 1)) for data in sent]
    send = close = lambda self, *data: None

heartbeat = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)
for sent in [], [bytes(heartbeat.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1)))]:
    link = Sender(LinkUrl("udpin", "udpin:nowhere"))
    session = LiveSession(link, load_airframe("paper"), LiveOptions(duration=0.1))
    session.start()
    assert session.join(60.0)
    print("scipy.optimize" in sys.modules, session.problem)
"""


class Silence(Link):
    """Nobody sends."""

    datagrams = True

    def __init__(self) -> None:
        super().__init__(LinkUrl("udpin", "udpin:nowhere"))

    def receive(self, timeout: float) -> list[ReceivedBytes]:
        return []

    def send(self, data: bytes) -> None:
        pass

    def close(self) -> None:
        self.ended = True


def test_a_snapshot_waits_one_turn_for_samples_and_no_longer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now, seen = [0.0], []
    session = LiveSession(Silence(), load_airframe("paper"), LiveOptions(listen_only=True))
    monkeypatch.setattr(Chain, "t", property(lambda _: now[0]))
    monkeypatch.setattr(session, "_publish", lambda _: seen.append(now[0]))
    monkeypatch.setattr(session, "_accept", lambda seconds: now.__setitem__(0, now[0] + seconds))
    # Nothing processed: at once. Samples in every turn: every other one.
    session._turn([], 0.0)
    assert seen == [0.0]
    for turn in range(1, 7):
        session._turn([0.1], float(turn))
    assert seen == pytest.approx([0.0, 0.2, 0.4, 0.6])
    # A turn with samples, then one without.
    session._turn([0.1], 10.0)
    session._turn([], 10.001)
    assert seen[4:] == pytest.approx([0.7])


def test_what_a_flight_loads_is_loaded_at_its_first_data() -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOADS], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.stdout.split() == ["False", "None", "True", "None"], done.stderr
