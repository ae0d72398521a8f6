"""Files read within bounds, and written whole or not at all; standard streams."""

import contextlib
import errno
import hashlib
import io
import os
import select
import stat
import sys
import tempfile
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from gcs_sysid.errors import InputError, nearest

_WRITER_WITHIN = 2.0
"""s after which a pipe without a writer is given up."""
_STRICT = ("strict", "surrogateescape")
"""Ways to fail at a sign that an encoding lacks; the latter is what Python does in LANG=C."""


def never_fail_to_print() -> None:
    """A sign that standard output's encoding lacks (cp1252, ASCII) becomes a question mark.

    What was closed before the start, as by `>&-`, leads nowhere.
    """
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors in _STRICT:
            stream.reconfigure(errors="replace")


def check_regular(path: Path) -> None:
    """See that a path leads to a file, which is as long as it says and ends.

    A pipe without a writer would block the program for ever, a device has no end.

    Raises:
        InputError: it leads to a pipe or a device.
        OSError: it leads nowhere.
    """
    if not stat.S_ISREG(path.stat().st_mode):
        raise InputError(f"{path} is a pipe or a device: save its data to a file first")


def split_session(path: Path) -> tuple[Path, int | None]:
    """A file, and which of its sessions: `LOG.bbl#2` is the second one of LOG.bbl."""
    name, mark, number = path.name.rpartition("#")
    if not (mark and name and number.isdecimal() and len(number) < 5) or path.exists():
        return path, None
    return path.with_name(name), int(number)


MAPPING_FILE = "columns.toml"
"""Says what the columns of the tables in its folder are."""
TABLE_SUFFIXES = frozenset({".csv", ".tsv", ".parquet"})
PACKED_SUFFIXES = frozenset({".gz", ".zip"})
BAG_SUFFIXES = (".mcap", ".db3")
"""Of recordings of ROS 2, which may have a mapping too."""


def is_table(path: Path) -> bool:
    """Whether a file is named as a table of signals, packed or not."""
    named = path.with_suffix("") if path.suffix.lower() in PACKED_SUFFIXES else path
    return named.suffix.lower() in TABLE_SUFFIXES


def is_bag_folder(path: Path) -> bool:
    """Whether a folder is what `ros2 bag record` makes."""
    return path.is_dir() and (path / "metadata.yaml").is_file()


def files_of(log: Path) -> list[Path]:
    """The file of a log, or those of the folder that it is in."""
    if not log.is_dir():
        return [log]
    return sorted(file for file in log.iterdir() if file.suffix in BAG_SUFFIXES)


def digest_of(log: Path, more: bytes = b"") -> tuple[str, int]:
    """SHA-256 of a log and what else its reading depends on; and the log's bytes.

    Raises:
        OSError: it cannot be read.
    """
    digest, size = hashlib.sha256(), 0
    for path in files_of(log):
        with open(path, "rb") as file:
            while piece := file.read(2**20):
                digest.update(piece)
                size += len(piece)
    digest.update(more)
    return digest.hexdigest(), size


def split_mapping(path: Path) -> tuple[Path, Path | None]:
    """A table of signals and its mapping file; None for what is no such table.

    `flight.csv#map.toml` names the mapping, from the table's folder unless it is absolute; else
    `columns.toml` beside the table is it.
    """
    name, mark, mapping = str(path).rpartition("#")
    if mark and name and mapping.endswith(".toml") and not path.exists():
        return Path(name), Path(name).parent / mapping
    beside = path.parent / MAPPING_FILE
    if is_table(path) and beside.is_file():
        return path, beside
    return path, None


def with_mapping(path: Path, mapping: Path) -> Path:
    """A table's name with that of its mapping; what is no table stays as it is."""
    if not (is_table(path) or path.suffix.lower() in BAG_SUFFIXES or is_bag_folder(path)):
        return path
    near = mapping.absolute().parent == path.absolute().parent
    return Path(f"{path}#{mapping.name if near else mapping.absolute()}")


def split_log(path: Path) -> tuple[Path, int | None, Path | None]:
    """The file of a log, and its session or the mapping that it may be named with."""
    table, mapping = split_mapping(path)
    return (*split_session(path), None) if mapping is None else (table, None, mapping)


def log_file(path: Path) -> Path:
    """The file of a log that may be named with a session or a mapping."""
    return split_log(path)[0]


