"""From bytes to fields, for many frames of a blackbox log at once."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.telemetry.blackbox_format import (
    GROUPS,
    INCREMENT,
    MOST_FIELDS,
    NEG_14BIT,
    NULL,
    SIGNED_VB,
    TAG2_3SVARIABLE,
    TAG8_4S16,
    TAG8_8SVB,
    Definition,
)

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
        found: Array = np.maximum(self._begins.take(self._rank.take(at) + n), at)
        return found

    def behind_tagged(self, at: Array, count: int) -> Array:
        """Where what follows a tag and the numbers that it marks begins.

        Args:
            at: (k,) positions of the tag.
            count: of the numbers that it can mark.
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


class _FieldRun(Protocol):
    """Fields that lie together in a frame."""

    first: int
    count: int
    """Of the fields."""

    def behind(self, window: ByteWindow, at: Array) -> Array:
        """(k,) where what follows it begins, in the window, for parts at (k,) positions."""

    def read(self, window: ByteWindow, at: Array, which: Array) -> Array:
        """(k, which) of its fields, counted from 0."""


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
    signed: Array = (values >> 1) ^ -(values & 1)
    return signed


def _negative_14_bits(values: Array) -> Array:
    low = values & 0xFFFF
    signed: Array = -np.where(low & 0x2000, (low & 0x3FFF) - 0x4000, low)
    return signed


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
    signed: Array = (values ^ top) - top
    return signed


class _Tag2:
    """TAG2_3S32 and TAG2_3SVARIABLE: three fields, with their widths in the tag's highest bits.

    Args:
        first: index of its first field.
        variable: whether the widths are those of TAG2_3SVARIABLE.
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


class FrameLayout:
    """How the fields of one type of frame lie in it.

    Args:
        definition: of the frame.
        version: of the data.
    """

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
