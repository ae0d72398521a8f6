"""Files made to harm, patterns of garbage, and what reading a log costs."""

import functools
import json
import struct
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.logs import open_log
from testbed.blackbox_log import MAGIC

HEAD = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000)
TOP = "sensor_combined:uint64_t timestamp;"


def ulg_entry(kind: str, content: bytes) -> bytes:
    """An entry of a .ulg."""
    return struct.pack("<HB", len(content), ord(kind)) + content


def formats(*texts: str) -> bytes:
    """The beginning of a .ulg with these formats."""
    return HEAD + b"".join(ulg_entry("F", text.encode()) for text in texts)


def subscribed(*names: str) -> bytes:
    """Entries that subscribe topics."""
    return b"".join(
        ulg_entry("A", struct.pack("<BH", 0, number) + name.encode())
        for number, name in enumerate(names)
    )


def _nested(depth: int, count: int, leaf: str = "uint8_t x;") -> list[str]:
    return [*(f"n{i}:n{i + 1}[{count}] a;" for i in range(depth)), f"n{depth}:{leaf}"]


ULG: dict[str, Callable[[], bytes]] = {
    "arrays of arrays": lambda: formats(*_nested(8, 9), TOP + "n0[99] x;"),
    "arrays of arrays of nothing": lambda: formats(
        *_nested(6, 65535, "uint8_t[0] x;"), TOP + "n0[65535] x;"
    ),
    "no fields": lambda: formats("z:;", *_nested(6, 65535, "z x;"), TOP + "n0[65535] x;"),
    "itself": lambda: formats(TOP + "sensor_combined x;"),
    "each other": lambda: formats("a:b x;", "b:a[2] y;", TOP + "a x;"),
    "a chain": lambda: formats(
        *(f"d{i}:d{i + 1} a;" for i in range(3000)), "d3000:float x;", TOP + "d0 x;"
    ),
    "a tree": lambda: formats(
        *(f"d{i}:d{i + 1} a;d{i + 1} b;" for i in range(60)), "d60:bool x;", TOP + "d0 x;"
    ),
    "a long array": lambda: formats(TOP + "float[65535] x;"),
    "a count without end": lambda: formats(TOP + f"float[{'9' * 4000}] x;"),
    "many columns": lambda: formats(TOP + "uint8_t[65000] x;"),
    "many fields": lambda: formats(TOP + "float x;" * 7000),
    "many formats": lambda: formats(*(f"f{i}:float x;" for i in range(40_000)), TOP + "float x;"),
}
"""Formats of .ulg that nothing should be allocated for."""


def _read_from(make: Callable[[], bytes]) -> bytes:
    """A log whose formats are needed."""
    return make() + subscribed(*["sensor_combined"] * 50)


def _fmt(number: int, size: int, name: bytes, letters: bytes, columns: bytes) -> bytes:
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", number, size & 0xFF, name, letters, columns)


def _bbl(*lines: str) -> bytes:
    return MAGIC + b"".join(f"H {line}\n".encode() for line in lines)


def _fields(letter: str, count: int) -> list[str]:
    names = ["loopIteration", "time", *(f"f{i}" for i in range(count - 2))]
    zeros = ",".join("0" * count)
    lists = {"name": ",".join(names), "signed": zeros, "predictor": zeros, "encoding": zeros}
    return [f"Field {letter} {what}:{text}" for what, text in lists.items()]


_SMALL = _fields("I", 3) + _fields("P", 3)
_ROTOR = b'[[rotor]]\nx = 0.2\ny = 0.2\nspin = "cw"\n'


def _record(kind: int, content: bytes, times: int = 1) -> bytes:
    return (struct.pack("<BQ", kind, len(content)) + content) * times


