"""Noise of the rotors' inputs: what both kinds have in common, that of speeds and of commands.

Noise on an input makes least squares underrate what that input does (errors in variables).
Where the noise is known, its part of the moments is known too and is taken out again.

Slowly sampled speeds miss what the rotors did in between: gyro noise feeds through to the commands,
in part to the rotors, and aliases to the frequencies of the motion; where a message was lost,
interpolation does not restore it.

Commands are exact, but where they are sent more slowly than the autopilot's loop runs, those in
between are missing. Gyro noise feeds through to the commands at frequencies above the stream's;
sampled, it aliases to the frequencies of the motion and acts as white noise on the inputs (errors
in variables). In hover it may be most of the command signal. The scatter of commands around a
quarter of their rate, above the motion's band, gives its size; the low-pass on the gyro gives how
much of what is seen there is aliased and never acted. Roll and pitch, which have derivative terms,
are several times noisier than yaw: what matters is the covariance of all rotors.
"""

from abc import ABC, abstractmethod

import numpy as np

from gcs_sysid.arrays import Array, complete_rows, runs
from gcs_sysid.estimation.fit.priors import Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.rows.actuator_dynamics import (
    SIGNALS,
    WIDTH,
    ActuatorDynamics,
    motor_filter,
)
from gcs_sysid.model import rigid_body
from gcs_sysid.signals.recursions import lfilter
from gcs_sysid.signals.redundant_commands import SLOW_COMMANDS
from gcs_sysid.signals.smoothers import Smoother, leaky

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

_ALIASED_DOUBT = 0.3
"""Relative standard deviation of the aliased noise: loops differ, interpolation to the IMU's times
takes some noise away, and messages are lost."""
_SPACING = 2
"""Samples between those of a difference: it sees most at a quarter of the sample rate."""
_FOLDS = 40
"""Multiples of the sample rate from which noise folds down, at most."""
_SETTLED = 12.0
"""Time constants after which a motor's response has ended."""
_PLACES = 16
"""Positions of one stream's samples between those of another that are distinguished."""

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
        self._differences = 0
        self._products = np.zeros((rotors, rotors))
        """Sum over so many third differences of inputs."""

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
        return np.sqrt(np.diag(self.covariance))

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

    def _add_differences(self, inputs: Array, spacing: int = 1) -> None:
        """The third differences, so many samples apart, that such inputs complete."""
        third = np.concatenate([self._last, inputs])
        self._last = third[-3 * spacing :]
        if len(third) > 3 * spacing:
            for _ in range(3):
                third = third[spacing:] - third[:-spacing]
            self._differences += len(third)
            self._products += third.T @ third


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


def with_unknown_noise(fit: RotationFit, interval: float) -> RotationFit:
    """A fit to speeds that come too slowly for their noise to be known.

    Noise n on an input u makes the slope on it too small by <n^2> / <u^2> (errors in variables),
    and the moment of inertia as much too large. Of what a fit leaves, 1 - R^2 of an axis' motion,
    the noise may be any share, none or all: (1 - R^2) / sqrt(3) rms. Three to eight flights each,
    emulated at 20 Hz, had Ixx 1.0 and Iyy 0.6 % too large, with 0.95 and 0.8 % left.

    Args:
        fit: to speeds.
        interval: s between readings.
    """
    if interval <= _SLOWEST:
        return fit
    off = np.zeros(len(fit.extended_covariance))
    left = np.clip(1.0 - fit.r_squared, 0.0, 1.0)
    off[rigid_body.MOMENTS] = fit.theta[rigid_body.MOMENTS] * left / np.sqrt(3.0)
    return fit.widened(np.diag(off**2))


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
        self._mixer = rigid_body.mixer(geometry)

    def _add(self, speeds: Array) -> None:
        self._samples += len(speeds)
        self._sums += speeds.sum(axis=0), (speeds * speeds).sum(axis=0)
        self._add_differences(speeds)

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


def missed_and_seen(dt: float, loop_cutoff: float | None, apart: float | None = None) -> Array:
    """(2,) for noise of unit density: the part that never acted, and the part that `CommandNoise`
    sees.

    Noise S(f) behind a second-order Butterworth low-pass, sampled, is sum_k S(f + k / dt). At low
    frequencies S(0) is real, the rest is aliased. The alias of order k appears in a second stream
    with its phase turned by 2 pi k a / dt: the mean of both keeps cos^2(pi k a / dt) of it.

    Args:
        dt: s between samples.
        loop_cutoff: Hz; None: there is no low-pass, and all of white noise is missed.
        apart: a, s between the samples of two streams; None: there is one.
    """
    if loop_cutoff is None:
        return np.ones(2)
    f = np.linspace(0.0, 0.5, 101) / dt
    folds = np.arange(-_FOLDS, _FOLDS + 1)
    power = 1.0 / (1.0 + ((f[:, None] + folds / dt) / loop_cutoff) ** 4)
    if apart is not None:
        power *= np.cos(np.pi * folds * apart / dt) ** 2
    sampled = power.sum(axis=1)
    seen = np.sin(np.pi * _SPACING * f * dt) ** 6
    return np.array([sampled[0] - 1.0, seen @ sampled / seen.sum()])


