"""Frames of one vehicle -> records, one by one and each message by code of its own.

Slow and plain, written before the table of messages: what that table gives is held against it.
"""

import math
from collections import Counter
from collections.abc import Callable
from functools import partial

import numpy as np

from gcs_sysid.model.attitude import from_euler
from gcs_sysid.signals.columns import IntakeEvent
from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.telemetry.clock import ClockDrift, VehicleClock
from gcs_sysid.telemetry.decode import read_parameter
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import Frame, Validity
from gcs_sysid.telemetry.marks import is_reset_mark
from gcs_sysid.telemetry.message_table import MOST_ROTORS, RPM
from gcs_sysid.telemetry.messages import MESSAGE_IDS, picker
from gcs_sysid.telemetry.outgoing import OWN_SYSTEM
from gcs_sysid.telemetry.vehicles import Contradictions, VehicleSelector

MILLI_G = 9.80665e-3
"""m/s^2 per thousandth of standard gravity."""
PREFERRED_FOR = 1.0
"""s. The next best message is used only when no better one came for this long."""
LANDED_STATE_FOR = 5.0
"""s. The same for EXTENDED_SYS_STATE, which comes once or twice a second."""
MOST_PARAMETERS = 4096
"""Names kept: a hostile sender can make up more than any autopilot has."""

Reader = Callable[[bytes], Record | None]

_highres_imu = picker(
    "HIGHRES_IMU", "time_usec", "id", "xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc"
)
_scaled_imu = picker(
    "SCALED_IMU", "time_boot_ms", "xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc"
)
_raw_imu = picker("RAW_IMU", "time_usec", "id", "xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc")
_attitude = picker("ATTITUDE", "time_boot_ms", "roll", "pitch", "yaw")
_quaternion = picker("ATTITUDE_QUATERNION", "time_boot_ms", "q1", "q2", "q3", "q4")
_position = picker("LOCAL_POSITION_NED", "time_boot_ms", "vx", "vy", "vz", "x", "y", "z")
_global_position = picker("GLOBAL_POSITION_INT", "time_boot_ms", "relative_alt", "vx", "vy", "vz")
_target = picker("ATTITUDE_TARGET", "body_roll_rate", "body_pitch_rate", "body_yaw_rate")
_sys_status = picker("SYS_STATUS", "load", "voltage_battery")
_battery_status = picker("BATTERY_STATUS", "id", "voltages")
_landed = picker("EXTENDED_SYS_STATE", "landed_state")
_heartbeat = picker("HEARTBEAT", "autopilot", "base_mode", "system_status")
_type_and_mode = picker("HEARTBEAT", "type", "autopilot", "base_mode")
_system_time = picker("SYSTEM_TIME", "time_unix_usec", "time_boot_ms")


class Preference:
    """Lets a message through only while none that ranks better comes."""

    def __init__(self, lasts: float = PREFERRED_FOR) -> None:
        self._lasts = lasts
        self._heard: list[float | None] = [None] * 4

    def allows(self, rank: int, t: float | None) -> bool:
        """Note a message of a rank (0 is the best) at a time; whether to use it."""
        if t is None:
            return True
        self._heard[rank] = t
        return not any(
            heard is not None and abs(t - heard) <= self._lasts for heard in self._heard[:rank]
        )


ESC_TELEMETRY = {
    f"ESC_TELEMETRY_{first}_TO_{first + 3}": first - 1 for first in (1, 5, 9, 13, 17, 21, 25, 29)
}
"""Message name -> index of its first rotor."""

_esc_status = picker("ESC_STATUS", "time_usec", "index", "rpm")
_rpm = picker("RPM", "rpm1", "rpm2")
_outputs = picker("ACTUATOR_OUTPUT_STATUS", "time_usec", "active", "actuator")
_SERVOS = [f"servo{i}_raw" for i in range(1, 17)]
_servos = picker("SERVO_OUTPUT_RAW", "time_usec", "port", *_SERVOS)


