"""The messages of an emulated PX4, made from its instruments.

Fields are passed in wire order, which is not the order of the definitions: see
`ordered_fieldnames` of the dialect's classes.
"""

import math

from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.autopilot import BOOT_US, EPOCH_US, STEP_US
from sim_bridge.dynamics import rotate_to_body
from sim_bridge.instruments import MAGNETIC_FIELD, Instruments, quaternion_of
from sim_bridge.wire import FrameWriter

HOME = (47.397742, 8.545594, 488.0)
"""Latitude, longitude (deg) and height (m) of the take-off point: PX4's own simulated home."""

EARTH_RADIUS = 6371000.0
"""m"""

OFFBOARD = 6 << 16
"""PX4's custom_mode in which a companion computer flies, as the mission does here."""

IMU_FIELDS = 63
"""HIGHRES_IMU fields_updated: accelerometer and gyro."""

CELLS = 4
CELL_FULL = 4.1
"""V"""
CELL_SAG = 4.0e-4
"""V/s: 10 minutes of flight take a quarter of a volt off each cell."""

_TYPES = {
    4: mavlink.MAV_TYPE_QUADROTOR,
    6: mavlink.MAV_TYPE_HEXAROTOR,
    8: mavlink.MAV_TYPE_OCTOROTOR,
    10: mavlink.MAV_TYPE_DECAROTOR,
    12: mavlink.MAV_TYPE_DODECAROTOR,
}
_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mavlink.MAV_SYS_STATUS_AHRS
)
_RPM = 30.0 / math.pi


