"""A mission from the ground and back to it, once or several times."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from sim_bridge.missions import HEIGHT, Mission, Reference, ramp, references

CLIMB = 6.0
"""s from the ground to the mission's height, and down again."""

SPIN_UP = 1.5
"""s armed on the ground, rotors turning, before each climb."""


@dataclass(frozen=True)
class GroundCycle:
    """Stays on the ground with flights between them.

    Attributes:
        mission: flown on each flight.
        ground: s of each stay.
        flights: how many.
    """

    mission: Mission
    ground: float
    flights: int = 1

    @property
    def name(self) -> str:
        """That of the mission."""
        return self.mission.name

    @property
    def duration(self) -> float:
        """All flights and stays, s."""
        return self.flights * self._cycle + self.ground

    @property
    def turbulence(self) -> float:
        """That of the mission."""
        return self.mission.turbulence

    @property
    def _cycle(self) -> float:
        return self.ground + 2.0 * CLIMB + self.mission.duration

    def _place(self, t: float) -> tuple[int, float]:
        """Number of the flight, and s since its climb began (negative on the ground before)."""
        flight, at = divmod(t, self._cycle)
        return int(flight), at - self.ground

    def is_grounded(self, t: float) -> bool:
        """Whether the vehicle stands on the ground."""
        flight, at = self._place(t)
        return at < 0.0 or flight >= self.flights

    def is_armed(self, t: float) -> bool:
        """Whether the rotors may turn."""
        flight, at = self._place(t)
        return flight < self.flights and at >= -SPIN_UP

    def reference(self, t: float) -> Reference:
        """Set-points t seconds after the start."""
        return next(self.references([t]))

    def references(self, times: Sequence[float]) -> Iterator[Reference]:
        """`reference` at many times."""
        length = self.mission.duration
        places = [self._place(t) for t in times]
        inside = [min(max(at - CLIMB, 0.0), length) for _, at in places]
        for (flight, at), here in zip(places, references(self.mission, inside), strict=True):
            yield self._placed(flight, at, here)

    @cached_property
    def _ends(self) -> tuple[Reference, Reference]:
        """The mission's first set-points and its last."""
        return self.mission.reference(0.0), self.mission.reference(self.mission.duration)

    def _placed(self, flight: int, at: float, here: Reference) -> Reference:
        """The mission's set-points from the ground and back, where earlier flights have ended."""
        length = self.mission.duration
        first, last = self._ends
        if not CLIMB <= at < CLIMB + length:
            # Up or down on the spot, where the mission begins or ended.
            falling = at >= CLIMB
            u = 1.0 - (at - CLIMB - length) / CLIMB if falling else at / CLIMB
            share, rate, acceleration = ramp(u)
            rate = -rate if falling else rate
            x, y, _ = here.position
            here = first._replace(
                position=(x, y, -HEIGHT * share),
                velocity=(0.0, 0.0, -HEIGHT / CLIMB * rate),
                acceleration=(0.0, 0.0, -HEIGHT / CLIMB**2 * acceleration),
            )
        north, east, _ = last.position
        x, y, z = here.position
        return here._replace(position=(x + flight * north, y + flight * east, z))