def esc_status(payload: bytes) -> tuple[int, int, tuple[float, ...]]:
    """Time in us, index of the first rotor, speeds of ESC_STATUS."""
    time_usec, index, *rpm = _esc_status(payload)
    # The sign only tells the sense of rotation, which the airframe gives.
    return time_usec, index, tuple(abs(value) * RPM for value in rpm)


def esc_telemetry(name: str) -> Callable[[bytes], tuple[float, ...]]:
    """Make the function from a payload of one ESC_TELEMETRY message to speeds."""
    pick = picker(name, "rpm")
    return lambda payload: tuple(value * RPM for value in pick(payload))


def rpm_sensors(payload: bytes) -> tuple[float, ...]:
    """Speeds of RPM's sensors; those that are not there (-1) are left out."""
    rpm1, rpm2 = _rpm(payload)
    if rpm1 < 0.0:
        return ()
    return tuple(value * RPM for value in ((rpm1, rpm2) if rpm2 >= 0.0 else (rpm1,)))


def actuator_outputs(payload: bytes) -> tuple[int, tuple[float, ...]]:
    """Time in us and commands of ACTUATOR_OUTPUT_STATUS."""
    time_usec, active, *outputs = _outputs(payload)
    # By the definition a mask, from PX4 a count; either way outputs beyond it are unused.
    count = active if active <= len(outputs) else min(active.bit_length(), len(outputs))
    used = outputs[: count or None]
    while len(used) > 4 and not math.isfinite(used[-1]):
        used.pop()
    return time_usec, tuple(used)


def servo_outputs(payload: bytes) -> tuple[int, int, tuple[float, ...]]:
    """Time in us, port and commands of SERVO_OUTPUT_RAW."""
    time_usec, port, *servos = _servos(payload)
    while len(servos) > 4 and servos[-1] == 0:  # 0 is: not there
        servos.pop()
    return time_usec, port, tuple(float(servo) for servo in servos)


