"""The format of PX4's own logs (.ulg): entries, found window by window, and what they describe.

An entry is the length of its content, a letter and the content. F entries describe topics: formats
with fields, which may be other formats or arrays. A entries give a topic a number, D entries are
its rows, which are copied with NumPy; a topic's columns are made of them at the end.

Definitions are a file's own word, and nothing is allocated on it before it is bounded: a row is
no longer than an entry can be, and how long it is follows from the formats without laying them
out. Where the chain of entries breaks, the next one is found by what a row of a known topic, a
subscription or a SYNC must look like: in linear time whatever lies between.
"""

import math
import struct
from array import array
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.files import StretchSearch, file_windows, reading_log

MAGIC = b"ULog\x01\x12\x35"
_ZEROS_PIECE = 2**20

_FILE_HEAD = struct.calcsize("<7sBQ")
"""Bytes of magic, version and time."""
_HEAD = struct.calcsize("<Hc")
"""Bytes of length and letter."""
_SYNC = b"\x08\x00S\x2f\x73\x13\x20\x25\x0c\xbb\x12"
_A, _D, _S = ord("A"), ord("D"), ord("S")
_SIZES = {
    "B": (40, 255), "F": (3, 2**16), "I": (5, 2**16), "M": (6, 2**16), "P": (8, 300),
    "Q": (9, 300), "A": (4, 259), "R": (2, 2), "L": (9, 4096), "C": (11, 4096), "S": (8, 8),
    "O": (2, 2), "D": (2, 2**16),
}  # fmt: skip
"""Letter -> bytes that its content has at least and at most."""
_BOUNDS: list[tuple[int, int] | None] = [_SIZES.get(chr(kind)) for kind in range(256)]
_DATA_APPENDED = 1
"""The one incompatible flag."""
_ANY_HEAD = struct.Struct("<HBH").unpack_from
"""Length, letter, and the number of a row's topic."""

_VALUES = {"int32_t": struct.Struct("<i"), "float": struct.Struct("<f")}
"""Types of parameters."""

Topic = dict[str, Array]


@dataclass
class _TopicRows:
    """The rows of a topic: their places in this window, and those of before."""

    layout: np.dtype[np.void]
    kept: np.dtype[np.void]
    """Of the columns wanted alone."""
    places: "array[int]" = field(default_factory=lambda: array("q"))
    table: bytearray = field(default_factory=bytearray)
    """It grows in place, so that no copy is needed to join what the windows give."""


@dataclass
class TopicLog:
    """PX4's topics, from wherever they come.

    Attributes:
        topics: (name, instance) -> column -> (n,) values, of topics with rows.
        start: s, the vehicle's clock as the log begins.
        initial: name -> value of numeric parameters as the log begins.
        changed: (t, name, value) of those that changed later.
        dropouts: (t, length) in s of pauses in the writing.
        garbage_bytes: bytes that belong to no entry.
        damaged: whether the file is not as it was written.
        faults: topic -> why it cannot be read.
    """

    topics: dict[tuple[str, int], Topic] = field(default_factory=dict)
    start: float = 0.0
    initial: dict[str, float] = field(default_factory=dict)
    changed: list[tuple[float, str, float]] = field(default_factory=list)
    dropouts: list[tuple[float, float]] = field(default_factory=list)
    garbage_bytes: int = 0
    damaged: bool = False
    faults: dict[str, str] = field(default_factory=dict)


_Subscription = tuple[int, int, "array[int] | None"]
"""Least and most bytes of a row's entry, and the places to add to; None: it is not wanted."""


