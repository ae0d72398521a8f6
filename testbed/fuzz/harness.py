"""What a harness is, and what several share."""

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from gcs_sysid.errors import GcsSysidError

CORPUS = Path(__file__).parents[2] / "tests" / "fuzz" / "corpus"
"""Inputs kept, a folder for each harness."""


@dataclass(frozen=True)
class Harness:
    """One reader under test.

    Attributes:
        name: as on the command line, and of its folder of kept inputs.
        reads: what is read, for the table.
        check: takes an input; raises anything at all when a property does not hold.
        seeds: makes inputs to begin with.
        weight: share of the inputs of a run, relative to the others: less where one takes longer.
        tokens: pieces that the mutator puts in.
        longest: bytes of an input.
        together: inputs joined for one check, where a reader takes as long for a few bytes as
            for a kilobyte; a finding is kept with all of them.
    """

    name: str
    reads: str
    check: Callable[[bytes], None]
    seeds: Callable[[], list[bytes]]
    weight: float
    tokens: tuple[bytes, ...] = ()
    longest: int = 2048
    together: int = 1

    def kept(self) -> list[bytes]:
        """The inputs kept of earlier findings."""
        return [path.read_bytes() for path in sorted((CORPUS / self.name).glob("*"))]


@contextlib.contextmanager
def one_line_errors() -> Iterator[None]:
    """Errors for users are no findings, as long as they are one line of bearable length."""
    try:
        yield
    except GcsSysidError as error:
        line = str(error)
        assert line, "an error without a word"
        assert line.isprintable(), f"not one printable line: {line!r:.200}"
        assert len(line) <= 1000, f"a line of {len(line)} characters"


class Scratch:
    """A file in memory, where the system has such, for readers that want a path."""

    def __init__(self, suffix: str) -> None:
        folder = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
        self._folder = tempfile.TemporaryDirectory(prefix="fuzz-", dir=folder)
        self.path = Path(self._folder.name) / f"input{suffix}"

    def put(self, data: bytes) -> Path:
        """Write the file; its path."""
        self.path.write_bytes(data)
        return self.path


class Bytes:
    """Hands out an input piece by piece; zeros once it is used up."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def __bool__(self) -> bool:
        return self._at < len(self._data)

    def take(self, count: int) -> bytes:
        """The next bytes."""
        piece = self._data[self._at : self._at + count]
        self._at += count
        return piece.ljust(count, b"\0")

    def byte(self) -> int:
        """The next byte."""
        at = self._at  # not by `take`: most of what a grammar costs is this
        self._at = at + 1
        return self._data[at] if at < len(self._data) else 0

    def rest(self) -> bytes:
        """All that is left."""
        piece, self._at = self._data[self._at :], len(self._data)
        return piece
