"""Harnesses of what logs say of themselves: definitions made by their grammar, not by chance.

Random changes of a log hardly ever make a format that nests itself, or an array of arrays of
nothing. Here each byte of the input is a choice in the grammar, so that nearly every input is a
log with definitions, some of them monstrous. Beside the answer, time and memory have a bar.
"""

import contextlib
import struct
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from random import Random
from zlib import crc32

from gcs_sysid.telemetry.blackbox import read_blackbox
from gcs_sysid.telemetry.dataflash import read_dataflash
from gcs_sysid.telemetry.log_formats import BLACKBOX_HEAD
from gcs_sysid.telemetry.mapped_table import read_table
from gcs_sysid.telemetry.track_collector import Recording
from gcs_sysid.telemetry.ulog import read_ulog
from testbed.fuzz.file_harnesses import check_recording
from testbed.fuzz.harness import Bytes, Scratch, one_line_errors

SECONDS, SECONDS_PER_MB = 0.5, 0.5
"""Processor time that a log may take; a flood of the smallest entries takes 0.25 s a megabyte."""
BYTES, BYTES_PER_BYTE = 64e6, 60.0
"""Memory that a log may take beyond the most that was ever taken before."""
_LARGEST_FLOOD = 100_000
_BEGINNINGS = 200
_FLOODS = 16
"""Inputs for each that may flood."""

_ulg, _bin, _bbl = Scratch(".ulg"), Scratch(".bin"), Scratch(".bbl")
_csv, _mapping = Scratch(".csv"), Scratch(".toml")


def _peak() -> float:
    with contextlib.suppress(ImportError):
        import resource

        return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return 0.0


@contextlib.contextmanager
def bounded(size: int) -> Iterator[None]:
    """Hold a reader to its bar of time and memory."""
    peak, began = _peak(), time.process_time()
    yield
    seconds, taken = time.process_time() - began, _peak() - peak
    assert seconds <= SECONDS + SECONDS_PER_MB * size / 1e6, f"{seconds:.2f} s for {size} bytes"
    assert taken <= BYTES + BYTES_PER_BYTE * size, f"{taken / 1e6:.0f} MB for {size} bytes"


def _check(data: bytes, scratch: Scratch, read: Callable[[Path], Recording]) -> None:
    path = scratch.put(data)
    with bounded(len(data)), one_line_errors():
        check_recording(read(path))


def _pick(take: Bytes, choices: Sequence[str]) -> str:
    return choices[take.byte() % len(choices)]


class _Choices(Bytes):
    """An input as choices in a grammar; some inputs may flood.

    A flood costs as much as a hundred definitions: in all inputs, they would be nearly all that
    is read.
    """

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self.times = (1, 2, 50, *((2000, _LARGEST_FLOOD) if crc32(data) % _FLOODS == 0 else ()))


