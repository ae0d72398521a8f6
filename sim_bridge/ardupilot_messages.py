"""The messages of an emulated ArduCopter that identification lives on.

Fields are passed in wire order: see `ordered_fieldnames` of the dialect's classes.
"""

import math

from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.ardupilot_parameters import PWM_MAX, PWM_MIN, spin_range
from sim_bridge.dynamics import rotate_to_body
from sim_bridge.message_writers import MAGNETIC_FIELD, FlightMessages

POSITION_FROM_US = 40_000_000
"""us since the autopilot was switched on: before that its EKF knows no position."""

MAG_ERROR = 1e6
"""By this factor HIGHRES_IMU's magnetic field is too large."""

_FIELDS = 8191
"""HIGHRES_IMU fields_updated: all of them."""

_ESC_GROUPS = (
    mavlink.MAVLink_esc_telemetry_1_to_4_message,
    mavlink.MAVLink_esc_telemetry_5_to_8_message,
    mavlink.MAVLink_esc_telemetry_9_to_12_message,
    mavlink.MAVLink_esc_telemetry_13_to_16_message,
    mavlink.MAVLink_esc_telemetry_17_to_20_message,
    mavlink.MAVLink_esc_telemetry_21_to_24_message,
    mavlink.MAVLink_esc_telemetry_25_to_28_message,
    mavlink.MAVLink_esc_telemetry_29_to_32_message,
)


class ArduPilotMessages(FlightMessages):
    """Makes each message for the instant the simulation is at, as one or more frames."""

    vtol_state: int = mavlink.MAV_VTOL_STATE_MC

    def highres_imu(self) -> list[bytes]:
        """HIGHRES_IMU: the filtered sensors, stamped with the time of sending."""
        (p, q, r), (x, y, z) = self.instruments.inertial()
        field = rotate_to_body(self._sim.state.quaternion, MAGNETIC_FIELD)
        return [
            self.writer.frame(
                mavlink.MAVLink_highres_imu_message,
                self.instruments.now_us,
                *(x, y, z, p, q, r),
                *(MAG_ERROR * m for m in field),
                *(self._pressure(), 0.0, 0.0, 35.0, _FIELDS, 0),
            )
        ]

    def raw_imu(self) -> list[bytes]:
        """RAW_IMU: the same in thousandths."""
        return [
            self.writer.frame(
                mavlink.MAVLink_raw_imu_message, self.instruments.now_us, *self._rounded(), 0, 3500
            )
        ]

    def scaled_imu2(self) -> list[bytes]:
        """SCALED_IMU2: a second sensor, which here reads what the first does."""
        return [
            self.writer.frame(
                mavlink.MAVLink_scaled_imu2_message, self.instruments.now_ms, *self._rounded(), 3500
            )
        ]

    def _rounded(self) -> list[int]:
        """Acceleration in mG, rates in mrad/s, magnetic field in mGauss."""
        gyro, accelerometer = self.instruments.inertial()
        field = rotate_to_body(self._sim.state.quaternion, MAGNETIC_FIELD)
        values = [1e3 / GRAVITY * a for a in accelerometer]
        values += [1e3 * w for w in gyro]
        values += [1e3 * m for m in field]
        # Whole numbers have no NaN: a driver that has nothing sends zeros.
        return [max(-32768, min(32767, round(v))) if math.isfinite(v) else 0 for v in values]

    def scaled_pressure(self) -> list[bytes]:
        """SCALED_PRESSURE."""
        return [
            self.writer.frame(
                mavlink.MAVLink_scaled_pressure_message,
                *(self.instruments.now_ms, self._pressure(), 0.0, 3500, 0),
            )
        ]

    def esc_telemetry(self) -> list[bytes]:
        """ESC_TELEMETRY_1_TO_4 and so on: no time of their own, rpm without sign."""
        speeds = self.instruments.rotor_speeds()
        rpm = [min(abs(n), 0xFFFF) for n in self.instruments.faults.rpm(speeds)]
        volts = self._sim.voltage
        k_M = self._sim.vehicle.k_M
        frames = []
        for first in range(0, self._rotors, 4):
            here = range(first, min(first + 4, self._rotors))
            gap = [0] * (4 - len(here))
            amps = [k_M * speeds[i] ** 3 / (0.8 * volts) for i in here]
            used = [1e3 / 3600.0 * self._sim.time * a for a in amps]
            frames.append(
                self.writer.frame(
                    _ESC_GROUPS[first // 4],
                    *([round(100.0 * volts)] * len(here) + gap),
                    *([min(0xFFFF, round(100.0 * a)) for a in amps] + gap),
                    *([min(0xFFFF, round(mah)) for mah in used] + gap),
                    *(rpm[here.start : here.stop] + gap),
                    *([self._sim.tick & 0xFFFF] * len(here) + gap),
                    *([45] * len(here) + gap),
                )
            )
        return frames

    def servo_output_raw(self) -> list[bytes]:
        """SERVO_OUTPUT_RAW: MOT_PWM_MIN when stopped, thrust from MOT_SPIN_MIN on."""
        if self._sim.armed:
            low, high = spin_range(self._sim.vehicle)
            span = PWM_MAX - PWM_MIN
            outputs = [
                round(PWM_MIN + span * (low + u * (high - low)))
                for u in self.instruments.commands()
            ]
        else:
            outputs = [PWM_MIN] * self._rotors
        return [self._servo_output_raw(outputs)]

    def rc_channels(self) -> list[bytes]:
        """RC_CHANNELS: sticks in the middle."""
        return [
            self.writer.frame(
                mavlink.MAVLink_rc_channels_message,
                *(self.instruments.now_ms, *[1500] * 8, *[0] * 10, 8, 254),
            )
        ]

    def vibration(self) -> list[bytes]:
        """VIBRATION."""
        return [
            self.writer.frame(
                mavlink.MAVLink_vibration_message,
                *(self.instruments.now_us, 3.0, 3.0, 5.0, 0, 0, 0),
            )
        ]

    def mission_current(self) -> list[bytes]:
        """MISSION_CURRENT."""
        return [self.writer.frame(mavlink.MAVLink_mission_current_message, 0, 0, 0, 0)]

    def local_position_ned(self) -> list[bytes]:
        """LOCAL_POSITION_NED, once there is a position."""
        if self.instruments.now_us < POSITION_FROM_US:
            return []
        return super().local_position_ned()

    def text(self, words: str) -> bytes:
        """STATUSTEXT for the pilot's information."""
        return self.writer.frame(
            mavlink.MAVLink_statustext_message,
            *(mavlink.MAV_SEVERITY_INFO, words.encode()[:50], 0, 0),
        )