def _mcap(definition: str, message: bytes, times: int = 50) -> bytes:
    """An MCAP file of one message, again and again, of a topic of PX4's."""
    texts = [b"px4_msgs/msg/SensorCombined", b"ros2msg", definition.encode()]
    named = b"".join(struct.pack("<I", len(text)) + text for text in texts)
    topic = struct.pack("<HHI", 1, 1, 24) + b"/fmu/out/sensor_combined\3\0\0\0cdr\0\0\0\0"
    return (
        b"\x89MCAP0\r\n" + _record(3, b"\1\0" + named) + _record(4, topic)
        + _record(5, struct.pack("<HIQQ", 1, 0, 0, 0) + b"\0\1\0\0" + message, times)
    )  # fmt: skip


def _mcap_bomb() -> bytes:
    """Chunks of 16 MB of zeros in 500 bytes: a zstd frame of blocks of a repeated byte."""
    blocks = [struct.pack("<I", (2**17 << 3) | 2 | (i == 127))[:3] + b"\0" for i in range(128)]
    frame = b"\x28\xb5\x2f\xfd\x00\x38" + b"".join(blocks)
    head = struct.pack("<QQQII", 0, 0, 2**24, 0, 4) + b"zstd" + struct.pack("<Q", len(frame))
    return b"\x89MCAP0\r\n" + _record(6, head + frame, 100)


