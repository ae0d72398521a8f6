"""The plots: a parameter over time with its 95 % band; acceleration, measured and predicted."""

import math
import time
from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.model.parameters import AXES
from gcs_sysid.results import words
from gcs_sysid.results.history import Acceleration, History, known_history, settled_range
from gcs_sysid.results.result_view import exponent_key
from gcs_sysid.results.words import round_numbers, scaled_unit
from gcs_sysid.screen import formatting
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.lines import Line, Lines, Shown
from gcs_sysid.screen.view import View

Floats = NDArray[np.float64]


class RationedPlot(Lines, Shown):
    """Draws other choices and sizes at once, new data no more often than they can be read."""

    def __init__(self, id: str, classes: str | None = None) -> None:
        super().__init__(id=id, classes=classes)
        self._drawn_at = -math.inf
        self._waiting = False
        self._choices: tuple[object, ...] = ()
        self._data: object = None

    @abstractmethod
    def drawing(self) -> list[Line]:
        """The plot of the view for the present size."""

    @abstractmethod
    def content_of(self, view: View) -> tuple[object, tuple[object, ...]]:
        """The data that it shows, and the choices on how."""

    def lay_out(self, view: View) -> None:
        """Draw what is new, now or when the last drawing is old enough."""
        data, choices = self.content_of(view)
        choices = (self.content_size, *choices)
        rest = self._drawn_at + 0.5 - time.monotonic()
        if choices != self._choices or (data is not self._data and rest <= 0.0):
            self._choices = choices
            self.draw()
        elif data is not self._data and not self._waiting:
            self._waiting = True
            self.set_timer(rest, self.draw)

    def draw(self) -> None:
        """Draw now."""
        if self._view is not None:
            self._waiting, self._drawn_at = False, time.monotonic()
            self._data = self.content_of(self._view)[0]
            self.put(self.drawing())


_NOTHING, _BAND, _TRUTH, _VALUE = range(4)
_SIGNS = (" ", "░", "─", "")
_STYLES = ("", "$primary 70%", "$text-warning", "bold")
"""What a cell of the picture shows, each over the one before."""


def ticks_of(low: float, high: float, wanted: int) -> tuple[list[float], list[str]]:
    """Round numbers within a range, and how to write them."""
    ticks, decimals = round_numbers(low, high, wanted)
    return ticks, [f"{tick:.{decimals}f}" for tick in ticks]


@dataclass(frozen=True)
class PlottedHistory:
    """A history reduced to the columns of a plot: extremes in each, so that no spike is lost."""

    t: Floats
    """(k,) place of each column that holds data: from the very start to the very end."""
    low: Floats
    high: Floats
    """(k,) least and greatest value in the column."""
    band_low: Floats
    band_high: Floats
    """(k,) outermost edges of the 95 % band in the column, NaN where there is none."""


def reduced_history(
    history: History, name: str, columns: int, scale: float = 1.0
) -> PlottedHistory | None:
    """Min-max decimation of one parameter to plot columns, or None where it has no values."""
    if name not in history.value or columns < 1:
        return None
    t, value, half = known_history(history, name)
    value, half = scale * value, scale * half
    if t.size == 0:
        return None
    width = max(float(t[-1] - t[0]), 1e-9) / max(1, columns - 1)
    column = np.rint((t - t[0]) / width).astype(np.int64)
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    return PlottedHistory(
        t=t[0] + column[starts] * width,
        low=np.minimum.reduceat(value, starts),
        high=np.maximum.reduceat(value, starts),
        band_low=np.fmin.reduceat(value - half, starts),
        band_high=np.fmax.reduceat(value + half, starts),
    )


def shade(
    curve: PlottedHistory,
    span: tuple[float, float],
    bounds: tuple[float, float],
    size: tuple[int, int],
) -> NDArray[np.bool_]:
    """(lines, columns) which character cells the band covers.

    `span` is s at the first and the last column, `bounds` the value at the lower and the upper
    edge.
    """
    columns, lines = size
    x = np.rint((curve.t - span[0]) / (span[1] - span[0]) * (columns - 1)).astype(np.int64)
    low, high = (
        formatting.filled(x, edge, columns, columns) for edge in (curve.band_low, curve.band_high)
    )
    cell = (bounds[1] - bounds[0]) / lines
    centers = bounds[1] - cell * (np.arange(lines)[:, None] + 0.5)
    covered: NDArray[np.bool_] = (centers >= low - 0.5 * cell) & (centers <= high + 0.5 * cell)
    return covered


