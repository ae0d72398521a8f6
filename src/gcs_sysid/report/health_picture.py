"""The health of a vehicle as one page: seen from above, with shares, CG and what to move."""

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gcs_sysid.health.health_trend import Series
from gcs_sysid.intervals import Z95
from gcs_sysid.report.health_trend_picture import height_of, trend_panels
from gcs_sysid.report.parts import Markup, element, joined, note, section
from gcs_sysid.results.number_format import PAGE

_WIDTH, _HEIGHT = 900.0, 632.0
_CENTER = (250.0, 312.0)
_REACH = 165.0
"""Of the outermost rotor from the center, on the page."""
_MOST_DISC = 62.0
_TEXT_X, _TEXT_TOP, _LINE = 520.0, 92.0, 23.0
_ADVICE_COLUMNS = 100
_LEAST_ARROW = 6.0
_INK, _PALE, _BLUE, _RED = "#222222", "#b8b8b8", "#1f6fb4", "#c2571a"


def health_picture(document: Mapping[str, Any], series: Sequence[Series] = ()) -> str:
    """The page as SVG; complete, nothing is loaded.

    Args:
        document: a health file's content, in which something hovers.
        series: numbers over several flights, drawn below it.
    """
    rotors = document["airframe"]["rotors"]
    reach = max(max(abs(r["x"]), abs(r["y"])) for r in rotors)
    scale = _REACH / reach
    name = str(document["source"]).replace("\\", "/").rpartition("/")[2]
    parts = [
        element("rect", width="100%", height="100%", fill="#ffffff"),
        _text(40.0, 44.0, f"Health of {name}", size=21),
        _text(
            40.0,
            68.0,
            f"{document['seconds_of_hover']:.0f} s of hover; seen from above, nose up",
            fill="#666666",
        ),
        *_vehicle(document, rotors, scale),
        *_cg(document, scale),
        *_facts(document),
        *_advice(document),
    ]
    height = _HEIGHT
    if series:
        parts.append(_text(40.0, height + 16.0, "Over the flights, in their order", size=17))
        parts += trend_panels(series, height + 34.0)
        height += 44.0 + height_of(series)
    picture = element(
        "svg",
        element("title", f"Health of {name}"),
        joined(*parts),
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {_WIDTH:g} {height:g}",
        role="img",
        font_family="sans-serif",
        font_size=14,
        fill=_INK,
    )
    return f"{picture}\n"


def health_section(document: Mapping[str, Any]) -> Markup:
    """The health of the vehicle as a section of a report.

    Args:
        document: a health file's content; where its verdict is "refused", the reasons are all.
    """
    if document["verdict"] == "refused":
        return section("health", "Health", element("p", "; ".join(document["reasons"])))
    picture = Markup(health_picture(document).strip())
    assumed = "; ".join(document["assumptions"])
    return section(
        "health",
        "Health",
        element("div", picture, class_="health"),
        note(f"Averages over hover, apart from the identification. Assumed: {assumed}."),
    )


def _text(
    x: float, y: float, words: str, *, size: int = 14, fill: str = _INK, anchor: str = "start"
) -> Markup:
    return element(
        "text", words, x=round(x, 1), y=round(y, 1), font_size=size, fill=fill, text_anchor=anchor
    )


def _at(forward: float, right: float, scale: float) -> tuple[float, float]:
    return _CENTER[0] + scale * right, _CENTER[1] - scale * forward


def _vehicle(
    document: Mapping[str, Any], rotors: list[Mapping[str, Any]], scale: float
) -> Iterator[Markup]:
    places = [_at(r["x"], r["y"], scale) for r in rotors]
    apart = min(math.dist(a, b) for i, a in enumerate(places) for b in places[:i])
    disc = min(_MOST_DISC, 0.47 * apart) if apart > 1.0 else 0.5 * _MOST_DISC
    shares = [r["thrust_share"]["value"] for r in document["rotors"]]
    named = (document.get("condition") or {}).get("rotor")
    x, y = _CENTER
    yield element("path", d=f"M{x:g} {y - _REACH - 72:g} l9 16 h-18 z", fill=_INK)
    for u, v in places:
        yield element(
            "line", x1=x, y1=y, x2=round(u, 1), y2=round(v, 1), stroke=_PALE, stroke_width=6
        )
    for i, ((u, v), share) in enumerate(zip(places, shares, strict=True)):
        # The disc filled like a cup: full is twice an even share.
        filled = min(0.5 * share * len(shares), 1.0)
        yield element(
            "circle",
            cx=round(u, 1),
            cy=round(v, 1),
            r=round(disc, 1),
            fill="#ffffff",
            stroke=_RED if i == named else _INK,
            stroke_width=3 if i == named else 1.5,
        )
        yield element(
            "circle",
            cx=round(u, 1),
            cy=round(v, 1),
            r=round(disc * math.sqrt(filled), 1),
            fill=_BLUE,
            fill_opacity=0.3,
        )
        way = "ccw" if rotors[i]["spin"] == "ccw" else "cw"
        yield _text(u, v - 4.0, f"{i + 1} {way}", size=13, anchor="middle")
        yield _text(u, v + 16.0, f"{100.0 * share:.1f} %", size=17, anchor="middle")


