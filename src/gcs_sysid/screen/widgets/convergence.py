"""The convergence plot: one parameter over time with its 95 % band."""

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.text import Text
from textual.app import RenderResult
from textual.color import Color
from textual_plotext import PlotextPlot

from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.view import View
from gcs_sysid.session.snapshot import Course

Floats = NDArray[np.float64]

MIN_WIDTH, MIN_HEIGHT = 24, 6
"""Below this a plot says nothing."""

MIN_SECONDS = 0.5
"""Time between two drawings of a growing course: by far the dearest part of the screen, and the
one that changes least."""


def nice_ticks(low: float, high: float, wanted: int) -> tuple[list[float], list[str]]:
    """About so many round numbers within a range, and how to write them."""
    rough = (high - low) / max(1, wanted)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= rough)
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    first, last = math.ceil(low / step), math.floor(high / step)
    ticks = [n * step for n in range(first, last + 1)]
    return ticks, [f"{tick:.{decimals}f}" for tick in ticks]


@dataclass(frozen=True)
class Curve:
    """A course reduced to the columns of a plot: extremes in each, so that no spike is lost."""

    t: Floats
    """(k,) place of each column that holds data: from the very start to the very end."""
    low: Floats
    high: Floats
    """(k,) least and greatest value in the column."""
    band_low: Floats
    band_high: Floats
    """(k,) outermost edges of the 95 % band in the column, NaN where there is none."""


def reduce_course(course: Course, name: str, columns: int, scale: float = 1.0) -> Curve | None:
    """Min-max decimation of one parameter to plot columns, or None where it has no values."""
    if name not in course.value or columns < 1:
        return None
    value = scale * course.value[name]
    half = scale * fmt.Z95 * course.std.get(name, np.full_like(value, np.nan))
    known = np.isfinite(value)
    t, value, half = course.t[known], value[known], half[known]
    if t.size == 0:
        return None
    half[~np.isfinite(half)] = np.nan
    width = max(float(t[-1] - t[0]), 1e-9) / max(1, columns - 1)
    column = np.rint((t - t[0]) / width).astype(np.int64)
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    return Curve(
        t=t[0] + column[starts] * width,
        low=np.minimum.reduceat(value, starts),
        high=np.maximum.reduceat(value, starts),
        band_low=np.fmin.reduceat(value - half, starts),
        band_high=np.fmax.reduceat(value + half, starts),
    )


def value_range(curve: Curve, truth: float | None) -> tuple[float, float]:
    """The range worth looking at: all of the later half, the truth, and a margin.

    The start of a course is far off and its band is wider than the picture; letting it set the
    scale would flatten what matters.
    """
    late = curve.t >= curve.t[0] + 0.5 * (curve.t[-1] - curve.t[0])
    low, high = float(np.min(curve.low[late])), float(np.max(curve.high[late]))
    edges = np.concatenate([curve.band_low[late], curve.band_high[late]])
    edges = edges[np.isfinite(edges)]
    if edges.size:
        # A band far wider than the value (nothing known yet) must not hide the value's course.
        reach = 3.0 * max(abs(low), abs(high), high - low)
        low = min(low, max(float(edges.min()), low - reach))
        high = max(high, min(float(edges.max()), high + reach))
    if truth is not None:
        low, high = min(low, truth), max(high, truth)
    margin = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    return low - margin, high + margin


def band_points(
    curve: Curve, low: float, high: float, rows: int
) -> tuple[list[float], list[float]]:
    """One point for every character cell that the band covers."""
    cell = (high - low) / max(1, rows - 1)
    centres = low + cell * np.arange(rows)
    inside = (centres[None, :] >= curve.band_low[:, None] - 0.5 * cell) & (
        centres[None, :] <= curve.band_high[:, None] + 0.5 * cell
    )
    column, row = np.nonzero(inside)
    return curve.t[column].tolist(), centres[row].tolist()


