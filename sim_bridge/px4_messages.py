"""The messages of an emulated PX4 that identification lives on, made from its instruments.

Fields are passed in wire order, which is not the order of the definitions: see
`ordered_fieldnames` of the dialect's classes.
"""

import math

from gcs_sysid.model.attitude import from_euler
from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.dynamics import rotate_to_body
from sim_bridge.instruments import Instruments
from sim_bridge.px4_status import HOME, voltage
from sim_bridge.wire import FrameWriter

MAGNETIC_FIELD = (0.215, 0.010, 0.430)
"""Gauss, NED: about that of central Europe."""

IMU_FIELDS = 63
"""HIGHRES_IMU fields_updated: accelerometer and gyro."""

_RPM = 30.0 / math.pi


class FlightMessages:
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
                self.instruments.now_us,
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
                self.instruments.now_ms,
                *self.instruments.attitude(),
                *self.instruments.rates(),
            )
        ]

    def attitude_quaternion(self) -> list[bytes]:
        """ATTITUDE_QUATERNION."""
        return [
            self.writer.frame(
                mavlink.MAVLink_attitude_quaternion_message,
                self.instruments.now_ms,
                *from_euler(*self.instruments.attitude()),
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
        volts = voltage(self._sim.time)
        frames = []
        for first in range(0, self._rotors, 4):
            group = speeds[first : first + 4]
            gap = [0] * (4 - len(group))
            # Electrical power is shaft power over an efficiency of 0.8.
            amps = [k_M * s * s * s / (0.8 * volts) for s in group]
            frames.append(
                self.writer.frame(
                    mavlink.MAVLink_esc_status_message,
                    self.instruments.now_us,
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

    def actuator_output_status(self) -> list[bytes]:
        """ACTUATOR_OUTPUT_STATUS: the commands on the range of the outputs."""
        outputs = self._outputs()
        return [
            self.writer.frame(
                mavlink.MAVLink_actuator_output_status_message,
                self.instruments.now_us,
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
                self.instruments.now_us & 0xFFFFFFFF,
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
                self.instruments.now_ms,
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
                    self.instruments.now_us,
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
