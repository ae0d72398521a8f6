"""Measured against predicted angular acceleration, in the form that the fit saw.

Both sides pass the estimator's own window, which averages the one and differentiates the other.
A report predicts a whole flight afterwards; a live session predicts each block of samples by the
fit that was in force before the block came, so that what is shown was never fitted.
"""

from collections import deque
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.record.tuning import tuning_for
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics, Coordinate
from gcs_sysid.estimation.rows.rotor_signals import RotorPath
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.history import Acceleration
from gcs_sysid.session.chain import Chain
from gcs_sysid.signals.sampling import SampleBlock
from gcs_sysid.signals.smoothers import WindowSmoother

_ROTOR_SIGNALS = 5
_RATES = slice(rb.RATE_SIGNALS.index("p"), rb.RATE_SIGNALS.index("r") + 1)
KEPT = 10.0
"""s of rows that a live session shows."""
_SETTLING = 5.0
"""Time constants that a motor's lag needs before its signal counts."""
_LEAST_CUTOFF_CYCLES = 1.5
"""Periods of the gyro's low-pass that it needs to settle, roundly."""


@dataclass(frozen=True)
class RotationSamples:
    """Samples of rotation on the uniform grid; NaN where there are none or it does not fly.

    Attributes:
        t: (n,) s since the first record.
        gyro: (n, 3) as measured, rad/s.
        rates: (n, 3) without bias, rad/s.
        rotors: (n, rotors) speeds in rad/s, or commands of 0 to 1.
    """

    t: Array
    gyro: Array
    rates: Array
    rotors: Array


@dataclass(frozen=True)
class Model:
    """What predicts angular acceleration.

    Attributes:
        Q: (3, N_SIGNALS) of w' = Q x.
        coordinates: (3,) rotor delay (s), motor lag (s), thrust curve.
        geometry: (3, rotors) of the airframe.
        rotor_input: what the samples hold of the rotors.
        gyro_cutoff: Hz, low-pass of the autopilot on its gyro; None: there is none.
        loop_cutoff: Hz, the same on its way into the commands.
    """

    Q: Array
    coordinates: Array
    geometry: Array
    rotor_input: RotorInput
    gyro_cutoff: float | None = None
    loop_cutoff: float | None = None


@dataclass(frozen=True)
class PredictionRows:
    """Rows of the forward form, NaN where a window held a missing sample.

    Attributes:
        t: (n,) s, centers of the windows.
        rates: (n, 3) averaged, rad/s.
        measured: (n, 3) angular acceleration, rad/s^2.
        predicted: (n, 3) the same of the model; NaN without one.
    """

    t: Array
    rates: Array
    measured: Array
    predicted: Array

    def part(self, rows: Mask) -> "PredictionRows":
        """Some of the rows."""
        return PredictionRows(
            self.t[rows], self.rates[rows], self.measured[rows], self.predicted[rows]
        )


def half_window(dt: float, rotor_input: RotorInput) -> int:
    """Samples on either side of a row's center, as the estimator takes them."""
    tuning = tuning_for(rotor_input, dt)
    return max(tuning.min_half_samples, round(tuning.half_width / dt))


@lru_cache(maxsize=4)
def _basis_of(lag: float, motors: bool, half_width: float) -> ActuatorDynamics:
    return ActuatorDynamics((0.0,), (lag,), motors=motors, half_width=half_width)


class Predictor:
    """Makes rows of samples, piece by piece.

    Args:
        dt: s between samples.
        model: None: nothing is predicted.
        rotor_input: what the samples hold, if there is no model.
    """

    def __init__(
        self, dt: float, model: Model | None, rotor_input: RotorInput = RotorInput.SPEED
    ) -> None:
        self.half = half_window(dt, model.rotor_input if model else rotor_input)
        self.smoother = WindowSmoother(
            dt, self.half, (0.0 if model is None else float(model.coordinates[Coordinate.DELAY]),)
        )
        self._model = model
        self._path: RotorPath | None = None
        if model is not None:
            lag, motors = float(model.coordinates[Coordinate.LAG]), model.rotor_input.motors
            basis = _basis_of(lag, motors, self.half * dt)
            self._path = RotorPath(model.geometry, dt, basis, model.gyro_cutoff)

    def rows(self, piece: RotationSamples) -> PredictionRows:
        """The rows that the next samples complete."""
        n, model = len(piece.t), self._model
        late = np.full((n, _ROTOR_SIGNALS), np.nan)
        H = late[:, 4:]
        if self._path is not None and model is not None:
            signals, _, _ = self._path.signals(piece.rotors)
            curve = float(model.coordinates[Coordinate.CURVE])
            late = signals[0]
            if len(signals) > 1:
                late = (1.0 - curve) * signals[0] + curve * signals[1]
            H = signals[0][:, 4:]
        body = np.column_stack(
            [rb.rate_signals(piece.rates), piece.rates[:, 1::-1] * H, piece.gyro]
        )
        t = piece.t[:, None]
        rows = self.smoother.update(np.column_stack([late, body, t]), _ROTOR_SIGNALS)
        inputs = rb.N_SIGNALS - _ROTOR_SIGNALS
        average = rows.average[:, _ROTOR_SIGNALS:]
        measured = rows.derivative[:, rb.N_SIGNALS : rb.N_SIGNALS + 3]
        predicted = np.full_like(measured, np.nan)
        if model is not None:
            x = np.column_stack(
                [rows.late_average[0, :, :4], average[:, :inputs], rows.late_derivative[0, :, 4]]
            )
            predicted = x @ model.Q.T
        return PredictionRows(rows.average[:, -1], average[:, _RATES], measured, predicted)


