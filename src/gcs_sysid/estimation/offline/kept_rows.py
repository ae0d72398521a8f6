"""Rows of one step from the samples kept, at any delay of the rotor speeds, near enough to exact.

    g_k - g_(k-1) = integral of Q(theta) x dt

Between samples the signals are quintic splines: at 20 Hz a cubic would be wrong by 7e-4 of a 2.7 Hz
signal, (omega dt)^4 / 720, the quintic by 2e-5. Rows are linear in theta; in the delay they are
linearized, with what a change of the delay adds in columns of its own, and made again where it
moves.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gcs_sysid.arrays import Array, complete_rows, runs
from gcs_sysid.estimation.noise.whitening import Whitener
from gcs_sysid.estimation.offline.likeliest_noise import memory, whitened
from gcs_sysid.estimation.rows.actuator_dynamics import (
    N_COORDINATES,
    SIGNALS,
    ActuatorDynamics,
    Coordinate,
    LagOf,
    LagPlace,
)
from gcs_sysid.estimation.rows.motor_linearization import (
    BODY_PLACES,
    OWN,
    LocalDynamics,
    MotorRows,
    step_of,
)
from gcs_sysid.estimation.rows.rotor_signals import low_pass_for
from gcs_sysid.estimation.rows.thrust_drift import ThrustDrift, hindsight
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.one_step import step_for
from gcs_sysid.signals.records import Samples

_DEGREE = 5
_END = 3
"""Samples at either end of a run where the spline is less true."""
_MAX_STEP = 0.0125
"""s, of Simpson's rule: the error is (omega h)^4 / 2880, 1e-5 of a 5 Hz signal."""
_REACH = 15
"""Samples after which a spline has forgotten an impulse."""
_AT_ONCE = 4096
"""Rows made at a time."""
LEAST = 24
"""Rows; shorter pieces between gaps carry little information and are left out."""
_H = SIGNALS - 1
_APART = 0.0045
"""s before and after, between which rotors' signals show what a change of the delay does: noise of
the speeds from sample to sample would pass for it."""


class SpeedDynamics(LocalDynamics):
    """The map from rows linearized about one delay of the rotor speeds to rows [x, y].

    Args:
        at: (N_COORDINATES,) with that delay.
        low: s, least delay.
        high: s, greatest; the same: it is given.
    """

    def __init__(self, at: Array, low: float, high: float) -> None:
        ActuatorDynamics.__init__(self, (0.0,))
        self.at = at
        self.free = (Coordinate.DELAY,) if low < high else ()
        self.low, self.high = at.copy(), at.copy()
        self.low[Coordinate.DELAY], self.high[Coordinate.DELAY] = low, high
        self.nodes = at[None]
        self.moved = np.full(N_COORDINATES, 1e-3)
        self.lag_place = LagPlace("command")
        self.sets = 2
        self.late = self.sets * OWN
        self.width = self.late + len(BODY_PLACES)

    def curvature(self, at: Array, maps: Array, weights: Array) -> Array:
        """See `ActuatorDynamics.curvature`; maps are linear."""
        return np.zeros((len(at), len(self.free), len(self.free)))

    def weights(self, at: Array) -> Array:
        """(K, 1 + f, 2) of the point, and of what a change of the delay adds."""
        out = np.zeros((len(at), 1 + len(self.free), 2))
        out[:, 0, 0], out[:, 0, 1] = 1.0, at[:, Coordinate.DELAY] - self.at[Coordinate.DELAY]
        out[:, 1:, 1] = 1.0
        return out