class Px4Messages:
    """Makes each message for the instant the simulation is at, as one or more frames.

    Attributes:
        instruments: what is measured.
        writer: makes the frames.
    """

    def __init__(self, instruments: Instruments, writer: FrameWriter) -> None:
        self.instruments = instruments
        self.writer = writer
        self._sim = instruments.simulation
        self._rotors = len(self._sim.vehicle.rotors)

    @property
    def now_us(self) -> int:
        """The vehicle's clock, us since it was switched on."""
        return BOOT_US + self._sim.tick * STEP_US

    @property
    def now_ms(self) -> int:
        """The same in ms, as 32 bits hold it."""
        return (self.now_us // 1000) & 0xFFFFFFFF

    def heartbeat(self) -> list[bytes]:
        """HEARTBEAT: armed and flying, in offboard mode."""
        mode = (
            mavlink.MAV_MODE_FLAG_SAFETY_ARMED
            | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
            | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        )
        kind = _TYPES.get(self._rotors, mavlink.MAV_TYPE_GENERIC_MULTIROTOR)
        return [
            self.writer.frame(
                mavlink.MAVLink_heartbeat_message,
                OFFBOARD,
                kind,
                mavlink.MAV_AUTOPILOT_PX4,
                mode,
                mavlink.MAV_STATE_ACTIVE,
                3,
            )
        ]

    def highres_imu(self) -> list[bytes]:
        """HIGHRES_IMU."""
        (p, q, r), (x, y, z) = self.instruments.inertial()
        state = self._sim.state
        height = HOME[2] - state.body[2]
        # Standard atmosphere near the ground, hPa.
        pressure = 1013.25 * (1.0 - 2.25577e-5 * height) ** 5.25588
        return [
            self.writer.frame(
                mavlink.MAVLink_highres_imu_message,
                self.now_us,
                x,
                y,
                z,
                p,
                q,
                r,
                *rotate_to_body(state.quaternion, MAGNETIC_FIELD),
                pressure,
                0.0,
                height,
                35.0,
                IMU_FIELDS,
                0,
            )
        ]

    def attitude(self) -> list[bytes]:
        """ATTITUDE."""
        return [
            self.writer.frame(
                mavlink.MAVLink_attitude_message,
                self.now_ms,
                *self.instruments.attitude(),
                *self.instruments.rates(),
            )
        ]

    def attitude_quaternion(self) -> list[bytes]:
        """ATTITUDE_QUATERNION."""
        return [
            self.writer.frame(
                mavlink.MAVLink_attitude_quaternion_message,
                self.now_ms,
                *quaternion_of(*self.instruments.attitude()),
                *self.instruments.rates(),
                0.0,
                0.0,
                0.0,
                0.0,
            )
        ]

    def esc_status(self) -> list[bytes]:
        """ESC_STATUS, four rotors a message, in motor order."""
        speeds = self.instruments.rotor_speeds()
        k_M = self._sim.vehicle.k_M
        volts = self.voltage
        frames = []
        for first in range(0, self._rotors, 4):
            group = speeds[first : first + 4]
            gap = [0] * (4 - len(group))
            # Electrical power is shaft power over an efficiency of 0.8.
            amps = [k_M * s * s * s / (0.8 * volts) for s in group]
            frames.append(
                self.writer.frame(
                    mavlink.MAVLink_esc_status_message,
                    self.now_us,
                    *[round(s * _RPM) for s in group],
                    *gap,
                    *[volts] * len(group),
                    *gap,
                    *amps,
                    *gap,
                    first,
                )
            )
        return frames

    def esc_info(self) -> list[bytes]:
        """ESC_INFO, four rotors a message."""
        n = self._rotors
        frames = []
        for first in range(0, n, 4):
            here = min(4, n - first)
            gap = [0] * (4 - here)
            frames.append(
                self.writer.frame(
                    mavlink.MAVLink_esc_info_message,
                    self.now_us,
                    0,
                    0,
                    0,
                    0,
                    (self._sim.tick // 1000) & 0xFFFF,
                    0,
                    0,
                    0,
                    0,
                    *[4500] * here,  # centidegrees
                    *gap,
                    first,
                    n,
                    0,
                    (1 << n) - 1 & 0xFF,
                )
            )
        return frames

    def actuator_output_status(self) -> list[bytes]:
        """ACTUATOR_OUTPUT_STATUS: the commands on the range of the outputs."""
        outputs = self._outputs()
        return [
            self.writer.frame(
                mavlink.MAVLink_actuator_output_status_message,
                self.now_us,
                len(outputs),
                *outputs,
                *[0.0] * (32 - len(outputs)),
            )
        ]

    def servo_output_raw(self) -> list[bytes]:
        """SERVO_OUTPUT_RAW: the same, rounded; its clock wraps after 71.6 minutes."""
        outputs = [round(x) for x in self._outputs()[:16]]
        outputs += [0] * (16 - len(outputs))
        return [
            self.writer.frame(
                mavlink.MAVLink_servo_output_raw_message,
                self.now_us & 0xFFFFFFFF,
                *outputs[:8],
                0,
                *outputs[8:],
            )
        ]

    def _outputs(self) -> list[float]:
        span = self._sim.vehicle.command
        return [span.min + u * (span.max - span.min) for u in self.instruments.commands()]

    def local_position_ned(self) -> list[bytes]:
        """LOCAL_POSITION_NED."""
        return [
            self.writer.frame(
                mavlink.MAVLink_local_position_ned_message,
                self.now_ms,
                *self._sim.state.position,
                *self.instruments.velocity(),
            )
        ]

    def extended_sys_state(self) -> list[bytes]:
        """EXTENDED_SYS_STATE: in the air."""
        return [
            self.writer.frame(
                mavlink.MAVLink_extended_sys_state_message,
                mavlink.MAV_VTOL_STATE_UNDEFINED,
                mavlink.MAV_LANDED_STATE_IN_AIR,
            )
        ]

    @property
    def voltage(self) -> float:
        """Of the battery, V."""
        return CELLS * (CELL_FULL - CELL_SAG * self._sim.time)

    @property
    def current(self) -> float:
        """Of the battery, A."""
        vehicle = self._sim.vehicle
        power = sum(vehicle.k_M * s * s * s for s in self._sim.state.speeds) / 0.8
        return float(power / self.voltage)

    @property
    def remaining(self) -> int:
        """Of the battery, %."""
        return max(5, 95 - int(self._sim.time / 12.0))

    def sys_status(self) -> list[bytes]:
        """SYS_STATUS."""
        return [
            self.writer.frame(
                mavlink.MAVLink_sys_status_message,
                _SENSORS,
                _SENSORS,
                _SENSORS,
                350,
                round(self.voltage * 1000.0),
                round(self.current * 100.0),
                0,
                0,
                0,
                0,
                0,
                0,
                self.remaining,
                0,
                0,
                0,
            )
        ]

    def battery_status(self) -> list[bytes]:
        """BATTERY_STATUS."""
        cell = round(self.voltage / CELLS * 1000.0)
        return [
            self.writer.frame(
                mavlink.MAVLink_battery_status_message,
                round(self.current * self._sim.time / 3.6),
                -1,
                2500,
                *[cell] * CELLS,
                *[0xFFFF] * (10 - CELLS),
                round(self.current * 100.0),
                0,
                mavlink.MAV_BATTERY_FUNCTION_ALL,
                mavlink.MAV_BATTERY_TYPE_LIPO,
                self.remaining,
                0,
                mavlink.MAV_BATTERY_CHARGE_STATE_OK,
                0,
                0,
                0,
                0,
                0,
                0,
            )
        ]

    def system_time(self) -> list[bytes]:
        """SYSTEM_TIME."""
        return [
            self.writer.frame(
                mavlink.MAVLink_system_time_message, EPOCH_US + self.now_us, self.now_ms
            )
        ]

    def _place(self) -> tuple[int, int, float]:
        """Latitude and longitude in 1e-7 deg, height above the sea in m."""
        north, east, down = self._sim.state.position
        latitude = HOME[0] + math.degrees(north / EARTH_RADIUS)
        narrower = math.cos(math.radians(HOME[0]))
        longitude = HOME[1] + math.degrees(east / (EARTH_RADIUS * narrower))
        return round(latitude * 1e7), round(longitude * 1e7), HOME[2] - down

    def _heading(self) -> float:
        """Heading in deg, 0..360."""
        return math.degrees(self.instruments.attitude()[2]) % 360.0

    def global_position_int(self) -> list[bytes]:
        """GLOBAL_POSITION_INT."""
        latitude, longitude, height = self._place()
        vx, vy, vz = self.instruments.velocity()
        return [
            self.writer.frame(
                mavlink.MAVLink_global_position_int_message,
                self.now_ms,
                latitude,
                longitude,
                round(height * 1e3),
                round((height - HOME[2]) * 1e3),
                round(vx * 100.0),
                round(vy * 100.0),
                round(vz * 100.0),
                round(self._heading() * 100.0) % 36000,
            )
        ]

    def gps_raw_int(self) -> list[bytes]:
        """GPS_RAW_INT."""
        latitude, longitude, height = self._place()
        vx, vy, _ = self.instruments.velocity()
        course = math.degrees(math.atan2(vy, vx)) % 360.0
        return [
            self.writer.frame(
                mavlink.MAVLink_gps_raw_int_message,
                self.now_us,
                latitude,
                longitude,
                round(height * 1e3),
                70,
                110,
                round(math.hypot(vx, vy) * 100.0),
                round(course * 100.0) % 36000,
                mavlink.GPS_FIX_TYPE_3D_FIX,
                14,
                round(height * 1e3),
                700,
                1100,
                200,
                0,
                0,
            )
        ]

    def vfr_hud(self) -> list[bytes]:
        """VFR_HUD."""
        vx, vy, vz = self.instruments.velocity()
        speed = math.hypot(vx, vy)
        commands = self.instruments.commands()
        return [
            self.writer.frame(
                mavlink.MAVLink_vfr_hud_message,
                speed,
                speed,
                HOME[2] - self._sim.state.body[2],
                -vz,
                round(self._heading()) % 360,
                round(100.0 * sum(commands) / len(commands)),
            )
        ]

    def home_position(self) -> list[bytes]:
        """HOME_POSITION."""
        return [
            self.writer.frame(
                mavlink.MAVLink_home_position_message,
                round(HOME[0] * 1e7),
                round(HOME[1] * 1e7),
                round(HOME[2] * 1e3),
                0.0,
                0.0,
                0.0,
                1.0,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
                self.now_us,
            )
        ]

    def autopilot_version(self) -> list[bytes]:
        """AUTOPILOT_VERSION: PX4 1.17 with MAVLink 2."""
        can = (
            mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
            | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
            | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
            | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        )
        version = (1 << 24) | (17 << 16) | (0 << 8) | 64
        return [
            self.writer.frame(
                mavlink.MAVLink_autopilot_version_message,
                can,
                1,
                version,
                version,
                0,
                0,
                0,
                0,
                *[0] * (8 + 8 + 8 + 18),
            )
        ]

    def protocol_version(self) -> list[bytes]:
        """PROTOCOL_VERSION: MAVLink 2 (and 1 understood)."""
        return [
            self.writer.frame(
                mavlink.MAVLink_protocol_version_message, 200, 100, 200, *[0] * (8 + 8)
            )
        ]
