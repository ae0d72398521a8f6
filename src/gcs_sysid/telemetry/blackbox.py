"""Logs of Betaflight, INAV and Indiflight (.bbl, .bfl): each field as the stream of a link.

- gyroADC is what the flight controller flies by, filtered; Indiflight's gyroADCafterRpm and
  accUnfiltered are the same before their low-pass filters, and are taken where they are.
- Body axes are forward, left, up, and the world north, west, up. Indiflight's quaternion, its
  positions, velocities and setpoints are forward, right, down and north, east, down already.
- eRPM counts hundreds of electrical revolutions a minute, motor_poles / 2 to one of the rotor.
- What is held from one measurement to the next (position, velocity) is one sample when it changes.
"""

import struct
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.files import reading_log
from gcs_sysid.model.attitude import from_angles
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.motor_order import MIXER
from gcs_sysid.signals.records import Stream
from gcs_sysid.signals.rotor_units import MOTOR_POLES
from gcs_sysid.telemetry.blackbox_format import Header, read_header, session_starts
from gcs_sysid.telemetry.blackbox_frames import DISARM, BlackboxFrames, latest, read_frames
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.message_table import RPM
from gcs_sysid.telemetry.track_collector import Recording
from gcs_sysid.telemetry.vehicles import multirotor_type

_FRD = np.array([1.0, -1.0, -1.0])
"""Forward, left, up to forward, right, down; north, west, up to north, east, down."""
_QUATERNION_ONE, _INDIFLIGHT_ONE = 32767.0, 8127.0
_MOST_MOTORS = 12
_MOST_NUMBERS = 16
"""Of a line of the header."""
_SESSIONS_NAMED = 8
_DATETIME = b"H Log start datetime:"
_LEAST_BYTES = 1024
"""A session with fewer holds no flight."""
_SCALES, _RADIANS = (1e-12, 1e3), 1e-6
"""Scales of a gyro that can be, and below which they are in rad/us."""
_PID_TERMS = ("axisP", "axisI", "axisD", "axisF", "axisS")
_FEWEST_MIXED, _MIXED = 1000, 0.9
"""Frames, and share of what sets each motor apart that PID sums explain, from which they show the
mixer: a mixer alone gives .99 and more."""
_MODES, _ARM = "flightModeFlags", 1
"""Field of S frames, and its bit: the switch is at "armed"."""
_ARRAYS = {
    "gyroADC": 3, "gyroData": 3, "gyroADCafterRpm": 3, "accSmooth": 3, "accUnfiltered": 3,
    "motor": _MOST_MOTORS, "eRPM": _MOST_MOTORS, "omegaUnfiltered": _MOST_MOTORS, "quat": 4,
    "imuQuaternion": 3, "attitude": 3, "extPos": 3, "extVel": 3, "pos": 3, "vel": 3, "navPos": 3,
    "navVel": 3, "setpoint": 3, "axisRate": 3, "gyroSp": 3, "axisP": 3, "axisI": 3, "axisD": 3,
    "axisF": 3, "axisS": 3,
}  # fmt: skip
_WANTED = {f"{name}[{i}]" for name, count in _ARRAYS.items() for i in range(count)} | {
    "vbatLatest",
    "vbat",
}


class _Position(NamedTuple):
    """Fields with velocity and position, and their conversion to m/s, m and NED."""

    velocity: str
    position: str
    to_ned: tuple[float, float, float]
    unit: float
    """m of the position; the velocity is in cm/s."""


_POSITIONS = (
    _Position("extVel", "extPos", (1.0, 1.0, 1.0), 1e-3),  # Indiflight's motion capture
    _Position("vel", "pos", (1.0, 1.0, 1.0), 1e-3),  # and its estimate
    _Position("navVel", "navPos", (1.0, 1.0, -1.0), 1e-2),  # INAV
)


