"""Thrust at a given command that falls slowly, as the battery's voltage does.

A motor at a duty cycle turns in proportion to its supply, so that thrust at full command falls with
its square: by a tenth in a flight. The accelerometer shows it: thrust over mass is the specific
force, and the command that makes 1 g rises. With u the mean command of the rotors, F the specific
force along the thrust and v the commands' variance over the square of their mean, averaged over a
second,

    ln u = l + D + eps ln(F / g) - k v,    D = E + beta w,  E(0) = 0,  E' = b

where eps, the inverse slope of the thrust curve, and k, its bend, are as unknown as the drift D and
its rate b. Where the battery's voltage V is reported, w = ln(V_0 / V) explains most of it: beta is
1 where thrust depends on the product of voltage and command, 2 where thrust is linear in the
command and a motor's speed goes with the voltage, 0 where the autopilot or a speed controller
compensates for it. A Kalman filter follows the six. Commands times exp(-D) make thrust as at V_0
(without a voltage, as at the start), whatever the curve: where it is a straight line full thrust
has fallen by D, where it is a parabola by 2 D, and so do one command and its square.

Other effects may look like drift: gusts, drag in a climb, a rough accelerometer, a payload.
Commands are scaled only by a loss of thrust (by a gain as far as the voltage has risen), and only
as far as it stands out of what these can do; a jump is none.
"""

from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, complete_rows
from gcs_sysid.model.parameters import GRAVITY


@dataclass(frozen=True)
class DriftTuning:
    """Priors on the drift, and when it counts.

    Attributes:
        period: s of samples in an average: several time constants of motors.
        rate: 1/s, one standard deviation of b: 10 % in a minute are usual.
        measured_rate: share of it left where the voltage is reported: temperature and its errors.
        effect: mean and standard deviation of beta.
        settled: averages of flight after which V_0 is taken: an earlier one may have been reported
            at rest, without load.
        wander: 1/s per root second, by which b changes: as much as it is, in half an hour.
        slope: mean and standard deviation of eps, 1 of a straight line and 0.5 of a parabola.
        bend: the same of k, 0 and 0.5.
        far: noise of an average over its ln(F / g): drag, as of the climb after take-off, and what
            the curve is far from hover.
        noise: of an average, before the flight shows its own, and
        worth: how many averages that is worth.
        memory: averages over which the noise is estimated.
        color: by which neighboring averages that err alike widen the variance.
        least_force: share of g below which the vehicle falls or tumbles, and is not watched.
        believed: standard deviations of D from which, and up to which, it begins to count.
        jump: standard deviations that make an average a jump (a blow, a mass dropped), and
        stayed: how many of them in a row make a new level, from which the drift continues.
        sag: by how much a battery's voltage under load bends the thrust curve, and
        sags: the drift from which that counts: on five flights of the emulator whose battery drops
            by 3 % under hover power, curves were off by 0.003 to 0.067, the drift being known
            exactly.
        least_fallen: of w, from which the voltage's fall is more than its errors.
        least_voltage: V, below which there is no battery or no measurement.
        unmeasured: standard deviation of D between flights without a voltage reported: 4.2 to 3.6 V
            a cell under load are 0.15.
        most_effect: of beta.
    """

    period: float = 1.0
    rate: float = 2e-3
    measured_rate: float = 0.1
    effect: tuple[float, float] = (1.2, 0.6)
    settled: int = 3
    wander: float = 4e-5
    slope: tuple[float, float] = (0.75, 0.25)
    bend: tuple[float, float] = (0.25, 0.25)
    far: float = 0.2
    noise: float = 0.005
    worth: float = 2.0
    memory: float = 20.0
    color: float = 2.0
    least_force: float = 0.3
    believed: tuple[float, float] = (3.0, 5.0)
    jump: float = 4.0
    stayed: int = 5
    sag: float = 0.05
    sags: float = 0.02
    least_fallen: float = 5e-3
    least_voltage: float = 1.0
    unmeasured: float = 0.05
    most_effect: float = 2.0


_TUNING = DriftTuning()
_D, _RATE, _EFFECT = 3, 4, 5


@dataclass(frozen=True)
class Drift:
    """What is corrected in samples.

    Attributes:
        applied: (n,) D.
        fallen: (n,) w = ln(V_0 / V); 0 where no voltage is reported.
    """

    applied: Array
    fallen: Array

    @property
    def factors(self) -> Array:
        """(n,) on the commands."""
        return np.exp(-self.applied)

    def part(self, piece: slice) -> "Drift":
        """Of some of the samples."""
        return Drift(self.applied[piece], self.fallen[piece])


