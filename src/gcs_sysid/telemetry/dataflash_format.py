"""The format of ArduPilot's own logs (.bin): rows of numbers, described by the log itself.

Each entry begins with A3 95 and the number of its type; FMT entries define the length, the field
types and the names of every type. The file is read window by window. Entries are found first, then
the columns wanted are taken from the window, a whole message type at once with NumPy: a log of
20 MB takes half a second where a decoder that makes an object of every entry takes twelve.
"""

import math
import re
import struct
import tempfile
from array import array
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.errors import InputError
from gcs_sysid.files import StretchSearch, file_windows, reading_log
from gcs_sysid.telemetry.log_formats import TEXT_DATAFLASH

HEAD = b"\xa3\x95"
EVERY = slice(None)
"""Rows."""
_FMT = 0x80
_HEADER = len(HEAD) + 1
_FMT_SIZE = _HEADER + struct.calcsize("<BB4s16s64s")
_LONGEST_LINE = 2**12

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
    letters: str
    columns: tuple[str, ...]


def _of_text(file: BinaryIO) -> BinaryIO:
    """The entries of a log that was saved as text, with every number as a double.

    Lines that are no entry, such as a banner or one cut short, are left out.
    """
    packed = tempfile.TemporaryFile()  # noqa: SIM115 - the caller closes it
    known: dict[str, tuple[int, str]] = {}
    while line := file.readline(_LONGEST_LINE):
        name, *values = (word.strip() for word in line.decode("latin-1").split(","))
        if name == "FMT" and len(values) > 3 and values[0].isdecimal() and int(values[0]) < 256:
            number, _, entry, letters, *columns = values
            kept = "".join(c if c in "nNZ" else "d" for c in letters if c in _TYPES)
            labels, size = ",".join(columns), _HEADER + struct.calcsize(_packing(kept))
            if int(number) != _FMT and len(labels) <= 64 and size < 256:
                known[entry] = int(number), kept
                described = (int(number), size, entry, kept, labels)
                packed.write(HEAD + bytes([_FMT]) + _packed("BBnNZ", described))
        elif name in known and len(values) == len(known[name][1]):
            code, kept = known[name]
            row = [v if c in "nNZ" else _number(v) for c, v in zip(kept, values, strict=True)]
            packed.write(HEAD + bytes([code]) + _packed(kept, row))
    packed.seek(0)
    return packed


