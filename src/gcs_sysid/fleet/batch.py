"""A batch: which files are logs, every log done once, kept as it is done, and a row for each."""

import json
import os
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

from gcs_sysid.errors import InputError
from gcs_sysid.files import (
    TABLE_SUFFIXES,
    check_regular,
    log_file,
    read_text,
    split_mapping,
    split_session,
    with_mapping,
    write_whole,
)
from gcs_sysid.fleet.batch_table import Row, row
from gcs_sysid.fleet.jobs import FAILURE, Document, Job, Task, make_task
from gcs_sysid.fleet.pools import Pool, complete, reason
from gcs_sysid.results.result_data import SCHEMA
from gcs_sysid.results.result_file import MOST_BYTES
from gcs_sysid.strict_json import json_text
from gcs_sysid.telemetry.blackbox import flight_sessions
from gcs_sysid.telemetry.log_formats import LOG_SUFFIXES, LogFormat, format_of, unpack

RESULTS = "results"
TABLE = "fleet.parquet"
_NAME = re.compile(r".*-([0-9a-f]{16})\.json")


class Store:
    """Documents by the key of their task.

    A file is there whole or not at all, and its name holds the key of content and settings: what
    is there is done, whenever and however the program ended.

    Args:
        folder: of the batch; made if need be.
        force: whether nothing that is there counts, and all of it may be overwritten.

    Raises:
        InputError: it cannot be made, or holds something else than a batch.
    """

    def __init__(self, folder: Path, *, force: bool = False) -> None:
        self.folder = folder
        results = folder / RESULTS
        try:
            if folder.is_dir() and not results.is_dir() and any(folder.iterdir()) and not force:
                raise InputError(
                    f"{folder} holds files that are not of a batch; name another folder, or "
                    f"use --force"
                )
            results.mkdir(parents=True, exist_ok=True)
            found = ((_NAME.fullmatch(path.name), path) for path in sorted(results.iterdir()))
            self._names = {match[1]: path.name for match, path in found if match}
        except OSError as error:
            raise InputError(f"{folder}: cannot write there: {error.strerror}") from error
        self._done = set() if force else set(self._names)

    @property
    def table(self) -> Path:
        """The table of all."""
        return self.folder / TABLE

    def name(self, task: Task) -> str:
        """Where a task's document is, from the folder; of the first name that its log had."""
        known = self._names.get(task.key)
        if known is None:
            stem = re.sub(r"[^A-Za-z0-9._-]+", "_", log_file(task.job.log).stem)[:60]
            known = f"{stem or 'log'}-{task.key}.json"
        return f"{RESULTS}/{known}"

    def find(self, task: Task) -> Document | None:
        """The document of a task, if it is done; one that is damaged is not."""
        if task.key not in self._done:
            return None
        try:
            text = read_text(self.folder / self.name(task), MOST_BYTES, "the result")
            document = json.loads(text)
        except (InputError, ValueError, RecursionError):
            return None
        whole = isinstance(document, dict) and document.get("schema") in (SCHEMA, FAILURE)
        return document if whole else None

    def keep(self, task: Task, document: Document) -> None:
        """Keep a task's document.

        Raises:
            InputError: it cannot be written.
        """
        path = self.folder / self.name(task)
        write_whole(path, json_text(document, 2) + "\n", replace=True)
        self._names[task.key] = path.name
        self._done.add(task.key)


AIRFRAME_FILE = "airframe.toml"


@dataclass
class BatchTally:
    """How far a batch has come.

    Attributes:
        total: logs.
        rows: of the logs done.
        kept: logs of these that were done before.
        verdicts: how many of each; `failed` has none.
    """

    total: int
    rows: list[Row] = field(default_factory=list)
    kept: int = 0
    verdicts: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys(("identified", "partial", "refused", "failed"), 0)
    )


