"""Rates are asked for until they arrive, and given back at the end."""

import pytest

from gcs_sysid.telemetry.frames import read_frame
from gcs_sysid.telemetry.messages import message_name
from gcs_sysid.telemetry.outgoing import Gate
from gcs_sysid.telemetry.requests import ASKS_AT_MOST
from gcs_sysid.telemetry.vehicles import MavlinkSystem
from gcs_sysid.telemetry.wanted_streams import bytes_per_second
from testbed.payloads import unpack
from tests.telemetry.in_memory import Asking

VEHICLE = MavlinkSystem(1, 1, 2, 12)
ARDUPILOT = MavlinkSystem(1, 1, 2, 3)
RATES = {
    "HIGHRES_IMU": 250.0,
    "ESC_STATUS": 250.0,
    "ACTUATOR_OUTPUT_STATUS": 250.0,
    "ATTITUDE": 100.0,
    "LOCAL_POSITION_NED": 50.0,
    "EXTENDED_SYS_STATE": 2.0,
}
RADIO = {name: rate for name, rate in RATES.items() if name != "ESC_STATUS"}


class Wire:
    def __init__(self):
        self.raws = []
        self.gate = Gate(self.raws.append)

    def take(self):
        """What was sent since: [("HEARTBEAT",) or (message name, interval in us)]."""
        said = []
        for raw in self.raws:
            frame = read_frame(raw)
            if frame.message_id == 0:
                said.append(("HEARTBEAT",))
            else:
                fields = unpack(76, frame.payload)
                said.append((message_name(int(fields["param1"])), fields["param2"]))
        self.raws.clear()
        return said


@pytest.fixture
def wire():
    return Wire()


@pytest.fixture
def requests(wire):
    return Asking(wire.gate, 250.0)


def run(requests, wire, until, arriving, start=0.0, **observed):
    """Tick every 0.2 s of an invented clock: [(t, message name, interval in us)] asked for."""
    asked = []
    for i in range(round((until - start) / 0.2)):
        t = start + 0.2 * i
        requests.tick(t, VEHICLE, arriving, **observed)
        asked += [(t, *said) for said in wire.take() if said[0] != "HEARTBEAT"]
    return asked


def test_only_heartbeats_go_out_before_a_vehicle_is_known(wire, requests):
    for i in range(41):
        requests.tick(0.1 * i, None, {})
    assert wire.take() == [("HEARTBEAT",)] * 5


def test_every_stream_is_asked_for_once_when_the_vehicle_is_known(wire, requests):
    requests.tick(0.0, VEHICLE, {})
    requests.tick(0.1, VEHICLE, {})
    said = wire.take()
    assert said[0] == ("HEARTBEAT",)
    assert said[1:] == [(name, round(1e6 / hz)) for name, hz in RATES.items()]
    assert requests.asked == RATES


def test_only_slow_streams_are_asked_for_again_and_not_too_often(wire, requests):
    arriving = RATES | {"HIGHRES_IMU": 180.0, "ESC_STATUS": 1.0, "ATTITUDE": 99.0}
    again = []
    for i in range(160):
        requests.tick(0.1 * i, VEHICLE, arriving)
        again += [(0.1 * i, *s) for s in wire.take() if s[0] != "HEARTBEAT" and i > 0]
    assert [name for _, name, _ in again] == ["ESC_STATUS"] * 3
    assert [t for t, *_ in again] == pytest.approx([5.0, 10.0, 15.0], abs=0.11)


def test_a_stream_that_never_comes_is_given_up(wire, requests):
    for i in range(1000):
        requests.tick(float(i), VEHICLE, RADIO)
    said = [name for name, *_ in wire.take()]
    assert said.count("ESC_STATUS") == ASKS_AT_MOST


def test_a_rate_that_another_station_reset_is_asked_for_again(wire, requests):
    full = dict(RATES)
    requests.tick(0.0, VEHICLE, {})
    for i in range(1, 500):
        requests.tick(float(i), VEHICLE, full)
    wire.take()
    requests.tick(500.0, VEHICLE, full | {"ATTITUDE": 15.0})
    assert ("ATTITUDE", 10000.0) in wire.take()


def test_after_a_reboot_all_are_asked_for(wire, requests):
    requests.tick(0.0, VEHICLE, {})
    wire.take()
    requests.reboot()
    requests.tick(0.5, VEHICLE, RATES)
    assert [name for name, *_ in wire.take()] == list(RATES)


def test_ardupilot_is_asked_for_its_own_messages_in_whole_milliseconds(wire):
    requests = Asking(wire.gate, 300.0, rotors=6)
    requests.tick(0.0, ARDUPILOT, {})
    said = dict(wire.take()[1:])
    assert said.keys() == {
        "HIGHRES_IMU",
        "ESC_TELEMETRY_1_TO_4",
        "ESC_TELEMETRY_5_TO_8",
        "SERVO_OUTPUT_RAW",
        "ATTITUDE",
        "LOCAL_POSITION_NED",
        "EXTENDED_SYS_STATE",
    }
    assert all(interval % 1000.0 == 0.0 for interval in said.values())
    assert said["HIGHRES_IMU"] == 5000.0  # two turns of its loop of 400 Hz


