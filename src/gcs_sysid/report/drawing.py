"""What several pictures draw as SVG: the vehicle from above, and numbers over flights.

Colors are attributes, for pictures that are files of their own; on a page the rules of its style
sheet, by class, come before them.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from gcs_sysid.health.health_trend import Series
from gcs_sysid.report.parts import Markup, element
from gcs_sysid.results.history import with_margin
from gcs_sysid.results.words import PAGE, power_of_ten, round_numbers, times_power
from gcs_sysid.significance import Z95

INK, SOFT, PALE, BLUE, RED = "#222222", "#666666", "#b8b8b8", "#1f6fb4", "#c2571a"


def text(
    x: float, y: float, words: str, *, size: float = 14, fill: str = INK, anchor: str = "start"
) -> Markup:
    """A line of text."""
    return element(
        "text", words, x=_at(x), y=_at(y), font_size=f"{size:g}", fill=fill, text_anchor=anchor
    )


def picture(
    size: tuple[float, float], title: str, parts: Iterable[Markup], *, letters: int = 14
) -> str:
    """A picture that is a file of its own; complete, nothing is loaded."""
    svg = element(
        "svg",
        element("title", title),
        element("rect", width="100%", height="100%", fill="#ffffff"),
        *parts,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {size[0]:g} {size[1]:g}",
        role="img",
        font_family="sans-serif",
        font_size=letters,
        fill=INK,
    )
    return f"{svg}\n"


def polyline(points: Iterable[tuple[float, float]], stroke: str, width: float) -> Markup:
    """Straight lines from point to point."""
    return element(
        "polyline", points=_places(points), fill="none", stroke=stroke, stroke_width=width
    )


def area(outline: Iterable[tuple[float, float]], fill: str) -> Markup:
    """A pale area within an outline."""
    return element("polygon", points=_places(outline), fill=fill, fill_opacity="0.2")


def _places(points: Iterable[tuple[float, float]]) -> str:
    return " ".join(f"{_at(x)},{_at(y)}" for x, y in points)


def line(x1: float, y1: float, x2: float, y2: float, kind: str, **style: str | float) -> Markup:
    """A straight line of a class."""
    return element("line", x1=_at(x1), y1=_at(y1), x2=_at(x2), y2=_at(y2), class_=kind, **style)


def _at(value: float) -> str:
    return f"{value:.1f}"


@dataclass(frozen=True)
class PlanView:
    """A vehicle from above, nose up.

    Attributes:
        rotors: m forward and right of the geometric center, of each rotor.
        center: of the vehicle on the picture.
        reach: on the picture, from the center to the outermost rotor along an axis.
        most: radius of a rotor's disc.
    """

    rotors: Sequence[tuple[float, float]]
    center: tuple[float, float]
    reach: float
    most: float

    @property
    def scale(self) -> float:
        """Picture's units a meter."""
        return self.reach / max(max(abs(x), abs(y)) for x, y in self.rotors)

    @property
    def radius(self) -> float:
        """Of the discs: they do not touch, unless rotors lie above each other."""
        places = self.places
        apart = min((math.dist(a, b) for i, a in enumerate(places) for b in places[:i]), default=0)
        return min(self.most, 0.47 * apart) if apart > 1.0 else 0.5 * self.most

    @property
    def places(self) -> list[tuple[float, float]]:
        """The rotors on the picture."""
        return [self.at(x, y) for x, y in self.rotors]

    def at(self, forward: float, right: float) -> tuple[float, float]:
        """A place on the picture."""
        return self.center[0] + self.scale * right, self.center[1] - self.scale * forward

    def frame(self, width: float) -> list[Markup]:
        """The arms, and an arrow head at the nose."""
        (x, y), top = self.center, self.center[1] - self.reach - 0.6 * self.most
        arms = [line(x, y, u, v, "arm", stroke=PALE, stroke_width=width) for u, v in self.places]
        nose = f"M{x:g} {top - 12.0:.1f} l7 12 h-14 z"
        return [*arms, element("path", d=nose, class_="front", fill=INK)]

    def cg(
        self, place: tuple[float, float], halves: tuple[float, float], size: float
    ) -> list[Markup]:
        """The center of gravity with its 95 % region.

        `place` is m forward and right, `halves` m of the interval along each; `size` is the cross'
        from the middle to an end.
        """
        u, v = self.at(*place)
        return [
            element(
                "ellipse",
                cx=_at(u),
                cy=_at(v),
                rx=_at(max(self.scale * halves[1], 0.1)),
                ry=_at(max(self.scale * halves[0], 0.1)),
                class_="doubt",
                fill=RED,
                fill_opacity=0.15,
                stroke=RED,
                stroke_dasharray="3 3",
            ),
            line(u - size, v, u + size, v, "cg", stroke=RED, stroke_width=2),
            line(u, v - size, u, v + size, "cg", stroke=RED, stroke_width=2),
            element(
                "circle", cx=_at(u), cy=_at(v), r=_at(0.6 * size), class_="cg", fill="none",
                stroke=RED, stroke_width=2,
            ),
        ]  # fmt: skip


