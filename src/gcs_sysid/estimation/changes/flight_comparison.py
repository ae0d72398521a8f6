"""Several flights in one record: whether the vehicle that takes off is the one that landed.

On the ground anything may change: battery, payload, propellers. So the first seconds of each
further flight are estimated separately and compared with the earlier estimate.
"""

import numpy as np
from scipy.linalg import block_diag

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.rows.actuator_dynamics import Coordinate
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.records import Samples
from gcs_sysid.significance import FALSE_ALARM_RATE, joint_chance

ENOUGH = 10.0
"""s of a flight used to decide whether the vehicle is the same."""

_COMPARED = range(rb.DAMPING)
"""Of theta: inertia, CG, torque over thrust. Damping and rotor inertia are too weakly
observable."""
_MODEL_ERROR = 0.01
"""Share by which fits of one vehicle may differ beyond their intervals: the model's own error,
with wind, inflow and temperature."""
_KNOWN_TO = 0.25
"""A parameter known less well than this share of its size is not compared: the smaller of both, as
what a flight hardly moves may come out next to nothing, with a deviation in proportion."""


class Trial:
    """The samples of the beginning of a flight, until it is decided what vehicle it is.

    Args:
        landed: s, session time at which the flight before ended.
        start: s, session time of the first sample.
        dt: s between samples.
    """

    def __init__(self, landed: float, start: float, dt: float) -> None:
        self.landed, self.start = landed, start
        self.end = start
        """s, session time of the newest sample."""
        self.parts: list[tuple[Array, Samples] | None] = []
        """Times and samples in order; None where one part does not join on to the next."""
        self._needed = round(ENOUGH / dt)

    @property
    def room(self) -> int:
        """Samples to come until there are enough."""
        return self._needed - sum(len(part[0]) for part in self.parts if part is not None)

    def add_samples(self, t: Array, samples: Samples) -> None:
        """Add (n,) times and samples."""
        self.parts.append((t, samples))
        self.end = float(t[-1])

    def restart(self) -> None:
        """A gap: what comes next does not join on to what came before."""
        if self.parts and self.parts[-1] is not None:
            self.parts.append(None)

    def drop_last(self, seconds: float) -> None:
        """Leave out the last moments: a landing."""
        for i, part in enumerate(self.parts):
            if part is not None:
                stay = part[0] <= self.end - seconds
                self.parts[i] = part[0][stay], part[1].part(stay)

    def is_another(self, before: Fit, fresh: OnlineEstimator, arm: float) -> bool:
        """Whether what flies cannot be the vehicle of a fit.

        Rotors are the same, or no scale would carry over: with commands T_max / m goes with the
        thrust curve, with speeds k_T / m with what rotors differ by, as where one is read wrong;
        both the first seconds of a flight hardly determine.

        Args:
            before: of the flight before.
            fresh: estimates the samples.
            arm: m, mean distance of the rotors.
        """
        for part in self.parts:
            if part is None:
                fresh.restart()
            else:
                fresh.update(part[1])
        drift = fresh.record.drift
        battery = 0.0 if drift is None else drift.thrust_doubt
        now = fresh.with_thrust_by(before.rotation, fresh.fit())
        return is_another(before, now, arm, battery)


def is_another(before: Fit, now: Fit, arm: float, battery: float = 0.0) -> bool:
    """Whether two fits of different flights cannot be of one vehicle.

    A chi-square test on what both know: k_T over mass, and what the rotation has relative to k_T.

    Args:
        before: the one.
        now: the other, with thrust by the rotors of the one.
        arm: m, mean distance of the rotors, by which a CG is judged.
        battery: one standard deviation of what another state of the battery may do to thrust,
            relative.
    """
    of_thrust = _thrust(before, now)
    a, b = before.rotation, now.rotation
    parts: list[tuple[Array, Array, Array]] = []
    """Difference, covariance, and what the battery does to it."""
    if of_thrust is not None:
        ratio, variance = of_thrust
        own = np.array([[variance + _MODEL_ERROR**2]])
        parts.append((np.array([ratio - 1.0]), own, np.array([battery])))
    if a is not None and b is not None:
        theta, size = a.theta, rb.counterparts(a.theta, arm)
        least = _KNOWN_TO * np.minimum(size, rb.counterparts(b.theta, arm))
        known = [i for i in _COMPARED if max(a.std[i], b.std[i]) < least[i]]
        covariance = _color(before) * a.covariance + _color(now) * b.covariance
        covariance += np.diag((_MODEL_ERROR * size) ** 2)
        moved = np.where(rb.RELATIVE, -battery * theta, 0.0)[known]
        parts.append(((b.theta - theta)[known], covariance[np.ix_(known, known)], moved))
    if not any(len(difference) for difference, _, _ in parts):
        return False
    differences, covariances, by_battery = zip(*parts, strict=True)
    # A battery moves all that is relative to thrust alike: inertia over mass it leaves alone.
    common = np.concatenate(by_battery)
    covariance = block_diag(*covariances) + np.outer(common, common)
    return joint_chance(np.concatenate(differences), covariance) < FALSE_ALARM_RATE


def _color(fit: Fit) -> float:
    """By how much power at low frequency exceeds what the residuals' noise allows; 1 if unknown.

    Slow unmodeled moments move the fits of two flights apart by more than either's interval, which
    follows from the scatter of residuals.
    """
    if fit.validation is None:
        return 1.0
    known = fit.validation.whiteness[np.isfinite(fit.validation.whiteness)]
    return float(np.max(known, initial=1.0))


def _thrust(before: Fit, now: Fit) -> tuple[float, float] | None:
    """Ratio of k_T over mass, and its variance; None if it is not known."""
    a, b = before.translation, now.translation
    if a is not None and b is not None and a.source != b.source:
        # An accelerometer's bias is in both of its own.
        a, b = before.accelerometer, now.accelerometer
    if a is None or b is None or not max(a.kappa_std, b.kappa_std) < _KNOWN_TO * a.kappa:
        return None
    variance = (a.kappa_std**2 + b.kappa_std**2) / a.kappa**2
    if before.rotation is not None:
        # The curve is one: its error moves both alike, but for how near full thrust they hover.
        slopes = b.curve_slope / b.kappa - a.curve_slope / a.kappa
        variance += (slopes * float(before.rotation.coordinates_std[Coordinate.CURVE])) ** 2
    return b.kappa / a.kappa, variance
