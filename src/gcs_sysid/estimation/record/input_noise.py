"""Noise of the rotors' inputs: what both kinds have in common, and that of speeds.

Noise on an input makes least squares underrate what that input does (errors in variables).
Where the noise is known, its part of the moments is known too and is taken out again.

Slowly sampled speeds miss what the rotors did in between: gyro noise feeds through to the commands,
in part to the rotors, and aliases to the frequencies of the motion (see
`estimation.record.command_noise`); where a message was lost, interpolation does not restore it.
"""

from abc import ABC, abstractmethod

import numpy as np

from gcs_sysid.arrays import Array, complete_rows, runs
from gcs_sysid.estimation.fit.priors import Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.rows.actuator_dynamics import WIDTH, ActuatorDynamics
from gcs_sysid.model import rigid_body
from gcs_sysid.signals.smoothers import Smoother

THIRD_DIFFERENCE = 20.0
"""1 + 9 + 9 + 1: variance of a third difference over that of white noise."""
ROUNDING_STD = 2.0 * np.pi / 60.0 / np.sqrt(12.0)
"""rad/s, of a speed sent as a whole number of revolutions a minute."""
_FAST_ENOUGH, _SLOWEST = 0.012, 0.025
"""s. Below the one sample time a rotor hardly moves within four samples, so that their residual
from a parabola is noise; above the other, motion and noise cannot be separated. Between them the
vehicle hardly moves, but the rotors do."""
_MISSED, _DOUBT = 0.25, 0.5
"""Share missed of the residuals of four samples between those times, and its standard deviation:
with motors of 40 ms, 0.08 where no message is lost and samples are taken as they come, 0.2 with 5 %
lost, three times as much where interpolation to the IMU's times smooths them."""
ENOUGH = 100
"""Differences from which their scatter is known."""

_LATE = 1.0 / 100.0
"""Of the time between readings, by which all jumps of torque together may seem late, one standard
deviation: at 50 Hz the delay of six emulated flights was off by 0.01 to 0.28 ms, 0.20 ms rms, with
intervals of 0.07 ms, and damping by up to 8 %."""
_SLOW, _GROWTH = 0.02, 1.5
"""s, from which that grows faster than the time between: at 25 Hz it was 1.3 and 1.4 ms."""
_SMOOTH = 0.045
"""s, above which it is not measured: the article's flights at 20 Hz have no jumps, and intervals
that hold."""

_RATES = [rigid_body.SIGNALS.index(name) for name in "pq"]
_DH = rigid_body.SIGNALS.index("dH")


class InputNoise(ABC):
    """Follows the noise of the rotors' inputs.

    Args:
        rotors: how many.
    """

    def __init__(self, rotors: int) -> None:
        self._last = np.zeros((0, rotors))
        """The latest inputs, which the next ones join on to."""

    @property
    @abstractmethod
    def doubt(self) -> float:
        """Relative standard deviation of the variance."""

    @property
    @abstractmethod
    def covariance(self) -> Array:
        """(rotors, rotors) of one input."""

    @property
    @abstractmethod
    def torques(self) -> Array:
        """(4, 4) covariance of roll, pitch, thrust and yaw in one sample."""

    @abstractmethod
    def row_moments(self, basis: ActuatorDynamics, smoother: Smoother, memory: float) -> Array:
        """What it adds to the moments of one row, in the form of `ActuatorDynamics.noise_at`.

        Args:
            basis: of the rows' elements; always the same.
            smoother: that made the rows; always the same.
            memory: s, of the leaky sum over them.
        """

    @property
    def std(self) -> Array:
        """(rotors,) of one input, rad/s or 1."""
        std: Array = np.sqrt(np.diag(self.covariance))
        return std

    def update(self, inputs: Array, apart: Array | None = None) -> None:
        """Take (n, rotors) inputs; NaN where missing.

        Args:
            inputs: speeds in rad/s, or commands.
            apart: of commands, (n,) s between the samples of the two streams whose mean they are;
                NaN, or None altogether: there is one.
        """
        complete = complete_rows(inputs)
        if complete.all():
            self._add(inputs)
            return
        for run, there in runs(complete):
            if there:
                self._add(inputs[run])
            else:
                self.restart()

    def restart(self) -> None:
        """What comes next does not join on to what came before."""
        self._last = self._last[:0]

    @abstractmethod
    def _add(self, inputs: Array) -> None:
        """Take inputs that are whole and follow on the last ones."""


