"""The fact that sets the scale: a weighed mass, a known thrust, or a known mass added."""

from dataclasses import dataclass
from typing import Literal

ScaleKind = Literal["mass", "k_T", "T_max", "added_mass"]
Known = tuple[float, float]
"""A value and its standard deviation."""


@dataclass(frozen=True)
class ScaleReference:
    """The fact that sets the scale.

    Attributes:
        kind: which.
        value: of it, SI.
        std: of the value; zero as given by a user, not where it comes from an earlier segment.
        origin: where it comes from; empty for a user.
        loaded: of "added_mass", k_T / m of the flight with the mass added, and its deviation.
        given: share by which what was given at first may be wrong, which no flight shows: all
            that is in proportion to the scale is off by it, after changes in flight too.
    """

    kind: ScaleKind
    value: float
    std: float = 0.0
    origin: str = ""
    loaded: Known | None = None
    given: float = 0.0
