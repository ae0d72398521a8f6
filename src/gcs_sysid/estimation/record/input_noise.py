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
from math import comb

import numpy as np

from gcs_sysid.arrays import Array, complete_rows, runs
from gcs_sysid.estimation.fit.priors import Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.rows.actuator_dynamics import SIGNALS, ActuatorDynamics, motor_filter
from gcs_sysid.model import rigid_body
from gcs_sysid.signals.recursions import lfilter
from gcs_sysid.signals.redundant_commands import SLOW_COMMANDS
from gcs_sysid.signals.smoothers import Smoother, leaky

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

_LATE, _MISSCALED = 0.3, 0.4
"""r^2 being the share of torque's power next to half the readings' rate: by 0.3 r intervals torque
seems late, by 0.4 r^2 of itself too large, rms over all phases. Steps of torque and of body rates
behind motors of 20 to 80 ms, read every 20 to 50 ms, have 0.15 to 0.6 and 0.1 to 0.75 (the most
where r is least); aerobatics emulated at 20 Hz have 0.4."""
_JUMPING = 0.02
"""Least share, next to half that rate, of the power of torque's change from one reading to the next
where torque jumps: 0.06 and more, in smooth flights 0.007 at most, emulated at 20 to 50 Hz. Offline
estimates, which have no window, were then up to 7 standard deviations off."""

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
_ACCELERATIONS = [rigid_body.N_SIGNALS, rigid_body.N_SIGNALS + 1]
_OF_YAW = [2, rigid_body.MOMENT_RATIO, rigid_body.ROTOR_INERTIA]
_LENGTHS = np.isin(np.arange(rigid_body.N_THETA), (rigid_body.CG_X, rigid_body.CG_Y))


class _Differences:
    """Scatter of the differences of some signals.

    Args:
        rotors: how many signals.
        order: of the differences.
        spacing: samples between those of a difference.

    Attributes:
        count: differences taken.
    """

    def __init__(self, rotors: int, order: int, spacing: int = 1) -> None:
        self.count = 0
        self._order, self._spacing = order, spacing
        self._last = np.zeros((0, rotors))
        self._products = np.zeros((rotors, rotors))

    def restart(self) -> None:
        """What comes next does not join on to what came before."""
        self._last = self._last[:0]

    def add(self, signals: Array) -> None:
        """Take (n, rotors) that follow on the last ones."""
        differences = np.concatenate([self._last, signals])
        reach = self._order * self._spacing
        self._last = differences[-reach:]
        if len(differences) <= reach:
            return
        for _ in range(self._order):
            differences = differences[self._spacing :] - differences[: -self._spacing]
        self.count += len(differences)
        self._products += differences.T @ differences

    @property
    def covariance(self) -> Array:
        """(rotors, rotors) of the white noise that would have these differences."""
        gain = comb(2 * self._order, self._order)  # sum of the squared binomial coefficients
        return self._products / (gain * max(self.count, 1))


class InputNoise(ABC):
    """Follows level and noise of the rotors' inputs.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        spacing: samples between those of a difference.
    """

    def __init__(self, geometry: Array, dt: float, spacing: int = 1) -> None:
        rotors = geometry.shape[1]
        self._dt, self._mixer = dt, rigid_body.mixer(geometry)
        self._count, self._sum = 0, np.zeros(rotors)
        self._products = np.zeros((rotors, rotors))
        self._differences = _Differences(rotors, 3, spacing)
        self._overlaps: dict[tuple[bool, float], Array] = {}

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
    def _of_elements(self) -> tuple[Array, ...]:
        """(signals, signals) covariances of what a sample has in an element: its averages, and
        derivatives where these have some. Those of a symmetric window do not hang together.
        """

    def row_moments(self, basis: ActuatorDynamics, smoother: Smoother, memory: float) -> Array:
        """(width, width) what it adds to the moments of one row of elements.

        Args:
            basis: of the rows' elements; always the same.
            smoother: that made the rows; always the same.
            memory: s, of the leaky sum over them.
        """
        out = np.zeros((basis.width, basis.width))
        for slopes, covariance in zip((False, True), self._of_elements(), strict=False):
            if not covariance.any():
                continue
            key = slopes, memory
            if key not in self._overlaps:
                taps = smoother.late_slopes if slopes else smoother.late_taps
                self._overlaps[key] = _overlaps(basis, taps, smoother.step, self._dt, memory)
            out[: basis.late, : basis.late] += np.kron(self._overlaps[key], covariance)
        return out

    @property
    def _mean(self) -> Array:
        return self._sum / max(self._count, 1)

    @property
    def _mean_products(self) -> Array:
        return self._products / max(self._count, 1)

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
        self._differences.restart()

    def _add(self, inputs: Array) -> None:
        """Take inputs that are whole and follow on the last ones."""
        self._count += len(inputs)
        self._sum += inputs.sum(axis=0)
        self._products += inputs.T @ inputs