def test_a_radio_is_asked_for_what_it_carries_and_that_is_said(wire):
    requests = Asking(wire.gate, 250.0, baud=57600)
    run(requests, wire, 1.0, {})
    hz = requests.asked["HIGHRES_IMU"]
    assert 10.0 < hz < 40.0
    assert bytes_per_second(requests.asked, 4) <= 5760.0
    (said,) = requests.take_events()
    assert said.startswith(f"57600 baud carries about {hz:.0f} Hz")
    assert "identification needs 50 Hz" in said
    assert requests.problem == said


def test_a_link_fast_enough_though_not_for_all_is_no_problem(wire):
    requests = Asking(wire.gate, 250.0, baud=230400)
    run(requests, wire, 1.0, {})
    assert 50.0 < requests.asked["HIGHRES_IMU"] < 250.0
    (said,) = requests.take_events()
    assert said.startswith("230400 baud carries")
    assert said.endswith("instead of 250 Hz")
    assert requests.problem == ""


def test_on_a_narrow_line_commands_make_room_once_the_speeds_prove_good(wire):
    requests = Asking(wire.gate, 250.0, baud=460800)
    run(requests, wire, 1.0, {})
    before = requests.asked["HIGHRES_IMU"]
    said = run(requests, wire, 2.0, dict(requests.asked), start=1.0, turning={"ESC_STATUS"})
    assert (1.0, "ACTUATOR_OUTPUT_STATUS", 0.0) in said
    assert "ACTUATOR_OUTPUT_STATUS" not in requests.asked
    assert requests.asked["HIGHRES_IMU"] > 1.3 * before
    assert bytes_per_second(requests.asked, 4) <= 46080.0


def test_a_stream_that_is_absent_takes_no_room(wire):
    requests = Asking(wire.gate, 250.0, baud=230400)
    run(requests, wire, 1.0, {})
    before = requests.asked["HIGHRES_IMU"]
    arriving = {name: hz for name, hz in requests.asked.items() if name != "ESC_STATUS"}
    run(requests, wire, 30.0, arriving, start=1.0)
    assert requests.asked["HIGHRES_IMU"] > 1.3 * before
    assert any("ESC_STATUS does not arrive" in text for text in requests.take_events())


def test_a_stream_slower_than_needed_is_told_once_and_forgiven(wire, requests):
    slow = RATES | {"HIGHRES_IMU": 4.0}
    run(requests, wire, 60.0, slow)
    (said,) = requests.take_events()
    assert said.startswith("requested 250 Hz, this link carries about 4 Hz")
    assert requests.problem == said
    run(requests, wire, 62.0, RATES, start=60.0)
    assert requests.problem == ""


def lossy(share_of, wire, requests, until):
    """Drive with a share of loss that depends on what is asked for."""
    lost = sent = 0.0
    t = 0.0
    while t < until:
        rate = sum(requests.asked.values())
        sent += 0.2 * rate
        lost += 0.2 * rate * share_of(bytes_per_second(requests.asked, 4))
        requests.tick(t, VEHICLE, RATES, lost_of=(round(lost), round(sent)))
        wire.take()
        t += 0.2


def test_a_link_that_loses_what_does_not_fit_is_asked_for_less(wire, requests):
    lossy(lambda asked: max(0.0, 1.0 - 30e3 / max(asked, 1.0)), wire, requests, 60.0)
    assert 20e3 < bytes_per_second(requests.asked, 4) <= 32e3
    (said,) = requests.take_events()
    assert "% of the messages are lost: requesting" in said


def test_a_link_that_loses_its_share_of_anything_keeps_its_rates(wire, requests):
    lossy(lambda _: 0.3, wire, requests, 120.0)
    assert requests.asked == RATES


def test_a_little_loss_changes_nothing(wire, requests):
    lossy(lambda _: 0.08, wire, requests, 60.0)
    assert requests.asked == RATES
    assert requests.take_events() == []


def test_a_vehicle_of_version_1_is_answered_in_version_1(wire, requests):
    """But for its first heartbeats: PX4 speaks 1 until it hears 2."""
    vehicle = MavlinkSystem(1, 1, 2, 12, version=1)
    versions = []
    for i in range(60):
        requests.tick(0.2 * i, vehicle, {})
    for raw in wire.raws:
        frame = read_frame(raw)
        versions.append((frame.message_id == 0, frame.version))
    heartbeats = [version for heartbeat, version in versions if heartbeat]
    assert heartbeats == [2] * requests.INTRODUCTIONS + [1] * (
        len(heartbeats) - requests.INTRODUCTIONS
    )
    assert len(heartbeats) > requests.INTRODUCTIONS
    assert {version for heartbeat, version in versions if not heartbeat} == {1}
    # Version 1 has no room for the number of ESC_STATUS.
    assert "SERVO_OUTPUT_RAW" in requests.asked
    assert not requests.asked.keys() & {"ESC_STATUS", "ACTUATOR_OUTPUT_STATUS"}


def test_a_vehicle_that_changes_to_version_2_is_asked_for_what_that_carries(wire, requests):
    requests.tick(0.0, MavlinkSystem(1, 1, 2, 12, version=1), {})
    wire.take()
    requests.tick(0.2, VEHICLE, {})
    said = wire.take()
    assert ("ESC_STATUS", 4000.0) in said
    assert ("SERVO_OUTPUT_RAW", 0.0) in said
    assert requests.asked == RATES
