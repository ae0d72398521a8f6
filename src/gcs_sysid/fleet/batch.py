"""A batch: which files are logs, every log done once, kept as it is done, and a row for each.

The rows make a table in Parquet. Every parameter is a column of the same structure, so `Ixx.value`
is a number, `Ixx.*` is all of it, and several parameters can be stacked. docs/batch.md describes
the columns.
"""

import json
import os
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, NoReturn

from gcs_sysid.errors import InputError
from gcs_sysid.files import (
    TABLE_SUFFIXES,
    check_regular,
    is_bag_folder,
    log_file,
    read_text,
    split_log,
    split_mapping,
    utf8,
    with_mapping,
    write_whole,
)
from gcs_sysid.fleet.jobs import FAILURE, Document, Job, Pool, Task, complete, make_task, reason
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.results.result_data import SCHEMA
from gcs_sysid.results.result_file import MOST_BYTES
from gcs_sysid.strict_json import json_text
from gcs_sysid.telemetry.blackbox import flight_sessions
from gcs_sysid.telemetry.log_formats import LOG_SUFFIXES, LogFormat, format_of, unpack

_OF_TABLE = "gcs-sysid/fleet/1"
_MOST_BYTES_OF_TABLE = 2**30
"""Of a table: some hundred thousand logs."""
_ESTIMATE = ("value", "std", "std_given", "unit", "status", "rests_on")
_HEALTH = {
    "seconds": ("seconds_of_hover",),
    "cg_x": ("cg", "x", "value"),
    "cg_x_std": ("cg", "x", "std"),
    "cg_y": ("cg", "y", "value"),
    "cg_y_std": ("cg", "y", "std"),
    "yaw_imbalance": ("yaw_imbalance", "value"),
    "hover_throttle": ("hover_throttle", "value"),
    "thrust_to_weight": ("thrust_to_weight", "value"),
    "drift_per_minute": ("drift_per_minute", "value"),
}
"""Part of the column `health` -> where a health file has it."""
_HOVER = ("name", "unit", "value", "std")
"""Of each number of the hover; the deviation is the flight's own."""
_PROPOSED = ("name", "value", "std", "std_given", "now")
"""Of each autopilot parameter."""
_SCALE = ("anchor", "value", "unit", "std")

Row = dict[str, Any]


def row(
    job: Job,
    task: Task | None,
    document: Document | None,
    name: str | None = None,
    error: str | None = None,
) -> Row:
    """The row of one log.

    Args:
        job: of the log.
        task: the same with the log's content known, if it could be read.
        document: of its analysis; None where it has none.
        name: of the document's file.
        error: why it has none.
    """
    made = document or {}
    vehicle = made.get("vehicle") or {}
    address = f"{vehicle['sysid']}:{vehicle['compid']}" if vehicle else None
    scale = made.get("scale")
    known = {**made.get("parameters", {}), **made.get("timing", {})}
    out: Row = {
        "path": str(job.log),
        "sha256": task.sha256 if task else None,
        "bytes": task.size if task else None,
        "result": name,
        "error": error or made.get("error"),
        "verdict": made.get("verdict"),
        "reasons": made.get("reasons"),
        "vehicle": f"{job.airframe_name} {address}" if address else None,
        "airframe": job.airframe_name,
        "sysid": vehicle.get("sysid"),
        "compid": vehicle.get("compid"),
        "autopilot": vehicle.get("autopilot"),
        "recorded": _time(made.get("telemetry", {}).get("recorded")),
        "rotor_input": made.get("rotor_input"),
        "estimator": made.get("estimator"),
        "scale": None if scale is None else {key: scale.get(key) for key in _SCALE},
        "changes": sum("detected" in event for event in made["events"])
        if "events" in made
        else None,
        "version": job.settings()["version"],
        "health": _health(made.get("health")),
        "hover": made.get("hover") or [],
        "proposed": _proposed(made.get("health") or {}),
    }
    for key in REGISTRY:
        estimate = known.get(key)
        out[key] = estimate and {part: estimate.get(part) for part in _ESTIMATE}
    return out


def _health(document: Document | None) -> dict[str, float | None] | None:
    """Findings of the hover; None where nothing hovered, or not as the airframe has it."""
    if document is None or document["verdict"] == "refused":
        return None
    out: dict[str, float | None] = {}
    for name, keys in _HEALTH.items():
        value: Any = document
        for key in keys:
            value = None if value is None else value.get(key)
        out[name] = value
    return out


