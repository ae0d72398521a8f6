"""Frames of one vehicle -> records.

What comes out depends on the frames and their order alone, never on when they came: a live
session and the analysis of its recording make the same records.

To take up another message, write its reader and add it to the table in `RecordDecoder`.
"""

import math
from collections import Counter
from collections.abc import Callable

from gcs_sysid.model.attitude import from_euler
from gcs_sysid.records import Record, Stream
from gcs_sysid.telemetry.clock import VehicleClock
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import Frame
from gcs_sysid.telemetry.messages import MESSAGE_IDS, message_name, picker

RPM = 2.0 * math.pi / 60.0
"""rad/s per revolution a minute."""
ATTITUDE_PREFERRED_FOR = 1.0
"""s. ATTITUDE_QUATERNION is used only when no ATTITUDE came for this long."""

Reader = Callable[[bytes], Record | None]

_highres_imu = picker(
    "HIGHRES_IMU", "time_usec", "id", "xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc"
)
_attitude = picker("ATTITUDE", "time_boot_ms", "roll", "pitch", "yaw")
_quaternion = picker("ATTITUDE_QUATERNION", "time_boot_ms", "q1", "q2", "q3", "q4")
_esc_status = picker("ESC_STATUS", "time_usec", "index", "rpm")
_outputs = picker("ACTUATOR_OUTPUT_STATUS", "time_usec", "active", "actuator")
_servos = picker("SERVO_OUTPUT_RAW", "time_usec", "port", *(f"servo{i}_raw" for i in range(1, 17)))
_position = picker("LOCAL_POSITION_NED", "time_boot_ms", "vx", "vy", "vz", "x", "y", "z")
_landed = picker("EXTENDED_SYS_STATE", "landed_state")
_heartbeat = picker("HEARTBEAT", "base_mode")
_system_time = picker("SYSTEM_TIME", "time_unix_usec", "time_boot_ms")


