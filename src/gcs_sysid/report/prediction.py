"""Measured against predicted angular acceleration, and the spectrum of what is left.

Both sides pass the estimator's own window, which averages the one and differentiates the other,
so that they are compared in the form that the fit saw.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, Mask, complete_rows, runs
from gcs_sysid.estimation.basis import CURVE, DELAY, LAG, RotorBasis
from gcs_sysid.estimation.rotors import RotorInput, RotorPath
from gcs_sysid.estimation.speed_noise import SpeedNoise
from gcs_sysid.estimation.tuning import COMMANDS, Tuning
from gcs_sysid.filters.smoothers import WindowSmoother
from gcs_sysid.filters.windows import cosine_window
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.report.recorder import Motion

_ROTOR_SIGNALS = 5
_MOST_POINTS = 512
"""Rows in one piece of a spectrum, at most."""
_LEAST_POINTS = 32


@dataclass(frozen=True)
class Model:
    """What predicts angular acceleration.

    Attributes:
        theta: (N_THETA,) of `rigid_body.THETA`.
        coordinates: (3,) rotor delay (s), motor lag (s), thrust curve.
        geometry: (3, rotors) of the airframe.
        rotor_input: what the samples hold of the rotors.
        gyro_cutoff: Hz, low-pass of the autopilot on its gyro; None: there is none.
        loop_cutoff: Hz, the same on its way into the commands.
    """

    theta: Array
    coordinates: Array
    geometry: Array
    rotor_input: RotorInput
    gyro_cutoff: float | None = None
    loop_cutoff: float | None = None


@dataclass(frozen=True)
class Prediction:
    """Rows of the forward form over a flight, NaN where a window held a missing sample.

    Attributes:
        t: (n,) s, centres of the windows.
        rates: (n, 3) averaged, rad/s.
        measured: (n, 3) angular acceleration, rad/s^2.
        predicted: (n, 3) the same of the model.
        step: s between rows.
        held_out: (n,) which rows were not fitted.
        speed_noise: (3,) variance of a row's prediction by white noise of the rotors' stream.
    """

    t: Array
    rates: Array
    measured: Array
    predicted: Array
    step: float
    held_out: Mask
    speed_noise: Array


@dataclass(frozen=True)
class Spectrum:
    """One-sided power density of the residual.

    Attributes:
        frequency: (n,) Hz.
        density: (n, 3) (rad/s^2)^2/Hz.
        white: (n, 3) that white noise of the sensors would leave: of the rotors' stream as it is
            known, of the gyro as high as found where the window amplifies such noise most.
    """

    frequency: Array
    density: Array
    white: Array


def predict(
    pieces: Iterable[Motion],
    dt: float,
    model: Model | None,
    since: float,
    until: float,
    fitted_share: float,
    rotor_input: RotorInput = "speed",
) -> Prediction:
    """Predict the angular acceleration of a flight.

    Args:
        pieces: of its samples, in order.
        dt: s between samples.
        model: None: nothing is predicted.
        since: s, from where on the model is meant to hold.
        until: s, up to where.
        fitted_share: of the rows that can be predicted, the first, that the model was fitted to.
        rotor_input: what the samples hold, if there is no model.
    """
    tuning = COMMANDS if (model.rotor_input if model else rotor_input) == "command" else Tuning()
    half = _half(dt, tuning)
    delay = 0.0 if model is None else float(model.coordinates[DELAY])
    smoother = WindowSmoother(dt, half, (delay,))
    path = _path(model, dt, half)
    found, noise = [], None
    if model is not None:
        commands = model.rotor_input == "command"
        noise = SpeedNoise(model.geometry, dt, commands=commands, loop_cutoff=model.loop_cutoff)
    for piece in pieces:
        found.append(_rows(piece, path, smoother, model))
        if noise is not None:
            noise.update(piece.rotors)
    t, rates, measured, predicted = (
        np.concatenate(parts) if parts else np.empty((0, 3))
        for parts in ([rows[k] for rows in found] for k in range(4))
    )
    t = t.reshape(-1)
    usable = complete_rows(np.column_stack([measured, predicted])) & (t >= since) & (t <= until)
    predicted = np.where(usable[:, None], predicted, np.nan)
    place = np.cumsum(usable)
    held_out: Mask = usable & (place > round(fitted_share * int(usable.sum())))
    variance = np.zeros(3)
    if model is not None and noise is not None:
        Q = rb.forward_matrix(model.theta)[:, :4]
        variance = np.diag(Q @ noise.moments(smoother, 0.0)[:4, :4] @ Q.T)
    return Prediction(t, rates, measured, predicted, smoother.step * dt, held_out, variance)


def _half(dt: float, tuning: Tuning) -> int:
    return max(tuning.min_half_samples, round(tuning.half_width / dt))


def _path(model: Model | None, dt: float, half: int) -> RotorPath | None:
    if model is None:
        return None
    lag = float(model.coordinates[LAG])
    commands = model.rotor_input == "command"
    basis = RotorBasis((0.0,), (lag,), commands=commands, half_width=half * dt)
    return RotorPath(model.geometry, dt, basis, model.gyro_cutoff)


def _rows(
    piece: Motion, path: RotorPath | None, smoother: WindowSmoother, model: Model | None
) -> tuple[Array, Array, Array, Array]:
    """Times, rates, measured and predicted accelerations of the rows that a piece completes."""
    n = len(piece.t)
    late = np.full((n, _ROTOR_SIGNALS), np.nan)
    if path is not None and model is not None:
        signals, _ = path.signals(piece.rotors)
        curve = float(model.coordinates[CURVE])
        late = signals[0] if len(signals) == 1 else (1.0 - curve) * signals[0] + curve * signals[1]
        H = signals[0][:, 4:]
    else:
        H = late[:, 4:]
    body = np.column_stack(
        [rb.rate_products(piece.rates), piece.rates, piece.rates[:, 1::-1] * H, piece.gyro]
    )
    t = piece.t[:, None]
    rows = smoother.update(np.column_stack([late, body, t]), _ROTOR_SIGNALS)
    average = rows.average[:, _ROTOR_SIGNALS:]
    gyro = slice(_ROTOR_SIGNALS + 11, _ROTOR_SIGNALS + 14)
    measured = rows.derivative[:, gyro]
    if model is None:
        predicted = np.full_like(measured, np.nan)
    else:
        x = np.column_stack(
            [rows.late_average[0, :, :4], average[:, :11], rows.late_derivative[0, :, 4]]
        )
        predicted = x @ rb.forward_matrix(model.theta).T
    return rows.average[:, -1:], average[:, 6:9], measured, predicted


def agreement(prediction: Prediction) -> tuple[Array, Array]:
    """(3,) R squared and (3,) Theil's coefficient on the rows not fitted; NaN without any."""
    rows = prediction.held_out
    if not rows.any():
        return np.full(3, np.nan), np.full(3, np.nan)
    y, z = prediction.measured[rows], prediction.predicted[rows]
    error, power, own = (np.mean(v**2, axis=0) for v in (y - z, y, z))
    return 1.0 - error / power, np.sqrt(error) / (np.sqrt(power) + np.sqrt(own))


