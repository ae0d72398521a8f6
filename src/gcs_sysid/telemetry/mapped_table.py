"""Tables of signals, CSV or Parquet, read by a mapping file that says what their columns are.

The mapping is TOML; `docs/tables.md` lists its keys. World axes other than NED and body axes other
than FRD are turned on reading: with M from the table's world to NED and B from FRD to the table's
body, both turns by 180 degrees, q = M * q_table * B.
"""

import contextlib
import csv
import math
import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError, needed
from gcs_sysid.files import MOST_BYTES_OF_TEXT, parse_toml, read_text, real_number, reject_unknown
from gcs_sysid.model.attitude import conjugate, from_angles, multiply, rotate
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.message_table import RPM
from gcs_sysid.telemetry.track_collector import Recording, interpolated, upright
from gcs_sysid.telemetry.vehicles import multirotor_type

_DEGREE = math.pi / 180.0
_HALF = math.sqrt(0.5)
_BODIES = {"FRD": (1.0, 1.0, 1.0), "FLU": (1.0, -1.0, -1.0)}
_BODY_TURNS = {"FRD": (1.0, 0.0, 0.0, 0.0), "FLU": (0.0, 1.0, 0.0, 0.0)}
_WORLDS = {
    "NED": (1.0, 0.0, 0.0, 0.0),
    "NWU": (0.0, 1.0, 0.0, 0.0),
    "ENU": (0.0, _HALF, _HALF, 0.0),
}
"""Name -> quaternion of the turn from it to NED."""
_ORDERS = {"wxyz": (0, 1, 2, 3), "xyzw": (3, 0, 1, 2)}
_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_RATES = {"rad/s": 1.0, "deg/s": _DEGREE}
_SPEEDS = {"rad/s": 1.0, "rpm": RPM, "Hz": 2.0 * math.pi}
_UNITS: dict[str, dict[str, float]] = {
    "gyro": _RATES,
    "force": {"m/s^2": 1.0, "g": GRAVITY},
    "attitude": {"rad": 1.0, "deg": _DEGREE},
    "velocity": {"m/s": 1.0},
    "position": {"m": 1.0},
    "speeds": _SPEEDS,
    "commands": {"1": 1.0, "%": 0.01},
    "in_air": {"1": 1.0},
    "armed": {"1": 1.0},
    "voltage": {"V": 1.0, "mV": 1e-3},
}
"""Signal -> unit -> what it is in SI; the first is the default."""
SIGNALS = tuple(_UNITS)
_WIDTHS = {"gyro": (3,), "force": (3,), "attitude": (3, 4), "velocity": (3,), "position": (3,),
           "in_air": (1,), "armed": (1,), "voltage": (1,)}  # fmt: skip
_KEYS = {"columns", "unit", "frame", "world", "order", "inverse", "time", "min", "max"}
_TOP = {"time", "time_unit", "frame", "world", "delimiter", "autopilot", "parameters", *_UNITS}
_MOST_ROTORS = 32
_LARGEST = 1e21
"""Larger values are damaged, and would overflow in products; times in ns have 19 digits."""
_AUTOPILOTS = {
    "": mavlink.MAV_AUTOPILOT_GENERIC,
    "px4": mavlink.MAV_AUTOPILOT_PX4,
    "ardupilot": mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
}
_MISSING = {"", "nan", "na", "null", "none"}


@dataclass(frozen=True)
class SignalColumns:
    """What one signal is made of.

    Attributes:
        columns: names in the table's header, in the order of axes or of motors.
        factor: of the unit to SI.
        time: column of its times.
        frame: FRD or FLU, of body axes.
        world: NED, NWU or ENU.
        order: of a quaternion, wxyz or xyzw.
        inverse: whether an attitude turns world axes into the body's, instead of the reverse.
        low: command that stops a motor.
        high: command of full thrust.
    """

    columns: tuple[str, ...]
    factor: float
    time: str
    frame: str
    world: str
    order: str
    inverse: bool
    low: float
    high: float


