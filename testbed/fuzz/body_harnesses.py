"""Harnesses of what follows the definitions of a .ulg or .bin: many bodies to a read.

A reader takes as long for the definitions as for a kilobyte of entries. So each input is a few
entries, changed, and many of them make one log.
"""

import functools
from collections.abc import Iterator
from zlib import crc32

import numpy as np

from gcs_sysid.telemetry.dataflash import read_dataflash
from gcs_sysid.telemetry.track_collector import Recording
from gcs_sysid.telemetry.ulog import read_ulog
from testbed.fuzz.definition_harnesses import bounded
from testbed.fuzz.file_harnesses import bin_seeds, check_recording, ulg_seeds
from testbed.fuzz.harness import Scratch, one_line_errors

_ulg, _bin = Scratch(".ulg"), Scratch(".bin")
_ULG_HEAD, _FMT = 16, 0x80
_SYNC = b"\x08\x00S\x2f\x73\x13\x20\x25\x0c\xbb\x12"
_SMALL_WINDOW = 520
"""Bytes, at which a few entries at a time are decided."""


def _ulg_entries(log: bytes) -> Iterator[tuple[str, bytes]]:
    at = _ULG_HEAD
    while at < len(log):
        size = 3 + int.from_bytes(log[at : at + 2], "little")
        yield chr(log[at + 2]), log[at : at + size]
        at += size


def _bin_entries(log: bytes) -> Iterator[tuple[int, bytes]]:
    sizes, at = {_FMT: 89}, 0
    while at < len(log):
        size = sizes[log[at + 2]]
        if log[at + 2] == _FMT:
            sizes[log[at + 3]] = log[at + 4]
        yield log[at + 2], log[at : at + size]
        at += size


@functools.cache
def _ulg_heads() -> tuple[bytes, ...]:
    """With all subscriptions, with those of one topic, and with none."""
    heads = []
    for log, kinds in ((0, "FPA"), (1, "FPA"), (0, "F")):
        seed = ulg_seeds()[log]
        entries = (entry for kind, entry in _ulg_entries(seed) if kind in kinds)
        heads.append(seed[:_ULG_HEAD] + b"".join(entries))
    return tuple(heads)


@functools.cache
def _bin_heads() -> tuple[bytes, ...]:
    """With all definitions, with those of the IMU alone, and with none."""
    heads = []
    for log, most in ((0, 99), (1, 99), (0, 1)):
        defined = [entry for number, entry in _bin_entries(bin_seeds()[log]) if number == _FMT]
        heads.append(b"".join(defined[:most]))
    return tuple(heads)


def check_ulg_bodies(data: bytes) -> None:
    """Entries behind the definitions of a PX4 log, one of several, are read or refused."""
    heads = _ulg_heads()
    path = _ulg.put(heads[crc32(data) % len(heads)] + data)
    with bounded(len(data)), one_line_errors():
        check_recording(read_ulog(path))


def check_bin_bodies(data: bytes) -> None:
    """The same of an ArduPilot log, which is read alike in windows of any size."""
    heads = _bin_heads()
    path = _bin.put(heads[crc32(data) % len(heads)] + data)
    with bounded(len(data)), one_line_errors():
        recording = read_dataflash(path)
        check_recording(recording)
        assert 0 <= recording.garbage_bytes <= len(data)
        assert_alike(recording, read_dataflash(path, _SMALL_WINDOW))


def assert_alike(one: Recording, other: Recording) -> None:
    """Two readings of one log are the same."""
    for name in ("counts", "garbage_bytes", "dropped", "lost", "parameters", "vehicle_type"):
        assert getattr(one, name) == getattr(other, name), name
    assert len(one.tracks) == len(other.tracks), "tracks"
    for a, b in zip(one.tracks, other.tracks, strict=True):
        assert a.key == b.key, "tracks"
        assert np.array_equal(a.t, b.t), a.key
        assert np.array_equal(a.values, b.values, equal_nan=True), a.key


def ulg_body_seeds() -> list[bytes]:
    """Entries of each kind."""
    found = {entry for _, entry in _ulg_entries(ulg_seeds()[0])}
    return [*sorted(found), _SYNC, b"\x02\0O\x14\0"]


def bin_body_seeds() -> list[bytes]:
    """Entries of each type, and definitions."""
    return sorted({entry for _, entry in _bin_entries(bin_seeds()[0])})