def hindsight(before: Drift, applied: float, fallen: float) -> Array:
    """(n,) factors on commands already corrected, by what is known of the drift since.

    Until the drift stands out of its uncertainty commands are not corrected. Where the voltage
    is reported, D has been in proportion to w since V_0.

    Args:
        before: of those samples.
        applied: D of the latest sample.
        fallen: w of the latest sample.
    """
    if fallen < _TUNING.least_fallen:
        return np.ones(len(before.applied))
    return np.exp(before.applied - applied / fallen * before.fallen)


class ThrustDrift:
    """Follows the drift; the factors do not depend on how samples are grouped.

    Args:
        dt: s between samples.
    """

    def __init__(self, dt: float) -> None:
        self._count = max(round(_TUNING.period / dt), 1)
        self._time = self._count * dt
        self._sums = np.zeros(5)
        """Samples, and sums over them of u, u^2, F and F^2."""
        self._volts = np.zeros(2)
        """Samples with a voltage, and their sum."""
        self.voltage: float | None = None
        """V_0, the battery voltage that thrust is referred to; None: not reported, or not yet."""
        self._measured = 0
        self._fallen = 0.0  # w
        self._started = False
        self._mean = np.array([0.0, _TUNING.slope[0], _TUNING.bend[0], 0.0, 0.0, _TUNING.effect[0]])
        stds = [10.0, _TUNING.slope[1], _TUNING.bend[1], 0.0, _TUNING.rate, _TUNING.effect[1]]
        self._covariance = np.diag(np.square(stds))
        self._noise, self._worth = _TUNING.noise**2, _TUNING.worth
        self._jumps = 0
        self._step = np.eye(6)
        self._step[_D, _RATE] = self._time
        self._target = self._now = 0.0
        self._fallen_before = 0.0  # w of the average before

    @property
    def drift(self) -> float:
        """D as far as it is significant."""
        return self._target

    @property
    def curve_doubt(self) -> float:
        """One standard deviation of the thrust curve for what a battery that sags does besides."""
        return _TUNING.sag * min(abs(self._target) / _TUNING.sags, 1.0)

    @property
    def thrust_doubt(self) -> float:
        """One standard deviation of what the battery may do to thrust unseen, relative."""
        slope = max(float(self._mean[1]), 0.25)
        if self.voltage is None:
            return _TUNING.unmeasured / slope
        drift, std = self._drift_and_std()
        # An effect that no battery has is that of climbs or gusts: the true one is as far off.
        effect = float(self._mean[_EFFECT])
        impossible = effect - min(max(effect, 0.0), _TUNING.most_effect)
        return float(np.linalg.norm([drift - self._target, std, impossible * self._fallen])) / slope

    def go_on_from(self, before: "ThrustDrift", *, landed: bool) -> None:
        """Refer thrust to what another one referred it to: another mass, or another flight.

        Args:
            before: that has followed the same rotors.
            landed: whether the battery may be another.
        """
        measured = before.voltage is not None
        self.voltage, self._measured = before.voltage, before._measured
        self._fallen = self._fallen_before = before._fallen
        self._mean, self._covariance = before._mean.copy(), before._covariance.copy()
        self._set(0, 10.0)
        self._noise, self._worth = before._noise, before._worth
        if landed and not measured:
            self._set(_D, 0.0)
            self._set(_RATE, _TUNING.rate)
        elif not landed or measured:
            self._target = self._now = before._target

    def update(self, commands: Array, force: Array, voltage: Array | None = None) -> Drift:
        """Take samples.

        Args:
            commands: (n, rotors) of 0 to 1; NaN where missing.
            force: (n,) m/s^2, specific force along the body z axis, down.
            voltage: (n,) V; NaN where not reported.

        Returns:
            D and w of each sample.
        """
        out, fallen = np.empty(len(commands)), np.empty(len(commands))
        whole = complete_rows(commands) & np.isfinite(force)
        kept, up = np.where(whole[:, None], commands, 0.0), np.where(whole, -force, 0.0)
        terms = np.column_stack([whole, kept.mean(axis=1), (kept * kept).mean(axis=1), up, up * up])
        volts = np.full(len(out), np.nan) if voltage is None else voltage
        with np.errstate(invalid="ignore"):
            measured = whole & (volts > _TUNING.least_voltage)
        volts = np.column_stack([measured, np.where(measured, volts, 0.0)])
        counted = np.cumsum(whole) + self._sums[0]
        start = 0
        while start < len(out):
            # Up to the sample that completes an average.
            stop = min(int(np.searchsorted(counted, self._count)) + 1, len(out))
            part = terms[start:stop]
            done = np.minimum(self._sums[0] + np.cumsum(part[:, 0]), self._count) / self._count
            out[start:stop] = self._now + (self._target - self._now) * done
            fallen[start:stop] = self._fallen_before + (self._fallen - self._fallen_before) * done
            self._sums += part.sum(axis=0)
            self._volts += volts[start:stop].sum(axis=0)
            if self._sums[0] >= self._count:
                self._add_average(self._sums[1:] / self._sums[0])
                self._sums[:] = self._volts[:] = 0.0
                counted = counted - self._count
            start = stop
        return Drift(out, fallen)

    def _add_average(self, means: Array) -> None:
        """Take averages of u, u^2, F and F^2; later factors go on to the drift that they show."""
        self._now, self._fallen_before = self._target, self._fallen
        self._add_voltage()
        u, square, force, power = means.tolist()
        t = _TUNING
        if u <= 0.0 or force < t.least_force * GRAVITY:
            return
        bend = -(square / u**2 - 1.0)
        row = np.array([1.0, np.log(force / GRAVITY), bend, 1.0, 0.0, self._fallen])
        if self._started:
            self._mean = self._step @ self._mean
            self._covariance = self._step @ self._covariance @ self._step.T
            wander = t.wander * (1.0 if self.voltage is None else t.measured_rate)
            self._covariance[_RATE, _RATE] += wander**2 * self._time
        self._started = True
        innovation = float(np.log(u) - row @ self._mean)
        spread = self._covariance @ row
        # Of white noise of the accelerometer the average has so much left.
        rough = max(power / force**2 - 1.0, 0.0) / self._count
        noise = t.color * (self._noise + rough + (t.far * float(row[1])) ** 2)
        variance = float(row @ spread) + noise
        # Over its own variance an innovation has unit power; a jump also indicates more noise.
        self._worth = min(self._worth + 1.0, t.memory)
        surplus = min(t.color * innovation**2 / variance, _TUNING.jump**2) - 1.0
        self._noise *= 1.0 + surplus / self._worth
        if innovation**2 > _TUNING.jump**2 * variance:
            self._jumps += 1
            if self._jumps >= _TUNING.stayed:
                self._covariance[0, 0] += 1.0
            return
        self._jumps = 0
        self._mean = self._mean + spread * (innovation / variance)
        self._covariance = self._covariance - np.outer(spread, spread) / variance
        self._believe()

    def _set(self, i: int, std: float) -> None:
        """Have an unknown be zero with a standard deviation."""
        self._mean[i] = 0.0
        self._covariance[i] = self._covariance[:, i] = 0.0
        self._covariance[i, i] = std**2

    def _add_voltage(self) -> None:
        """Take the average of the voltage, if enough of it was reported."""
        count, total = self._volts.tolist()
        if 2.0 * count < self._count:
            return
        volts = total / count
        self._measured += 1
        if self.voltage is None:
            if self._measured < _TUNING.settled:
                return
            self.voltage = volts
            # What the voltage explains need not be drift; none of it is before V_0.
            self._mean[0] += self._mean[_D]
            self._set(_D, 0.0)
            self._set(_RATE, _TUNING.measured_rate * _TUNING.rate)
        self._fallen = float(np.log(self.voltage / volts))

    def _drift_and_std(self) -> tuple[float, float]:
        """D and its standard deviation, as far as the voltage lets it be a gain."""
        row = np.zeros(6)
        row[_D], row[_EFFECT] = 1.0, self._fallen
        drift, std = float(row @ self._mean), float(row @ self._covariance @ row) ** 0.5
        effect = min(max(float(self._mean[_EFFECT]), 0.0), _TUNING.most_effect)
        return max(drift, min(effect * self._fallen, 0.0)), std

    def _believe(self) -> None:
        """Go by the drift as far as it stands out, or as what the voltage does is known."""
        low, high = _TUNING.believed
        drift, std = self._drift_and_std()
        sigmas = abs(drift) / max(std, 1e-12)
        if self.voltage is not None:
            effect, variance = self._mean[_EFFECT], self._covariance[_EFFECT, _EFFECT]
            sigmas = max(sigmas, float(effect / variance**0.5))
        self._target = min(max((sigmas - low) / (high - low), 0.0), 1.0) * drift
