"""ArduPilot's own logs (.bin): each entry type as the stream that it would be on a link.

- IMU of the first instance is HIGHRES_IMU: filtered by INS_GYRO_FILTER and INS_ACCEL_FILTER. Where
  that stands still, another that measures on is read.
- ESC holds the reading as it came (RawRPM) beside the one slewed to the moment of writing (RPM,
  what ESC_TELEMETRY sends, 2 ms later): the former is taken.
- RCOU is SERVO_OUTPUT_RAW, usually at 10 Hz.
- Entries without a time (EV and PARM of old firmware) take that of the IMU entry before them.
"""

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.errors import InputError
from gcs_sysid.model.attitude import from_angles
from gcs_sysid.signals.inertial_stream import Standstill
from gcs_sysid.signals.motor_order import motor_outputs
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.dataflash_format import EVERY, DataflashLog
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.message_table import RPM, OnboardMessage
from gcs_sysid.telemetry.track_collector import Recording

_EV_ARMED, _EV_DISARMED, _EV_LANDED, _EV_NOT_LANDED = 10, 11, 18, 28
_OUTPUTS = ("RCOU", "RCO2", "RCO3")
"""Entries with outputs, RCOU with the first."""
_EKF_2 = 2.0
"""AHRS_EKF_TYPE."""
_FRAME_CLASSES = {
    1: mavlink.MAV_TYPE_QUADROTOR,
    2: mavlink.MAV_TYPE_HEXAROTOR,
    3: mavlink.MAV_TYPE_OCTOROTOR,
    4: mavlink.MAV_TYPE_OCTOROTOR,
    5: mavlink.MAV_TYPE_HEXAROTOR,
    6: mavlink.MAV_TYPE_HELICOPTER,
    7: mavlink.MAV_TYPE_TRICOPTER,
    8: mavlink.MAV_TYPE_COAXIAL,
    9: mavlink.MAV_TYPE_COAXIAL,
    11: mavlink.MAV_TYPE_HELICOPTER,
    12: mavlink.MAV_TYPE_DODECAROTOR,
    13: mavlink.MAV_TYPE_HELICOPTER,
    14: mavlink.MAV_TYPE_DECAROTOR,
}
"""FRAME_CLASS -> MAV_TYPE."""
_OTHER_FIRMWARE = (
    (rb"(?:Ardu|APM:)Plane", mavlink.MAV_TYPE_FIXED_WING),
    (rb"(?:Ardu|APM:)Rover", mavlink.MAV_TYPE_GROUND_ROVER),
    (rb"ArduSub", mavlink.MAV_TYPE_SUBMARINE),
    (rb"Blimp", mavlink.MAV_TYPE_AIRSHIP),
)
"""Beginnings of the message that names the firmware, where that is not Copter."""
_CHANNEL = re.compile(r"(?:C|Ch|Chan)(\d+)")


