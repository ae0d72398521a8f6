"""Errors that a user can act on: one clear line, no traceback."""

from collections.abc import Iterable

from gcs_sysid.sanitize import one_line


class GcsSysidError(Exception):
    """Base of every error the program raises on purpose.

    The message is the one line a user sees: what is wrong, where, and what to do. It may hold
    what stood in a file or came over a link: as text it is always one printable line.
    """

    def __str__(self) -> str:
        return one_line(super().__str__())


class InputError(GcsSysidError):
    """A file, option or value that cannot be used (exit status 2).

    Args:
        reason: what is wrong and where, or all of the message.
        how: what to do; it follows the reason in the message.
    """

    def __init__(self, reason: str, how: str = "") -> None:
        super().__init__(f"{reason}: {how}" if how else reason)
        self.reason, self.how = reason, how


class LinkError(GcsSysidError):
    """A link that cannot be opened or was lost for good (exit status 2)."""


class NoAnswerError(InputError):
    """Data that can be read and do not allow an answer (exit status 1)."""


def nearest(word: str, known: Iterable[str]) -> str:
    """What to add to a message about an unknown word: `; did you mean mass?`, or nothing."""
    import difflib  # only where something is wrong

    near = difflib.get_close_matches(word, list(known), 1)
    return f"; did you mean {near[0]}?" if near else ""
