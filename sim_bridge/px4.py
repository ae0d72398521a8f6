"""The emulated autopilot as PX4: which messages it streams and how it answers."""

from typing import Any

import numpy as np

from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.answering import ACCEPTED, DENIED, FAILED, AnsweringAutopilot
from sim_bridge.autopilot import Schedule, vehicle_clock
from sim_bridge.fault_injection import FaultInjector
from sim_bridge.instruments import Instruments
from sim_bridge.px4_messages import Px4Messages
from sim_bridge.px4_parameters import px4_parameters
from sim_bridge.sensor_faults import NO_SENSOR_FAULTS, SensorFaults
from sim_bridge.sensors import make_channels
from sim_bridge.simulation import Simulation
from sim_bridge.status_messages import Identity, StatusMessages
from sim_bridge.wire import FrameWriter

# Which messages read which sensor: its noise is drawn at the pace of the fastest of them.
_READERS: dict[str, tuple[int, ...]] = {
    "gyro": (mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,),
    "accelerometer": (mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,),
    "attitude": (mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION),
    "rotor": (mavlink.MAVLINK_MSG_ID_ESC_STATUS,),
    "velocity": (mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,),
}

IDENTITY = Identity(
    autopilot=mavlink.MAV_AUTOPILOT_PX4,
    custom_mode=6 << 16,  # offboard
    capabilities=(
        mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
        | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    ),
    version=(1, 17, 0, 64),  # an alpha
)


class Px4(AnsweringAutopilot):
    """PX4 on one link: it streams at once, at the rates of a wide onboard link.

    Args:
        simulation: what it flies.
        noise: one of `NOISE_MODELS`.
        sigma: of the models that take one.
        rate: of IMU and rotors, Hz.
        seed: of the sensors.
        sensor_faults: in force.
        writer: makes the frames; None for unsigned MAVLink 2 of system 1.
    """

    def __init__(
        self,
        simulation: Simulation,
        noise: str,
        sigma: float,
        rate: float,
        seed: np.random.SeedSequence,
        sensor_faults: SensorFaults = NO_SENSOR_FAULTS,
        writer: FrameWriter | None = None,
    ) -> None:
        writer = writer or FrameWriter(1, 1)
        intervals = {
            "gyro": 1.0 / rate,
            "accelerometer": 1.0 / rate,
            "attitude": 1.0 / min(rate, 100.0),
            "rotor": 1.0 / rate,
            "velocity": 1.0 / min(rate, 50.0),
        }
        vehicle = simulation.vehicle
        channels = make_channels(noise, sigma, intervals, len(vehicle.rotors), seed)
        faults, link = seed.spawn(2)
        instruments = Instruments(
            simulation,
            channels,
            vehicle_clock(sensor_faults, simulation.step_us),
            FaultInjector(vehicle, sensor_faults, faults),
        )
        super().__init__(instruments, writer, link)
        self.parameters = px4_parameters(vehicle, writer.sysid)
        self._flight = Px4Messages(instruments, writer)
        self._status = StatusMessages(instruments, writer, IDENTITY)
        self.schedule = Schedule(simulation.step_us)
        self._make_streams(rate)

    def _make_streams(self, rate: float) -> None:
        """The streams in the order of sending: the IMU first, as PX4's samples come first."""
        flight, status = self._flight, self._status
        attitude = min(rate, 100.0)
        position = min(rate, 50.0)
        self._add_streams(
            [
                (mavlink.MAVLINK_MSG_ID_HIGHRES_IMU, rate, flight.highres_imu),
                (mavlink.MAVLINK_MSG_ID_ATTITUDE, attitude, flight.attitude),
                (mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, attitude, flight.attitude_quaternion),
                (mavlink.MAVLINK_MSG_ID_ESC_STATUS, rate, flight.esc_status),
                (
                    mavlink.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS,
                    rate,
                    flight.actuator_output_status,
                ),
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
            ]
        )

    _off = 0

    def _set_interval(self, message: Any) -> int:
        if any((message.param3, message.param4, getattr(message, "param7", 0.0))):
            return DENIED
        msgid = round(message.param1)
        stream = self.schedule.streams.get(msgid)
        if stream is not None and message.param2 == 0 and stream.default == 0:
            return ACCEPTED  # not in the link's mode: PX4 leaves it as it is
        if not self.schedule.set_interval(msgid, message.param2, self._sim.tick):
            return FAILED
        streams = self.schedule.streams
        for sensor, readers in _READERS.items():
            paces = [streams[r].interval for r in readers if r in streams]
            if msgid in readers and any(paces):
                self.instruments.retime(sensor, min(p for p in paces if p) * 1e-6)
        return ACCEPTED
