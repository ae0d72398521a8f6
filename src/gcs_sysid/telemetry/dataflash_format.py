"""The format of ArduPilot's own logs (.bin): rows of numbers, described by the log itself.

Each entry begins with A3 95 and the number of its type; FMT entries define the length, the field
types and the names of every type. Entries are found first and decoded later, a whole message type
at once with NumPy: a log of 20 MB takes half a second where a decoder that makes an object of every
entry takes twelve.
"""

from array import array
from bisect import bisect_left
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError

HEAD = b"\xa3\x95"
MOST_BYTES = 2**32
"""Of a log, which is read whole: the cards that autopilots write to hold no larger file."""
_FMT = 0x80
_FMT_SIZE = 89
_HEADER = 3
_MOST_FMT = 4096
"""FMT entries looked into; there are 256 types."""
_SEARCHED = 2**16
"""Bytes searched at once where the chain of entries is broken."""

_TYPES: dict[str, tuple[str, float | None]] = {
    "a": ("(32,)<i2", None), "b": ("i1", None), "B": ("u1", None), "h": ("<i2", None),
    "H": ("<u2", None), "i": ("<i4", None), "I": ("<u4", None), "q": ("<i8", None),
    "Q": ("<u8", None), "f": ("<f4", None), "d": ("<f8", None), "g": ("<f2", None),
    "n": ("S4", None), "N": ("S16", None), "Z": ("S64", None), "M": ("u1", None),
    "c": ("<i2", 0.01), "C": ("<u2", 0.01), "e": ("<i4", 0.01), "E": ("<u4", 0.01),
    "L": ("<i4", 1e-7),
}  # fmt: skip
"""Letter in FMT -> NumPy type, and what an integer is multiplied by."""


@dataclass(frozen=True)
class EntryType:
    """One type of entry, as its FMT describes it."""

    name: str
    size: int
    """Bytes, header included."""
    letters: str
    columns: tuple[str, ...]


