"""Every way to run the program against an autopilot that keeps each byte it is sent.

Whatever is done, whatever the vehicle says: only what docs/links.md lists comes out.
"""

import contextlib
import json
import os
import signal
import socket
import struct
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
import serial

from gcs_sysid.__main__ import main
from gcs_sysid.cli import live_command as live_command
from gcs_sysid.cli import screens as screens
from gcs_sysid.live import live_session as live_session
from gcs_sysid.live.reception import Reception
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.link import Link, ReceivedBytes
from gcs_sysid.telemetry.tlog import TlogReader
from gcs_sysid.telemetry.urls import parse_url
from tests.autopilots import GROUPS, INTERVALS, MESSAGES, READS, SETS, Autopilot
from tests.terminals import PATIENCE, OnTerminal
from tests.web.conftest import Client

HEARTBEAT = "HEARTBEAT"
AIRFRAME = ("--airframe", "paper")
KEY = bytes(range(32))
needs_posix = pytest.mark.skipif(
    not hasattr(os, "openpty"), reason="sends signals to itself, and needs pseudo terminals"
)
DOCUMENT = Path(__file__).parents[1] / "docs" / "links.md"


# --- a minute in a moment: all that a session does as time goes by


class Air(Link):
    """A link in memory, on which time passes as it is listened to."""

    datagrams = True

    def __init__(self, vehicle, silent):
        super().__init__(parse_url("udpin:127.0.0.1:14550"))
        self.now = 0.0
        self._vehicle, self._silent = vehicle, silent
        self._answers = []

    def receive(self, timeout):
        self.now += 0.05
        said = self._vehicle.speak(0.05) + self._answers
        self._answers = []
        if self._silent[0] < self.now < self._silent[1]:
            return []
        return [ReceivedBytes(raw, ("10.0.0.1", 14550)) for raw in said]

    def send(self, data):
        self._answers += self._vehicle.notice(data)

    def close(self):
        self.ended = True


@pytest.fixture
def pass_time(monkeypatch, capsys):
    """Runs `live --headless` for so many seconds of an invented clock."""

    def run(vehicle, seconds, *options, silent=(0.0, 0.0)):
        air = Air(vehicle, silent)

        def receiver(url, *, record_to, **settings):
            return Reception(air, record_to, **settings)

        monkeypatch.setattr(live_command, "ReceiverProcess", receiver)
        monkeypatch.setattr(live_session, "time", SimpleNamespace(monotonic=lambda: air.now))
        words = ["live", "udpin:127.0.0.1:14550", *AIRFRAME, "--headless", "--no-record"]
        status = main([*words, "--duration", str(seconds), *options])
        assert status == 1  # a vehicle that stands still tells nothing
        assert "internal error" not in capsys.readouterr().err
        return vehicle.asked

    return run


@pytest.mark.slow
@pytest.mark.parametrize(
    ("manners", "kinds"),
    [
        ({}, {HEARTBEAT, SETS, READS, INTERVALS}),
        ({"mute": True}, {HEARTBEAT, SETS, READS, INTERVALS, MESSAGES}),
        (
            {"autopilot": 3, "old": True, "version": 1},
            {HEARTBEAT, SETS, READS, GROUPS, INTERVALS, MESSAGES},
        ),
    ],
    ids=["px4", "mute", "old-ardupilot"],
)
def test_as_time_goes_by_only_what_is_documented_is_sent(manners, kinds, pass_time):
    """With an outage, after which all is asked for again."""
    vehicle = Autopilot(**manners)
    asked = pass_time(vehicle, 30.0, silent=(15.0, 20.0))
    assert asked.keys() == kinds
    assert 27 <= asked[HEARTBEAT].total() <= 31
    document = DOCUMENT.read_text(encoding="utf-8")
    assert all(name in document for name in asked[SETS])
    streams = {value.name: n for n, value in mavlink.enums["MAV_DATA_STREAM"].items()}
    groups = {n: name.removeprefix("MAV_DATA_STREAM_") for name, n in streams.items()}
    assert all(groups[n] in document for n in asked[GROUPS])
    assert all(vehicle.own_rate.values())


@pytest.mark.slow
def test_who_only_listens_sends_nothing(pass_time):
    for manners in ({}, {"mute": True}):
        assert not pass_time(Autopilot(**manners), 14.0, "--listen-only", silent=(5.0, 10.0))


# --- real links, whole commands


