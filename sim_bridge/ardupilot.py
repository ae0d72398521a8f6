"""The emulated autopilot as ArduCopter: silent until asked, rates in whole milliseconds."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.answering import ACCEPTED, DENIED, FAILED, UNSUPPORTED, AnsweringAutopilot
from sim_bridge.ardupilot_instruments import ESC_PERIOD, ArduPilotInstruments
from sim_bridge.ardupilot_messages import ArduPilotMessages
from sim_bridge.ardupilot_parameters import ardupilot_parameters
from sim_bridge.autopilot import Schedule, vehicle_clock
from sim_bridge.fault_injection import FaultInjector
from sim_bridge.sensor_faults import NO_SENSOR_FAULTS, SensorFaults
from sim_bridge.sensors import make_channels
from sim_bridge.simulation import Simulation
from sim_bridge.status_messages import Identity, StatusMessages
from sim_bridge.vehicle_parameters import Parameter
from sim_bridge.wire import FrameWriter

STEP_US = 1250
"""Step of the physics for this autopilot: half its loop."""

LOOP_STEPS = 2
"""Physics steps a turn of the main loop: 400 Hz. Messages are sent, and rotors commanded, then."""

LEAST_INTERVAL_MS = 3
"""No message more often: 0.8 times the loop's rate, in whole milliseconds."""

MOST_INTERVAL_MS = 60_000

LEAST_INTERVAL_BEFORE_4_MS = 20
"""Of groups, before 4.0."""

BOOT_US = 60_000_000
"""The vehicle's clock at the start of the flight: long enough for the EKF to have a position."""

IDENTITY = Identity(
    autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
    custom_mode=4,  # guided
    capabilities=(
        mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
        | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    ),
    version=(4, 7, 0, 0),  # a development version
)

_GROUPS: dict[int, tuple[int, ...]] = {
    mavlink.MAV_DATA_STREAM_RAW_SENSORS: (
        mavlink.MAVLINK_MSG_ID_RAW_IMU,
        mavlink.MAVLINK_MSG_ID_SCALED_IMU2,
        mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE,
    ),
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
        mavlink.MAVLINK_MSG_ID_MISSION_CURRENT,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
    ),
    mavlink.MAV_DATA_STREAM_RC_CHANNELS: (
        mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,
        mavlink.MAVLINK_MSG_ID_RC_CHANNELS,
    ),
    mavlink.MAV_DATA_STREAM_POSITION: (
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    ),
    mavlink.MAV_DATA_STREAM_EXTRA1: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
    mavlink.MAV_DATA_STREAM_EXTRA2: (mavlink.MAVLINK_MSG_ID_VFR_HUD,),
    mavlink.MAV_DATA_STREAM_EXTRA3: (
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
        mavlink.MAVLINK_MSG_ID_VIBRATION,
        mavlink.MAVLINK_MSG_ID_ESC_TELEMETRY_1_TO_4,
    ),
}
"""Messages that REQUEST_DATA_STREAM sets the rate of, by group."""


def recorder_rates(rate: float) -> dict[int, float]:
    """Message number -> Hz that a recording ground station asks for, given that of the IMU."""
    return {
        mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: rate,
        mavlink.MAVLINK_MSG_ID_ESC_TELEMETRY_1_TO_4: rate,
        mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: rate,
        mavlink.MAVLINK_MSG_ID_ATTITUDE: min(rate, 100.0),
        mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: min(rate, 100.0),
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: min(rate, 50.0),
        mavlink.MAVLINK_MSG_ID_RAW_IMU: min(rate, 50.0),
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
        mavlink.MAVLINK_MSG_ID_VFR_HUD: 4.0,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 2.0,
        mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    }