class UlogFile(TopicLog):
    """A .ulg read once, within bounds of time and memory.

    Rows of the topics wanted are kept; of these the columns (topic, name) for which `is_read`,
    None: all. The timestamp is.

    Raises:
        InputError: the file cannot be read, or is no ULog that is known here.
    """

    MOST_INSTANCES = 16
    """Of a topic; PX4 has 10 at most."""
    MOST_SUBSCRIPTIONS = 1024
    """PX4 logs some 200 topics."""
    _LONGEST_UNKNOWN = 2048
    """Bytes of the rows of a topic whose subscription is missing."""
    _MOST_FAULTS = 100
    _MOST_NEW_KINDS = 1000
    """Entries of unknown kinds."""
    _LONG = 300
    """Bytes of an entry other than a row that others must follow: a length may be damaged."""
    _WINDOW = 2**22
    """Bytes read at once."""
    _MARGIN = 4 * 2**16
    """Bytes that must follow an entry before it is decided, unless the file ends."""

    def __init__(
        self,
        path: Path,
        wanted: Collection[str],
        is_read: Callable[[str, str], bool] | None = None,
    ) -> None:
        super().__init__()
        self._wanted = frozenset(wanted)
        self._is_read = is_read
        self._formats = Formats()
        self._defining = True
        self._subscriptions: dict[int, _Subscription] = {}
        self._rows: dict[tuple[str, int], _TopicRows] = {}
        self._low = np.full(2**16, 2**17, np.int32)
        self._high = np.zeros(2**16, np.int32)
        self._longest = 0
        self._learned: set[int] = set()  # topics whose subscription is missing
        self._new_kinds = 0
        self._keys: dict[bytes, tuple[str, str]] = {}
        # (place, name, value) and (place, s) in this window, whose times are those of the rows.
        self._parameters: list[tuple[int, str, float]] = []
        self._pauses: list[tuple[int, float]] = []
        self._search = StretchSearch()
        self._hunting = False  # whether the last window ended in garbage
        self._names = sorted(name.encode() for name in self._wanted)
        with reading_log(path):
            self._read(path)
        for key, rows in sorted(self._rows.items()):
            if rows.table:
                table = np.frombuffer(rows.table, rows.kept)
                self.topics[key] = {name: table[name] for name in rows.kept.names or ()}
        self._rows.clear()

    def _read(self, path: Path) -> None:
        with open(path, "rb") as file:
            end = _end_without_zeros(path)
            try:
                parts = self._take_head(file.read(_FILE_HEAD + _HEAD + _SIZES["B"][0]), end)
            except InputError as error:
                raise InputError(f"{path} cannot be read as a PX4 log: {error}") from error
            for start, stop in pairwise(parts):
                file.seek(start)
                for window in file_windows(file, self._WINDOW, stop):
                    window.done = self._scan(window.content, final=window.final)
        self.garbage_bytes += path.stat().st_size - end
        self.damaged |= self.garbage_bytes > 0

    def _take_head(self, head: bytes, end: int) -> list[int]:
        """Where the parts of the file begin: PX4 appends to what a crash has cut short."""
        if len(head) < _FILE_HEAD or not head.startswith(MAGIC):
            raise InputError("it does not begin as one")
        (start_us,) = struct.unpack_from("<Q", head, 8)
        self.start = start_us * 1e-6
        self._last_us = float(start_us)
        size, kind, _ = _ANY_HEAD(head.ljust(_FILE_HEAD + 5, b"\0"), _FILE_HEAD)
        parts = [_FILE_HEAD]
        flags = head[_FILE_HEAD + _HEAD :]
        if kind == ord("B") and size >= len(flags) == _SIZES["B"][0]:
            incompatible = flags[8:16]
            if incompatible[0] & ~_DATA_APPENDED or any(incompatible[1:]):
                raise InputError("it is of a version of the format that is not known here")
            if incompatible[0]:
                for offset in struct.unpack_from("<3Q", flags, 16):
                    if parts[-1] + _HEAD + size < offset < end:
                        parts.append(offset)
        return [*parts, max(end, _FILE_HEAD)]

    def _scan(self, content: bytes, *, final: bool) -> int:
        """Find the entries of a window, which begins with one; the bytes that are done."""
        end = len(content)
        limit = end if final else max(end - self._MARGIN, 0)
        self._search.forget()
        at = 0
        if self._hunting:
            at = self._hunt(content, 0, limit)
            self.garbage_bytes += at
        while at + 5 <= limit:
            size, kind, number = _ANY_HEAD(content, at)
            following = at + _HEAD + size
            if kind == _D:
                known = self._subscriptions.get(number)
                if known is None:
                    known = self._learn(content, following, size, number)
                if known is not None and known[0] <= size <= known[1] and following <= end:
                    if known[2] is not None:
                        known[2].append(at)
                    at = following
                    continue
            elif following <= end and self._take(content, at, kind, size):
                at = following
                continue
            if final and self._is_cut_short(content, at, following, kind):
                at = end
                break
            found = self._hunt(content, at + 1, limit)
            self.garbage_bytes += found - at
            at = found
        if final and at < end:
            # Fewer than an entry: one that is cut short.
            at = end
        self._hunting &= not final
        self._settle(content)
        return min(at, end)

    def _learn(
        self, content: bytes, following: int, size: int, number: int
    ) -> _Subscription | None:
        """A topic whose subscription is missing: its rows are as long as the first of them."""
        self.damaged = True
        can_be = (
            10 <= size <= self._LONGEST_UNKNOWN and len(self._learned) < self.MOST_SUBSCRIPTIONS
        )
        if not can_be or not _follows(content, following):
            return None
        self._learned.add(number)
        self._search.forget()  # what was found was found without it
        return self._subscribe(number, size, size, None)

    def _subscribe(
        self, number: int, low: int, high: int, places: "array[int] | None"
    ) -> _Subscription:
        self._subscriptions[number] = known = low, high, places
        self._low[number], self._high[number] = low, high
        self._longest = max(self._longest, high)
        return known

    def _take(self, content: bytes, at: int, kind: int, size: int) -> bool:
        """Read an entry that is no row; whether it can be one."""
        bounds = _BOUNDS[kind]
        if bounds is None:  # of a later version of the format, which are to be passed over
            self._new_kinds += 1
            can_be = 0 < size < 10_000 and self._new_kinds <= self._MOST_NEW_KINDS
            return can_be and _follows(content, at + _HEAD + size)
        if not bounds[0] <= size <= bounds[1]:
            return False
        if size > self._LONG and not _follows(content, at + _HEAD + size):
            return False
        letter = chr(kind)
        body = content[at + _HEAD : at + _HEAD + size]
        if letter == "P":
            self._take_parameter(body, at)
        elif letter == "O":
            self._pauses.append((at, int.from_bytes(body, "little") * 1e-3))
        elif letter == "A":
            self._take_subscription(body)
        elif letter in "LC":
            self._defining = False
        elif letter == "F" and self._defining and len(self.faults) < self._MOST_FAULTS:
            try:
                self._formats.add(body.decode("utf-8", "ignore"))
            except InputError as error:
                self._fault(body[:80].decode("utf-8", "ignore").partition(":")[0], str(error))
        return letter != "S" or content.startswith(_SYNC, at)

    def _fault(self, name: str, why: str) -> None:
        self.damaged = True
        if len(self.faults) < self._MOST_FAULTS:
            self.faults.setdefault(name, why)

    def _take_parameter(self, body: bytes, at: int) -> None:
        key = body[1 : 1 + body[0]]
        if key not in self._keys:
            kind, _, name = key.decode("utf-8", "ignore").partition(" ")
            self._keys[key] = kind, name
        kind, name = self._keys[key]
        form, value = _VALUES.get(kind), body[1 + len(key) :]
        if form is None or len(value) != form.size or not name or not name.isprintable():
            return
        (number,) = form.unpack(value)
        if not math.isfinite(number):
            return
        if self._defining:
            self.initial[name] = float(number)
        else:
            self._parameters.append((at, name, float(number)))

    def _take_subscription(self, body: bytes) -> None:
        self._defining = False
        multi_id, number = body[0], int.from_bytes(body[1:3], "little")
        name = body[3:].decode("utf-8", "ignore")
        if number in self._learned:
            self._learned.remove(number)
        elif number in self._subscriptions or name in self.faults:
            return
        subscribed = len(self._subscriptions) - len(self._learned)
        if subscribed >= self.MOST_SUBSCRIPTIONS or len(self.faults) >= self._MOST_FAULTS:
            self.damaged = True
            return
        self._search.forget()  # what was found was found without it
        try:
            size = self._formats.size(name) + 2
            padding = self._formats.padding(name)
            if name not in self._wanted or multi_id >= self.MOST_INSTANCES:
                self._subscribe(number, size - padding, size, None)
                return
            rows = self._rows.get((name, multi_id))
            if rows is None:
                layout = self._formats.layout(name)
                rows = _TopicRows(layout, self._kept(name, layout))
                self._rows[name, multi_id] = rows
            self._subscribe(number, size - padding, size, rows.places)
        except InputError as error:
            self._fault(name, str(error))

    def _kept(self, name: str, layout: np.dtype[np.void]) -> np.dtype[np.void]:
        if self._is_read is None:
            return layout
        columns = layout.names or ()
        kept = [c for c in columns if c == "timestamp" or self._is_read(name, c)]
        return np.dtype([(column, layout[column]) for column in kept])

    def _is_cut_short(self, content: bytes, at: int, following: int, kind: int) -> bool:
        """Whether the file ends inside of this entry."""
        end = len(content)
        if following <= end or _BOUNDS[kind] is None:
            return False
        return self._hunt(content, at + 1, end) >= end

    def _hunt(self, content: bytes, at: int, limit: int) -> int:
        """Where the next entry of a window begins, or `limit`."""
        self.damaged = self._hunting = True
        found = self._search.next(at, limit, partial(self._entries_in, content))
        self._hunting = found is None
        return limit if found is None else found

    def _entries_in(self, content: bytes, start: int, stop: int) -> list[int]:
        """What begins an entry in a stretch: rows of known topics and subscriptions."""
        data = np.frombuffer(content, np.uint8)
        count = max(min(stop, len(content) - 5) - start, 0)
        # The upper byte of a length is small, which spares looking at what only holds Ds.
        rows = data[start + 2 : start + 2 + count] == _D
        rows &= data[start + 1 : start + 1 + count] <= self._longest >> 8
        at = np.flatnonzero(rows) + start
        size = data[at] | data[at + 1].astype(np.int32) << 8
        number = data[at + 3] | data[at + 4].astype(np.int32) << 8
        sound = (self._low[number] <= size) & (size <= self._high[number])
        found: list[int] = at[sound & (at + _HEAD + size <= len(content))].tolist()
        letters, upper = data[start + 2 : start + 2 + count], data[start + 1 : start + 1 + count]
        synced = np.flatnonzero((letters == _S) & (upper == 0)) + start
        found += _places_of(_SYNC, data, synced).tolist()
        named = np.flatnonzero((letters == _A) & (upper == 0)) + start
        for name in self._names:
            mine = named[data[named] == 3 + len(name)]
            found += (_places_of(name, data, mine + 6) - 6).tolist()
        return sorted(found)

    def _settle(self, content: bytes) -> None:
        """Copy the rows of a window, and give what has no time that of the rows before it."""
        data = np.frombuffer(content, np.uint8)
        stamps: list[Array] = []
        for rows in self._rows.values():
            if not rows.places:
                continue
            places = np.frombuffer(rows.places, np.int64)
            windows = np.lib.stride_tricks.sliding_window_view(data, rows.layout.itemsize)
            piece = windows[places + _HEAD + 2]
            table: Array = piece.view(rows.layout)[:, 0]
            stamps.append(np.stack([places, table["timestamp"].astype(float)]))
            if rows.kept is not rows.layout:
                kept: Array = np.empty(len(table), rows.kept)
                for name in rows.kept.names or ():
                    kept[name] = table[name]
                table = kept
            rows.table += table.view(np.uint8).data
            del places
            del rows.places[:]
        joined = np.concatenate([np.empty((2, 0)), *stamps], axis=1)
        places, times = joined[:, np.argsort(joined[0])]
        latest = np.maximum.accumulate(np.concatenate([[self._last_us], times]))

        def times_of(entries: list[Any]) -> list[float]:
            at = np.searchsorted(places, [entry[0] for entry in entries])
            seconds: list[float] = (latest[at] * 1e-6).tolist()
            return seconds

        self.changed += [
            (t, name, value)
            for t, (_, name, value) in zip(
                times_of(self._parameters), self._parameters, strict=True
            )
        ]
        self.dropouts += [
            (t, length) for t, (_, length) in zip(times_of(self._pauses), self._pauses, strict=True)
        ]
        self._parameters.clear()
        self._pauses.clear()
        self._last_us = float(latest[-1])