_Q = ("Q1", "Q2", "Q3", "Q4")
_NED = ("VN", "VE", "VD", "PN", "PE", "PD")
ENTRIES = (
    OnboardMessage(
        "IMU", Stream.IMU, ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"), sensors="primary"
    ),
    OnboardMessage(
        "ATT",
        Stream.ATTITUDE,
        ("Roll", "Pitch", "Yaw"),
        convert=lambda degrees: from_angles(np.radians(degrees)),
    ),
    OnboardMessage("XKQ", Stream.ATTITUDE, _Q, rank=1, sensors="primary"),
    OnboardMessage("NKQ", Stream.ATTITUDE, _Q, rank=2, sensors="primary"),
    OnboardMessage("XKF1", Stream.VELOCITY, _NED, rank=1, sensors="primary"),
    OnboardMessage("NKF1", Stream.VELOCITY, _NED, rank=2, sensors="primary"),
    OnboardMessage("EKF1", Stream.VELOCITY, _NED, rank=3, sensors="primary"),
    OnboardMessage("RATE", Stream.RATE_SETPOINT, ("RDes", "PDes", "YDes"), math.radians(1.0)),
)
"""Entries whose columns are the values. Of a stream's, the first is read; of attitudes the one that
comes most often. Outputs, ESCs, RPM and states take more, see `_EntryReader`."""
_TIMES, _NUMBERS = ("TimeUS", "TimeMS"), ("I", "C", "Inst", "Instance")
_READ: dict[str, set[str]] = {
    "PARM": {"Name", "Value"}, "ESC": {"RPM", "RawRPM"}, "RPM": {"RPM", "rpm1", "rpm2"},
    "EV": {"Id"}, "ARM": {"ArmState"}, "BAT": {"Volt"}, "CTUN": {"ThO"}, "MOTB": {"BatVolt"},
    "BARO": {"Press"}, "DSF": {"Dp"}, "MSG": {"Message"},
    "GPS": {"GMS", "GWk"},
    **{f"ESC{number}": {"RPM", "RawRPM"} for number in range(1, 17)},
    **{f"{row.name[:2]}F4": {"PI"} for row in ENTRIES},
    **{row.name: set(row.fields) for row in ENTRIES},
}  # fmt: skip
"""Entry -> columns that are read, beside times, numbers of instances and outputs."""
_OF_MOTORS = (
    ("throttle", "CTUN", "ThO"),
    ("share of the full voltage", "MOTB", "BatVolt"),
    ("pressure", "BARO", "Press"),
)
"""Extras by entry and column, as AP_MotorsMulticopter and AP_Baro (raw) log them."""
_EKF_2_FIRST = {"XKQ": 2, "NKQ": 1, "XKF1": 2, "NKF1": 1}
"""Ranks where the autopilot flies by EKF 2 (N...) instead of EKF 3 (X...)."""


def _is_read(name: str, column: str) -> bool:
    if name in _OUTPUTS:
        return column in _TIMES or _CHANNEL.fullmatch(column) is not None
    return name in _READ and (column in _READ[name] or column in (*_TIMES, *_NUMBERS))


def read_dataflash(path: Path, window: int | None = None) -> Recording:
    """Read a .bin file.

    `window` is bytes read at once, which change no number.

    Raises:
        InputError: it cannot be read or is no dataflash log.
    """
    log = DataflashLog(path, _is_read, window)
    if "StartTime" in log.columns("TIME"):
        raise InputError(
            f"{path} is a log of PX4 from before 2017 (sdlog2), which is not read: convert it to "
            ".csv with PX4's sdlog2_dump.py and say with --csv what the columns are"
        )
    with np.errstate(invalid="ignore", over="ignore"):  # damaged numbers may be anything
        return _EntryReader(log).read()