class DataflashLog:
    """A .bin log, its entries found and counted.

    Attributes:
        path: of the file.
        counts: entry name -> number of entries.
        garbage_bytes: bytes that belong to no entry.

    Raises:
        InputError: the file cannot be read or is no dataflash log.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            size = path.stat().st_size
            if size > MOST_BYTES:
                raise InputError(f"{path}: too large for an ArduPilot log: {size:,} bytes")
            self._data = path.read_bytes()
        except OSError as error:
            raise InputError(f"cannot read {path}: {error.strerror}") from error
        except MemoryError as error:
            raise InputError(f"{path}: too large for this machine's memory") from error
        self.garbage_bytes = 0
        self._types: dict[int, EntryType] = {}
        self._found: list[int] = []  # entries in what was searched, and up to where that was
        self._searched = 0
        self._places = self._find()
        self._by_name = {entry.name: number for number, entry in self._types.items()}
        if not any(places for number, places in self._places.items() if number != _FMT):
            raise InputError(
                f"{path} cannot be read as an ArduPilot log: no entry found that it describes"
            )
        self.counts = {
            self._types[number].name: len(places)
            for number, places in self._places.items()
            if places and number != _FMT
        }

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return len(self._data)

    def places(self, name: str) -> NDArray[np.int64]:
        """Positions in the file of all entries of a name, rising."""
        number = self._by_name.get(name)
        places = self._places.get(-1 if number is None else number, ())
        return np.asarray(places, dtype=np.int64)

    def names(self, name: str) -> list[str]:
        """Columns of the entries of a name that hold one number each; [] when there are none."""
        return [column for column, (kind, _, _) in self._layout(name).items() if kind.kind in "iuf"]

    def text(self, name: str, column: str) -> Array | None:
        """(n,) bytes without the zeros at their end; None when there is no such column."""
        layout = self._layout(name)
        is_text = column in layout and layout[column][0].kind == "S"
        return self._values(name, column) if is_text else None

    def numbers(self, name: str, wanted: Collection[str]) -> dict[str, Array]:
        """Those wanted of a name's columns that are there, as (n,) floats.

        Integers are scaled; what is damaged may be NaN.
        """
        with np.errstate(invalid="ignore"):
            return {
                column: self._values(name, column).astype(float, copy=False)
                for column in self.names(name)
                if column in wanted
            }

    def _layout(self, name: str) -> dict[str, tuple[np.dtype[Any], int, float | None]]:
        """Column -> type, place in the entry and scale; {} when there are no such entries."""
        if name not in self.counts:
            return {}
        entry, at, layout = self._types[self._by_name[name]], _HEADER, {}
        for column, letter in zip(entry.columns, entry.letters, strict=True):
            kind, scale = np.dtype(_TYPES[letter][0]), _TYPES[letter][1]
            layout[column] = kind, at, scale
            at += kind.itemsize
        return layout

    def _values(self, name: str, column: str) -> Array:
        """(n,) of one column: others of a long log would take as much memory for nothing."""
        kind, at, scale = self._layout(name)[column]
        size = len(self._data) - kind.itemsize + 1
        items = np.ndarray((size,), f"V{kind.itemsize}", self._data, strides=(1,))
        values: Array = items[self.places(name) + at].view(kind)
        return values if scale is None else values * scale

    def _find(self) -> "dict[int, array[int]]":
        """Type number -> positions of its entries; learns the types on the way."""
        data = self._data
        end = len(data)
        places = {_FMT: array("q")}
        sizes = {_FMT: _FMT_SIZE}
        at = 0
        while at + _HEADER <= end:
            number = data[at + 2]
            size = sizes.get(number) if data[at] == 0xA3 and data[at + 1] == 0x95 else None
            if size is None or at + size > end:
                if size is not None and data.find(HEAD, at + _HEADER) < 0:
                    break  # the last entry is cut short
                found = self._resync(at + 1, sizes)
                self.garbage_bytes += found - at
                at = found
                continue
            places[number].append(at)
            if number == _FMT:
                self._learn(at, sizes, places)
            at += size
        return places

    def _resync(self, at: int, sizes: dict[int, int]) -> int:
        """Position of the next entry that another one, or the end, follows."""
        while at < len(self._data):
            if at >= self._searched:
                self._search(at, sizes)
            index = bisect_left(self._found, at)
            if index < len(self._found):
                return self._found[index]
            at = self._searched
        return len(self._data)

    def _search(self, start: int, sizes: dict[int, int]) -> None:
        """Find all such entries in a stretch: of garbage, every third byte may begin one."""
        end = len(self._data)
        self._searched = min(start + _SEARCHED, end)
        data = np.frombuffer(self._data, np.uint8)
        first = np.flatnonzero(data[start : min(self._searched, end - 2)] == HEAD[0]) + start
        first = first[data[first + 1] == HEAD[1]]
        size_of = np.zeros(256, np.int64)
        size_of[list(sizes)] = list(sizes.values())
        size = size_of[data[first + 2]]
        first, follows = first[size > 0], (first + size)[size > 0]
        last = np.minimum(follows, end - 2)
        headed = (data[last] == HEAD[0]) & (data[last + 1] == HEAD[1]) & (follows < end - 1)
        self._found = first[headed | (follows >= end)].tolist()

    def _learn(self, at: int, sizes: dict[int, int], places: "dict[int, array[int]]") -> None:
        """Take up a FMT entry, if it can be true."""
        number, size = self._data[at + 3], self._data[at + 4]
        if number in sizes or len(places[_FMT]) > _MOST_FMT:
            return
        texts = [
            self._data[at + start : at + stop].split(b"\0", 1)[0].decode("ascii", "replace")
            for start, stop in ((5, 9), (9, 25), (25, _FMT_SIZE))
        ]
        name, letters, labels = texts
        columns = tuple(labels.split(",")) if labels else ()
        if not (name + labels).isprintable():
            return
        if not letters or len(letters) != len(columns):
            return
        if set(letters) - set(_TYPES):
            return
        width = sum(np.dtype(_TYPES[letter][0]).itemsize for letter in letters)
        if width + _HEADER != size or len({*columns, ""}) != len(columns) + 1:
            return
        sizes[number] = size
        places[number] = array("q")
        self._searched = 0  # what was found was found without it
        self._types[number] = EntryType(name, size, letters, columns)
