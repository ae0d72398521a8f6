"""Everything that a report is made of."""

import hashlib
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from gcs_sysid import __version__
from gcs_sysid.arrays import Array
from gcs_sysid.files import log_file
from gcs_sysid.live.acceleration_prediction import Model
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.report.prediction_series import Prediction, Spectrum, predict, residual_spectrum
from gcs_sysid.report.recorder import Recorder
from gcs_sysid.results.result import Result
from gcs_sysid.results.snapshot import Event, History

AXES = ("roll", "pitch", "yaw")


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
    log = log_file(log)
    with log.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    versions = {
        "gcs-sysid": __version__,
        "Python": f"{platform.python_version()}, {platform.system()} {platform.machine()}",
        "NumPy": np.__version__,
        "SciPy": scipy.__version__,
    }
    return Provenance(command, versions, log.stat().st_size, digest)


@dataclass(frozen=True)
class ReportData:
    """Input of the pages' sections and figures.

    Attributes:
        result: as `Result.as_json`.
        inspection: as `Inspection.as_json`; empty where there is none.
        airframe: with its anchor.
        provenance: what reproduces it.
        history: of the estimates.
        prediction: None where nothing flew.
        spectrum: of the residual; None where too little of the flight was kept apart.
        truth: true parameters of an emulated vehicle.
        notes: of the analysis, such as which rotor stream it took, and when it restarted.
        health: a health file's content; empty where nothing hovers.
        twin: a twin file's content; empty where nothing was held out.
        twin_picture: the growth of its errors, as SVG.
    """

    result: Mapping[str, Any]
    inspection: Mapping[str, Any]
    airframe: Airframe
    provenance: Provenance
    history: History
    prediction: Prediction | None = None
    spectrum: Spectrum | None = None
    truth: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[Event, ...] = ()
    health: Mapping[str, Any] = field(default_factory=dict)
    twin: Mapping[str, Any] = field(default_factory=dict)
    twin_picture: str = ""

    @property
    def geometry(self) -> Array:
        """(3, rotors) of the airframe."""
        return self.airframe.geometry


def gather(
    result: Result,
    recorder: Recorder,
    inspection: Mapping[str, Any],
    airframe: Airframe,
    provenance: Provenance,
    truth: Mapping[str, float] | None = None,
    health: Mapping[str, Any] | None = None,
) -> ReportData:
    """Put together what a report needs.

    Args:
        result: of the analysis that the recorder looked at.
        recorder: its samples are read once more.
        inspection: as `ReportData.inspection`.
        airframe: with its anchor.
        provenance: what reproduces it.
        truth: as `ReportData.truth`.
        health: as `ReportData.health`.
    """
    prediction = predicted(result, recorder, airframe)
    spectrum = None
    if prediction is not None and recorder.dt is not None:
        spectrum = residual_spectrum(prediction, recorder.dt, result.rotor_input)
    return ReportData(
        result.as_json(),
        inspection,
        airframe,
        provenance,
        recorder.history,
        prediction,
        spectrum,
        dict(truth or {}),
        recorder.notes,
        dict(health or {}),
    )


def predicted(result: Result, recorder: Recorder, airframe: Airframe) -> Prediction | None:
    """Measured and predicted angular acceleration of the flight; None where nothing flew.

    Args:
        result: of the analysis that the recorder looked at.
        recorder: its samples are read once more.
        airframe: with its anchor.
    """
    if recorder.dt is None:
        return None
    validation, model = recorder.validation, None
    if validation is not None:
        rotors = result.as_json()["telemetry"]["rotor_input"]
        model = Model(
            validation.theta,
            validation.coordinates,
            airframe.geometry,
            result.rotor_input,
            rotors.get("gyro_filter"),
            rotors.get("loop_filter"),
        )
    since = max((segment["end"] for segment in result.segments), default=float("-inf"))
    failures = [event["t"] for event in result.events if event["kind"] == "rotor_failure"]
    until = min((t for t in failures if t > since), default=float("inf"))
    share = 0.0 if validation is None else validation.fitted_share
    return predict(recorder.samples(), recorder.dt, model, since, until, share, result.rotor_input)
