"""The messages of an emulated PX4 that identification lives on, made from its instruments.

Fields are passed in wire order, which is not the order of the definitions: see
`ordered_fieldnames` of the dialect's classes.
"""

from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.dynamics import rotate_to_body
from sim_bridge.message_writers import HOME, MAGNETIC_FIELD, FlightMessages

IMU_FIELDS = 63
"""HIGHRES_IMU fields_updated: accelerometer and gyro."""

_UNUSED = (0.0,) * 32

DISARMED = 900.0
"""us: PWM of an output that drives nothing."""


class Px4Messages(FlightMessages):
    """Makes each message for the instant the simulation is at, as one or more frames."""

    _driven: tuple[int, list[float]] = (-1, [])

    def highres_imu(self) -> list[bytes]:
        """HIGHRES_IMU."""
        gyro, accelerometer = self.instruments.inertial()
        body = self._sim.state.body
        return [
            self.writer.frame(
                mavlink.MAVLink_highres_imu_message,
                self.instruments.now_us,
                *accelerometer,
                *gyro,
                *rotate_to_body(body[6:10], MAGNETIC_FIELD),
                self._pressure(),
                0.0,
                HOME[2] - body[2],
                35.0,
                IMU_FIELDS,
                0,
            )
        ]

    def esc_status(self) -> list[bytes]:
        """ESC_STATUS, four rotors a message, in motor order."""
        speeds = self.instruments.rotor_speeds()
        rpm = self.instruments.faults.rpm(speeds)
        k_M = self._sim.vehicle.k_M
        volts = self._sim.voltage
        # Electrical power is shaft power over an efficiency of 0.8.
        power = 0.8 * volts
        frames = []
        for first in range(0, self._rotors, 4):
            group = speeds[first : first + 4]
            gap = [0] * (4 - len(group))
            amps = [k_M * s * s * s / power for s in group]
            frames.append(
                self.writer.frame(
                    mavlink.MAVLink_esc_status_message,
                    self.instruments.now_us,
                    *rpm[first : first + 4],
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
                *_UNUSED[len(outputs) :],
            )
        ]

    def servo_output_raw(self) -> list[bytes]:
        """SERVO_OUTPUT_RAW: the same, rounded."""
        return [self._servo_output_raw([round(x) for x in self._outputs()])]

    def _outputs(self) -> list[float]:
        """Of this instant, computed once for all messages that show them."""
        tick, outputs = self._driven
        if tick == self._sim.tick:
            return outputs
        if self._sim.armed:
            span = self._sim.vehicle.command
            low, width = span.min, span.max - span.min
            outputs = [low + u * width for u in self.instruments.commands()]
        else:
            outputs = [DISARMED] * self._rotors
        # A count of outputs, the unused ones among them, as PX4 in simulation sends it.
        outputs += [DISARMED] * (self.instruments.faults.sensor_faults.active_count - len(outputs))
        self._driven = self._sim.tick, outputs
        return outputs

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
