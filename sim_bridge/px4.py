"""The emulated autopilot as PX4: which messages it streams and how it answers."""

from collections.abc import Callable
from typing import Any

import numpy as np

from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.autopilot import Schedule
from sim_bridge.instruments import Instruments
from sim_bridge.px4_messages import FlightMessages
from sim_bridge.px4_parameters import parameter_table
from sim_bridge.px4_status import StatusMessages
from sim_bridge.sensors import make_channels
from sim_bridge.simulation import Simulation
from sim_bridge.wire import FrameWriter

# Which messages read which sensor: its noise is drawn at the pace of the fastest of them.
_READERS: dict[str, tuple[int, ...]] = {
    "gyro": (mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,),
    "accelerometer": (mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,),
    "attitude": (mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION),
    "rotor": (mavlink.MAVLINK_MSG_ID_ESC_STATUS,),
    "velocity": (mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,),
}


class Px4:
    """PX4 on one link.

    Attributes:
        schedule: the streams.
        writer: makes the frames.
        parameters: as PARAM_VALUE shows them.
    """

    def __init__(
        self,
        simulation: Simulation,
        noise: str,
        sigma: float,
        rate: float,
        seed: np.random.SeedSequence,
    ) -> None:
        self._sim = simulation
        self.writer = FrameWriter(1, 1)
        self.parameters = parameter_table(simulation.vehicle, self.writer.sysid)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        attitude = min(rate, 100.0)
        intervals = {
            "gyro": 1.0 / rate,
            "accelerometer": 1.0 / rate,
            "attitude": 1.0 / attitude,
            "rotor": 1.0 / rate,
            "velocity": 1.0 / min(rate, 50.0),
        }
        channels = make_channels(noise, sigma, intervals, len(simulation.vehicle.rotors), seed)
        self._instruments = Instruments(simulation, channels)
        self._flight = FlightMessages(self._instruments, self.writer)
        self._status = StatusMessages(self._instruments, self.writer)
        self.schedule = self._streams(rate)
        self._handlers: dict[str, Callable[[Any], list[bytes]]] = {
            "COMMAND_LONG": self._command,
            "COMMAND_INT": self._command,
            "TIMESYNC": self._timesync,
            "PING": self._ping,
            "PARAM_REQUEST_LIST": self._parameter_list,
            "PARAM_REQUEST_READ": self._parameter_read,
            "PARAM_SET": self._parameter_set,
            "MISSION_REQUEST_LIST": self._mission_list,
        }

    def _streams(self, rate: float) -> Schedule:
        """The streams in the order of sending: the IMU first, as PX4's samples come first."""
        flight, status = self._flight, self._status
        attitude = min(rate, 100.0)
        position = min(rate, 50.0)
        schedule = Schedule()
        for msgid, hertz, maker in (
            (mavlink.MAVLINK_MSG_ID_HIGHRES_IMU, rate, flight.highres_imu),
            (mavlink.MAVLINK_MSG_ID_ATTITUDE, attitude, flight.attitude),
            (mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, attitude, flight.attitude_quaternion),
            (mavlink.MAVLINK_MSG_ID_ESC_STATUS, rate, flight.esc_status),
            (mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS, rate, flight.actuator_output_status),
            (mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, rate, flight.servo_output_raw),
            (mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, position, flight.local_position_ned),
            (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 5.0, status.global_position_int),
            (mavlink.MAVLINK_MSG_ID_VFR_HUD, 4.0, status.vfr_hud),
            (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 2.0, flight.extended_sys_state),
            (mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, 2.0, status.gps_raw_int),
            (mavlink.MAVLINK_MSG_ID_HEARTBEAT, 1.0, status.heartbeat),
            (mavlink.MAVLINK_MSG_ID_SYS_STATUS, 1.0, status.sys_status),
            (mavlink.MAVLINK_MSG_ID_SYSTEM_TIME, 1.0, status.system_time),
            (mavlink.MAVLINK_MSG_ID_ESC_INFO, 1.0, flight.esc_info),
            (mavlink.MAVLINK_MSG_ID_BATTERY_STATUS, 0.5, status.battery_status),
            (mavlink.MAVLINK_MSG_ID_HOME_POSITION, 0.5, status.home_position),
            (mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, 0.0, status.autopilot_version),
            (mavlink.MAVLINK_MSG_ID_PROTOCOL_VERSION, 0.0, status.protocol_version),
        ):
            schedule.add(msgid, hertz, maker)
        return schedule

    def poll(self, tick: int) -> list[bytes]:
        """Frames due at this physics step."""
        frames: list[bytes] = []
        for stream in self.schedule.take(tick):
            frames += stream.make()
        return frames

    def receive(self, data: bytes, tick: int) -> list[bytes]:
        """Frames that answer what a ground station sent."""
        del tick  # answers carry the simulation's own time
        answers = []
        for message in self._parser.parse_buffer(data) or ():
            handler = self._handlers.get(message.get_type())
            if handler is not None and self._is_for_us(message):
                answers += handler(message)
        return answers

    def _is_for_us(self, message: Any) -> bool:
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self.writer.sysid) and component in (0, self.writer.compid)

    # Commands

    def _command(self, message: Any) -> list[bytes]:
        result, extra = self._execute(message)
        ack = self.writer.frame(
            mavlink.MAVLink_command_ack_message,
            message.command,
            result,
            0,
            0,
            message.get_srcSystem(),
            message.get_srcComponent(),
        )
        return [ack, *extra]

    def _execute(self, message: Any) -> tuple[int, list[bytes]]:
        """Do what a command asks: its MAV_RESULT and the messages asked for."""
        accepted: int = mavlink.MAV_RESULT_ACCEPTED
        match message.command:
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                if any((message.param3, message.param4, getattr(message, "param7", 0.0))):
                    return mavlink.MAV_RESULT_DENIED, []
                return self._set_interval(round(message.param1), message.param2), []
            case mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
                return accepted, [self._interval(round(message.param1))]
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                stream = self.schedule.streams.get(round(message.param1))
                if stream is None:
                    return mavlink.MAV_RESULT_DENIED, []
                return accepted, stream.make()
            case mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
                return accepted, self._status.autopilot_version()
            case mavlink.MAV_CMD_REQUEST_PROTOCOL_VERSION:
                return accepted, self._status.protocol_version()
            case mavlink.MAV_CMD_GET_HOME_POSITION:
                return accepted, self._status.home_position()
        return mavlink.MAV_RESULT_UNSUPPORTED, []

    def _set_interval(self, msgid: int, interval: float) -> int:
        if not self.schedule.set_interval(msgid, interval, self._sim.tick):
            return int(mavlink.MAV_RESULT_FAILED)
        for sensor, readers in _READERS.items():
            paces = [self.schedule.streams[r].interval for r in readers]
            if msgid in readers and any(paces):
                self._instruments.retime(sensor, min(p for p in paces if p) * 1e-6)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _interval(self, msgid: int) -> bytes:
        """MESSAGE_INTERVAL: 0 for a message there is none of, -1 for one that is off."""
        stream = self.schedule.streams.get(msgid)
        interval = 0 if stream is None else round(stream.interval) or -1
        return self.writer.frame(mavlink.MAVLink_message_interval_message, interval, msgid & 0xFFFF)

    # Time, parameters, mission

    def _timesync(self, message: Any) -> list[bytes]:
        if message.tc1 != 0:
            return []  # an answer to somebody else's question
        now = self._instruments.now_us * 1000
        return [self.writer.frame(mavlink.MAVLink_timesync_message, now, message.ts1)]

    def _ping(self, message: Any) -> list[bytes]:
        if message.target_system or message.target_component:
            return []
        return [
            self.writer.frame(
                mavlink.MAVLink_ping_message,
                message.time_usec,
                message.seq,
                message.get_srcSystem(),
                message.get_srcComponent(),
            )
        ]

    def _parameter(self, index: int) -> bytes:
        parameter = self.parameters[index]
        return self.writer.frame(
            mavlink.MAVLink_param_value_message,
            parameter.wire,
            len(self.parameters),
            index,
            parameter.name.encode(),
            parameter.kind,
        )

    def _index(self, name: str) -> int | None:
        for i, parameter in enumerate(self.parameters):
            if parameter.name == name:
                return i
        return None

    def _parameter_list(self, message: Any) -> list[bytes]:
        del message
        return [self._parameter(i) for i in range(len(self.parameters))]

    def _parameter_read(self, message: Any) -> list[bytes]:
        index: int | None = message.param_index
        if index is not None and index < 0:
            index = self._index(message.param_id)
        if index is None or index >= len(self.parameters):
            return []
        return [self._parameter(index)]

    def _parameter_set(self, message: Any) -> list[bytes]:
        index = self._index(message.param_id)
        if index is None:
            return []
        self.parameters[index].set(message.param_value)
        return [self._parameter(index)]

    def _mission_list(self, message: Any) -> list[bytes]:
        return [
            self.writer.frame(
                mavlink.MAVLink_mission_count_message,
                0,
                message.get_srcSystem(),
                message.get_srcComponent(),
                getattr(message, "mission_type", 0),
            )
        ]
