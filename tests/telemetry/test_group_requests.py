"""ArduPilot before 4.0 is asked for groups of messages, and given its own rates back."""

import pytest

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import read_frame
from gcs_sysid.telemetry.outgoing import Gate
from gcs_sysid.telemetry.requests import ASK_AGAIN_AFTER
from gcs_sysid.telemetry.vehicles import MavlinkSystem
from gcs_sysid.telemetry.wanted_streams import GROUPS
from testbed.payloads import unpack
from tests.telemetry.in_memory import Asking

RAW_SENSORS, RC, EXTRA1, POSITION, EXTRA3 = 1, 3, 10, 6, 12
NAMES = {
    RAW_SENSORS: "RAW_IMU",
    RC: "SERVO_OUTPUT_RAW",
    EXTRA1: "ATTITUDE",
    POSITION: "GLOBAL_POSITION_INT",
    EXTRA3: "ESC_TELEMETRY_1_TO_4",
}


class OldArduPilot:
    """Rates by groups, 50 Hz at most; it knows no SET_MESSAGE_INTERVAL.

    Attributes:
        rates: group -> Hz.
        deaf: groups that it does not heed.
        intervals: how many requests for single messages came.
    """

    def __init__(self, baud=None, version=1, rate=250.0):
        self.rates = {RAW_SENSORS: 2.0, RC: 2.0, EXTRA1: 4.0}
        self.deaf = set()
        self.intervals = 0
        self.now = 0.0
        self.vehicle = MavlinkSystem(1, 1, mavlink.MAV_TYPE_QUADROTOR, 3, version)
        self.requests = Asking(Gate(self.notice), rate, baud=baud)

    def notice(self, raw):
        frame = read_frame(raw)
        fields = unpack(frame.message_id, frame.payload)
        if frame.message_id == mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
            self.intervals += 1
        elif frame.message_id == mavlink.MAVLINK_MSG_ID_REQUEST_DATA_STREAM:
            group, rate = fields["req_stream_id"], fields["req_message_rate"]
            assert fields["start_stop"] == (rate > 0)
            if group not in self.deaf:
                self.rates[group] = float(min(rate, 50))

    def arriving(self):
        return {name: self.rates.get(group, 0.0) for group, name in NAMES.items()}

    def fly(self, seconds, **observed):
        for _ in range(round(seconds / 0.2)):
            self.requests.tick(self.now, self.vehicle, self.arriving(), **observed)
            self.now += 0.2


def test_what_single_requests_do_not_bring_groups_do():
    old = OldArduPilot()
    before = dict(old.rates)
    old.fly(9.0)
    assert old.rates == before
    old.fly(3.0)
    assert old.rates == {RAW_SENSORS: 50.0, RC: 50.0, EXTRA1: 50.0, POSITION: 10.0}
    assert old.requests.asked == {name: g.most for name, g in GROUPS.items()}
    assert any("lacks SET_MESSAGE_INTERVAL" in e for e in old.requests.take_events())
    assert old.requests.problem == ""
    heard = old.intervals
    old.fly(60.0)
    assert old.intervals == heard
    old.requests.close()
    assert old.rates == before | {POSITION: 0.0}


def test_rates_that_another_station_resets_are_asked_for_again():
    old = OldArduPilot()
    old.fly(20.0)
    old.rates |= {RAW_SENSORS: 4.0, RC: 4.0}
    old.fly(ASK_AGAIN_AFTER + 0.4)
    assert old.rates[RAW_SENSORS] == old.rates[RC] == 50.0


def test_a_group_that_never_comes_is_told():
    old = OldArduPilot()
    old.deaf = {RAW_SENSORS}
    old.fly(40.0)
    assert "requested 50 Hz, this link carries about 2 Hz" in old.requests.problem
    told = old.requests.take_events()
    assert told.count(old.requests.problem) == 1


def test_the_esc_group_is_asked_for_only_where_the_speeds_are_real():
    old = OldArduPilot()
    old.rates[EXTRA3] = 1.0
    old.fly(20.0)
    assert old.rates[EXTRA3] == 1.0
    old.fly(1.0, turning={"ESC_TELEMETRY_1_TO_4"})
    assert EXTRA3 not in old.rates or old.rates[EXTRA3] == 1.0  # version 1 cannot carry them
    new = OldArduPilot(version=2)
    new.rates[EXTRA3] = 1.0
    new.fly(20.0, turning={"ESC_TELEMETRY_1_TO_4"})
    assert new.rates[EXTRA3] == 50.0
    new.requests.close()
    assert new.rates[EXTRA3] == 1.0


@pytest.mark.parametrize(("baud", "hertz"), [(57600, 13.0), (230400, 50.0)])
def test_groups_fit_the_line(baud, hertz):
    old = OldArduPilot(baud)
    old.fly(20.0)
    assert old.rates[RAW_SENSORS] == hertz
    assert bool(old.requests.problem) is (hertz < 50.0)
    sizes = sum(old.rates[g.number] * g.size for g in GROUPS.values())
    assert sizes <= baud / 10.0


def test_arducopter_4_0_to_4_5_is_asked_for_raw_imu_alone():
    """It knows single requests, and no HIGHRES_IMU."""
    raws = []
    requests = Asking(Gate(raws.append), 250.0)
    vehicle = MavlinkSystem(1, 1, mavlink.MAV_TYPE_QUADROTOR, 3)
    for i in range(200):
        absent = ("HIGHRES_IMU", "ESC_TELEMETRY_1_TO_4")
        arriving = {name: hz for name, hz in requests.asked.items() if name not in absent}
        requests.tick(0.2 * i, vehicle, arriving)
    assert requests.asked["RAW_IMU"] == 200.0  # its loop sends 250 Hz unevenly
    numbers = {read_frame(raw).message_id for raw in raws}
    assert mavlink.MAVLINK_MSG_ID_REQUEST_DATA_STREAM not in numbers
