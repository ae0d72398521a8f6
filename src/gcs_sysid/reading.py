"""Files that are read whole: not before their size is known to be bearable."""

import stat
from pathlib import Path

from gcs_sysid.errors import InputError


def check_regular(path: Path) -> None:
    """See that a path leads to a file, which is as long as it says and ends.

    A pipe that nobody writes to would hold the program up for ever, a device has no end.

    Raises:
        InputError: it leads to a pipe or a device.
        OSError: it leads nowhere.
    """
    if not stat.S_ISREG(path.stat().st_mode):
        raise InputError(
            f"{path} is a pipe or a device: save what it gives as a file, and give that"
        )


def read_bytes(path: Path, most: int, what: str) -> bytes:
    """All of a file.

    Args:
        path: of it.
        most: bytes that it may have; devices and pipes, which tell no size, are held to it too.
        what: it is, for messages, such as "the airframe file".

    Raises:
        InputError: it cannot be read, or is larger.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(most + 1)
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot read {what}: {reason}") from error
    if len(data) > most:
        raise InputError(f"{path}: too large for {what}: more than {most:,} bytes")
    return data


def read_text(path: Path, most: int, what: str) -> str:
    """All of a file of UTF-8 text; the line ends become newlines.

    Raises:
        InputError: as of `read_bytes`, or it is no text.
    """
    try:
        text = read_bytes(path, most, what).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot read {what}: not UTF-8 text") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")
