"""Sensor noise: colored, white and MEMS, one seeded generator a sensor.

Noise is drawn in blocks by NumPy and SciPy and handed out sample by sample; how it is cut into
blocks does not change a single value, so that the message path and an ensemble study draw the
same noise from the same seed.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.recursions import lfilter

Array = NDArray[np.float64]

BLOCK = 512
"""Samples drawn at a time."""

CORNER = 5.0
"""rad/s, corner of the article's shaping filters."""

SENSORS = ("gyro", "accelerometer", "attitude", "rotor", "velocity")
"""Sensors with noise of their own; the order fixes which generator is whose."""


class Component(Protocol):
    """One additive part of a sensor's noise."""

    def start(self, random: np.random.Generator, width: int) -> None:
        """Draw what stays for the whole flight; begin in the stationary state."""
        ...

    def block(self, random: np.random.Generator, count: int, width: int, dt: float) -> Array:
        """The next (count, width) samples, dt seconds apart."""
        ...


@dataclass
class White:
    """White noise: of standard deviation sigma, or of a density.

    Attributes:
        sigma: in the sensor's unit.
        density: one-sided, in the sensor's unit per root hertz: sigma^2 = density^2 / (2 dt).
    """

    sigma: float = 0.0
    density: float = 0.0

    def start(self, random: np.random.Generator, width: int) -> None:
        """Nothing stays."""

    def block(self, random: np.random.Generator, count: int, width: int, dt: float) -> Array:
        """The next samples."""
        sigma = math.hypot(self.sigma, self.density / math.sqrt(2.0 * dt))
        return sigma * random.standard_normal((count, width))


class LowPass:
    """White noise through corner / (s + corner), of stationary standard deviation sigma."""

    def __init__(self, sigma: float, corner: float = CORNER) -> None:
        self.sigma = sigma
        self.corner = corner
        self._last: Array = np.zeros(0)

    def start(self, random: np.random.Generator, width: int) -> None:
        """Begin in the stationary state."""
        self._last = self.sigma * random.standard_normal(width)

    def block(self, random: np.random.Generator, count: int, width: int, dt: float) -> Array:
        """The next samples: x_k+1 = a x_k + sigma sqrt(1 - a^2) n_k."""
        a = math.exp(-self.corner * dt)
        fresh = self.sigma * math.sqrt(1.0 - a * a) * random.standard_normal((count, width))
        out, _ = lfilter([1.0], [1.0, -a], fresh, (a * self._last)[None, :])
        self._last = out[-1]
        return np.asarray(out)


class HighPass:
    """White noise through s / (s + corner), of stationary standard deviation sigma.

    y_k = n_k - x_k with x_k+1 = a x_k + (1 - a) n_k; var(y) = 2 / (1 + a) var(n).
    """

    def __init__(self, sigma: float, corner: float = CORNER) -> None:
        self.sigma = sigma
        self.corner = corner
        self._slow: Array | None = None
        self._draw: Array = np.zeros(0)

    def start(self, random: np.random.Generator, width: int) -> None:
        """Draw the slow part's first value; its scale needs the sample time, known later."""
        self._slow = None
        self._draw = random.standard_normal(width)

    def block(self, random: np.random.Generator, count: int, width: int, dt: float) -> Array:
        """The next samples."""
        a = math.exp(-self.corner * dt)
        sigma = self.sigma * math.sqrt((1.0 + a) / 2.0)
        if self._slow is None:
            self._slow = sigma * math.sqrt((1.0 - a) / (1.0 + a)) * self._draw
        white = sigma * random.standard_normal((count, width))
        slow, after = lfilter([0.0, 1.0 - a], [1.0, -a], white, self._slow[None, :])
        self._slow = after[0]
        return np.asarray(white - slow)


class Bias:
    """A constant of this size and random sign on every axis, walking if `walk` is set.

    Attributes:
        size: in the sensor's unit.
        walk: in the sensor's unit per root second.
    """

    def __init__(self, size: float, walk: float = 0.0) -> None:
        self.size = size
        self.walk = walk
        self._now: Array = np.zeros(0)

    def start(self, random: np.random.Generator, width: int) -> None:
        """Draw the signs."""
        self._now = self.size * random.choice([-1.0, 1.0], size=width)

    def block(self, random: np.random.Generator, count: int, width: int, dt: float) -> Array:
        """The next samples."""
        steps = self.walk * math.sqrt(dt) * random.standard_normal((count, width))
        # Summed from the last value on, so that the cut into blocks changes nothing.
        steps[0] += self._now
        out = np.cumsum(steps, axis=0)
        self._now = out[-1]
        return out


