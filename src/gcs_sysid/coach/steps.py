"""Work in steps of some milliseconds, for a thread that has other things to do meanwhile."""

from collections.abc import Generator
from typing import TypeVar

T = TypeVar("T")

Steps = Generator[None, None, T]
"""Yields between steps; what it returns is the outcome."""


def finished(steps: Steps[T]) -> T:
    """The outcome, all steps done at once."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            outcome: T = end.value
            return outcome