def residual_spectrum(prediction: Prediction, dt: float, rotor_input: str) -> Spectrum | None:
    """The residual's power density on the rows not fitted, by Welch; None if too few joined."""
    residual = np.where(
        prediction.held_out[:, None], prediction.measured - prediction.predicted, np.nan
    )
    stretches = [residual[run] for run, there in runs(complete_rows(residual)) if there]
    longest = max((len(s) for s in stretches), default=0)
    size = min(_MOST_POINTS, max(_LEAST_POINTS, 2 ** int(np.log2(max(longest // 4, 1)))))
    taper = np.hanning(size + 2)[1:-1, None]
    scale = 2.0 * prediction.step / float(np.sum(taper**2))
    found = [
        np.abs(np.fft.rfft(taper * (s[a : a + size] - s[a : a + size].mean(axis=0)), axis=0)) ** 2
        for s in stretches
        for a in range(0, len(s) - size + 1, size // 2)
    ]
    if not found:
        return None
    density = scale * np.mean(found, axis=0)[1:-1]
    frequency = np.fft.rfftfreq(size, prediction.step)[1:-1]
    half = _half(dt, COMMANDS if rotor_input == "command" else Tuning())
    window = cosine_window(half, dt)
    angles = 2.0 * np.pi * np.outer(frequency, dt * np.arange(-half, half + 1))
    averaged, shape = (
        np.abs(np.exp(-1j * angles) @ taps) ** 2 for taps in (window.average, window.derivative)
    )
    total = float(window.average @ window.average)
    speeds = np.outer(2.0 * dt / total * averaged, prediction.speed_noise)
    near = shape > 0.5 * shape.max()
    gyro = np.maximum(density[near] - speeds[near], 0.01 * density[near]) / shape[near, None]
    white = speeds + shape[:, None] * gyro.mean(axis=0)
    seen = shape > 1e-4 * shape.max()
    return Spectrum(frequency[seen], density[seen], white[seen])
