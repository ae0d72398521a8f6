"""CG, shares, throttle and thrust coefficient over flights, as small panels of one picture."""

import math
from collections.abc import Sequence

from gcs_sysid.health.health_trend import Series
from gcs_sysid.intervals import Z95
from gcs_sysid.report.parts import Markup, element
from gcs_sysid.results.number_format import PAGE, power_of_ten, times_power

_COLUMNS = 3
_LEFT, _WIDTH, _HEIGHT = 40.0, 280.0, 150.0
_PLOT_LEFT, _PLOT_TOP, _PLOT_RIGHT, _PLOT_BOTTOM = 52.0, 26.0, 266.0, 122.0
_INK, _PALE, _BLUE = "#222222", "#d8d8d8", "#1f6fb4"


def height_of(series: Sequence[Series]) -> float:
    """Of the panels together, in units of the picture."""
    return _HEIGHT * math.ceil(len(series) / _COLUMNS)


def trend_panels(series: Sequence[Series], top: float) -> list[Markup]:
    """A panel each, in rows of three, with 95 % intervals.

    Args:
        series: numbers over flights, each from at least one flight.
        top: of the first row in the picture.
    """
    parts = []
    for i, one in enumerate(series):
        x = _LEFT + _WIDTH * (i % _COLUMNS)
        y = top + _HEIGHT * (i // _COLUMNS)
        parts.append(element("g", *_panel(one), transform=f"translate({x:g} {y:g})"))
    return parts


def _panel(series: Series) -> list[Markup]:
    known = [
        (n, v, Z95 * s)
        for n, (v, s) in enumerate(zip(series.values, series.stds, strict=True))
        if math.isfinite(v)
    ]
    low, high = min(v - h for _, v, h in known), max(v + h for _, v, h in known)
    spare = 0.08 * (high - low) or 0.01 * abs(high) or 1.0
    low, high = low - spare, high + spare
    count = len(series.values)

    def x(number: float) -> float:
        return round(_PLOT_LEFT + (_PLOT_RIGHT - _PLOT_LEFT) * (number + 0.5) / count, 1)

    def y(value: float) -> float:
        share = (value - low) / (high - low)
        return round(_PLOT_BOTTOM - (_PLOT_BOTTOM - _PLOT_TOP) * share, 1)

    power = power_of_ten(max(abs(low), abs(high)))
    unit = " ".join(filter(None, [times_power(power).strip(), PAGE.unit(series.unit)]))
    parts = [_text(f"{series.name}, {unit}", 0.0, 14.0, "start")]
    digits = max(0, 1 - math.floor(math.log10((high - low) / 10.0**power)))
    for value in (low + spare, high - spare) if high - low > 2.0 * spare else (low + spare,):
        parts += [
            element("line", x1=_PLOT_LEFT, x2=_PLOT_RIGHT, y1=y(value), y2=y(value), stroke=_PALE),
            _text(PAGE.fixed(value / 10.0**power, digits), _PLOT_LEFT - 6.0, y(value) + 4.0, "end"),
        ]
    every = max(1, math.ceil(count / 8))
    parts += [
        _text(str(n + 1), x(n), _PLOT_BOTTOM + 18.0, "middle") for n in range(0, count, every)
    ]
    for n, value, half in known:
        parts += [
            element(
                "line", x1=x(n), x2=x(n), y1=y(value - half), y2=y(value + half), stroke=_BLUE,
                stroke_width=2,
            ),
            element("circle", cx=x(n), cy=y(value), r=3.5, fill=_BLUE),
        ]  # fmt: skip
    return parts


def _text(words: str, x: float, y: float, anchor: str) -> Markup:
    return element("text", words, x=x, y=y, font_size=12, fill=_INK, text_anchor=anchor)
