"""The offline estimate of a flight, beside the online one.

From the samples kept `prediction_error` estimates once more, with all of the flight in view; rate
setpoints, where logged, are instruments. By what the two estimates differ beyond chance the
interval is wider. Where it predicts held-out parts of the flight far worse than the online one,
that is given.

**Instruments.** A rate setpoint turns the vehicle and is independent of gusts. What it explains of
torque is free of what the rate loop answered to them, however the disturbance is colored. With rows
of one axis whitened, e what a fit leaves, s = dQ/d(ln I) x how that changes with the moment of
inertia, and Z the setpoint through a bank of Laguerre filters (0 to 0.7 s of its past), two-stage
least squares is

    s^ = Z (Z'Z)^-1 Z's ,    delta = s^'e / s^'s

with I exp(delta) the estimate by instruments (Soderstrom and Stoica, System Identification, ch. 8).
Its variance follows from the scatter of s^'e over batches, and is at least that of white e: where
the whitener is not right, instruments must hold all the same.

Instruments are weak where the first stage explains hardly more than chance (F below 10: Staiger and
Stock 1997, Econometrica 65, 557-586). They are invalid where the setpoint itself responds to the
vehicle, as that of an attitude or position loop does: innovations then predict it, beyond what its
own past does.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.changes.tracking import Tracker
from gcs_sysid.estimation.checks.validation import Validation
from gcs_sysid.estimation.fit.disturbance import RULES as DISTURBANCE
from gcs_sysid.estimation.fit.disturbance import curve_doubt
from gcs_sysid.estimation.fit.priors import Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.noise.uncertainty import meat
from gcs_sysid.estimation.offline.kept_rows import CommandRows, SpeedRows
from gcs_sysid.estimation.offline.likeliest_noise import innovations
from gcs_sysid.estimation.offline.prediction_error import (
    PredictionErrorFit,
    Whitened,
    estimate,
    sound_rows,
)
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.record.input_noise import SpeedNoise
from gcs_sysid.estimation.rows.actuator_dynamics import LAGS_OF, LagPlace
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.recursions import lfilter
from gcs_sysid.significance import Z95

_POLE = 0.035
"""s, of the Laguerre filters."""
_ORDERS = 12
"""Of them: their responses reach to 2 x _POLE x _ORDERS, 0.8 s."""
_LATE = 2
"""Rows by which setpoints are late, so that they are past whatever stamps and averages do."""
_LEAST_SECONDS = 5.0
_BATCH = 1.0
"""s."""
_WORSE = 2.0
"""Times what the online estimate leaves: other parts held out differ by half of it."""

Progress = Callable[[str, float], None]
"""Called with the current step and the share of it that is done, 0 to 1."""


@dataclass(frozen=True)
class InstrumentRules:
    """When setpoints are usable."""

    least_f: float = 10.0
    """F of the first stage."""
    most_answer: float = 7.0
    """F with which innovations predict the setpoint. Of rates asked by a script it is 0.3 to 4.7,
    of those asked by the position loop of a real flight of 17 s it is 11 and 12."""


INSTRUMENT_RULES = InstrumentRules()


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
        rules = INSTRUMENT_RULES
        return self.strength >= rules.least_f and self.answer <= rules.most_answer


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
    G = fit.deviating.jacobian(fit.theta, fit.deviations)[1]
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
    return Z @ np.linalg.solve(gram + ridge, Z.T @ signal)


def _f(signal: Array, explained: Array) -> float:
    """F of a regression on the filters' outputs."""
    power = float(explained @ explained)
    rest = max(float(signal @ signal) - power, 1e-300)
    return (power / _ORDERS) / (rest / max(len(signal) - _ORDERS, 1))


_DELAY_STD = 0.003
"""s, of the delay of the rotor speeds' stamps about the online estimate."""


@dataclass(frozen=True)
class OfflineFit:
    """The offline estimate.

    Attributes:
        fit: the online one with the rotation replaced.
        bounding_fit: the same with the Cramer-Rao bound as its covariance.
        method: which estimator it is of, in words.
        apart: (N_THETA,) by how much it differs from the online one, beyond chance and more than
            its own standard deviation; else 0. Its intervals hold that.
    """

    fit: Fit
    bounding_fit: Fit
    method: str
    apart: Array = field(default_factory=lambda: np.zeros(rb.N_THETA))


