"""Messages of ROS 2 as columns: what their definitions (.msg) say of their bytes (CDR).

Where a field is depends on the lengths of strings and sequences before it. Messages whose lengths
are alike have one layout, found along the first of them; NumPy then reads all as rows of one array.
Definitions and lengths are a file's own word: a layout never leaves its message, and the steps of
finding it are bounded.
"""

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError

_TYPES = {
    "bool": "u1", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2",
    "uint16": "u2", "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4",
    "float64": "f8",
}  # fmt: skip
_TIMES = {"builtin_interfaces/Time", "builtin_interfaces/Duration"}
_SECTION = re.compile(r"^=+[ \t]*\r?\nMSG:[ \t]*([\w/]+)[ \t]*$", re.MULTILINE)
_FIELD = re.compile(
    r"([A-Za-z][\w/]*)(?:<=\d+)?(?:\[(<=[0-9]*|[0-9]{0,9})\])?\s+([A-Za-z]\w*)\s*(=?)"
)


@dataclass(frozen=True)
class _MessageField:
    kind: str
    name: str
    count: int | None
    """Of an array; 0: a sequence; None: a single value."""


_Types = Mapping[str, tuple[_MessageField, ...]]


def short_type(name: str) -> str:
    """`px4_msgs/EscStatus` of `px4_msgs/msg/EscStatus`."""
    return name.replace("/msg/", "/", 1)


def _definitions(name: str, text: str) -> _Types:
    """Type -> its fields, of a message's definition, which those of the types in it follow.

    Raises:
        InputError: a line is no field.
    """
    first, *others = _SECTION.split(text)
    sections = {name: first, **dict(zip(others[::2], others[1::2], strict=True))}
    return {
        short_type(kind): tuple(_fields(short_type(kind), content))
        for kind, content in sections.items()
    }


def _fields(owner: str, text: str) -> Iterator[_MessageField]:
    for line in text.splitlines():
        content = line.partition("#")[0].strip()
        found = _FIELD.match(content)
        if found is None:
            if content:
                raise InputError(f"{owner:.80}: {content[:40]!r} is no field")
            continue
        kind, size, name, is_constant = found.groups()
        if is_constant:
            continue
        if kind == "Header":
            kind = "std_msgs/Header"
        elif "/" not in kind and kind not in _TYPES and kind not in ("string", "wstring"):
            kind = f"{owner.rpartition('/')[0]}/{kind}"
        count = None if size is None else int(size) if size.isdecimal() else 0
        yield _MessageField(short_type(kind), name, count)


class _Layout:
    """Where the fields of a message are.

    Attributes:
        columns: (name, type, offset) of those that are read.
        lengths: bytes that other messages must share to be laid out so.
        steps: fields and elements that may be looked at yet.
    """

    MOST_NESTING = 8
    MOST_COLUMNS = 1024
    """As of a .ulg's topic."""

    def __init__(
        self, types: _Types, message: bytes, is_read: Callable[[str], bool], steps: int
    ) -> None:
        self.columns: list[tuple[str, str, int]] = []
        self.lengths = [0, 1]
        self.steps = steps
        self._types, self._message, self._is_read = types, message, is_read
        self._order = "<"
        self._at = 4

    def find(self, root: str) -> None:
        """Find the fields of a message of a type.

        Raises:
            InputError: the message does not fit its definition.
        """
        if self._message[:1] != b"\0" or self._message[1:2] not in (b"\0", b"\1"):
            raise InputError("messages that are not plain CDR, perhaps compressed")
        self._order = "<" if self._message[1] else ">"
        self._lay_out(root, "", 0)

    def _lay_out(self, kind: str, prefix: str, depth: int) -> None:
        fields = self._types.get(kind)
        if fields is None or depth > self.MOST_NESTING:
            why = "no definition of" if fields is None else "too many types inside of each other:"
            raise InputError(f"{why} {kind:.80}")
        if not fields:
            self._pass(1)  # IDL knows no empty type
        for each in fields:
            name = prefix + each.name
            many = each.count is not None
            count = 1 if each.count is None else each.count or self._length()
            if each.kind in _TYPES:
                self._take(name, _TYPES[each.kind], count, many=many)
                continue
            for i in range(count):
                element = f"{name}[{i}]" if many else name
                if each.kind in _TIMES:
                    self._take(f"{element}.sec", "i4", 1, many=False)
                    self._take(f"{element}.nanosec", "u4", 1, many=False)
                elif each.kind == "string":
                    self._pass(self._length())
                else:
                    self._lay_out(each.kind, f"{element}.", depth + 1)

    def _take(self, name: str, kind: str, count: int, *, many: bool) -> None:
        size = int(kind[1])
        start = self._align(size) if count else self._at
        self._pass(size * count)
        if self._is_read(name):
            if len(self.columns) + count > self.MOST_COLUMNS:
                raise InputError(f"messages with more than {self.MOST_COLUMNS} fields of interest")
            for i in range(count):
                column = f"{name}[{i}]" if many else name
                self.columns.append((column, self._order + kind, start + size * i))

    def _length(self) -> int:
        start = self._align(4)
        self._pass(4)
        self.lengths += range(start, self._at)
        length: int = np.frombuffer(self._message, f"{self._order}u4", 1, start)[0].item()
        return length

    def _align(self, size: int) -> int:
        self._at += -(self._at - 4) % size
        return self._at

    def _pass(self, size: int) -> None:
        self._step()
        self._at += size
        if self._at > len(self._message):
            raise InputError("messages shorter than their definition")

    def _step(self) -> None:
        self.steps -= 1
        if self.steps < 0:
            raise InputError("messages with too many fields")


