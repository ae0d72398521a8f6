"""Live sessions over real sockets, and their recordings."""

import dataclasses
import hashlib
import io
import socket
import subprocess
import sys
import threading

import pytest
from fastcrc import crc16
from pymavlink import mavutil

from gcs_sysid.errors import InputError
from gcs_sysid.live.live_estimate import LiveOptions
from gcs_sysid.live.live_session import LiveSession
from gcs_sysid.results.snapshot import LinkState
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.telemetry import tlog_writer
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.link import PersistentLink, TcpLink, UdpLink
from gcs_sysid.telemetry.signing import SigningClock
from gcs_sysid.telemetry.tlog import TlogReader
from gcs_sysid.telemetry.urls import LinkUrl
from testbed.signer import Signer

LISTEN = LiveOptions(listen_only=True, refit_interval=5.0)
"""Sends nothing, and refits seldom, of which the final numbers keep no trace."""
LONGEST = 120.0
"""s; a session that has not ended by then never will."""


@pytest.fixture
def udp():
    link = UdpLink(LinkUrl("udpin", "udpin:127.0.0.1", host="127.0.0.1", port=0))
    yield link
    link.close()


@pytest.fixture
def emulator():
    """Starts the emulator as a program; ends it with the test."""
    started = []

    def start(*options):
        process = subprocess.Popen(
            [sys.executable, "-m", "sim_bridge", "--airframe", "paper", *options],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.terminate()
        process.communicate(timeout=20)


def finish(session):
    """Wait for a session's own end."""
    ended = session.join(LONGEST)
    session.stop()
    assert ended
    assert session.problem is None
    return session.final


def assert_same_numbers(a, b):
    """Every value of two results equal within a thousandth of its std; all else exactly.

    A fit begins at the one before and ends near its optimum: when it was made shows in
    the digits beyond.
    """
    assert a.verdict == b.verdict
    assert a.reasons == b.reasons
    assert a.parameters.keys() == b.parameters.keys()
    for name, first in a.parameters.items():
        second = b.parameters[name]
        assert first.status == second.status
        near = 1e-3 * (second.std or 0.0)
        for x, y in ((first.value, second.value), (first.std, second.std)):
            assert x == (None if y is None else pytest.approx(y, rel=1e-9, abs=near)), name
    assert a.vehicle == b.vehicle
    assert a.telemetry["used_seconds"] == b.telemetry["used_seconds"]
    assert a.telemetry["messages"] == b.telemetry["messages"]


@pytest.mark.slow
def test_udp_session_and_its_recording_give_the_same_numbers(udp, emulator, airframe, tmp_path):
    target = f"udpout:127.0.0.1:{udp.port}"
    flight = ("--mission", "all-axes", "--rate", "100", "--seed", "1")
    process = emulator("--connect", target, *flight, "--speed", "4", "--duration", "14")
    path = tmp_path / "live.tlog"
    gone = lambda: process.poll() is not None  # noqa: E731
    told = []
    session = LiveSession(
        udp, airframe, LiveOptions(rate=100.0, refit_interval=2.0), path, gone, told.append
    )
    session.start()
    final = finish(session)
    assert process.returncode == 0
    assert len(told) > 3  # once a second of flight at most
    assert told[-1].parameters["Ixx"].value == pytest.approx(0.0165, rel=0.05)
    # 3 s of ground, start of the grid and windows are less than half of it.
    assert final.telemetry["used_seconds"] > 7.0
    assert final.parameters["Ixx"].value == pytest.approx(0.0165, rel=0.05)
    assert_same_numbers(final, analyze_log(path, airframe))
    latest = session.latest()
    assert latest.result == final
    assert latest.link.state is LinkState.ENDED
    assert latest.link.vehicle.endswith("1:1")
    assert latest.link.received == sum(1 for _ in TlogReader(path))


def replay(path, port, address="127.0.0.1"):
    """Send a recording's frames as datagrams, at a pace that a receive buffer holds."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for _, frame in TlogReader(path):
            sender.sendto(frame.raw, (address, port))


def test_a_silent_link_is_said_to_be_silent(udp, airframe):
    session = LiveSession(udp, airframe, LISTEN)
    assert session.latest() is None
    session.start()
    first = session.latest()
    assert first.link.state is LinkState.WAITING
    assert first.link.vehicle == ""
    assert first.result.verdict == "refused"
    assert not session.join(0.3)  # it goes on listening
    assert session.latest().link.state is LinkState.WAITING
    session.stop()


def test_duration_ends_a_session_that_hears_nobody(udp, airframe):
    session = LiveSession(udp, airframe, LiveOptions(duration=0.2))
    session.start()
    final = finish(session)
    assert final.verdict == "refused"
    assert "no heartbeat" in final.reasons[0]
    assert session.latest().link.state is LinkState.ENDED


@pytest.mark.slow
def test_a_reset_is_in_the_recording_and_its_analysis(udp, airframe, flight, tmp_path, analyzed):
    path = tmp_path / "live.tlog"
    sent = threading.Event()
    session = LiveSession(udp, airframe, LISTEN, path, sender_gone=sent.is_set)
    session.start()
    raws = [frame.raw for _, frame in TlogReader(flight.tlog)]
    half = len(raws) // 2
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for raw in raws[:half]:
            sender.sendto(raw, ("127.0.0.1", udp.port))
        for _ in range(round(LONGEST / 0.1)):
            if session.latest().link.received == half or session.join(0.1):
                break
        session.reset()
        for raw in raws[half:]:
            sender.sendto(raw, ("127.0.0.1", udp.port))
    sent.set()
    final = finish(session)
    again = analyze_log(path, airframe)
    assert_same_numbers(final, again)
    assert [event["kind"] for event in final.events] == ["reset"]
    assert final.events == again.events
    # Neither is it a message that was received.
    assert final.telemetry["received"] == again.telemetry["received"] == len(raws)
    # Seen as the whole flight, the estimate rests on more of it.
    assert final.telemetry["used_seconds"] < 0.7 * analyzed.telemetry["used_seconds"]
    # Other readers see a line of text of this tool's own address.
    reader = mavutil.mavlink_connection(str(path), dialect="common")
    text = reader.recv_match(type="STATUSTEXT", condition="STATUSTEXT.get_srcSystem() == 245")
    assert text.text == "gcs-sysid: estimate reset"
    reader.close()


@pytest.mark.slow
def test_actions_are_done_while_it_runs(udp, airframe, tmp_path):
    session = LiveSession(udp, airframe, LiveOptions(listen_only=True, duration=1.0))
    session._stem = tmp_path / "toggled.tlog"
    session.start()
    session.mark("gust")
    said = session.toggle_recording()
    finish(session)
    texts = [e.text for e in session.latest().events]
    assert texts == ["gust", said]
    assert said == f"recording to {tmp_path / 'toggled.tlog'}"
    assert session.recordings() == [f"nothing received: {tmp_path / 'toggled.tlog'} was not kept"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_faults_of_disk_and_listener_cost_no_numbers(udp, airframe, flight, tmp_path, monkeypatch):
    """What was seen before does not change either."""

    class Full(io.BytesIO):
        def write(self, data):
            raise OSError(28, "No space left on device")

    seen = []

    def breaks(result):
        seen.append((session.latest(), repr(session.latest())))
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr(tlog_writer, "open_file", lambda *_: Full())
    monkeypatch.setattr(tlog_writer.TlogWriter, "SYNC_EVERY", 3600.0)
    sent = threading.Event()
    session = LiveSession(udp, airframe, LISTEN, tmp_path / "a.tlog", sent.is_set, breaks)
    session.start()
    replay(flight.tlog, udp.port)
    sent.set()
    assert session.join(LONGEST)
    assert len(seen) == 1
    assert isinstance(session.problem, ZeroDivisionError)
    final, last = session.final, session.latest()
    assert final.verdict == "identified"
    count = sum(1 for _ in TlogReader(flight.tlog))
    assert final.telemetry["recording"] == {"missing": count}
    told = [event.text for event in last.events]
    assert "internal error (ZeroDivisionError: a defect): results are no longer written" in told
    assert any("No space left" in text for text in told)
    assert "No space left" in session.recordings()[0]
    assert all(repr(snapshot) == before for snapshot, before in seen)
    with pytest.raises(dataclasses.FrozenInstanceError):
        last.t = 0.0
    assert last.link.state is LinkState.ENDED
    assert last.link.url == f"udpin:127.0.0.1:{udp.url.port}"
    assert udp.url.port > 0
    assert last.link.rates["HIGHRES_IMU"] == pytest.approx(20.0, rel=0.05)
    assert last.link.rejected == last.link.unknown == 0
    assert last.link.lost_percent == 0.0
    assert last.link.bytes_per_second > 1000.0
    assert len(last.attitude) == len(last.rates) == 3
    assert len(last.rotor_speeds) == 4
    assert last.used_seconds > 11.0
    assert last.history.t[-1] <= last.t


PASSPHRASE = "correct horse"
CRC_EXTRA = {i: message.crc_extra for i, message in mavlink.mavlink_map.items()}


@pytest.mark.slow
def test_a_tcp_connection_that_breaks_costs_nothing_of_a_signed_flight(
    airframe, flight, tmp_path, analyzed
):
    """The estimate goes on, and the recording is one file, whose frames are 13 bytes longer."""
    key, path = tmp_path / "key", tmp_path / "live.tlog"
    key.write_text(PASSPHRASE + "\n", encoding="ascii")
    signer = Signer(hashlib.sha256(PASSPHRASE.encode()).digest(), SigningClock())
    frames = [frame for _, frame in TlogReader(flight.tlog)]
    count = len(frames)
    # First the same without signatures: nobody believes it.
    raws = [frame.raw for frame in frames]
    raws += [signer.sign(frame.raw, CRC_EXTRA[frame.message_id]) for frame in frames]
    options = dataclasses.replace(LISTEN, signing_key=key)
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = LinkUrl("tcp", "tcp:127.0.0.1", host="127.0.0.1", port=server.getsockname()[1])
        session = LiveSession(PersistentLink(TcpLink(url)), airframe, options, path)
        session.start()
        for part in (raws[: 3 * count // 2], raws[3 * count // 2 :]):
            vehicle, _ = server.accept()
            with vehicle:
                vehicle.sendall(b"".join(part))
        settled(session, lambda s: s.link.received == count)
        session.request_stop()
        final = finish(session)
    signing = final.telemetry["signing"]
    assert signing["accepted"] == count
    assert signing["refused"] == {"unsigned": count, "wrong key": 0, "replayed": 0, "too old": 0}
    assert final.telemetry["lost"] == 0
    assert final.telemetry["garbage_bytes"] == 0
    assert_same_numbers(final, analyzed)
    assert_same_numbers(final, analyze_log(path, airframe))
    assert all(frame.signed for _, frame in TlogReader(path))
    assert set(tmp_path.iterdir()) == {key, path}
    told = [event.text for event in session.latest().events]
    assert any("waiting for it to return" in text for text in told)
    assert any(text.startswith("link back after") for text in told)


def settled(session, until, longest=LONGEST):
    """Wait until a session says so."""
    for _ in range(round(longest / 0.05)):
        if until(session.latest()) or session.join(0.05):
            break
    assert until(session.latest())


@pytest.mark.slow
def test_another_anchor_changes_the_scale_and_nothing_else(udp, airframe, flight):
    sent = threading.Event()
    session = LiveSession(udp, airframe, LISTEN, sender_gone=sent.is_set)
    session.start()
    replay(flight.tlog, udp.port)
    settled(session, lambda s: s.result.parameters["Ixx"].status == "identified")
    for kind, value, why in (
        ("weight", 1.0, "one of mass, k_T, T_max"),
        ("mass", -1.0, "positive"),
        ("mass", float("nan"), "positive"),
        ("T_max", 7.0, "cannot set the scale with speeds"),
    ):
        with pytest.raises(InputError, match=why):
            session.set_anchor(kind, value)
    assert session.airframe.mass == 1.5
    said = session.set_anchor("mass", 3.0)
    assert said == "scale from mass = 3 kg"
    settled(session, lambda s: s.result.scale.value == 3.0)
    assert session.airframe.mass == 3.0
    sent.set()
    final = finish(session)
    heavy = airframe.with_anchor("mass", 3.0)
    assert_same_numbers(final, analyze_log(flight.tlog, heavy))
    assert "scale: mass = 3 kg" in [e.text for e in session.latest().events]


def as_system(raw, system):
    """A frame of MAVLink 2 as if another system had sent it."""
    frame = bytearray(raw)
    frame[5] = system
    extra = mavlink.mavlink_map[int.from_bytes(frame[7:10], "little")].crc_extra
    frame[-2:] = crc16.mcrf4xx(bytes(frame[1:-2]) + bytes([extra])).to_bytes(2, "little")
    return bytes(frame)


@pytest.mark.slow
def test_another_vehicle_begins_anew_in_a_recording_of_its_own(udp, airframe, flight, tmp_path):
    """Two vehicles on one link: the second recording's analysis ends with the session's numbers."""
    path = tmp_path / "two.tlog"
    sent = threading.Event()
    session = LiveSession(udp, airframe, LISTEN, path, sender_gone=sent.is_set)
    session.start()
    with pytest.raises(InputError, match="no vehicle 2:1"):
        session.choose_vehicle((2, 1))
    frames = [frame.raw for _, frame in TlogReader(flight.tlog)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for raw in frames[: len(frames) // 4]:
            sender.sendto(raw, ("127.0.0.1", udp.port))
            sender.sendto(as_system(raw, 2), ("127.0.0.1", udp.port))
        settled(session, lambda s: len(s.link.vehicles) == 2)
        assert [v.chosen for v in session.latest().link.vehicles] == [True, False]
        assert session.choose_vehicle((2, 1)).startswith("restarting on")
        settled(session, lambda s: s.link.recording.endswith("two-2.tlog"))
        for raw in frames:
            sender.sendto(as_system(raw, 2), ("127.0.0.1", udp.port))
    sent.set()
    final = finish(session)
    assert final.vehicle["sysid"] == 2
    assert final.verdict == "identified"
    chosen = [v.address for v in session.latest().link.vehicles if v.chosen]
    assert chosen == [(2, 1)]
    assert_same_numbers(final, analyze_log(tmp_path / "two-2.tlog", airframe, (2, 1)))
    assert session.recordings() == [f"recorded to {path}", f"recorded to {tmp_path / 'two-2.tlog'}"]
    assert session.flushed_recording() == tmp_path / "two-2.tlog"