class Convergence(PlotextPlot):
    """Plot of the chosen parameter: value, band, and the truth where it is known."""

    BORDER_TITLE = "Convergence"

    def __init__(self) -> None:
        super().__init__(id="convergence")
        self.view: View | None = None
        self._drawn_at = -math.inf
        self._waiting = False

    def show(self, view: View) -> None:
        """Bring the plot up to date."""
        old, self.view = self.view, view
        if old is None or (old.selected, old.exponents) != (view.selected, view.exponents):
            self.refresh()
        elif (old.snapshot and old.snapshot.course) is not (view.snapshot and view.snapshot.course):
            self._refresh_later()

    def _refresh_later(self) -> None:
        """Redraw when the last drawing is old enough; several requests make one drawing."""
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

    def headline(self) -> str:
        """The parameter's name and present value, as the plot's title writes it."""
        found = None if self.view is None else self.view.estimate(self.view.selected)
        if self.view is None or found is None:
            return ""
        parameter, estimate = found
        exponent = self.view.exponents.get(fmt.exponent_key(parameter), 0)
        value, half = (text.strip() for text in fmt.value_and_half(estimate, exponent))
        sign = "" if estimate.status == "given" else "± "
        unit = fmt.scaled_unit(parameter.unit, exponent)
        return f"{fmt.label(parameter.name)} = {value} {sign}{half} {unit}".rstrip()

    def render(self) -> RenderResult:
        """Draw for the present size and theme."""
        width, height = self.size.width, self.size.height
        view = self.view
        self._drawn_at = time.monotonic()
        if view is None or view.snapshot is None or width < MIN_WIDTH or height < MIN_HEIGHT:
            return Text("")
        found = view.estimate(view.selected)
        course, truth = view.snapshot.course, view.truth.get(view.selected)
        scale = 1.0 if found is None else 10.0 ** -view.exponents.get(fmt.exponent_key(found[0]), 0)
        whole = reduce_course(course, view.selected, width, scale)
        if whole is None:
            return Text(f"{fmt.label(view.selected)}: no course to plot yet")
        truth = None if truth is None else scale * truth
        low, high = value_range(whole, truth)
        # Title, frame, tick labels and legend take five rows; the frame takes two columns and the
        # labels of the value axis some more. With the exact number of columns that is left, band
        # and value fall into every column once.
        rows = height - 5
        ticks = nice_ticks(low, high, rows // 3)
        columns = width - 2 - max(map(len, ticks[1]), default=0)
        curve = reduce_course(course, view.selected, columns, scale) or whole
        self.plt.clear_data()
        self.plt.clear_figure()
        self.plt.title(self.headline())
        self.plt.ylim(low, high)
        self.plt.yticks(*ticks)
        self._draw(curve, truth, band_points(curve, low, high, rows), columns)
        return super().render()

    def _draw(
        self,
        curve: Curve,
        truth: float | None,
        band: tuple[list[float], list[float]],
        columns: int,
    ) -> None:
        """Band, truth and value, each over the one before."""
        plt, colours = self.plt, self._colours()
        start, end = float(curve.t[0]), max(float(curve.t[-1]), float(curve.t[0]) + 1e-3)
        plt.xlim(start, end)
        plt.xticks(*nice_ticks(start, end, columns // 12))
        if band[0]:
            plt.scatter(*band, marker="░", color=colours["band"])
        if truth is not None:
            plt.plot([start, end], [truth, truth], marker="─", color=colours["truth"])
        plt.plot(
            np.repeat(curve.t, 2).tolist(),
            np.column_stack([curve.low, curve.high]).ravel().tolist(),
            marker="braille",
            color=colours["value"],
        )
        legend = "░ 95 % band   ⠒ value" + ("" if truth is None else "   ─ truth")
        plt.xlabel(f"s     {legend}")

    def _colours(self) -> dict[str, tuple[int, int, int]]:
        variables = self.app.theme_variables
        surface = Color.parse(variables["surface"])
        primary = Color.parse(variables["primary"])
        return {
            "value": Color.parse(variables["foreground"]).rgb,
            "band": surface.blend(primary, 0.55).rgb,
            "truth": Color.parse(variables["text-warning"]).rgb,
        }