FILES: dict[tuple[str, str], Callable[[], bytes]] = {
    **{(".ulg", name): functools.partial(_read_from, make) for name, make in ULG.items()},
    (".ulg", "00 00 5a after definitions"): lambda: (
        formats(TOP + "float x;") + subscribed("sensor_combined") + b"\0\0\x5a" * 400_000
    ),
    (".ulg", "20 000 subscriptions"): lambda: (
        formats(TOP + "float x;") + subscribed(*["sensor_combined"] * 20_000)
    ),
    (".bin", "FMT of every length"): lambda: b"".join(
        _fmt(i % 256, i // 256, b"IMU", b"QBffffff", b"TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
        for i in range(65_536)
    ),
    (".bin", "FMT that describes FMT anew"): lambda: (
        _fmt(128, 3, b"FMT", b"", b"") * 20_000 + b"\xa3\x95\x80" * 300_000
    ),
    (".bin", "FMT of no bytes, then its entries"): lambda: (
        _fmt(7, 3, b"IMU", b"", b"TimeUS,GyrX") * 20_000 + b"\xa3\x95\x07" * 300_000
    ),
    (".bin", "FMT with unknown letters"): lambda: (
        _fmt(9, 255, b"IMU", b"\xff" * 16, b"," * 64) * 10_000
    ),
    (".tlog", "FD, 20 MB"): lambda: b"\xfd" * 20_000_000,
    (".tlog", "FE, 20 MB"): lambda: b"\xfe" * 20_000_000,
    (".bbl", "4000 fields"): lambda: _bbl(*_fields("I", 4000), *_fields("P", 4000)) + b"I" * 10**6,
    (".bbl", "a name of 1 MB"): lambda: _bbl(f"Field I name:{'a' * 10**6}"),
    (".bbl", "a header without an end"): lambda: MAGIC + b"\n" + (b"H a:" * 4000 + b"\x01\n") * 60,
    (".bbl", "I interval of 4000 digits"): lambda: (
        _bbl(*_SMALL, f"I interval:{'9' * 4000}") + b"I\0\0\0" * 10_000
    ),
    (".bbl", "P interval of 1/0"): lambda: _bbl(*_SMALL, "P interval:1/0") + b"I\0\0\0" * 10_000,
    (".bbl", "100 000 sessions"): lambda: MAGIC * 100_000,
    (".bbl", "no motors, E in between"): lambda: (
        _bbl(*_SMALL) + (b"I\0\0\0P\0\0\0E\x0e\xff\xff\xff\xff\x0f\0") * 60_000
    ),
    (".mcap", "a record of 2^64 - 1 bytes"): lambda: b"\x89MCAP0\r\n\x05" + b"\xff" * 10**6,
    (".mcap", "a type in itself"): lambda: _mcap("px4_msgs/SensorCombined[9] x", bytes(100)),
    (".mcap", "sequences of nothing"): lambda: _mcap(
        "Empty[] x\n===\nMSG: px4_msgs/Empty\n", b"\xff" * 100_000
    ),
    (".mcap", "60 000 columns"): lambda: _mcap("uint8[60000] gyro_rad", bytes(60_000)),
    (".mcap", "chunks of 16 MB in 500 bytes"): _mcap_bomb,
    (".toml", "brackets, 1 MB"): lambda: b"a = " + b"[" * 10**6,
    (".toml", "a dotted key of 20 000 parts"): lambda: ".".join("a" * 20_000).encode() + b" = 1",
    (".toml", "a mass of 10 000 digits"): lambda: b"mass = " + b"9" * 10_000 + b"\n" + _ROTOR * 4,
    (".toml", "20 000 rotors"): lambda: b"mass = 1.5\n" + _ROTOR * 20_000,
    (".toml", "30 MB of comment"): lambda: b"#" * 30_000_000,
    (".json", "brackets, 1 MB"): lambda: b"[" * 10**6,
    (".json", "objects in objects"): lambda: b'{"a":' * 200_000,
    (".json", "a number of 4 000 000 digits"): lambda: (
        b'{"schema": "gcs-sysid/1", "a": ' + b"9" * 4_000_000 + b"}"
    ),
    (".json", "a list of 2 000 000 numbers"): lambda: json.dumps(
        {"schema": "gcs-sysid/1", "events": [0] * 2_000_000}
    ).encode(),
    (".json", "100 MB of spaces"): lambda: b" " * 100_000_000,
}
"""(Suffix, what it is) -> a maker of the file."""


def _drawn(letters: bytes, size: int = 2**20) -> bytes:
    """So many letters by chance."""
    return np.random.default_rng(1).choice(np.frombuffer(letters, np.uint8), size).tobytes()


PATTERNS = {
    "FD": b"\xfd", "FE": b"\xfe", "FD 09 00 00": b"\xfd\x09\0\0", "FE 00": b"\xfe\0",
    "00": b"\0", "00 00 5A": b"\0\0\x5a", "D": b"D", "A3 95": b"\xa3\x95",
    "A3 95 80": b"\xa3\x95\x80", "A3 95 01": b"\xa3\x95\x01", "I": b"I", "P": b"P",
    "IE": b"IE", "H ": b"H ", "S": b"S", "PPE": b"PPE", "IPSE": b"IPSE",
    "IPSE drawn": _drawn(b"IPSE"), "P I 80 0 drawn": _drawn(b"PI\x80\0"),
    "IPGHSE drawn": _drawn(b"IPGHSE"), "I P drawn": _drawn(b"IP"), "S E drawn": _drawn(b"SE"),
    "S 0 drawn": _drawn(b"S\0"), "S S 80 drawn": _drawn(b"SS\x80"),
    "P FF drawn": _drawn(b"P\xff"), "P 5x80 drawn": _drawn(b"P\x80\x80\x80\x80\x80"),
    "I P 80 to FF": _drawn(b"IP\x80\x81\xfe\xff"), "E FF drawn": _drawn(b"E\xff"),
    "E events": _drawn(b"EEEEE\x0e\x0e\x0d\x0d\x1e\x1e"),
    **{f"IPSE of {period}": _drawn(b"IPSE", period) for period in (13, 345, 839, 841, 3001)},
}  # fmt: skip


def measure(path: Path, content: bytes) -> tuple[float, int]:
    """Processor time in s, and IMU samples, of a log."""
    path.write_bytes(content)
    began = time.process_time()
    blocks = list(open_log(path).blocks())
    spent = time.process_time() - began
    tracks = [track for block in blocks for track in block.tracks]
    return spent, sum(len(track.t) for track in tracks if track.stream is Stream.IMU)
