"""Work in steps of some milliseconds, for a thread that has other things to do meanwhile."""

from collections import deque
from collections.abc import Callable, Generator
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
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


def at_once(in_steps: Callable[P, Steps[T]]) -> Callable[P, T]:
    """The same function or method, but all steps done at once."""

    @wraps(in_steps)
    def whole(*arguments: P.args, **options: P.kwargs) -> T:
        return finished(in_steps(*arguments, **options))

    return whole


class Pending:
    """Work that waits its turn: done in the order in which it came, in steps or all at once.

    Args:
        most: pieces of work that wait; for more, the oldest are finished at once.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._pieces: deque[Steps[None]] = deque()

    def __len__(self) -> int:
        """How many pieces are not finished."""
        return len(self._pieces)

    def add(self, piece: Steps[None]) -> None:
        """Have another piece of work done after all the others."""
        self._pieces.append(piece)
        while len(self._pieces) > self._most:
            finished(self._pieces.popleft())

    def step(self) -> bool:
        """Do one step; whether there is anything left to do."""
        if self._pieces:
            try:
                next(self._pieces[0])
            except StopIteration:
                self._pieces.popleft()
        return bool(self._pieces)

    def finish(self) -> None:
        """Do all of it."""
        while self._pieces:
            finished(self._pieces.popleft())

    def drop(self) -> None:
        """Leave undone what is left."""
        self._pieces.clear()
