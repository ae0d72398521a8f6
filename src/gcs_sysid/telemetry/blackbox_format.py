"""The format of Betaflight's, INAV's and Indiflight's logs (.bbl, .bfl): headers and fields.

A file holds sessions one after the other. Each begins with lines of text that describe its frames:
`H Field I encoding:1,0,...`. A frame is a letter and then its fields, most of them of variable
length, each as the difference from what a predictor says:

- I: everything, from which the following P can be computed; P: the change since the last frame
- S: flight modes; G: GPS; H: where home is; E: events

The definition is what the firmware writes and what Betaflight's blackbox-log-viewer reads. This
module reads the headers and turns bytes into fields, for many frames at once; `blackbox_frames`
finds the frames and adds the predictions.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.telemetry.log_formats import BLACKBOX_HEAD

MARKERS = b"IPGHSE"
"""First bytes of frames."""
MOST_SESSIONS = 1000
"""In a file; as the reference decoder."""
MOST_FIELDS = 512
"""Of a frame; the reference takes 128, Indiflight writes 171."""
_LONGEST_NAME, _LONGEST_LINE, _LONGEST_HEADER = 64, 2**14, 2**18
_MOST_LOOPS = 2**15
"""Of the firmware between I frames, which it counts in 16 bits."""

SIGNED_VB, UNSIGNED_VB, NEG_14BIT, TAG8_8SVB, TAG2_3S32, TAG8_4S16, NULL, TAG2_3SVARIABLE = (
    0, 1, 3, 6, 7, 8, 9, 10,
)  # fmt: skip
(
    ZERO, PREVIOUS, STRAIGHT_LINE, AVERAGE_2, MINTHROTTLE, MOTOR_0, INCREMENT, HOME_COORD,
    FIXED_1500, VBATREF, LAST_MAIN_FRAME_TIME, MINMOTOR,
) = range(12)  # fmt: skip
_ONE_EACH = (SIGNED_VB, UNSIGNED_VB, NEG_14BIT, NULL)
"""Encodings of a field for itself, which the reference cuts to 32 bits; the others are not cut."""
UNCUT = -(2**62)
GROUPS = {TAG8_8SVB: 8, TAG2_3S32: 3, TAG8_4S16: 4, TAG2_3SVARIABLE: 3}
"""Encoding -> most fields that are written together."""
_ALWAYS = {ZERO, MINTHROTTLE, MOTOR_0, FIXED_1500, VBATREF, MINMOTOR}
_PREDICTORS = {
    "I": _ALWAYS, "P": _ALWAYS | {PREVIOUS, STRAIGHT_LINE, AVERAGE_2, INCREMENT},
    "G": {*_ALWAYS, HOME_COORD, LAST_MAIN_FRAME_TIME} - {MOTOR_0},
    "H": _ALWAYS - {MOTOR_0}, "S": _ALWAYS - {MOTOR_0},
}  # fmt: skip
_LINE = re.compile(rb"H ([\x20-\x39\x3b-\x7e]{1,64}):([\x20-\x7e\x80-\xff]*)\r?")
_TEXT = bytes([0x0D, *range(0x20, 0x7F), *range(0x80, 0x100)])
"""What a line may consist of."""
_LINE_OR_FRAME = re.compile(rb"H |[IPGSE]")
_DIGITS = re.compile(r"[+-]?\d{1,9}")


@dataclass(frozen=True)
class Definition:
    """The fields of one type of frame, one entry each."""

    names: tuple[str, ...]
    signed: tuple[int, ...]
    predictors: tuple[int, ...]
    encodings: tuple[int, ...]

    def only(self, names: tuple[str, ...]) -> "Definition":
        """Some of the fields."""
        rows = [self.names.index(name) for name in names]
        lists = (self.signed, self.predictors, self.encodings)
        return Definition(names, *(tuple(numbers[i] for i in rows) for numbers in lists))

    def lowest(self) -> Array:
        """(fields,) lowest value of those that are cut to 32 bits; UNCUT for the others."""
        cut = np.isin(self.encodings, _ONE_EACH) & (np.array(self.predictors) != INCREMENT)
        return np.where(cut, np.where(np.array(self.signed) == 0, 0, -(2**31)), UNCUT)


@dataclass(frozen=True)
class Header:
    """Header of a session.

    Attributes:
        values: of the lines that define no fields, as written; the last of each name.
        frames: letter -> fields. P has those of I.
        data: position in the file of the first byte after it.
        interval: loops between I frames.
        logged: (k,) rising, loops after an I frame that are logged, 0 included.
    """

    values: dict[str, str]
    frames: dict[str, Definition]
    data: int
    interval: int = 32
    logged: Array = field(default_factory=lambda: np.arange(32))

    def numbers(self, name: str) -> list[float]:
        """The numbers of a line; [] when it is missing or says something else."""
        try:
            found = [float(word) for word in self.values[name].split(",")]
        except (KeyError, ValueError):
            return []
        return found if np.isfinite(found).all() else []

    def number(self, name: str, default: float) -> float:
        """The first number of a line."""
        return next(iter(self.numbers(name)), default)

    @property
    def version(self) -> float:
        """Of the data."""
        return self.number("Data version", 1.0)

    def constants(self) -> dict[int, int]:
        """Predictor -> what it predicts; the defaults are the reference decoder's."""
        low = self.number("minthrottle", 1150.0)
        return {
            MINTHROTTLE: _whole(low),
            FIXED_1500: 1500,
            VBATREF: _whole(self.number("vbatref", 4095.0)),
            MINMOTOR: _whole(self.number("motorOutput", low)),
        }


