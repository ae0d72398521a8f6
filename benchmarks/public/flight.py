"""What an estimator is given, and what it answers."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.session.chain import Chain
from gcs_sysid.signals.sampling import SampleBlock

SHORTEST = 2.0
"""s of a stretch that is worth giving out."""


@dataclass(frozen=True)
class Stretch:
    """Uninterrupted flight on a uniform grid. Axes are forward, right, down.

    Attributes:
        t: (n,) s, the vehicle's clock.
        rates: (n, 3) angular rates without bias, rad/s.
        force: (n, 3) specific force (what an accelerometer reads), m/s^2.
        rotors: (n, rotors) speeds, rad/s; or commands from 0 to 1.
    """

    t: Array
    rates: Array
    force: Array
    rotors: Array


@dataclass(frozen=True)
class Flight:
    """A flight, and what its user knows of the vehicle.

    Attributes:
        dt: s from sample to sample.
        stretches: of at least 2 s each.
        commands: whether `rotors` are commands, thrust being unknown but growing with them.
        x: (rotors,) m forward of the point that airframes are measured from.
        y: (rotors,) m to the right of it.
        spin: (rotors,) +1 for counter-clockwise seen from above, else -1.
        mass: kg.
    """

    dt: float
    stretches: tuple[Stretch, ...]
    commands: bool
    x: Array
    y: Array
    spin: Array
    mass: float

    @property
    def geometry(self) -> Array:
        """(3, rotors) x, y and spin."""
        return np.stack([self.x, self.y, self.spin])

    @property
    def arm(self) -> float:
        """m, mean distance of the rotors."""
        return float(np.hypot(self.x, self.y).mean())


Claims = Mapping[str, tuple[float, float]]
"""Parameter -> value and its standard deviation, SI. What is not claimed is left out."""
Entry = Callable[[Flight], Claims]


class Onlooker:
    """Keeps the aligned samples that the program's own chain makes of a log."""

    def __init__(self) -> None:
        self.blocks: list[SampleBlock] = []

    def begin(self) -> None:
        """Reset: the log is read again."""
        self.blocks = []

    def take(self, block: SampleBlock) -> None:
        """Keep a block."""
        self.blocks.append(block)

    def end(self, chain: Chain) -> None:
        """Nothing more."""


def flight_of(blocks: list[SampleBlock], airframe: Airframe) -> Flight | None:
    """Samples that the program's own chain aligned; None where nothing flew or mass is unknown.

    Args:
        blocks: of a log, in order.
        airframe: as the user has it.
    """
    if airframe.mass is None:
        return None
    rotors = len(airframe.rotors)
    blocks = [b for b in blocks if b.rotors is not None and b.samples.speeds.shape[1] == rotors]
    if not blocks:
        return None
    # The stream that the end of the log rests on.
    source = blocks[-1].rotors
    assert source is not None
    stream = (source.kind, source.name)
    blocks = [b for b in blocks if b.rotors and (b.rotors.kind, b.rotors.name) == stream]
    dt = blocks[-1].dt
    t = np.concatenate([b.t for b in blocks])
    columns = [
        np.concatenate(c)
        for c in zip(
            *((b.samples.rates, b.samples.force, b.samples.speeds) for b in blocks), strict=True
        )
    ]
    flying = np.concatenate([b.flying for b in blocks])
    good = flying & np.isfinite(np.column_stack(columns)).all(axis=1)
    # A stretch ends where a sample is missing or cannot be used.
    joined = np.append(False, good[1:] & good[:-1] & (np.abs(np.diff(t) - dt) < 0.5 * dt))
    cuts = np.append(np.flatnonzero(~joined), len(t))
    stretches = []
    for begin, stop in pairwise(cuts.tolist()):
        if good[begin] and (stop - begin) * dt >= SHORTEST:
            stretches.append(Stretch(t[begin:stop], *(c[begin:stop] for c in columns)))
    if not stretches:
        return None
    x, y, spin = airframe.geometry
    commands = source.kind.motors
    return Flight(dt, tuple(stretches), commands, x, y, spin, airframe.mass)
