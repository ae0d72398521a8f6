"""What users ask of a running session, from threads of their own."""

import queue
from collections.abc import Callable

from gcs_sysid.errors import GcsSysidError, InputError

_MOST = 64
"""Commands that wait; who asks faster is refused."""


class CommandQueue:
    """Commands of users, which wait until the session's thread carries them out."""

    def __init__(self) -> None:
        self._waiting: queue.Queue[Callable[[], None]] = queue.Queue(_MOST)

    def ask(self, command: Callable[[], None]) -> None:
        """Have something done in the session's thread.

        Raises:
            InputError: too much waits to be done.
        """
        try:
            self._waiting.put_nowait(command)
        except queue.Full:
            raise InputError("the session is busy: try again") from None

    @property
    def is_empty(self) -> bool:
        """Whether it holds no commands."""
        return self._waiting.empty()

    def grant(self, note: Callable[[str], None]) -> Exception | None:
        """Carry out the requests. One that fails is reported, and the session continues.

        Args:
            note: called with what could not be done.

        Returns:
            The first defect, if one was met.
        """
        first: Exception | None = None
        while not self.is_empty:
            try:
                self._waiting.get()()
            except (GcsSysidError, OSError) as error:
                note(f"not done: {error}")
            except Exception as defect:  # noqa: BLE001 - the flight goes on all the same
                first = first or defect
                note(f"not done: {in_words(defect)}")
        return first


def in_words(defect: Exception) -> str:
    """One line about an unforeseen error."""
    return f"internal error ({type(defect).__name__}: {defect})"