class _EntryReader:
    """Turns the entries of one log into streams."""

    def __init__(self, log: DataflashLog) -> None:
        self._log = log
        # Entries without a time take that of the most frequent one.
        timed = [name for name in ("IMU", "ATT", "RCOU") if name in log.counts]
        self._known = timed[0] if timed else ""
        known_t = self._own_times(self._known)
        self._span = (float(known_t[0]), float(known_t[-1])) if len(known_t) else None
        self._parameters = self._read_parameters()
        self._latest = {name: value for _, name, value in self._parameters}

    def read(self) -> Recording:
        system = self._latest.get("MAV_SYSID", self._latest.get("SYSID_THISMAV", 1.0))
        lost = self._column("DSF", "Dp")
        recording = Recording(
            tracks=[],
            system=int(system),
            component=mavlink.MAV_COMP_ID_AUTOPILOT1,
            vehicle_type=self._vehicle_type(),
            autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
            parameters=self._parameters,
            counts=self._log.counts,
            garbage_bytes=self._log.garbage_bytes,
            damaged=self._log.garbage_bytes > 0,
            lost=0 if lost is None else int(_known(lost)[-1:].sum()),
        )
        self._add_entries(recording)
        self._add_outputs(recording)
        self._add_escs(recording)
        self._add_rpm(recording)
        self._add_states(recording)
        self._add_battery(recording)
        self._add_clock(recording)
        return recording

    def _vehicle_type(self) -> int:
        """MAV_TYPE by firmware and frame; a plane that hovers is what carries it then."""
        messages = self._log.text("MSG", "Message")
        said = [] if messages is None else messages.tolist()
        for begins, vehicle_type in _OTHER_FIRMWARE:
            named = any(re.match(begins, message) for message in said)
            if named and not self._latest.get("Q_ENABLE", 0.0) > 0.0:
                return vehicle_type
        frame = self._latest.get("FRAME_CLASS", self._latest.get("Q_FRAME_CLASS", 0.0))
        # Firmware before FRAME_CLASS was made for one frame each, mostly the quadrotor.
        return _FRAME_CLASSES.get(int(frame), mavlink.MAV_TYPE_QUADROTOR)

    def _column(self, name: str, *columns: str) -> Array | None:
        """(n,) the first of some columns that the entries of a name have."""
        there = self._log.names(name)
        column = next((column for column in columns if column in there), None)
        return None if column is None else self._log.numbers(name, (column,))[column]

    def _own_times(self, name: str) -> Array:
        for column, unit in (("TimeUS", 1e-6), ("TimeMS", 1e-3)):
            times = self._column(name, column)
            if times is not None:
                return times * unit
        return np.zeros(0)

    def _times(self, name: str) -> Array:
        """(n,) s of all entries of a name: their own, else those of what was written before."""
        own = self._own_times(name)
        if len(own):
            return own
        places, known_t = self._log.places(name), self._own_times(self._known)
        if not len(known_t):
            return np.zeros(len(places))
        before = np.searchsorted(self._log.places(self._known), places) - 1
        return known_t[np.maximum(before, 0)]

    def _read_parameters(self) -> list[tuple[float, str, float]]:
        texts, values = self._log.text("PARM", "Name"), self._column("PARM", "Value")
        if values is None or texts is None:
            return []
        names = (name.decode("ascii", "replace") for name in texts.tolist())
        table = zip(self._times("PARM").tolist(), names, values.tolist(), strict=True)
        return [
            (t, name, value)
            for t, name, value in table
            if math.isfinite(t) and math.isfinite(value) and name.isprintable()
        ]

    def _named(self, name: str, wanted: Sequence[str], rows: Mask | slice = EVERY) -> Array | None:
        """(n, columns) of the columns named; None when the log has not all of them."""
        if not wanted or not set(wanted) <= set(self._log.names(name)):
            return None
        first = self._log.numbers(name, wanted[:1], rows)[wanted[0]]
        values = np.empty((len(first), len(wanted)))
        for i, column in enumerate(wanted):
            values[:, i] = self._log.numbers(name, (column,), rows)[column] if i else first
        return values

    def _primary(self, name: str) -> Mask:
        """(n,) the entries of the first sensor, or of the estimator that the autopilot flies by."""
        number = self._column(name, "I", "C")
        if number is None:
            return np.ones(len(self._log.places(name)), dtype=bool)
        wanted = number.min()
        by_core = "C" in self._log.names(name)
        chosen = self._column(f"{name[:2]}F4", "PI") if by_core else None
        if chosen is not None:
            primaries, times = np.unique(chosen, return_counts=True)
            most = primaries[times.argmax()]
            wanted = most if np.any(number == most) else wanted
        return number == wanted

    def _sound_imu(self, row: OnboardMessage, recording: Recording) -> Mask:
        """(n,) the entries of the first IMU, or where it stands still, of the one that goes on."""
        first, number = self._primary(row.name), self._column(row.name, "I")
        if number is None or first.all():
            return first
        measured = {}
        for instance in _known(number).tolist():
            rows = number == instance
            values = self._named(row.name, row.fields, rows)
            assert values is not None
            stands = Standstill(values.shape[1]).update(self._times(row.name)[rows], values)
            measured[instance] = int(np.count_nonzero(~stands))
        own, best = min(measured), max(measured, key=measured.__getitem__)
        if measured[own] > 0.9 * measured[best]:  # a loop now and then is faster than its sensor
            return first
        still = 100.0 * (1.0 - measured[own] / int(first.sum()))
        recording.problems += (
            f"IMU {own:.0f} stands still in {still:.0f} % of its entries: IMU {best:.0f} is read",
        )
        return number == best

    def _add_entries(self, recording: Recording) -> None:
        for stream in (Stream.IMU, Stream.ATTITUDE, Stream.VELOCITY, Stream.RATE_SETPOINT):
            there: list[tuple[int, OnboardMessage, Mask | slice]] = []
            for row in sorted((row for row in ENTRIES if row.stream is stream), key=self._rank):
                if set(row.fields) <= set(self._log.names(row.name)):
                    rows: Mask | slice = EVERY
                    count = self._log.counts[row.name]
                    if row.sensors == "primary":
                        primary = (
                            self._sound_imu(row, recording)
                            if stream is Stream.IMU
                            else self._primary(row.name)
                        )
                        rows, count = primary, int(primary.sum())
                    there.append((count, row, rows))
            if there:
                # max gives the first of those that come equally often.
                attitude = stream is Stream.ATTITUDE
                _, row, taken = max(there, key=lambda each: each[0]) if attitude else there[0]
                t = self._times(row.name)[taken]
                columns = self._named(row.name, row.fields, taken)
                assert columns is not None
                recording.add(stream, t, row.values(columns))
            for _, row, _ in there:
                self._log.let_go(row.name, row.fields)

    def _rank(self, row: OnboardMessage) -> int:
        """By which the rows of a stream are sorted."""
        other = _EKF_2_FIRST.get(row.name, row.rank)
        return other if self._latest.get("AHRS_EKF_TYPE") == _EKF_2 else row.rank

    def _add_outputs(self, recording: Recording) -> None:
        """All outputs; where no parameter says which are motors', the first that are used."""
        known = motor_outputs("ardupilot", self._latest)
        for name in _OUTPUTS:
            channels = {
                int(match[1]) - 1: column
                for column in self._log.names(name)
                if (match := _CHANNEL.fullmatch(column)) is not None
            }
            first = min(channels, default=0)
            whole = [c for i, c in enumerate(sorted(channels), first) if c == i]
            if not known:
                columns = self._log.numbers(name, channels.values())
                used = [c for c in whole if c < 4 or columns[channels[c]].any()]
                whole = [c for i, c in enumerate(used, first) if c == i]
            values = self._named(name, [channels[channel] for channel in whole])
            if values is not None:
                t = self._times(name)
                recording.add(Stream.ROTOR_COMMAND, t, values, first, source=_OUTPUTS[0])

    def _add_clock(self, recording: Recording) -> None:
        columns = self._named("GPS", ("GWk", "GMS"))
        if columns is not None:
            weeks, milliseconds = columns.T
            valid = self._primary("GPS") & (weeks > 0.0)
            seconds = 7 * 86_400 * weeks + 1e-3 * milliseconds
            recording.add_clock(self._times("GPS"), seconds, valid)

    def _add_escs(self, recording: Recording) -> None:
        """One stream when all ESCs are written at the same times, else one of each."""
        escs: dict[int, tuple[Array, Array]] = {}
        if "ESC" in self._log.counts:
            number, speed, t = (
                self._column("ESC", "Instance"),
                self._speed("ESC"),
                self._times("ESC"),
            )
            if number is not None and speed is not None:
                for instance in _known(number).tolist():
                    rows = number == instance
                    escs[int(instance)] = t[rows], speed[rows]
        else:
            for instance in range(16):  # before 4.1
                speed = self._speed(f"ESC{instance + 1}")
                if speed is not None:
                    escs[instance] = self._times(f"ESC{instance + 1}"), speed
        # An ESC has the number of its output; old firmware counts those that drive motors.
        outputs = motor_outputs("ardupilot", self._latest).get("SERVO", {})
        if outputs and not escs.keys() & set(outputs.values()):
            escs = {outputs.get(number, number): esc for number, esc in escs.items()}
        first = next(iter(escs.values()), None)
        start = min(escs, default=0)
        together = first is not None and sorted(escs) == list(range(start, start + len(escs)))
        if (
            first is not None
            and together
            and all(np.array_equal(t, first[0]) for t, _ in escs.values())
        ):
            speeds = np.column_stack([escs[motor][1] for motor in sorted(escs)])
            recording.add(Stream.ROTOR_SPEED, first[0], speeds, start, source="ESC")
            return
        for motor, (t, speed) in sorted(escs.items()):
            recording.add(Stream.ROTOR_SPEED, t, speed, motor, "ESC")

    def _speed(self, name: str) -> Array | None:
        """(n,) rad/s that ESCs report; the reading itself where the log has it."""
        columns = self._log.numbers(name, ("RPM", "RawRPM"))
        if "RPM" not in columns:
            return None
        raw = columns.get("RawRPM")
        rpm = columns["RPM"] if raw is None or not np.any(raw) else raw
        return np.abs(rpm) * RPM

    def _add_rpm(self, recording: Recording) -> None:
        columns = self._log.numbers("RPM", ("I", "RPM", "rpm1", "rpm2"))
        t = self._times("RPM")
        if "I" in columns and "RPM" in columns:
            sensors = {int(i): (columns["I"] == i, columns["RPM"]) for i in _known(columns["I"])}
        else:
            every = np.ones(len(t), dtype=bool)
            names = enumerate(("rpm1", "rpm2"))
            sensors = {i: (every, columns[name]) for i, name in names if name in columns}
        for sensor, (rows, rpm) in sensors.items():
            there = rows & (rpm >= 0.0)  # -1: no such sensor
            if np.any(there & (rpm > 0.0)) or sensor == 0:
                recording.add(Stream.ROTOR_SPEED, t[there], rpm[there] * RPM, sensor, "RPM")

    def _add_states(self, recording: Recording) -> None:
        """Armed and in the air, from the changes that are logged."""
        if self._span is None:
            return
        armed: dict[float, bool] = {}
        flies: dict[float, bool] = {}
        for t, number in self._pairs("EV", "Id"):
            if number in (_EV_ARMED, _EV_DISARMED):
                armed[t] = number == _EV_ARMED
            if number in (_EV_LANDED, _EV_NOT_LANDED):
                flies[t] = number == _EV_NOT_LANDED
        armed.update((t, bool(state)) for t, state in self._pairs("ARM", "ArmState"))
        # What was true before the first change is its opposite: many logs begin on arming.
        start, end = self._span
        for changes in (armed, flies):
            if changes:
                changes.setdefault(start, not changes[min(changes)])
        recording.add_state(Stream.ARMED, armed, end)
        recording.add_state(Stream.IN_AIR, flies, end)

    def _add_battery(self, recording: Recording) -> None:
        """Of the first battery, what the motors' library has of it, and the first barometer."""
        volts = self._named("BAT", ("Volt",))
        if volts is not None:
            rows = self._primary_instance("BAT")
            recording.add_voltage(self._times("BAT")[rows], volts[rows])
        for extra, name, column in _OF_MOTORS:
            values = self._named(name, (column,))
            if values is not None:
                rows = self._primary_instance(name)
                recording.extras[extra] = self._times(name)[rows], values[rows]

    def _primary_instance(self, name: str) -> Mask:
        """(n,) the entries of the first instance, under any of the names that number had."""
        number = self._column(name, "Inst", "Instance", "I")
        return np.ones(len(self._log.places(name)), bool) if number is None else number == 0

    def _pairs(self, name: str, column: str) -> Iterator[tuple[float, float]]:
        values = self._column(name, column)
        if values is not None:
            yield from zip(self._times(name).tolist(), values.tolist(), strict=True)


def _known(numbers: Array) -> Array:
    """Each number once; a damaged log may give a count the type of a fraction."""
    return np.unique(numbers[np.isfinite(numbers)])