class ScalarDecoder:
    """Makes records from the frames of one vehicle.

    Attributes:
        clock: the vehicle's clock as its stamps tell it.
        dropped: reason -> number of messages that gave no record though they should have:
            "not finite", "no time" (no stamp, or one not to be believed).
        parameters: name -> value of the autopilot's parameters heard so far.
    """

    def __init__(self) -> None:
        self.clock = VehicleClock()
        self.dropped: Counter[str] = Counter()
        self.parameters: dict[str, float] = {}
        self._imu_id: int | None = None
        self._autopilot: int | None = None
        self._armed: bool | None = None
        self._q_last = (1.0, 0.0, 0.0, 0.0)
        self._forget_times()
        table: dict[str, Reader] = {
            "HIGHRES_IMU": self._read_imu,
            "SCALED_IMU": self._read_scaled_imu,
            "RAW_IMU": self._read_raw_imu,
            "ATTITUDE": self._read_attitude,
            "ATTITUDE_QUATERNION": self._read_quaternion,
            "ATTITUDE_TARGET": self._read_target,
            "ESC_STATUS": self._read_esc_status,
            "RPM": partial(self._read_unstamped, rpm_sensors, 0, "RPM"),
            "ACTUATOR_OUTPUT_STATUS": self._read_outputs,
            "SERVO_OUTPUT_RAW": self._read_servos,
            "LOCAL_POSITION_NED": self._read_position,
            "GLOBAL_POSITION_INT": self._read_global_position,
            "SYS_STATUS": partial(self._read_volts, 0),
            "BATTERY_STATUS": partial(self._read_volts, 1),
            "EXTENDED_SYS_STATE": self._read_landed,
            "HEARTBEAT": self._read_heartbeat,
            "PARAM_VALUE": self._read_parameter,
            "SYSTEM_TIME": self._read_system_time,
        }
        for name, first in ESC_TELEMETRY.items():
            table[name] = partial(self._read_unstamped, esc_telemetry(name), first, name)
        self._readers = {MESSAGE_IDS[name]: reader for name, reader in table.items()}

    @property
    def dropped_messages(self) -> int:
        """How many messages gave no record though they should have."""
        return self.dropped["no time"] + self.dropped["not finite"]

    def reads(self, message_id: int) -> bool:
        """Whether there is anything to read in messages of a type."""
        # What a live session asks for is read by its restoration, and makes no record.
        return message_id in self._readers or message_id == MESSAGE_IDS["MESSAGE_INTERVAL"]

    def decode(self, frame: Frame) -> Record | None:
        """Take one frame whose checksum is right; None when it makes no record."""
        reader = self._readers.get(frame.message_id)
        if reader is None:
            return None
        reboots = self.clock.reboots
        record = reader(frame.payload)
        if self.clock.reboots != reboots:
            self._forget_times()
        return record

    def _forget_times(self) -> None:
        """What was found at times of another boot says nothing of the present."""
        self._imu = Preference()
        self._attitude = Preference()
        self._velocity = Preference()
        self._volts = Preference()
        self._flight = Preference(LANDED_STATE_FOR)
        self._outputs_last = -math.inf

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
        if stream is Stream.IMU and not math.isfinite(sum(values[3:])):
            # Nearly everything rests on the gyro: one without an accelerometer is of use.
            self.dropped["accelerometer not finite"] += 1
            values = (*values[:3], math.nan, math.nan, math.nan)
        needed = values[:3] if stream is Stream.IMU else values
        if not math.isfinite(math.fsum(needed) if len(needed) > 32 else sum(needed)):
            self.dropped["not finite"] += 1
            return None
        return Record(stream, t, values, offset, source)

    def _read_imu(self, payload: bytes) -> Record | None:
        time_usec, imu_id, *values = _highres_imu(payload)
        if self._imu_id is None:
            self._imu_id = imu_id
        if imu_id != self._imu_id:  # a second sensor is another stream, not more samples
            return None
        t = self.clock.stamp_us64(time_usec)
        self._imu.allows(0, t)
        return self._record(Stream.IMU, t, tuple(values))

    def _read_scaled_imu(self, payload: bytes) -> Record | None:
        time_boot_ms, *values = _scaled_imu(payload)
        return self._milli_imu(2, self.clock.stamp_ms32(time_boot_ms), values)

    def _read_raw_imu(self, payload: bytes) -> Record | None:
        time_usec, imu_id, *values = _raw_imu(payload)
        # By the definition in the sensor's own counts; ArduPilot sends what SCALED_IMU has, with
        # stamps a thousand times finer.
        if self._autopilot != mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA or imu_id != 0:
            return None
        t = self.clock.stamp_us64_or_32(time_usec)
        return self._milli_imu(1, t, values)

    def _milli_imu(self, rank: int, t: float | None, values: list[int]) -> Record | None:
        """From mrad/s and thousandths of g."""
        if not self._imu.allows(rank, t):
            return None
        gyro = (1e-3 * value for value in values[:3])
        return self._record(Stream.IMU, t, (*gyro, *(MILLI_G * value for value in values[3:])))

    def _read_attitude(self, payload: bytes) -> Record | None:
        time_boot_ms, roll, pitch, yaw = _attitude(payload)
        t = self.clock.stamp_ms32(time_boot_ms)
        if not math.isfinite(roll + pitch + yaw):
            self.dropped["not finite"] += 1
            return None
        self._attitude.allows(0, t)
        return self._quaternion_record(t, from_euler(roll, pitch, yaw))

    def _read_quaternion(self, payload: bytes) -> Record | None:
        time_boot_ms, w, x, y, z = _quaternion(payload)
        t = self.clock.stamp_ms32(time_boot_ms)
        if not self._attitude.allows(1, t):
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
        time_usec, first, speeds = esc_status(payload)
        if first >= MOST_ROTORS:
            return None
        t = self.clock.stamp_us64(time_usec)
        return self._record(Stream.ROTOR_SPEED, t, speeds, first, "ESC_STATUS")

    def _read_unstamped(
        self, read: Callable[[bytes], tuple[float, ...]], first: int, name: str, payload: bytes
    ) -> Record | None:
        speeds = read(payload)
        if not speeds:
            return None
        return self._record(Stream.ROTOR_SPEED, self._time_of_sending, speeds, first, name)

    def _read_target(self, payload: bytes) -> Record | None:
        return self._record(Stream.RATE_SETPOINT, self._time_of_sending, _target(payload))

    @property
    def _time_of_sending(self) -> float | None:
        """Time for a message without a stamp: that of its neighbor, s.

        ArduPilot sends all that is due in one step with the same time, SERVO_OUTPUT_RAW just
        before ESC_TELEMETRY and HIGHRES_IMU after it: the IMU's last stamp is a step old.
        """
        now = self.clock.now
        return None if now is None else max(now, self._outputs_last)

    def _read_outputs(self, payload: bytes) -> Record | None:
        time_usec, values = actuator_outputs(payload)
        t = self.clock.stamp_us64(time_usec)
        return self._record(Stream.ROTOR_COMMAND, t, values, 0, "ACTUATOR_OUTPUT_STATUS")

    def _read_servos(self, payload: bytes) -> Record | None:
        time_usec, port, values = servo_outputs(payload)
        if port != 0:
            return None
        t = self.clock.stamp_us32(time_usec)
        if t is not None:
            self._outputs_last = t
        return self._record(Stream.ROTOR_COMMAND, t, values, 0, "SERVO_OUTPUT_RAW")

    def _read_position(self, payload: bytes) -> Record | None:
        time_boot_ms, *values = _position(payload)
        t = self.clock.stamp_ms32(time_boot_ms)
        self._velocity.allows(0, t)
        return self._record(Stream.VELOCITY, t, tuple(values))

    def _read_global_position(self, payload: bytes) -> Record | None:
        time_boot_ms, height_mm, *velocity_cm = _global_position(payload)
        t = self.clock.stamp_ms32(time_boot_ms)
        if not self._velocity.allows(1, t):
            return None
        velocity = (0.01 * value for value in velocity_cm)
        # North and east would need an origin, and nobody uses them.
        return self._record(Stream.VELOCITY, t, (*velocity, 0.0, 0.0, -1e-3 * height_mm))

    def _read_volts(self, rank: int, payload: bytes) -> Record | None:
        battery, *cells = (_battery_status if rank else _sys_status)(payload)
        if rank and battery != 0:
            return None
        t = self._time_of_sending
        if not self._volts.allows(rank, t):
            return None
        volts = sum(cell for cell in cells if cell != 0xFFFF)
        return self._record(Stream.VOLTAGE, t, (volts * 1e-3,))

    def _read_landed(self, payload: bytes) -> Record | None:
        (state,) = _landed(payload)
        if state == mavlink.MAV_LANDED_STATE_UNDEFINED:
            return None
        # Taking off and landing count as not flying: near the ground the model does not hold.
        in_air = float(state != mavlink.MAV_LANDED_STATE_ON_GROUND)
        self._flight.allows(0, self.clock.now)
        return self._record(Stream.IN_AIR, self.clock.now, (in_air,))

    def _read_heartbeat(self, payload: bytes) -> Record | None:
        self._autopilot, base_mode, status = _heartbeat(payload)
        now = self.clock.now
        if now is None:  # usual at the start: no reason to count it
            return None
        armed = bool(base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        # ArduPilot's status tells flight too. One message makes one record, so the arming is
        # told when it changes and the flight in between.
        if (
            armed == self._armed
            and self._autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
            and status in (mavlink.MAV_STATE_STANDBY, mavlink.MAV_STATE_ACTIVE)
            and self._flight.allows(1, now)
        ):
            in_air = float(status == mavlink.MAV_STATE_ACTIVE)
            return self._record(Stream.IN_AIR, now, (in_air,))
        self._armed = armed
        return self._record(Stream.ARMED, now, (float(armed),))

    def _read_parameter(self, payload: bytes) -> Record | None:
        bytewise = self._autopilot == mavlink.MAV_AUTOPILOT_PX4
        name, value = read_parameter(payload, bytewise=bytewise)
        if not name or not math.isfinite(value):
            return None
        if len(self.parameters) >= MOST_PARAMETERS and name not in self.parameters:
            return None
        self.parameters[name] = value
        return Record(Stream.PARAMETER, self.clock.now or 0.0, (value,), source=name)

    def _read_system_time(self, payload: bytes) -> Record | None:
        self.clock.system_time(*_system_time(payload))
        return None


class ScalarIntake:
    """What `Intake` tells, frame by frame, but for counts and rates of messages."""

    def __init__(self, wanted: tuple[int, int | None] | None = None) -> None:
        self.selector = VehicleSelector(wanted)
        self.decoder = ScalarDecoder()
        self.drift = ClockDrift()
        self.turning: set[str] = set()
        self.fates: Counter[str] = Counter()
        self.events: list[IntakeEvent] = []
        self._contradictions = Contradictions()
        self._others: set[tuple[int, int]] = set()

    def frame(self, frame: Frame, wall: float | None = None) -> Record | None:
        """Take one frame; the record it makes, if any."""
        if frame.valid is not Validity.OK:
            return None
        if frame.system == OWN_SYSTEM and is_reset_mark(frame):
            self._note("reset", "estimate reset by the user")
            return None
        first = self.selector.chosen
        self.selector.note_senders(
            *(np.array([n], np.uint8) for n in (frame.system, frame.component))
        )
        if frame.message_id == 0:
            self.selector.notice(frame)
        known, is_chosen = first is not None, self.selector.is_chosen(frame)
        if first is not None and not is_chosen and self.decoder.clock.now is None:
            is_chosen = self.selector.go_over(frame)
            if is_chosen:
                self._begin_anew(first)
        if frame.message_id == 0:
            self._hear(frame)
        if not is_chosen:
            self.fates["others"] += 1
            return None
        record = self._decode(frame)
        if not known:
            self._note("vehicle", f"{self.selector.chosen} found")
        clock = self.decoder.clock
        if record is not None:
            if record.stream is Stream.ROTOR_SPEED:
                count = sum(value != 0.0 for value in record.values)
                if count >= min(4, len(record.values)):
                    self.turning.add(record.source)
            if wall is not None and clock.now is not None:
                self.drift.add_moment(clock.now, wall)
        return record

    def _decode(self, frame: Frame) -> Record | None:
        clock = self.decoder.clock
        before, reboots, dropped = clock.now, clock.reboots, self.decoder.dropped_messages
        record = self.decoder.decode(frame)
        if record is not None:
            self.fates["used"] += 1
        elif not self.decoder.reads(frame.message_id):
            self.fates["not needed"] += 1
        else:
            new = self.decoder.dropped_messages != dropped
            self.fates["dropped" if new else "passed over"] += 1
        if clock.reboots != reboots:
            self._note("reboot", f"the vehicle's clock went back from {before:.1f} s: reboot")
        return record

    def _begin_anew(self, first) -> None:
        self._others.add(first.address)
        self.decoder = ScalarDecoder()
        self._contradictions = Contradictions()
        self._note(
            "vehicles",
            f"{first}, the first received, sends nothing but heartbeats: "
            f"using {self.selector.chosen}, which sends IMU data",
        )

    def _hear(self, heartbeat: Frame) -> None:
        chosen, who = self.selector.chosen, (heartbeat.system, heartbeat.component)
        if chosen is None:
            return
        if who == chosen.address:
            vehicle_type, autopilot, mode = _type_and_mode(heartbeat.payload)
            armed = bool(mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            if self._contradictions.note_heartbeat(vehicle_type, autopilot, armed=armed):
                self._note("senders", "")
            return
        other = self.selector.systems.get(who)
        if other is None or not other.is_autopilot or self.selector.wanted is not None:
            return
        if who not in self._others:
            self._others.add(who)
            self._note("vehicles", str(other))

    def _note(self, kind: str, text: str) -> None:
        self.events.append(IntakeEvent(self.decoder.clock.now or 0.0, kind, text))
