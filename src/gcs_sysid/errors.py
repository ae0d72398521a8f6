"""Errors that a user can act on: one clear line, no traceback; text of others made harmless.

A vehicle, a file or its name can hold anything: escape sequences that recolor, clear or write
to a terminal, line breaks that forge lines, marks that turn text around. Shown are their codes.
"""

from collections.abc import Iterable
from importlib import import_module
from typing import Any

LONGEST_LINE = 1000
"""Characters; the middle of a longer line is left out."""


def printable(text: str) -> str:
    """Text that moves no cursor: characters that print nothing become their codes."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def one_line(text: str) -> str:
    """One printable line of bearable length."""
    text = printable(text)
    if len(text) > LONGEST_LINE:
        half = LONGEST_LINE // 2 - 3
        text = f"{text[:half]} ... {text[-half:]}"
    return text


def in_words(defect: BaseException) -> str:
    """One line about an unforeseen error."""
    return one_line(f"internal error ({type(defect).__name__}: {' '.join(str(defect).split())})")


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


_EXTRAS = {
    "pyarrow": "fleet", "distributed": "cluster", "mcap": "mcap", "pandas": "notebook",
    "matplotlib": "notebook",
}  # fmt: skip
"""Library -> the optional dependencies of this package that it is among."""


def needed(module: str, purpose: str) -> Any:
    """A module of an optional library, loaded.

    `purpose` is what the library is needed for, in words.

    Raises:
        InputError: it is not installed.
    """
    library = module.partition(".")[0]
    try:
        return import_module(module)
    except ImportError as error:
        extra = _EXTRAS[library]
        raise InputError(f'{purpose} needs {library}: pip install "gcs-sysid[{extra}]"') from error


def nearest(word: str, known: Iterable[str]) -> str:
    """What to add to a message about an unknown word: `; did you mean mass?`, or nothing."""
    import difflib  # only where something is wrong

    near = difflib.get_close_matches(word, list(known), 1)
    return f"; did you mean {near[0]}?" if near else ""


def authority(host: str, port: int) -> str:
    """Host and port as in an address."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
