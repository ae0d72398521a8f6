"""One log's analysis as a piece of work that any process on any machine can do."""

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gcs_sysid import __version__
from gcs_sysid.errors import InputError
from gcs_sysid.files import split_mapping, split_session
from gcs_sysid.health.whole_analysis import analyze_whole
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.session.chain_options import ChainOptions

FAILURE = "gcs-sysid/failure/1"
"""Schema of the document of a log that cannot be read."""

Document = dict[str, Any]


@dataclass(frozen=True)
class Job:
    """A log and how it is analyzed.

    Attributes:
        log: its path as it was found, for people.
        airframe: with a scale anchor.
        vehicle: system and perhaps component; None: the first autopilot in the log.
        offline: whether the estimate is the maximum-likelihood one.
    """

    log: Path
    airframe: Airframe
    vehicle: tuple[int, int | None] | None = None
    offline: bool = False

    def settings(self) -> dict[str, Any]:
        """All that the result depends on beside the log's content, as plain JSON values."""
        return {
            "version": __version__,
            "airframe": dataclasses.asdict(self.airframe),
            "vehicle": self.vehicle,
            "offline": self.offline,
        }


@dataclass(frozen=True)
class Task:
    """A job whose log's content is known.

    Attributes:
        job: what is to be done.
        path: of the log, absolute: a worker has another working folder.
        sha256: of its content.
        size: bytes.
    """

    job: Job
    path: str
    sha256: str
    size: int

    @property
    def key(self) -> str:
        """Equal for the same content and settings, whatever the log is called."""
        text = json.dumps([self.sha256, self.job.settings()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def make_task(job: Job) -> Task:
    """Read a log's content through for its digest.

    Raises:
        OSError: it cannot be read.
    """
    table, mapping = split_mapping(job.log)
    path, session = (table, None) if mapping is not None else split_session(job.log)
    with open(path, "rb") as file:
        made = hashlib.file_digest(file, "sha256")
        size = file.tell()
    if mapping is not None:
        made.update(mapping.read_bytes())
    if session is not None:
        made.update(f"#{session}".encode())
    digest = made.hexdigest()
    return Task(job, str(job.log.absolute()), digest, size)


def analyze(task: Task) -> Document:
    """The result of one log, or why there is none, as the file that is kept.

    Raises:
        InputError: the log cannot be opened just now, or memory does not suffice; that says
            nothing of its content.
    """
    job = task.job
    made: Document
    try:
        options = ChainOptions(history_interval=None, offline=job.offline)
        log, name = Path(task.path), str(job.log)
        made = analyze_whole(log, job.airframe, job.vehicle, options, name=name).as_json()
    except InputError as error:
        if isinstance(error.__cause__, OSError | MemoryError):
            raise
        reason = str(error).replace(task.path, str(job.log))
        made = {"schema": FAILURE, "error": reason}
    about = {"sha256": task.sha256, "bytes": task.size, "settings": job.settings()}
    return {**made, "source": str(job.log), "log": about}
