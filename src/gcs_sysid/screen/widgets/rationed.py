"""A plot that is drawn no more often than it can be read: the dearest part of the screen."""

import math
import time

from textual.widget import Widget

MIN_SECONDS = 0.5
"""Between two drawings of what grows."""


class RationedPlot(Widget):
    """Redraws on request, several requests within `MIN_SECONDS` making one drawing."""

    def __init__(self, id: str, classes: str | None = None) -> None:
        super().__init__(id=id, classes=classes)
        self._drawn_at = -math.inf
        self._waiting = False

    def note_drawing(self) -> None:
        """To be called by `render`."""
        self._drawn_at = time.monotonic()

    def refresh_later(self) -> None:
        """Redraw when the last drawing is old enough."""
        if self._waiting:
            return
        rest = self._drawn_at + MIN_SECONDS - time.monotonic()
        if rest <= 0.0:
            self.refresh()
            return
        self._waiting = True
        self.set_timer(rest, self._refresh_waiting)

    def _refresh_waiting(self) -> None:
        self._waiting = False
        self.refresh()