@dataclass(frozen=True)
class TableMapping:
    """A mapping file, checked."""

    signals: Mapping[str, SignalColumns]
    time_factor: float
    delimiter: str | None
    autopilot: str
    parameters: Mapping[str, float]

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns that it names, each once."""
        named = [c for s in self.signals.values() for c in (s.time, *s.columns)]
        return tuple(dict.fromkeys(named))


def read_mapping(path: Path) -> TableMapping:
    """A mapping file.

    Raises:
        InputError: it cannot be read, or is inconsistent.
    """
    text = read_text(path, "the mapping file")
    mapping = mapping_of(path, parse_toml(text, str(path), "a mapping file"))
    if not _rotor_signals(mapping):
        raise InputError(f"{path}: neither [speeds] nor [commands] of the rotors is mapped")
    return mapping


def mapping_of(path: Path, table: Mapping[str, Any]) -> TableMapping:
    """The content of a mapping file, which is named where there is something wrong.

    Raises:
        InputError: it is inconsistent.
    """
    reject_unknown(table, _TOP, str(path))
    common = {key: _text(path, key, table.get(key, ""), "") for key in ("time", "frame", "world")}
    delimiter = _text(path, "delimiter", table.get("delimiter", ","), ",")
    if len(delimiter) != 1:
        raise InputError(f'{path}: delimiter: must be one character, such as ";"')
    signals = {}
    for name in _UNITS:
        if name in table:
            signals[name] = _signal(path, name, table[name], common)
    if "gyro" not in signals:
        raise InputError(f'{path}: gyro is missing: [gyro] with columns = ["p", "q", "r"]')
    if "velocity" in signals and signals["velocity"].world == "body" and "attitude" not in signals:
        raise InputError(f"{path}: [velocity] in axes of the body needs [attitude] too")
    if "position" in signals and "velocity" not in signals:
        raise InputError(f"{path}: [position] needs [velocity] too")
    return TableMapping(
        signals,
        _choice(path, "time_unit", table.get("time_unit", "s"), _TIMES),
        delimiter if "delimiter" in table else None,
        _name(path, "autopilot", table.get("autopilot", ""), _AUTOPILOTS),
        _parameters(path, table.get("parameters", {})),
    )


def _signal(path: Path, name: str, table: Any, common: Mapping[str, str]) -> SignalColumns:
    if isinstance(table, list | str):
        table = {"columns": table}
    if not isinstance(table, dict):
        raise InputError(f"{path}: {name}: must be a table with columns")
    reject_unknown(table, _KEYS, f"{path}: {name}")
    columns = table.get("columns", [])
    columns = [columns] if isinstance(columns, str) else columns
    if not (isinstance(columns, list) and columns and all(isinstance(c, str) for c in columns)):
        raise InputError(f'{path}: {name}: columns must be a list of names, such as ["a", "b"]')
    widths = _WIDTHS.get(name)
    if (widths and len(columns) not in widths) or len(columns) > _MOST_ROTORS:
        wanted = " or ".join(map(str, widths or (f"at most {_MOST_ROTORS}",)))
        raise InputError(f"{path}: {name}: needs {wanted} columns, not {len(columns)}")
    if len(set(columns)) < len(columns):
        raise InputError(f"{path}: {name}: names a column twice")
    units = _UNITS[name]
    inverse = table.get("inverse", False)
    if not isinstance(inverse, bool):
        raise InputError(f"{path}: {name}: inverse must be true or false")
    low, high = (
        real_number(table.get(k, d), f"{path}: {name}: {k}") for k, d in (("min", 0), ("max", 1))
    )
    if not low < high:
        raise InputError(f"{path}: {name}: min {low:g} must be less than max {high:g}")
    time = _text(path, f"{name}: time", table.get("time", common["time"]), "")
    if not time:
        raise InputError(f'{path}: time is missing: time = "name of the column of times"')
    return SignalColumns(
        tuple(columns),
        _choice(path, f"{name}: unit", table.get("unit", next(iter(units))), units),
        time,
        _name(path, f"{name}: frame", table.get("frame", common["frame"] or "FRD"), _BODIES),
        _name(
            path,
            f"{name}: world",
            table.get("world", common["world"] or "NED"),
            (*_WORLDS, "body") if name == "velocity" else _WORLDS,
        ),
        _name(path, f"{name}: order", table.get("order", "wxyz"), _ORDERS),
        inverse,
        low,
        high,
    )


def _text(path: Path, key: str, value: Any, default: str) -> str:
    if not isinstance(value, str):
        raise InputError(f"{path}: {key} must be text in quotes, not {value!r}")
    return value or default


def _name(path: Path, key: str, value: Any, known: Collection[str]) -> str:
    if not isinstance(value, str) or value not in known:
        names = ", ".join(name for name in known if name)
        raise InputError(f"{path}: {key} must be one of {names}, not {value!r}")
    return value


def _choice(path: Path, key: str, value: Any, known: Mapping[str, float]) -> float:
    return known[_name(path, key, value, known)]


def _parameters(path: Path, table: Any) -> dict[str, float]:
    if not isinstance(table, dict):
        raise InputError(f"{path}: parameters must be a table of NAME = number")
    return {
        name: real_number(value, f"{path}: parameters: {name}") for name, value in table.items()
    }


def read_table(path: Path, mapping_path: Path) -> Recording:
    """Read a table as a log.

    Raises:
        InputError: either cannot be read, or they do not fit each other.
    """
    mapping = read_mapping(mapping_path)
    try:
        with open(path, "rb") as file:
            is_parquet = file.read(4) == b"PAR1"
        read = _read_parquet if is_parquet else _read_csv
        columns = read(path, mapping, mapping_path)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    return recording_of(path, mapping, columns, mapping_path)


def recording_of(
    path: Path, mapping: TableMapping, columns: Mapping[str, Array], mapping_path: Path
) -> Recording:
    """Columns as a mapping says what they are; those of a signal are of one length.

    Raises:
        InputError: their times are none, or there is no sample of the gyro.
    """
    rotors = max((len(mapping.signals[n].columns) for n in _rotor_signals(mapping)), default=0)
    recording = Recording(
        tracks=[],
        system=1,
        component=1,
        vehicle_type=multirotor_type(rotors),
        autopilot=_AUTOPILOTS[mapping.autopilot],
        counts={name: len(columns[s.time]) for name, s in mapping.signals.items()},
    )
    values = {n: _values(s, columns, mapping.time_factor) for n, s in mapping.signals.items()}
    _check_times(path, mapping, values)
    _add_tracks(recording, mapping, values)
    if not any(track.stream is Stream.IMU for track in recording.tracks):
        raise InputError(f"{path} holds no sample of the gyro: see [gyro] of {mapping_path}")
    start = min(float(track.t[0]) for track in recording.tracks)
    recording.parameters += [(start, name, v) for name, v in mapping.parameters.items()]
    return recording


def _rotor_signals(mapping: TableMapping) -> tuple[str, ...]:
    return tuple(name for name in ("speeds", "commands") if name in mapping.signals)


_Samples = tuple[Array, Array]


def _values(signal: SignalColumns, columns: Mapping[str, Array], time_factor: float) -> _Samples:
    """(n,) s and (n, width) in SI, of the rows in which the signal has any value."""
    t = _sound(columns[signal.time]) * time_factor
    values = _sound(np.column_stack([columns[n] for n in signal.columns])) * signal.factor
    there = np.isfinite(values).any(axis=1) & np.isfinite(t)
    return t[there], values[there]


def _sound(values: Array) -> Array:
    """Values without those that nothing measures."""
    sound: Array = np.where(np.abs(values) <= _LARGEST, values, np.nan)
    return sound


def _check_times(path: Path, mapping: TableMapping, values: Mapping[str, _Samples]) -> None:
    for name, (t, _) in values.items():
        column = mapping.signals[name].time
        if len(t) > 1 and not (np.diff(t) > 0.0).any():
            raise InputError(f"{path}: times in column {column!r} never rise")
        if name == "gyro" and len(t) > 1:
            steps = np.diff(t)
            if 4 * np.count_nonzero(steps == 0.0) > len(steps):
                raise InputError(
                    f"{path}: rows share their time in column {column!r}: are they of two "
                    "sensors? Leave those of one"
                )
            rate = 1.0 / max(float(np.median(steps)), 1e-12)
            if not 2.0 < rate < 50_000.0:
                raise InputError(
                    f"{path}: by column {column!r} the gyro comes at {rate:.3g} Hz: "
                    "set time_unit to s, ms, us or ns"
                )


def _add_tracks(
    recording: Recording, mapping: TableMapping, values: Mapping[str, _Samples]
) -> None:
    gyro_t, gyro = values["gyro"]
    gyro = gyro * _BODIES[mapping.signals["gyro"].frame]
    force = np.full_like(gyro, np.nan)
    if "force" in values:
        force_t, found = values["force"]
        found = found * _BODIES[mapping.signals["force"].frame]
        # In rows of their own the two meet by time.
        same = len(force_t) == len(gyro_t) and bool((force_t == gyro_t).all())
        force = found if same else interpolated(gyro_t, force_t, found)
    recording.add(Stream.IMU, gyro_t, np.hstack([gyro, force]))
    if "attitude" in values:
        t, q = values["attitude"]
        recording.add(Stream.ATTITUDE, t, _attitude(mapping.signals["attitude"], q))
    if "velocity" in values:
        t, v = values["velocity"]
        motion = np.full((len(t), 6), np.nan)
        signal = mapping.signals["velocity"]
        if signal.world == "body":
            at, q = values["attitude"]
            turns = interpolated(t, at, upright(_attitude(mapping.signals["attitude"], q)))
            turns /= np.linalg.norm(turns, axis=1, keepdims=True)
            v = rotate(turns, v * _BODIES[signal.frame])
        motion[:, :3] = _in_ned(v, signal.world)
        if "position" in values:
            at, places = values["position"]
            motion[:, 3:] = interpolated(t, at, _in_ned(places, mapping.signals["position"].world))
        else:
            motion[:, 3:] = 0.0
        recording.add(Stream.VELOCITY, t, motion)
    for name, stream in (("speeds", Stream.ROTOR_SPEED), ("commands", Stream.ROTOR_COMMAND)):
        if name in values:
            t, found = values[name]
            signal = mapping.signals[name]
            if name == "speeds":
                found = np.abs(found)
            else:
                low, high = (signal.factor * end for end in (signal.low, signal.high))
                found = (found - low) / (high - low)
            whole = np.isfinite(found).all(axis=1)
            recording.add(stream, t[whole], found[whole], source=name)
    for name, stream in (("in_air", Stream.IN_AIR), ("armed", Stream.ARMED)):
        if name in values:
            # What is less than that of no is not known.
            t, state = values[name]
            no = mapping.signals[name].low
            known = state[:, 0] >= no
            recording.add(stream, t[known], state[known] > no)
    if "voltage" in values:
        recording.add_voltage(*values["voltage"])


def _attitude(signal: SignalColumns, values: Array) -> Array:
    """(n, 4) quaternions w, x, y, z, FRD to NED, of quaternions or Euler angles."""
    if values.shape[1] == 4:
        q = values[:, _ORDERS[signal.order]] / signal.factor
    else:  # about x, y, z of the table's own axes (z-y'-x'')
        q = from_angles(values)
    q = conjugate(q) if signal.inverse else q
    world = np.array(_WORLDS[signal.world])
    body = np.array(_BODY_TURNS[signal.frame])
    out: Array = multiply(
        multiply(np.broadcast_to(world, q.shape), q), np.broadcast_to(body, q.shape)
    )
    return out


def _in_ned(values: Array, world: str) -> Array:
    if world == "ENU":
        return values[:, [1, 0, 2]] * (1.0, 1.0, -1.0)
    out: Array = values * ((1.0, -1.0, -1.0) if world == "NWU" else 1.0)
    return out


def _check_header(
    path: Path, mapping: TableMapping, mapping_path: Path, header: Sequence[str]
) -> None:
    missing = [name for name in mapping.columns if name not in header]
    if missing:
        there = ", ".join(name for name in header[:12] if name) + (" ..." if header[12:] else "")
        raise InputError(
            f"{path} has no column {missing[0]!r}, which {mapping_path} names; it has {there}"
        )


@dataclass(frozen=True)
class _TextForm:
    """How a table of text is written: its encoding, delimiter, and lines before the rows."""

    encoding: str
    delimiter: str
    header: list[str]
    before: int


def _text_form(path: Path, delimiter: str | None) -> _TextForm:
    with open(path, "rb") as file:
        line = file.readline(MOST_BYTES_OF_TEXT)
    head = line[:64]
    wide = head.startswith((b"\xff\xfe", b"\xfe\xff"))
    # Without a mark, as of some exporters, every second byte of letters is zero.
    little = not wide and head[1::2].strip(b"\0") == b"" != head[::2].strip(b"\0")
    encoding = "utf-16" if wide else "utf-16-le" if little else "utf-8-sig"
    try:
        if encoding == "utf-8-sig" and line.decode(errors="replace").encode() != line:
            encoding = "latin-1"  # of Excel in the west
        with open(path, encoding=encoding, newline="") as file:
            first = file.readline(MOST_BYTES_OF_TEXT)
            named = first.lower().startswith("sep=")
            if named:  # of Excel
                delimiter = delimiter or first[4:5]
                first = file.readline(MOST_BYTES_OF_TEXT)
    except UnicodeError:
        first = "\0"
    if not first.replace("\t", " ").rstrip("\r\n").isprintable():
        raise InputError(f"{path}: not a table: neither text nor Parquet")
    delimiter = delimiter or max(",;\t", key=first.count)
    try:
        header = [name.strip() for name in next(csv.reader([first], delimiter=delimiter), [])]
    except (csv.Error, TypeError) as error:
        raise InputError(f"{path}: not a table of text: {error}") from error
    return _TextForm(encoding, delimiter, header, 1 + named)


def _read_csv(path: Path, mapping: TableMapping, mapping_path: Path) -> dict[str, Array]:
    """Column -> (n,) values; what is empty is NaN."""
    form = _text_form(path, mapping.delimiter)
    _check_header(path, mapping, mapping_path, form.header)
    places = [form.header.index(name) for name in mapping.columns]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # that there are no rows is said below
            values = np.loadtxt(path, float, None, form.delimiter, skiprows=form.before,
                                usecols=places, ndmin=2, encoding=form.encoding)  # fmt: skip
    except ValueError:  # empty fields, or what is no number: slower, and by line
        values = _by_line(path, form, mapping, places)
    if not len(values):
        raise InputError(f"{path} has a header and no rows")
    return dict(zip(mapping.columns, values.T, strict=True))


def _by_line(path: Path, form: _TextForm, mapping: TableMapping, places: Sequence[int]) -> Array:
    rows, times = [], {signal.time for signal in mapping.signals.values()}
    point = "," if form.delimiter == "," else "."
    try:
        with open(path, encoding=form.encoding, newline="") as file:
            reader = csv.reader(file, delimiter=form.delimiter)
            for _ in range(form.before):
                next(reader, None)
            for row in reader:
                if row:
                    fields = zip(mapping.columns, places, strict=True)
                    rows.append([_field(path, reader.line_num, row, n, p, point, mapping.time_factor
                                        if n in times else None) for n, p in fields])  # fmt: skip
    except (UnicodeError, csv.Error) as error:
        raise InputError(f"{path}: not a table of text: {error}") from error
    return np.array(rows, float).reshape(-1, len(mapping.columns))


def _field(
    path: Path,
    line: int,
    row: Sequence[str],
    name: str,
    place: int,
    point: str,
    time_factor: float | None,
) -> float:
    """A number; of a column of times in units of `time_factor` s, which may be dates too."""
    text = row[place].strip() if place < len(row) else ""
    try:
        # A comma that does not part fields is a decimal one.
        return math.nan if text.lower() in _MISSING else float(text.replace(",", point))
    except ValueError:
        states = {"true": 1.0, "false": 0.0}
        if text.lower() in states:
            return states[text.lower()]
        with contextlib.suppress(ValueError, OverflowError):
            if time_factor is not None:
                date = datetime.fromisoformat(text)
                return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp() / time_factor
        raise InputError(
            f"{path}: line {line}, column {name!r}: {text[:40]!r} is no number"
        ) from None


def _read_parquet(path: Path, mapping: TableMapping, mapping_path: Path) -> dict[str, Array]:
    needing = f"{path}: reading Parquet"
    pa, parquet = needed("pyarrow", needing), needed("pyarrow.parquet", needing)
    try:
        header = parquet.read_schema(path).names
        _check_header(path, mapping, mapping_path, header)
        table = parquet.read_table(path, columns=list(mapping.columns))
        out = {}
        for name in mapping.columns:
            column = table.column(name)
            if pa.types.is_timestamp(column.type) or pa.types.is_duration(column.type):
                unit = _TIMES[column.type.unit]
                column = column.cast(pa.int64())
                out[name] = column.to_numpy().astype(float) * unit / mapping.time_factor
            else:
                out[name] = column.cast(pa.float64()).to_numpy().astype(float)
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path}: cannot read the Parquet file: {str(error)[:200]}") from error
    if not len(out[mapping.columns[0]]):
        raise InputError(f"{path} has no rows")
    return out