def with_sparse_readings(fit: RotationFit, noise: "SpeedNoise", window: Array) -> RotationFit:
    """A fit with the error of what speeds do between two readings.

    What is faster than half the readings' rate folds onto the motion. Where torque jumps at one
    place between readings each time, as at set points sent at a fraction of their rate, it does so
    with one phase, and no scatter shows it: in quadrature torque seems early or late, in phase too
    large or too small. Torque that is late by t is off by -t I w'', which damping takes up:
    <w'' w> = -<w'^2>, so that it is off by t I <w'^2> / <w^2>.

    Noise n on an input u makes the slope on it too small by <n^2> / <u^2> (errors in variables),
    and the moment of inertia as much too large. Where readings come too slowly for the noise to be
    known, it may be any share of what a fit leaves, 1 - R^2 of an axis' motion: (1 - R^2) / sqrt(3)
    rms.

    Args:
        fit: to speeds.
        noise: of the speeds.
        window: (WIDTH, WIDTH) moments of rows [x, y] of the symmetric window.
    """
    if not is_sparse(noise.interval):
        return fit
    share = noise.folded_share
    moments = fit.theta[rigid_body.MOMENTS]
    late, scale, noisy = np.zeros((3, len(fit.extended_covariance)))
    if fit.full_covariance[Unknown.DELAY, Unknown.DELAY] > 0.0:
        by = _LATE * share**0.5 * noise.interval
        late[Unknown.DELAY] = by
        late[rigid_body.DAMPING] = -by * float(moments[:2].mean()) * _quickness(window)
        with_damping = fit.covariance[rigid_body.DAMPING]
        known = max(float(with_damping[rigid_body.DAMPING]), 1e-300)
        late[_OF_YAW] = with_damping[_OF_YAW] / known * late[rigid_body.DAMPING]
    scale[: rigid_body.N_THETA] = np.where(_LENGTHS, 0.0, _MISSCALED * share * fit.theta)
    if noise.interval > _SLOWEST:
        left = np.clip(1.0 - fit.r_squared, 0.0, 1.0)
        noisy[rigid_body.MOMENTS] = moments * left / np.sqrt(3.0)
    return fit.widened(np.outer(late, late) + np.outer(scale, scale) + np.diag(noisy**2))


def is_sparse(interval: float) -> bool:
    """Whether speeds read every `interval` s miss what happens in between."""
    return interval > _FAST_ENOUGH


def _quickness(window: Array) -> float:
    """<w'^2> / <w^2> of roll and pitch, rad^2/s^2."""
    powers = np.diag(window)
    return float(powers[_ACCELERATIONS].sum() / max(powers[_RATES].sum(), 1e-12))


