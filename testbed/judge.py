"""A flight analyzed as by a user, and its result compared with the truth."""

import math
import os
import traceback
from pathlib import Path
from typing import Any

from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.results.result import Result
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import ChainOptions
from gcs_sysid.significance import Z95
from testbed.emulated import Truth

BY_OFFLINE = "GCS_SYSID_BY_OFFLINE"
"""Environment variable, set where the offline estimate is judged, wherever there is one."""
OPTIONS = ChainOptions(offline=BY_OFFLINE in os.environ)
MOMENTS = ("Ixx", "Iyy", "Izz")
NO_CHANGE = ("disturbance", "rotor_input", "landing")
"""Kinds of events that claim nothing of the vehicle."""


def judge(log: Path, airframe: Airframe, truth: Truth) -> dict[str, Any]:
    """What came of a flight, as JSON holds it. The estimator sees the log and the airframe alone.

    Args:
        log: the recording.
        airframe: as the user has it.
        truth: parameter -> value or values.
    """
    try:
        result = analyze_log(log, airframe, options=OPTIONS)
    except InputError as error:
        return {"verdict": "refused", "error": str(error).replace(str(log), log.name)}
    except Exception as error:  # noqa: BLE001 - a defect is an outcome here
        trace = traceback.extract_tb(error.__traceback__)[-1]
        return {"verdict": "error", "error": f"{type(error).__name__}: {error} ({trace.name})"}
    return outcome(result, truth)


def outcome(result: Result, truth: Truth) -> dict[str, Any]:
    """A result against the truth."""
    estimates: dict[str, Estimate] = {**result.parameters, **result.timing}
    judged = {}
    for name, estimate in estimates.items():
        if name not in truth or estimate.value is None or not estimate.std:
            continue
        if estimate.status in ("identified", "weak"):
            judged[name] = {
                "status": estimate.status,
                **against(estimate.value, estimate.std, truth[name]),
            }
    found = result.validation
    changes = [e for e in result.events if "detected" in e and e["kind"] not in NO_CHANGE]
    return {
        "verdict": result.verdict,
        "reasons": list(result.reasons),
        "events": [{"t": e["t"], "kind": e["kind"]} for e in changes],
        "parameters": judged,
        "r_squared": _worst(found.get("r_squared"), min),
        "whiteness": _worst(found.get("whiteness"), max),
    }


Claims = list[tuple[str, dict[str, Any]]]
"""Name and judgment (see `against`, and its `status`) of each parameter that a result shows."""


def claims(outcome: dict[str, Any], *, all_shown: bool = False) -> Claims:
    """What an outcome claims: parameters that are `identified`, or `weak` ones too."""
    return [
        (name, found)
        for name, found in outcome.get("parameters", {}).items()
        if all_shown or found["status"] == "identified"
    ]


def against(value: float, std: float, truth: float | list[float]) -> dict[str, float | bool]:
    """An estimate against its true value, or the nearest within the range of several.

    Returns:
        error: relative to the truth (absolute where that is zero), signed.
        z: error over standard deviation.
        holds: whether the 95 % interval has a true value in it.
    """
    several = truth if isinstance(truth, list) else [truth]
    nearest = min(max(value, min(several)), max(several))
    error = value - nearest
    scale = abs(nearest) or 1.0
    return {
        "error": error / scale,
        "z": error / std,
        "holds": abs(error) <= Z95 * std,
    }


def _worst(axes: dict[str, float | None] | None, pick: Any) -> float | None:
    values = [v for v in (axes or {}).values() if v is not None and math.isfinite(v)]
    return pick(values) if values else None
