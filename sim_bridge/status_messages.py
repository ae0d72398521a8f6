"""The housekeeping messages of an emulated autopilot: state, battery, place, versions.

Fields are passed in wire order: see `ordered_fieldnames` of the dialect's classes.
"""

import math
from dataclasses import dataclass

from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.autopilot import EPOCH_US
from sim_bridge.battery import CELLS
from sim_bridge.instruments import Instruments
from sim_bridge.message_writers import HOME, MessageMaker
from sim_bridge.wire import FrameWriter

EARTH_RADIUS = 6371000.0
"""m"""

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


def remaining(flown: float) -> int:
    """Charge of the battery after so many seconds, %."""
    return max(5, 95 - int(flown / 12.0))


@dataclass(frozen=True)
class Identity:
    """What an autopilot says that it is.

    Attributes:
        autopilot: MAV_AUTOPILOT.
        custom_mode: its number for the mode in which a companion computer flies.
        capabilities: MAV_PROTOCOL_CAPABILITY bits.
        version: major, minor, patch and FIRMWARE_VERSION_TYPE.
    """

    autopilot: int
    custom_mode: int
    capabilities: int
    version: tuple[int, int, int, int]


class StatusMessages(MessageMaker):
    """Makes each message for the instant the simulation is at, as one or more frames."""

    def __init__(self, instruments: Instruments, writer: FrameWriter, identity: Identity) -> None:
        super().__init__(instruments, writer)
        self._identity = identity

    def heartbeat(self) -> list[bytes]:
        """HEARTBEAT: flown by a companion computer; armed unless on the ground."""
        mode = (
            mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
            | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        )
        state = mavlink.MAV_STATE_STANDBY
        if self._sim.armed:
            mode |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
            state = mavlink.MAV_STATE_ACTIVE
        kind = _TYPES.get(self._rotors, mavlink.MAV_TYPE_GENERIC_MULTIROTOR)
        return [
            self.writer.frame(
                mavlink.MAVLink_heartbeat_message,
                self._identity.custom_mode,
                kind,
                self._identity.autopilot,
                mode,
                state,
                3,
            )
        ]

    @property
    def current(self) -> float:
        """Of the battery, A."""
        vehicle = self._sim.vehicle
        power = sum(vehicle.k_M * s * s * s for s in self._sim.state.speeds) / 0.8
        return float(power / self._sim.voltage)

    def sys_status(self) -> list[bytes]:
        """SYS_STATUS."""
        return [
            self.writer.frame(
                mavlink.MAVLink_sys_status_message,
                _SENSORS,
                _SENSORS,
                _SENSORS,
                350,
                round(self._sim.voltage * 1000.0),
                round(self.current * 100.0),
                0,
                0,
                0,
                0,
                0,
                0,
                remaining(self._sim.time),
                0,
                0,
                0,
            )
        ]

    def battery_status(self) -> list[bytes]:
        """BATTERY_STATUS."""
        cell = round(self._sim.voltage / CELLS * 1000.0)
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
                remaining(self._sim.time),
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
                mavlink.MAVLink_system_time_message,
                EPOCH_US + self.instruments.now_us,
                self.instruments.now_ms,
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
        return math.degrees(self.instruments.attitude(fresh=False)[2]) % 360.0

    def global_position_int(self) -> list[bytes]:
        """GLOBAL_POSITION_INT."""
        latitude, longitude, height = self._place()
        vx, vy, vz = self.instruments.velocity(fresh=False)
        return [
            self.writer.frame(
                mavlink.MAVLink_global_position_int_message,
                self.instruments.now_ms,
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
        vx, vy, _ = self.instruments.velocity(fresh=False)
        history = math.degrees(math.atan2(vy, vx)) % 360.0
        return [
            self.writer.frame(
                mavlink.MAVLink_gps_raw_int_message,
                self.instruments.now_us,
                latitude,
                longitude,
                round(height * 1e3),
                70,
                110,
                round(math.hypot(vx, vy) * 100.0),
                round(history * 100.0) % 36000,
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
        vx, vy, vz = self.instruments.velocity(fresh=False)
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
                self.instruments.now_us,
            )
        ]

    def autopilot_version(self) -> list[bytes]:
        """AUTOPILOT_VERSION."""
        major, minor, patch, kind = self._identity.version
        version = major << 24 | minor << 16 | patch << 8 | kind
        return [
            self.writer.frame(
                mavlink.MAVLink_autopilot_version_message,
                self._identity.capabilities,
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
