"""Readers of recordings take whatever they find."""

import pytest

from gcs_sysid.telemetry.tlog import TlogReader
from tests.telemetry.in_memory import as_bytes

START = 1_750_000_000_000_000


@pytest.fixture
def flight(stream):
    return [(START + 4000 * i, frame) for i, frame in enumerate(stream[1])]


def test_a_truncated_last_record_is_left_out(tmp_path, flight):
    data = as_bytes(flight)
    path = tmp_path / "cut.tlog"
    for cut in range(1, len(flight[-1][1].raw) + 8):
        path.write_bytes(data[:-cut])
        reader = TlogReader(path)
        assert list(reader) == flight[:-1]
        assert reader.counts.cut_short == 8 + len(flight[-1][1].raw) - cut


def test_what_is_no_record_is_not_taken_for_one_cut_short(tmp_path, flight):
    path = tmp_path / "whole.tlog"
    for after in (b"", bytes(9), bytes(8) + b"\xfd\x09\x02", bytes(8) + b"\xfe\x00" + bytes(9)):
        path.write_bytes(as_bytes(flight) + after)
        reader = TlogReader(path)
        assert list(reader) == flight
        assert reader.counts.cut_short == 0