def session_starts(data: bytes) -> list[int]:
    """Positions at which sessions begin, and the end of the file."""
    starts: list[int] = []
    at = data.find(BLACKBOX_HEAD)
    while at >= 0 and len(starts) < MOST_SESSIONS:
        starts.append(at)
        at = data.find(BLACKBOX_HEAD, at + len(BLACKBOX_HEAD))
    return [*starts, len(data) if at < 0 else at]


def read_header(data: bytes, start: int, stop: int) -> Header:
    """The header of a session that lies between two positions.

    Raises:
        InputError: it does not describe frames that firmware writes.
    """
    values: dict[str, str] = {}
    fields: dict[str, dict[str, str]] = {}
    at, last = start, min(stop, start + _LONGEST_HEADER)
    end = wrong = start  # of the line, and what is in it before which none can begin
    while found := _LINE_OR_FRAME.search(data, at, last):
        at = found.start()
        if data[at] != ord("H"):
            break
        if at >= end:
            end = data.find(b"\n", at, last)
            end = last + _LONGEST_LINE if end < 0 else end
        fits = at >= wrong and end - at < _LONGEST_LINE
        match = _LINE.fullmatch(data, at, end) if fits else None
        if match:
            name, value = match[1].decode("ascii"), match[2].decode("utf-8", "replace")
            _, letter, what = (*name.split(" ", 2), "", "")[:3]
            if name.startswith("Field ") and len(letter) == 1:
                fields.setdefault(letter, {})[what] = value
            else:
                values[name] = value
        elif fits:
            wrong = at + len(data[at:end].rstrip(_TEXT))
        at = end + 1 if match else at + 1
    else:
        at = last
    if "I" not in fields or "P" not in fields:
        raise InputError("its header does not describe the frames: it is damaged, or cut short")
    fields["P"] = {**fields["I"], **fields["P"]}
    frames = {letter: _definition(letter, f) for letter, f in fields.items() if letter in "IPGHS"}
    if frames["P"].names != frames["I"].names:
        raise InputError("its header gives I frames and P frames, which share columns, other names")
    interval, logged = _intervals(values)
    return Header(values, frames, at, interval, logged)


