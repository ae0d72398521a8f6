"""What both command lines share: one-line usage errors and checked numbers."""

import argparse
import math
from collections.abc import Callable
from typing import NoReturn


class OneLineParser(argparse.ArgumentParser):
    """Reports wrong usage as one line and exit status 2."""

    def error(self, message: str) -> NoReturn:
        """Say it and stop."""
        self.exit(2, f"{self.prog.split()[0]}: error: {message}; see {self.prog} --help\n")


def number(text: str) -> float:
    """An argparse type: a finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"must be a number, got {text!r}")
    return value


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


def split_prior(text: str) -> tuple[str, str, str] | None:
    """Name, value and standard deviation of NAME=VALUE±STD; +- and +/- do as well."""
    name, equals, rest = text.partition("=")
    for sign in ("+/-", "+-"):
        rest = rest.replace(sign, "±")
    value, plus_minus, std = rest.partition("±")
    return (name.strip(), value.strip(), std.strip()) if equals and plus_minus else None
