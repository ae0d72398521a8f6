"""Blackbox frames: what was written, what a plain reader reads, and what orangebox reads."""

import random

import numpy as np
import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.telemetry.blackbox_format import read_header, session_starts
from gcs_sysid.telemetry.blackbox_frames import read_frames
from testbed import blackbox_log as bbl
from testbed.blackbox_log import BlackboxWriter, Field
from testbed.fuzz.blackbox_reference import PlainReader

ENCODINGS = (0, 1, 3, 6, 7, 8, 9, 10)
KEYS, DELTAS = (0, 4, 8, 9, 11), (0, 1, 2, 3, 4, 6, 8, 9, 11)
SETTINGS = {"minthrottle": 1070, "motorOutput": "158,2047", "vbatref": 1680}
OTHERS = {"S": bbl.SLOW, "G": bbl.GPS, "H": bbl.HOME}


def frames_of(data, wanted=None):
    start, stop = session_starts(data)[:2]
    return read_frames(data, read_header(data, start, stop), stop, wanted)


def assert_as_plain(data):
    start, stop = session_starts(data)[:2]
    plain = PlainReader(data, read_header(data, start, stop), stop).read()
    frames = frames_of(data)
    assert frames.main.values.tolist() == plain.main
    assert frames.time_us.tolist() == plain.time_us
    assert frames.slow.values.tolist() == plain.slow
    assert frames.damaged == plain.damaged
    return frames


def drawn_fields(rng):
    """Runs of fields of any encoding and predictor."""
    fields = list(bbl.CLOCK)
    while len(fields) < rng.randrange(6, 40):
        encoding, p_encoding = rng.choice(ENCODINGS), rng.choice(ENCODINGS)
        for _ in range(rng.choice((1, 2, 3, 4, 8, 9))):
            named = any(field.name == "motor[0]" for field in fields)
            motor = (5,) if named else ()
            name = f"x[{len(fields)}]" if named or rng.random() < 0.8 else "motor[0]"
            kinds = rng.choice(KEYS + motor), rng.choice(DELTAS + motor)
            fields.append(Field(name, rng.randrange(2), kinds[0], encoding, kinds[1], p_encoding))
    return fields


