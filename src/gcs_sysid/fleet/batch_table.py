"""The table of a batch: a row a log, in Parquet.

Every parameter is a column of the same structure, so `Ixx.value` is a number, `Ixx.*` is all of
it, and several parameters can be stacked. docs/batch.md describes the columns.
"""

from datetime import datetime
from pathlib import Path
from typing import Any

from gcs_sysid.errors import InputError
from gcs_sysid.files import utf8, write_whole
from gcs_sysid.fleet.jobs import Document, Job, Task
from gcs_sysid.model.parameters import REGISTRY

SCHEMA = "gcs-sysid/fleet/1"
MOST_BYTES = 2**30
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
_SCALE = ("anchor", "value", "unit", "std")

Row = dict[str, Any]


def require() -> None:
    """See beforehand that tables can be written and read.

    Raises:
        InputError: PyArrow is not installed.
    """
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError as error:
        raise InputError("fleet tables need PyArrow: pip install pyarrow") from error


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
        "vehicle": f"{job.airframe.name} {address}" if address else None,
        "airframe": job.airframe.name,
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


def _time(text: str | None) -> datetime | None:
    """Of a result's `recorded`: UTC, and naive, because readers turn others to local time."""
    try:
        return datetime.strptime(text or "", "%Y-%m-%d %H:%M UTC")
    except ValueError:
        return None


def _schema() -> Any:
    import pyarrow as pa

    def struct(parts: tuple[str, ...]) -> Any:
        numbers = ("value", "std", "std_given")
        return pa.struct([(n, pa.float64() if n in numbers else pa.string()) for n in parts])

    columns = [
        ("path", pa.string()),
        ("sha256", pa.string()),
        ("bytes", pa.int64()),
        ("result", pa.string()),
        ("error", pa.string()),
        ("verdict", pa.string()),
        ("reasons", pa.list_(pa.string())),
        ("vehicle", pa.string()),
        ("airframe", pa.string()),
        ("sysid", pa.int16()),
        ("compid", pa.int16()),
        ("autopilot", pa.string()),
        ("recorded", pa.timestamp("ms")),
        ("rotor_input", pa.string()),
        ("estimator", pa.string()),
        ("scale", struct(_SCALE)),
        ("changes", pa.int32()),
        ("version", pa.string()),
        ("health", pa.struct([(name, pa.float64()) for name in _HEALTH])),
        *((name, struct(_ESTIMATE)) for name in REGISTRY),
    ]
    return pa.schema(columns, metadata={"schema": SCHEMA})


def _required() -> set[str]:
    """Columns without which a table cannot be used; older ones have no health."""
    return set(_schema().names) - {"health"}


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
        if path.stat().st_size > MOST_BYTES:
            raise InputError(f"{path}: too large for a table: more than {MOST_BYTES:,} bytes")
        table = parquet.read_table(path, partitioning=None)
    except (OSError, pa.ArrowException) as error:
        reason = getattr(error, "strerror", None) or "not Parquet"
        raise InputError(f"{path}: cannot read the table: {reason}") from error
    known = (table.schema.metadata or {}).get(b"schema")
    if known != SCHEMA.encode() or not _required() <= set(table.schema.names):
        raise InputError(f"{path}: not a table of gcs-sysid batch (of this version)")
    rows: list[Row] = table.to_pylist()
    return rows
