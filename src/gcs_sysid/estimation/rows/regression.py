"""From aligned signals to regression rows: products, window, leak.

All signals of both sides pass the same linear filter, so its lag cancels: a smoother
(`gcs_sysid.signals.smoothers`), and for the rotation then perhaps a leaky sum. The leak
integrates both sides again: gyro noise, which differentiation made grow with frequency, becomes
nearly white, which is what least squares weighs best. Where noise of the rotor speeds
dominates, no leak is better; the estimator carries both and takes the more certain one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, Mask, runs
from gcs_sysid.estimation.rows.actuator_dynamics import BODY, SIGNALS, ActuatorDynamics
from gcs_sysid.estimation.rows.rotor_signals import RotorPath
from gcs_sysid.estimation.rows.thrust_drift import Drift, ThrustDrift
from gcs_sysid.model import attitude, rigid_body
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.one_step import OneStep
from gcs_sysid.signals.records import Samples
from gcs_sysid.signals.smoothers import Smoothed, Smoother


@dataclass(frozen=True)
class RegressionRows:
    """Regression rows, NaN where a window held a sample that must not be used.

    Attributes:
        rotation: (1, n, width) of elements, see `estimation.rows.actuator_dynamics`.
        momentum: (3, n, thrusts + 3), one for each world axis: the thrust of each lag and set
            along it, velocity, 1, and what they make up.
        accelerometer: (n, thrusts + 3).
        one_step: (m, width') of elements, over one step; m = 0 where none are made.
        inputs: (samples, rotors) speeds or commands that the rows were made of.
        drift: for which commands were corrected; None: no correction.
    """

    rotation: Array
    momentum: Array
    accelerometer: Array
    one_step: Array
    inputs: Array
    drift: Drift | None


class RowMaker:
    """Makes rows from samples, block by block, with the same result as in one pass.

    Args:
        path: makes the rotors' signals.
        basis: that they are for.
        smoother: the filter on both sides.
        one_step: makes rows of one step beside them, and their basis; None: not needed.
        drift: of thrust at a given command, for which commands are corrected; None: no correction.
    """

    def __init__(
        self,
        path: RotorPath,
        basis: ActuatorDynamics,
        smoother: Smoother,
        one_step: tuple[OneStep, ActuatorDynamics] | None = None,
        drift: ThrustDrift | None = None,
    ) -> None:
        self._path = path
        self._drift = drift
        self._basis = basis
        self._smoother = smoother
        self._one_step = one_step
        self._thrusts = thrusts = basis.thrusts
        self._late = late = SIGNALS * len(basis.lags) * basis.sets
        # Columns of what is smoothed: after the rotors' signals those of the body, then the rest.
        self._lift = slice(late + BODY, late + BODY + 3 * thrusts)
        self._thrust = slice(self._lift.stop, self._lift.stop + thrusts)
        self._products = slice(self._thrust.stop, self._thrust.stop + basis.products)
        self._bends = slice(self._products.stop, self._products.stop + basis.bends)
        self._width = self._bends.stop + 4
        self._past: Array = np.empty(0)

    def restart(self) -> None:
        """Forget what a gap separates from the next samples."""
        self._path.restart()
        self._past = np.empty(0)
        self._smoother.restart()
        if self._one_step is not None:
            self._one_step[0].restart()

    def count_after(self, samples: int) -> int:
        """How many rows so many more samples will complete."""
        return self._smoother.count_after(samples)

    def steps_after(self, samples: int) -> int:
        """How many rows of one step so many more samples will complete."""
        return 0 if self._one_step is None else self._one_step[0].count_after(samples)

    def update(self, samples: Samples) -> RegressionRows:
        """The rows that these samples complete."""
        inputs, drift = samples.speeds, None
        if self._drift is not None:
            drift = self._drift.update(inputs, samples.force[:, 2], samples.voltage[:, 0])
            inputs = inputs * drift.factors[:, None]
        signals = self._signals(samples, inputs)
        rows = self._smoother.update(signals, self._late)
        n, thrusts = len(rows.average), self._thrusts
        one_step = np.empty((0, 0))
        if self._one_step is not None:
            step, basis = self._one_step
            one_step = self._of_elements(
                step.update(signals[:, : self._late + BODY], self._late), basis
            )
        momentum = np.empty((3, n, thrusts + 3))
        momentum[..., :thrusts] = (
            rows.average[:, self._lift].reshape(n, thrusts, 3).transpose(2, 0, 1)
        )
        momentum[..., -3] = rows.average[:, -4:-1].T
        momentum[..., -2] = 1.0
        momentum[..., -1] = rows.derivative[:, -4:-1].T
        momentum[2, :, -1] -= GRAVITY
        accelerometer = np.ones((n, thrusts + 3))
        accelerometer[:, :thrusts] = rows.average[:, self._thrust]
        accelerometer[:, -3] = 0.0
        accelerometer[:, -1] = rows.average[:, -1]
        rotation = self._of_elements(rows, self._basis)[None]
        return RegressionRows(rotation, momentum, accelerometer, one_step, inputs, drift)

    def _of_elements(self, rows: Smoothed, basis: ActuatorDynamics) -> Array:
        """(n, width) rows of elements."""
        late, n = self._late, len(rows.average)
        shape = (len(rows.late_average), n, len(basis.lags), basis.sets, SIGNALS)
        # Of roll, pitch, thrust and yaw the average, of H the derivative.
        rotors = rows.late_average.reshape(shape)
        rotors[..., -1] = rows.late_derivative.reshape(shape)[..., -1]
        out = np.empty((n, basis.width))
        delays, lags = [e.delay for e in basis.elements], [e.lag for e in basis.elements]
        chosen = rotors[delays, :, lags]
        out[:, : basis.late] = np.swapaxes(chosen, 0, 1).reshape(n, basis.late)
        bent = basis.late + basis.products
        if basis.products:
            out[:, basis.late : bent] = rows.average[:, self._products]
        if basis.bends:
            out[:, bent:-BODY] = rows.average[:, self._bends]
        out[:, -BODY:-3] = rows.average[:, late : late + BODY - 3]
        out[:, -3:] = rows.derivative[:, late + BODY - 3 : late + BODY]
        return out

    def _signals(self, s: Samples, inputs: Array) -> Array:
        rotors, bent, thrust = self._path.signals(inputs)
        n, late = len(s.gyro), self._late
        H = rotors[0, :, 4]
        out = np.empty((n, self._width))
        out[:, :late] = np.swapaxes(rotors, 0, 1).reshape(n, late)
        if self._basis.products:
            forms = self._forms(rotors[..., 4])[1:]
            products = s.rates[None, :, 1::-1] * forms[..., None]
            out[:, self._products] = np.swapaxes(products, 0, 1).reshape(n, -1)
        out[:, self._bends] = np.swapaxes(bent, 0, 1).reshape(n, -1)
        coupled, gyro = late + len(rigid_body.RATE_SIGNALS), late + BODY - 3
        out[:, late:coupled] = rigid_body.rate_signals(s.rates)
        out[:, coupled:gyro] = s.rates[:, 1::-1] * H[:, None]  # q H, p H
        out[:, gyro : late + BODY] = s.gyro
        lift = attitude.down_axis(s.attitude) * thrust[..., None]
        out[:, self._lift] = np.swapaxes(lift, 0, 1).reshape(n, -1)
        out[:, self._thrust] = thrust.T
        out[:, -4:-1] = s.velocity
        out[:, -1] = s.force[:, 2]
        return out

    def _forms(self, H: Array) -> Array:
        """(forms, n) of the (lags * sets, n) H that the products of rates and H are formed with."""
        basis = self._basis
        if basis.coupled_lags:
            sets = range(basis.sets)
            forms: Array = H[[lag * basis.sets + i for lag in basis.coupled_lags for i in sets]]
            return forms
        before, n, most = self._past, H.shape[1], basis.coupled_shifts[-1]
        joined = np.concatenate([before, H[0]])
        self._past = joined[-most:]
        # Where there is no past, after a gap, H has not changed.
        padded = np.concatenate([np.full(most - len(before), np.nan), joined])
        shifted = np.stack([padded[most - k : most - k + n] for k in basis.coupled_shifts])
        return np.where(np.isnan(shifted), H[0], shifted)


_PIECE = 16
"""RegressionRows that a leaky sum takes at once."""


class LeakySums:
    """Leaky sums of rows, over each run of complete ones; incomplete rows are dropped.

    Args:
        row_time: s between rows.
        memories: s; 0 passes rows as they are.
    """

    def __init__(self, row_time: float, memories: Sequence[float]) -> None:
        decay = np.array([np.exp(-row_time / m) if m > 0.0 else 0.0 for m in memories])
        age = np.arange(_PIECE)[:, None] - np.arange(_PIECE)
        powers = decay[:, None, None] ** np.maximum(age, 0)
        # Shapes (leaks, 1, rows, rows) and (leaks, 1, rows, 1).
        self._weights = np.where(age >= 0, powers, 0.0)[:, None]
        self._carried = (decay[:, None] ** np.arange(1, _PIECE + 1))[:, None, :, None]
        self._sum: Array | None = None

    def restart(self) -> None:
        """Start from nothing; as both sides do so at once, no transient arises."""
        self._sum = None

    def update(self, rows: Array) -> Array:
        """(d, n, width) rows to (leaks, d, at most n, width), those that are complete in all."""
        if np.isfinite(rows.sum()):
            return self._add(rows)
        complete: Mask = np.asarray(np.isfinite(rows).all(axis=(0, 2)))
        out = [np.empty((len(self._weights), len(rows), 0, rows.shape[-1]))]
        for run, there in runs(complete):
            if there:
                out.append(self._add(rows[:, run]))
            else:
                self.restart()
        return np.concatenate(out, axis=2)

    def _add(self, rows: Array) -> Array:
        n = rows.shape[1]
        out = np.empty((len(self._weights), len(rows), n, rows.shape[-1]))
        for start in range(0, n, _PIECE):
            part = rows[:, start : start + _PIECE]
            m = part.shape[1]
            sums = self._weights[:, :, :m, :m] @ part
            if self._sum is not None:
                sums += self._carried[:, :, :m] * self._sum
            self._sum = sums[:, :, -1:]
            out[:, :, start : start + m] = sums
        return out
