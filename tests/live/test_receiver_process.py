"""A receiver in a process of its own: what arrives is recorded, whoever is busy or dies."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import pytest

from gcs_sysid.errors import InputError, LinkError
from gcs_sysid.live.live_session import LiveSession
from gcs_sysid.live.live_view import SELDOM
from gcs_sysid.live.receiver_process import ReceiverProcess
from gcs_sysid.live.reception import Ended, RecordingCut, ResetMark, Toggled
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.telemetry.frames import read_frame
from gcs_sysid.telemetry.tlog import TlogReader
from gcs_sysid.telemetry.transceiver import ReceivedFrames
from gcs_sysid.telemetry.urls import LinkUrl
from testbed.payloads import unpack
from tests.live.test_live_session import LISTEN, LONGEST, assert_same_numbers

HERE = LinkUrl("udpin", "udpin:127.0.0.1", host="127.0.0.1", port=0)
needs_posix = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")


@pytest.fixture
def receiver():
    """Starts receivers; ends them with the test."""
    started = []

    def start(**settings):
        started.append(ReceiverProcess(HERE, **settings))
        return started[-1]

    yield start
    for each in started:
        each.close()


def raws_of(path):
    return [frame.raw for _, frame in TlogReader(path)]


def send(receiver, raws):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for raw in raws:
            sender.sendto(raw, ("127.0.0.1", receiver.url.port))


def items(receiver, enough):
    """What is handed over until it is enough."""
    got = []
    deadline = time.monotonic() + LONGEST
    while not enough(got):
        assert time.monotonic() < deadline, got
        got += receiver.next_items(0.05)
    return got


def frames_in(got):
    return [frame for item in got if isinstance(item, ReceivedFrames) for frame in item.frames]


def until(said):
    """Wait for something outside of this process."""
    deadline = time.monotonic() + LONGEST
    while not said():
        assert time.monotonic() < deadline
        threading.Event().wait(0.01)


def is_running(pid):
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    return False


@pytest.mark.slow
def test_a_busy_session_loses_nothing_says_so_and_catches_up(
    receiver, flight, analyzed, tmp_path, monkeypatch
):
    """It learns when it can: the result is that of the recording, whatever was put off."""
    airframe, path = load_airframe("paper"), tmp_path / "live.tlog"
    source, sent, go_on = receiver(record_to=path), threading.Event(), threading.Event()
    session = LiveSession(source, airframe, LISTEN, path, sender_gone=sent.is_set)
    chain = session._estimate.chain
    take, renew, renewed = chain.take, chain.renew_every, []
    monkeypatch.setattr(chain, "take", lambda block: go_on.wait() and take(block))
    monkeypatch.setattr(chain, "renew_every", lambda every: renewed.append(every) or renew(every))
    session.start()
    raws = raws_of(flight.tlog)
    half = len(raws) // 2
    send(source, raws[:half])
    until(lambda: source._newest)
    threading.Event().wait(1.3)  # so much later comes the rest, while nobody learns
    send(source, raws[half:])
    until(lambda: source.waiting > 1.0)
    go_on.set()
    until(lambda: any("caught up after" in e.text for e in session.latest().events))
    told = [e.text for e in session.latest().events]
    assert any(text.startswith("the computer is too slow: ") for text in told)
    assert renewed[:2] == [SELDOM, LISTEN.refit_interval]
    sent.set()
    assert session.join(LONGEST)
    assert raws_of(path) == raws_of(flight.tlog)
    assert_same_numbers(session.final, analyzed)
    receiver_told = session.final.telemetry["receiver"]
    assert receiver_told["longest_wait"] > 1.0
    assert receiver_told["too_slow_seconds"] > 0.0
    assert receiver_told["not_learnt"] == 0


def test_what_is_ordered_is_done_at_one_place_of_stream_and_recording(receiver, flight, tmp_path):
    first, second = tmp_path / "a.tlog", tmp_path / "b.tlog"
    source = receiver(record_to=first)
    raws = raws_of(flight.tlog)[:50]
    send(source, raws[:5])
    got = items(source, lambda got: len(frames_in(got)) == 5)
    source.mark_reset()
    got += items(source, lambda got: any(isinstance(i, ResetMark) for i in got))
    source.cut_recording(second)
    got += items(source, lambda got: any(isinstance(i, RecordingCut) for i in got))
    send(source, raws[5:])
    got += items(source, lambda got: len(frames_in(got)) == len(raws) - 5)
    assert source.flushed_recording() == second
    assert raws_of(second) == raws[5:]
    assert source.recording_report.path == str(second)
    source.stop_recording()
    (toggled,) = items(source, lambda got: got)
    assert toggled == Toggled(f"recording {second} stopped")
    assert not source.recording_report.active
    source.finish()
    assert isinstance(items(source, lambda got: got)[-1], Ended)
    assert raws_of(first)[:5] == raws[:5]
    assert len(raws_of(first)) == 6  # and the mark
    assert source.recording_report.lines == (f"recorded to {first}", f"recorded to {second}")


@pytest.mark.slow
def test_what_cannot_be_opened_gives_its_line(receiver, tmp_path):
    taken = tmp_path / "taken.tlog"
    taken.write_bytes(b"precious")
    with pytest.raises(InputError, match="exists already"):
        receiver(record_to=taken)
    with pytest.raises(InputError, match="cannot read the signing key"):
        receiver(signing_key=tmp_path / "none")
    port = receiver().url.port
    with pytest.raises(LinkError, match="in use") as caught:
        ReceiverProcess(LinkUrl("udpin", f"udpin:127.0.0.1:{port}", "127.0.0.1", port))
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@needs_posix
def test_a_receiver_that_is_killed_ends_the_session_with_a_line(receiver, flight, tmp_path):
    path = tmp_path / "live.tlog"
    source = receiver(record_to=path)
    session = LiveSession(source, load_airframe("paper"), LISTEN, path)
    session.start()
    raws = raws_of(flight.tlog)
    send(source, raws)
    until(lambda: session.latest().link.received == len(raws))
    session.flushed_recording()
    source._process.kill()
    assert session.join(LONGEST)
    assert isinstance(session.problem, LinkError)
    assert "the receiver died" in str(session.problem)
    assert session.final.parameters["Ixx"].status == "identified"
    assert raws_of(path) == raws


_SESSION = textwrap.dedent(
    """
    import sys
    from pathlib import Path
    from gcs_sysid.live.live_estimate import LiveOptions
    from gcs_sysid.live.live_session import LiveSession
    from gcs_sysid.live.receiver_process import ReceiverProcess
    from gcs_sysid.model.airframe import load_airframe
    from gcs_sysid.telemetry.urls import LinkUrl
    path = Path(sys.argv[1])
    url = LinkUrl("udpin", "udpin:127.0.0.1", host="127.0.0.1", port=0)
    source = ReceiverProcess(url, record_to=path)
    print(source.url.port, source._process.pid, flush=True)
    session = LiveSession(source, load_airframe("paper"), LiveOptions(), path)
    session.start()
    session.join()
    """
)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs Linux's /proc")
@pytest.mark.parametrize("how", ["SIGKILL", pytest.param("SIGSTOP", marks=pytest.mark.thorough)])
def test_a_session_that_dies_leaves_a_whole_recording_and_the_vehicle_as_it_was(
    how, flight, tmp_path
):
    """Its receiver takes what has come, gives the rates back, and does not outlive it."""
    path = tmp_path / "live.tlog"
    words = [sys.executable, "-c", _SESSION, str(path)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            port, pid = map(int, process.stdout.readline().split())
            raws = raws_of(flight.tlog)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
                vehicle.bind(("127.0.0.1", 0))
                vehicle.settimeout(LONGEST)
                beat = next(raw for raw in raws if raw[7:10] == b"\0\0\0")
                vehicle.sendto(beat, ("127.0.0.1", port))
                while vehicle.recv(1000)[7] != 76:  # until it has asked for a rate
                    pass
                if how == "SIGSTOP":
                    process.send_signal(signal.SIGSTOP)
                for raw in raws:
                    vehicle.sendto(raw, ("127.0.0.1", port))
                process.kill()
                until(lambda: not is_running(pid))
                answers = []
                vehicle.setblocking(False)
                with contextlib.suppress(BlockingIOError):
                    while True:
                        answers.append(vehicle.recv(1000))
        finally:
            process.kill()
    assert raws_of(path) == [beat, *raws]
    asked = [unpack_interval(raw) for raw in answers if raw[7] == 76]
    last = dict(asked)
    assert last
    assert set(last.values()) == {0.0}


def unpack_interval(raw):
    """Message that was asked for, and its interval."""
    fields = unpack(76, read_frame(raw).payload)
    return fields["param1"], fields["param2"]
