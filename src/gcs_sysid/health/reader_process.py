"""A long log read by another process, which assesses hover while the log is learned from here."""

import contextlib
import pickle
import subprocess
import sys
from io import BufferedReader
from pathlib import Path
from typing import Any, cast

from gcs_sysid.health.vehicle_health import Health, HealthOptions
from gcs_sysid.processes import apart, one_thread_environment
from gcs_sysid.telemetry.log_relay import RelayedLog, read_object

COMMAND = [sys.executable, "-P", "-m", "gcs_sysid.health.reader_main"]
_PIPE = 2**20
"""Bytes that a pipe holds, where the system allows it; few turns between the processes."""


class ReaderProcess:
    """Reads a log once for two: an analysis here, and what hover shows there.

    Args:
        path: as of `open_log`.
        wanted: likewise.
        given: as of `HoverRecords.health`.
        span: likewise.

    Attributes:
        log: to be read here.

    Raises:
        OSError: no process can be started.
    """

    def __init__(
        self,
        path: Path,
        wanted: tuple[int, int | None] | None,
        given: HealthOptions,
        span: tuple[float, float],
    ) -> None:
        self._process = subprocess.Popen(
            COMMAND,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=one_thread_environment(),
            pipesize=_PIPE,
            **apart(),
        )
        self._answers = cast(BufferedReader, self._process.stdout)
        self.log = RelayedLog(path, wanted, self._receive)
        task = pickle.dumps((path, wanted, pickle.dumps((str(path), given, span))))
        stdin = self._process.stdin
        assert stdin is not None
        with contextlib.suppress(OSError):  # it has died, which the log finds
            stdin.write(task)
            stdin.flush()

    def _receive(self) -> Any:
        return read_object(self._answers)

    def health(self) -> Health | None:
        """What hover shows, when the log is read; None where the process has ended early.

        Raises:
            InputError: the airframe is not known.
        """
        try:
            found = self._receive()
        except (EOFError, OSError):
            return None
        if isinstance(found, Exception):
            raise found
        health: Health = found
        return health

    def close(self) -> None:
        """End it, if it has not ended."""
        self._process.kill()
        with contextlib.suppress(OSError), self._process:  # a task that it did not take
            pass