def noise_model(name: str, sigma: float) -> dict[str, list[Component]]:
    """The noise of every sensor that has any.

    none: perfect sensors.
    paper: white noise through first-order filters with a corner of 5 rad/s: low-pass on the
        accelerometer and the attitude made from it, high-pass on the gyro. sigma is the
        stationary standard deviation in rad, rad/s and (times g) m/s^2.
    white: the same standard deviations, white.
    mems: a small inertial unit with densities, biases and their walk.

    Raises:
        ValueError: there is no such model.
    """
    if name == "none":
        return {}
    if name == "paper":
        return {
            "gyro": [HighPass(sigma)],
            # Tilt from an accelerometer is a/g: noise of sigma g makes sigma of tilt.
            "accelerometer": [LowPass(sigma * GRAVITY)],
            "attitude": [LowPass(sigma)],
        }
    if name == "white":
        return {
            "gyro": [White(sigma)],
            "accelerometer": [White(sigma * GRAVITY)],
            "attitude": [White(sigma)],
        }
    if name == "mems":
        return {
            "gyro": [
                White(density=math.radians(0.01)),  # rad/s/sqrt(Hz), as of an ICM-20948 class
                Bias(0.01, walk=5e-5),  # rad/s left after calibration; rad/s/sqrt(s)
            ],
            "accelerometer": [
                White(density=100e-6 * GRAVITY),  # 100 ug/sqrt(Hz)
                Bias(0.05, walk=1e-4),  # m/s^2; m/s^2/sqrt(s)
            ],
            "attitude": [LowPass(math.radians(0.2), corner=1.0)],  # rad, an EKF's slow error
            "rotor": [White(0.5)],  # rad/s
            "velocity": [LowPass(0.03, corner=1.0)],  # m/s, an EKF with GNSS
        }
    raise ValueError(f"no noise model {name!r}")


NOISE_MODELS = ("none", "paper", "mems", "white")
"""Names that `noise_model` knows."""


class Channel:
    """The noise of one sensor.

    Attributes:
        width: values a sample.
        interval: s between samples.
    """

    def __init__(
        self,
        components: Sequence[Component],
        width: int,
        interval: float,
        seed: np.random.SeedSequence,
    ) -> None:
        self.width = width
        self.interval = interval
        self._components = list(components)
        # A generator each: what one component draws never moves the others.
        self._randoms = [np.random.default_rng(s) for s in seed.spawn(len(self._components))]
        for component, random in zip(self._components, self._randoms, strict=True):
            component.start(random, width)
        self._drawn: Array = np.empty((0, width))
        self._ready: Iterator[list[float]] = iter(())
        self._quiet = [0.0] * width

    def block(self, count: int) -> Array:
        """The next (count, width) samples.

        However many are asked for, they are drawn BLOCK at a time: a recursion that goes on from
        one block to the next rounds its first value otherwise than within one.
        """
        drawn = [self._drawn]
        for _ in range(-((len(self._drawn) - count) // BLOCK)):
            drawn.append(self._draw())
        whole = np.concatenate(drawn)
        self._drawn = whole[count:]
        return whole[:count]

    def _draw(self) -> Array:
        out = np.zeros((BLOCK, self.width))
        for component, random in zip(self._components, self._randoms, strict=True):
            out += component.block(random, BLOCK, self.width, self.interval)
        return out

    def next(self) -> list[float]:
        """The next sample."""
        if not self._components:
            return self._quiet
        sample = next(self._ready, None)
        if sample is None:
            self._ready = iter(self.block(BLOCK).tolist())
            sample = next(self._ready)
        return sample

    def retime(self, interval: float) -> None:
        """Go on with samples this far apart (a ground station asked for another rate)."""
        if interval != self.interval:
            self.interval = interval
            self._ready = iter(())


def make_channels(
    name: str,
    sigma: float,
    intervals: dict[str, float],
    rotors: int,
    seed: np.random.SeedSequence,
) -> dict[str, Channel]:
    """A channel for every sensor.

    Args:
        name: noise model.
        sigma: of the models that take one.
        intervals: s between samples of every sensor.
        rotors: number of rotors.
        seed: of the flight; each sensor gets its own generator.
    """
    model = noise_model(name, sigma)
    return {
        sensor: Channel(
            model.get(sensor, []), rotors if sensor == "rotor" else 3, intervals[sensor], own
        )
        for sensor, own in zip(SENSORS, seed.spawn(len(SENSORS)), strict=True)
    }
