"""Aligned signals and residuals of a flight as a table: CSV, Parquet or MCAP.

Columns, axes forward, right, down and world north, east, down, all in SI: what the estimator takes
on its uniform grid, and the angular acceleration by its window, measured, predicted by the final
fit, and their difference. NaN, an empty field in CSV, where a signal is missing.
"""

import io
import json
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.parameters import AXES
from gcs_sysid.report.data import Recorder, predicted
from gcs_sysid.results.result import Result
from gcs_sysid.session.chain import Chain
from gcs_sysid.signals.sampling import SampleBlock

Table = Mapping[str, Array]
_FIXED = (
    "t", "gyro_x", "gyro_y", "gyro_z", "rate_x", "rate_y", "rate_z", "force_x", "force_y",
    "force_z", "q_w", "q_x", "q_y", "q_z", "v_north", "v_east", "v_down", "flying",
)  # fmt: skip


class SignalRecorder:
    """An observer of `analyze_log` that keeps the aligned signals.

    Args:
        rotors: how many the airframe has.
    """

    def __init__(self, rotors: int) -> None:
        self._recorder = Recorder(rotors)
        self._rotors = rotors
        self._pieces: list[Array] = []

    def begin(self) -> None:
        """A reading of the log begins; one before it does not count."""
        self._recorder.begin()
        self._pieces = []

    def take(self, block: SampleBlock) -> None:
        """The next block of samples."""
        self._recorder.take(block)
        s = block.samples
        columns = [block.t, s.gyro, s.rates, s.force, s.attitude, s.velocity, block.flying]
        self._pieces.append(np.column_stack([*columns, s.speeds]))

    def end(self, chain: Chain) -> None:
        """All is read, and the estimate final."""
        self._recorder.end(chain)

    def table(self, result: Result, airframe: Airframe) -> Table:
        """Column -> (n,) values.

        Args:
            result: of the analysis that this looked at.
            airframe: that it was made with.
        """
        what = result.rotor_input
        names = [*_FIXED, *(f"rotor_{what}_{i}" for i in range(1, self._rotors + 1))]
        rows = np.vstack([np.empty((0, len(names))), *self._pieces])
        table = dict(zip(names, rows.T, strict=True))
        found = predicted(result, self._recorder, airframe)
        self._recorder.close()
        for i, axis in enumerate(AXES):
            measured = model = np.full(len(rows), np.nan)
            if found is not None and len(found.t) > 1:
                measured, model = (
                    _on_grid(table["t"], found.t, values[:, i], found.step)
                    for values in (found.measured, found.predicted)
                )
            table[f"{axis}_acceleration"] = measured
            table[f"{axis}_acceleration_predicted"] = model
            table[f"{axis}_residual"] = measured - model
        return table


def _on_grid(t: Array, times: Array, values: Array, step: float) -> Array:
    """(n,) at t, straight between rows of the fit; NaN where one of the two is missing."""
    there = np.isfinite(times)
    times, values = times[there], values[there]
    out = np.full(len(t), np.nan)
    if len(times) < 2:
        return out
    i = np.clip(np.searchsorted(times, t, side="right"), 1, len(times) - 1)
    gap = times[i] - times[i - 1]
    share = (t - times[i - 1]) / np.maximum(gap, 1e-12)
    near = (share >= 0.0) & (share <= 1.0) & (gap < 1.5 * step)
    out[near] = (values[i - 1] + share * (values[i] - values[i - 1]))[near]
    return out


def writer_of(path: Path) -> Callable[[Table], bytes]:
    """What makes the file of a table, by the suffix.

    Raises:
        InputError: there is no such format, or what it needs is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in _WRITERS:
        raise InputError(f"{path}: --signals writes .csv, .parquet or .mcap")
    package, extra = _NEEDS.get(suffix, ("", ""))
    if package:
        try:
            import_module(package)
        except ImportError as error:
            raise InputError(
                f'{path}: writing {suffix} needs {package}: pip install "gcs-sysid[{extra}]"'
            ) from error
    return _WRITERS[suffix]


def _as_csv(table: Table) -> bytes:
    text = io.StringIO()
    np.savetxt(text, np.column_stack(list(table.values())), "%.9g", ",",
               header=",".join(table), comments="")  # fmt: skip
    return text.getvalue().replace("nan", "").encode()


def _as_parquet(table: Table) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as parquet

    file = io.BytesIO()
    columns = {name: pa.array(values, from_pandas=True) for name, values in table.items()}
    parquet.write_table(pa.table(columns), file)
    return file.getvalue()


def _as_mcap(table: Table) -> bytes:
    """One topic of JSON messages, stamped with the log's own time from 0."""
    from mcap.writer import Writer

    file = io.BytesIO()
    writer = Writer(file)
    writer.start(library="gcs-sysid")
    schema = {"type": "object", "properties": {name: {"type": "number"} for name in table}}
    kind = writer.register_schema("gcs_sysid.Signals", "jsonschema", json.dumps(schema).encode())
    topic = writer.register_channel("/gcs_sysid/signals", "json", kind)
    names = list(table)
    rows = np.column_stack(list(table.values()))
    for start in range(0, len(rows), 4096):
        for row in rows[start : start + 4096].tolist():
            message = {name: v for name, v in zip(names, row, strict=True) if v == v}
            stamp = round(1e9 * row[0])
            writer.add_message(topic, stamp, json.dumps(message).encode(), stamp)
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()


_WRITERS: Mapping[str, Callable[[Table], bytes]] = {
    ".csv": _as_csv,
    ".parquet": _as_parquet,
    ".mcap": _as_mcap,
}
_NEEDS = {".parquet": ("pyarrow", "fleet"), ".mcap": ("mcap", "mcap")}