def _definition(letter: str, fields: dict[str, str]) -> Definition:
    names = tuple(fields.get("name", "").split(",", MOST_FIELDS))
    columns = [
        [int(w) if _DIGITS.fullmatch(w) else -1 for w in fields.get(what, "").split(",", 2**12)]
        for what in ("signed", "predictor", "encoding")
    ]
    signed, predictors, encodings = columns
    if letter in "SH":  # the reference has none before that they could be predicted from
        predictors = [ZERO if p == PREVIOUS else p for p in predictors]
    signed = (signed + [0] * len(names))[: len(names)]
    wrong = f"its header describes the fields of {letter} frames wrongly: "
    if len(names) > MOST_FIELDS:
        raise InputError(f"{wrong}more than {MOST_FIELDS}")
    if len(set(names)) < len(names) or not all(0 < len(name) <= _LONGEST_NAME for name in names):
        raise InputError(f"{wrong}two of one name, or a name of no or many letters")
    if len(predictors) != len(names) or len(encodings) != len(names):
        raise InputError(f"{wrong}{len(names)} names, {len(predictors)} predictors")
    for name, predictor, encoding in zip(names, predictors, encodings, strict=True):
        if predictor not in _PREDICTORS[letter]:
            raise InputError(f"{wrong}{name} has predictor {predictor}")
        if encoding not in (*_ONE_EACH, *GROUPS):
            raise InputError(f"{wrong}{name} has encoding {encoding}")
    if letter in "IP" and not {"loopIteration", "time"} <= set(names):
        raise InputError(f"{wrong}no loopIteration or time")
    if MOTOR_0 in predictors and "motor[0]" not in names[: predictors.index(MOTOR_0)]:
        raise InputError(f"{wrong}{names[predictors.index(MOTOR_0)]} is predicted by no motor[0]")
    return Definition(names, tuple(signed), tuple(predictors), tuple(encodings))


def _intervals(values: dict[str, str]) -> tuple[int, Array]:
    """Loops between I frames, and which of them are logged."""
    whole = Header(values, {}, 0).number("I interval", 32.0)
    words = values.get("P interval", "1/1").strip().split("/")
    if len(words) == 1:
        words = ["1", *words]
    numbers = [int(word) if _DIGITS.fullmatch(word) else 0 for word in words]
    if not 1 <= whole <= _MOST_LOOPS or len(numbers) != 2:
        raise InputError("its header gives no I interval and P interval that can be")
    interval, share, parts = int(whole), numbers[0], max(numbers[1], 1)
    loops = np.arange(interval)
    logged = loops[(loops + share - 1) % parts < share]
    if not len(logged):
        raise InputError("its header gives a P interval at which nothing is logged")
    return interval, logged


def _whole(value: float) -> int:
    return int(min(max(value, -(2.0**31)), 2.0**32 - 1.0))


_SMALL_FRAME, _BYTES_A_FIELD = 256, 4
"""A frame has at most 256 bytes, or four for each field: Indiflight writes 170 fields."""


ONES = np.array([bin(i).count("1") for i in range(256)], np.int32)
"""Of the bits of a byte."""
_LONGEST_NUMBER = 5
"""Bytes; one that goes on for longer is damaged, and read as 0."""


