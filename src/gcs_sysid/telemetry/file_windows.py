"""A log read window by window: what one leaves undone comes again before what follows it."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

MOST_BYTES = 2**32
"""Of an onboard log: the cards that autopilots write to hold no larger file."""


@dataclass
class FileWindow:
    """Bytes of a file that are in memory together."""

    content: bytes
    position: int
    """Of the first of them in the file."""
    final: bool
    """Whether nothing follows them."""
    done: int = 0
    """How many of them need not come again; set by the reader."""


def file_windows(file: BinaryIO, size: int, stop: int | None = None) -> Iterator[FileWindow]:
    """Read a file from where it stands.

    Args:
        file: open.
        size: bytes read at once.
        stop: position at which to end; None: where the file ends.
    """
    position, rest, final = file.tell(), b"", False
    while not final:
        left = size if stop is None else stop - position - len(rest)
        more = file.read(min(size, left))
        final = len(more) < size or (left <= size and stop is not None)
        window = FileWindow(rest + more, position, final)
        yield window
        position += window.done
        rest = window.content[window.done :]
