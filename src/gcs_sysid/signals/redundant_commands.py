"""Streams of commands that say the same, which together show more than one of them.

PX4 sends its outputs as ACTUATOR_OUTPUT_STATUS and as SERVO_OUTPUT_RAW. Where a link is slow, they
are sampled at different instants: the mean of both misses a third as much of what was commanded
between samples, and a message lost of one is seldom lost of the other.
"""

from collections.abc import Sequence

import numpy as np

from gcs_sysid.arrays import Array

SLOW_COMMANDS = 0.012
"""s between commands. Those that come more often miss little (6 % of their noise at 100 Hz), and
what is seen at a quarter of their rate may well be motion: taking that out costs more than it
brings."""

Rotors = Sequence[tuple[Array, Array]]
"""Times and values of each rotor."""

_TWINS = ("ACTUATOR_OUTPUT_STATUS", "SERVO_OUTPUT_RAW")
_FEW = 20
_AS_OFTEN = 0.7
"""Of the messages of one, that the other has at least; a slow stream would only blur a fast one."""
_ROUNDING = 1.0
"""Of SERVO_OUTPUT_RAW, which sends whole microseconds."""


def twin_of(name: str) -> str | None:
    """The stream that may say what this one says."""
    return _TWINS[1 - _TWINS.index(name)] if name in _TWINS else None


def say_the_same(rotors: Rotors, others: Rotors) -> bool:
    """Whether the others come as often, and fit between the values as these fit between each other.

    Other units, other outputs or other stamps show.
    """
    return len(rotors) == len(others) and all(
        _fits(*one, *other) for one, other in zip(rotors, others, strict=True)
    )


def _fits(t: Array, values: Array, other_t: Array, other_values: Array) -> bool:
    inside = (other_t >= t[0]) & (other_t <= t[-1])
    if inside.sum() < max(_FEW, _AS_OFTEN * len(t)):
        return False
    own = _beside(t, values)
    off = other_values[inside] - np.interp(other_t[inside], t, values)
    return float(np.sqrt(np.mean(off**2))) <= 1.2 * float(np.sqrt(np.mean(own**2))) + _ROUNDING


def _beside(t: Array, values: Array) -> Array:
    """(n - 2,) what a straight line between the neighbors of each value leaves of it."""
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    return values[1:-1] - values[:-2] - share * (values[2:] - values[:-2])


def mean_of(one: Array, other: Array) -> Array:
    """(n, rotors) the mean of both, or the one that is there."""
    mean: Array = 0.5 * (one + other)
    np.copyto(mean, other, where=np.isnan(one))
    np.copyto(mean, one, where=np.isnan(other))
    return mean