class BatchRun:
    """Runs jobs whose documents are not there yet.

    Args:
        jobs: to do; logs of the same content and settings are done once.
        store: of documents.
        pool: does the work.
        show: called with the row of each log and the tally, as logs are done.
        stopped: asked now and then whether to end early, keeping what is done.
    """

    def __init__(
        self,
        jobs: list[Job],
        store: Store,
        pool: Pool,
        show: Callable[[Row, BatchTally], None],
        stopped: Callable[[], bool],
    ) -> None:
        self._jobs, self._store, self._pool = jobs, store, pool
        self._show, self._stopped = show, stopped
        self._copies: dict[str, list[Task]] = {}
        self._made: set[str] = set()
        self.tally = BatchTally(len(jobs))

    def run(self) -> list[Row]:
        """Do them; the rows of all that are done at the end.

        Raises:
            InputError: a document cannot be kept.
        """
        for task, ended in complete(self._pool, self._tasks(self._jobs), self._stopped):
            document = None if isinstance(ended, BaseException) else ended
            if document is not None:
                self._store.keep(task, document)
                self._made.add(task.key)
            why = reason(ended) if isinstance(ended, BaseException) else None
            for copy in self._copies.pop(task.key):
                self._take(copy.job, copy, document, why)
        return self.tally.rows

    def _tasks(self, jobs: Iterable[Job]) -> Iterator[Task]:
        """What is still to be done."""
        for job in jobs:
            if self._stopped():
                return
            try:
                task = make_task(job)
            except OSError as error:
                self._take(job, None, None, f"cannot read {job.log}: {error.strerror}")
                continue
            if task.key in self._copies:
                self._copies[task.key].append(task)
                continue
            document = self._store.find(task)
            if document is None:
                self._copies[task.key] = [task]
                yield task
            else:
                self.tally.kept += task.key not in self._made
                self._take(job, task, document)

    def _take(
        self, job: Job, task: Task | None, document: Document | None, error: str | None = None
    ) -> None:
        name = self._store.name(task) if task is not None and document is not None else None
        made = row(job, task, document, name, error)
        self.tally.rows.append(made)
        self.tally.verdicts[made["verdict"] or "failed"] += 1
        self._show(made, self.tally)


def find_logs(paths: Iterable[Path], mapping: Path | None = None) -> list[Path]:
    """The logs among files and in folders, each once.

    A file that is named counts as a log whatever it is. In a folder and the folders in it, a log
    is what its content or its name says is one; a log that is damaged from the beginning is found
    by its name. Names that begin with a dot are skipped. A blackbox log of several sessions counts
    once for each that holds frames, as `LOG.bbl#2`. A table of signals is a log where a mapping
    says what its columns are.

    Args:
        paths: of files and folders.
        mapping: of all tables; None: a columns.toml beside them.

    Returns:
        As reached from `paths`, in their order, and by name within a folder.

    Raises:
        InputError: there is no such file or folder, or a folder cannot be read.
    """
    found: dict[Path, Path] = {}
    for path in paths:
        file, session = split_session(path)
        if (table := split_mapping(path))[1] is not None:
            file = table[0]
        if not file.exists():
            raise InputError(f"{path}: no such file or folder")
        if not path.is_dir():
            check_regular(file)
        for log in _in_folder(path, mapping) if path.is_dir() else [path]:
            if mapping is not None:
                log = with_mapping(log, mapping)
            single = session is not None or split_mapping(log)[1] is not None
            for flight in [log] if single else _sessions(log):
                found.setdefault(flight.resolve(), flight)
    return list(found.values())


def _in_folder(folder: Path, mapping: Path | None) -> Iterable[Path]:
    def refuse(error: OSError) -> NoReturn:
        raise InputError(f"{error.filename}: cannot read the folder: {error.strerror}")

    for parent, folders, files in os.walk(folder, onerror=refuse):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(files):
            path = Path(parent, name)
            if not name.startswith(".") and path.is_file() and _is_log(path, mapping):
                yield path


def _sessions(log: Path) -> list[Path]:
    """A log of its own for each session of a blackbox log that holds several."""
    form = _format(log)
    numbers = []
    if form is not None and form.in_sessions:
        with ExitStack() as until:
            numbers = flight_sessions(unpack(log, until))
    if numbers in ([], [1]):
        return [log]
    return [log.with_name(f"{log.name}#{number}") for number in numbers]


def _is_log(path: Path, mapping: Path | None) -> bool:
    if path.suffix.lower() in TABLE_SUFFIXES:
        return (mapping or split_mapping(path)[1]) is not None
    return path.suffix.lower() in LOG_SUFFIXES or _format(path) is not None


def _format(path: Path) -> LogFormat | None:
    try:
        return format_of(path)
    except (InputError, OSError):
        return None


def nearest_airframe(log: Path) -> Path | None:
    """The airframe.toml beside a log, or in the nearest folder above that has one."""
    for folder in log.absolute().parents:
        file = folder / AIRFRAME_FILE
        if file.is_file():
            return file
    return None
