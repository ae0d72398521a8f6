"""Readers of recordings take whatever they find."""

import random
import struct

import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.telemetry import tlog
from gcs_sysid.telemetry.frames import Validity
from gcs_sysid.telemetry.tlog import TlogReader, read_tlog

START = 1_750_000_000_000_000


@pytest.fixture
def flight(stream):
    return [(START + 4000 * i, frame) for i, frame in enumerate(stream[1])]


def as_bytes(records):
    return b"".join(struct.pack(">Q", t) + frame.raw for t, frame in records)


def test_a_truncated_last_record_is_left_out(tmp_path, flight):
    data = as_bytes(flight)
    path = tmp_path / "cut.tlog"
    for cut in range(1, len(flight[-1][1].raw) + 8):
        path.write_bytes(data[:-cut])
        reader = read_tlog(path)
        assert list(reader) == flight[:-1]
        assert reader.counts.cut_short == 8 + len(flight[-1][1].raw) - cut


def test_what_is_no_record_is_not_taken_for_one_cut_short(tmp_path, flight):
    path = tmp_path / "whole.tlog"
    for after in (b"", bytes(9), bytes(8) + b"\xfd\x09\x02", bytes(8) + b"\xfe\x00" + bytes(9)):
        path.write_bytes(as_bytes(flight) + after)
        reader = read_tlog(path)
        assert list(reader) == flight
        assert reader.counts.cut_short == 0


@pytest.mark.parametrize("seed", range(100))
def test_a_corrupted_log_gives_no_wrong_frame_and_goes_on(tmp_path, flight, seed):
    rng = random.Random(seed)
    data = bytearray(as_bytes(flight))
    for _ in range(5):
        at = rng.randrange(len(data))
        match rng.randrange(3):
            case 0:
                data[at] ^= 1 << rng.randrange(8)
            case 1:
                del data[at : at + rng.randrange(1, 40)]
            case _:
                data[at:at] = rng.randbytes(rng.randrange(1, 40))
    path = tmp_path / "hurt.tlog"
    path.write_bytes(data)
    good = [frame for _, frame in read_tlog(path) if frame.valid is Validity.OK]
    assert set(good) <= {frame for _, frame in flight}
    assert len(good) >= len(flight) - 12


def test_frames_with_a_changed_definition_keep_the_chain(tmp_path, flight):
    frame = flight[5][1]
    changed = frame._replace(raw=frame.raw[:-1] + bytes([frame.raw[-1] ^ 1]))
    path = tmp_path / "changed.tlog"
    path.write_bytes(as_bytes([*flight[:5], (flight[5][0], changed), *flight[6:]]))
    reader = read_tlog(path)
    records = list(reader)
    assert len(records) == len(flight)
    assert reader.counts.bad_crc == 1
    assert reader.counts.garbage_bytes == 0


def test_windows_do_not_change_what_is_read(tmp_path, flight, monkeypatch):
    data = bytearray(as_bytes(flight * 3))
    data[5000:5000] = bytes(random.Random(2).randbytes(2500))
    path = tmp_path / "long.tlog"
    path.write_bytes(data)
    whole = list(read_tlog(path))
    monkeypatch.setattr(tlog, "WINDOW", 1000)
    assert list(read_tlog(path)) == whole
    assert len(whole) > 100


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (b"not a log at all\n" * 500, "is not a .tlog"),
        (b"ULog\x01\x12\x35\x01" + bytes(range(256)) * 300, "is not a .tlog"),
        (bytes(100_000), "is not a .tlog"),
    ],
    ids=["empty", "text", "ulog", "zeros"],
)
def test_a_file_that_is_no_tlog_gives_one_line(tmp_path, content, says):
    path = tmp_path / "some.tlog"
    path.write_bytes(content)
    with pytest.raises(InputError, match=says) as caught:
        TlogReader(path)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_folder_give_one_line(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        read_tlog(tmp_path / "missing.tlog")
    with pytest.raises(InputError, match="is a folder"):
        read_tlog(tmp_path)


def test_random_files_are_never_taken_for_a_log(tmp_path):
    rng = random.Random(11)
    path = tmp_path / "noise.tlog"
    for _ in range(5):
        path.write_bytes(rng.randbytes(50_000))
        with pytest.raises(InputError):
            read_tlog(path)
