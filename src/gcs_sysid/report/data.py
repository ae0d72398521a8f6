"""Everything that a report is made of.

What an analysis uses is kept in bounded memory, for figures that are drawn afterwards: angular
acceleration measured against predicted, and the spectrum of what is left.

Aligned signals and residuals also make a table: CSV, Parquet or MCAP. Columns, axes forward, right,
down and world north, east, down, all in SI: what the estimator takes on its uniform grid, and the
angular acceleration by its window, measured, predicted by the final fit, and their difference. NaN,
an empty field in CSV, where a signal is missing.
"""

import io
import json
import platform
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from gcs_sysid import __version__
from gcs_sysid.arrays import Array, Mask, complete_rows, runs
from gcs_sysid.errors import InputError, needed
from gcs_sysid.estimation.record.input_noise import CommandNoise, SpeedNoise
from gcs_sysid.files import digest_of, log_file
from gcs_sysid.live.acceleration_prediction import Model, PredictionRows, Predictor, RotationSamples
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.parameters import AXES
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.history import History
from gcs_sysid.results.result import Result
from gcs_sysid.results.snapshot import Event
from gcs_sysid.signals.smoothers import Window, cosine_window, noise_gains
from gcs_sysid.twin.measured_flight import FlightRecorder


@dataclass(frozen=True)
class Spectrum:
    """One-sided power density of the residual.

    Attributes:
        frequency: (n,) Hz.
        density: (n, 3) (rad/s^2)^2/Hz.
        white: (n, 3) that white noise of the sensors would leave: of the rotors' stream as it is
            known, of the gyro as high as found where the window amplifies such noise most.
    """

    frequency: Array
    density: Array
    white: Array


@dataclass(frozen=True)
class Prediction(PredictionRows):
    """Rows of the forward form over a flight.

    Attributes:
        step: s between rows.
        held_out: (n,) which rows were not fitted.
        spectrum: of the residual; None where too little of the flight was kept apart.
    """

    step: float
    held_out: Mask
    spectrum: Spectrum | None


def predict(
    pieces: Iterable[RotationSamples],
    dt: float,
    model: Model | None,
    since: float,
    until: float,
    held_out: Array,
    rotor_input: RotorInput = RotorInput.SPEED,
) -> Prediction:
    """Predict the angular acceleration of a flight.

    Args:
        pieces: of its samples, in order.
        dt: s between samples.
        model: None: nothing is predicted.
        since: s, from where on the model is meant to hold.
        until: s, up to where.
        held_out: (n, 2) stretches that it was not fitted to, as of `Validation`.
        rotor_input: what the samples hold, if there is no model.
    """
    predictor = Predictor(dt, model, rotor_input)
    found = []
    noise: SpeedNoise | CommandNoise | None = None
    if model is not None and model.rotor_input.motors:
        noise = CommandNoise(model.geometry, dt, model.loop_cutoff)
    elif model is not None:
        noise = SpeedNoise(model.geometry, dt)
    for piece in pieces:
        found.append(predictor.rows(piece))
        if noise is not None:
            noise.update(piece.rotors)
    t, rates, measured, predicted = (
        np.concatenate([getattr(rows, name) for rows in found]) if found else np.empty((0, 3))
        for name in ("t", "rates", "measured", "predicted")
    )
    t = t.reshape(-1)
    usable = complete_rows(np.column_stack([measured, predicted])) & (t >= since) & (t <= until)
    predicted = np.where(usable[:, None], predicted, np.nan)
    place = np.cumsum(usable) / max(int(usable.sum()), 1)
    out: Mask = usable & (np.searchsorted(held_out.ravel(), place) % 2 == 1)
    variance = np.zeros(3)
    if model is not None and noise is not None:
        Q = model.Q[:, :4]
        average, _ = noise_gains(predictor.smoother, dt, 0.0)
        variance = np.diag(Q @ (average * noise.torques) @ Q.T)
    step = predictor.smoother.step * dt
    residual = np.where(out[:, None], measured - predicted, np.nan)
    spectrum = _spectrum(residual, step, variance, cosine_window(predictor.half, dt), dt)
    return Prediction(t, rates, measured, predicted, step, out, spectrum)


