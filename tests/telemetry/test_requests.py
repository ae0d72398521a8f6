"""Rates are asked for until they arrive, and given back at the end."""

import pytest

from gcs_sysid.telemetry.frames import read_frame
from gcs_sysid.telemetry.messages import message_name, unpack
from gcs_sysid.telemetry.outgoing import Gate
from gcs_sysid.telemetry.requests import ASKS_AT_MOST, StreamRequests, default_rates
from gcs_sysid.telemetry.vehicles import Vehicle

VEHICLE = Vehicle(1, 1, 2, 12)
RATES = {"HIGHRES_IMU": 250.0, "ESC_STATUS": 250.0, "ATTITUDE": 100.0}


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
    return StreamRequests(wire.gate, RATES)


def test_only_heartbeats_go_out_before_a_vehicle_is_known(wire, requests):
    for i in range(41):
        requests.tick(0.1 * i, None, {})
    assert wire.take() == [("HEARTBEAT",)] * 5


def test_every_stream_is_asked_for_once_when_the_vehicle_is_known(wire, requests):
    requests.tick(0.0, VEHICLE, {})
    requests.tick(0.1, VEHICLE, {})
    asked = {("HIGHRES_IMU", 4000.0), ("ESC_STATUS", 4000.0), ("ATTITUDE", 10000.0)}
    said = wire.take()
    assert said[0] == ("HEARTBEAT",)
    assert set(said[1:]) == asked
    assert len(said) == 4
    assert requests.asked == RATES


def test_only_slow_streams_are_asked_for_again_and_not_too_often(wire, requests):
    arriving = {"HIGHRES_IMU": 180.0, "ESC_STATUS": 1.0, "ATTITUDE": 99.0}
    again = []
    for i in range(160):
        requests.tick(0.1 * i, VEHICLE, arriving)
        again += [(0.1 * i, *s) for s in wire.take() if s[0] != "HEARTBEAT" and i > 0]
    assert [name for _, name, _ in again] == ["ESC_STATUS"] * 3
    assert [t for t, *_ in again] == pytest.approx([5.0, 10.0, 15.0], abs=0.11)


def test_a_stream_that_never_comes_is_given_up(wire, requests):
    for i in range(1000):
        requests.tick(float(i), VEHICLE, {"HIGHRES_IMU": 250.0, "ATTITUDE": 100.0})
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
    assert len(wire.take()) == 3


def test_the_vehicles_own_rates_are_restored_at_the_end(wire, requests):
    requests.tick(0.0, VEHICLE, {})
    wire.take()
    requests.close()
    assert set(wire.take()) == {(name, 0.0) for name in RATES}
    requests.close()
    assert wire.take() == []


def test_listening_only_asks_nothing(wire):
    wire.gate.listen_only = True
    requests = StreamRequests(wire.gate, RATES)
    requests.tick(0.0, VEHICLE, {})
    requests.close()
    assert wire.raws == []
    assert requests.asked == {}


def test_slow_rates_lower_what_need_not_be_faster():
    assert default_rates(20.0)["ATTITUDE"] == 20.0
    assert default_rates(250.0)["ATTITUDE"] == 100.0
    assert default_rates(250.0)["LOCAL_POSITION_NED"] == 50.0