def fit_offline(
    tracker: Tracker, online: Fit, progress: Progress | None = None
) -> OfflineFit | str:
    """Estimate offline from the samples that the tracker kept.

    Args:
        tracker: with `keep`.
        online: its last fit.
        progress: called with the current step and the share of it that is done.

    Returns:
        The fit, or why there is none.
    """
    before = online.rotation
    if before is None or not tracker.kept:
        return "no online estimate to start from"
    estimator, commands = tracker.estimator, tracker.tuning.rotor_input.motors
    if commands and not before.whiteners:
        return "commands are too slow, or the motors' lag is given: there is nothing to improve"
    noise = estimator.record.input_noise
    if isinstance(noise, SpeedNoise) and noise.folded_share > 0.0:
        when = f"speeds are {1e3 * noise.interval:.0f} ms apart"
        return f"{when}, and torque jumps in between: it would bias an offline estimate more"
    count = sum(len(part.gyro) for part in tracker.kept)
    what = f"prediction error of {count} samples"
    choice = estimator.record.choice
    found: list[tuple[PredictionErrorFit, LagPlace | None]] = []
    every = _rows(tracker, before)
    for number, (rows, place) in enumerate(every):

        def on_progress(share: float, done: int = number) -> None:
            if progress is not None:
                progress(what, (done + share) / len(every))

        estimated = estimate(
            rows,
            before,
            estimator.record.noise_doubt,
            estimator.prior,
            choice,
            calm=estimator.is_calm,
            progress=on_progress,
        )
        if estimated is not None:
            found.append((estimated, place))
    if not found:
        return f"the {what} found no estimate"
    best, place = min(found, key=lambda pair: pair[0].cost)
    validation = best.whitened.validate(estimator.prior, choice)
    if _is_worse(validation, online.validation):
        return f"the {what} predicts held-out parts of the flight worse"
    rotation = best.fit.rotation
    if place is not None:
        doubt = _motor_doubt([estimated for estimated, _ in found], best, tracker.dt)
        rotation = replace(rotation.widened(doubt), lag_place=place, lag_doubt=doubt)
    own, apart = _widened(rotation, before)
    own, instrumented = combined(own, fit_by_instruments(best.whitened, own))
    thrust, accelerometer = estimator.fit_translation(own)
    fit = replace(
        online,
        rotation=own,
        translation=thrust,
        accelerometer=accelerometer,
        validation=validation,
        moments=best.moments(online.moments),
    )
    bounded = replace(fit, rotation=replace(own, covariance=np.diag(best.fit.bound**2)))
    method = "prediction error, instruments" if instrumented else "prediction error"
    return OfflineFit(fit, bounded, method, apart)


def _rows(
    tracker: Tracker, before: RotationFit
) -> list[tuple[SpeedRows | CommandRows, LagPlace | None]]:
    """What makes rows of the samples kept, by what lags behind commands."""
    tuning, estimator = tracker.tuning, tracker.estimator
    flight = tracker.kept, tracker.geometry, tracker.dt
    if not tuning.rotor_input.motors:
        reach = 3.0 * _DELAY_STD if before.delay_std else 0.0
        noise = estimator.record.signals_noise
        return [(SpeedRows(*flight, before.delay, reach, noise, tuning.gyro_cutoff), None)]
    known = before.lag_place or LagPlace()
    curve = tuning.curves[0] if len(tuning.curves) == 1 else None
    return [
        (CommandRows(*flight, of, curve, tuning.gyro_cutoff), replace(known, of=of))
        for of in LAGS_OF
    ]


def _motor_doubt(found: Sequence[PredictionErrorFit], best: PredictionErrorFit, dt: float) -> Array:
    """(N_UNKNOWNS, N_UNKNOWNS) covariance of what is not known of the motors.

    By what another place of the lag leads to the best one may be off, with that place's
    probability (Bayesian model averaging: Hoeting et al. 1999, Statistical Science 14, 382-417).
    """
    fit = best.fit.rotation
    weight = np.exp([best.cost - other.cost for other in found])
    away = np.stack([other.fit.rotation.unknowns for other in found]) - fit.unknowns
    doubt: Array = (away * (weight / weight.sum())[:, None]).T @ away
    # Delay and lag trade against each other within a sample.
    timing = [Unknown.DELAY, Unknown.LAG]
    doubt[timing, timing] += dt**2
    return doubt + curve_doubt(fit)


def _is_worse(validation: Validation | None, online: Validation | None) -> bool:
    """Whether far more of the held-out motion of the worst axis stays unexplained."""
    if validation is None or online is None:
        return False
    left, before = (1.0 - float(each.r_squared.min()) for each in (validation, online))
    return left > _WORSE * before


def _widened(fit: RotationFit, online: RotationFit) -> tuple[RotationFit, Array]:
    """Disagreement beyond chance between two estimates of one flight counts as error of either.

    The online one weighs the same rows less well, so that by chance they differ by the difference
    of their variances (Hausman 1978, Econometrica 46, 1251-1271).
    """
    apart = fit.theta - online.theta
    # Two estimates differ by so much by chance.
    chance = Z95**2 * np.maximum(online.std**2 - fit.std**2, 0.0)
    error = np.sqrt(np.maximum(apart**2 - chance, 0.0)) * np.sign(apart)
    shown = np.where(np.abs(error) > fit.std, error, 0.0)
    return fit.widened(np.outer(error, error)), shown
