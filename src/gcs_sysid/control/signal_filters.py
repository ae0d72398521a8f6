"""Filters of gyro and derivative: what an autopilot's parameters make of a signal before it acts.

All are continuous: they run at the gyro's rate, which is fast against their frequencies.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gcs_sysid.arrays import Array


@dataclass(frozen=True)
class SignalFilter:
    """One filter.

    Attributes:
        kind: "first", "second" or "third" order, poles alike, at -3 dB there (Betaflight's PT1, PT2
            and PT3); "butterworth", of second order; or "notch".
        frequency: Hz.
        quality: of a notch, its frequency over its width at -3 dB.
        depth: of a notch, its gain in the middle.
    """

    kind: Literal["first", "second", "third", "butterworth", "notch"]
    frequency: float
    quality: float = 1.0
    depth: float = 0.0

    def response(self, s: Array) -> Array:
        """At s = j omega, rad/s.

            first, second, third   1 / (1 + k x)^n ,  k^2 = 2^(1/n) - 1
            butterworth            1 / (1 + sqrt(2) x + x^2)
            notch                  (1 + depth x / Q + x^2) / (1 + x / Q + x^2)

        with x = s over the frequency in rad/s.
        """
        x = s / (2.0 * np.pi * self.frequency)
        response: Array
        if self.kind == "notch":
            width = x / self.quality
            response = (1.0 + self.depth * width + x * x) / (1.0 + width + x * x)
        elif self.kind == "butterworth":
            response = 1.0 / (1.0 + math.sqrt(2.0) * x + x * x)
        else:
            n = ("first", "second", "third").index(self.kind) + 1
            response = 1.0 / (1.0 + math.sqrt(2.0 ** (1.0 / n) - 1.0) * x) ** n
        return response


def chain_response(filters: Iterable[SignalFilter], s: Array) -> Array:
    """Of filters one behind the other."""
    out = np.ones_like(s)
    for each in filters:
        out = out * each.response(s)
    return out