class ByteWindow:
    """Bytes of a session in which many frames are read at once.

    Where a field ends shows without reading it: a number ends with the first byte below 0x80, a
    group has its length in its tag. So the n-th number from a position on begins behind the end
    that is n - 1 further in the list of all ends: one look-up for any number of frames and fields.

    Args:
        raw: (n,) uint8. Behind the last first byte of a frame come as many as the longest frame
            may have, zeros where the session has ended.
    """

    def __init__(self, raw: Array) -> None:
        self.raw = raw
        self._end = len(raw) - 1
        last = raw < 0x80
        # How many numbers end before each byte, and where the one behind the k-th end begins, from
        # 1 on; of half the size of positions, so that more of it stays in the cache.
        self._rank = np.zeros(len(raw) + 1, np.int32)
        np.cumsum(last, dtype=np.int32, out=self._rank[1:])
        behind = np.flatnonzero(last[:-1])
        self._begins = np.full(len(behind) + 1 + MOST_FIELDS, self._end, np.int32)
        self._begins[0] = 0
        np.add(behind, 1, out=self._begins[1 : len(behind) + 1], casting="unsafe")

    def nth(self, at: Array, n: Array | int) -> Array:
        """Where number n, from 0 on, begins of those that follow each other from a position on.

        Args:
            at: positions; of any shape to which n can be brought.
            n: how many numbers lie between.
        """
        return np.maximum(self._begins.take(self._rank.take(at) + n), at)

    def behind_tagged(self, at: Array, count: int) -> Array:
        """Where what follows a tag and the numbers that it marks begins.

        At (k,) positions of the tag; `count` is of the numbers that it can mark.
        """
        tag = self.raw.take(at)
        return self.within(self.nth(at + 1, ONES.take(tag & ((1 << count) - 1))))

    def within(self, at: Array) -> Array:
        """(k,) positions, none behind the last."""
        return np.minimum(at, self._end)

    def numbers(self, at: Array) -> Array:
        """Unsigned numbers that begin at positions of any shape; 0 where one is too long."""
        values = self.raw[at].astype(np.int64)
        flat, at = values.reshape(-1), at.reshape(-1)
        more = np.flatnonzero(flat > 0x7F)
        flat[more] &= 0x7F
        for i in range(1, _LONGEST_NUMBER):
            byte = self.raw[np.minimum(at[more] + i, self._end)].astype(np.int64)
            flat[more] |= (byte & 0x7F) << (7 * i)
            more = more[byte > 0x7F]
        flat[more] = 0
        values &= 0xFFFFFFFF
        return values

    def words(self, at: Array, size: int, *, little: bool) -> Array:
        """(k,) uint64 of the bytes from (k,) positions on, at most eight."""
        order = range(size - 1, -1, -1) if little else range(size)
        values = np.zeros(len(at), np.uint64)
        for i in order:
            values = values << np.uint64(8) | self.raw[np.minimum(at + i, self._end)]
        return values


class _Numbers:
    """Fields of a number each, or of nothing."""

    def __init__(self, first: int, encodings: list[int]) -> None:
        self.first, self.count = first, len(encodings)
        self._encodings = np.array(encodings)
        there = self._encodings != NULL
        self._order = np.cumsum(there) - there
        self._numbers = int(there.sum())

    def behind(self, window: ByteWindow, at: Array) -> Array:
        return window.nth(at, self._numbers) if self._numbers else at

    def read(self, window: ByteWindow, at: Array, which: Array) -> Array:
        values = window.numbers(window.nth(at[:, None], self._order[which]))
        encodings = self._encodings[which]
        _convert(values, encodings == SIGNED_VB, _zigzag)
        _convert(values, encodings == NEG_14BIT, _negative_14_bits)
        _convert(values, encodings == NULL, np.zeros_like)
        return values


def _convert(values: Array, columns: Array, how: Callable[[Array], Array]) -> None:
    if columns.all():
        values[:] = how(values)
    elif columns.any():
        values[:, columns] = how(values[:, columns])


def _zigzag(values: Array) -> Array:
    return (values >> 1) ^ -(values & 1)


def _negative_14_bits(values: Array) -> Array:
    low = values & 0xFFFF
    return -np.where(low & 0x2000, (low & 0x3FFF) - 0x4000, low)


class _TaggedNumbers:
    """TAG8_8SVB: a byte that marks which of up to eight numbers are there, the others being 0."""

    def __init__(self, first: int, count: int) -> None:
        self.first, self.count = first, count

    def behind(self, window: ByteWindow, at: Array) -> Array:
        return window.behind_tagged(at, self.count)

    def read(self, window: ByteWindow, at: Array, which: Array) -> Array:
        tag = window.raw[at].astype(np.int64)[:, None]
        values = np.zeros((len(at), len(which)), np.int64)
        row, column = np.nonzero(tag >> which & 1)
        order = ONES[tag[row, 0] & ((1 << which[column]) - 1)]
        values[row, column] = _zigzag(window.numbers(window.nth(at[row] + 1, order)))
        return values


