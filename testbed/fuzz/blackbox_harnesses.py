"""Harnesses of blackbox logs: whole files, bodies behind a header, sessions by the grammar.

What is read is held against a plain reader, frame by frame.
"""

import functools
import math
from itertools import pairwise

from gcs_sysid.telemetry.blackbox import read_blackbox
from gcs_sysid.telemetry.blackbox_format import Header, read_header, session_starts
from gcs_sysid.telemetry.blackbox_frames import read_frames
from gcs_sysid.telemetry.log_formats import BLACKBOX_HEAD
from testbed import blackbox_log as bbl
from testbed.fuzz.blackbox_reference import PlainReader
from testbed.fuzz.file_harnesses import check_recording
from testbed.fuzz.harness import Bytes, Scratch, one_line_errors

_bbl = Scratch(".bbl")


def check_bbl(data: bytes) -> None:
    """A blackbox log is read or refused; what is read is what a plain reader reads."""
    path = _bbl.put(data)
    with one_line_errors():
        starts = session_starts(data)
        for number, (start, stop) in enumerate(pairwise(starts), 1):
            check_frames_of_bbl(data, read_header(data, start, stop), stop)
            recording = read_blackbox(path, number)
            check_recording(recording)
            assert 0 <= recording.garbage_bytes <= len(data)
    if data.count(BLACKBOX_HEAD) != 1:
        with one_line_errors():
            check_recording(read_blackbox(path))


def check_frames_of_bbl(data: bytes, header: Header, stop: int) -> None:
    """The frames of a session are those that a plain reader reads."""
    frames = read_frames(data, header, stop)
    plain = PlainReader(data, header, stop).read()
    assert frames.main.values.tolist() == plain.main, "main frames"
    assert frames.time_us.tolist() == plain.time_us, "times"
    assert frames.slow.values.tolist() == plain.slow, "slow frames"
    assert frames.damaged == plain.damaged, "damaged frames"


@functools.cache
def _bbl_headers() -> tuple[tuple[bytes, Header], ...]:
    """Headers for frames alone: those of the logs to begin with, and small ones."""
    one = bbl.Field("a", 1, bbl.MINTHROTTLE, bbl.SIGNED_VB, bbl.AVERAGE_2)
    motors = (bbl.Field("motor[0]", 0), bbl.Field("b", 1, bbl.MOTOR_0, bbl.NEG_14BIT))
    whole = [log[: read_header(log, 0, len(log)).data] for log in bbl_seeds()[:4]]
    small = [
        bbl.BlackboxWriter([*bbl.CLOCK, *fields], others, {"minthrottle": 1000}, interval).data
        for fields, others, interval in (
            ((), {}, 1), ((one,), {}, 2), (motors, {}, 4), ((one,), {"S": bbl.SLOW[:2]}, 32),
            ((one,), {"H": bbl.HOME, "G": bbl.GPS}, 4),
        )
    ]  # fmt: skip
    return tuple((text, read_header(text, 0, len(text))) for text in (*whole, *small))


def check_bbl_bodies(data: bytes) -> None:
    """Bytes behind a header, which the first one chooses, are read or refused."""
    text, header = _bbl_headers()[data[0] % len(_bbl_headers()) if data else 0]
    log = text + data
    with one_line_errors():
        check_frames_of_bbl(log, header, len(log))


_BLOCKS = {
    bbl.SIGNED_VB: 1, bbl.UNSIGNED_VB: 1, bbl.NEG_14BIT: 1, bbl.TAG8_8SVB: 1, bbl.TAG2_3S32: 3,
    bbl.TAG8_4S16: 4, bbl.TAG2_3SVARIABLE: 3,
}  # fmt: skip
"""Encoding -> fields that one block of it always holds."""
_WIDE = {bbl.SIGNED_VB, bbl.TAG8_8SVB, bbl.TAG2_3S32, bbl.TAG2_3SVARIABLE}
"""Encodings of 32 bits."""
_ANYWHERE = (bbl.ZERO, bbl.MINTHROTTLE, bbl.FIXED_1500, bbl.VBATREF, bbl.MINMOTOR)
_BEFORE = (bbl.ZERO, bbl.PREVIOUS, bbl.STRAIGHT_LINE, bbl.AVERAGE_2)


def _bbl_fields(take: Bytes) -> tuple[list[bbl.Field], list[int]]:
    """Fields of main frames beside the clock, and how large their values may be."""
    fields: list[bbl.Field] = []
    sizes: list[int] = []
    for _ in range(take.byte() % 6):
        encoding, later = (list(_BLOCKS)[take.byte() % len(_BLOCKS)] for _ in range(2))
        positive = bbl.UNSIGNED_VB in (encoding, later)
        size = (3, 100, 2000, 500_000)[take.byte() % (4 if {encoding, later} <= _WIDE else 3)]
        # Whole blocks in both kinds of frames.
        for _ in range(math.lcm(_BLOCKS[encoding], _BLOCKS[later]) * (1 + take.byte() % 3)):
            before, after = take.byte(), take.byte()
            predictor = bbl.ZERO if positive else _ANYWHERE[before % len(_ANYWHERE)]
            fits = encoding in _WIDE or (fields and sizes[0] <= 2000)
            if not positive and fields and fits and before > 200:
                predictor = bbl.MOTOR_0
            p_predictor = bbl.ZERO if positive else _BEFORE[after % len(_BEFORE)]
            name = f"f{len(fields)}" if fields else "motor[0]"
            signed = int(not positive)
            fields.append(bbl.Field(name, signed, predictor, encoding, p_predictor, later))
            sizes.append(size)
    return fields, sizes


