"""The formats of logs: one row each, from which doors, help and pages follow.

A log is known by its content; endings show what a missing file was to be. Light to
import: a reader is loaded when its first log is read.
"""

import gzip
import importlib
import io
import re
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any

from gcs_sysid.errors import InputError
from gcs_sysid.files import (
    BAG_SUFFIXES,
    MAPPING_FILE,
    MOST_BYTES_OF_LOG,
    PACKED_SUFFIXES,
    TABLE_SUFFIXES,
    check_regular,
    is_table,
)

HEAD = 2**12
"""Bytes in which a format shows itself; there may be the end of another log before it."""
LOOKED_AT = 2**20
"""Bytes of a file that does not begin as a log in which one may begin."""
BLACKBOX_HEAD = b"H Product:Blackbox flight data recorder by Nicholas Sherlock"
TEXT_DATAFLASH = rb"^FMT, *128, *89, *FMT"
"""The first entry of a .bin that was saved as text."""


@dataclass(frozen=True)
class LogFormat:
    """A format that is read.

    Attributes:
        name: `Log.kind`.
        words: for people, with the usual ending.
        endings: of its files, the usual one first.
        shows: whether a log of it begins in the first bytes of a file.
        reader: module of this package and function (path, and session or mapping) to a
            `Recording`.
        shared_endings: those that other files have as often.
        in_sessions: whether a file may hold several logs, as `LOG#2`.
    """

    name: str
    words: str
    endings: tuple[str, ...]
    shows: Callable[[bytes], bool]
    reader: str
    shared_endings: tuple[str, ...] = ()
    in_sessions: bool = False

    def read(self, path: Path, *part: Any) -> Any:
        """A file as its reader gives it.

        Raises:
            InputError: it cannot be read.
        """
        module, _, function = self.reader.partition(":")
        return getattr(importlib.import_module(f"{__package__}.{module}"), function)(path, *part)


def _begins(magic: bytes, head: bytes) -> bool:
    return head.startswith(magic)


def _holds(pattern: bytes, head: bytes) -> bool:
    return re.search(pattern, head, re.MULTILINE) is not None


def _is_tlog(head: bytes) -> bool:
    # Loaded here: the choices of an option need no frames.
    from gcs_sysid.telemetry.tlog import shows_a_record

    return shows_a_record(head)


FORMATS = (
    LogFormat("rosbag", "recording of ROS 2 (.mcap, .db3)", BAG_SUFFIXES,
              partial(_holds, rb"\A(\x89MCAP0\r\n|SQLite format 3\0)"), "rosbag:read_rosbag"),
    LogFormat(
        "blackbox",
        "blackbox log of Betaflight, INAV or Indiflight (.bbl)",
        (".bbl", ".bfl"),
        partial(_holds, BLACKBOX_HEAD),
        "blackbox:read_blackbox",
        (".txt",),
        in_sessions=True,
    ),
    LogFormat(
        "dataflash",
        "ArduPilot's own log (.bin)",
        (".bin",),
        # Anything may be before the entry that describes itself, in bytes or as text.
        partial(_holds, rb"\A\xa3\x95|\xa3\x95\x80\x80\x59FMT|" + TEXT_DATAFLASH),
        "dataflash:read_dataflash",
        (".log",),
    ),
    LogFormat("ulog", "PX4's own log (.ulg)", (".ulg",), partial(_begins, b"ULog"),
              "ulog:read_ulog"),
    LogFormat("tlog", "recording of a ground station (.tlog)", (".tlog",), _is_tlog,
              "tlog:TlogReader", (".rlog",)),
    LogFormat("table", "table of signals", tuple(sorted(TABLE_SUFFIXES)), lambda _: False,
              "mapped_table:read_table"),
)  # fmt: skip
"""In the order in which they are looked for."""
BY_NAME = {row.name: row for row in FORMATS}
LOG_SUFFIXES = frozenset(ending for row in FORMATS[:-1] for ending in row.endings)
"""Endings of logs that need no mapping."""
ANY_SUFFIX = LOG_SUFFIXES.union(PACKED_SUFFIXES, *(row.shared_endings for row in FORMATS))
"""Endings of what may be a log."""


def usual_endings(last: str = ", ") -> str:
    """`.tlog, .ulg, .bin, .bbl` for people; `last` joins the last."""
    *most, final = (row.endings[0] for row in reversed(FORMATS[:-1]))
    return f"{', '.join(most)}{last}{final}"