def _follows(content: bytes, at: int) -> bool:
    """Whether two entries, or the end, come next by their headers."""
    for _ in range(2):
        if at >= len(content):
            return at == len(content)
        if at + _HEAD > len(content):
            return False
        size = content[at] | content[at + 1] << 8
        bounds = _BOUNDS[content[at + 2]]
        if bounds is None or not bounds[0] <= size <= bounds[1]:
            return False
        at += _HEAD + size
    return at <= len(content)


def _places_of(text: bytes, data: Array, at: Array) -> Array:
    """Those of some places at which a text begins."""
    at = at[at + len(text) <= len(data)]
    for i, letter in enumerate(text):
        at = at[data[at + i] == letter]
    return at


def _end_without_zeros(path: Path) -> int:
    """Bytes of a log less the zeros behind it, as a power cut leaves them, but for a row's."""
    with open(path, "rb") as file:
        size = end = file.seek(0, 2)
        while end:
            start = max(end - _ZEROS_PIECE, 0)
            file.seek(start)
            piece = file.read(end - start).rstrip(b"\0")
            end = start
            if piece:
                return min(start + len(piece) + 2**16, size)
    return size


_TYPES = {
    "int8_t": "i1", "uint8_t": "u1", "int16_t": "<i2", "uint16_t": "<u2", "int32_t": "<i4",
    "uint32_t": "<u4", "int64_t": "<i8", "uint64_t": "<u8", "float": "<f4", "double": "<f8",
    "bool": "i1", "char": "i1",
}  # fmt: skip