def bbl_session(data: bytes) -> tuple[bytes, list[list[int]], bool]:
    """A log by the grammar of the format, its main frames, and whether it was left intact."""
    take = Bytes(data)
    fields, sizes = _bbl_fields(take)
    settings = {"minthrottle": 1000 + take.byte(), "motorOutput": "48,2047", "vbatref": 1600}
    interval = (1, 2, 4, 32)[take.byte() % 4]
    others = {"S": bbl.SLOW, "G": bbl.GPS, "H": bbl.HOME}
    writer = bbl.BlackboxWriter(
        [*bbl.CLOCK, *fields], others, settings, interval, version=1 + take.byte() % 2
    )
    written: list[list[int]] = []
    time, intact = 1000, True
    while take and len(written) < 400:
        loop, kind = len(written), take.byte()
        time += 900 + take.byte()
        drawn = [int.from_bytes(take.take(3), "little") % (2 * n + 1) - n for n in sizes]
        values = [v if f.signed else abs(v) for f, v in zip(fields, drawn, strict=True)]
        row = [loop, time, *values]
        (writer.inter if loop % interval else writer.intra)(row)
        written.append(row)
        if kind < 24:
            writer.other("S", [kind, 1, kind % 3, 1, 0])
        elif kind < 48:
            writer.other("H", [500 * kind, -700])
            writer.other("G", [time, 9, 500 * kind + take.byte(), -690])
        elif kind < 60:
            writer.event(30, bytes([kind, 1]))
        elif kind < 68:
            intact = False
            writer.data = writer.data[: -1 - take.byte() % 9] + take.take(kind - 60)
    return writer.data + bbl.END, written, intact


def check_bbl_frames(data: bytes) -> None:
    """What the grammar writes is read as written; where damaged, as a plain reader does."""
    log, written, intact = bbl_session(data)
    check_bbl(log)
    if intact and written:
        found = read_frames(log, read_header(log, 0, len(log)), len(log)).main.values.tolist()
        assert found == written, "not what was written"


def bbl_seeds() -> list[bytes]:
    """Logs with every field that is read, of every encoding, and two sessions in a file."""
    vectors = ("gyroADC", "accSmooth", "imuQuaternion", "navPos", "navVel", "setpoint")
    flown = [bbl.Field(f"{name}[{i}]", p_predictor=3) for name in vectors for i in range(3)]
    rotors = [
        bbl.Field("motor[0]", 0, bbl.MINMOTOR, bbl.UNSIGNED_VB, bbl.AVERAGE_2),
        *(bbl.Field(f"motor[{i}]", 0, bbl.MOTOR_0, p_predictor=bbl.AVERAGE_2) for i in (1, 2, 3)),
        *(bbl.Field(f"eRPM[{i}]", 0, 0, bbl.UNSIGNED_VB, 1, bbl.TAG8_8SVB) for i in range(4)),
        bbl.Field("vbatLatest", 0, bbl.VBATREF, bbl.NEG_14BIT, 1, bbl.TAG8_8SVB),
    ]
    packed = [
        *(bbl.Field(f"a[{i}]", 1, 0, bbl.TAG8_4S16, 1, bbl.TAG8_4S16) for i in range(4)),
        *(bbl.Field(f"b[{i}]", 1, 0, bbl.TAG2_3S32, 1, bbl.TAG2_3S32) for i in range(3)),
        *(bbl.Field(f"c[{i}]", 1, 8, bbl.TAG2_3SVARIABLE, 1, 10) for i in range(3)),
        bbl.Field("d", 1, bbl.MINTHROTTLE, bbl.SIGNED_VB, bbl.PREVIOUS, bbl.NULL),
    ]
    settings = {"gyro_scale": bbl.float_bits(1.0), "acc_1G": 2048, "minthrottle": 1070,
                "motorOutput": "158,2047", "motor_poles": 14, "vbatref": 1680}  # fmt: skip
    logs = []
    for fields, version in ((flown + rotors, 2), (packed, 2), (packed, 1), ([], 2)):
        others = {"S": bbl.SLOW, "G": bbl.GPS, "H": bbl.HOME} if fields else {"S": bbl.SLOW}
        writer = bbl.BlackboxWriter([*bbl.CLOCK, *fields], others, settings, 4, version=version)
        for loop in range(9):
            values = [loop, 1000 * loop, *((i * loop) % 23 - 9 for i in range(len(fields)))]
            if fields and fields is packed:
                values[-1] = 5
            (writer.inter if loop % 4 else writer.intra)(values)
            if loop == 2:
                writer.other("S", [1, 2, 0, 1, 1])
            if loop == 4 and fields:
                writer.other("H", [500, -700])
                writer.other("G", [4001, 9, 510, -690])
            if loop == 6:
                writer.event(30, b"\1\2")
        writer.resume(400, 20_000_000)
        writer.intra([400, 20_000_000, *([5] * len(fields))])
        writer.event(15, b"\4")
        logs.append(writer.data + bbl.END)
    return [*logs, logs[1] + b"\xff" * 9 + logs[3], logs[0][:-40]]


def bbl_body_seeds() -> list[bytes]:
    """Pieces of frames behind each header, never the end, behind which nothing is read."""
    pieces = []
    for (text, _), log in zip(_bbl_headers(), bbl_seeds(), strict=False):
        pieces += [log[len(text) + at : -len(bbl.END)][:40] for at in (0, 60, 200)]
    frames = b"I\0\x64\x07P\x02\x01P\0\x03S\1\2H\4\5G\1\2\3\4E\x0e\4\x90\x4eI\4\x90\x4e\1"
    return [*(piece for piece in pieces if piece), frames]
