"""Noise on commands sampled too slowly, and what it adds to the moments.

Commands are exact, but where they are sent more slowly than the autopilot's loop runs, those in
between are missing. Gyro noise feeds through to the commands at frequencies above the stream's;
sampled, it aliases to the frequencies of the motion and acts as white noise on the inputs (errors
in variables). In hover it may be most of the command signal.

The scatter of commands around a quarter of their rate, above the motion's band, gives its size; the
low-pass on the gyro gives how much of what is seen there is aliased and never acted. Roll and
pitch, which have derivative terms, are several times noisier than yaw: what matters is the
covariance of all rotors.
"""

import numpy as np

from gcs_sysid.arrays import Array, complete_rows
from gcs_sysid.estimation.record.input_noise import ENOUGH, THIRD_DIFFERENCE, InputNoise
from gcs_sysid.estimation.rows.actuator_dynamics import (
    SIGNALS,
    ActuatorDynamics,
    motor_filter,
)
from gcs_sysid.model import rigid_body
from gcs_sysid.signals.recursions import lfilter
from gcs_sysid.signals.redundant_commands import SLOW_COMMANDS
from gcs_sysid.signals.smoothers import Smoother, leaky

_DOUBT = 0.3
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
        self._differences = 0
        self._products = np.zeros((rotors, rotors))
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
        if not self._slow:
            return
        joined = np.concatenate([self._last, commands])
        reach = 3 * _SPACING
        self._last = joined[-reach:]
        if len(joined) > reach:
            third = joined
            for _ in range(3):
                third = third[_SPACING:] - third[:-_SPACING]
            self._differences += len(third)
            self._products += third.T @ third

    @property
    def doubt(self) -> float:
        """Relative standard deviation of the covariance."""
        return _DOUBT

    @property
    def covariance(self) -> Array:
        """(rotors, rotors) of white noise on the commands equivalent to the aliased part."""
        if self._differences < ENOUGH:
            return np.zeros_like(self._products)
        missed, seen = self._places @ self._folding
        scale = missed / seen / (self._differences * THIRD_DIFFERENCE)
        covariance: Array = scale * self._products
        return covariance

    @property
    def level(self) -> tuple[float, float]:
        """Mean and standard deviation of commands, the latter about each rotor's own mean."""
        mean = self._sum / max(self._count, 1)
        variance = np.maximum(self._squares / max(self._count, 1) - mean * mean, 0.0)
        return float(mean.mean()), float(variance.mean() ** 0.5)

    @property
    def torques(self) -> Array:
        """See `InputNoise.torques`; near half throttle thrust follows commands one to one."""
        torques: Array = self._mixer.T @ self.covariance @ self._mixer
        return torques

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
    overlaps: Array = summed @ summed.T
    return overlaps
