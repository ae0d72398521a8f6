"""What a result holds and its file says; `results.result` adds what can be made of it."""

from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from gcs_sysid.errors import InputError
from gcs_sysid.files import write_whole
from gcs_sysid.model.airframe import Airframe, own_units_words, parse_airframe
from gcs_sysid.model.estimate import Estimate, IdentifiedEstimate, Objection, Verdict
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.strict_json import json_text

if TYPE_CHECKING:
    from gcs_sysid.results.history import Acceleration, History

SCHEMA = "gcs-sysid/1"


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
class ResultData:
    """All that an identification found, at one instant."""

    verdict: Verdict
    reasons: tuple[str, ...]
    source: str
    vehicle: dict[str, Any]
    scale: Scale | None
    rotor_input: RotorInput
    parameters: dict[str, Estimate]
    estimator: Literal["online", "offline"] = "online"
    method: str = ""
    """Which offline estimator: "prediction error"."""
    timing: dict[str, Estimate] = field(default_factory=dict)
    events: tuple[dict[str, Any], ...] = ()
    segments: tuple[dict[str, Any], ...] = ()
    validation: dict[str, Any] = field(default_factory=dict)
    priors: dict[str, Any] = field(default_factory=dict)
    """What was known beforehand: name -> value and std."""
    assumptions: tuple[dict[str, Any], ...] = ()
    """What neither the log nor the user gives: `what`, its `value`, and the `source` of that."""
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

    objections: tuple[Objection, ...] = field(default=(), compare=False)
    """What stands behind the reasons; those to single parameters are in the estimates."""

    advice: dict[str, Any] | None = None
    """What to fly next, of a running session: see `Advice`."""

    health: dict[str, Any] | None = field(default=None, compare=False)
    """A health file's content, of a running session or a result file: what hover shows."""

    history: "History | None" = field(default=None, compare=False)
    """Estimates over time, where `analyze(..., history=True)` kept them; not in files."""
    prediction: "Acceleration | None" = field(default=None, compare=False)
    """Angular acceleration of the held-out part, by the fit to the rest; kept in the same way."""

    @property
    def estimates(self) -> dict[str, Estimate]:
        """All of parameters and timing, by name."""
        return self.parameters | self.timing

    @property
    def layout(self) -> Airframe | None:
        """Its rotors, under the airframe's name; None where they are not known.

        Raises:
            InputError: what a file has makes no vehicle.
        """
        if not self.airframe:
            return None
        table = {"name": self.airframe.get("name"), "rotor": self.airframe.get("rotors")}
        return parse_airframe(table, "the result's airframe")

    def need_scale(self) -> None:
        """Check that values are those of a vehicle, not per kg of its mass.

        Raises:
            InputError: nothing was given to scale them.
        """
        own = self.airframe.get("own_units") or ()
        if own:
            raise InputError("{}: to analyze the log again, {}".format(*own_units_words(own)))

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
        if estimate.known is None or estimate.status in ("weak", "unobservable"):
            raise InputError(f"{name} is {estimate.status} in this result, not identified")
        return IdentifiedEstimate(**vars(estimate))

    def as_json(self) -> dict[str, Any]:
        """The result as the dictionary that `--json` writes, the caller's own to change."""
        advice = {} if self.advice is None else {"advice": self.advice}
        return deepcopy(
            {
                "schema": SCHEMA,
                "verdict": self.verdict,
                "reasons": list(self.reasons),
                "objections": [objection.as_json() for objection in self.objections],
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
                "assumptions": list(self.assumptions),
                "disturbance": self.disturbance,
                "rotors": [{k: v.as_json() for k, v in rotor.items()} for rotor in self.rotors],
                "covariance": self.covariance,
                "telemetry": self.telemetry,
                **advice,
                **({} if self.health is None else {"health": self.health}),
            }
        )

    def dumps(self, indent: int | None = 2) -> str:
        """The result as JSON text (strict: no NaN or infinity)."""
        return json_text(self.as_json(), indent)

    def write(self, path: Path, *, force: bool = False) -> None:
        """Write the result to a file; over another one only if forced.

        Raises:
            InputError: it cannot be written, or is there already.
        """
        write_whole(path, self.dumps() + "\n", replace=force)
