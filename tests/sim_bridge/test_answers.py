"""How the emulated PX4 answers a ground station, without a link between."""

import struct
from typing import Any

import numpy as np
import pytest

from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.missions import MISSIONS
from sim_bridge.px4 import Px4
from sim_bridge.simulated_vehicle import Vehicle
from sim_bridge.simulation import Simulation

CMD = {
    "set": mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
    "get": mavlink.MAV_CMD_GET_MESSAGE_INTERVAL,
    "request": mavlink.MAV_CMD_REQUEST_MESSAGE,
}


@pytest.fixture
def desk(paper_vehicle: Vehicle, open_desk: Any) -> Any:
    gusts, sensors = np.random.SeedSequence(0).spawn(2)
    simulation = Simulation(paper_vehicle, MISSIONS["hover"], gusts, 0.0)
    return open_desk(simulation, Px4(simulation, "paper", 0.02, 50.0, sensors))


def test_a_message_interval_is_set_told_and_put_back(desk: Any) -> None:
    imu = mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
    (ack,) = desk.command(CMD["set"], imu, 5000)
    assert (ack.get_type(), ack.command, ack.result) == ("COMMAND_ACK", CMD["set"], 0)
    assert (ack.target_system, ack.target_component) == (245, 190)
    assert desk.counts(0.5)["HIGHRES_IMU"] == 100
    _, interval = desk.command(CMD["get"], imu)
    assert (interval.get_type(), interval.message_id, interval.interval_us) == (
        "MESSAGE_INTERVAL",
        imu,
        5000,
    )
    desk.command(CMD["set"], imu, -1)
    assert "HIGHRES_IMU" not in desk.counts(0.2)
    assert desk.command(CMD["get"], imu)[1].interval_us == 0  # as PX4 says of what is off
    desk.command(CMD["set"], imu, 0)
    assert desk.counts(0.5)["HIGHRES_IMU"] == 25


def test_an_interval_for_an_unknown_message_fails(desk: Any) -> None:
    (ack,) = desk.command(CMD["set"], 9999, 5000)
    assert ack.result == mavlink.MAV_RESULT_FAILED


def test_messages_on_request(desk: Any) -> None:
    ack, version = desk.command(CMD["request"], mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    assert ack.result == mavlink.MAV_RESULT_ACCEPTED
    assert version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    ack, version = desk.command(mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 1)
    assert version.get_type() == "AUTOPILOT_VERSION"
    ack, protocol = desk.command(mavlink.MAV_CMD_REQUEST_PROTOCOL_VERSION, 1)
    assert protocol.max_version == 200
    (ack,) = desk.command(CMD["request"], 9999)
    assert ack.result == mavlink.MAV_RESULT_DENIED


@pytest.mark.parametrize(
    "number", [mavlink.MAV_CMD_COMPONENT_ARM_DISARM, mavlink.MAV_CMD_NAV_LAND, 31000]
)
def test_other_commands_are_unsupported(desk: Any, number: int) -> None:
    (ack,) = desk.command(number, 1)
    assert ack.result == mavlink.MAV_RESULT_UNSUPPORTED
    assert ack.command == number


def test_commands_for_others_are_left_alone(desk: Any) -> None:
    imu = mavlink.MAVLINK_MSG_ID_HIGHRES_IMU
    assert desk.command(CMD["set"], imu, 5000, target=(2, 1)) == []
    assert desk.command(CMD["set"], imu, 5000, target=(1, 154)) == []
    assert len(desk.command(CMD["set"], imu, 5000, target=(0, 0))) == 1


def as_int(value: float) -> int:
    return int(struct.unpack("<i", struct.pack("<f", value))[0])


def test_parameters_are_listed_read_and_set(desk: Any) -> None:
    listed = desk.ask(mavlink.MAVLink_param_request_list_message(1, 1))
    assert [m.param_index for m in listed] == list(range(listed[0].param_count))
    by_name = {m.param_id: m for m in listed}
    assert {"MAV_SYS_ID", "SYS_AUTOSTART", "CA_ROTOR_COUNT"} <= set(by_name)
    assert by_name["CA_ROTOR_COUNT"].param_type == mavlink.MAV_PARAM_TYPE_INT32
    assert as_int(by_name["CA_ROTOR_COUNT"].param_value) == 4
    assert by_name["CA_ROTOR0_PX"].param_value == 0.25
    (read,) = desk.ask(mavlink.MAVLink_param_request_read_message(1, 1, b"MAV_SYS_ID", -1))
    assert as_int(read.param_value) == 1
    (read,) = desk.ask(mavlink.MAVLink_param_request_read_message(1, 1, b"", 2))
    assert read.param_index == 2
    assert desk.ask(mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1)) == []
    real = mavlink.MAV_PARAM_TYPE_REAL32
    (told,) = desk.ask(mavlink.MAVLink_param_set_message(1, 1, b"THR_MDL_FAC", 0.5, real))
    assert told.param_value == 0.5


def test_no_parameter_tells_the_truth(desk: Any) -> None:
    truths = {round(x, 9) for x in (1.5, 0.0165, 0.0167, 0.0294, 2.05e-4, 6.14e-6, 15.0)}
    assert not truths & {round(p.value, 9) for p in desk.autopilot.parameters}
