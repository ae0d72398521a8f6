"""The result of an identification, as files, screens and reports take it."""

import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from gcs_sysid.errors import InputError
from gcs_sysid.estimation.parameters.status import Status
from gcs_sysid.files import write_whole
from gcs_sysid.intervals import Z95, interval95

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from gcs_sysid.model.flight_model import FlightModel
    from gcs_sysid.results.notebook_view import PlotKind
    from gcs_sysid.results.parameter_samples import ParameterSamples
    from gcs_sysid.results.snapshot import Acceleration, History

SCHEMA = "gcs-sysid/1"

Verdict = Literal["identified", "partial", "refused"]


@dataclass(frozen=True)
class Estimate:
    """One parameter's value with its uncertainty.

    `value` and `std` are None without any information; `std` is 0 for a value given as exact.

    Example:
        >>> from gcs_sysid import Estimate
        >>> low, high = Estimate(0.0294, 0.0003, "kg m^2", "identified").ci95
        >>> round(low, 4), round(high, 4)
        (0.0288, 0.03)
    """

    value: float | None
    std: float | None
    unit: str
    status: Status
    bound: float | None = None
    """The least standard deviation that any estimator could have on this flight."""
    rests_on: str | None = None
    """What more than half of the knowledge comes from, if not from this flight's data."""
    std_given: float = 0.0
    """The part of `std` that comes from what was given (arm, scale, IMU): the same in every flight
    analyzed with it, however long. `std` is the root of the sum of both squares."""

    @property
    def std_data(self) -> float | None:
        """The part of `std` that comes from this flight's data."""
        if self.std is None or not self.std_given:
            return self.std
        return math.sqrt(max(self.std**2 - self.std_given**2, 0.0))

    not_negative: bool = False
    """Whether physics puts zero as the lower bound: see `bounded`."""

    @property
    def ci95(self) -> tuple[float, float] | None:
        """The 95 % interval (normal), or None where there is no value.

        Intervals of what cannot be negative are cut off at zero. No true value lies below, so
        coverage stays at least 95 %.
        """
        return interval95(self.value, self.std, not_negative=self.not_negative)

    @property
    def bounded(self) -> "Estimate":
        """The estimate within its physical bound: the nearest possible value.

        At zero the upper limit is that of an estimate of zero, so that no estimate below it makes
        the interval too short.
        """
        if not self.not_negative or self.value is None or not self.value < 0.0:
            return self
        return replace(self, value=0.0)

    @property
    def shown(self) -> bool:
        """Whether there is a value to show: not if unobservable."""
        return self.value is not None and self.status != "unobservable"

    @property
    def limit(self) -> float | None:
        """Upper limit (95 %) of the magnitude of a value consistent with zero; else None."""
        if not self.shown or self.status == "given" or self.ci95 is None:
            return None
        low, high = self.ci95
        return max(-low, high) if low <= 0.0 <= high else None

    @property
    def half(self) -> float | None:
        """Half-width of the 95 % interval; None if there is none, or the value is not shown."""
        if self.value is None or self.std is None or (self.status == "given" and not self.std):
            return None
        half = Z95 * self.std
        return half if math.isfinite(half) else None

    @property
    def relative_half(self) -> float | None:
        """The same over the value."""
        half = self.half
        if half is None or not self.value or not math.isfinite(self.value):
            return None
        return half / abs(self.value)

    def as_json(self) -> dict[str, Any]:
        """The estimate as the result file writes it."""
        ci = self.ci95
        out = {
            "value": _finite(self.value),
            "std": _finite(self.std),
            "std_data": _finite(self.std_data),
            "std_given": None if self.std is None else self.std_given,
            "ci95": None if ci is None or not all(map(math.isfinite, ci)) else list(ci),
            "unit": self.unit,
            "status": self.status,
        }
        if self.bound is not None:
            out["bound"] = _finite(self.bound)
        if self.rests_on is not None:
            out["rests_on"] = self.rests_on
        return out