def _number(text: str) -> float:
    """NaN where a name stands for the number, as of flight modes."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _packing(letters: str) -> str:
    """For `struct`."""
    return "<" + "".join({"n": "4s", "N": "16s", "Z": "64s"}.get(c, c) for c in letters)


def _packed(letters: str, values: Sequence[Any]) -> bytes:
    row = (v.encode("latin-1") if isinstance(v, str) else v for v in values)
    return struct.pack(_packing(letters), *row)


EntryLayout = dict[str, tuple[np.dtype[Any], int, float | None]]
"""Column -> type, place in the entry and scale."""


@dataclass
class _EntryRows:
    """Entries of one type: their places in this window, and what is kept of those before."""

    layout: EntryLayout = field(default_factory=dict)
    """Of the columns wanted; empty: its entries are counted alone."""
    count: int = 0
    places: "array[int]" = field(default_factory=lambda: array("q"))
    columns: dict[str, bytearray] = field(default_factory=dict)
    """As logged; they grow in place, so that no copy is needed to join them."""
    all_places: bytearray = field(default_factory=bytearray)
    """uint32 in the file."""


class DataflashLog:
    """A .bin log, its entries counted and the columns wanted taken.

    `wanted`: whether a column (name of the entry, name of the column) is to be taken.

    Attributes:
        path: of the file.
        counts: entry name -> number of entries.
        garbage_bytes: bytes that belong to no entry.

    Raises:
        InputError: the file cannot be read or is no dataflash log.
    """

    _MOST_FMT = 4096
    """FMT entries looked into; there are 256 types."""
    _WINDOW = 2**22
    """Bytes read at once."""
    _MARGIN = 2 * 256
    """Bytes that must follow where an entry begins before it is decided, unless the file ends."""

    def __init__(
        self, path: Path, wanted: Callable[[str, str], bool], window: int | None = None
    ) -> None:
        self.path = path
        self.garbage_bytes = 0
        self._wanted = wanted
        self._window = max(window or self._WINDOW, self._MARGIN + 1)
        self._types: dict[int, EntryType] = {}
        self._rows = {_FMT: _EntryRows()}
        self._sizes = {_FMT: _FMT_SIZE}
        self._hunting = False  # whether the last window ended in garbage
        self._search = StretchSearch()
        with reading_log(path):
            self._read()
        if not any(rows.count for number, rows in self._rows.items() if number != _FMT):
            raise InputError(
                f"{path} cannot be read as an ArduPilot log: no entry found that it describes"
            )
        self.counts: dict[str, int] = {}
        self._by_name: dict[str, int] = {}
        for number, entry in self._types.items():
            if self._rows[number].count:  # a name may be described twice
                self._by_name[entry.name] = number
                self.counts[entry.name] = self._rows[number].count

    def places(self, name: str) -> NDArray[np.int64]:
        """Positions in the file of the entries of a name of which any column is wanted, rising."""
        rows = self._rows_of(name)
        places = np.frombuffer(b"" if rows is None else rows.all_places, np.uint32)
        return places.astype(np.int64)

    def columns(self, name: str) -> tuple[str, ...]:
        """All columns of a name as the log describes it, wanted or not; () when it does not."""
        return next((t.columns for t in self._types.values() if t.name == name), ())

    def names(self, name: str) -> list[str]:
        """Columns wanted of the entries of a name that hold one number each; [] without entries."""
        return [column for column, (kind, _, _) in self._layout(name).items() if kind.kind in "iuf"]

    def text(self, name: str, column: str) -> Array | None:
        """(n,) bytes without the zeros at their end; None when there is no such column."""
        layout = self._layout(name)
        is_text = column in layout and layout[column][0].kind == "S"
        return self._values(name, column) if is_text else None

    def numbers(
        self, name: str, wanted: Collection[str], rows: Mask | slice = EVERY
    ) -> dict[str, Array]:
        """Those wanted of a name's columns that are there, as (n,) floats of some rows.

        Integers are scaled; what is damaged may be NaN.
        """
        with np.errstate(invalid="ignore"):  # of bits that are no number
            return {
                column: self._values(name, column, rows).astype(float, copy=False)
                for column in self.names(name)
                if column in wanted
            }

    def let_go(self, name: str, columns: Collection[str]) -> None:
        """Forget columns of a name: in a long log they are most of what is held."""
        rows = self._rows_of(name) or _EntryRows()
        for column in columns:
            rows.layout.pop(column, None)
            rows.columns.pop(column, None)

    def _rows_of(self, name: str) -> _EntryRows | None:
        return self._rows[self._by_name[name]] if name in self.counts else None

    def _layout(self, name: str) -> EntryLayout:
        rows = self._rows_of(name)
        return {} if rows is None else rows.layout

    def _values(self, name: str, column: str, some: Mask | slice = EVERY) -> Array:
        """(n,) of one column."""
        rows = self._rows[self._by_name[name]]
        kind, _, scale = rows.layout[column]
        values: Array = np.frombuffer(rows.columns[column], kind)[some]
        return values if scale is None else values * scale

    def _read(self) -> None:
        with open(self.path, "rb") as file:
            is_text = re.search(TEXT_DATAFLASH, file.read(_LONGEST_LINE), re.MULTILINE)
            file.seek(0)
            with _of_text(file) if is_text else file as entries:
                for window in file_windows(entries, self._window):
                    window.done = self._find(window.content, final=window.final)
                    self._settle(window.content, window.position)

    def _find(self, data: bytes, *, final: bool) -> int:
        """Find the entries of a window, and learn the types on the way; the bytes that are done."""
        end = len(data)
        stop = end - _HEADER if final else end - self._MARGIN
        places = {number: rows.places for number, rows in self._rows.items()}
        sizes = self._sizes
        self._search.forget()
        at = 0
        if self._hunting:
            at = self._resync(data, 0, final=final)
            self.garbage_bytes += at
        while at <= stop:
            number = data[at + 2]
            size = sizes.get(number) if data[at] == 0xA3 and data[at + 1] == 0x95 else None
            if size is None or at + size > end:
                if size is not None and data.find(HEAD, at + _HEADER) < 0:
                    return end  # the last entry is cut short
                found = self._resync(data, at + 1, final=final)
                self.garbage_bytes += found - at
                at = found
                continue
            places[number].append(at)
            if number == _FMT:
                self._learn(data, at, places)
            at += size
        return min(at, end)

    def _resync(self, data: bytes, at: int, *, final: bool) -> int:
        """Position of the next entry that another one, or the end, follows."""
        limit = len(data) if final else len(data) - self._MARGIN + 1
        found = self._search.next(at, limit, partial(self._entries_in, data, final))
        self._hunting = found is None
        return limit if found is None else found

    def _entries_in(self, content: bytes, final: bool, start: int, stop: int) -> list[int]:
        """All such entries in a stretch."""
        last = len(content)
        data = np.frombuffer(content, np.uint8)
        first = np.flatnonzero(data[start : min(stop, last - 2)] == HEAD[0]) + start
        first = first[data[first + 1] == HEAD[1]]
        size_of = np.zeros(256, np.int64)
        size_of[list(self._sizes)] = list(self._sizes.values())
        size = size_of[data[first + 2]]
        first, follows = first[size > 0], (first + size)[size > 0]
        next_head = np.minimum(follows, last - 2)
        headed = (data[next_head] == HEAD[0]) & (data[next_head + 1] == HEAD[1])
        headed &= follows < last - 1
        found: list[int] = first[headed | (final & (follows >= last))].tolist()
        return found

    def _learn(self, data: bytes, at: int, places: "dict[int, array[int]]") -> None:
        """Take up a FMT entry, if it can be true."""
        number, size = data[at + 3], data[at + 4]
        fmt = self._rows[_FMT]
        if number in self._sizes or fmt.count + len(fmt.places) > self._MOST_FMT:
            return
        texts = [
            data[at + start : at + stop].split(b"\0", 1)[0].decode("ascii", "replace")
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
        self._sizes[number] = size
        self._search.forget()  # what was found was found without it
        self._types[number] = EntryType(name, letters, columns)
        rows = self._rows[number] = _EntryRows(self._laid_out(self._types[number]))
        rows.columns = {column: bytearray() for column in rows.layout}
        places[number] = rows.places

    def _laid_out(self, entry: EntryType) -> EntryLayout:
        """Of the columns wanted."""
        at, layout = _HEADER, {}
        for column, letter in zip(entry.columns, entry.letters, strict=True):
            kind, scale = np.dtype(_TYPES[letter][0]), _TYPES[letter][1]
            if kind.kind in "iufS" and self._wanted(entry.name, column):
                layout[column] = kind, at, scale
            at += kind.itemsize
        return layout

    def _settle(self, content: bytes, position: int) -> None:
        """Take the columns wanted from a window at a position in the file."""
        for rows in self._rows.values():
            if rows.layout and rows.places:
                places = np.array(rows.places)
                rows.all_places += (places + position).astype(np.uint32).data
                for column, (kind, at, _) in rows.layout.items():
                    size = len(content) - kind.itemsize + 1
                    items = np.ndarray((size,), f"V{kind.itemsize}", content, strides=(1,))
                    rows.columns[column] += items[places + at].view(np.uint8).data
            rows.count += len(rows.places)
            del rows.places[:]
