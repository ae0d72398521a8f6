"""Checksums of many frames at once, against those taken one by one."""

import numpy as np
import pytest
from fastcrc import crc16

from gcs_sysid.telemetry import frame_block as module
from gcs_sysid.telemetry.frame_block import checksums, checksums_agree, rows_of


@pytest.mark.parametrize("rows_at_once", [7, 8192])
def test_pieces_of_every_length_have_the_checksums_of_the_protocol(monkeypatch, rows_at_once):
    monkeypatch.setattr(module, "ROWS_AT_ONCE", rows_at_once)
    random = np.random.default_rng(5)
    data = random.integers(0, 256, 5000, dtype=np.uint8)
    length = np.concatenate([np.arange(300), random.integers(0, 300, 700)])
    at = random.integers(0, len(data) - 300, len(length))
    extra = random.integers(0, 256, len(length), dtype=np.uint8)
    pieces = [data[a : a + n].tobytes() for a, n in zip(at, length, strict=True)]
    expected = [crc16.mcrf4xx(p + bytes([e])) for p, e in zip(pieces, extra, strict=True)]
    assert checksums(data, at, length, extra).tolist() == expected


def test_checksums_behind_overlapping_pieces_are_recognized():
    random = np.random.default_rng(6)
    data = random.integers(0, 256, 3000, dtype=np.uint8)
    at = np.arange(len(data) - 280)
    length = random.integers(0, 270, len(at))
    extra = random.integers(0, 256, len(at), dtype=np.uint8)
    for first in range(0, 2500, 300):  # no other piece writes what these cover
        end = first + length[first]
        piece = data[first:end].tobytes() + bytes([extra[first]])
        data[end : end + 2] = np.frombuffer(crc16.mcrf4xx(piece).to_bytes(2, "little"), np.uint8)
    expected = [
        crc16.mcrf4xx(data[a : a + n].tobytes() + bytes([e]))
        == int(data[a + n : a + n + 2].view("<u2")[0])
        for a, n, e in zip(at, length, extra, strict=True)
    ]
    assert sum(expected) >= 8
    assert checksums_agree(data, at, length, extra).tolist() == expected


def test_no_pieces_have_no_checksums():
    none = np.empty(0, int)
    data = np.zeros(10, np.uint8)
    assert len(checksums(data, none, none, none.astype(np.uint8))) == 0
    assert rows_of(data, none, 4).shape == (0, 4)
    assert rows_of(data, np.array([6, 0]), 4).shape == (2, 4)
