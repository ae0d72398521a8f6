"""From bytes to frames: what is lost and why, damaged times, changed definitions, memory."""

import random
import struct
import tracemalloc

import pytest

from gcs_sysid.telemetry.frames import Validity
from gcs_sysid.telemetry.tlog import ScanCounts, Scanner, TlogReader

START = 1_750_000_000_000_000
STEP = 4000


def times(count):
    return [START + STEP * i for i in range(count)]


def as_log(raws, stamps=None):
    stamps = times(len(raws)) if stamps is None else stamps
    return b"".join(struct.pack(">Q", t) + raw for t, raw in zip(stamps, raws, strict=True))


def scan(data, window=None):
    """All frames of some bytes, cut into windows: (times, validities, counts)."""
    scanner = Scanner()
    stamps, validities = [], []
    rest, at, final = b"", 0, False
    while not final:
        more = data[at : at + window] if window else data
        at += len(more)
        final = at >= len(data)
        block, done = scanner.scan(rest + more, final=final)
        rest = (rest + more)[done:]
        stamps += block.time_us.tolist()
        validities += block.validity.tolist()
    return stamps, validities, scanner.counts


@pytest.fixture
def raws(stream):
    return [frame.raw for frame in stream[1]]


def test_what_is_lost_is_counted_by_its_reason(raws):
    changed = raws[5][:-1] + bytes([raws[5][-1] ^ 1])
    unknown = bytes([0xFD, 1, 0, 0, 9, 1, 1, 0xFF, 0xFF, 0xFF, 7, 1, 2])
    data = as_log([*raws[:5], changed, *raws[6:19], unknown, raws[19]])
    data += bytes(50) + as_log(raws[20:40]) + b"cut short"
    _, validities, counts = scan(data)
    assert counts == ScanCounts(
        frames=41, bad_crc=1, unknown=1, garbage_bytes=59, resyncs=1, repaired_times=0
    )
    assert validities.count(Validity.OK) == 39
    assert validities[5] == Validity.BAD_CRC


def test_a_damaged_time_is_replaced_by_the_one_before(raws):
    stamps = times(len(raws))
    for i in (7, 20):
        stamps[i] ^= 1 << 40
    expected = [*stamps]
    expected[7], expected[20] = stamps[6], stamps[19]
    found, _, counts = scan(as_log(raws, stamps))
    assert found == expected
    assert counts.repaired_times == 2


def test_a_damaged_first_or_last_time_is_seen_by_its_one_neighbor(raws):
    stamps = times(len(raws))
    stamps[0], stamps[-1] = stamps[0] ^ 1 << 60, 0
    found, _, counts = scan(as_log(raws, stamps))
    assert found == [stamps[1], *stamps[1:-1], stamps[-2]]
    assert counts.repaired_times == 2


def test_times_that_jump_for_good_or_come_rarely_are_believed(raws):
    jump = [t + 10**12 * (i > 30) for i, t in enumerate(times(len(raws)))]
    assert scan(as_log(raws, jump))[0] == jump
    rare = [START + 3_600_000_000 * i for i in range(len(raws))]
    assert scan(as_log(raws, rare))[0] == rare


def test_a_frame_found_after_garbage_has_its_own_time_if_that_is_whole(raws):
    data = as_log(raws[:10]) + b"\x55" * 33 + as_log(raws[10:20], times(20)[10:])
    found, _, counts = scan(data)
    assert found == times(20)
    assert (counts.garbage_bytes, counts.resyncs) == (33, 1)
    cut = as_log(raws[:10]) + as_log(raws[10:20], times(20)[10:])[5:]
    found, _, counts = scan(cut)
    assert found == [*times(10), times(10)[-1], *times(20)[11:]]
    assert counts.repaired_times == 1


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(30))
def test_windows_of_any_size_give_the_same_frames_times_and_counts(raws, seed, damage):
    rng = random.Random(seed)
    data = as_log(raws * 2)
    for _ in range(rng.choice([0, 1, 4])):
        at = rng.randrange(len(data))
        noise = rng.choice([rng.randbytes(rng.randrange(1, 3000)), b"\xfd\xfe" * 20])
        data = damage(data[:at] + noise + data[at:], rng)
    whole = scan(data)
    for window in (300, 1000, 4096):
        assert scan(data, window) == whole


@pytest.mark.parametrize("behind", ["one", "many"])
def test_garbage_without_end_after_a_frame_is_read_in_little_memory(raws, behind):
    """As a disk leaves it on which a power cut met a file that had been given its room."""
    scanner, rest, longest = Scanner(), as_log(raws[: 1 if behind == "one" else 20]), 0
    for _ in range(100):
        block, done = scanner.scan(rest := rest + bytes(2**17), final=False)
        rest = rest[done:]
        longest = max(longest, len(rest))
        del block
    assert longest < Scanner.ALONE + 2**18
    assert scanner.counts.frames == (1 if behind == "one" else 20)


def test_a_whole_type_of_another_definition_keeps_the_chain(sender):
    raws = []
    for i in range(2000):
        raw = sender.imu(1.0 + 0.004 * i).raw
        raws += [raw[:-1] + bytes([raw[-1] ^ 1]), sender.attitude(1.0 + 0.004 * i).raw]
    _, validities, counts = scan(as_log(raws))
    assert validities == [Validity.BAD_CRC, Validity.OK] * 2000
    assert (counts.bad_crc, counts.garbage_bytes, counts.resyncs) == (2000, 0, 0)


def test_a_long_log_is_read_in_little_memory(tmp_path, raws):
    record = as_log(raws)
    path = tmp_path / "long.tlog"
    path.write_bytes(record * (12_000_000 // len(record)))
    tracemalloc.start()
    try:
        frames = sum(map(len, TlogReader(path).blocks()))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert frames == len(raws) * (12_000_000 // len(record))
    assert peak < 40_000_000


def test_a_damaged_length_that_leads_to_another_record_costs_one_frame(sender):
    raws = [sender.attitude(1.0 + 0.01 * i, roll=0.1, pitch=0.2, yaw=0.3).raw for i in range(20)]
    size = len(raws[0])
    assert {len(raw) for raw in raws} == {size}
    for lost in (4, 8, 11):
        raw = bytearray(raws[lost])
        raw[1] += size + 8  # to the record after the next one
        raws[lost] = bytes(raw)
    _, validities, counts = scan(as_log(raws))
    assert validities == [Validity.OK] * 17
    assert (counts.garbage_bytes, counts.resyncs) == (3 * (size + 8), 3)