def with_sparse_readings(fit: RotationFit, interval: float, window: Array) -> RotationFit:
    """A fit with the error of what speeds do between two readings.

    Torque jumps where commands do, and from readings before and after, a jump seems as early or
    late as it lay between them. Delay follows the jumps, slow motion does not. Torque that is late
    by t is off by -t I w'', which damping takes up: <w'' w> = -<w'^2>, so that it is off by
    t I <w'^2> / <w^2>.

    Args:
        fit: to speeds.
        interval: s between readings.
        window: (WIDTH, WIDTH) moments of rows [x, y] of the symmetric window.
    """
    powers = np.diag(window)
    turning = float(powers[_RATES].sum())
    if (
        not is_sparse(interval)
        or fit.full_covariance[Unknown.DELAY, Unknown.DELAY] <= 0.0
        or turning <= 0.0
    ):
        return fit
    late = _LATE * interval * max((interval / _SLOW) ** _GROWTH, 1.0)
    quickness = float(powers[-3:-1].sum()) / turning
    off = np.zeros(len(fit.extended_covariance))
    off[Unknown.DELAY], off[rigid_body.DAMPING] = (
        late,
        -late * float(fit.theta[:2].mean()) * quickness,
    )
    return fit.widened(np.outer(off, off))


def is_sparse(interval: float) -> bool:
    """Whether speeds read every `interval` s miss what happens in between."""
    return _FAST_ENOUGH < interval <= _SMOOTH


class SpeedNoise(InputNoise):
    """Follows level and noise of the rotor speeds.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
    """

    def __init__(self, geometry: Array, dt: float) -> None:
        self._dt = dt
        rotors = geometry.shape[1]
        super().__init__(rotors)
        self._samples = 0
        self._sums = np.zeros((2, rotors))  # of Omega and Omega^2
        self._differences = 0
        self._products = np.zeros((rotors, rotors))
        self._mixer = rigid_body.mixer(geometry)

    def _add(self, speeds: Array) -> None:
        self._samples += len(speeds)
        self._sums += speeds.sum(axis=0), (speeds * speeds).sum(axis=0)
        joined = np.concatenate([self._last, speeds])
        self._last = joined[-3:]
        if len(joined) > 3:
            third = joined[3:] - joined[:-3] - 3.0 * (joined[2:-1] - joined[1:-2])
            self._differences += len(third)
            self._products += third.T @ third

    @property
    def doubt(self) -> float:
        """Relative standard deviation of the covariance."""
        return _DOUBT if _FAST_ENOUGH < self._dt <= _SLOWEST else 0.0

    @property
    def covariance(self) -> Array:
        """(rotors, rotors) rad^2/s^2 of white noise on the speeds."""
        covariance = np.zeros_like(self._products)
        if self._dt <= _SLOWEST and self._differences >= ENOUGH:
            covariance = self._products / (self._differences * THIRD_DIFFERENCE)
            # Sensors err one by one; what the loop does it does to all rotors at once.
            one_by_one = self._dt <= _FAST_ENOUGH
            covariance = np.diag(np.diag(covariance)) if one_by_one else _MISSED * covariance
        least = np.maximum(ROUNDING_STD**2 - np.diag(covariance), 0.0)
        return covariance + np.diag(least)

    def row_moments(self, basis: ActuatorDynamics, smoother: Smoother, memory: float) -> Array:
        """(WIDTH, WIDTH) of rows [x, y], the same at all delays: `InputNoise.row_moments`."""
        out = np.zeros((WIDTH, WIDTH))
        average, derivative = smoother.noise_gains(memory)
        torques, _, H = self.of_signals
        # Averages and derivatives of a symmetric window do not hang together.
        out[:4, :4], out[_DH, _DH] = average * torques, derivative * H
        return out

    @property
    def torques(self) -> Array:
        """See `InputNoise.torques`."""
        return self.of_signals[0]

    @property
    def of_signals(self) -> tuple[Array, Array, float]:
        """Covariance of the rotors' signals in one sample.

        (4, 4) of roll, pitch, thrust and yaw, (4,) of these with H, and the variance of H.
        """
        if self._samples == 0:
            return np.zeros((4, 4)), np.zeros(4), 0.0
        # Of Omega^2 the noise is 2 Omega times that of Omega.
        slope = 2.0 * np.sqrt(self._sums[1] / self._samples)
        mixer, spin, covariance = self._mixer * slope[:, None], self._mixer[:, 3], self.covariance
        return (
            mixer.T @ covariance @ mixer,
            mixer.T @ covariance @ spin,
            float(spin @ covariance @ spin),
        )