def drawn_log(rng, fields=None, size=None):
    """A session of such fields, of values that fit and of such that do not."""
    writer = BlackboxWriter(
        drawn_fields(rng) if fields is None else fields,
        OTHERS,
        SETTINGS,
        interval=rng.choice((1, 8, 32)),
        every=rng.choice((1, 2, 4)),
        version=rng.choice((1, 2)) if fields is None else 2,
    )
    size = size or rng.choice((1, 8, 200, 40_000, 2**31))
    loop, time = 0, rng.choice((5, 2**32 - 20_000))
    values = [rng.randrange(-size, size + 1) for _ in writer.main]
    for k in range(rng.randrange(1, 100)):
        values = [v + rng.randrange(-size, size + 1) // rng.choice((1, 4, 50)) for v in values]
        values[:2] = loop, time % 2**32
        (writer.inter if loop % writer.interval and k else writer.intra)(values)
        if rng.random() < 0.05:
            writer.other("S", [rng.randrange(4) for _ in bbl.SLOW])
        if rng.random() < 0.05:
            writer.other("H", [rng.randrange(-(2**31), 2**31) for _ in bbl.HOME])
        if rng.random() < 0.05:
            writer.other("G", [time, 9, rng.randrange(-(2**31), 2**31), 5])
        if rng.random() < 0.02:
            writer.event(30, bbl.unsigned_vb(3) + bbl.unsigned_vb(2))
        if rng.random() < 0.01:  # a pause, or a time that is wrong
            loop, time = (loop // writer.interval + 100) * writer.interval, time + 30_000_000
            if rng.random() < 0.7:
                writer.resume(loop, time % 2**32)
            continue
        begun = loop - loop % writer.interval
        loop = min(loop + writer.every, begun + writer.interval)
        time += 1000 + rng.randrange(-3, 4)
    return writer, writer.data + rng.choice((b"", bbl.END))


def damaged(rng, data, first):
    data = bytearray(data)
    for _ in range(rng.choice((1, 3, 10))):
        at = rng.randrange(first, len(data))
        kind = rng.randrange(4)
        if kind == 0:
            data[at] = rng.randrange(256)
        elif kind == 1:
            del data[at : min(at + rng.randrange(1, 40), len(data) - 2)]
        elif kind == 2:
            data[at:at] = rng.choices((255, 0, 73, 80, 69, 14), k=rng.randrange(1, 30))
        else:
            data[at:at] = data[rng.randrange(first, len(data)) :][: rng.randrange(60)]
    return bytes(data)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_logs_of_every_kind_are_read_as_a_plain_reader_reads_them(seed):
    rng = random.Random(seed)
    writer, data = drawn_log(rng)
    assert_as_plain(data)
    for _ in range(3):
        assert_as_plain(damaged(rng, data, len(writer.header())))


@pytest.mark.parametrize(
    "garbage",
    [
        "P", "IE", "I", "PH", "PPE", "S", "P\x80", "I" + "\x80" * 11, "IPGHSE\0\1\x7f",
        "PI\x80\0", "P\x80\x80\x80\x80\x80", "E\x0e\x0d\x1e", "E\xff",
    ],
)  # fmt: skip
def test_much_garbage_is_read_as_a_plain_reader_reads_it(garbage):
    """Of which every byte may begin a frame; several groups of tagged numbers in each."""
    rng = random.Random(garbage)
    fields = [*bbl.CLOCK]
    fields += [Field(f"x[{i}]", 1, bbl.ZERO, bbl.TAG8_8SVB, bbl.PREVIOUS) for i in range(27)]
    writer, data = drawn_log(rng, fields, 40_000)
    drawn = "".join(rng.choices(garbage, k=3000))
    middle = len(writer.header()) + len(data[len(writer.header()) :]) // 2
    for many in ((garbage * 3000)[:3000].encode("latin1"), drawn.encode("latin1")):
        assert_as_plain(data[:middle] + many + data[middle:])
        assert_as_plain(data[:middle] + many)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("predictor", DELTAS)
def test_what_was_written_is_read(encoding, predictor):
    """Each encoding with each predictor, of values of every length."""
    rng = random.Random(100 * encoding + predictor)
    sizes = {3: 2**12, 8: 2**14}
    fields = [
        *bbl.CLOCK,
        Field("motor[0]", 0, bbl.MINMOTOR, bbl.UNSIGNED_VB, bbl.AVERAGE_2),
        *(Field(f"x[{i}]", 1, bbl.MOTOR_0, bbl.SIGNED_VB, predictor, encoding) for i in range(4)),
        *(Field(f"y[{i}]", 1, bbl.ZERO, encoding, bbl.PREVIOUS) for i in range(4)),
    ]
    if encoding in (7, 10):  # three fields share a tag
        fields = [f for f in fields if not f.name.endswith("[3]")]
    writer = BlackboxWriter(fields, {}, SETTINGS, interval=16)
    fixed = encoding == bbl.NULL
    written = []
    before = two = None
    for loop in range(64):
        size = sizes.get(encoding, 2**28) >> rng.choice((1, 8, 20, 28))
        own = [0 if fixed else rng.randrange(-size, size + 1) for _ in range(len(fields) - 3)]
        row = [loop, 1000 * loop, 1000 + loop % 7, *own]
        for i, field in enumerate(fields):
            if not field.name.startswith("x") or loop % 16 == 0:
                continue
            if predictor == bbl.INCREMENT:
                row[i] = before[i] + 1
            elif fixed:  # nothing is written: it is what was predicted
                low = {4: 1070, 8: 1500, 9: 1680, 11: 158}.get(predictor, 0)
                mean = int((before[i] + two[i]) / 2)
                row[i] = {1: before[i], 2: 2 * before[i] - two[i], 3: mean}.get(predictor, low)
            elif encoding in (3, 8):
                row[i] = before[i] + row[i] % 5 if predictor in (1, 2, 3) else row[i] % 2000
        two = row if loop % 16 == 0 else before
        before = row
        (writer.inter if loop % 16 else writer.intra)(row)
        written.append(row)
    frames = frames_of(writer.data + bbl.END)
    assert frames.main.values.tolist() == written
    assert frames.damaged == frames.lost == frames.garbage_bytes == 0


def test_columns_wanted_are_those_of_all():
    _, data = drawn_log(random.Random(8))
    every = frames_of(data).main
    for name in every.names:
        found = frames_of(data, [name]).main
        assert {name, "loopIteration", "time"} <= set(found.names)
        assert np.array_equal(found.columns(name), every.columns(name))
    slow = frames_of(data).slow
    found = frames_of(data, ["stateFlags"])
    assert found.slow.names == ("stateFlags",)
    assert np.array_equal(found.slow.values, slow.columns("stateFlags"))
    assert np.array_equal(found.slow.order, slow.order)


def plain_log(frames=200, fields=()):
    main = [*bbl.CLOCK, Field("gyroADC[0]", 1, 0, 0, bbl.AVERAGE_2), *fields]
    writer = BlackboxWriter(main, {"S": bbl.SLOW}, SETTINGS, interval=16)
    pieces = []
    for loop in range(frames):
        row = [loop, 1_000_000 + 1000 * loop, loop % 50 - 25, *([7] * len(fields))]
        pieces.append((writer.inter if loop % 16 else writer.intra)(row))
    return writer, pieces


def test_after_a_damaged_frame_the_next_i_frame_counts():
    writer, pieces = plain_log()
    pieces[40] = b"P\xff"
    frames = frames_of(writer.header() + b"".join(pieces))
    assert frames.main.values[:, 0].tolist() == [*range(40), *range(48, 200)]
    assert frames.damaged >= 1
    assert frames.lost == 7


def test_a_pause_is_told_by_an_event_and_a_wrong_time_is_not_believed():
    writer, _ = plain_log(32)
    writer.intra([9000, 2_000_000, 1])  # no event: too far away
    writer.inter([9001, 2_001_000, 1])
    writer.intra([32, 1_032_000, 2])
    writer.resume(90_000, 500_000_000)
    writer.intra([90_000, 500_000_000, 3])
    writer.inter([90_001, 500_001_000, 4])
    frames = frames_of(writer.data + bbl.END)
    assert frames.main.values[:, 0].tolist() == [*range(33), 90_000, 90_001]
    assert frames.lost == 2
    assert frames.time_us[-1] == 500_001_000


def test_a_wrong_first_time_does_not_cost_the_log():
    """The reference decoder would refuse all that comes after it."""
    writer, pieces = plain_log(64)
    wrong = BlackboxWriter(writer.main, {}, SETTINGS).intra([4_000_000_000, 3_000_000_000, 0])
    frames = frames_of(writer.header() + wrong + b"".join(pieces[:64]))
    assert frames.main.values[1:, 0].tolist() == list(range(64))


def test_the_clock_wraps():
    writer = BlackboxWriter(bbl.CLOCK, {}, {}, interval=16)
    for loop in range(64):
        time = (2**32 - 30_000 + 1000 * loop) % 2**32
        (writer.inter if loop % 16 else writer.intra)([loop, time])
    frames = frames_of(writer.data)
    assert frames.time_us.tolist() == [2**32 - 30_000 + 1000 * loop for loop in range(64)]
    assert frames.main.values[-1, 1] == 33_000


def test_garbage_around_the_frames_is_counted():
    writer, _ = plain_log(32)
    data = writer.header() + b"\0\0\0" + writer.data[len(writer.header()) :]
    assert frames_of(data + bbl.END + b"\xff" * 99).garbage_bytes == 0  # before, and after the end
    frames = frames_of(data + b"\xff" * 99)
    assert len(frames.main.values) == 31
    assert frames.garbage_bytes > 99


class TestOrangebox:
    """Where orangebox follows the format, every value is the same."""

    orangebox = pytest.importorskip("orangebox")

    def rows(self, path):
        parser = self.orangebox.Parser.load(str(path))
        return [frame.data for frame in parser.frames()]

    FIELDS = (
        *bbl.CLOCK,
        *(Field(f"a[{i}]", 1, 0, 0, 1, bbl.TAG2_3S32) for i in range(3)),
        *(Field(f"b[{i}]", 1, 0, 0, 1, bbl.TAG8_4S16) for i in range(4)),
        Field("vbat", 0, bbl.VBATREF, bbl.NEG_14BIT, 1, bbl.TAG8_8SVB),
        *(Field(f"c[{i}]", 1, 0, 0, 1, bbl.TAG8_8SVB) for i in range(9)),
        *(Field(f"d[{i}]", 1, bbl.FIXED_1500, 0, bbl.AVERAGE_2) for i in range(6)),
        Field("motor[0]", 1, bbl.MINMOTOR, 0, bbl.AVERAGE_2),
        *(Field(f"motor[{i}]", 1, bbl.MOTOR_0, 0, bbl.AVERAGE_2) for i in (1, 2, 3)),
        Field("e", 1, bbl.MINTHROTTLE, 0, bbl.STRAIGHT_LINE),
    )

    @pytest.mark.parametrize("seed", range(4))
    @pytest.mark.parametrize("every", [1, 2, 4])
    def test_equal_on_logs_of_our_own(self, tmp_path, seed, every):
        rng = random.Random(seed)
        writer = BlackboxWriter(self.FIELDS, {"S": bbl.SLOW}, SETTINGS, interval=32, every=every)
        row = [0] * len(self.FIELDS)
        for loop in range(0, 400, every):
            row = [v + rng.randrange(-9, 10) * rng.choice((0, 1, 30, 900)) for v in row]
            row[:2] = loop, 1000 * loop + rng.randrange(5)
            row[9] = 1680 - loop
            (writer.inter if loop % 32 else writer.intra)(row)
            if rng.random() < 0.05:
                writer.other("S", [rng.randrange(2) for _ in bbl.SLOW])
        path = tmp_path / "log.bbl"
        path.write_bytes(writer.data + bbl.END)
        found = frames_of(path.read_bytes()).main.values.tolist()
        assert [list(row[: len(self.FIELDS)]) for row in self.rows(path)] == found

    @pytest.mark.thorough
    def test_equal_on_a_real_log(self, shared_logs, caplog):
        path = shared_logs / "real" / "LOG00259.BFL"
        rows = self.rows(path)
        caplog.clear()  # orangebox warns of a header and of an event
        found = frames_of(path.read_bytes()).main.values
        assert not caplog.records
        assert [list(row[: found.shape[1]]) for row in rows] == found.tolist()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ((b"Field I predictor:0,0", b"Field I predictor:0,1"), "time has predictor 1"),
        ((b"Field I encoding:1,1", b"Field I encoding:1,2"), "time has encoding 2"),
        ((b"Field I name:loopIteration", b"Field I name:lost"), "no loopIteration or time"),
        ((b"Field P predictor:6,2", b"Field P predictor:6,2,1"), "2 names, 3 predictors"),
        ((b"Field I name:", b"Field I name:a,b,"), "names"),
        ((b"I interval:32", b"I interval:99999999"), "I interval"),
        ((b"P interval:1/1", b"P interval:0/9"), "nothing is logged"),
        ((b"Field P predictor:6,2", b"Field P predictor:6,5"), "predicted by no motor"),
        ((b"Field I", b"Field J"), "does not describe the frames"),
        (
            (b"H Field P predictor", b"H Field P name:time,loopIteration\nH Field P predictor"),
            "share",
        ),
        ((b"Field I name:loop", b"Field I name:" + b"x," * 600 + b"loop"), "more than 512"),
    ],
)
def test_headers_that_no_firmware_writes_are_refused(change, said):
    data = BlackboxWriter(bbl.CLOCK, {}, {}).header().replace(*change) + b"I\0\0"
    with pytest.raises(InputError, match=said):
        frames_of(data)


def test_frames_that_claim_more_than_their_bytes_are_refused():
    fields = [*bbl.CLOCK, *(Field(f"x[{i}]", 1, 0, bbl.NULL, 0, bbl.NULL) for i in range(500))]
    data = BlackboxWriter(fields, {}, {}).header() + b"I\0\0" * 4000
    with pytest.raises(InputError, match="more values"):
        frames_of(data)
    assert len(frames_of(data, ["time"]).main.values) == 4000
