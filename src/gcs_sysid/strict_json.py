"""JSON as RFC 8259 has it: numbers are finite, read and written.

Every document of the program passes through here, so that no infinity, wherever it comes from,
costs a user the numbers beside it, and none enters by a file.
"""

import json
import math
from typing import Any, NoReturn

from gcs_sysid.errors import InputError


def json_text(
    document: object, indent: int | None = None, separators: tuple[str, str] | None = None
) -> str:
    """A document as JSON. A number that is not finite is unknown: null.

    Args:
        document: of dicts, lists, text and numbers.
        indent: spaces for each level; None: all in one line.
        separators: between items, and between names and values.
    """
    try:
        return json.dumps(document, indent=indent, separators=separators, allow_nan=False)
    except ValueError:
        known = _finite(document)
        return json.dumps(known, indent=indent, separators=separators, allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {name: _finite(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(part) for part in value]
    return value


def parse_json(text: str, where: str) -> Any:
    """The document in a text: all of it, or its last line where every line is one.

    `where` is the file's name, for messages.

    Raises:
        InputError: it is no JSON, or has numbers that are not finite.
    """

    def refuse(word: str) -> NoReturn:
        raise InputError(f"{where}: not strict JSON: {word} in it")

    def finite(digits: str) -> float:
        number = float(digits)
        return number if math.isfinite(number) else refuse(f"{digits[:20]}, which is too large,")

    def loads(part: str) -> Any:
        return json.loads(part, parse_constant=refuse, parse_float=finite)

    try:
        try:
            return loads(text)
        except json.JSONDecodeError as error:
            if not error.msg.startswith("Extra data"):
                raise
            return loads(text.rstrip().rpartition("\n")[2])
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: not valid JSON: {error}") from error
