"""A mission's set-points, one control period after the other."""

from collections.abc import Iterator

from sim_bridge.missions import Mission, Reference, references

AHEAD = 128
"""Control periods that are looked up at a time."""


class SetPoints:
    """Reads a mission many control periods at a time, as multisines are far cheaper then.

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
        reference = next(self._ready, None) if tick == self._next else None
        if reference is None:
            ticks = range(tick, tick + AHEAD * self._steps, self._steps)
            self._ready = references(self._mission, [k * self._step_size for k in ticks])
            reference = next(self._ready)
        self._next = tick + self._steps
        return reference