class SpeedRows:
    """Makes rows from samples that hold rotor speeds.

    Args:
        parts: samples, in time order.
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        delay: s, of the rotors' stamps behind the gyro's, about which it is estimated.
        reach: s, by how much it may differ from that; 0: it is given.
        covariance: (5, 5) of the known noise of the rotors' signals in a sample.
        gyro_cutoff: Hz of the autopilot's second-order low-pass of its gyro; None: there is none.
    """

    def __init__(
        self,
        parts: Sequence[Samples],
        geometry: Array,
        dt: float,
        delay: float,
        reach: float,
        covariance: Array,
        gyro_cutoff: float | None = None,
    ) -> None:
        self._delay, self._reach, self._covariance = delay, reach, covariance
        step = step_for(dt)
        h, self.time = step.step, step.time
        self._steps = max(1, math.ceil(self.time / _MAX_STEP - 1e-9))
        self._margin = _END + math.ceil((abs(delay) + reach + _APART) / self.time)
        self._runs: list[tuple[Array, Array, Array]] = []
        mixer, spin = rb.mixer(geometry), geometry[2]
        for part in gapless(parts):
            low_pass = low_pass_for(gyro_cutoff, dt)
            rotors = np.column_stack([part.speeds**2 @ mixer, part.speeds @ spin])
            if low_pass is not None:
                rotors = low_pass.update(rotors)
            settled = int(np.argmax(np.isfinite(rotors[:, 0])))
            signals = rotors, part.gyro, part.rates
            some = tuple(_means(signal[settled:], h) for signal in signals)
            if len(some[0]) >= LEAST + 2 * self._margin + 1 and np.isfinite(some[0]).all():
                self._runs.append(some)  # type: ignore[arg-type]

    def basis(self, at: Array) -> SpeedDynamics:
        """To linearize rows about the delay of (N_COORDINATES,) coordinates."""
        low, high = self._delay - self._reach, self._delay + self._reach
        point = at_delay(float(np.clip(at[Coordinate.DELAY], low, high)))
        return SpeedDynamics(point, low, high)

    def made(self, basis: LocalDynamics) -> list[Array]:
        """(n, width) rows of every run without a gap, about the delay of a basis."""
        from scipy.interpolate import make_interp_spline  # takes a while to load

        out, shift = [], float(basis.at[Coordinate.DELAY]) / self.time
        for rotors, gyro, rates in self._runs:
            n = len(rotors)
            of_rotors, of_rates = (
                make_interp_spline(np.arange(n, dtype=float), values, k=_DEGREE)
                for values in (rotors, rates)
            )
            first, last = self._margin, n - 1 - self._margin
            rows = np.empty((last - first, basis.width))
            for start in range(first, last, _AT_ONCE):
                stop = min(start + _AT_ONCE, last)
                times = np.arange(start, stop) + _nodes(self._steps)[:, None]
                self._fill(rows[start - first : stop - first], times, shift, of_rotors, of_rates)
            rows[:, -3:] = np.diff(gyro[first : last + 1], axis=0) / self.time
            out.append(rows)
        return out

    def _fill(self, out: Array, times: Array, shift: float, of_rotors, of_rates) -> None:  # type: ignore[no-untyped-def]
        """Rows over (2 steps + 1, m) times in samples, but for what the gyro measured."""
        simpson, w = _simpson(self._steps), of_rates(times)
        turned = w[..., 1::-1]

        def moved(shift: float) -> Array:
            late = of_rotors(times + shift)
            return np.column_stack(
                [
                    np.tensordot(simpson, late[..., :_H], 1),
                    (late[-1, :, _H] - late[0, :, _H]) / self.time,
                    np.tensordot(simpson, turned * late[..., _H:], 1),
                ]
            )

        apart = _APART / self.time
        out[:, :OWN] = moved(shift)
        out[:, OWN : 2 * OWN] = (moved(shift + apart) - moved(shift - apart)) / (2.0 * _APART)
        out[:, 2 * OWN : -3] = np.tensordot(simpson, rb.rate_signals(w), 1)

    def taps(self, basis: LocalDynamics) -> Array:
        """(length, 4) what a unit in one sample adds to rows: average, change, and by the delay."""
        from scipy.interpolate import make_interp_spline

        impulse = np.zeros(2 * (_REACH + self._margin) + 1)
        impulse[len(impulse) // 2] = 1.0
        spline = make_interp_spline(np.arange(len(impulse), dtype=float), impulse, k=_DEGREE)
        starts = np.arange(self._margin, len(impulse) - 1 - self._margin)
        late = float(basis.at[Coordinate.DELAY]) / self.time
        times = starts + _nodes(self._steps)[:, None] + late

        def moved(shift: float) -> Array:
            at = spline(times + shift)
            return np.stack([_simpson(self._steps) @ at, (at[-1] - at[0]) / self.time], axis=1)

        apart = _APART / self.time
        change = (moved(apart) - moved(-apart)) / (2.0 * _APART)
        return np.column_stack([moved(0.0), change])

    def noise(self, basis: LocalDynamics, whiteners: Sequence[Whitener]) -> Array:
        """(bank, width, width) what known noise of the rotors' inputs adds to one whitened row."""
        longest = max(memory(whitener) for whitener in whiteners)
        taps = np.pad(self.taps(basis), ((0, longest), (0, 0)))
        responses = np.stack([whitened(taps, whitener) for whitener in whiteners])
        overlaps = np.swapaxes(responses, 1, 2) @ responses
        # Roll, pitch, thrust and yaw are averages, H' is a change.
        kind = np.array([0, 0, 0, 0, 1, 2, 2, 2, 2, 3])
        signal = np.tile(np.arange(SIGNALS), 2)
        places = np.concatenate([np.arange(SIGNALS), OWN + np.arange(SIGNALS)])
        out = np.zeros((len(responses), basis.width, basis.width))
        out[:, places[:, None], places] = (
            overlaps[:, kind[:, None], kind] * self._covariance[signal[:, None], signal]
        )
        return out


class CommandRows:
    """Makes rows from samples that hold commands, linearized about motors.

    Args:
        parts: samples, in time order.
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        of: what lags.
        curve: thrust curve that is given; None: it is unknown.
        gyro_cutoff: Hz of the autopilot's second-order low-pass of its gyro; None: there is none.
    """

    def __init__(
        self,
        parts: Sequence[Samples],
        geometry: Array,
        dt: float,
        of: LagOf,
        curve: float | None = None,
        gyro_cutoff: float | None = None,
    ) -> None:
        self.time, self.of = step_of(dt).time, of
        self._geometry, self._dt, self._curve = geometry, dt, curve
        joined = Samples.joined(parts)
        drift = ThrustDrift(dt).update(joined.speeds, joined.force[:, 2], joined.voltage[:, 0])
        factors = hindsight(drift, drift.applied[-1], drift.fallen[-1])
        whole = replace(joined, speeds=joined.speeds * factors[:, None])
        self._hover = float(np.nanmean(whole.speeds))
        self._runs = []
        for part in gapless([whole]):
            low_pass = low_pass_for(gyro_cutoff, dt)
            inputs = part.speeds if low_pass is None else low_pass.update(part.speeds)
            self._runs.append((inputs, part.gyro, part.rates))

    def basis(self, at: Array) -> LocalDynamics:
        """To linearize rows about (N_COORDINATES,) motors."""
        at = at.copy()
        if self._curve is not None:
            at[Coordinate.CURVE] = self._curve
        return LocalDynamics(at, self.of, self._dt, curve=self._curve is None)

    def made(self, basis: LocalDynamics) -> list[Array]:
        """(n, width) rows of every run without a gap, about the motors of a basis."""
        out = []
        maker = MotorRows(self._geometry, self._dt, basis, self._hover)
        for signals in self._runs:
            rows = maker.update(*signals)
            maker.restart()
            rows = rows[complete_rows(rows)]
            if len(rows) >= LEAST:
                out.append(rows)
        return out

    def noise(self, basis: LocalDynamics, whiteners: Sequence[Whitener]) -> Array:
        """See `SpeedRows`: commands are known."""
        return np.zeros((len(whiteners), basis.width, basis.width))


def gapless(parts: Sequence[Samples]) -> list[Samples]:
    """Stretches of samples in which nothing is missing."""
    joined = Samples.joined(parts)
    there = complete_rows(np.hstack([joined.gyro, joined.rates, joined.speeds]))
    return [joined.part(run) for run, ok in runs(there) if ok]


def at_delay(delay: float) -> Array:
    """(N_COORDINATES,) of rotor speeds that are stamped so many s late."""
    at = np.zeros(N_COORDINATES)
    at[Coordinate.DELAY], at[Coordinate.CURVE] = delay, 1.0
    return at


def _means(values: Array, h: int) -> Array:
    """(n // h, ...) of h samples each."""
    n = len(values) // h * h
    return values[:n].reshape(-1, h, values.shape[1]).mean(axis=1)


def _nodes(steps: int) -> Array:
    return np.linspace(0.0, 1.0, 2 * steps + 1)


def _simpson(steps: int) -> Array:
    weights = np.tile([2.0, 4.0], steps + 1)[: 2 * steps + 1]
    weights[[0, -1]] = 1.0
    return weights / (6.0 * steps)
