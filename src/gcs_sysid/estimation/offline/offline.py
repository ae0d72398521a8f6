"""The offline estimate of a flight, beside the online one.

From the samples kept `prediction_error` estimates once more, with all of the flight in view. By
what the two estimates differ beyond chance the interval is wider. Where it predicts held-out parts
of the flight far worse than the online one, that is given.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.changes.tracking import Tracker
from gcs_sysid.estimation.checks.validation import Validation
from gcs_sysid.estimation.fit.disturbance import curve_doubt
from gcs_sysid.estimation.fit.lag_places import rivals_doubt
from gcs_sysid.estimation.fit.priors import Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.offline.kept_rows import CommandRows, SpeedRows
from gcs_sysid.estimation.offline.prediction_error import PredictionErrorFit, estimate
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.record.input_noise import SpeedNoise
from gcs_sysid.estimation.rows.actuator_dynamics import LAGS_OF, LagPlace
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.significance import Z95

_WORSE = 2.0
"""Times what the online estimate leaves: other parts held out differ by half of it."""
_DELAY_STD = 0.003
"""s, of the delay of the rotor speeds' stamps about the online estimate."""

Progress = Callable[[str, float], None]
"""Called with the current step and the share of it that is done, 0 to 1."""


@dataclass(frozen=True)
class OfflineFit:
    """The offline estimate.

    Attributes:
        fit: the online one with the rotation replaced.
        bounding_fit: the same with the Cramer-Rao bound as its covariance.
        apart: (N_THETA,) by how much it differs from the online one, beyond chance and more than
            its own standard deviation; else 0. Its intervals hold that.
    """

    fit: Fit
    bounding_fit: Fit
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
    if commands and not before.of_steps:
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
    # What lags by the online estimate is the likeliest.
    every.sort(key=lambda pair: pair[1] != before.lag_place)
    for number, (rows, place) in enumerate(every):

        def on_progress(share: float, done: int = number) -> None:
            if progress is not None:
                progress(what, (done + share) / len(every))

        estimated = estimate(
            rows,
            before,
            estimator.record.input_noise.doubt,
            estimator.prior,
            choice,
            calm=estimator.is_calm,
            rival=min((other.cost for other, _ in found), default=math.inf),
            progress=on_progress,
        )
        if estimated is not None:
            found.append((estimated, place))
    if not found:
        return f"the {what} found no estimate"
    best, place = min(found, key=lambda pair: pair[0].cost)
    validation = best.validate(estimator.prior, choice)
    if _is_worse(validation, online.validation):
        return f"the {what} predicts held-out parts of the flight worse"
    rotation = best.fit.rotation
    if place is not None:
        doubt = _motor_doubt([estimated for estimated, _ in found], tracker.dt)
        doubt += curve_doubt(rotation, lambda: estimator.record.window_fit(place))
        rotation = replace(rotation.widened(doubt), lag_place=place, lag_doubt=doubt)
    own, apart = _widened(rotation, before)
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
    return OfflineFit(fit, bounded, apart)


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


def _motor_doubt(found: Sequence[PredictionErrorFit], dt: float) -> Array:
    """(N_UNKNOWNS, N_UNKNOWNS) covariance of what is not known of the motors."""
    doubt = rivals_doubt([one.fit.rotation for one in found], [one.cost for one in found])
    # Delay and lag trade against each other within a sample.
    timing = [Unknown.DELAY, Unknown.LAG]
    doubt[timing, timing] += dt**2
    return doubt


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