def _spectrum(
    residual: Array, step: float, speed_noise: Array, window: Window, dt: float
) -> Spectrum | None:
    """The residual's power density on the rows not fitted, by Welch; None if too few joined.

    Args:
        residual: (n, 3) NaN where a row was fitted.
        step: s between rows.
        speed_noise: (3,) variance of a row's prediction by white noise of the rotors' stream.
        window: that makes a row of samples `dt` s apart.
        dt: s.
    """
    stretches = [residual[run] for run, there in runs(complete_rows(residual)) if there]
    longest = max((len(s) for s in stretches), default=0)
    # Rows in one piece of the spectrum.
    size = min(512, max(32, 2 ** int(np.log2(max(longest // 4, 1)))))
    taper = np.hanning(size + 2)[1:-1, None]
    scale = 2.0 * step / float(np.sum(taper**2))
    found = [
        np.abs(np.fft.rfft(taper * (s[a : a + size] - s[a : a + size].mean(axis=0)), axis=0)) ** 2
        for s in stretches
        for a in range(0, len(s) - size + 1, size // 2)
    ]
    if not found:
        return None
    density = scale * np.mean(found, axis=0)[1:-1]
    frequency = np.fft.rfftfreq(size, step)[1:-1]
    angles = 2.0 * np.pi * np.outer(frequency, dt * np.arange(-window.half, window.half + 1))
    averaged, shape = (
        np.abs(np.exp(-1j * angles) @ taps) ** 2 for taps in (window.average, window.derivative)
    )
    total = float(window.average @ window.average)
    speeds = np.outer(2.0 * dt / total * averaged, speed_noise)
    near = shape > 0.5 * shape.max()
    gyro = np.maximum(density[near] - speeds[near], 0.01 * density[near]) / shape[near, None]
    white = speeds + shape[:, None] * gyro.mean(axis=0)
    seen = shape > 1e-4 * shape.max()
    return Spectrum(frequency[seen], density[seen], white[seen])


@dataclass(frozen=True)
class Provenance:
    """What reproduces a report.

    Attributes:
        command: the command line, word by word.
        versions: of the program and what it computes with, by name.
        log_bytes: length of the recording.
        log_sha256: its hash.
    """

    command: tuple[str, ...]
    versions: Mapping[str, str]
    log_bytes: int
    log_sha256: str


def provenance_of(command: tuple[str, ...], log: Path) -> Provenance:
    """What reproduces a report of this log."""
    digest, size = digest_of(log_file(log))
    versions = {
        "gcs-sysid": __version__,
        "Python": f"{platform.python_version()}, {platform.system()} {platform.machine()}",
        "NumPy": np.__version__,
        "SciPy": scipy.__version__,
    }
    return Provenance(command, versions, size, digest)


@dataclass(frozen=True)
class ReportData:
    """Input of the pages' sections and figures.

    Attributes:
        result: of the analysis.
        inspection: as `Inspection.as_json`; empty where there is none.
        airframe: with its anchor.
        provenance: what reproduces it.
        history: of the estimates.
        prediction: None where nothing flew.
        truth: true parameters of an emulated vehicle.
        notes: of the analysis, such as which rotor stream it took, and when it restarted.
        health: a health file's content; empty where nothing hovers.
        twin: a twin file's content; empty where nothing was held out.
        twin_picture: the growth of its errors, as SVG.
    """

    result: Result
    inspection: Mapping[str, Any]
    airframe: Airframe
    provenance: Provenance
    history: History
    prediction: Prediction | None = None
    truth: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[Event, ...] = ()
    health: Mapping[str, Any] = field(default_factory=dict)
    twin: Mapping[str, Any] = field(default_factory=dict)
    twin_picture: str = ""


def predicted(result: Result, recorder: FlightRecorder, airframe: Airframe) -> Prediction | None:
    """Measured and predicted angular acceleration of the flight; None where nothing flew.

    The recorder looked at the result's analysis; its samples are read once more.
    """
    if recorder.dt is None:
        return None
    validation, model = recorder.validation, None
    if validation is not None:
        rotors = result.telemetry["rotor_input"]
        model = Model(
            validation.Q,
            validation.coordinates,
            airframe.geometry,
            result.rotor_input,
            rotors.get("gyro_filter"),
            rotors.get("loop_filter"),
        )
    since = max((segment["end"] for segment in result.segments), default=float("-inf"))
    failures = [event["t"] for event in result.events if event["kind"] == "rotor_failure"]
    until = min((t for t in failures if t > since), default=float("inf"))
    held_out = np.empty((0, 2)) if validation is None else validation.held_out
    pieces = (
        RotationSamples(rows[:, 0], rows[:, 1:4], rows[:, 4:7], rows[:, 21:])
        for rows in recorder.rows()
    )
    return predict(pieces, recorder.dt, model, since, until, held_out, result.rotor_input)


Table = Mapping[str, Array]
_FIXED = (
    "t", "gyro_x", "gyro_y", "gyro_z", "rate_x", "rate_y", "rate_z", "force_x", "force_y",
    "force_z", "q_w", "q_x", "q_y", "q_z", "v_north", "v_east", "v_down", "flying",
    "setpoint_x", "setpoint_y", "setpoint_z",
)  # fmt: skip


def signal_table(result: Result, recorder: FlightRecorder, airframe: Airframe) -> Table:
    """Column -> (n,) values.

    The recorder looked at the result's analysis; its samples are read twice more.
    """
    what = result.rotor_input
    names = [*_FIXED, *(f"rotor_{what}_{i}" for i in range(1, len(airframe.rotors) + 1))]
    rows = np.vstack([np.empty((0, len(names))), *recorder.rows(whole=True)])
    rows = rows[np.isfinite(rows[:, 0])]
    table = dict(zip(names, rows.T, strict=True))
    found = predicted(result, recorder, airframe)
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
    if len(times) < 2:
        return np.full(len(t), np.nan)
    i = np.clip(np.searchsorted(times, t, side="right"), 1, len(times) - 1)
    gap = times[i] - times[i - 1]
    out: Array = np.interp(t, times, values, np.nan, np.nan)
    return np.where(gap < 1.5 * step, out, np.nan)


def writer_of(path: Path) -> Callable[[Table], bytes]:
    """What makes the file of a table, by the suffix.

    Raises:
        InputError: there is no such format, or what it needs is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in _WRITERS:
        raise InputError(f"{path}: --signals writes .csv, .parquet or .mcap")
    if suffix in _NEEDS:
        needed(_NEEDS[suffix], f"{path}: writing {suffix}")
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
_NEEDS = {".parquet": "pyarrow", ".mcap": "mcap"}