def unreadable(path: Path, error: OSError | ValueError) -> str:
    """Why a file cannot be read, with the nearest name in its folder where there is none of its."""
    reason = getattr(error, "strerror", None) or str(error)
    if not isinstance(error, FileNotFoundError):
        return reason
    with contextlib.suppress(OSError):
        near = nearest(path.name, (entry.name for entry in os.scandir(path.parent)))
        return f"{reason}{near}"
    return f"{reason}: there is no folder {path.parent}"


def read_bytes(path: Path, what: str, most: int) -> bytes:
    """All of a file.

    Args:
        path: of it.
        what: it is, for messages, such as "the airframe file".
        most: bytes that it may have; devices and pipes, which report no size, are held to it too.

    Raises:
        InputError: it cannot be read, or is larger, or a pipe without a writer.
    """
    try:
        with open(path, "rb", opener=_open_written) as file:
            data = file.read(most + 1)
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        raise InputError(f"{path}: cannot read {what}: {unreadable(path, error)}") from error
    if len(data) > most:
        raise InputError(f"{path}: too large for {what}: more than {most:,} bytes")
    return data


def _open_written(path: str, flags: int) -> int:
    """Open a file to read, without waiting for ever for the writer of a pipe.

    Raises:
        OSError: it cannot be opened, or is a pipe without a writer.
    """
    if not hasattr(os, "O_NONBLOCK"):  # Windows has no pipes among its files
        return os.open(path, flags)
    handle = os.open(path, flags | os.O_NONBLOCK)
    try:
        if stat.S_ISFIFO(os.fstat(handle).st_mode):
            _wait_for_writer(handle)
        os.set_blocking(handle, True)
    except BaseException:
        os.close(handle)
        raise
    return handle


def _wait_for_writer(pipe: int) -> None:
    if select.select([pipe], [], [], _WRITER_WITHIN)[0]:
        return
    with contextlib.suppress(BlockingIOError):  # there is a writer who has not written yet
        os.read(pipe, 1)
        raise OSError(errno.EPIPE, "a pipe without a writer")


MOST_BYTES_OF_TEXT = 5_000_000
"""Of a text that people write, or programs for them."""


def read_text(path: Path, what: str, most: int = MOST_BYTES_OF_TEXT) -> str:
    """All of a file of UTF-8 text; the line ends become newlines. Arguments are of `read_bytes`.

    Raises:
        InputError: as of `read_bytes`, or it is no text.
    """
    try:
        text = read_bytes(path, what, most).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot read {what}: not UTF-8 text") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def parse_toml(text: str, where: str, what: str) -> dict[str, Any]:
    """The table of a TOML file.

    `what` is what the file is to be, such as "a mapping file"; `where` is named in errors.

    Raises:
        InputError: it is not valid, or would take for ever to read.
    """
    # tomllib needs the cube of a dotted key's parts; 64 rotors in a line have some 200 dots.
    dots, most = [line.count(".") for line in text.splitlines()], 1000
    if max(dots, default=0) > most:
        raise InputError(f"{where}: not {what}: a line with more than {most} dots")
    if sum(n * n for n in dots) > 10_000_000:  # takes 0.2 s
        raise InputError(f"{where}: not {what}: too many lines with hundreds of dots")
    # Loaded here: every command would pay for it at its start.
    import tomllib

    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # TOMLDecodeError is a ValueError
        raise InputError(f"{where}: not valid TOML: {error}") from error


def reject_unknown(table: Mapping[str, Any], known: set[str], where: str) -> None:
    """Check that a table has no other keys.

    Raises:
        InputError: it has one.
    """
    for key in table:
        if key not in known:
            raise InputError(f"{where}: unknown key {key!r}; known are {', '.join(sorted(known))}")


def real_number(value: object, where: str) -> float:
    """A finite number of a table.

    Raises:
        InputError: it is none.
    """
    # TOML's integers have no limit, floats have.
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not abs(value) <= sys.float_info.max
    ):
        raise InputError(f"{where} must be a number, got {as_it_is(value)}")
    return float(value)


def as_it_is(value: object) -> str:
    """What a file has in place of something else, cut to a bearable length."""
    try:
        return f"{value!r:.40}"
    except (ValueError, RecursionError):  # Python writes no whole number of 4300 digits
        return "a number of thousands of digits"


def check_target(path: Path, *, replace: bool, sources: tuple[Path, ...] = ()) -> None:
    """See beforehand, because an analysis takes its time, whether a file can be written.

    The sources must not be replaced in any case.

    Raises:
        InputError: it cannot be written, or must not.
    """
    if not path.parent.is_dir():
        raise InputError(f"{path}: cannot write: no such folder as {path.parent}")
    if path.is_dir():
        raise InputError(f"{path}: cannot write: it is a folder")
    _check_no_device(path)
    if path.resolve() in (source.resolve() for source in sources):
        raise InputError(f"{path} is also an input or another output; name another file")
    if path.exists() and not replace:
        raise cannot_write(path, FileExistsError())