class _Packed:
    """Groups whose tag, a byte, gives the width of each field.

    Args:
        first: index of its first field.
        count: of the fields.
        places: (256, 4, 2) for each tag and field, in bits: where the field begins, counted from
            the tag's end, and how many it has; 0: the field is 0.
        sizes: (256,) bytes, the tag's included.
        little: whether bits count from the lowest of the first byte, else from its highest.
    """

    def __init__(
        self, first: int, count: int, places: Array, sizes: Array, *, little: bool
    ) -> None:
        self.first, self.count = first, count
        self._places, self._sizes, self._little = places, sizes, little

    def behind(self, window: ByteWindow, at: Array) -> Array:
        return window.within(at + self._sizes.take(window.raw.take(at)))

    def read(self, window: ByteWindow, at: Array, which: Array) -> Array:
        tag = window.raw[at]
        words = window.words(at + 1, 8, little=self._little)[:, None]
        start, bits = np.moveaxis(self._places[tag][:, which], 2, 0)
        shift = start if self._little else np.maximum(64 - start - bits, 0)
        return _signed(words >> shift.astype(np.uint64), bits)


def _signed(words: Array, bits: Array) -> Array:
    """The lowest bits of words, as signed integers."""
    values = words.astype(np.int64) & ((1 << bits) - 1)
    top = (1 << bits) >> 1
    return (values ^ top) - top


class _Tag2:
    """TAG2_3S32 and TAG2_3SVARIABLE: three fields, with their widths in the tag's highest bits.

    `variable`: the widths are those of TAG2_3SVARIABLE.
    """

    count = 3

    def __init__(self, first: int, *, variable: bool) -> None:
        self.first = first
        self._starts, self._bits = _VARIABLE if variable else _FIXED

    def behind(self, window: ByteWindow, at: Array) -> Array:
        return window.within(at + _TAG2_SIZES.take(window.raw.take(at)))

    def read(self, window: ByteWindow, at: Array, which: Array) -> Array:
        tag = window.raw[at]
        bits = self._bits[tag >> 6][:, which]
        shift = 24 - self._starts[tag >> 6][:, which] - bits
        words = window.words(at, 3, little=False)[:, None]
        values = _signed(words >> shift.astype(np.uint64), bits)
        wide = np.flatnonzero(tag >> 6 == 3)
        if len(wide):
            lengths = 1 + (tag[wide, None] >> np.array([0, 2, 4]) & 3).astype(np.int64)
            offsets = 1 + np.cumsum(lengths, axis=1) - lengths
            for column, field in enumerate(which.tolist()):
                words = window.words(at[wide] + offsets[:, field], 4, little=True)
                values[wide, column] = _signed(words, 8 * lengths[:, field])
        return values


def _tag2_size(tag: int) -> int:
    return 4 + sum(tag >> i & 3 for i in (0, 2, 4)) if tag >> 6 == 3 else 1 + (tag >> 6)


def _nibbles(tag: int) -> list[tuple[int, int]]:
    """TAG8_4S16 of today: widths of 0, 4, 8 or 16 bits, without gaps."""
    bits = [(0, 4, 8, 16)[tag >> i & 3] for i in (0, 2, 4, 6)]
    return [(sum(bits[:i]), bits[i]) for i in range(4)]


def _old_nibbles(tag: int) -> list[tuple[int, int]]:
    """The same of data version 1: 4 bits come in pairs, whatever the tag says of the second."""
    places: list[tuple[int, int]] = []
    at = 0
    while len(places) < 4:
        kind = tag >> 2 * len(places) & 3
        if kind == 1:
            places += [(at, 4), (at + 4, 4)]
        else:
            places.append((at, (0, 0, 8, 16)[kind]))
        at += (0, 8, 8, 16)[kind]
    return places[:4]