class RecordDecoder:
    """Makes records from the frames of one vehicle.

    Attributes:
        clock: the vehicle's clock as its stamps tell it.
        dropped: reason -> number of messages that gave no record though they should have:
            "not finite", "no time" (no stamp, or one not to be believed).
    """

    def __init__(self) -> None:
        self.clock = VehicleClock()
        self.dropped: Counter[str] = Counter()
        self._imu_id: int | None = None
        self._attitude_last: float | None = None
        self._q_last = (1.0, 0.0, 0.0, 0.0)
        table: dict[str, Reader] = {
            "HIGHRES_IMU": self._read_imu,
            "ATTITUDE": self._read_attitude,
            "ATTITUDE_QUATERNION": self._read_quaternion,
            "ESC_STATUS": self._read_esc_status,
            "ACTUATOR_OUTPUT_STATUS": self._read_outputs,
            "SERVO_OUTPUT_RAW": self._read_servos,
            "LOCAL_POSITION_NED": self._read_position,
            "EXTENDED_SYS_STATE": self._read_landed,
            "HEARTBEAT": self._read_heartbeat,
            "SYSTEM_TIME": self._read_system_time,
        }
        self._readers = {MESSAGE_IDS[name]: reader for name, reader in table.items()}

    def decode(self, frame: Frame) -> Record | None:
        """Take one frame whose checksum is right; None when it makes no record."""
        reader = self._readers.get(frame.message_id)
        if reader is None:
            return None
        reboots = self.clock.reboots
        record = reader(frame.payload)
        if self.clock.reboots != reboots:
            self._attitude_last = None
        return record

    def _record(
        self,
        stream: Stream,
        t: float | None,
        values: tuple[float, ...],
        offset: int = 0,
        source: str = "",
    ) -> Record | None:
        if t is None:
            self.dropped["no time"] += 1
            return None
        # One infinite or NaN value makes the sum so; large finite ones cannot overflow it.
        if not math.isfinite(math.fsum(values) if len(values) > 32 else sum(values)):
            self.dropped["not finite"] += 1
            return None
        return Record(stream, t, values, offset, source)

    def _read_imu(self, payload: bytes) -> Record | None:
        time_usec, imu_id, *values = _highres_imu(payload)
        if self._imu_id is None:
            self._imu_id = imu_id
        if imu_id != self._imu_id:  # a second sensor is another stream, not more samples
            return None
        return self._record(Stream.IMU, self.clock.stamp_us64(time_usec), tuple(values))

    def _read_attitude(self, payload: bytes) -> Record | None:
        time_boot_ms, roll, pitch, yaw = _attitude(payload)
        t = self.clock.stamp_ms32(time_boot_ms)
        if not math.isfinite(roll + pitch + yaw):
            self.dropped["not finite"] += 1
            return None
        if t is not None:
            self._attitude_last = t
        return self._quaternion_record(t, from_euler(roll, pitch, yaw))

    def _read_quaternion(self, payload: bytes) -> Record | None:
        time_boot_ms, w, x, y, z = _quaternion(payload)
        t = self.clock.stamp_ms32(time_boot_ms)
        last = self._attitude_last
        if t is not None and last is not None and abs(t - last) <= ATTITUDE_PREFERRED_FOR:
            return None
        return self._quaternion_record(t, (w, x, y, z))

    def _quaternion_record(
        self, t: float | None, q: tuple[float, float, float, float]
    ) -> Record | None:
        """Unit length, and the sign that continues the last one (q and -q are one attitude)."""
        w, x, y, z = q
        norm = math.sqrt(w * w + x * x + y * y + z * z) if math.isfinite(w + x + y + z) else 0.0
        if not 0.9 < norm < 1.1:
            self.dropped["not finite"] += 1
            return None
        a, b, c, d = self._q_last
        if a * w + b * x + c * y + d * z < 0.0:
            norm = -norm
        q = (w / norm, x / norm, y / norm, z / norm)
        if t is not None:
            self._q_last = q
        return self._record(Stream.ATTITUDE, t, q)

    def _read_esc_status(self, payload: bytes) -> Record | None:
        time_usec, index, *rpm = _esc_status(payload)
        # The sign only tells the sense of rotation, which the airframe gives.
        speeds = tuple(abs(value) * RPM for value in rpm)
        t = self.clock.stamp_us64(time_usec)
        return self._record(Stream.ROTOR_SPEED, t, speeds, index, "ESC_STATUS")

    def _read_outputs(self, payload: bytes) -> Record | None:
        time_usec, active, *outputs = _outputs(payload)
        t = self.clock.stamp_us64(time_usec)
        # By the definition a mask, from PX4 a count; either way outputs beyond it are unused.
        count = active if active <= len(outputs) else min(active.bit_length(), len(outputs))
        used = outputs[: count or None]
        while len(used) > 4 and not math.isfinite(used[-1]):
            used.pop()
        return self._record(Stream.ROTOR_COMMAND, t, tuple(used), 0, "ACTUATOR_OUTPUT_STATUS")

    def _read_servos(self, payload: bytes) -> Record | None:
        time_usec, port, *servos = _servos(payload)
        if port != 0:
            return None
        t = self.clock.stamp_us32(time_usec)
        while len(servos) > 4 and servos[-1] == 0:  # 0 is: not there
            servos.pop()
        values = tuple(float(servo) for servo in servos)
        return self._record(Stream.ROTOR_COMMAND, t, values, 0, "SERVO_OUTPUT_RAW")

    def _read_position(self, payload: bytes) -> Record | None:
        time_boot_ms, *values = _position(payload)
        return self._record(Stream.VELOCITY, self.clock.stamp_ms32(time_boot_ms), tuple(values))

    def _read_landed(self, payload: bytes) -> Record | None:
        (state,) = _landed(payload)
        if state == mavlink.MAV_LANDED_STATE_UNDEFINED:
            return None
        # Taking off and landing count as not flying: near the ground the model does not hold.
        in_air = float(state == mavlink.MAV_LANDED_STATE_IN_AIR)
        return self._record(Stream.IN_AIR, self.clock.now, (in_air,))

    def _read_heartbeat(self, payload: bytes) -> Record | None:
        (base_mode,) = _heartbeat(payload)
        if self.clock.now is None:  # usual at the start: no reason to count it
            return None
        armed = float(bool(base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED))
        return self._record(Stream.ARMED, self.clock.now, (armed,))

    def _read_system_time(self, payload: bytes) -> Record | None:
        self.clock.system_time(*_system_time(payload))
        return None


USED_MESSAGES = tuple(sorted(message_name(i) for i in RecordDecoder()._readers))
"""Names of the messages that records are made from."""
