"""What makers of messages share, and the flight messages that autopilots send alike.

Fields are passed in wire order, which is not the order of the definitions: see
`ordered_fieldnames` of the dialect's classes.
"""

import numpy as np

from gcs_sysid.model.attitude import from_euler
from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.instruments import Instruments
from sim_bridge.wire import FrameWriter

HOME = (47.397742, 8.545594, 488.0)
"""Latitude, longitude (deg) and height (m) of the take-off point: PX4's own simulated home."""

MAGNETIC_FIELD = (0.215, 0.010, 0.430)
"""Gauss, NED: about that of central Europe."""


_UNUSED = [0] * 16


class MessageMaker:
    """Makes messages for the instant the simulation is at, each as one or more frames.

    Attributes:
        instruments: what is measured.
        writer: makes the frames.
    """

    def __init__(self, instruments: Instruments, writer: FrameWriter) -> None:
        self.instruments = instruments
        self.writer = writer
        self._sim = instruments.simulation
        self._rotors = len(self._sim.vehicle.rotors)

    def _pressure(self) -> float:
        """Of the standard atmosphere near the ground, as the barometer reads it, hPa."""
        height, vehicle = HOME[2] - self._sim.state.body[2], self._sim.vehicle
        thrust = float(np.mean(np.square(self._sim.state.speeds)) * vehicle.k_T / vehicle.T_max)
        pressure = float(1013.25 * (1.0 - 2.25577e-5 * height) ** 5.25588)
        return pressure + 0.01 * self.instruments.faults.pressure(thrust)


class FlightMessages(MessageMaker):
    """Attitude, position and whether the vehicle flies.

    Attributes:
        vtol_state: MAV_VTOL_STATE by which the autopilot says that it is none.
    """

    vtol_state: int = mavlink.MAV_VTOL_STATE_UNDEFINED

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
                *self.instruments.faults.quaternion(from_euler(*self.instruments.attitude())),
                *self.instruments.rates(),
                0.0,
                0.0,
                0.0,
                0.0,
            )
        ]

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
        """EXTENDED_SYS_STATE: in the air or on the ground."""
        grounded = self._sim.grounded
        return [
            self.writer.frame(
                mavlink.MAVLink_extended_sys_state_message,
                self.vtol_state,
                mavlink.MAV_LANDED_STATE_ON_GROUND if grounded else mavlink.MAV_LANDED_STATE_IN_AIR,
            )
        ]

    def _servo_output_raw(self, outputs: list[int]) -> bytes:
        """SERVO_OUTPUT_RAW of outputs in us; its clock wraps after 71.6 minutes."""
        outputs = outputs[:16] + _UNUSED[len(outputs) :]
        return self.writer.frame(
            mavlink.MAVLink_servo_output_raw_message,
            self.instruments.now_us & 0xFFFFFFFF,
            *outputs[:8],
            0,
            *outputs[8:],
        )
