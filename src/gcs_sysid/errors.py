"""Errors that a user can act on: one clear line, no traceback."""


class GcsSysidError(Exception):
    """Base of every error the program raises on purpose.

    The message is the one line a user sees: what is wrong, where, and what to do.
    """


class InputError(GcsSysidError):
    """A file, option or value that cannot be used (exit status 2)."""


class LinkError(GcsSysidError):
    """A link that cannot be opened or was lost for good (exit status 2)."""
