"""Things that the command line switches on by NAME[=VALUE], again and again: traps, link faults."""

import argparse
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from gcs_sysid.argument_types import between, not_negative, positive
from gcs_sysid.telemetry.dialect import mavlink


@dataclass(frozen=True)
class Kind:
    """How one is written.

    Attributes:
        says: what it does.
        parse: makes its value of the text after the =; None for one without a value.
        unit: of the value, as help shows it.
        usual: the text taken when none is given; None when one must be.
    """

    says: str
    parse: Callable[[str], Any] | None = None
    unit: str = ""
    usual: str | None = None


@dataclass(frozen=True)
class Span:
    """A while, once or again and again.

    Attributes:
        start: s after the start of the flight.
        length: s.
        every: s from one beginning to the next; 0: once.
    """

    start: float
    length: float
    every: float = 0.0

    def holds(self, t: float) -> bool:
        """Whether it is on, t seconds after the start of the flight."""
        since = t - self.start
        return since >= 0.0 and (since % self.every if self.every else since) < self.length


LATEST = 1e7
"""s: beyond it no flight goes on; that is 115 days."""


def moment(text: str) -> float:
    """A type of value: s from the start of the flight, above zero."""
    value = positive(text)
    if value > LATEST:
        raise argparse.ArgumentTypeError(f"must be at most {LATEST:g} s, got {text!r}")
    return value


def share(text: str) -> float:
    """A type of value: 0 to 1."""
    value = not_negative(text)
    if value > 1.0:
        raise argparse.ArgumentTypeError(f"must be a share from 0 to 1, got {text!r}")
    return value


def milliseconds(text: str) -> float:
    """A type of value: 0 to 1000 ms, as s."""
    value = not_negative(text)
    if value > 1000.0:
        raise argparse.ArgumentTypeError(f"must be 0 to 1000 ms, got {text!r}")
    return 1e-3 * value


def whole(most: int) -> Callable[[str], int]:
    """A type of value: a whole number from 1 to `most`."""

    def parse(text: str) -> int:
        if not re.fullmatch("[0-9]{1,9}", text) or not 0 < int(text) <= most:
            raise argparse.ArgumentTypeError(f"must be a whole number 1..{most}, got {text!r}")
        return int(text)

    return parse


def message_number(text: str) -> int:
    """The number of a message, from its name in the dialect."""
    found = getattr(mavlink, f"MAVLINK_MSG_ID_{text}", None)
    if not isinstance(found, int):
        raise argparse.ArgumentTypeError(f"no message {text!r} in the dialect")
    return found


def span(text: str) -> Span:
    """A type of value: FROM:S or FROM:S:EVERY, all in s."""
    parts = text.split(":")
    if len(parts) not in (2, 3):
        raise argparse.ArgumentTypeError(f"write FROM:S or FROM:S:EVERY, got {text!r}")
    every = positive(parts[2]) if len(parts) == 3 else 0.0
    return Span(not_negative(parts[0]), positive(parts[1]), every)


def named_spans(text: str) -> tuple[tuple[int, Span], ...]:
    """A type of value: MESSAGE:FROM:S or MESSAGE:FROM:S:EVERY; one, to be added to others."""
    name, _, rest = text.partition(":")
    return ((message_number(name), span(rest)),)


def two(
    first: Callable[[str], Any], second: Callable[[str], Any], written: str
) -> Callable[[str], tuple[Any, Any]]:
    """A type of value: two of them with a colon between."""

    def parse(text: str) -> tuple[Any, Any]:
        a, colon, b = text.partition(":")
        if not colon:
            raise argparse.ArgumentTypeError(f"write {written}, got {text!r}")
        return first(a), second(b)

    return parse


def seconds(text: str) -> float:
    """A type of value: s, of either sign."""
    return between(-LATEST, LATEST, "s")(text)


def parse_choice(text: str, kinds: Mapping[str, Kind], word: str) -> tuple[str, Any]:
    """The name of a field and its value, for NAME or NAME=VALUE.

    Args:
        text: as written.
        kinds: by name.
        word: what they are called.

    Raises:
        argparse.ArgumentTypeError: there is none of that name, or its value makes no sense.
    """
    name, equals, value = text.partition("=")
    kind = kinds.get(name)
    if kind is None:
        raise argparse.ArgumentTypeError(f"no {word} {name!r}; there are {', '.join(kinds)}")
    field = name.replace("-", "_")
    if kind.parse is None:
        if equals:
            raise argparse.ArgumentTypeError(f"{name} takes no value")
        return field, True
    if not equals and kind.usual is None:
        raise argparse.ArgumentTypeError(f"write {name}={kind.unit}")
    try:
        return field, kind.parse(value if equals else kind.usual or "")
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(f"{name}: {error}") from error


T = TypeVar("T")


def gather(none: T, parsed: Iterable[tuple[str, Any]], added: frozenset[str]) -> T:
    """All that were chosen, together.

    Args:
        none: dataclass with none of them.
        parsed: of `parse_choice`; of a field given twice the last counts.
        added: fields whose values, tuples, add up instead.
    """
    for field, value in parsed:
        if field in added:
            value = getattr(none, field) + value
        none = replace(none, **{field: value})  # type: ignore[type-var]
    return none


def choice_help(kinds: Mapping[str, Kind]) -> str:
    """One line each, for --help."""
    lines = []
    for name, kind in kinds.items():
        value = f"={kind.unit}" if kind.unit and kind.usual is None else f"[={kind.unit}]"
        usual = f" ({kind.usual})" if kind.usual else ""
        lines.append(f"  {name + value if kind.unit else name:<26} {kind.says}{usual}")
    return "\n".join(lines)
