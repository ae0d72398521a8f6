"""MAVLink's checksum (X.25, CRC-16/MCRF4XX) of many frames at once.

Two bytes are taken per look-up, in all frames of one length together: the 16 bits of state and
the next 16 bits of the message, joined by exclusive or, index the state after them.

Pieces that overlap much, as every byte of garbage may begin one, are not gone through one by one.
The checksum is linear: with S_k the state after k bytes of the buffer and A what a byte of zero
does to a state, a piece from a to b leaves S_b ^ A^(b - a) (S_a ^ 0xFFFF).
"""

import numpy as np

from gcs_sysid.arrays import Array, Mask

ROWS_AT_ONCE = 8192
"""Frames worked on together: their bytes, indices and states stay in the processor's cache."""


def _byte_table() -> Array:
    """(256,) the state after one byte, from the state's low byte joined with it."""
    state: Array = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        state = (state >> 1) ^ np.where(state & 1, np.uint16(0x8408), np.uint16(0))
    return state


_BYTE = _byte_table()


def _word_table() -> Array:
    """(65536,) the state after two bytes, from the state joined with them."""
    word = np.arange(65536, dtype=np.uint16)
    once = (word >> 8) ^ _BYTE[word & 0xFF]
    table: Array = (once >> 8) ^ _BYTE[once & 0xFF]
    return table


_WORD = _word_table()
LONGEST = 512
"""More than a piece has bytes."""
_COLUMNS = 128
"""States in a row of the buffer's."""


def _advance_tables() -> Array:
    """(LONGEST + 1, 2, 256) the low and the high byte of a state after n bytes of zero."""
    tables = np.empty((LONGEST + 1, 2, 256), np.uint16)
    tables[0] = np.arange(256), np.arange(256) << 8
    for n in range(LONGEST):
        tables[n + 1] = (tables[n] >> 8) ^ _BYTE[tables[n] & 0xFF]
    return tables


_ADVANCE = _advance_tables()


def checksums(data: Array, at: Array, length: Array, extra: Array) -> Array:
    """Checksums of pieces of a buffer.

    Args:
        data: (size,) uint8, contiguous.
        at: (n,) where each piece begins.
        length: (n,) bytes of each; the piece lies wholly in the buffer.
        extra: (n,) uint8, CRC_EXTRA: one more byte that the checksum covers.

    Returns:
        (n,) uint16.
    """
    if len(at) > ROWS_AT_ONCE:
        first, stop = int(at.min()), int((at + length).max())
        # Where bytes are covered many times, the states of the buffer are taken.
        if int(length.sum()) > 8 * (stop - first) and int(length.max()) <= LONGEST:
            return RunningChecksum(data[first:stop]).of(at - first, length, extra)
    result = np.empty(len(at), np.uint16)
    order = np.argsort(length.astype(np.uint16), kind="stable")  # a radix sort
    ends = np.flatnonzero(np.diff(length[order], append=-1)) + 1
    start = 0
    for end in ends.tolist():
        size = int(length[order[start]])
        for first in range(start, end, ROWS_AT_ONCE):
            rows = order[first : min(first + ROWS_AT_ONCE, end)]
            result[rows] = _equal_lengths(data, at.take(rows), size, extra.take(rows))
        start = end
    return result


def checksums_agree(data: Array, at: Array, length: Array, extra: Array) -> Mask:
    """(n,) whether the two bytes behind pieces are their checksums; see `checksums`."""
    end = at + length
    behind = data[end] | data[end + 1].astype(np.uint16) << 8
    agree: Mask = behind == checksums(data, at, length, extra)
    return agree


def rows_of(data: Array, at: Array, size: int) -> Array:
    """(n, size) copies of the bytes that begin at each position."""
    # Overlapping items of `size` bytes: picking one copies it whole, not byte by byte.
    items = np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))
    return items[at].view(np.uint8).reshape(len(at), size)


def _equal_lengths(data: Array, at: Array, size: int, extra: Array) -> Array:
    """(n,) uint16 state after `size` bytes from each position, and the extra ones."""
    state = np.full(len(at), 0xFFFF, np.uint16)
    if size % 2 and int(at.max()) + size == len(data):
        data = np.append(data, np.uint8(0))
    words = rows_of(data, at, size + size % 2).view("<u2")
    columns = np.ascontiguousarray(words.T, np.uint16)
    if size % 2:
        columns[-1] &= 0xFF
        columns[-1] |= extra.astype(np.uint16) << 8
    for column in columns:
        column ^= state
        state = _WORD.take(column)
    return state if size % 2 else _after(state, extra)


class RunningChecksum:
    """Checksums of pieces of a buffer in a time that goes with it, not with their lengths.

    Args:
        data: (size,) uint8.
    """

    def __init__(self, data: Array) -> None:
        self._states = _running_states(data)
        self._words = np.zeros(len(data) + 1, np.uint16)  # from every byte on
        self._words[:-1] = data
        self._words[:-2] |= self._words[1:-1] << 8

    def of(self, at: Array, length: Array, extra: Array) -> Array:
        """As `checksums`, of pieces of at most `LONGEST` bytes."""
        made = np.empty(len(at), np.uint16)
        for first in range(0, len(at), ROWS_AT_ONCE):
            rows = slice(first, first + ROWS_AT_ONCE)
            made[rows] = self._some(at[rows], at[rows] + length[rows], length[rows], extra[rows])
        return made

    def agree(self, at: Array, length: Array, extra: Array) -> Mask:
        """As `checksums_agree`, of a few pieces of at most `LONGEST` bytes."""
        end = at + length
        agree: Mask = self._some(at, end, length, extra) == self._words.take(end)
        return agree

    def _some(self, at: Array, end: Array, length: Array, extra: Array) -> Array:
        before = self._states.take(at) ^ np.uint16(0xFFFF)
        table = length.astype(np.intp) << 9  # in which low and high bytes have 256 each
        state = self._states.take(end)
        state ^= _ADVANCE.take(table + (before & 0xFF))
        table += 256
        state ^= _ADVANCE.take(table + (before >> 8))
        return _after(state, extra)


def _after(state: Array, byte: Array) -> Array:
    """States after one byte each, by arithmetic: faster than a table where many are together."""
    low = (state ^ byte) & np.uint16(0xFF)
    low ^= low << 4 & np.uint16(0xFF)
    after: Array = state >> 8
    after ^= low << 8
    after ^= low << 3
    after ^= low >> 4
    return after


def _running_states(data: Array) -> Array:
    """(size + 1,) uint16, the state after so many bytes, from 0."""
    rows = len(data) // _COLUMNS + 1
    padded = np.zeros(rows * _COLUMNS, np.uint8)
    padded[: len(data)] = data
    columns = padded.reshape(rows, _COLUMNS).T.astype(np.uint16, order="C")
    end = np.zeros(rows, np.uint16)  # of each row of the buffer, begun with 0
    for column in range(0, _COLUMNS, 2):
        end = _WORD.take(end ^ columns[column] ^ columns[column + 1] << 8)
    low, high = (table.tolist() for table in _ADVANCE[_COLUMNS])
    starts = [0]
    for state in end[:-1].tolist():  # S_end = end ^ A^columns S_start
        starts.append(state ^ low[starts[-1] & 0xFF] ^ high[starts[-1] >> 8])
    states = np.empty((_COLUMNS + 1, rows), np.uint16)
    states[0] = starts
    for column, byte in enumerate(columns):
        states[column + 1] = _after(states[column], byte)
    made: Array = states[:-1].T.reshape(-1)[: len(data) + 1]
    return made