def _flood(take: _Choices, piece: bytes) -> bytes:
    """A piece once, seldom very often."""
    drawn = take.byte()
    chosen = (drawn > 180) + (drawn > 220) + (drawn > 248) + (drawn > 252)
    times = take.times[min(chosen, len(take.times) - 1)]
    return piece * max(1, min(times, _LARGEST_FLOOD // max(len(piece), 1)))


_TOPICS = (
    "sensor_combined", "actuator_motors", "vehicle_status", "esc_status", "actuator_outputs",
    "n0", "n1", "n2", "n3", "n4", "n5", "n6", "n7", "n8", "n9",
)  # fmt: skip
_ULOG_TYPES = (*_TOPICS, "float", "uint64_t", "uint8_t", "bool", "char", "double", "", "float32")
_COUNTS = (
    "", "", "", "", "[0]", "[1]", "[2]", "[3]", "[4]", "[16]", "[255]", "[1024]", "[65535]",
    "[99999]", "[-1]", "[x]", "[", "[9999999999999999999999]",
)  # fmt: skip
_ULOG_NAMES = (
    "timestamp", "x", "gyro_rad", "accelerometer_m_s2", "control", "esc", "esc_rpm", "noutputs",
    "output", "esc_count", "landed", "_padding0", "", "arming_state",
)  # fmt: skip


def ulg_of(data: bytes) -> bytes:
    """The .ulg that an input stands for."""
    take = _Choices(data)
    log = b"ULog\x01\x12\x35\x01" + take.take(3) + bytes(5)

    def entry(kind: bytes, content: bytes) -> bytes:
        return struct.pack("<HB", len(content) & 0xFFFF, kind[0]) + content[:0xFFFF]

    while take:
        kind = take.byte() % 16
        if kind < 7:
            fields = ["uint64_t timestamp"] * (take.byte() % 4 > 0)
            for _ in range(take.byte() % 12):
                fields.append(
                    f"{_pick(take, _ULOG_TYPES)}{_pick(take, _COUNTS)} {_pick(take, _ULOG_NAMES)}"
                )
            fields *= 300 if take.byte() % 40 == 0 else 1
            piece = entry(b"F", f"{_pick(take, _TOPICS)}:{';'.join(fields)};".encode())
        elif kind < 10:
            number = struct.pack("<BH", take.byte() % 20, take.byte() % 8)
            piece = entry(b"A", number + _pick(take, _TOPICS).encode())
        elif kind < 13:
            size = (0, 6, 8, 12, 32, 72, 600, 60_000)[take.byte() % 8]
            piece = entry(b"D", struct.pack("<H", take.byte() % 8) + bytes(size))
        elif kind == 13:
            key = f"{_pick(take, ('float', 'int32_t', 'char[4]', ''))} P{take.byte()}".encode()
            piece = entry(b"P", bytes([len(key)]) + key + take.take(4))
        elif kind == 14:
            letter = b"OSIMQRLCBZ"[take.byte() % 10 :][:1]
            piece = entry(letter, take.take(take.byte() % 12))
        else:
            piece = take.take(1 + take.byte() % 12)
        log += _flood(take, piece)
    return log


def check_ulg_definitions(data: bytes) -> None:
    """A PX4 log with any definitions is read or refused within its bar."""
    _check(ulg_of(data), _ulg, read_ulog)


_ENTRY_NAMES = ("IMU", "ATT", "RCOU", "ESC", "PARM", "EV", "MODE", "RPM", "XKF1", "XKF4", "a", "")
_COLUMNS = ("TimeUS", "GyrX", "I", "C1", "Instance", "RPM", "Name", "Value", "PI", "Id", "", "T,")
_LETTERS = "aBbhHiIqQfdgnNZMcCeELx?"


def bin_of(data: bytes) -> bytes:
    """The .bin that an input stands for."""
    take = _Choices(data)
    log = b"\xa3\x95\x80" + struct.pack(
        "<BB4s16s64s", 128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns"
    )
    sizes = {"a": 64, "b": 1, "B": 1, "h": 2, "H": 2, "i": 4, "I": 4, "q": 8, "Q": 8, "f": 4,
             "d": 8, "g": 2, "n": 4, "N": 16, "Z": 64, "M": 1, "c": 2, "C": 2, "e": 4, "E": 4,
             "L": 4}  # fmt: skip
    known = [(128, 89)]
    while take:
        kind = take.byte() % 8
        if kind < 4:
            letters = "".join(_pick(take, _LETTERS) for _ in range(take.byte() % 17))
            columns = ",".join(_pick(take, _COLUMNS) for _ in letters)
            size = 3 + sum(sizes.get(letter, 1) for letter in letters)
            size = size if take.byte() % 5 else take.byte()
            number = take.byte() % 12 if take.byte() % 9 else 128
            known.append((number, size))
            piece = b"\xa3\x95\x80" + struct.pack(
                "<BB4s16s64s", number, size & 0xFF, _pick(take, _ENTRY_NAMES).encode(),
                letters.encode(), columns.encode(),
            )  # fmt: skip
        elif kind < 7:
            number, size = known[take.byte() % len(known)]
            body = take.take(8) * (size // 8 + 1)
            piece = b"\xa3\x95" + bytes([number]) + body[: max(size - 3, 0)]
        else:
            piece = take.take(1 + take.byte() % 6)
        log += _flood(take, piece)
    return log


def check_bin_definitions(data: bytes) -> None:
    """An ArduPilot log with any definitions is read or refused within its bar."""
    _check(bin_of(data), _bin, read_dataflash)


_HEADER_NAMES = (
    "loopIteration", "time", "gyroADC[0]", "gyroADC[1]", "gyroADC[2]", "motor[0]", "motor[1]",
    "eRPM[0]", "accSmooth[0]", "vbatLatest", "x", "",
)  # fmt: skip
_SETTINGS = (
    "I interval", "P interval", "gyro_scale", "acc_1G", "minthrottle", "motorOutput", "vbatref",
    "motor_poles", "Data version", "looptime", "Field I signed", "Field P predictor",
)  # fmt: skip
_SET_TO = (
    "0", "1", "-1", "32", "1/2", "1/32768", "0/0", "1e308", "1e-308", "nan", "0x3f800000",
    "32768", "2147483648", "9" * 4000, "1,2,3", "1," * 4000, "",
)  # fmt: skip


def bbl_of(data: bytes) -> bytes:
    """The .bbl that an input stands for."""
    take = _Choices(data)
    log = BLACKBOX_HEAD + b"\n"
    while take:
        kind = take.byte() % 8
        if kind < 2:
            count = take.byte() % 24
            names = ["loopIteration", "time"][: take.byte() % 4]
            names += [_pick(take, _HEADER_NAMES) for _ in range(count)]
            if take.byte() % 4 == 0:
                names += [f"f{i}" for i in range(600 if take.byte() % 3 == 0 else 100)]
            letter = _pick(take, "IIIPPSGHX")
            lists = {"name": names, "signed": [str(take.byte() % 2) for _ in names]}
            lists["predictor"] = [_pick(take, ("0", "0", "1", "2", "6", "5", "11")) for _ in names]
            lists["encoding"] = [_pick(take, ("0", "1", "3", "6", "7", "8", "9")) for _ in names]
            piece = b"".join(
                f"H Field {letter} {what}:{','.join(words)}\n".encode()
                for what, words in lists.items()
            )
        elif kind < 5:
            line = f"H {_pick(take, _SETTINGS)}:{_pick(take, _SET_TO)}"
            piece = line.encode() + (b"\n", b"\r\n", b"", b"\x01\n")[take.byte() % 4]
        elif kind < 7:
            piece = b"IPSGHE"[take.byte() % 6 :][:1] + take.take(take.byte() % 24)
        else:
            piece = BLACKBOX_HEAD + b"\n" if take.byte() % 2 else take.take(5)
        log += _flood(take, piece)
    return log


def check_bbl_definitions(data: bytes) -> None:
    """A blackbox log with any header is read or refused within its bar."""
    _check(bbl_of(data), _bbl, read_blackbox)


_PARTED = b"\n%\n"
"""Between a mapping and its table."""
_MAPPING = """time = "t"
time_unit = "ms"
frame = "FLU"
world = "ENU"
gyro = { columns = ["p", "q", "r"], unit = "deg/s" }
force = ["ax", "ay", "az"]
attitude = { columns = ["qx", "qy", "qz", "qw"], order = "xyzw", inverse = true }
velocity = { columns = ["vx", "vy", "vz"], time = "tv" }
position = ["x", "y", "z"]
speeds = { columns = ["a", "b", "c", "d"], unit = "rpm" }
commands = { columns = ["ua", "ub", "uc", "ud"], min = 1000, max = 2000 }
in_air = "up"
parameters = { THR_MDL_FAC = 0.3 }
"""
_SMALL = 'time = "t"\ngyro = ["p", "q", "r"]\nspeeds = ["a", "b", "c", "d"]\n'


def check_table(data: bytes) -> None:
    """A table is read by its mapping, or either is refused, within the bar."""
    mapping, _, table = data.partition(_PARTED)
    path, mapping_path = _csv.put(table), _mapping.put(mapping)
    with bounded(len(data)), one_line_errors():
        check_recording(read_table(path, mapping_path))


def table_seeds() -> list[bytes]:
    """Mappings with tables that fit them: a full one, with gaps, by semicolon; and a small one."""
    rng = Random(2)
    names = [
        "t", "tv", "p", "q", "r", "ax", "ay", "az", "qx", "qy", "qz", "qw", "vx", "vy", "vz",
        "x", "y", "z", "a", "b", "c", "d", "ua", "ub", "uc", "ud", "up",
    ]  # fmt: skip
    rows = [
        ["" if rng.random() < 0.05 else f"{rng.uniform(-1.0, 1.0):.4g}" for _ in names[2:]]
        for _ in range(8)
    ]
    lines = [",".join([str(4 * i), str(4 * i + 1), *row]) for i, row in enumerate(rows)]
    full = "\n".join([",".join(names), *lines, ""])
    small = "t,p,q,r,a,b,c,d\n" + "".join(f"{0.01 * i},0,1,0.5,1e3,9,9,9\n" for i in range(9))
    return [
        mapping.encode() + _PARTED + table.encode()
        for mapping, table in (
            (_MAPPING, full),
            (_MAPPING, full.replace(",", ";")),
            (_SMALL, small),
            (_SMALL, "\ufeff" + small.replace("\n", "\r\n")),
            (_SMALL, small.replace("0.5", "true").replace("9,9", '"9","9"')),
        )
    ]


def choices() -> list[bytes]:
    """Inputs to begin with: many, as what is drawn near a few would nearly be the same logs."""
    rng = Random(1)
    return [rng.randbytes(rng.randrange(20, 400)) for _ in range(_BEGINNINGS)]