_OTHERS = (
    (rb"#ROSBAG V", "a bag of ROS 1",
     "convert it: pip install rosbags; rosbags-convert --src FILE.bag --dst FILE.mcap"),
    (rb"ULogEnc", "an encrypted PX4 log",
     "decrypt it with PX4's Tools/decrypt_ulog.py and your key, and give the .ulg"),
    (rb"BZh|\xfd7zXZ|\x28\xb5\x2f\xfd|7z\xbc\xaf|Rar!|.{257}ustar", "an archive",
     "unpack it and give the log in it"),
    (rb"(?i)\s*<(?:!doctype html|html|head)", "a web page", "download the log itself"),
    (rb"version https://git-lfs", "a pointer to a file", "fetch the file with git lfs pull"),
    (rb"\s*[\[{]\s*[\"\[{]", "JSON, such as a result, and no log",
     "tune, export, compare and twin take results, --baseline takes a flight's health"),
)  # fmt: skip
"""What is at hand instead of a log: how it begins, what it is, what to do."""


def format_of(path: Path) -> LogFormat:
    """The format of a file, or of the one log that is packed in it, by its content.

    Raises:
        InputError: it is of none, and what it is instead.
        OSError: it cannot be read.
    """
    check_regular(path)
    with opened_log(path) as file, _damage_in_words(path):
        head = file.read(HEAD)
        for pattern, what, advice in _OTHERS:
            if re.match(pattern, head, re.DOTALL):
                raise InputError(f"{path} is {what}: {advice}")
        found = _first(head)
        if found is None:
            head += file.read(LOOKED_AT)
            found = _first(head)
    if found is not None:
        return found
    if not head.strip(b"\0"):
        what = "holds zeros alone" if head else "is empty"
        raise InputError(f"{path} {what}: nothing was recorded in it, or the copy of it failed")
    if is_table(path):
        raise InputError(
            f"{path} is a table: say what its columns are with --csv MAPPING.toml, or in a "
            f"{MAPPING_FILE} beside it"
        )
    raise InputError(
        f"{path} is not a {usual_endings(' or ')} log: nothing of these formats found in it"
    )


def _first(head: bytes) -> LogFormat | None:
    return next((row for row in FORMATS if row.shows(head)), None)


@contextmanager
def opened_log(path: Path) -> Iterator[IO[bytes] | gzip.GzipFile]:
    """The bytes of a log, unpacked where it is in a .gz or alone in a .zip.

    Raises:
        InputError: it is in a .zip with others, or in a damaged one.
        OSError: it cannot be read.
    """
    with open(path, "rb") as file:
        magic = file.read(4)
        file.seek(0)
        if magic.startswith(b"\x1f\x8b"):
            with gzip.open(file) as content:
                yield content
        elif magic == b"PK\3\4":
            with _damage_in_words(path):
                archive = zipfile.ZipFile(file)
                member = archive.open(_only_log(path, archive))
            with archive, member:
                yield member
        else:
            yield file


def _only_log(path: Path, archive: zipfile.ZipFile) -> str:
    # macOS puts a hidden file beside each.
    names = [n for n in archive.namelist() if not (n.endswith("/") or Path(n).name[:1] == ".")]
    logs = [name for name in names if Path(name).suffix.lower() in LOG_SUFFIXES]
    wanted = logs or names
    if len(wanted) != 1:
        raise InputError(f"{path} holds {len(wanted)} files: unpack it and give the logs in it")
    return wanted[0]


@contextmanager
def _damage_in_words(path: Path) -> Iterator[None]:
    """What `gzip` and `zipfile` raise as one line.

    Raises:
        InputError: they raised something.
    """
    try:
        yield
    except (EOFError, zlib.error, gzip.BadGzipFile, zipfile.BadZipFile, RuntimeError) as error:
        raise InputError(f"{path} cannot be unpacked: {error}") from error


def unpack(path: Path, until: ExitStack) -> Path:
    """A log as a file that its reader can read: itself, or a copy for as long as `until` is open.

    Raises:
        InputError: it cannot be unpacked.
        OSError: it cannot be read, or the copy not be written.
    """
    with opened_log(path) as file:
        if isinstance(file, io.BufferedReader):
            return path
        whole = Path(until.enter_context(tempfile.TemporaryDirectory(prefix="gcs-sysid-")), "log")
        with open(whole, "wb") as target, _damage_in_words(path):
            while piece := file.read(LOOKED_AT):
                target.write(piece)
                if target.tell() > MOST_BYTES_OF_LOG:
                    raise InputError(f"{path}: too large when unpacked")
    return whole