@dataclass(frozen=True)
class _Field:
    kind: str
    count: int | None
    """Of an array; None: a single value."""
    name: str


class Formats:
    """What a log's F entries describe, within bounds."""

    MOST_NESTING = 8
    """Formats inside each other; PX4 nests once."""
    MOST_FIELDS = 1024
    """Of a format; PX4's largest has some 60."""
    MOST_COLUMNS = 1024
    """Of a topic that is read, its arrays laid out."""
    MOST_FORMATS = 4096
    _LONGEST_ROW = 2**16 - 3
    """Bytes; what an entry can hold beside the topic's number."""

    def __init__(self) -> None:
        self._formats: dict[str, tuple[_Field, ...]] = {}
        self._sizes: dict[str, int] = {}
        self._heights: dict[str, int] = {}  # formats inside each other

    def add(self, text: str) -> None:
        """Take up `name:type field;type[4] field;`.

        Raises:
            InputError: it is not of that form, or exceeds a bound.
        """
        if len(self._formats) >= self.MOST_FORMATS:
            raise InputError(f"more than {self.MOST_FORMATS} formats")
        name, colon, rest = text.partition(":")
        if not colon or not name or not name.isprintable():
            raise InputError("a format without a name")
        words = rest.split(";", self.MOST_FIELDS)
        if len(words) > self.MOST_FIELDS:
            raise InputError(f"{name:.80} has more than {self.MOST_FIELDS} fields")
        self._formats[name] = tuple(_field(word, name) for word in words if word)

    def size(self, name: str, depth: int = 0) -> int:
        """Bytes of a row, padding at its end included; the formats cannot change afterwards.

        Raises:
            InputError: it is not described, or nested too deep or longer than an entry can be.
        """
        if name in self._sizes:
            if depth + self._heights[name] > self.MOST_NESTING:
                raise InputError(f"formats nested more than {self.MOST_NESTING} deep")
            return self._sizes[name]
        if name not in self._formats:
            raise InputError(f"no format {name:.80}")
        if depth > self.MOST_NESTING:
            raise InputError(f"formats nested more than {self.MOST_NESTING} deep")
        size = height = 0
        for each in self._formats[name]:
            kind = _TYPES.get(each.kind)
            if kind is None:
                one = self.size(each.kind, depth + 1)
                height = max(height, 1 + self._heights[each.kind])
            else:
                one = np.dtype(kind).itemsize
            size += one * (1 if each.count is None else each.count)
            if size > self._LONGEST_ROW:
                raise InputError(f"rows of {name:.80} longer than an entry can be")
        self._sizes[name], self._heights[name] = size, height
        return size

    def padding(self, name: str) -> int:
        """Bytes at the end of a row that may be missing."""
        size = 0
        for each in reversed(self._formats[name]):
            if not each.name.startswith("_padding"):
                break
            kind = _TYPES.get(each.kind)
            one = self._sizes[each.kind] if kind is None else np.dtype(kind).itemsize
            size += one * (1 if each.count is None else each.count)
        return size

    def layout(self, name: str) -> np.dtype[np.void]:
        """The columns of a row, as `esc[0].esc_rpm`; without the padding at its end.

        Raises:
            InputError: it has too many, two of one name, or no timestamp.
        """
        columns: list[tuple[str, str, int]] = []
        self._lay_out(name, "", 0, columns)
        names, kinds, offsets = zip(*columns, strict=True) if columns else ((), (), ())
        if len(set(names)) < len(names):
            raise InputError(f"{name:.80} has two fields of one name")
        size = self.size(name) - self.padding(name)
        inside = [i for i, offset in enumerate(offsets) if offset < size]
        layout = np.dtype(
            {
                "names": [names[i] for i in inside],
                "formats": [kinds[i] for i in inside],
                "offsets": [offsets[i] for i in inside],
                "itemsize": size,
            }
        )
        if not inside or "timestamp" not in names or layout["timestamp"] != np.dtype("<u8"):
            raise InputError("no timestamp")
        return layout

    def _lay_out(
        self, name: str, prefix: str, offset: int, columns: list[tuple[str, str, int]]
    ) -> None:
        """Each column is at least a byte of the row, so that there is an end to them."""
        for each in self._formats[name]:
            kind = _TYPES.get(each.kind)
            size = self._sizes[each.kind] if kind is None else np.dtype(kind).itemsize
            for i in range(1 if each.count is None else each.count) if size else ():
                column = prefix + each.name + ("" if each.count is None else f"[{i}]")
                if kind is None:
                    self._lay_out(each.kind, column + ".", offset, columns)
                else:
                    columns.append((column, kind, offset))
                if len(columns) > self.MOST_COLUMNS:
                    raise InputError(f"more than {self.MOST_COLUMNS} columns")
                offset += size


def _field(word: str, owner: str) -> _Field:
    kind, _, name = word.partition(" ")
    kind, bracket, count = kind.partition("[")
    digits = count.removesuffix("]")
    if not name.isprintable() or not name or not kind:
        raise InputError(f"{owner:.80} has a field without a name")
    if bracket and not (digits.isascii() and digits.isdigit() and len(digits) < 6):
        raise InputError(f"{owner:.80} has an array of {digits:.20} fields")
    return _Field(kind, int(digits) if bracket else None, name)
