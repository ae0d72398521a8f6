"""The health of a vehicle as one page: seen from above, with shares, CG and what to move."""

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gcs_sysid.health.health_trend import Series
from gcs_sysid.report.drawing import (
    BLUE,
    INK,
    RED,
    SOFT,
    FlightsChart,
    IntervalPoint,
    PlanView,
    picture,
    text,
)
from gcs_sysid.report.parts import Markup, element, note, section
from gcs_sysid.results.health_view import cg_facts, half_of, health_facts
from gcs_sysid.results.result_view import number_figures
from gcs_sysid.results.words import PAGE
from gcs_sysid.significance import Z95

_WIDTH, _HEIGHT = 900.0, 632.0


def health_picture(document: Mapping[str, Any], series: Sequence[Series] = ()) -> str:
    """The page as SVG; complete, nothing is loaded.

    Args:
        document: a health file's content, in which something hovers.
        series: numbers over several flights, drawn below it.
    """
    rotors = [(r["x"], r["y"]) for r in document["airframe"]["rotors"]]
    view = PlanView(rotors, (250.0, 304.0), 162.0, 60.0)
    name = str(document["source"]).replace("\\", "/").rpartition("/")[2]
    about = f"{document['seconds_of_hover']:.0f} s of hover; seen from above, nose up"
    parts = [
        text(40.0, 44.0, f"Health of {name}", size=21),
        text(40.0, 68.0, about, fill=SOFT),
        *_vehicle(document, view),
        *_cg(document, view),
        *_facts(document),
        *_advice(document),
    ]
    height = _HEIGHT
    if series:
        parts.append(text(40.0, height + 16.0, "Over the flights, in their order", size=17))
        parts += _trends(series, height + 34.0)
        height += 44.0 + 150.0 * math.ceil(len(series) / 3)
    return picture((_WIDTH, height), f"Health of {name}", parts)


def health_section(document: Mapping[str, Any]) -> Markup:
    """The health of the vehicle as a section of a report.

    Args:
        document: a health file's content; where its verdict is "refused", the reasons are all.
    """
    if document["verdict"] == "refused":
        return section("health", "Health", element("p", "; ".join(document["reasons"])))
    drawn = Markup(health_picture(document).strip())
    assumed = "; ".join(document["assumptions"])
    return section(
        "health",
        "Health",
        element("div", drawn, class_="health"),
        note(f"Averages over hover, apart from the identification. Assumed: {assumed}."),
    )


def _vehicle(document: Mapping[str, Any], view: PlanView) -> Iterator[Markup]:
    yield from view.frame(6.0)
    spins = [r["spin"] for r in document["airframe"]["rotors"]]
    shares = [r["thrust_share"]["value"] for r in document["rotors"]]
    named = (document.get("condition") or {}).get("rotor")
    for i, ((u, v), share) in enumerate(zip(view.places, shares, strict=True)):
        # The disc filled like a cup: full is twice an even share.
        filled = min(0.5 * share * len(shares), 1.0)
        stroke, width = (RED, 3) if i == named else (INK, 1.5)
        place = {"cx": round(u, 1), "cy": round(v, 1)}
        yield element(
            "circle", **place, r=round(view.radius, 1), fill="#ffffff", stroke=stroke,
            stroke_width=width,
        )  # fmt: skip
        inner = round(view.radius * math.sqrt(filled), 1)
        yield element("circle", **place, r=inner, fill=BLUE, fill_opacity=0.3)
        yield text(u, v - 4.0, f"{i + 1} {spins[i]}", size=13, anchor="middle")
        yield text(u, v + 16.0, f"{100.0 * share:.1f} %", size=17, anchor="middle")


def _cg(document: Mapping[str, Any], view: PlanView) -> Iterator[Markup]:
    along, across = (document["cg"][axis] for axis in "xy")
    place = along["value"], across["value"]
    yield from view.cg(place, (Z95 * along["std"], Z95 * across["std"]), 11.0)
    u, v = view.at(*place)
    dx, dy = view.center[0] - u, view.center[1] - v
    length = math.hypot(dx, dy)
    if length > 6.0:
        # Longer than the offset, which is small: the way that the load should go.
        stretch = max(70.0, length) / length
        a, b = u + stretch * dx, v + stretch * dy
        angle = math.atan2(dy, dx)
        head = " ".join(
            f"L{a - 13.0 * math.cos(angle + turn):.1f} {b - 13.0 * math.sin(angle + turn):.1f}"
            f"M{a:.1f} {b:.1f}"
            for turn in (0.4, -0.4)
        )
        arrow = f"M{u:.1f} {v:.1f}L{a:.1f} {b:.1f}{head}"
        yield element("path", d=arrow, stroke=BLUE, stroke_width=3, fill="none")


def _facts(document: Mapping[str, Any]) -> Iterator[Markup]:
    lines = [
        ("" if i else "center of gravity", f"{size} {way}")
        for i, (_, size, way, _) in enumerate(cg_facts(document, PAGE))
    ]
    lines += health_facts(document, PAGE)
    for key in ("k_T", "T_max", "thrust_curve"):
        entry = document.get(key)
        if entry is not None and entry["value"] is not None:
            shown = number_figures(entry["value"], half_of(entry), entry["unit"], PAGE)
            lines.append((key.replace("_c", " c"), shown.measure))
    for i, (name, words) in enumerate(lines):
        y = 112.0 + 23.0 * i
        yield text(520.0, y, name, fill=SOFT)
        yield text(660.0, y, words)


def _advice(document: Mapping[str, Any]) -> Iterator[Markup]:
    lines = [
        f"{'   ' if later else '→ '}{part}"
        for advice in document["advice"]
        for later, part in enumerate(textwrap.wrap(advice, 100))
    ]
    for i, part in enumerate(lines[:4]):
        yield text(40.0, _HEIGHT - 88.0 + 23.0 * i, part)


def _trends(series: Sequence[Series], top: float) -> Iterator[Markup]:
    """A chart each, in rows of three."""
    for i, one in enumerate(series):
        points = [
            IntervalPoint(n, value, value - Z95 * std, value + Z95 * std)
            for n, (value, std) in enumerate(zip(one.values, one.stds, strict=True), 1)
            if math.isfinite(value)
        ]
        span = min(p.low for p in points), max(p.high for p in points)
        unit = PAGE.unit(one.unit)
        chart = FlightsChart(one.name, unit, len(one.values), span, 266.0, 140.0)
        place = f"translate({40.0 + 280.0 * (i % 3):g} {top + 150.0 * (i // 3):g})"
        yield element("g", *chart.axes(), *chart.points(points), transform=place)