class Ground:
    """The vehicle's end of a link, in a thread: speaks until the command has ended.

    Args:
        vehicle: speaks.
        enough: whether the vehicle has been asked for enough.
        then: called once, when it has.
    """

    def __init__(self, vehicle, send, receive, enough, then):
        self._vehicle, self._send, self._receive = vehicle, send, receive
        self._enough, self._then = enough, then
        self.problem = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._over.set()
        self._thread.join()
        assert self.problem is None

    def _run(self):
        try:
            answers, waiting = [], True
            for _ in range(round(PATIENCE / 0.05)):
                if self._over.wait(0.05):
                    break
                self._send(answers + self._vehicle.speak(0.05))
                answers = self._vehicle.notice(self._receive())
                if waiting and self._enough(self._vehicle.asked):
                    waiting = False
                    self._then()
            else:
                raise TimeoutError(f"asked for no more than {dict(self._vehicle.asked)}")
            self._vehicle.notice(self._receive())
        except Exception as problem:  # noqa: BLE001 - told by the test
            self.problem = problem
            os.kill(os.getpid(), signal.SIGTERM)


@contextlib.contextmanager
def on_udp(vehicle, enough, then):
    """A vehicle that sends to a port, at which a command listens; the command's URL."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end,
    ):
        probe.bind(("127.0.0.1", 0))
        to = probe.getsockname()
        probe.close()
        end.bind(("127.0.0.1", 0))
        end.setblocking(False)

        def send(frames):
            for raw in frames:
                with contextlib.suppress(OSError):  # nobody listens there yet
                    end.sendto(raw, to)

        def receive():
            data = b""
            with contextlib.suppress(OSError):  # nothing more has come
                while True:
                    data += end.recv(65536)
            return data

        with Ground(vehicle, send, receive, enough, then):
            yield f"udpin:127.0.0.1:{to[1]}"


@contextlib.contextmanager
def on_tcp(vehicle, enough, then):
    """A vehicle that a command connects to; the command's URL."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        peers = []

        def send(frames):
            with contextlib.suppress(BlockingIOError):
                peers.append(server.accept()[0])
                peers[-1].setblocking(False)
            for peer in peers:
                with contextlib.suppress(OSError):  # it has hung up
                    peer.sendall(b"".join(frames))

        def receive():
            data = b""
            for peer in peers:
                with contextlib.suppress(OSError):  # nothing more has come
                    while more := peer.recv(65536):
                        data += more
            return data

        with Ground(vehicle, send, receive, enough, then):
            yield f"tcp:127.0.0.1:{server.getsockname()[1]}"
        for peer in peers:
            peer.close()


@contextlib.contextmanager
def on_serial(vehicle, enough, then):
    """A vehicle on a serial port; the command's URL."""
    ours, theirs = os.openpty()
    serial.Serial(os.ttyname(theirs)).close()  # sets it to carry bytes as they are
    os.set_blocking(ours, False)

    def send(frames):
        with contextlib.suppress(BlockingIOError):  # nobody reads
            os.write(ours, b"".join(frames))

    def receive():
        data = b""
        with contextlib.suppress(OSError):
            while True:
                data += os.read(ours, 65536)
        return data

    try:
        with Ground(vehicle, send, receive, enough, then):
            yield f"{os.ttyname(theirs)},57600"
    finally:
        os.close(ours)
        os.close(theirs)


@pytest.fixture
def end_by(monkeypatch):
    """Sends a signal to this process; one that comes when the command has ended does no harm."""
    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = [(number, signal.signal(number, lambda *_: None)) for number in numbers]
    yield lambda number: lambda: os.kill(os.getpid(), number)
    for number, handler in before:
        signal.signal(number, handler)


def streams_and_parameters(asked):
    return len(asked[SETS]) >= 5 and len(asked[READS]) >= 2


def assert_harmless(vehicle):
    """And left as it was found."""
    # Whoever answers late is asked for its intervals another way.
    assert vehicle.asked.keys() - {MESSAGES} == {HEARTBEAT, SETS, READS, INTERVALS}
    assert vehicle.received == vehicle.understood
    assert all(vehicle.own_rate.values())


@pytest.mark.slow
@needs_posix
@pytest.mark.parametrize("words", [["live", "--headless", *AIRFRAME, "--no-record"], ["inspect"]])
def test_a_serial_port(words, end_by, folder, capsys):
    vehicle = Autopilot(autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)
    with on_serial(vehicle, streams_and_parameters, end_by(signal.SIGTERM)) as url:
        assert main([*words, url]) in (0, 1)
    assert_harmless(vehicle)
    assert "Traceback" not in capsys.readouterr().err