class ArduPilot(AnsweringAutopilot):
    """ArduCopter on one link: HEARTBEAT and STATUSTEXT, and what is asked for.

    Args:
        simulation: what it flies, in steps of `STEP_US`.
        noise: one of `NOISE_MODELS`; of gyro and accelerometer before their filters.
        sigma: of the models that take one.
        seed: of the sensors.
        sensor_faults: in force.
        writer: makes the frames; None for unsigned MAVLink 2 of system 1.
        asked: message number -> Hz, as if a ground station had asked before the flight.
    """

    _no_such_message = FAILED

    def __init__(
        self,
        simulation: Simulation,
        noise: str,
        sigma: float,
        seed: np.random.SeedSequence,
        sensor_faults: SensorFaults = NO_SENSOR_FAULTS,
        writer: FrameWriter | None = None,
        asked: Mapping[int, float] | None = None,
    ) -> None:
        writer = writer or FrameWriter(1, 1)
        vehicle = simulation.vehicle
        intervals = {
            "gyro": simulation.step_size,
            "accelerometer": simulation.step_size,
            "attitude": 0.01,
            "rotor": ESC_PERIOD,
            "velocity": 0.02,
        }
        channels = make_channels(noise, sigma, intervals, len(vehicle.rotors), seed)
        faults, link = seed.spawn(2)
        self._instruments = ArduPilotInstruments(
            simulation,
            channels,
            vehicle_clock(sensor_faults, simulation.step_us, BOOT_US),
            FaultInjector(vehicle, sensor_faults, faults),
        )
        super().__init__(self._instruments, writer, link)
        self._handlers["REQUEST_DATA_STREAM"] = self._data_stream
        self.parameters = ardupilot_parameters(vehicle, writer.sysid)
        self._flight = ArduPilotMessages(self._instruments, writer)
        self._status = StatusMessages(self._instruments, writer, IDENTITY)
        self.schedule = Schedule(simulation.step_us)
        self._make_streams()
        if sensor_faults.groups_only:
            self._never_sent.add(mavlink.MAVLINK_MSG_ID_HIGHRES_IMU)
        self._asked = dict(asked or {})
        self._ask(0)

    def _ask(self, tick: int) -> None:
        for msgid, hertz in self._asked.items():
            if msgid in self.schedule.streams:
                self._set_milliseconds(msgid, int(1e3 / hertz), tick)

    @property
    def rotor_delay(self) -> float:
        """S by which rotor speeds lag behind the IMU's stamps, its filter apart."""
        if mavlink.MAVLINK_MSG_ID_ESC_TELEMETRY_1_TO_4 in self._never_sent:
            return super().rotor_delay - ESC_PERIOD
        return super().rotor_delay

    def _make_streams(self) -> None:
        flight, status = self._flight, self._status
        self._add_streams(
            [
                (mavlink.MAVLINK_MSG_ID_HEARTBEAT, 1.0, status.heartbeat),
                (mavlink.MAVLINK_MSG_ID_HIGHRES_IMU, 0.0, flight.highres_imu),
                (mavlink.MAVLINK_MSG_ID_RAW_IMU, 0.0, flight.raw_imu),
                (mavlink.MAVLINK_MSG_ID_SCALED_IMU2, 0.0, flight.scaled_imu2),
                (mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE, 0.0, flight.scaled_pressure),
                (mavlink.MAVLINK_MSG_ID_SYS_STATUS, 0.0, status.sys_status),
                (mavlink.MAVLINK_MSG_ID_MISSION_CURRENT, 0.0, flight.mission_current),
                (mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, 0.0, status.gps_raw_int),
                (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 0.0, status.global_position_int),
                (mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, 0.0, flight.local_position_ned),
                (mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, 0.0, flight.servo_output_raw),
                (mavlink.MAVLINK_MSG_ID_RC_CHANNELS, 0.0, flight.rc_channels),
                (mavlink.MAVLINK_MSG_ID_ATTITUDE, 0.0, flight.attitude),
                (mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, 0.0, flight.attitude_quaternion),
                (mavlink.MAVLINK_MSG_ID_VFR_HUD, 0.0, status.vfr_hud),
                (mavlink.MAVLINK_MSG_ID_SYSTEM_TIME, 0.0, status.system_time),
                (mavlink.MAVLINK_MSG_ID_BATTERY_STATUS, 0.0, status.battery_status),
                (mavlink.MAVLINK_MSG_ID_VIBRATION, 0.0, flight.vibration),
                (mavlink.MAVLINK_MSG_ID_ESC_TELEMETRY_1_TO_4, 0.0, flight.esc_telemetry),
                (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 0.0, flight.extended_sys_state),
                (mavlink.MAVLINK_MSG_ID_HOME_POSITION, 0.0, status.home_position),
                (mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, 0.0, status.autopilot_version),
                (mavlink.MAVLINK_MSG_ID_PROTOCOL_VERSION, 0.0, status.protocol_version),
            ]
        )

    def poll(self, tick: int) -> list[bytes]:
        """Frames due at this physics step: messages leave once a turn of the main loop."""
        if tick % LOOP_STEPS:
            self.instruments.advance()
            return []
        # Made before the others: their numbers follow.
        banner = self._banner() if tick == self._silent_until else []
        return [*banner, *super().poll(tick)]

    def _tick_of(self, time: float) -> int:
        tick = super()._tick_of(time)
        return tick + tick % LOOP_STEPS if tick > 0 else tick

    def _banner(self) -> list[bytes]:
        texts = ["ArduCopter V4.7.0-dev (emulated)", f"Frame: {len(self._sim.vehicle.rotors)}/X"]
        return [self._flight.text(words) for words in texts]

    def _set_interval(self, message: Any) -> int:
        if self._sensor_faults.groups_only:
            return UNSUPPORTED
        msgid, asked = round(message.param1), message.param2
        stream = self.schedule.streams.get(msgid)
        if stream is None:
            return DENIED
        if asked == 0:
            interval = round(1e-3 * stream.default)
        elif asked == -1:
            interval = 0
        else:
            # Fractions of a millisecond are cut, not rounded.
            interval = max(1, min(MOST_INTERVAL_MS, int(asked / 1000)))
        self._set_milliseconds(msgid, interval, self._sim.tick)
        return ACCEPTED

    def _set_milliseconds(self, msgid: int, interval: int, tick: int) -> None:
        """Send so often; 0 for never."""
        interval = max(interval, LEAST_INTERVAL_MS) if interval else -1
        self.schedule.set_interval(msgid, 1e3 * interval, tick)

    def _data_stream(self, message: Any) -> list[bytes]:
        if message.start_stop in (0, 1):
            rate = message.req_message_rate if message.start_stop else 0
            self._set_group(message.req_stream_id, rate, self._sim.tick)
        return []

    def _set_group(self, group: int, rate: int, tick: int) -> None:
        """Set the rates of a group's messages, overriding earlier requests for each."""
        groups = _GROUPS if group == mavlink.MAV_DATA_STREAM_ALL else (group,)
        least = LEAST_INTERVAL_BEFORE_4_MS if self._sensor_faults.groups_only else LEAST_INTERVAL_MS
        interval = max(1000 // rate, least) if rate else 0
        for number in groups:
            for msgid in _GROUPS.get(number, ()):
                stream = self.schedule.streams.get(msgid)
                if stream is not None:
                    stream.default = 1e3 * interval
                    self._set_milliseconds(msgid, interval, tick)

    def _restart(self, tick: int) -> None:
        super()._restart(tick)
        self._ask(self._silent_until)

    def _reset_rates(self, tick: int) -> None:
        self._set_group(mavlink.MAV_DATA_STREAM_ALL, 4, tick)

    def _parameter_list(self, message: Any) -> list[bytes]:
        return [*self._banner(), *super()._parameter_list(message)]

    def _parameter_read(self, message: Any) -> list[bytes]:
        if message.param_index >= 0:
            return super()._parameter_read(message)
        # Asked by name, ArduPilot does not look up the number.
        index = self._index(message.param_id)
        return [] if index is None else [self._parameter(index, 0xFFFF)]

    def _parameter_set(self, message: Any) -> list[bytes]:
        index = self._index(message.param_id)
        if index is None:
            return []
        self._take_parameter(self.parameters[index], message.param_value)
        return [self._parameter(index, 0xFFFF)]

    def _take_parameter(self, parameter: Parameter, wire: float) -> None:
        super()._take_parameter(parameter, wire)
        if parameter.name == "INS_GYRO_FILTER":
            self._instruments.gyro_filter.set_cutoff(float(parameter.value))
        elif parameter.name == "INS_ACCEL_FILTER":
            self._instruments.accelerometer_filter.set_cutoff(float(parameter.value))
