"""The scanner finds every good frame, never a wrong one, and never raises."""

import random
from itertools import pairwise

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import LONGEST_FRAME, FrameScanner, Validity, read_frame

FIXTURES = settings(
    deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def scan_all(data, cuts=()):
    scanner = FrameScanner()
    frames = []
    edges = [0, *sorted(cuts), len(data)]
    for start, stop in pairwise(edges):
        frames += scanner.feed(data[start:stop])
    frames += scanner.flush()
    return frames, scanner


def ok(frames):
    return [frame for frame in frames if frame.valid is Validity.OK]


def test_all_frames_are_found(stream):
    data, expected = stream
    frames, scanner = scan_all(data)
    assert frames == expected
    assert scanner.garbage_bytes == scanner.bad_crc == 0


@pytest.mark.slow
@FIXTURES
@given(cuts=st.lists(st.integers(0, 5000), max_size=200), seed=st.integers(0, 500))
def test_frames_do_not_depend_on_chunking(damage, stream, cuts, seed):
    data = damage(stream[0], random.Random(seed)) if seed else stream[0]
    whole, one = scan_all(data)
    pieces, many = scan_all(data, [cut for cut in cuts if cut < len(data)])
    assert pieces == whole
    assert (many.garbage_bytes, many.bad_crc) == (one.garbage_bytes, one.bad_crc)


@pytest.mark.parametrize("seed", range(200))
def test_damage_gives_no_wrong_frame_and_loses_only_what_it_hit(stream, seed):
    data, expected = stream
    rng = random.Random(seed)
    at = rng.randrange(len(data))
    hurt = bytearray(data)
    hurt[at] ^= 1 << rng.randrange(8)
    frames, scanner = scan_all(bytes(hurt))
    good = ok(frames)
    assert set(good) <= set(expected)
    assert len(good) >= len(expected) - 1
    assert sum(len(frame.raw) for frame in frames) + scanner.garbage_bytes == len(data)


@FIXTURES
@given(data=st.binary(max_size=2000), datagrams=st.lists(st.binary(max_size=400), max_size=8))
def test_any_bytes_are_taken_without_error_and_without_holding_them(data, datagrams):
    scanner = FrameScanner()
    scanner.feed(data)
    assert len(scanner._rest) <= 2 * LONGEST_FRAME
    other = FrameScanner()
    for datagram in datagrams:
        other.scan(datagram)
        assert len(other._rest) <= LONGEST_FRAME


def test_a_changed_definition_is_reported_and_skipped(sender):
    before, after = sender.raw(heartbeat()), sender.raw(heartbeat())
    changed = bytearray(sender.raw(mavlink.MAVLink_sys_status_message(*range(13))))
    changed[-1] ^= 0x55
    frames, scanner = scan_all(before + changed + after)
    assert [frame.valid for frame in frames] == [Validity.OK, Validity.BAD_CRC, Validity.OK]
    assert scanner.bad_crc == 1
    assert scanner.garbage_bytes == 0


def test_a_wrong_length_does_not_hide_the_frames_behind_it(sender):
    raws = [sender.raw(heartbeat()) for _ in range(6)]
    hurt = bytearray(raws[1])
    # Longer by one whole frame: it ends exactly where another frame begins.
    hurt[1] += len(raws[2])
    frames, _ = scan_all(raws[0] + bytes(hurt) + b"".join(raws[2:]))
    assert [frame.raw for frame in ok(frames)] == [raws[0], *raws[2:]]


def test_unknown_types_are_skipped_by_length(sender):
    unknown = bytearray(sender.raw(heartbeat()))
    unknown[7:10] = (60_999).to_bytes(3, "little")
    frames, _ = scan_all(sender.raw(heartbeat()) + unknown + sender.raw(heartbeat()))
    assert [frame.valid for frame in frames] == [Validity.OK, Validity.UNKNOWN, Validity.OK]
    assert frames[1].message_id == 60_999


def test_a_frame_of_version_1_has_its_header(make_sender):
    sender = make_sender(7, 9)
    sender.packer.seq = 200
    frame = read_frame(sender.raw(heartbeat(), version=1))
    assert frame[:4] == (7, 9, 200, 0)
    assert (frame.version, frame.signed, len(frame.payload)) == (1, False, 9)


def test_a_garbage_datagram_does_not_desynchronise_the_next(stream):
    _, expected = stream
    rng = random.Random(1)
    scanner = FrameScanner()
    found = []
    for frame in expected:
        scanner.scan(rng.choice([b"\xfd\xff\x00", b"\xfe", rng.randbytes(50), b""]))
        found += ok(scanner.scan(frame.raw))
    assert found == expected


def test_a_frame_cut_in_two_datagrams_is_put_together(stream):
    data, expected = stream
    scanner = FrameScanner()
    frames = []
    for at in range(0, len(data), 37):
        frames += scanner.scan(data[at : at + 37])
    assert sum(len(frame.raw) for frame in frames) > 0.2 * len(data)
    assert set(ok(frames)) <= set(expected)


def heartbeat():
    return mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