class Convergence(RationedPlot):
    """Plot of the chosen parameter: value, band, and the truth where it is known."""

    BORDER_TITLE = "Convergence"

    def __init__(self) -> None:
        super().__init__("convergence")

    def content_of(self, view: View) -> tuple[object, tuple[object, ...]]:
        """The history; the parameter and its power of ten."""
        history = None if view.snapshot is None else view.snapshot.history
        return history, (view.selected, view.exponents, view.ended)

    def headline(self) -> str:
        """The parameter's name and present value, as the plot's title writes it."""
        found = None if self._view is None else self._view.estimate(self._view.selected)
        if self._view is None or found is None:
            return ""
        parameter, estimate = found
        exponent = self._view.exponents.get(exponent_key(parameter), 0)
        text = " ".join(fmt.value_with_half(estimate, exponent).split())
        unit = scaled_unit(parameter.unit, exponent) if estimate.shown else ""
        return f"{words.label(parameter.name)} = {text} {unit}".rstrip()

    def drawing(self) -> list[Line]:
        """The picture between its headline and its axis."""
        width, height = self.content_size.width, self.content_size.height
        view = self._view
        if view is None or view.snapshot is None or width < 24 or height < 6:
            return []
        found = view.estimate(view.selected)
        history, truth = view.snapshot.history, view.truth.get(view.selected)
        key = "" if found is None else exponent_key(found[0])
        scale = 10.0 ** -view.exponents.get(key, 0)
        whole = reduced_history(history, view.selected, formatting.DOTS_WIDE * width, scale)
        if whole is None:
            missing = "history" if found is not None and found[1].shown else "estimate"
            yet = "" if view.ended else " yet"
            return [[(f"{words.label(view.selected)}: no {missing}{yet}", "")]]
        truth = None if truth is None else scale * truth
        bounds = settled_range(
            whole.t,
            (whole.low, whole.high),
            (whole.band_low, whole.band_high),
            () if truth is None else (truth,),
        )
        # Headline, time axis with its numbers, and legend take four lines.
        lines = height - 4
        ticks = ticks_of(*bounds, lines // 3)
        margin = max(map(len, ticks[1]), default=0) + 1
        columns = width - margin
        curve = (
            reduced_history(history, view.selected, formatting.DOTS_WIDE * columns, scale) or whole
        )
        rows = self._rows(curve, bounds, truth, (columns, lines))
        cell = (bounds[1] - bounds[0]) / lines
        at = {int((bounds[1] - tick) / cell): text for tick, text in zip(*ticks, strict=True)}
        drawn: list[Line] = [[(self.headline().center(width), "bold")]]
        for number, row in enumerate(rows):
            axis = f"{at.get(number, ''):>{margin - 1}}{'┤' if number in at else '│'}"
            drawn.append([(axis, ""), *row])
        drawn += self._time_axis(curve, margin, columns)
        legend = "░ 95 % band   ⠒ value" + ("" if truth is None else "   ─ truth")
        drawn.append([(f"seconds     {legend}".center(width).rstrip(), fmt.MUTED)])
        return drawn

    def _rows(
        self,
        curve: PlottedHistory,
        bounds: tuple[float, float],
        truth: float | None,
        size: tuple[int, int],
    ) -> list[Line]:
        """The lines of the picture: band, truth and value, each over the one before."""
        columns, lines = size
        span = _span(curve)
        wide = formatting.DOTS_WIDE * columns - 1
        x = np.rint((curve.t - span[0]) / (span[1] - span[0]) * wide).astype(np.int64)
        x, first = np.unique(x, return_index=True)
        dots = formatting.curve(x, curve.low[first], curve.high[first], bounds, size, wide)
        kinds = np.where(shade(curve, span, bounds, size), _BAND, _NOTHING)
        if truth is not None:
            kinds[int((bounds[1] - truth) / (bounds[1] - bounds[0]) * lines)] = _TRUTH
        kinds[np.array([[dot != " " for dot in line] for line in dots])] = _VALUE
        out = []
        for line, kind in zip(dots, kinds, strict=True):
            edges = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), columns]
            runs = zip(edges, edges[1:], kind[edges[:-1]].tolist(), strict=False)
            out.append(
                [
                    (line[a:b] if of == _VALUE else _SIGNS[of] * (b - a), _STYLES[of])
                    for a, b, of in runs
                ]
            )
        return out

    def _time_axis(self, curve: PlottedHistory, margin: int, columns: int) -> list[Line]:
        """The axis below the picture, and its numbers."""
        start, end = _span(curve)
        line, numbers = ["─"] * columns, [" "] * (columns + margin)
        for tick, text in zip(*ticks_of(start, end, columns // 12), strict=True):
            place = round((tick - start) / (end - start) * (columns - 1))
            left = min(max(0, margin + place - len(text) // 2), columns + margin - len(text))
            if 0 <= place < columns:
                line[place] = "┬"
                numbers[left : left + len(text)] = text
        return [
            [(" " * (margin - 1) + "└" + "".join(line), "")],
            [("".join(numbers).rstrip(), "")],
        ]


def _span(curve: PlottedHistory) -> tuple[float, float]:
    """S at the left and the right edge of the picture."""
    return float(curve.t[0]), max(float(curve.t[-1]), float(curve.t[0]) + 1e-3)


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
    per_second = (formatting.DOTS_WIDE * size[0] - 1) / (end - start)
    x = np.rint((t - start) * per_second).astype(np.int64)
    bridge = max(2, round(0.3 * per_second))  # a gap of more than 0.3 s is not drawn over
    return formatting.curve(*formatting.extremes(x, values), (-limit, limit), size, bridge)


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

    def content_of(self, view: View) -> tuple[object, tuple[object, ...]]:
        """The acceleration; there is no choice."""
        return None if view.snapshot is None else view.snapshot.acceleration, ()

    def drawing(self) -> list[Line]:
        """Three strips, and what the signs mean."""
        view, size = self._view, self.content_size
        found = None if view is None or view.snapshot is None else view.snapshot.acceleration
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