@dataclass(frozen=True)
class IdentifiedEstimate(Estimate):
    """An estimate with value and interval, as `Result.identified` returns it."""

    value: float
    std: float

    @property
    def ci95(self) -> tuple[float, float]:
        """The 95 % interval, as of `Estimate`."""
        return interval95(self.value, self.std, not_negative=self.not_negative)


@dataclass(frozen=True)
class Scale:
    """The anchor that sets the scale of all masses, inertias and coefficients."""

    anchor: Literal["mass", "k_T", "T_max", "added_mass"]
    value: float
    unit: str
    std: float = 0.0
    """Of the value; zero where it was given."""
    origin: str = ""
    """Where the value comes from, if it was not given."""
    std_given: float = 0.0
    """Of the value, by the error of what was given at first."""

    def as_json(self) -> dict[str, Any]:
        """The scale as the result file writes it."""
        out: dict[str, Any] = {"anchor": self.anchor, "value": self.value, "unit": self.unit}
        if self.origin:
            out |= {"std": self.std, "from": self.origin}
        if self.std_given:
            out["std_given"] = self.std_given
        return out


@dataclass(frozen=True, repr=False)
class Result:
    """The complete result of an identification at one instant.

    Example:
        >>> import gcs_sysid
        >>> result = gcs_sysid.analyze("logs/sample.tlog", "paper")
        >>> [name for name, e in result.parameters.items() if e.status == "weak"]
        ['linear_drag']
        >>> result.scale.anchor, result.as_json()["parameters"]["mass"]["unit"]
        ('mass', 'kg')
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    source: str
    vehicle: dict[str, Any]
    scale: Scale | None
    rotor_input: Literal["speed", "command"]
    parameters: dict[str, Estimate]
    estimator: Literal["online", "offline"] = "online"
    method: str = ""
    """Which offline estimator: "filter error", "whitener bank" or "maximum likelihood", perhaps
    with "instruments"."""
    timing: dict[str, Estimate] = field(default_factory=dict)
    events: tuple[dict[str, Any], ...] = ()
    segments: tuple[dict[str, Any], ...] = ()
    validation: dict[str, Any] = field(default_factory=dict)
    priors: dict[str, Any] = field(default_factory=dict)
    """What was known beforehand: name -> value and std."""
    telemetry: dict[str, Any] = field(default_factory=dict)
    airframe: dict[str, Any] = field(default_factory=dict)
    """Name and rotors that the identification rests on, as in airframe files."""

    disturbance: dict[str, float] = field(default_factory=dict)
    """Axis -> nats a second by which an unmodeled moment explains it better; above 1 there is one.
    Empty where rows were not whitened."""
    rotors: tuple[dict[str, Estimate], ...] = ()
    """k_T and k_M of each rotor in motor order, with measured rotor speeds."""
    covariance: dict[str, Any] = field(default_factory=dict)
    """`names` and `matrix`, of all parameters with a value and a standard deviation."""

    advice: dict[str, Any] | None = None
    """What to fly next, of a running session: see `Advice`."""

    health: dict[str, Any] | None = field(default=None, compare=False)
    """A health file's content: what the last minutes of hover show, of a running session."""

    history: "History | None" = field(default=None, compare=False)
    """Estimates over time, where `analyze(..., history=True)` kept them; not in files."""
    prediction: "Acceleration | None" = field(default=None, compare=False)
    """Angular acceleration of the held-out part, by the fit to the rest; kept in the same way."""

    def identified(self, name: str) -> IdentifiedEstimate:
        """A reliable parameter, typed accordingly: its value is a float.

        Args:
            name: of a parameter or timing value that is identified, given, or known to be small.

        Raises:
            InputError: there is no such parameter, or it is weak or unobservable.

        Example:
            >>> import gcs_sysid
            >>> result = gcs_sysid.analyze("logs/sample.tlog", "paper")
            >>> low, high = result.identified("Izz").ci95
            >>> low < 0.0294 < high
            True
        """
        estimate = self.parameters.get(name) or self.timing.get(name)
        if estimate is None:
            known = ", ".join([*self.parameters, *self.timing])
            raise InputError(f"the result has no {name!r}; it has {known}")
        if (
            estimate.value is None
            or estimate.std is None
            or estimate.status in ("weak", "unobservable")
        ):
            raise InputError(f"{name} is {estimate.status} in this result, not identified")
        return IdentifiedEstimate(
            estimate.value,
            estimate.std,
            estimate.unit,
            estimate.status,
            estimate.bound,
            estimate.rests_on,
            estimate.std_given,
            estimate.not_negative,
        )

    def samples(self, n: int, seed: int = 0, *, given: bool = True) -> "ParameterSamples":
        """Vehicles drawn from the full covariance, all of them physical; see `draw_samples`.

        Args:
            n: vehicles.
            seed: of the random numbers.
            given: whether errors of arm, scale and IMU as given are drawn too; without them the
                samples show what this vehicle's motion may differ by.

        Raises:
            InputError: there is no covariance, or hardly any draw is physical.

        Example:
            >>> import gcs_sysid
            >>> samples = gcs_sysid.analyze("logs/sample.tlog", "paper").samples(500, seed=1)
            >>> samples["Izz"].shape, bool(abs(samples["Izz"].mean() - 0.0294) < 0.001)
            ((500,), True)
        """
        from gcs_sysid.results.parameter_samples import draw_samples

        return draw_samples(self, n, seed, given=given)

    def model(self, samples: "ParameterSamples | None" = None) -> "FlightModel":
        """Equations of motion with these values: `model().simulate(t, rotors, initial)`.

        Args:
            samples: an ensemble from `samples`; None: the estimate itself.

        Raises:
            InputError: the result lacks a parameter without which the model cannot fly.
        """
        from gcs_sysid.results.parameter_samples import flight_model

        return flight_model(self, samples)

    def to_dataframe(self) -> "pandas.DataFrame":
        """A row per parameter and timing value.

        Raises:
            InputError: pandas is not installed.
        """
        from gcs_sysid.results.notebook_view import dataframe

        return dataframe(self)

    def plot(self, kind: "PlotKind | None" = None) -> "Figure":
        """Draw `convergence`, `correlation` or `prediction`; by default all there is to draw.

        Raises:
            InputError: matplotlib is not installed, or the result does not hold what is wanted.
        """
        from gcs_sysid.results.notebook_view import plot

        return plot(self, kind)

    def __repr__(self) -> str:
        """One screen of text."""
        from gcs_sysid.results.notebook_view import text

        return text(self)

    def _repr_html_(self) -> str:
        from gcs_sysid.results.notebook_view import html

        return html(self)

    def as_json(self) -> dict[str, Any]:
        """The result as the dictionary that `--json` writes."""
        advice = {} if self.advice is None else {"advice": self.advice}
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "reasons": list(self.reasons),
            "source": self.source,
            "vehicle": self.vehicle,
            "airframe": self.airframe,
            "scale": None if self.scale is None else self.scale.as_json(),
            "estimator": self.estimator,
            **({"method": self.method} if self.method else {}),
            "rotor_input": self.rotor_input,
            "parameters": {k: v.as_json() for k, v in self.parameters.items()},
            "timing": {k: v.as_json() for k, v in self.timing.items()},
            "events": list(self.events),
            "segments": list(self.segments),
            "validation": self.validation,
            "priors": self.priors,
            "disturbance": self.disturbance,
            "rotors": [{k: v.as_json() for k, v in rotor.items()} for rotor in self.rotors],
            "covariance": self.covariance,
            "telemetry": self.telemetry,
            **advice,
            **({} if self.health is None else {"health": self.health}),
        }

    def dumps(self, indent: int | None = 2) -> str:
        """The result as JSON text (strict: no NaN or infinity)."""
        return json.dumps(self.as_json(), indent=indent, allow_nan=False)

    def write(self, path: Path, *, force: bool = False) -> None:
        """Write the result to a file; over another one only if forced.

        Raises:
            InputError: it cannot be written, or is there already.
        """
        write_whole(path, self.dumps() + "\n", replace=force)


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
