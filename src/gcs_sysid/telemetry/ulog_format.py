"""Topics of a .ulg: formats with fields, which may be other formats or arrays.

Definitions are a file's own word, and nothing is allocated on it before it is bounded: a row is
no longer than an entry can be, and how long it is follows from the formats without laying them
out.
"""

from dataclasses import dataclass

import numpy as np

from gcs_sysid.errors import InputError

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
