"""MAVLink's checksum (X.25, CRC-16/MCRF4XX) of many frames at once.

Two bytes are taken per look-up, in all frames of one length together: the 16 bits of state and
the next 16 bits of the message, joined by exclusive or, index the state after them.
"""

import numpy as np

from gcs_sysid.arrays import Array

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
    result = np.empty(len(at), np.uint16)
    order = np.argsort(length.astype(np.uint16), kind="stable")  # a radix sort
    ends = np.flatnonzero(np.diff(length[order], append=-1)) + 1
    start = 0
    for end in ends.tolist():
        size = int(length[order[start]])
        for first in range(start, end, ROWS_AT_ONCE):
            rows = order[first : min(first + ROWS_AT_ONCE, end)]
            state = _equal_lengths(data, at[rows], size)
            result[rows] = (state >> 8) ^ _BYTE[(state ^ extra[rows]) & 0xFF]
        start = end
    return result


def rows_of(data: Array, at: Array, size: int) -> Array:
    """(n, size) copies of the bytes that begin at each position."""
    # Overlapping items of `size` bytes: picking one copies it whole, not byte by byte.
    items = np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))
    return items[at].view(np.uint8).reshape(len(at), size)


def _equal_lengths(data: Array, at: Array, size: int) -> Array:
    """(n,) uint16 state after `size` bytes from each position."""
    state = np.full(len(at), 0xFFFF, np.uint16)
    if size % 2:
        state = (state >> 8) ^ _BYTE[(state ^ data[at]) & 0xFF]
        at = at + 1
    if size > 1:
        words = rows_of(data, at, size - size % 2).view("<u2")
        for column in np.ascontiguousarray(words.T, np.uint16):
            state = _WORD.take(state ^ column)
    return state