def read_blackbox(path: Path, session: int | None = None) -> Recording:
    """Read a session of a .bbl file.

    Sessions count from 1 on; None: the longest.

    Raises:
        InputError: it cannot be read, or the session holds no flight data.
    """
    with reading_log(path):
        data = path.read_bytes()
    starts = session_starts(data)
    sessions = len(starts) - 1
    longest = 1 + int(np.argmax([*np.diff(starts), 0]))
    number = longest if session is None else session
    if not 1 <= number <= sessions:
        raise InputError(f"{path} has no session {number}; {_listed(path, data, starts)}")
    try:
        header = read_header(data, starts[number - 1], starts[number])
        names = header.frames["I"].names
        wanted = [name for name in names if name in _WANTED]
        frames = read_frames(data, header, starts[number], [*wanted, _MODES])
        if not len(frames.time_us):
            raise InputError("it holds no flight data")
    except InputError as error:
        if sessions == 1:
            raise InputError(f"{path} cannot be read as a blackbox log: {error}") from error
        listed = _listed(path, data, starts)
        raise InputError(f"session {number} of {path}: {error}; {listed}") from error
    recording = _SessionReader(header, frames).read()
    if session is None and sessions > 1:
        recording.problems += (
            f"it holds {sessions} sessions: the longest, {path.name}#{number}, is read",
        )
    return recording


def _listed(path: Path, data: bytes, starts: list[int]) -> str:
    """The sessions of a file, in words."""
    words = []
    for number, (start, stop) in enumerate(pairwise(starts[: _SESSIONS_NAMED + 1]), 1):
        at = data.find(_DATETIME, start, min(stop, start + 2**16)) + len(_DATETIME)
        text = data[at : at + 16].decode("ascii", "replace").replace("T", " ")
        dated = f", {text}" if at >= len(_DATETIME) and not text.startswith("0000") else ""
        words.append(f"{path.name}#{number} ({(stop - start) / 1e3:,.0f} kB{dated})")
    more = len(starts) - 1 - len(words)
    return f"it holds {', '.join([*words, *([f'{more} more'] if more > 0 else [])]) or 'none'}"


def flight_sessions(path: Path) -> list[int]:
    """The numbers of a file's sessions that hold frames; [] when it cannot be read."""
    try:
        with reading_log(path):
            data = path.read_bytes()
    except InputError:
        return []
    found = []
    for number, (start, stop) in enumerate(pairwise(session_starts(data)), 1):
        try:
            header = read_header(data, start, stop)
        except InputError:
            continue
        if stop - header.data > _LEAST_BYTES:
            found.append(number)
    return found


