"""From aligned signals to regression rows: products, window, leak; and to sums of their products.

All signals of both sides pass the same linear filter, so its lag cancels: a smoother
(`gcs_sysid.signals.smoothers`), and for the rotation then perhaps a leaky sum. The leak
integrates both sides again: gyro noise, which differentiation made grow with frequency, becomes
nearly white, which is what least squares weighs best. Where noise of the rotor speeds
dominates, no leak is better; the estimator carries both, as whiteners of these rows.

**The memory** (`NormalEquations`). Every estimate here is the minimizer of a cost that is quadratic
in the data, so the sum of z z' over all rows z = [inputs, outputs] is a sufficient statistic: the
information form of recursive least squares. Keeping that sum for each second or so of flight,
instead of only the total, costs little and shows how much the score varies from batch to batch,
which a valid covariance needs when residuals are colored; and it lets a fit be checked on batches
it has not seen.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array, Mask, runs
from gcs_sysid.estimation.rows.actuator_dynamics import BODY, SIGNALS, ActuatorDynamics
from gcs_sysid.estimation.rows.rotor_signals import RotorPath
from gcs_sysid.estimation.rows.thrust_drift import Drift, ThrustDrift
from gcs_sysid.model import attitude, rigid_body
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.one_step import OneStep
from gcs_sysid.signals.records import Samples
from gcs_sysid.signals.smoothers import Smoothed, Smoother

_AT_ONCE = 2**18
"""Bytes allocated from the system in a step; page by page that takes up to 10 ms a MB."""


@dataclass(frozen=True)
class RegressionRows:
    """Regression rows, NaN where a window held a sample that must not be used.

    Attributes:
        rotation: (1, n, width) of elements, see `estimation.rows.actuator_dynamics`.
        momentum: (3, n, thrusts + 3), one for each world axis: the thrust of each lag and set
            along it, velocity, 1, and what they make up.
        accelerometer: (n, thrusts + 5): the thrust likewise, what a place off in x, y and z
            adds, 1, and what they make up.
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
        rotation = self._of_elements(rows, self._basis)[None]
        body = rotation[0, :, -BODY:].T
        at = {name: body[i] for i, name in enumerate(rigid_body.RATE_SIGNALS)}
        accelerometer = np.ones((n, thrusts + 5))
        accelerometer[:, :thrusts] = rows.average[:, self._thrust]
        accelerometer[:, -5] = at["rp"] - body[-2]
        accelerometer[:, -4] = at["qr"] + body[-3]
        accelerometer[:, -3] = -at["pp"] - at["qq"]
        accelerometer[:, -1] = rows.average[:, -1]
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
            return H[[lag * basis.sets + i for lag in basis.coupled_lags for i in sets]]
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


class NormalEquations:
    """Second moments of rows, in batches of equally many rows; bounded memory.

    When `max_batches` are full, neighbors are merged and batches become twice as long.

    Args:
        shape: leading shape of one moment matrix, then its width twice: (..., m, m).
        rows_per_batch: rows summed in one batch.
        max_batches: an even number.
    """

    def __init__(self, shape: Sequence[int], rows_per_batch: int, max_batches: int = 512) -> None:
        self._rows_per_batch = rows_per_batch
        self._batches = np.zeros((max_batches, *shape))
        self._counts = np.zeros(max_batches, dtype=np.int64)
        self._full = 0
        self.total = np.zeros(shape)
        """(..., m, m) sum over all rows; not to be written to."""
        self.rows = 0
        """Rows added so far."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # Most of the allocation is still zero and takes no memory until it is written.
        other, begun = copy(self), self._begun
        other._batches = np.zeros(self._batches.shape)
        other._batches[:begun] = self._batches[:begun]
        other._counts, other.total = self._counts.copy(), self.total.copy()
        return other

    def reserve(self) -> None:
        """Have all memory now, before a long flight, and not find it wanting in it."""
        each = max(_AT_ONCE // self.total.nbytes, 1)
        for start in range(self._begun, len(self._batches), each):
            self._batches[start : start + each] = 0.0  # untouched zeros take none

    @property
    def batches(self) -> Array:
        """(k, ..., m, m) sums of the batches begun so far, oldest first (a view)."""
        return self._batches[: self._begun]

    @property
    def counts(self) -> NDArray[np.int64]:
        """(k,) rows in each batch (a view)."""
        return self._counts[: self._begun]

    def add(self, rows: Array) -> None:
        """Add rows of shape (..., n, m), in time order.

        The sums do not depend on how rows are grouped in calls, but for rounding.
        """
        n, start = rows.shape[-2], 0
        self.rows += n
        while start < n:
            if self._full == len(self._batches):
                self._merge()
            room = self._rows_per_batch - int(self._counts[self._full])
            part = rows[..., start : start + room, :]
            products = np.swapaxes(part, -1, -2) @ part
            self.total += products
            self._batches[self._full] += products
            self._counts[self._full] += part.shape[-2]
            start += part.shape[-2]
            if self._counts[self._full] == self._rows_per_batch:
                self._full += 1

    def add_sum(self, products: Array, rows: int) -> None:
        """Add (..., m, m) products of so many rows, which stay together."""
        if self._full == len(self._batches):
            self._merge()
        self.rows += rows
        self.total += products
        self._batches[self._full] += products
        self._counts[self._full] += rows
        if self._counts[self._full] >= self._rows_per_batch:
            self._full += 1

    def drop_last(self, rows: int) -> None:
        """Forget the newest batches that hold at least so many rows."""
        dropped = 0
        while dropped < rows and self._begun:
            last = self._begun - 1
            dropped += int(self._counts[last])
            self._batches[last] = 0.0
            self._counts[last] = 0
            self._full = last
        self.total = self.batches.sum(axis=0)
        self.rows -= dropped

    def narrowed(self, leading: Sequence[int], columns: Sequence[int]) -> Self:
        """The same, of (n, m, m), with some of the leading index and of the columns alone."""
        other = copy(self)
        other.total = self.total[np.ix_(leading, columns, columns)]
        other._batches = np.zeros((len(self._batches), *other.total.shape))
        for old, new in zip(self.batches, other._batches, strict=False):
            new[...] = old[np.ix_(leading, columns, columns)]
        other._counts = self._counts.copy()
        return other

    @property
    def _begun(self) -> int:
        return self._full + int(self._full < len(self._counts) and self._counts[self._full] > 0)

    def _merge(self) -> None:
        half = len(self._batches) // 2
        for i in range(half):  # one by one: together they would take half as much memory again
            np.add(self._batches[2 * i], self._batches[2 * i + 1], out=self._batches[i])
        self._counts[:half] = self._counts[0::2] + self._counts[1::2]
        self._batches[half:] = 0.0
        self._counts[half:] = 0
        self._rows_per_batch *= 2
        self._full = half
