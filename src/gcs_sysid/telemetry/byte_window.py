"""Bytes of a blackbox log in which many fields are found at once.

Fields have variable lengths, but where one ends shows without reading it: a number ends with the
first byte below 0x80, a group has its length in its tag. So the n-th number from a position on
begins behind the end that is n - 1 further in the list of all ends: one look-up for any number of
frames and of fields.
"""

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.telemetry.blackbox_format import MOST_FIELDS

ONES = np.array([bin(i).count("1") for i in range(256)], np.int32)
"""Of the bits of a byte."""


class ByteWindow:
    """Bytes of a session in which many frames are read at once.

    Args:
        raw: (n,) uint8. Behind the last first byte of a frame come as many as the longest frame
            may have, zeros where the session has ended.

    Attributes:
        share: of the bytes, that may begin a frame of the type that is looked at.
    """

    _LONGEST_NUMBER = 5
    CACHED = 2**14
    """Positions looked at together: their arrays stay in the cache."""
    _CROWD = 0.125
    """Share of the bytes from which on every tag is looked at."""
    _LONG = 2**30
    """Added to the rank of bytes of numbers that go on for too long."""

    def __init__(self, raw: Array) -> None:
        self.raw = raw
        self.share = 0.0
        self._behind_tags: dict[tuple[int, int], Array] = {}
        self._end = len(raw) - 1
        last = raw < 0x80
        self._begins = self._begins_of(last)
        self._rank = np.zeros(len(raw) + 1, np.int32)
        np.cumsum(last, dtype=np.int32, out=self._rank[1:])
        goes_on = ~last
        long = goes_on[: 1 - self._LONGEST_NUMBER].copy()
        for i in range(1, self._LONGEST_NUMBER):
            long &= goes_on[i : len(raw) - self._LONGEST_NUMBER + 1 + i]
        self._has_long = bool(long.any())
        # How many numbers that go on for too long follow each other from a byte on, (n + 1,); -1
        # in all others.
        self._cut: Array | None = None

    def _begins_of(self, ends: Mask) -> Array:
        """Where the number behind the one begins that ends k-th, from 1 on; of half the size of
        positions, so that more of it stays in the cache.
        """
        behind = np.flatnonzero(ends[:-1])
        begins = np.full(len(behind) + 1 + MOST_FIELDS, self._end, np.int32)
        begins[0] = 0
        np.add(behind, 1, out=begins[1 : len(behind) + 1], casting="unsafe")
        return begins

    def _cut_long(self) -> None:
        """Cut runs of bytes that say "it goes on" into numbers of five bytes.

        Whatever byte of a run is begun from, all arrive behind the run's end, so that only how
        many numbers lie between differs.
        """
        starts = self._begins[: len(self._begins) - MOST_FIELDS]
        lengths = np.append(starts[1:] - 1, np.int32(self._end)) - starts
        long = lengths >= self._LONGEST_NUMBER
        starts, lengths = starts[long], lengths[long]
        pieces = lengths // self._LONGEST_NUMBER
        ends = self.raw < 0x80
        ends[_counted(starts + (self._LONGEST_NUMBER - 1), pieces, self._LONGEST_NUMBER)] = True
        self._begins = self._begins_of(ends)
        np.cumsum(ends, dtype=np.int32, out=self._rank[1:])
        at = _counted(starts, lengths, 1)
        left = np.repeat(starts + lengths, lengths) - at
        some = left // self._LONGEST_NUMBER
        all_of_them = np.repeat(pieces, lengths)
        passed = (np.repeat(lengths, lengths) - left) // self._LONGEST_NUMBER
        self._rank[at] += all_of_them - passed - some + self._LONG
        self._cut = np.full(len(self.raw) + 1, -1, np.int32)
        self._cut[at] = some

    def nth(self, at: Array, n: Array | int) -> Array:
        """Where number n, from 0 on, begins of those that follow each other from a position on.

        Args:
            at: positions; of any shape to which n can be brought.
            n: how many numbers lie between.
        """
        rank = self._ranks() if at.size else self._rank
        return self._nth_by_rank(rank.take(at), at, n)

    def _ranks(self) -> Array:
        """(n + 1,) how many numbers end before each byte."""
        if self._has_long and self._cut is None:
            self._cut_long()
        return self._rank

    def _nth_by_rank(self, rank: Array, at: Array, n: Array | int) -> Array:
        rank = np.add(rank, n)
        cut = self._cut
        long = None
        if cut is not None and rank.size and rank.max() >= self._LONG:
            long = rank >= self._LONG
            rank &= self._LONG - 1
        found: Array = self._begins.take(rank)
        if not isinstance(n, int) or n == 0:
            found = np.maximum(found, at)
        if cut is not None and long is not None:
            few = 4 * np.count_nonzero(long) < long.size
            which = np.nonzero(long) if few else ...
            at = np.broadcast_to(at, rank.shape)[which]
            numbers = n if isinstance(n, int) else np.broadcast_to(n, rank.shape)[which]
            cut_at = numbers <= cut.take(at)
            found[which] = np.where(cut_at, at + self._LONGEST_NUMBER * numbers, found[which])
        return found

    def behind_tagged(self, at: Array, count: int, groups: int = 1) -> Array:
        """Where what follows groups of a tag and the numbers that it marks begins.

        Args:
            at: (k,) positions of the first group's tag.
            count: of the numbers that a tag can mark.
            groups: that follow each other.
        """
        if self.share < self._CROWD:
            for _ in range(groups):
                at = self._behind_tagged(at, self.raw.take(at), count)
            return at
        together = groups if self.share * groups > groups.bit_length() else 1
        table = self._behind_every_tag(count, together)
        for _ in range(groups // together):
            at = table.take(at)
        return at

    def _behind_every_tag(self, count: int, groups: int) -> Array:
        """The same from every position on: each tag is looked at once, and groups are doubled."""
        if (count, groups) not in self._behind_tags:
            found = np.arange(len(self.raw), dtype=np.int32)
            half = groups // 2
            halves = [half, groups - half] if half else []
            tables = [self._behind_every_tag(count, some) for some in halves]
            for i in range(0, len(found), self.CACHED):
                piece = found[i : i + self.CACHED]
                if half:
                    piece[:] = tables[1].take(tables[0][i : i + self.CACHED])
                else:
                    piece += 1
                    ones = ONES.take(self.raw[i : i + self.CACHED] & ((1 << count) - 1))
                    rank = self._ranks()[i + 1 : i + 1 + len(piece)]
                    piece[:] = self.within(self._nth_by_rank(rank, piece, ones))
            self._behind_tags[count, groups] = found
        return self._behind_tags[count, groups]

    def _behind_tagged(self, at: Array, tag: Array, count: int) -> Array:
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
        for i in range(1, self._LONGEST_NUMBER):
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


def _counted(first: Array, counts: Array, step: int) -> Array:
    """Numbers from each of (k,) on, as many as given for each, so far apart from each other."""
    before = np.cumsum(counts) - counts
    counted: Array = np.repeat(first - step * before, counts)
    counted += step * np.arange(len(counted))
    return counted
