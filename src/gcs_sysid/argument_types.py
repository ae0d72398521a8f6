"""What both command lines share: one-line usage errors and checked numbers."""

import argparse
import math
import re
from collections.abc import Callable
from typing import Any, NoReturn

from gcs_sysid.errors import nearest
from gcs_sysid.sanitize import one_line


class OneLineParser(argparse.ArgumentParser):
    """Reports wrong usage as one line and exit status 2, with the nearest word that is known."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse, but each command refuses options that it does not know itself."""
        found, extra = super().parse_known_args(args, namespace)
        if extra:
            near = nearest(extra[0].partition("=")[0], self._option_string_actions)
            self.error(f"unrecognized arguments: {' '.join(extra)}{near}")
        return found, extra

    def _get_value(self, action: argparse.Action, arg_string: str) -> Any:
        """A value; an empty one is a variable that was never set, and what it asks for lost."""
        if not arg_string and action.nargs != argparse.PARSER:
            raise argparse.ArgumentError(action, "must not be empty")
        return super()._get_value(action, arg_string)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """A choice; one that is misspelt is answered with the nearest."""
        if action.choices is not None and value not in action.choices:
            near = nearest(str(value), map(str, action.choices))
            listed = "" if near else f" (choose from {', '.join(map(str, action.choices))})"
            raise argparse.ArgumentError(action, f"invalid choice: {value!r}{near}{listed}")

    def error(self, message: str) -> NoReturn:
        """Say it and stop."""
        said = one_line(message)
        self.exit(2, f"{self.prog.split()[0]}: error: {said}; see {self.prog} --help\n")


class AppendNamed(argparse.Action):
    """Appends (name, ...) as "append" does, and refuses a name that was given before."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        """Append one; of two for a name, one would be ignored."""
        before = getattr(namespace, self.dest)
        if any(values[0] == name for name, *_ in before):
            raise argparse.ArgumentError(self, f"{values[0]} is given twice")
        setattr(namespace, self.dest, [*before, values])


def number(text: str) -> float:
    """An argparse type: a finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"must be a number, got {text!r}")
    return value


def baud(text: str) -> int:
    """An argparse type: the baud rate of a serial port."""
    if not text.isdecimal() or not 1 <= len(text) <= 8 or int(text) == 0:
        raise argparse.ArgumentTypeError(f"must be a baud rate such as 57600, got {text!r}")
    return int(text)


def positive(text: str) -> float:
    """An argparse type: a finite number above zero."""
    value = number(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f"must be positive, got {text!r}")
    return value


def not_negative(text: str) -> float:
    """An argparse type: a finite number, zero or more."""
    value = number(text)
    if value < 0.0:
        raise argparse.ArgumentTypeError(f"must not be negative, got {text!r}")
    return value


def between(least: float, most: float, unit: str) -> Callable[[str], float]:
    """An argparse type: a number from `least` to `most` of a unit."""

    def checked(text: str) -> float:
        value = number(text)
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(
                f"must lie between {least:g} and {most:g} {unit}, got {text!r}"
            )
        return value

    return checked


class Measured(float):
    """A number, with the standard deviation that was given behind it as it was written, or None."""

    sigma: str | None = None


def measured(check: Callable[[str], float]) -> Callable[[str], Measured]:
    """An argparse type: VALUE or VALUE±STD, the latter perhaps in percent; +- and +/- do as well.

    Args:
        check: the type of the value.
    """

    def checked(text: str) -> Measured:
        value, sign, sigma = _plus_minus(text)
        out = Measured(check(value))
        if sign:
            if not _SIGMA.fullmatch(sigma):
                raise argparse.ArgumentTypeError(
                    f"must be VALUE or VALUE±STD (or +-), such as 0.25+-0.003 or 0.25+-1%, "
                    f"got {text!r}"
                )
            out.sigma = sigma
        return out

    return checked


_SIGMA = re.compile(r"(\d+\.?\d*|\.\d+)(e[+-]?\d+)?\s*%?", re.IGNORECASE | re.ASCII)


def _plus_minus(text: str) -> tuple[str, str, str]:
    """The text before and after ±, and that sign; empty where there is none."""
    for sign in ("+/-", "+-"):
        text = text.replace(sign, "±")
    value, sign, std = text.partition("±")
    return value.strip(), sign, std.strip()


def split_prior(text: str) -> tuple[str, str, str] | None:
    """Name, value and standard deviation of NAME=VALUE±STD; +- and +/- do as well."""
    name, equals, rest = text.partition("=")
    value, plus_minus, std = _plus_minus(rest)
    return (name.strip(), value, std) if equals and plus_minus else None
