"""A mission's set-points, one control period after the other."""

from collections.abc import Iterator

from sim_bridge.missions import ExcitationMission, Mission, Reference

AHEAD = 64
"""Control periods for which multisines are computed at a time."""


class SetPoints:
    """Reads a mission; multisines are known in advance, and far cheaper many at a time.

    Args:
        mission: to fly.
        step_size: s in a physics step.
        steps: of the physics in a control period.
    """

    def __init__(self, mission: Mission, step_size: float, steps: int) -> None:
        self._mission = mission
        self._step_size = step_size
        self._steps = steps
        self._next = -1
        self._ready: Iterator[Reference] = iter(())

    def at(self, tick: int) -> Reference:
        """Set-points at a physics step; it is quickest a control period after the last one."""
        mission = self._mission
        if not isinstance(mission, ExcitationMission):
            return mission.reference(tick * self._step_size)
        reference = next(self._ready, None) if tick == self._next else None
        if reference is None:
            ticks = range(tick, tick + AHEAD * self._steps, self._steps)
            self._ready = mission.references([k * self._step_size for k in ticks])
            reference = next(self._ready)
        self._next = tick + self._steps
        return reference