def _proposed(document: Document) -> list[dict[str, Any]]:
    """The autopilot parameters that the hover suggests."""
    suggested = document.get("autopilot_parameters") or {}
    return [{part: name if part == "name" else one[part] for part in _PROPOSED}
            for name, one in suggested.items()]  # fmt: skip


def _time(text: str | None) -> datetime | None:
    """Of a result's `recorded`: UTC, and naive, because readers turn others to local time."""
    try:
        return datetime.strptime(text or "", "%Y-%m-%d %H:%M UTC")
    except ValueError:
        return None


def _schema() -> Any:
    import pyarrow as pa

    def struct(parts: tuple[str, ...]) -> Any:
        numbers = ("value", "std", "std_given", "now")
        return pa.struct([(n, pa.float64() if n in numbers else pa.string()) for n in parts])

    others = {
        "bytes": pa.int64(),
        "reasons": pa.list_(pa.string()),
        "sysid": pa.int16(),
        "compid": pa.int16(),
        "recorded": pa.timestamp("ms"),
        "scale": struct(_SCALE),
        "changes": pa.int32(),
        "health": pa.struct([(name, pa.float64()) for name in _HEALTH]),
        "hover": pa.list_(struct(_HOVER)),
        "proposed": pa.list_(struct(_PROPOSED)),
        **dict.fromkeys(REGISTRY, struct(_ESTIMATE)),
    }
    columns = [(name, others.get(name, pa.string())) for name in row(Job(Path(), None), None, None)]
    return pa.schema(columns, metadata={"schema": _OF_TABLE})


def write_table(path: Path, rows: list[Row]) -> None:
    """Write the rows, by path, in place of the table that is there.

    Raises:
        InputError: it cannot be written.
    """
    import pyarrow as pa
    from pyarrow import parquet

    written = [{name: _storable(value) for name, value in row.items()} for row in rows]
    table = pa.Table.from_pylist(sorted(written, key=lambda row: row["path"]), _schema())
    buffer = pa.BufferOutputStream()
    parquet.write_table(table, buffer, compression="zstd")
    write_whole(path, buffer.getvalue().to_pybytes(), replace=True)


def _storable(value: Any) -> Any:
    """A value, or a text that a table can hold."""
    if isinstance(value, list):
        return [_storable(each) for each in value]
    return utf8(value).decode() if isinstance(value, str) else value


def read_table(path: Path) -> list[Row]:
    """Read a table's rows.

    Raises:
        InputError: it cannot be read, or is no table of a batch.
    """
    import pyarrow as pa
    from pyarrow import parquet

    try:
        if path.stat().st_size > _MOST_BYTES_OF_TABLE:
            most = f"{_MOST_BYTES_OF_TABLE:,}"
            raise InputError(f"{path}: too large for a table: more than {most} bytes")
        table = parquet.read_table(path, partitioning=None)
    except (OSError, pa.ArrowException) as error:
        reason = getattr(error, "strerror", None) or "not Parquet"
        raise InputError(f"{path}: cannot read the table: {reason}") from error
    known = (table.schema.metadata or {}).get(b"schema")
    required = set(_schema().names) - {"health", "hover", "proposed"}  # older ones have none
    if known != _OF_TABLE.encode() or not required <= set(table.schema.names):
        raise InputError(f"{path}: not a table of gcs-sysid batch (of this version)")
    rows: list[Row] = table.to_pylist()
    return rows


RESULTS = "results"
TABLE = "fleet.parquet"
_NAME = re.compile(r".*-([0-9a-f]{16})\.json")


class Store:
    """Documents by the key of their task.

    A file is there whole or not at all, and its name holds the key of content and settings: what is
    there is done, whenever and however the program ended. `force`: nothing that is there counts,
    and all of it may be overwritten.

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
            text = read_text(self.folder / self.name(task), "the result", MOST_BYTES)
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

    A file that is named counts as a log whatever it is. In a folder and the folders in it, a log is
    what its content or its name says is one; a log that is damaged from the beginning is found by
    its name. Names that begin with a dot are skipped. A blackbox log of several sessions counts
    once for each that holds frames, as `LOG.bbl#2`. A table of signals is a log where a mapping
    says what its columns are. `mapping` is that of all tables; None: a columns.toml beside them.

    Returns:
        As reached from `paths`, in their order, and by name within a folder.

    Raises:
        InputError: there is no such file or folder, or a folder cannot be read.
    """
    found: dict[Path, Path] = {}
    for path in paths:
        file, session, _ = split_log(path)
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
        if is_bag_folder(Path(parent)):
            yield Path(parent)
            files = []
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