def _cg(document: Mapping[str, Any], scale: float) -> Iterator[Markup]:
    along, across = (document["cg"][axis] for axis in "xy")
    u, v = _at(along["value"], across["value"], scale)
    yield element(
        "ellipse",
        cx=round(u, 1),
        cy=round(v, 1),
        rx=round(max(scale * Z95 * across["std"], 1.0), 1),
        ry=round(max(scale * Z95 * along["std"], 1.0), 1),
        fill=_RED,
        fill_opacity=0.15,
        stroke=_RED,
        stroke_dasharray="3 3",
    )
    yield element(
        "circle", cx=round(u, 1), cy=round(v, 1), r=7, fill="#ffffff", stroke=_RED, stroke_width=2
    )
    yield element(
        "path", d=f"M{u - 11:.1f} {v:.1f}h22M{u:.1f} {v - 11:.1f}v22", stroke=_RED, stroke_width=2
    )
    dx, dy = _CENTER[0] - u, _CENTER[1] - v
    length = math.hypot(dx, dy)
    if length > _LEAST_ARROW:
        # Longer than the offset, which is small: the way that the load should go.
        stretch = max(70.0, length) / length
        a, b = u + stretch * dx, v + stretch * dy
        angle = math.atan2(dy, dx)
        head = " ".join(
            f"L{a - 13.0 * math.cos(angle + turn):.1f} {b - 13.0 * math.sin(angle + turn):.1f}"
            f"M{a:.1f} {b:.1f}"
            for turn in (0.4, -0.4)
        )
        yield element(
            "path",
            d=f"M{u:.1f} {v:.1f}L{a:.1f} {b:.1f}{head}",
            stroke=_BLUE,
            stroke_width=3,
            fill="none",
        )


def _facts(document: Mapping[str, Any]) -> Iterator[Markup]:
    lines = []
    for axis, positive, negative in (("x", "forward", "aft"), ("y", "right", "left")):
        place = document["cg"][axis]
        way = positive if place["value"] >= 0.0 else negative
        size = PAGE.measure(1e3 * abs(place["value"]), 1e3 * Z95 * place["std"], "mm")
        lines.append(("center of gravity" if axis == "x" else "", f"{size} {way}"))
    for key, name, factor, unit in (
        ("yaw_imbalance", "yaw imbalance", 100.0, "%"),
        ("hover_throttle", "hover throttle", 100.0, "%"),
        ("thrust_to_weight", "full thrust", 1.0, "× weight"),
        ("k_T", "k_T", 1.0, "N s²"),
        ("T_max", "T_max", 1.0, "N"),
        ("thrust_curve", "thrust curve", 1.0, ""),
        ("drift_per_minute", "thrust drift", 100.0, "% a minute"),
    ):
        entry = document.get(key)
        if entry is None or entry["value"] is None:
            continue
        half = factor * Z95 * (entry["std"] or 0.0)
        if half:
            value, around, power, _ = PAGE.value_and_half(factor * entry["value"], half)
            text = f"({value} ± {around}){power} {unit}" if power else f"{value} ± {around} {unit}"
        else:
            text = f"{PAGE.number(factor * entry['value'])} {unit}"
        lines.append((name, text))
    for i, (name, text) in enumerate(lines):
        y = _TEXT_TOP + 20.0 + _LINE * i
        yield _text(_TEXT_X, y, name, fill="#666666")
        yield _text(_TEXT_X + 140.0, y, text)


def _advice(document: Mapping[str, Any]) -> Iterator[Markup]:
    y = _HEIGHT - 88.0
    lines = [
        (line, first == 0)
        for text in document["advice"]
        for first, line in enumerate(textwrap.wrap(text, _ADVICE_COLUMNS))
    ]
    for line, begins in lines[:4]:
        yield _text(40.0, y, f"{'→ ' if begins else '   '}{line}")
        y += _LINE
