"""A log that another process reads: its blocks, each with the figures of that moment.

They come through a pipe. Arrays go as they lie in memory, outside the pickle, and are arrays of
their own on the other side: a part that is kept there keeps no other one's memory.
"""

import contextlib
import pickle
import struct
import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BufferedReader
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from gcs_sysid.signals.columns import RecordBlock
from gcs_sysid.telemetry.clock import ClockDrift
from gcs_sysid.telemetry.logs import Log, open_log
from gcs_sysid.telemetry.vehicles import MavlinkSystem

_HEAD = struct.Struct("<QQ")
"""Bytes of the pickle; number of arrays."""
_SIZE = struct.Struct("<Q")


class ObjectSender:
    """Hands objects over as fast as the other side takes them, in a thread of its own.

    Args:
        pipe: to the other process.
    """

    def __init__(self, pipe: BinaryIO) -> None:
        self._pipe = pipe
        self._wake = threading.Condition()
        self._waiting: deque[list[Any]] = deque()
        self._closing = self._broken = False
        self._thread = threading.Thread(target=self._run, name="sender", daemon=True)
        self._thread.start()

    def put(self, what: object) -> None:
        """Hand over an object as it is now; its arrays must not change any more.

        Raises:
            BrokenPipeError: nothing can be handed over any more.
        """
        parts = _packed(what)
        with self._wake:
            if self._broken:
                raise BrokenPipeError
            self._waiting.append(parts)
            self._wake.notify_all()

    def wait(self, most: int) -> None:
        """Wait until no more than so many objects are left to hand over."""
        with self._wake:
            self._wake.wait_for(lambda: len(self._waiting) <= most)

    def close(self) -> None:
        """Wait until all is handed over."""
        with self._wake:
            self._closing = True
            self._wake.notify_all()
        self._thread.join()

    def _run(self) -> None:
        try:
            while self._send_next():
                pass
        except (OSError, MemoryError):
            with self._wake:
                self._broken = True
                self._waiting.clear()
                self._wake.notify_all()
            with contextlib.suppress(OSError):
                self._pipe.close()  # the other side learns of it

    def _send_next(self) -> bool:
        with self._wake:
            self._wake.wait_for(lambda: self._waiting or self._closing)
            if not self._waiting:
                return False
            parts = self._waiting[0]
        # At once: part by part, each would wait for the interpreter.
        self._pipe.write(b"".join(parts))
        self._pipe.flush()
        with self._wake:
            self._waiting.popleft()
            self._wake.notify_all()
        return True


def _packed(what: object) -> list[Any]:
    """The bytes of an object, arrays as views of their own memory."""
    arrays: list[pickle.PickleBuffer] = []
    content = pickle.dumps(what, protocol=5, buffer_callback=arrays.append)
    views = [array.raw() for array in arrays]
    sizes = b"".join(_SIZE.pack(view.nbytes) for view in views)
    return [_HEAD.pack(len(content), len(views)), sizes, content, *views]


def read_object(pipe: BufferedReader) -> Any:
    """The next object that the other side hands over.

    Raises:
        EOFError: the other side has ended.
    """
    size, count = _HEAD.unpack(_filled(pipe, _HEAD.size))
    sizes = [size for (size,) in _SIZE.iter_unpack(_filled(pipe, _SIZE.size * count))]
    content = _filled(pipe, size)
    return pickle.loads(content, buffers=[_filled(pipe, size) for size in sizes])


def _filled(pipe: BufferedReader, size: int) -> memoryview:
    content = np.empty(size, np.uint8).data
    if pipe.readinto(content) < size:
        raise EOFError("the other side has ended")
    return content


@dataclass(eq=False)
class LogFigures:
    """All that a `Log` says of itself, at one moment of its reading."""

    kind: str
    recorded: float | None
    vehicle: MavlinkSystem | None
    systems: list[MavlinkSystem]
    parameters: dict[str, float]
    drift: ClockDrift
    drift_ppm: float | None
    problems: tuple[str, ...]
    share_read: float
    telemetry: dict[str, Any]

    @classmethod
    def of(cls, log: Log) -> "LogFigures":
        """Those of now."""
        return cls(
            log.kind,
            log.recorded,
            log.vehicle,
            log.systems,
            log.parameters,
            log.drift,
            log.drift_ppm,
            log.problems,
            log.share_read,
            log.as_dict(),
        )


@dataclass(frozen=True)
class RelayedPart:
    """What the reading process says: figures, and the block just read, if any."""

    figures: LogFigures
    block: RecordBlock | None = None
    last: bool = False


def relayed(log: Log, sender: ObjectSender) -> Iterator[RecordBlock]:
    """The blocks of a log, each handed over to a `RelayedLog` of another process.

    Args:
        log: not yet read.
        sender: to the other process.
    """
    sender.put(RelayedPart(LogFigures.of(log)))
    for block in log.blocks():
        sender.put(RelayedPart(LogFigures.of(log), block))
        yield block
    sender.put(RelayedPart(LogFigures.of(log), last=True))


class RelayedLog(LogFigures):
    """A `Log` that another process reads; where that one ends early, it is read here.

    It says of itself what the log said when the block given last was read.

    Args:
        path: as of `open_log`.
        wanted: likewise.
        receive: the next thing that the other process handed over; raises `EOFError` when it has
            ended.
    """

    def __init__(
        self, path: Path, wanted: tuple[int, int | None] | None, receive: Callable[[], Any]
    ) -> None:
        self._path, self._wanted, self._receive = path, wanted, receive

    def blocks(self) -> Iterator[RecordBlock]:
        """As `Log` says.

        Raises:
            InputError: the file cannot be read, as the other process found.
        """
        given = 0
        for part in self._parts():
            self._take(part.figures)
            if part.last:
                return
            if part.block is not None:
                given += 1
                yield part.block
        # The same blocks come of the same file: on from where the other process got.
        log = open_log(self._path, self._wanted)
        self._take(LogFigures.of(log))
        for block in islice(log.blocks(), given, None):
            self._take(LogFigures.of(log))
            yield block
        self._take(LogFigures.of(log))

    def _parts(self) -> Iterator[RelayedPart]:
        while True:
            try:
                part = self._receive()
            except (EOFError, OSError):
                return
            if isinstance(part, Exception):
                raise part
            yield part

    def _take(self, figures: LogFigures) -> None:
        vars(self).update(vars(figures))

    def as_dict(self) -> dict[str, Any]:
        """As `Telemetry` says."""
        return {**self.telemetry}