class CommandNoise(InputNoise):
    """Follows level and noise of the commands.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        loop_cutoff: Hz, of the second-order low-pass that the gyro passes on its way into the
            commands; None: there is none.
    """

    def __init__(self, geometry: Array, dt: float, loop_cutoff: float | None = None) -> None:
        rotors = geometry.shape[1]
        super().__init__(rotors)
        self._dt = dt
        self._slow = dt >= SLOW_COMMANDS
        apart = (*(dt / _PLACES * np.arange(_PLACES)), None)
        self._folding = np.array([missed_and_seen(dt, loop_cutoff, a) for a in apart])
        self._places = np.zeros(_PLACES + 1)
        """How many samples had their second stream at each place, and how many had none."""
        self._mixer = rigid_body.mixer(geometry)
        self._count = 0
        self._sum = np.zeros(rotors)
        self._squares = np.zeros(rotors)
        self._overlaps: dict[float, Array] = {}

    def update(self, inputs: Array, apart: Array | None = None) -> None:
        """Take commands, see `InputNoise.update`."""
        if self._slow:
            place = np.full(len(inputs), _PLACES)
            if apart is not None:
                two = np.isfinite(apart)
                place[two] = np.rint(apart[two] / self._dt * _PLACES).astype(int) % _PLACES
            self._places += np.bincount(place[complete_rows(inputs)], minlength=_PLACES + 1)
        super().update(inputs)

    def _add(self, commands: Array) -> None:
        self._count += len(commands)
        self._sum += commands.sum(axis=0)
        self._squares += (commands * commands).sum(axis=0)
        if self._slow:
            self._add_differences(commands, _SPACING)

    @property
    def doubt(self) -> float:
        """Relative standard deviation of the covariance."""
        return _ALIASED_DOUBT

    @property
    def covariance(self) -> Array:
        """(rotors, rotors) of white noise on the commands equivalent to the aliased part."""
        if self._differences < ENOUGH:
            return np.zeros_like(self._products)
        missed, seen = self._places @ self._folding
        scale = missed / seen / (self._differences * THIRD_DIFFERENCE)
        return scale * self._products

    @property
    def level(self) -> tuple[float, float]:
        """Mean and standard deviation of commands, the latter about each rotor's own mean."""
        mean = self._sum / max(self._count, 1)
        variance = np.maximum(self._squares / max(self._count, 1) - mean * mean, 0.0)
        return float(mean.mean()), float(variance.mean() ** 0.5)

    @property
    def torques(self) -> Array:
        """See `InputNoise.torques`; near half throttle thrust follows commands one to one."""
        return self._mixer.T @ self.covariance @ self._mixer

    def row_moments(self, basis: ActuatorDynamics, smoother: Smoother, memory: float) -> Array:
        """(width, width) of rows of elements, see `InputNoise.row_moments`."""
        out = np.zeros((basis.width, basis.width))
        signals = np.zeros((SIGNALS, SIGNALS))
        signals[:4, :4] = self.torques
        if not signals.any():
            return out
        if memory not in self._overlaps:
            self._overlaps[memory] = _overlaps(basis, smoother, self._dt, memory)
        # Of w^2 the noise is 2 w times that of w.
        gains = np.array([1.0, 2.0 * self._sum.mean() / self._count])
        out[: basis.late, : basis.late] = np.kron(
            self._overlaps[memory], np.kron(np.outer(gains, gains), signals)
        )
        return out


def _overlaps(basis: ActuatorDynamics, smoother: Smoother, dt: float, memory: float) -> Array:
    """(elements, elements) covariances of white noise after the basis' filters."""
    taps = smoother.late_taps
    room = int(np.ceil(_SETTLED * basis.lags[-1] / dt))
    responses = np.zeros((len(basis.elements), taps.shape[1] + room))
    for response, element in zip(responses, basis.elements, strict=True):
        a, b0, b1 = motor_filter(dt, basis.lags[element.lag])
        driven = np.zeros(responses.shape[1])
        driven[: taps.shape[1]] = taps[element.delay]
        response[:] = lfilter([b0, b1], [1.0, -a], driven)[0]
    summed = leaky(responses, smoother.step, dt, memory)
    return summed @ summed.T
