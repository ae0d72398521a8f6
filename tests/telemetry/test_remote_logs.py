"""Logs are fetched byte for byte, whatever the link loses, and go on after they were cut off."""

import random

import pytest

from gcs_sysid.errors import LinkError
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import read_frame
from gcs_sysid.telemetry.messages import message_name
from gcs_sysid.telemetry.outgoing import Gate
from gcs_sysid.telemetry.remote_logs import Exchange, RemoteLogs
from gcs_sysid.telemetry.transceiver import ReceivedFrames
from gcs_sysid.telemetry.urls import parse_url
from sim_bridge.log_server import LogServer
from sim_bridge.wire import FrameWriter

CONTENT = random.Random(1).randbytes(150_001)
READ = {"HEARTBEAT", "LOG_REQUEST_LIST", "LOG_REQUEST_DATA", "LOG_REQUEST_END"}
FTP = "FILE_TRANSFER_PROTOCOL"


class KilledError(Exception):
    """The program ends here."""


class Radio:
    """A vehicle with logs behind a link that loses frames both ways, in time of its own."""

    url = parse_url("udpin:127.0.0.1:14550")

    def __init__(self, paths, loss=0.0, ways=("LOG", FTP), answers=10**9):
        self.now = 0.0
        self.sent = []
        self.gate = Gate(self._to_vehicle)
        self._answers = answers
        self._writer = FrameWriter()
        self._logs = LogServer(paths, self._writer)
        self._logs.handlers = {
            name: handler for name, handler in self._logs.handlers.items() if name.startswith(ways)
        }
        self._parser = mavlink.MAVLink(None)
        self._random, self._loss = random.Random(2), loss
        self._coming = []

    def follow(self, vehicle):
        assert vehicle == (1, 1)

    def receive(self, timeout):
        raw, self._coming = [*self._coming, *self._logs.poll()], []
        self.now += 0.001 if raw else timeout
        if round(self.now * 1000) % 500 < 20:
            raw.append(self._heartbeat())
        self._answers -= len(raw)
        if self._answers < 0:
            raise KilledError
        frames = [read_frame(each) for each in raw if self._random.random() >= self._loss]
        return [ReceivedFrames(0, frames)] if frames else []

    def _to_vehicle(self, raw):
        self.sent.append(message_name(read_frame(raw).message_id))
        if self._random.random() < self._loss:
            return
        for message in self._parser.parse_buffer(raw):
            handler = self._logs.handlers.get(message.get_type())
            self._coming += handler(message) if handler else []

    def _heartbeat(self):
        fields = (mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, 0, 0, 4, 3)
        message = mavlink.MAVLink_heartbeat_message(*fields)
        return message.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1))


@pytest.fixture
def paths(tmp_path):
    first, second = tmp_path / "one.ulg", tmp_path / "two.ulg"
    first.write_bytes(b"another log")
    second.write_bytes(CONTENT)
    return [first, second]


def fetch(radio, file):
    logs = RemoteLogs(Exchange(radio, clock=lambda: radio.now))
    *_, last = logs.listed()
    shares = []
    with open(file, "r+b" if file.exists() else "w+b") as out:
        logs.read(last, out, shares.append)
    return shares


@pytest.mark.parametrize("ways", ["LOG", FTP])
@pytest.mark.parametrize("loss", [0.0, 0.1])
def test_a_log_arrives_byte_for_byte_and_only_reading_is_asked_for(paths, tmp_path, ways, loss):
    radio = Radio(paths, loss, ways)
    shares = fetch(radio, tmp_path / "got")
    assert (tmp_path / "got").read_bytes() == CONTENT
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert set(radio.sent) <= READ | {FTP}
    assert (FTP in radio.sent) == (ways == FTP)


@pytest.mark.parametrize(("ways", "kills"), [("LOG", (300, 600, 900)), (FTP, (150, 200, 200))])
def test_what_was_killed_goes_on_where_it_was(paths, tmp_path, ways, kills):
    got = tmp_path / "got"
    for answers in kills:
        with pytest.raises(KilledError):
            fetch(Radio(paths, 0.1, ways, answers), got)
    held = got.stat().st_size
    assert 0 < held < len(CONTENT)
    assert CONTENT.startswith(got.read_bytes())
    radio = Radio(paths, 0.1, ways)
    shares = fetch(radio, got)
    assert got.read_bytes() == CONTENT
    assert shares[0] > 0.9 * held / len(CONTENT)


def test_a_beginning_of_another_log_is_replaced(paths, tmp_path):
    got = tmp_path / "got"
    got.write_bytes(bytes(2 * len(CONTENT)))
    fetch(Radio(paths), got)
    assert got.read_bytes() == CONTENT


def test_a_vehicle_that_falls_silent_is_given_up_with_what_came_kept(paths, tmp_path):
    got = tmp_path / "got"
    radio = Radio(paths)
    logs = RemoteLogs(Exchange(radio, clock=lambda: radio.now))
    *_, last = logs.listed()

    def fall_silent(share):
        radio._loss = 1.0

    with (
        open(got, "w+b") as out,
        pytest.raises(LinkError, match=r"nothing came for 30 s after \d+"),
    ):
        logs.read(last, out, fall_silent)
    assert CONTENT.startswith(got.read_bytes())
    assert got.stat().st_size


def test_a_vehicle_that_serves_no_logs_is_named(paths):
    radio = Radio(paths, ways=("NONE",))
    with pytest.raises(LinkError, match="PX4 quadrotor 1:1: sends no list of its logs"):
        RemoteLogs(Exchange(radio, clock=lambda: radio.now)).listed()
