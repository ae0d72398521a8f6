"""A plot that is drawn no more often than it can be read: the dearest part of the screen."""

import math
import time
from abc import abstractmethod

from gcs_sysid.screen.widgets.lines import Line, Lines

MIN_SECONDS = 0.5
"""Between two drawings of what grows."""


class RationedPlot(Lines):
    """Draws itself on request, several requests within `MIN_SECONDS` making one drawing."""

    def __init__(self, id: str, classes: str | None = None) -> None:
        super().__init__(id=id, classes=classes)
        self._drawn_at = -math.inf
        self._waiting = False

    @abstractmethod
    def drawing(self) -> list[Line]:
        """The plot for the present size."""

    def draw(self) -> None:
        """Draw now."""
        self._drawn_at = time.monotonic()
        self.put(self.drawing())

    def draw_later(self) -> None:
        """Draw when the last drawing is old enough."""
        if self._waiting:
            return
        rest = self._drawn_at + MIN_SECONDS - time.monotonic()
        if rest <= 0.0:
            self.draw()
            return
        self._waiting = True
        self.set_timer(rest, self._draw_waiting)

    def _draw_waiting(self) -> None:
        self._waiting = False
        self.draw()

    def on_resize(self) -> None:
        """Draw for the new size."""
        self.draw()