def cannot_write(path: Path | str, error: OSError | ValueError) -> InputError:
    """Why a file cannot be written; a ValueError is of a name with a null character."""
    if isinstance(error, FileExistsError):
        return InputError(f"{path} exists; --force overwrites it")
    return InputError(f"{path}: cannot write: {getattr(error, 'strerror', None) or error}")


def utf8(text: str) -> bytes:
    """Text in UTF-8; bytes of a file's name that are none become their codes."""
    return text.encode("utf-8", "backslashreplace")


def write_whole(path: Path, content: str | bytes, *, replace: bool) -> None:
    """Write a file in one step: readers see all of it or none.

    Text becomes UTF-8, as of `utf8`.

    Raises:
        InputError: it cannot be written, or exists and must not be replaced.
    """
    _check_no_device(path)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
    except (OSError, ValueError) as error:
        raise cannot_write(path, error) from error
    part = Path(name)
    try:
        with open(handle, "wb") as file:
            file.write(utf8(content) if isinstance(content, str) else content)
        if os.name == "posix":
            part.chmod(0o666 & ~_umask())
        if replace:
            part.replace(path)
        else:
            _put_new(part, path)
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        part.unlink(missing_ok=True)


def _check_no_device(path: Path) -> None:
    """See that no pipe or device gives way to a file, as `/dev/full` would for the superuser."""
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: cannot write: it is a pipe or a device; name a file")


def _put_new(part: Path, path: Path) -> None:
    """Give a file its name, unless that is taken."""
    if os.name != "posix":
        part.rename(path)  # which does not replace there
        return
    try:
        os.link(part, path)
    except OSError as error:
        if path.exists():
            raise FileExistsError from error
        # A file system without links: a name taken within this blink would be lost.
        part.replace(path)


def _umask() -> int:
    mask = os.umask(0o022)
    os.umask(mask)
    return mask


MOST_BYTES_OF_LOG = 2**32
"""Of an onboard log: the cards that autopilots write to hold no larger file."""


@contextlib.contextmanager
def reading_log(path: Path) -> Iterator[None]:
    """What goes wrong in reading an onboard log, as one line.

    Raises:
        InputError: it cannot be read, or is too large for a card, or for the memory.
    """
    try:
        size = path.stat().st_size
        if size > MOST_BYTES_OF_LOG:
            raise InputError(f"{path}: too large for an autopilot's log: {size:,} bytes")
        yield
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    except MemoryError as error:
        raise InputError(f"{path}: too large for this machine's memory") from error


@dataclass
class FileWindow:
    """Bytes of a log that are in memory together."""

    content: bytes
    position: int
    """Of the first of them in the file."""
    final: bool
    """Whether nothing follows them."""
    done: int = 0
    """How many of them need not come again; set by the reader."""


def file_windows(file: BinaryIO, size: int, stop: int | None = None) -> Iterator[FileWindow]:
    """Read a file from where it stands; what one window leaves undone comes again with the next.

    `stop` is the position at which to end; None: where the file ends.
    """
    position, rest, final = file.tell(), b"", False
    while not final:
        left = size if stop is None else stop - position - len(rest)
        more = file.read(min(size, left))
        final = len(more) < size or (left <= size and stop is not None)
        window = FileWindow(rest + more, position, final)
        yield window
        position += window.done
        rest = window.content[window.done :]


class StretchSearch:
    """Finds what begins in the bytes of a window, where a reader has lost its way.

    A stretch is searched at once, however little of it is asked for: of garbage, every byte may
    begin something.
    """

    _AT_ONCE = 2**16
    """Bytes of a stretch."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Search again: the bytes, or what may begin there, are others."""
        self._start = self._stop = 0
        self._found: list[int] = []

    def next(self, at: int, limit: int, found_in: Callable[[int, int], list[int]]) -> int | None:
        """The first found from a position to before a limit; None when there is none.

        `found_in` gives all that begins in a stretch, rising, by where that begins and ends.
        """
        while at < limit:
            if not self._start <= at < self._stop:
                self._start, self._stop = at, min(at + self._AT_ONCE, limit)
                self._found = found_in(self._start, self._stop)
            index = bisect_left(self._found, at)
            if index < len(self._found):
                return self._found[index]
            at = self._stop
        return None
