"""What both kinds of noise of the rotors' inputs have in common: unbroken runs of samples."""

from abc import ABC, abstractmethod

import numpy as np

from gcs_sysid.arrays import Array, complete_rows, runs

THIRD_DIFFERENCE = 20.0
"""1 + 9 + 9 + 1: variance of a third difference over that of white noise."""


class InputNoise(ABC):
    """Follows the noise of the rotors' inputs.

    Args:
        rotors: how many.
    """

    def __init__(self, rotors: int) -> None:
        self._last = np.zeros((0, rotors))
        """The latest inputs, which the next ones join on to."""

    @property
    @abstractmethod
    def doubt(self) -> float:
        """Relative standard deviation of the variance."""

    @property
    @abstractmethod
    def std(self) -> Array:
        """(rotors,) of one input."""

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
        self._last = self._last[:0]

    @abstractmethod
    def _add(self, inputs: Array) -> None:
        """Take inputs that are whole and follow on the last ones."""