def _table(places: Callable[[int], list[tuple[int, int]]]) -> tuple[Array, Array]:
    """(256, 4, 2) places of the fields for each tag, and (256,) bytes, the tag's included."""
    table = np.array([places(tag) for tag in range(256)])
    sizes = 1 + (table.sum(axis=2).max(axis=1) + 7) // 8
    return table, sizes.astype(np.int32)


_TAG2_SIZES = np.array([_tag2_size(tag) for tag in range(256)], np.int32)
# Where the fields begin in the first three bytes, from the highest bit on, and their bits; the
# fourth width is separate.
_FIXED = (
    np.array([(2, 4, 6), (4, 8, 12), (2, 10, 18), (0, 0, 0)]),
    np.array([(2, 2, 2), (4, 4, 4), (6, 6, 6), (0, 0, 0)]),
)
_VARIABLE = (
    np.array([(2, 4, 6), (2, 7, 12), (2, 10, 17), (0, 0, 0)]),
    np.array([(2, 2, 2), (5, 5, 4), (8, 7, 7), (0, 0, 0)]),
)
_NEW, _OLD = _table(_nibbles), _table(_old_nibbles)


_FieldRun = _Numbers | _TaggedNumbers | _Packed | _Tag2
"""Fields that lie together in a frame: `behind` says where in the window what follows begins, for
parts at (k,) positions; `read` gives (k, which) of the fields, counted from 0."""


class FrameLayout:
    """How the fields of one type of frame lie in it."""

    def __init__(self, definition: Definition, version: float) -> None:
        self.definition = definition
        self.fields = len(definition.names)
        self.longest = max(_SMALL_FRAME, _BYTES_A_FIELD * self.fields)
        """Longest plausible frame in bytes, its letter not counted."""
        self._parts = list(_parts(definition, version))

    def ends(self, window: ByteWindow, at: Array) -> Array:
        """(k,) positions behind frames whose first fields are at (k,) positions."""
        for part in self._parts:
            at = part.behind(window, at)
        return at

    def decode(self, window: ByteWindow, at: Array, columns: Array) -> Array:
        """(k, columns) fields as they are written, of frames as for `ends`.

        Args:
            window: in which they lie.
            at: (k,) positions of their first fields.
            columns: (m,) rising, the fields wanted.
        """
        out = np.empty((len(at), len(columns)), np.int64)
        done = 0
        for part in self._parts:
            stop = int(np.searchsorted(columns, part.first + part.count))
            if stop > done:
                out[:, done:stop] = part.read(window, at, columns[done:stop] - part.first)
            if stop == len(columns):
                break
            done = stop
            at = part.behind(window, at)
        return out


def _parts(definition: Definition, version: float) -> list[_FieldRun]:
    # What increments by itself is not written, whatever its encoding.
    written = [
        NULL if predictor == INCREMENT else encoding
        for predictor, encoding in zip(definition.predictors, definition.encodings, strict=True)
    ]
    parts: list[_FieldRun] = []
    i = 0
    while i < len(written):
        encoding = written[i]
        run = i + 1
        if encoding in GROUPS:
            while run < min(i + GROUPS[encoding], len(written)) and (
                encoding != TAG8_8SVB or written[run] == encoding
            ):
                run += 1
            if encoding != TAG8_8SVB:
                parts.append(_group(encoding, i, version))
            elif run - i > 1:
                parts.append(_TaggedNumbers(i, run - i))
            else:
                parts.append(_Numbers(i, [SIGNED_VB]))
        else:
            while run < len(written) and written[run] not in GROUPS:
                run += 1
            parts.append(_Numbers(i, written[i:run]))
        i = run
    return parts


def _group(encoding: int, first: int, version: float) -> _FieldRun:
    if encoding != TAG8_4S16:
        return _Tag2(first, variable=encoding == TAG2_3SVARIABLE)
    places, sizes = _OLD if version < 2 else _NEW
    return _Packed(first, 4, places, sizes, little=version < 2)