@needs_posix
@pytest.mark.slow
@pytest.mark.parametrize("how", ["SIGTERM", pytest.param("hang up", marks=pytest.mark.thorough)])
def test_the_screen_its_keys_and_its_end_over_a_signed_link(how, folder):
    """The result is written, the recordings are whole, the rates are given back."""
    (folder / "vehicle.key").write_bytes(KEY)
    vehicle, other = Autopilot(key=KEY), threading.Event()

    def both(asked):
        # Rates are set some time after they are read: a target alone may have answered no more.
        return vehicle.targets == {(1, 1), (2, 1)} and streams_and_parameters(asked)

    with on_udp(vehicle, both, other.set) as url:
        options = ("--signing-key", "vehicle.key", "--json", "result.json", "--record", "a.tlog")
        program = OnTerminal("live", url, *AIRFRAME, *options, folder=folder)
        try:
            # The header keeps it; a line of the events may have passed before it is drawn.
            assert program.shows(b"2 vehicles"), program.shown
            program.type(b"mv")
            assert program.shows(b"Which vehicle?"), program.shown
            program.type(b"\x1b[B\r")
            assert other.wait(PATIENCE), program.shown
            program.hang_up() if how == "hang up" else program.process.terminate()
            assert program.shows(None)
            status = program.process.returncode
        finally:
            program.end()
    # Whoever closes the terminal does not want to be told.
    assert status == (1 if how == "SIGTERM" else 0), program.shown
    assert_harmless(vehicle)
    assert vehicle.signed == {True}
    assert b"Traceback" not in program.shown
    assert b"failed" not in program.shown
    final = json.loads((folder / "result.json").read_text().splitlines()[-1])
    assert (final["verdict"], final["vehicle"]["sysid"]) == ("refused", 2)
    recordings = sorted(folder.glob("*.tlog"))
    assert len(recordings) == 2  # one of each vehicle
    for recording in recordings:
        reader = TlogReader(recording)
        assert sum(1 for _ in reader) > 0
        assert reader.counts.garbage_bytes == 0


@pytest.mark.slow
@needs_posix
def test_a_page_and_its_buttons_over_tcp(end_by, folder, capsys, monkeypatch):
    """`--web`, ended by SIGHUP as by a terminal that closes."""
    vehicle, served = Autopilot(), []
    monkeypatch.setattr(screens, "say_addresses", lambda site, _host: served.append(site))

    def act():
        """What a page sends whose buttons are pressed, and more than it has."""
        pilot, viewer = (Client(served[0], role) for role in ("pilot", "viewer"))
        offered = json.loads(pilot.get("/live/scene")[1])["actions"]
        assert {"mark", "record", "reset", "scale", "vehicle"} <= set(offered)
        for action in (
            {"action": "mark", "text": "here"},
            {"action": "reset"},
            {"action": "record"},
            {"action": "scale", "name": "mass", "value": 2.0},
            {"action": "health"},
        ):
            assert viewer.post("/live/action", action)[0] == 403
            pilot.post("/live/action", action)
        for name in ("arm", "send", "command", "set_mode", "request_stop", "gate"):
            assert pilot.post("/live/action", {"action": name, "text": "MAV_CMD"})[0] == 400
        end_by(signal.SIGHUP)()

    with on_tcp(vehicle, streams_and_parameters, act) as url:
        assert main(["live", url, *AIRFRAME, "--web", "0"]) == 1
    assert_harmless(vehicle)
    out, err = capsys.readouterr()
    assert "given" in out  # the result's table
    assert "here" in err
    assert "Traceback" not in err
    assert list(folder.glob("logs/*.tlog"))


def test_what_is_read_from_files_opens_no_link(folder, monkeypatch, capsys):
    vehicle = Autopilot()
    with Path("flight.tlog").open("wb") as log:
        for n in range(100):
            stamp = struct.pack(">Q", 1_750_000_000_000_000 + 50_000 * n)
            log.writelines(stamp + raw for raw in vehicle.speak(0.05))

    def refuse(*_arguments, **_named):
        raise AssertionError("a link was opened")

    monkeypatch.setattr(socket, "socket", refuse)
    monkeypatch.setattr(serial, "Serial", refuse)
    for words in (["replay", "--headless", "--speed", "max", *AIRFRAME], ["analyze", *AIRFRAME]):
        assert main([*words, "flight.tlog"]) in (1, 2)
    assert main(["inspect", "flight.tlog"]) == 0
    assert "AssertionError" not in capsys.readouterr().err
