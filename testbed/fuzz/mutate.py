"""Makes inputs of others: what atheris does, in plain Python, without its feedback."""

import random
from collections.abc import Sequence

_NUMBERS = (
    b"\0\0", b"\xff\xff", b"\0\0\0\x80", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\xc0\x7f",
    b"\0\0\x80\x7f", b"\0\0\0\0\0\0\0\x80", b"\xff\xff\xff\xff\xff\xff\xff\x7f", b"-1", b"1e999",
    b"nan", b"99999999999999999999", b"0", b"\0", b"\n", b"\xc2\xb1",
)  # fmt: skip
"""Edges of whole numbers, infinity and NaN in binary; the same as text."""


class Mutator:
    """Draws inputs near those that it was given.

    Args:
        seeds: inputs to begin with.
        tokens: pieces that mean something to the reader.
        longest: bytes of an input.
        rng: of its own.
    """

    def __init__(
        self, seeds: Sequence[bytes], tokens: Sequence[bytes], longest: int, rng: random.Random
    ) -> None:
        self._seeds = [seed for seed in seeds if seed] or [b"\0"]
        self._tokens = (*tokens, *_NUMBERS)
        self._longest = longest
        self._rng = rng

    def draw(self) -> bytes:
        """One input."""
        random_below = self._rng.random
        data = bytearray(self._seeds[int(random_below() * len(self._seeds))])
        for _ in range(1 + int(8 * random_below() ** 3)):
            self._change(data)
        return bytes(data[: self._longest])

    def _change(self, data: bytearray) -> None:
        random_below = self._rng.random
        at = int(random_below() * (len(data) + 1))
        kind = int(9 * random_below())
        if kind == 0 and at < len(data):
            data[at] ^= 1 << int(8 * random_below())
        elif kind == 1 and at < len(data):
            data[at] = int(256 * random_below())
        elif kind == 2:
            token = self._tokens[int(random_below() * len(self._tokens))]
            data[at:at] = token
        elif kind == 3:
            token = self._tokens[int(random_below() * len(self._tokens))]
            data[at : at + len(token)] = token
        elif kind == 4:
            del data[at : at + 1 + int(16 * random_below() ** 2)]
        elif kind == 5:
            del data[at:]
        elif kind == 6:
            piece = data[at : at + 1 + int(64 * random_below())]
            data[at:at] = piece * (1 + int(3 * random_below()))
        elif kind == 7:
            other = self._seeds[int(random_below() * len(self._seeds))]
            start = int(random_below() * len(other))
            data[at:] = other[start:]
        else:
            data[at:at] = self._rng.randbytes(1 + int(8 * random_below()))