class MessageColumns:
    """The numbers in the messages of a topic.

    Args:
        name: of the messages' type.
        text: its definition.
        is_read: whether a field is, arrays by the name without an index.

    Attributes:
        count: messages added.
        unread: why messages were not read -> how many.

    Raises:
        InputError: the definition cannot be understood.
    """

    PIECE = 2**22
    """Bytes of messages that become columns together."""
    MOST_LAYOUTS = 100
    """Different ones in a piece."""
    MOST_STEPS = 20_000
    """Of all layouts of a piece."""

    def __init__(self, name: str, text: str, is_read: Callable[[str], bool]) -> None:
        self._types, self._root = _definitions(name, text), short_type(name)
        self._is_read = is_read
        self._waiting: list[bytes] = []
        self._times: list[int] = []
        self._size = 0
        self._pieces: list[dict[str, Array]] = []
        self.count = 0
        self.unread: dict[str, int] = {}

    def add(self, message: bytes, time: int) -> None:
        """Take up a message, recorded at a time in ns."""
        self.count += 1
        self._waiting.append(message)
        self._times.append(time)
        self._size += len(message)
        if self._size > self.PIECE:
            self._settle()

    def _settle(self) -> None:
        messages, times = self._waiting, 1e-9 * np.array(self._times, float)
        self._waiting, self._times, self._size = [], [], 0
        sizes = np.array([len(message) for message in messages])
        groups = [np.flatnonzero(sizes == size) for size in np.unique(sizes).tolist()]
        steps = self.MOST_STEPS
        for _ in range(self.MOST_LAYOUTS):
            if not groups:
                return
            rows = groups.pop()
            alike = [messages[i] for i in rows.tolist()]
            data = np.frombuffer(b"".join(alike), np.uint8).reshape(len(rows), len(alike[0]))
            layout = _Layout(self._types, alike[0], self._is_read, steps)
            fault = ""
            try:
                layout.find(self._root)
            except InputError as error:
                fault = str(error)
            steps = layout.steps
            shared = [at for at in layout.lengths if at < data.shape[1]]
            same = (data[:, shared] == data[0, shared]).all(axis=1)
            if fault:
                self._leave_out(fault, int(same.sum()))
            else:
                piece = {name: _column(data[same], kind, at) for name, kind, at in layout.columns}
                self._pieces.append({"log_time": times[rows[same]], **piece})
            if not same.all():
                groups.append(rows[~same])
        self._leave_out("messages too different from each other", sum(map(len, groups)))

    def _leave_out(self, why: str, count: int) -> None:
        if count and (why in self.unread or len(self.unread) < self.MOST_LAYOUTS):
            self.unread[why] = self.unread.get(why, 0) + count

    def columns(self) -> dict[str, Array]:
        """Field -> (n,) values, NaN where a message has none; times in s, `log_time` too."""
        self._settle()
        columns: dict[str, Array] = {}
        for name in dict.fromkeys(name for piece in self._pieces for name in piece):
            columns[name] = np.concatenate(
                [
                    piece[name] if name in piece else np.full(len(piece["log_time"]), np.nan)
                    for piece in self._pieces
                ]
            )
            whole, _, last = name.rpartition(".")
            if last == "nanosec":
                columns[whole] = columns[f"{whole}.sec"] + 1e-9 * columns[name]
        return columns


class JsonColumns:
    """The same of messages in JSON."""

    def __init__(self, is_read: Callable[[str], bool]) -> None:
        self._is_read = is_read
        self._rows: list[dict[str, float]] = []
        self.count = 0
        self.unread: dict[str, int] = {}

    def add(self, message: bytes, time: int) -> None:
        """As of `MessageColumns`."""
        self.count += 1
        try:
            found = {
                name: float(value)
                for name, value in json.loads(message).items()
                if isinstance(value, int | float) and self._is_read(name)
            }
            self._rows.append({"log_time": 1e-9 * time, **found})
        except (ValueError, AttributeError, RecursionError, OverflowError):
            why = "messages that are no JSON object"
            self.unread[why] = self.unread.get(why, 0) + 1

    def columns(self) -> dict[str, Array]:
        """As of `MessageColumns`."""
        names = dict.fromkeys(name for row in self._rows for name in row)
        return {name: np.array([row.get(name, math.nan) for row in self._rows]) for name in names}


def _column(data: Array, kind: str, at: int) -> Array:
    """(n,) numbers at a place of (n, size) bytes."""
    size = int(kind[-1])
    column: Array = np.ascontiguousarray(data[:, at : at + size]).view(kind)[:, 0]
    return column
