"""The result of an identification, as files, screens and reports take it."""

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

SCHEMA = "gcs-sysid/1"

Status = Literal["identified", "given", "weak", "unobservable"]
Verdict = Literal["identified", "partial", "refused"]


@dataclass(frozen=True)
class Estimate:
    """One parameter's value with its uncertainty.

    `value` and `std` are None where the data say nothing at all; `std` is 0 for a given value.
    """

    value: float | None
    std: float | None
    unit: str
    status: Status

    @property
    def ci95(self) -> tuple[float, float] | None:
        """The 95 % interval (normal), or None where there is no value."""
        if self.value is None or self.std is None:
            return None
        half = 1.959963984540054 * self.std
        return (self.value - half, self.value + half)

    def as_json(self) -> dict[str, Any]:
        """The estimate as the result file writes it."""
        ci = self.ci95
        return {
            "value": _finite(self.value),
            "std": _finite(self.std),
            "ci95": None if ci is None or not all(map(math.isfinite, ci)) else list(ci),
            "unit": self.unit,
            "status": self.status,
        }


@dataclass(frozen=True)
class Scale:
    """The anchor that sets the scale of all masses, inertias and coefficients."""

    anchor: Literal["mass", "k_T", "T_max"]
    value: float
    unit: str


@dataclass(frozen=True)
class Result:
    """Everything an identification says, at one instant."""

    verdict: Verdict
    reasons: tuple[str, ...]
    source: str
    vehicle: dict[str, Any]
    scale: Scale | None
    rotor_input: Literal["speed", "command"]
    parameters: dict[str, Estimate]
    timing: dict[str, Estimate] = field(default_factory=dict)
    events: tuple[dict[str, Any], ...] = ()
    segments: tuple[dict[str, Any], ...] = ()
    validation: dict[str, Any] = field(default_factory=dict)
    telemetry: dict[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """The result as the dictionary that `--json` writes."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "reasons": list(self.reasons),
            "source": self.source,
            "vehicle": self.vehicle,
            "scale": None
            if self.scale is None
            else {
                "anchor": self.scale.anchor,
                "value": self.scale.value,
                "unit": self.scale.unit,
            },
            "rotor_input": self.rotor_input,
            "parameters": {k: v.as_json() for k, v in self.parameters.items()},
            "timing": {k: v.as_json() for k, v in self.timing.items()},
            "events": list(self.events),
            "segments": list(self.segments),
            "validation": self.validation,
            "telemetry": self.telemetry,
        }

    def dumps(self, indent: int | None = 2) -> str:
        """The result as JSON text (strict: no NaN or infinity)."""
        return json.dumps(self.as_json(), indent=indent, allow_nan=False)

    def write(self, path: Path) -> None:
        """Write the result to a file."""
        path.write_text(self.dumps() + "\n", encoding="utf-8")


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