class SpeedNoise(InputNoise):
    """Of the rotor speeds.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        interval: s between readings of the speeds.
    """

    def __init__(self, geometry: Array, dt: float, interval: float = 0.0) -> None:
        super().__init__(geometry, dt)
        self.interval = max(interval, dt)
        spacing = round(self.interval / dt)
        self._readings = [_Differences(geometry.shape[1], k, spacing) for k in (1, 4)]

    def _add(self, inputs: Array) -> None:
        super()._add(inputs)
        self._differences.add(inputs)
        if is_sparse(self.interval):
            for differences in self._readings:
                differences.add(inputs)

    def restart(self) -> None:
        """See `InputNoise.restart`."""
        super().restart()
        for differences in self._readings:
            differences.restart()

    @property
    def folded_share(self) -> float:
        """r^2 of `with_sparse_readings`, of roll or pitch; 0 where torque does not jump."""
        if self._relative_to(self._readings[0].covariance) < _JUMPING:
            return 0.0
        return self._relative_to(self._mean_products - np.outer(self._mean, self._mean))

    def _relative_to(self, covariance: Array) -> float:
        mixer = self._linear_mixer[:, :2]
        parts = (np.diag(mixer.T @ c @ mixer) for c in (self._readings[1].covariance, covariance))
        return max(float(a / b) if b > 0.0 else 0.0 for a, b in zip(*parts, strict=True))

    @property
    def _linear_mixer(self) -> Array:
        """(rotors, 4): of Omega^2 the noise is 2 Omega times that of Omega."""
        return self._mixer * (2.0 * np.sqrt(np.diag(self._mean_products)))[:, None]

    @property
    def doubt(self) -> float:
        """Relative standard deviation of the covariance."""
        return _DOUBT if _FAST_ENOUGH < self._dt <= _SLOWEST else 0.0

    @property
    def covariance(self) -> Array:
        """(rotors, rotors) rad^2/s^2 of white noise on the speeds."""
        covariance = np.zeros_like(self._differences.covariance)
        if self._dt <= _SLOWEST and self._differences.count >= ENOUGH:
            covariance = self._differences.covariance
            one_by_one = self._dt <= _FAST_ENOUGH
            covariance = self._one_by_one(covariance) if one_by_one else _MISSED * covariance
        least = np.maximum(ROUNDING_STD**2 - np.diag(covariance), 0.0)
        return covariance + np.diag(least)

    def _one_by_one(self, covariance: Array) -> Array:
        """(rotors, rotors) the diagonal part of a covariance to which yaw adds what it will.

        Sensors err one by one; what the loop does it does to all rotors at once, most of it about
        yaw, whose torque is that of drag: steps of its rate were a tenth of the third differences
        of doublets at 250 Hz. Without yaw P D P is left of D, whose diagonal is (P o P) d. Blocks
        of differences that stand out are no measure: noise of real ESCs is uneven, and a third of
        it would be left out with them.
        """
        yaw = self._mixer[:, 3] / np.linalg.norm(self._mixer[:, 3])
        P = np.eye(len(yaw)) - np.outer(yaw, yaw)
        return np.diag(np.linalg.solve(P * P, np.diag(P @ covariance @ P)))

    def _of_elements(self) -> tuple[Array, ...]:
        averaged, differentiated = self.of_signals, np.zeros((SIGNALS, SIGNALS))
        differentiated[4, 4] = averaged[4, 4]
        averaged[4], averaged[:, 4] = 0.0, 0.0
        return averaged, differentiated

    @property
    def torques(self) -> Array:
        """See `InputNoise.torques`."""
        return self.of_signals[:4, :4]

    @property
    def of_signals(self) -> Array:
        """(5, 5) covariance of roll, pitch, thrust, yaw and H in one sample."""
        if self._count == 0:
            return np.zeros((SIGNALS, SIGNALS))
        signals = np.column_stack([self._linear_mixer, self._mixer[:, 3]])
        return signals.T @ self.covariance @ signals


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
    """Of the commands.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        loop_cutoff: Hz, of the second-order low-pass that the gyro passes on its way into the
            commands; None: there is none.
    """

    def __init__(self, geometry: Array, dt: float, loop_cutoff: float | None = None) -> None:
        super().__init__(geometry, dt, _SPACING)
        self._slow = dt >= SLOW_COMMANDS
        apart = (*(dt / _PLACES * np.arange(_PLACES)), None)
        self._folding = np.array([missed_and_seen(dt, loop_cutoff, a) for a in apart])
        self._places = np.zeros(_PLACES + 1)
        """How many samples had their second stream at each place, and how many had none."""

    def update(self, inputs: Array, apart: Array | None = None) -> None:
        """Take commands, see `InputNoise.update`."""
        if self._slow:
            place = np.full(len(inputs), _PLACES)
            if apart is not None:
                two = np.isfinite(apart)
                place[two] = np.rint(apart[two] / self._dt * _PLACES).astype(int) % _PLACES
            self._places += np.bincount(place[complete_rows(inputs)], minlength=_PLACES + 1)
        super().update(inputs)

    def _add(self, inputs: Array) -> None:
        super()._add(inputs)
        if self._slow:
            self._differences.add(inputs)

    @property
    def doubt(self) -> float:
        """Relative standard deviation of the covariance."""
        return _ALIASED_DOUBT

    @property
    def covariance(self) -> Array:
        """(rotors, rotors) of white noise on the commands equivalent to the aliased part."""
        if self._differences.count < ENOUGH:
            return np.zeros_like(self._differences.covariance)
        missed, seen = self._places @ self._folding
        return missed / seen * self._differences.covariance

    @property
    def level(self) -> tuple[float, float]:
        """Mean and standard deviation of commands, the latter about each rotor's own mean."""
        mean = self._mean
        variance = np.maximum(np.diag(self._mean_products) - mean * mean, 0.0)
        return float(mean.mean()), float(variance.mean() ** 0.5)

    @property
    def torques(self) -> Array:
        """See `InputNoise.torques`; near half throttle thrust follows commands one to one."""
        return self._mixer.T @ self.covariance @ self._mixer

    def _of_elements(self) -> tuple[Array, ...]:
        signals = np.zeros((SIGNALS, SIGNALS))
        signals[:4, :4] = self.torques
        # Of w^2 the noise is 2 w times that of w.
        gains = np.array([1.0, 2.0 * self._mean.mean()])
        return (np.kron(np.outer(gains, gains), signals),)


def _overlaps(basis: ActuatorDynamics, taps: Array, step: int, dt: float, memory: float) -> Array:
    """(elements, elements) covariances of white noise after the basis' filters."""
    room = int(np.ceil(_SETTLED * basis.lags[-1] / dt))
    responses = np.zeros((len(basis.elements), taps.shape[1] + room))
    for response, element in zip(responses, basis.elements, strict=True):
        a, b0, b1 = motor_filter(dt, basis.lags[element.lag])
        driven = np.zeros(responses.shape[1])
        driven[: taps.shape[1]] = taps[element.delay]
        response[:] = lfilter([b0, b1], [1.0, -a], driven)[0]
    summed = leaky(responses, step, dt, memory)
    return summed @ summed.T
