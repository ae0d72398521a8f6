"""Measured against predicted angular acceleration of a flight, and the spectrum of what is left."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, Mask, complete_rows, runs
from gcs_sysid.estimation.record.command_noise import CommandNoise
from gcs_sysid.estimation.record.input_noise import SpeedNoise
from gcs_sysid.live.acceleration_prediction import (
    Model,
    Predictor,
    RotationSamples,
    half_window,
)
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.signals.smoothers import cosine_window


@dataclass(frozen=True)
class Prediction:
    """Rows of the forward form over a flight, NaN where a window held a missing sample.

    Attributes:
        t: (n,) s, centers of the windows.
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
    pieces: Iterable[RotationSamples],
    dt: float,
    model: Model | None,
    since: float,
    until: float,
    fitted_share: float,
    rotor_input: RotorInput = RotorInput.SPEED,
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
    predictor = Predictor(dt, model, rotor_input)
    found = []
    noise: SpeedNoise | CommandNoise | None = None
    if model is not None and model.rotor_input.motors:
        noise = CommandNoise(model.geometry, dt, model.loop_cutoff)
    elif model is not None:
        noise = SpeedNoise(model.geometry, dt)
    for piece in pieces:
        found.append(predictor.rows(piece))
        if noise is not None:
            noise.update(piece.rotors)
    t, rates, measured, predicted = (
        np.concatenate([getattr(rows, name) for rows in found]) if found else np.empty((0, 3))
        for name in ("t", "rates", "measured", "predicted")
    )
    t = t.reshape(-1)
    usable = complete_rows(np.column_stack([measured, predicted])) & (t >= since) & (t <= until)
    predicted = np.where(usable[:, None], predicted, np.nan)
    place = np.cumsum(usable)
    held_out: Mask = usable & (place > round(fitted_share * int(usable.sum())))
    variance = np.zeros(3)
    if model is not None and noise is not None:
        Q = rb.forward_matrix(model.theta)[:, :4]
        average, _ = predictor.smoother.noise_gains(0.0)
        variance = np.diag(Q @ (average * noise.torques) @ Q.T)
    return Prediction(
        t, rates, measured, predicted, predictor.smoother.step * dt, held_out, variance
    )


def residual_spectrum(
    prediction: Prediction, dt: float, rotor_input: RotorInput
) -> Spectrum | None:
    """The residual's power density on the rows not fitted, by Welch; None if too few joined."""
    residual = np.where(
        prediction.held_out[:, None], prediction.measured - prediction.predicted, np.nan
    )
    stretches = [residual[run] for run, there in runs(complete_rows(residual)) if there]
    longest = max((len(s) for s in stretches), default=0)
    # Rows in one piece of the spectrum.
    size = min(512, max(32, 2 ** int(np.log2(max(longest // 4, 1)))))
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
    half = half_window(dt, rotor_input)
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
