"""What both command lines share: one-line usage errors and checked numbers."""

import argparse
import math
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