class _SessionReader:
    """Turns the frames of one session into streams."""

    def __init__(self, header: Header, frames: BlackboxFrames) -> None:
        self._header, self._frames = header, frames
        self._t = frames.time_us * 1e-6
        fine = header.number("blackbox_high_resolution", 0.0) > 0.0
        self._degrees = np.radians(0.1 if fine else 1.0)
        """rad/s of one in what the firmware counts in deg/s, or tenths of them."""
        self._motors = self._count("motor")
        self._rotors = self._motors or self._count("eRPM") or self._count("omegaUnfiltered")

    def read(self) -> Recording:
        frames = self._frames
        recording = Recording(
            tracks=[],
            system=1,
            component=mavlink.MAV_COMP_ID_AUTOPILOT1,
            # No firmware writes its mixer into the header.
            vehicle_type=multirotor_type(self._rotors),
            autopilot=mavlink.MAV_AUTOPILOT_GENERIC,
            parameters=self._parameters(),
            counts={f"{letter} frames": count for letter, count in frames.counts.items() if count},
            garbage_bytes=frames.garbage_bytes,
            damaged=frames.damaged > 0,
        )
        if frames.lost:
            recording.dropped["frames that cannot be computed"] = frames.lost
        self._add_mixer(recording)
        self._add_imu(recording)
        self._add_attitude(recording)
        self._add_velocity(recording)
        self._add_rotors(recording)
        self._add_armed(recording)
        self._add_extras(recording)
        return recording

    def _count(self, name: str) -> int:
        names = self._frames.main.names
        return next(i for i in range(len(names) + 1) if f"{name}[{i}]" not in names)

    def _fields(self, name: str, count: int) -> Array | None:
        """(n, count) of an array field; None when the log has not all of it."""
        return self._frames.main.columns(*(f"{name}[{i}]" for i in range(count)))

    def _first_of(self, *names: str) -> Array | None:
        """(n, 3) of the first field that is there."""
        found = (self._fields(name, 3) for name in names)
        return next((values for values in found if values is not None), None)

    def _parameters(self) -> list[tuple[float, str, float]]:
        """The numbers of the header: `motorOutput[1]` is the second one of a line."""
        dated = []
        for line in self._header.values:
            numbers = self._header.numbers(line) if line.isascii() and " " not in line else []
            for i, value in enumerate(numbers[:_MOST_NUMBERS]):
                name = line if len(numbers) == 1 else f"{line}[{i}]"
                dated.append((float(self._t[0]), name, value))
        return dated

    def _add_mixer(self, recording: Recording) -> None:
        """What a PID sum of one adds to each motor, as parameters, where the log shows it."""
        motors = self._fields("motor", self._motors)
        if motors is None or not self._motors:
            return
        sums = np.zeros((len(motors), 3))
        for axis in range(3):
            for term in _PID_TERMS:
                part = self._frames.main.columns(f"{term}[{axis}]")
                if part is not None:
                    sums[:, axis] += part[:, 0]
        # Motors at a limit do not follow; the throttle is what all have in common.
        low, high = motors.min(), motors.max()
        edge = 0.01 * (high - low)
        free = ((motors > low + edge) & (motors < high - edge)).all(axis=1)
        apart = (motors - motors.mean(axis=1, keepdims=True))[free]
        known = np.column_stack([sums[free], np.ones(len(apart))])
        if len(apart) < _FEWEST_MIXED or not (known.std(axis=0)[:3] > 0.0).all():
            return
        gains, *_ = np.linalg.lstsq(known, apart, rcond=None)
        rest, power = ((apart - known @ gains) ** 2).sum(axis=0), apart.var(axis=0) * len(apart)
        if (rest < (1.0 - _MIXED) * power).all():
            recording.parameters += [
                (float(self._t[0]), f"{MIXER}{axis}[{motor}]", float(gain))
                for axis, row in zip(("roll", "pitch", "yaw"), gains, strict=False)
                for motor, gain in enumerate(row)
            ]

    def _add_imu(self, recording: Recording) -> None:
        gyro = self._first_of("gyroADCafterRpm", "gyroADC", "gyroData")
        acc = self._first_of("accUnfiltered", "accSmooth")
        if gyro is None:
            return
        known, one_g = self._header.values, self._header.number("acc_1G", 0.0)
        if not known.keys() & {"gyro_scale", "gyro.scale"}:
            recording.problems += ("its header has no gyro_scale: deg/s are assumed of the gyro",)
        if acc is not None and "acc_1G" not in known:
            recording.problems += ("its header has no acc_1G: accelerations have no scale",)
        force = (
            np.full_like(gyro, np.nan) if acc is None or one_g <= 0.0 else acc * (GRAVITY / one_g)
        )
        values = np.hstack([gyro * self._gyro_unit() * _FRD, force * _FRD])
        recording.add(Stream.IMU, self._t, values)

    def _gyro_unit(self) -> float:
        """rad/s of one: the header's `gyro_scale` is a float's bits, in deg/s."""
        values = self._header.values
        bits = values.get("gyro_scale", values.get("gyro.scale", "")).strip().removeprefix("0x")
        try:
            (scale,) = struct.unpack(">f", bytes.fromhex(bits.rjust(8, "0")))
        except (ValueError, struct.error):
            scale = 1.0
        if not _SCALES[0] < scale < _SCALES[1]:
            scale = 1.0
        if scale < _RADIANS:  # Baseflight counts in rad/us
            return float(scale * 1e6)
        return float(scale * self._degrees)

    def _add_attitude(self, recording: Recording) -> None:
        q = self._fields("quat", 4)
        if q is not None:
            recording.add(Stream.ATTITUDE, self._t, q / _INDIFLIGHT_ONE)
            return
        xyz = self._first_of("imuQuaternion")
        if xyz is not None:
            xyz = xyz / _QUATERNION_ONE
            w = np.sqrt(np.maximum(1.0 - (xyz**2).sum(axis=1), 0.0))
            recording.add(Stream.ATTITUDE, self._t, np.column_stack([w, xyz * _FRD]))
            return
        angles = self._first_of("attitude")
        if angles is not None:  # INAV: tenths of degrees, nose down, clockwise from north
            q = from_angles(np.radians(angles * (0.1, -0.1, 0.1)))
            recording.add(Stream.ATTITUDE, self._t, q)

    def _add_velocity(self, recording: Recording) -> None:
        for source in _POSITIONS:
            velocity, position = self._first_of(source.velocity), self._first_of(source.position)
            if velocity is None or position is None:
                continue
            to_ned = np.array(source.to_ned)
            values = np.hstack([velocity * 0.01 * to_ned, position * source.unit * to_ned])
            new = np.flatnonzero((np.diff(values, axis=0) != 0.0).any(axis=1)) + 1
            if len(new) > 1:
                recording.add(Stream.VELOCITY, self._t[new], values[new])
                return

    def _add_rotors(self, recording: Recording) -> None:
        count = self._motors
        commands = self._fields("motor", count)
        if commands is not None and count:
            recording.add(Stream.ROTOR_COMMAND, self._t, commands, source="motor")
        poles = self._header.number("motor_poles", MOTOR_POLES)
        for name, unit in (
            ("eRPM", 100.0 * RPM / (0.5 * (poles if poles >= 2.0 else MOTOR_POLES))),
            ("omegaUnfiltered", 1.0),
        ):
            speeds = self._fields(name, self._rotors)
            if speeds is not None and speeds.any():
                recording.add(Stream.ROTOR_SPEED, self._t, speeds * unit, source=name)
                return

    def _when(self, order: Array) -> Array:
        """(k,) s of frames without a time: that of the main frame before."""
        first = float(self._t[0])
        return np.maximum(latest(self._frames.main.order, self._t, order), first)

    def _add_armed(self, recording: Recording) -> None:
        """As the switch is; a log without it is of an armed vehicle, until it says otherwise."""
        changes = {float(self._t[0]): True}
        flags = self._frames.slow.columns(_MODES)
        if flags is not None and (armed := flags[:, 0].astype(np.int64) & _ARM > 0).any():
            t = self._when(self._frames.slow.order)
            last = np.append(t[1:] != t[:-1], True)  # of a time
            changes = dict(zip(t[last].tolist(), armed[last].tolist(), strict=True))
        events = self._frames.events
        stops = self._when(events[events[:, 1] == DISARM, 0])
        changes |= dict.fromkeys(stops.tolist(), False)
        recording.add_state(Stream.ARMED, changes, float(self._t[-1]))

    def _add_extras(self, recording: Recording) -> None:
        """Setpoints of the rate loop, and the battery."""
        asked = self._fields("setpoint", 3)
        asked = self._fields("axisRate", 3) if asked is None else asked  # INAV
        turns = self._fields("gyroSp", 3)
        if asked is not None:
            recording.add(Stream.RATE_SETPOINT, self._t, asked * self._degrees * _FRD)
        elif turns is not None:
            recording.add(Stream.RATE_SETPOINT, self._t, np.radians(turns))
        unit, divider = 0.01, self._header.number("vbatscale", 0.0)
        if 0.0 < self._header.number("vbatref", 0.0) < 256.0:
            unit = 0.1  # Betaflight 3, in a byte
        elif divider > 0.0:
            unit = 0.33 * divider / 4095.0  # before, counts of the converter at 3.3 V
        for name in ("vbatLatest", "vbat"):
            volts = self._frames.main.columns(name)
            if volts is not None:
                recording.add_voltage(self._t, volts * unit)