class LivePrediction:
    """An observer of a chain: the last seconds, each row predicted before it was fitted.

    Blocks are gathered while the fit is unchanged, or not viewed: a prediction costs as much for
    one block as for ten.
    """

    def __init__(self, chain: Chain) -> None:
        self._chain = chain
        self._samples: deque[SampleBlock] = deque()
        self._waiting: list[SampleBlock] = []
        self._model: Model | None = None
        self._by: RotationFit | None = None
        """Whose model it is."""
        self._rows: deque[PredictionRows] = deque()

    def add_samples(self, block: SampleBlock) -> None:
        """Predict what this block adds by the fit there is; the chain takes it afterwards."""
        waiting = self._waiting
        others = self._chain.fit.rotation is not self._by  # of another fit
        if waiting and (block.fresh or block.dt != waiting[-1].dt or others):
            self._predict()
        if not waiting:
            self._model = self._model_in_force()
        waiting.append(block)
        if block.t[-1] - waiting[0].t[0] > KEPT:
            self._predict()

    def acceleration(self) -> Acceleration | None:
        """The last seconds; None while nothing was predicted in them."""
        self._predict()
        if not self._rows:
            return None
        t, measured, predicted = (
            np.concatenate([getattr(rows, name) for rows in self._rows])
            for name in ("t", "measured", "predicted")
        )
        return Acceleration(t, measured, predicted)

    def _predict(self) -> None:
        """Rows of the blocks that wait."""
        if not self._waiting:
            return
        samples, first, last = self._samples, self._waiting[0], self._waiting[-1]
        if samples and (first.fresh or first.dt != samples[-1].dt):
            samples.clear()
        if self._rows and first.t[0] < self._rows[-1].t[-1]:
            self._rows.clear()
        samples.extend(self._waiting)
        self._waiting.clear()
        model = self._model
        if model is None:
            self._drop(first, 1.0)
            return
        predictor = Predictor(first.dt, model)
        settling = _SETTLING * float(model.coordinates[Coordinate.LAG])
        if model.gyro_cutoff is not None:
            settling += _LEAST_CUTOFF_CYCLES / model.gyro_cutoff
        room = predictor.half * first.dt + abs(float(model.coordinates[Coordinate.DELAY]))
        # As many samples before the first block as its first new row and the filters need.
        self._drop(first, settling + 2.0 * room + (predictor.smoother.step + 3) * first.dt)
        rows = predictor.rows(_joined(samples))
        seen = self._rows[-1].t[-1] if self._rows else -np.inf
        new = (rows.t > seen + 0.5 * predictor.smoother.step * first.dt) & np.isfinite(
            rows.predicted[:, 0] + rows.measured[:, 0]
        )
        if new.any():
            self._rows.append(rows.part(new))
        while self._rows and self._rows[0].t[-1] < last.t[-1] - KEPT:
            self._rows.popleft()

    def _model_in_force(self) -> Model | None:
        chain = self._chain
        self._by = fit = chain.fit.rotation
        if fit is None:
            return None
        geometry = chain.airframe.geometry
        cutoff = chain.cutoffs[0]
        return Model(fit.Q, fit.coordinates, geometry, chain.rotor_input, cutoff)

    def _drop(self, block: SampleBlock, seconds: float) -> None:
        """Forget the blocks that ended so long before this one began."""
        while self._samples[0].t[-1] < block.t[0] - seconds:
            self._samples.popleft()


def _joined(blocks: deque[SampleBlock]) -> RotationSamples:
    return RotationSamples(
        np.concatenate([block.t for block in blocks]),
        np.concatenate([block.samples.gyro for block in blocks]),
        np.concatenate([block.samples.rates for block in blocks]),
        np.concatenate([block.samples.speeds for block in blocks]),
    )
