"""Setpoints as instrumental variables: Ixx and Iyy from what the pilot asked, a second opinion.

A rate setpoint turns the vehicle and is independent of gusts. What it explains of torque is free of
what the rate loop answered to them, however the disturbance is colored. With rows of one axis
whitened, e what a fit leaves, s = dQ/d(ln I) x how that changes with the moment of inertia, and Z
the setpoint through a bank of Laguerre filters (0 to 0.7 s of its past), two-stage least squares is

    s^ = Z (Z'Z)^-1 Z's ,    delta = s^'e / s^'s

with I exp(delta) the estimate by instruments (Soderstrom and Stoica, System Identification, ch. 8).
Its variance follows from the scatter of s^'e over batches, and is at least that of white e: where
the whitener is not right, instruments must hold all the same.

Instruments are weak where the first stage explains hardly more than chance (F below 10: Staiger and
Stock 1997, Econometrica 65, 557-586). They are invalid where the setpoint itself responds to the
vehicle, as that of an attitude or position loop does: innovations then predict it, beyond what its
own past does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.disturbance import RULES as DISTURBANCE
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.noise.uncertainty import meat
from gcs_sysid.estimation.offline.likeliest_noise import innovations
from gcs_sysid.estimation.offline.prediction_error import Whitened, sound_rows
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.recursions import lfilter

_POLE = 0.035
"""s, of the Laguerre filters."""
_ORDERS = 12
"""Of them: their responses reach to 2 x _POLE x _ORDERS, 0.8 s."""
_LATE = 2
"""Rows by which setpoints are late, so that they are past whatever stamps and averages do."""
_LEAST_SECONDS = 5.0
_BATCH = 1.0
"""s."""


@dataclass(frozen=True)
class InstrumentRules:
    """When setpoints are usable."""

    least_f: float = 10.0
    """F of the first stage."""
    most_answer: float = 7.0
    """F with which innovations predict the setpoint. Of rates asked by a script it is 0.3 to 4.7,
    of those asked by the position loop of a real flight of 17 s it is 11 and 12."""


RULES = InstrumentRules()


@dataclass(frozen=True)
class InstrumentFit:
    """Estimate of one axis with setpoints as instruments.

    Attributes:
        delta: by which ln I differs from the fit's.
        std: of it.
        strength: F of the first stage.
        answer: F with which innovations predict the setpoint.
    """

    delta: float
    std: float
    strength: float
    answer: float

    @property
    def believed(self) -> bool:
        """Whether they are instruments, and strong enough."""
        return self.strength >= RULES.least_f and self.answer <= RULES.most_answer


def fit_by_instruments(
    flight: Whitened, fit: RotationFit
) -> tuple[InstrumentFit | None, InstrumentFit | None]:
    """Roll and pitch by their setpoints; None where there are none, or too little of them.

    Args:
        flight: rows.
        fit: to them.
    """
    residuals = flight.residuals(fit)
    sound = sound_rows(residuals, flight.time, fit.whiteners)
    P = flight.basis.map_at(fit.coordinates)[: rb.N_SIGNALS]
    G = rb.forward_jacobian(fit.theta, fit.deviating.torque(fit.deviations))[1]
    found = []
    for axis in (0, 1):
        # By how much the predicted acceleration changes with ln Ixx or ln Iyy.
        slope = fit.theta[axis] * G[axis, axis] @ P
        parts = []
        for run, residual, ok in zip(flight.runs, residuals, sound, strict=True):
            asked = run.setpoint[:, axis]
            if np.isfinite(asked).all():
                signals = residual[:, axis], run.rows @ slope, asked
                white = (innovations(signal, fit.whiteners[axis]) for signal in signals)
                parts.append((*white, ok))
        found.append(fit_axis(parts, flight.time))
    return found[0], found[1]


def combined(fit: RotationFit, found: Sequence[InstrumentFit | None]) -> tuple[RotationFit, bool]:
    """A fit moved towards its instruments as far as there is evidence that it is biased.

    The fit has an unknown bias b ~ N(0, tau^2). The maximum-likelihood tau^2 is delta^2 minus the
    variance of the contrast delta under no bias (Hausman). The estimate is corrected by w delta,
    w = tau^2 / delta^2, and the remaining uncertainty of b widens its interval.

    Args:
        fit: of the record.
        found: of roll and pitch.

    Returns:
        The fit, and whether instruments moved it.
    """
    theta, full = fit.theta.copy(), fit.full_covariance.copy()
    n, moved = rb.N_THETA, False
    for axis, by in enumerate(found):
        if by is None or not by.believed or fit.disturbance[axis] <= DISTURBANCE.detected:
            continue
        own = float(fit.std[axis] / fit.theta[axis])
        share = max(0.0, 1.0 - max(by.std**2 - own**2, 0.0) / max(by.delta**2, 1e-300))
        if not share:
            continue
        trial = theta.copy()
        trial[axis] *= np.exp(share * by.delta)
        if not rb.is_physical(trial):
            continue
        variance = (1.0 - share) * own**2 + share * by.std**2 + share * (1.0 - share) * by.delta**2
        widening = max(variance - own**2, 0.0) * theta[axis] ** 2
        theta, moved = trial, True
        full[axis, axis] += widening
    if not moved:
        return fit, False
    return replace(fit, theta=theta, covariance=full[:n, :n], full_covariance=full), True


def fit_axis(parts: Sequence[tuple[Array, ...]], T: float) -> InstrumentFit | None:
    """Of whitened residual, slope and setpoint, and which rows are sound, of every run."""
    rows = sum(int(sound.sum()) for *_, sound in parts)
    if rows * T < _LEAST_SECONDS:
        return None
    e, s, z = (np.concatenate([part[i][part[3]] for part in parts]) for i in range(3))
    if not z.any():
        return None
    Z, answers = (
        np.concatenate([_laguerre(part[i], T)[part[3]] for part in parts]) for i in (2, 0)
    )
    predicted = _projected(s, Z)
    power = float(predicted @ predicted)
    delta = float(predicted @ e) / max(power, 1e-300)
    left = e - delta * s
    # What the setpoint's own past predicts is not feedback (Granger 1969, Econometrica 37).
    left_of_z = z - _projected(z, Z)
    left_of_answers = answers - _projected(answers, Z)
    scores = np.add.reduceat(predicted * left, np.arange(0, rows, max(round(_BATCH / T), 1)))
    variance = max(float(meat(scores[:, None])[0, 0]), float(left @ left) / rows * power)
    return InstrumentFit(
        delta,
        float(np.sqrt(variance)) / max(power, 1e-300),
        _f(s, predicted),
        _f(left_of_z, _projected(left_of_z, left_of_answers)),
    )


def _laguerre(signal: Array, T: float) -> Array:
    """(n, _ORDERS) of (n,): a low-pass, then one all-pass after the other."""
    a = float(np.exp(-T / _POLE))
    late = np.concatenate([np.zeros(_LATE), signal[:-_LATE]])
    out = [lfilter([np.sqrt(1.0 - a * a)], [1.0, -a], late)[0]]
    for _ in range(_ORDERS - 1):
        out.append(lfilter([-a, 1.0], [1.0, -a], out[-1])[0])
    return np.stack(out, axis=1)


def _projected(signal: Array, Z: Array) -> Array:
    """What (n, k) columns explain of (n,) or (n, m) signals."""
    gram = Z.T @ Z
    ridge = 1e-9 * np.trace(gram) / len(gram) * np.eye(len(gram))
    explained: Array = Z @ np.linalg.solve(gram + ridge, Z.T @ signal)
    return explained


def _f(signal: Array, explained: Array) -> float:
    """F of a regression on the filters' outputs."""
    power = float(explained @ explained)
    rest = max(float(signal @ signal) - power, 1e-300)
    return (power / _ORDERS) / (rest / max(len(signal) - _ORDERS, 1))