@dataclass(frozen=True)
class IntervalPoint:
    """A number of one flight.

    Attributes:
        flight: from 1 on.
        value: drawn as a dot.
        low: where its 95 % interval begins.
        high: where that ends.
        words: said of it under the pointer.
        kind: more classes.
    """

    flight: int
    value: float
    low: float
    high: float
    words: str = ""
    kind: str = ""


@dataclass(frozen=True)
class FlightsChart:
    """A number over flights with its 95 % intervals.

    Attributes:
        title: above it, before the unit.
        unit: of the numbers, as the page writes it.
        flights: how many there are.
        span: least and greatest number that the picture holds, without its margin.
        width: of the picture.
        height: of the picture.
    """

    title: str
    unit: str
    flights: int
    span: tuple[float, float]
    width: float
    height: float

    _left, _top, _right, _bottom = 56.0, 18.0, 10.0, 28.0

    def x(self, flight: float) -> float:
        """Place of a flight."""
        wide = self.width - self._left - self._right
        return self._left + wide * (flight - 0.5) / self.flights

    def y(self, value: float) -> float:
        """Place of a number; one far outside lies at the edge."""
        low, high = self._range
        share = min(max((value - low) / (high - low), -0.02), 1.02)
        bottom = self.height - self._bottom
        return bottom - (bottom - self._top) * share

    @property
    def _range(self) -> tuple[float, float]:
        return with_margin(*self.span)

    def axes(self) -> list[Markup]:
        """Title and unit, lines at round numbers, flights below."""
        low, high = self._range
        power = power_of_ten(max(abs(low), abs(high)))
        unit = " ".join(filter(None, [times_power(power).strip(), self.unit]))
        right, bottom = self.width - self._right, self.height - self._bottom
        title = ", ".join(filter(None, [self.title, unit]))
        parts = [text(0.0 if self.title else self._left, 11.0, title, size=12)]
        values, decimals = round_numbers(
            low / 10.0**power, high / 10.0**power, (bottom - self._top) / 26.0
        )
        for value in values:
            at = self.y(value * 10.0**power)
            number = PAGE.fixed(value, decimals)
            parts += [
                line(self._left, at, right, at, "gridline", stroke=PALE),
                text(self._left - 6.0, at + 4.0, number, size=12, anchor="end"),
            ]
        for n in range(1, self.flights + 1, max(1, math.ceil(self.flights / 8))):
            parts.append(text(self.x(n), self.height - 10.0, str(n), size=12, anchor="middle"))
        return [*parts, line(self._left, bottom, right, bottom, "axis", stroke=PALE)]

    def cut(self, flight: int) -> Markup:
        """A line before a flight."""
        at = self.x(flight - 0.5)
        return line(at, self._top, at, self.height - self._bottom, "cut")

    def points(self, points: Iterable[IntervalPoint]) -> list[Markup]:
        """Dots with their intervals."""
        out = []
        for point in points:
            at = self.x(point.flight)
            low, high = self.y(point.low), self.y(point.high)
            dot = element("circle", cx=_at(at), cy=_at(self.y(point.value)), r="3.5", fill=BLUE)
            whisker = line(at, low, at, high, "whisker", stroke=BLUE, stroke_width=2)
            title = element("title", point.words) if point.words else None
            out.append(element("g", title, whisker, dot, class_=f"estimate {point.kind}".strip()))
        return out


def chart_of(series: Series, title: str, width: float, height: float) -> list[Markup]:
    """A number over flights with its 95 % intervals, each by the flight's own scatter."""
    unit = PAGE.unit(series.unit)
    points = [
        IntervalPoint(
            number, value, value - Z95 * std, value + Z95 * std,
            f"flight {number}: {PAGE.measure(value, Z95 * std, unit)}", "identified",
        )
        for number, (value, std) in enumerate(zip(series.values, series.stds, strict=True), 1)
        if math.isfinite(value) and math.isfinite(std)
    ]  # fmt: skip
    span = min(point.low for point in points), max(point.high for point in points)
    chart = FlightsChart(title, unit, len(series.values), span, width, height)
    return [*chart.axes(), *chart.points(points)]
