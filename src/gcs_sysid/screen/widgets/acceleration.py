"""Measured against predicted angular acceleration: three strips, one an axis."""

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.model.parameters import AXES
from gcs_sysid.results.history import Acceleration
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen import text_drawing
from gcs_sysid.screen.view import View
from gcs_sysid.screen.widgets.lines import Line, RationedPlot

Floats = NDArray[np.float64]

PREDICTED = "•"
MARGIN = 7
"""Columns for an axis' name and scale."""


def strip(
    t: Floats, values: Floats, start: float, end: float, limit: float, size: tuple[int, int]
) -> list[str]:
    """A curve as lines of braille.

    Args:
        t: (n,) s.
        values: (n,).
        start: s at the left edge.
        end: s at the right edge.
        limit: of the values at the upper edge, and minus that at the lower.
        size: columns and lines.
    """
    per_second = (text_drawing.DOTS_WIDE * size[0] - 1) / (end - start)
    x = np.rint((t - start) * per_second).astype(np.int64)
    bridge = max(2, round(0.3 * per_second))  # a gap of more than 0.3 s is not drawn over
    return text_drawing.curve(*text_drawing.extremes(x, values), (-limit, limit), size, bridge)


def overlay(
    lines: list[str], t: Floats, values: Floats, start: float, end: float, limit: float
) -> list[str]:
    """The predicted curve as a dot in every second column, over the lines of the measured one.

    In one color: a hundred changes of color a line took most of the screen's time, and the signs
    distinguish the two.
    """
    columns, high = len(lines[0]), len(lines)
    marks: dict[int, int] = {}
    for column in range(0, columns, 2):
        near = np.abs(t - (start + (column + 0.5) / columns * (end - start)))
        i = int(near.argmin())
        if near[i] <= 1.5 * (end - start) / columns and np.isfinite(values[i]):
            place = (0.5 - 0.5 * values[i] / limit) * (high - 1)
            marks[column] = int(np.clip(round(place), 0, high - 1))
    out = [list(line) for line in lines]
    for column, row in marks.items():
        out[row][column] = PREDICTED
    return ["".join(line) for line in out]


def nice_limit(largest: float) -> float:
    """A round number at or above the largest value: 1, 2 or 5 times a power of ten."""
    if not largest > 0.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(largest))
    return float(next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= largest * 0.999))


class AccelerationPanel(RationedPlot):
    """What the vehicle did, and what the estimate said that it would do."""

    BORDER_TITLE = "Angular acceleration, rad/s²: one-step-ahead prediction"

    def __init__(self, name: str) -> None:
        super().__init__(name, classes="acceleration")
        self._found: Acceleration | None = None

    def show(self, view: View) -> None:
        """Bring the panel up to date."""
        found = None if view.snapshot is None else view.snapshot.acceleration
        if found is not self._found:
            self._found = found
            self.draw_later()

    def drawing(self) -> list[Line]:
        """Three strips, and what the signs mean."""
        found, size = self._found, self.content_size
        if found is None or len(found.t) < 2:
            return [[("no prediction yet", fmt.MUTED)]]
        if size.width < 20 or size.height < 4:
            return []
        return self._strips(found, size.width, size.height)

    def _strips(self, found: Acceleration, width: int, height: int) -> list[Line]:
        each = max(1, (height - 1) // 3)
        columns = width - MARGIN
        start, end = float(found.t[0]), float(found.t[-1])
        shares = found.r_squared
        lines: list[Line] = []
        for axis, name in enumerate(AXES):
            measured, predicted = found.measured[:, axis], found.predicted[:, axis]
            limit = nice_limit(float(np.nanmax(np.abs(measured), initial=0.0)))
            curve = strip(found.t, measured, start, end, limit, (columns, each))
            drawn = overlay(curve, found.t, predicted, start, end, limit)
            heads = [name, f"±{limit:g}"] if each > 1 else [name]
            for row, text in enumerate(drawn):
                head = heads[row] if row < len(heads) else ""
                lines.append([(f"{head:<{MARGIN}}", fmt.MUTED if row else "bold"), (text, "")])
        readings = "  ".join(
            f"{name} {'?' if np.isnan(share) else f'{100.0 * max(share, 0.0):.1f} %'}"
            for name, share in zip(AXES, shares, strict=True)
        )
        legend = f"⠒ measured  {PREDICTED} predicted"
        explained = f"   explained: {readings}"
        fits = len(legend) + len(explained) <= width
        lines.append([(legend, fmt.MUTED), (explained if fits else "", "bold")])
        return lines
