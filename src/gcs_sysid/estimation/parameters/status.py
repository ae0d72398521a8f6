"""How well a value is known, in one word, and what becomes of that where the model is in doubt."""

import math
from dataclasses import dataclass, replace

from gcs_sysid.intervals import Z95
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import Parameter, Sign


@dataclass(frozen=True)
class StatusRules:
    """Where one status ends and the next begins.

    Where gusts or unmodeled torques move the vehicle more than its rotors do, the controller's
    reaction to them is mistaken for the vehicle's response, and intervals are confidently wrong:
    hence the rules on R², the share of an axis' angular acceleration that is explained.
    """

    identified_below: float = 0.05
    """Standard deviation over the reference value."""
    unobservable_above: float = 0.5
    """The same, above which the data carry no useful information."""
    weak_below_r2: float = 0.8
    """R² below which nothing on that axis is identified."""
    unobservable_below_r2: float = 0.5
    """R² below which it is not even weak."""
    impossible_below: float = -3.0
    """Standard deviations below zero from which a value that cannot be negative contradicts the
    model: noise alone does so once in 740 estimates of zero."""
    weak_below_whitened: float = 0.35
    unobservable_below_whitened: float = 0.2
    """The same of whitened rows, of which slow disturbances are taken out and much is noise: 0.99
    in calm air, 0.36 to 0.96 on real flights, whose inertia is right to 5 %; a vehicle with two
    rotors swapped has 0.0 to 0.4."""

    def explained(self, *, whitened: bool) -> tuple[float, float]:
        """Shares of an axis' acceleration, below which nothing is identified, or even weak.

        Args:
            whitened: whether of whitened rows.
        """
        if whitened:
            return self.weak_below_whitened, self.unobservable_below_whitened
        return self.weak_below_r2, self.unobservable_below_r2


RULES = StatusRules()


NOTHING = Estimate(None, None, status="unobservable")


def judged(value: float, std: float, reference: float, sign: Sign = "positive") -> Estimate:
    """A value with the status that its standard deviation gives it.

    Args:
        value: SI.
        std: standard deviation.
        reference: what it is divided by.
        sign: physical bound. What may be zero, and is small with an interval that contains zero,
            is "zero". Of what cannot be negative, but is, nothing is left: the model is wrong.
    """
    if not (math.isfinite(value) and math.isfinite(std)):
        return NOTHING
    if sign == "not negative" and value < RULES.impossible_below * std:
        return NOTHING
    ratio = std / reference if reference > 0.0 else math.inf
    if ratio < RULES.identified_below:
        low = -math.inf if sign == "not negative" else -Z95 * std
        zero = sign != "positive" and low <= value <= Z95 * std
        return Estimate(value, std, status="zero" if zero else "identified")
    return Estimate(
        value, std, status="weak" if ratio < RULES.unobservable_above else "unobservable"
    )


def doubted(
    value: Estimate, parameter: Parameter, r_squared: tuple[float, ...], *, whitened: bool = False
) -> Estimate:
    """The value, its status lowered where the model explains too little on one of its axes.

    Args:
        value: of the parameter. What must be positive, and is not, is weak at most: the airframe's
            spins are wrong.
        parameter: which.
        r_squared: of roll, pitch and yaw.
        whitened: whether it is of whitened rows.
    """
    if parameter.sign == "positive" and value.value is not None and value.value <= 0.0:
        value = replace(value, status="weak" if value.status == "identified" else value.status)
    weak_below, lost_below = RULES.explained(whitened=whitened)
    axes = () if parameter.mean_torque else parameter.axes
    worst = min((r_squared[axis] for axis in axes), default=1.0)
    if value.status in ("given", "unobservable") or worst >= weak_below:
        return value
    return replace(value, status="weak" if worst >= lost_below else "unobservable")
