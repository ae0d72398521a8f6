"""A number with its uncertainty, and objections to it: types that all rooms hand on.

What a status or a verdict may be is here; which one there is, `judgement` alone decides.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from gcs_sysid.significance import Z95, interval95

Status = Literal["identified", "given", "zero", "weak", "unobservable"]
KNOWN: frozenset[Status] = frozenset({"identified", "given", "zero"})
"""Statuses of a parameter that a complete identification may have."""
Verdict = Literal["identified", "partial", "refused"]


@dataclass(frozen=True)
class Objection:
    """What some evidence holds against estimates, or against all of a result.

    Attributes:
        reason: what is wrong, in a pilot's words.
        parameters: those that it concerns.
        cap: the best status left to these; None: any.
        verdict: the best verdict left to the result; "identified" makes it a note, which is
            stated in any case; None: what follows from the statuses.
        widening: name -> standard deviation that it adds, SI.
        given: whether that is the same in every flight analyzed so, a part of `std_given`.
        void: whether the values mean nothing at all and are not shown.
        stated: whether the reason stands among those of the verdict; False where others imply it.
        evidence: name -> number that it rests on.
        how: what to do about it; empty where nothing is known to help.
        flying: whether that is to fly more, or otherwise.
        by: its producer.
    """

    reason: str
    parameters: frozenset[str] = frozenset()
    cap: Status | None = None
    verdict: Verdict | None = None
    widening: Mapping[str, float] = field(default_factory=dict)
    given: bool = False
    void: bool = False
    stated: bool = True
    evidence: Mapping[str, float] = field(default_factory=dict)
    how: str = ""
    flying: bool = False
    by: str = ""

    @property
    def words(self) -> str:
        """What is wrong and what to do."""
        return f"{self.reason}; {self.how}" if self.how else self.reason

    def as_json(self) -> dict[str, Any]:
        """Of a result: the cap is that of the verdict."""
        return self._with_cap(self.verdict or "identified")

    def of_parameter(self) -> dict[str, Any]:
        """Of one parameter: the cap is that of its status; None where only its interval grew."""
        return self._with_cap(self.cap)

    def _with_cap(self, cap: str | None) -> dict[str, Any]:
        how = {"how": self.how} if self.how else {}
        return {"reason": self.reason, **how, "cap": cap, "by": self.by}


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
    unit: str = ""
    """SI; "1" for pure numbers."""
    status: Status | None = None
    """How well it is known, in a word; None: not judged."""
    bound: float | None = None
    """The least standard deviation that any estimator could have on this flight."""
    rests_on: str | None = None
    """What more than half of the knowledge comes from, if not from this flight's data."""
    std_given: float = 0.0
    """The part of `std` that comes from what was given or assumed (arm, scale, IMU): the same in
    every flight analyzed with it, however long. `std` is the root of the sum of both squares."""
    not_negative: bool = False
    """Whether physics puts zero as the lower bound: see `bounded`."""
    objections: tuple[Objection, ...] = field(default=(), compare=False)
    """To its status or interval."""

    @property
    def known(self) -> "Quantity | None":
        """The same with its numbers; None where it has none."""
        return None if self.value is None or self.std is None else Quantity(**vars(self))

    @property
    def std_data(self) -> float | None:
        """The part of `std` that comes from this flight's data."""
        if self.std is None or not self.std_given:
            return self.std
        return math.sqrt(max(self.std**2 - self.std_given**2, 0.0))

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
        """The estimate as result and health files write it."""
        ci = self.ci95
        out: dict[str, Any] = {
            "value": _finite(self.value),
            "std": _finite(self.std),
            "std_data": _finite(self.std_data),
            "std_given": None if self.std is None else self.std_given,
            "ci95": None if ci is None or not all(map(math.isfinite, ci)) else list(ci),
            "unit": self.unit,
        }
        if self.status is not None:
            out["status"] = self.status
        if self.bound is not None:
            out["bound"] = _finite(self.bound)
        if self.rests_on is not None:
            out["rests_on"] = self.rests_on
        if self.status is not None:
            out["objections"] = [objection.of_parameter() for objection in self.objections]
        return out


@dataclass(frozen=True)
class Quantity(Estimate):
    """An estimate that has a value and a standard deviation."""

    value: float
    std: float

    @property
    def ci95(self) -> tuple[float, float]:
        """The 95 % interval, as of `Estimate`."""
        return interval95(self.value, self.std, not_negative=self.not_negative)

    def off_by(self, own: float = 0.0, given: float = 0.0) -> "Quantity":
        """Off by standard deviations more, of the data's and of what is given."""
        std, both = math.hypot(self.std, own, given), math.hypot(self.std_given, given)
        return replace(self, std=std, std_given=both)

    def times(self, factor: float, unit: str) -> "Quantity":
        """In proportion to it."""
        std, given = abs(factor) * self.std, abs(factor) * self.std_given
        return replace(self, value=factor * self.value, std=std, std_given=given, unit=unit)

    def under(self, numerator: float, unit: str) -> "Quantity":
        """A number over it."""
        found = self.times(numerator / self.value**2, unit)
        return replace(found, value=numerator / self.value)


class IdentifiedEstimate(Quantity):
    """As `Result.identified` returns it."""


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
