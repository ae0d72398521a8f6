"""The convergence plot: one parameter over time with its 95 % band."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.results import words
from gcs_sysid.results.history import History, known_history, settled_range
from gcs_sysid.results.number_format import scaled_unit
from gcs_sysid.results.result_view import exponent_key
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen import text_drawing
from gcs_sysid.screen.view import View
from gcs_sysid.screen.widgets.lines import Line, RationedPlot

Floats = NDArray[np.float64]

_NOTHING, _BAND, _TRUTH, _VALUE = range(4)
_SIGNS = (" ", "░", "─", "")
_STYLES = ("", "$primary 70%", "$text-warning", "bold")
"""What a cell of the picture shows, each over the one before."""


def nice_ticks(low: float, high: float, wanted: int) -> tuple[list[float], list[str]]:
    """About so many round numbers within a range, at least two, and how to write them."""
    rough = (high - low) / max(1, wanted)
    power = 10.0 ** math.floor(math.log10(rough))
    steps = [m * power for m in (0.5, 1.0, 2.0, 5.0, 10.0)]
    widest = next(i for i, step in enumerate(steps) if step >= rough)
    for step in reversed(steps[: widest + 1]):
        first, last = math.ceil(low / step), math.floor(high / step)
        ticks = [n * step for n in range(first, last + 1)]
        if len(ticks) > 1:
            break
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
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

    Args:
        curve: with the band.
        span: s at the first and the last column.
        bounds: value at the lower and the upper edge.
        size: columns and lines.
    """
    columns, lines = size
    x = np.rint((curve.t - span[0]) / (span[1] - span[0]) * (columns - 1)).astype(np.int64)
    low, high = (
        text_drawing.filled(x, edge, columns, columns) for edge in (curve.band_low, curve.band_high)
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
        self.view: View | None = None

    def show(self, view: View) -> None:
        """Bring the plot up to date."""
        old, self.view = self.view, view
        if old is None or _choices(old) != _choices(view):
            self.draw()
        elif (old.snapshot and old.snapshot.history) is not (
            view.snapshot and view.snapshot.history
        ):
            self.draw_later()

    def headline(self) -> str:
        """The parameter's name and present value, as the plot's title writes it."""
        found = None if self.view is None else self.view.estimate(self.view.selected)
        if self.view is None or found is None:
            return ""
        parameter, estimate = found
        exponent = self.view.exponents.get(exponent_key(parameter), 0)
        text = " ".join(fmt.value_with_half(estimate, exponent).split())
        unit = scaled_unit(parameter.unit, exponent) if estimate.shown else ""
        return f"{words.label(parameter.name)} = {text} {unit}".rstrip()

    def drawing(self) -> list[Line]:
        """The picture between its headline and its axis."""
        width, height = self.content_size.width, self.content_size.height
        view = self.view
        if view is None or view.snapshot is None or width < 24 or height < 6:
            return []
        found = view.estimate(view.selected)
        history, truth = view.snapshot.history, view.truth.get(view.selected)
        key = "" if found is None else exponent_key(found[0])
        scale = 10.0 ** -view.exponents.get(key, 0)
        whole = reduced_history(history, view.selected, text_drawing.DOTS_WIDE * width, scale)
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
        ticks = nice_ticks(*bounds, lines // 3)
        margin = max(map(len, ticks[1]), default=0) + 1
        columns = width - margin
        curve = (
            reduced_history(history, view.selected, text_drawing.DOTS_WIDE * columns, scale)
            or whole
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
        wide = text_drawing.DOTS_WIDE * columns - 1
        x = np.rint((curve.t - span[0]) / (span[1] - span[0]) * wide).astype(np.int64)
        x, first = np.unique(x, return_index=True)
        dots = text_drawing.curve(x, curve.low[first], curve.high[first], bounds, size, wide)
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
        for tick, text in zip(*nice_ticks(start, end, columns // 12), strict=True):
            place = round((tick - start) / (end - start) * (columns - 1))
            left = min(max(0, margin + place - len(text) // 2), columns + margin - len(text))
            if 0 <= place < columns:
                line[place] = "┬"
                numbers[left : left + len(text)] = text
        return [
            [(" " * (margin - 1) + "└" + "".join(line), "")],
            [("".join(numbers).rstrip(), "")],
        ]


def _choices(view: View) -> tuple[object, ...]:
    """What the plot follows at once, besides the history."""
    return view.selected, view.exponents, view.ended


def _span(curve: PlottedHistory) -> tuple[float, float]:
    """S at the left and the right edge of the picture."""
    return float(curve.t[0]), max(float(curve.t[-1]), float(curve.t[0]) + 1e-3)
