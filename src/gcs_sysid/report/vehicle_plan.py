"""The vehicle from above, with its rotors and its center of gravity."""

from typing import Any

import numpy as np

from gcs_sysid.report.data import ReportData
from gcs_sysid.report.markup import Markup, element
from gcs_sysid.report.wording import half_of
from gcs_sysid.results.number_format import PAGE

_SIZE = 300.0
_MARGIN = 46.0


def plan_view(data: ReportData) -> Markup | None:
    """Rotors in the autopilot's order and the CG; None where the CG is not known at all."""
    cg = [data.result["parameters"].get(name) for name in ("cg_x", "cg_y")]
    if any(e is None or e["value"] is None or e["status"] == "unobservable" for e in cg):
        return None
    x, y, spin = data.geometry
    reach = float(max(np.abs(x).max(), np.abs(y).max()))
    scale = (0.5 * _SIZE - _MARGIN) / reach
    disc = 0.62 * min(
        (0.5 * np.hypot(x[i] - x[j], y[i] - y[j]) for i in range(len(x)) for j in range(i)),
        default=reach,
    )
    radius = float(min(disc * scale, _MARGIN - 6.0))

    def at(forward: float, right: float) -> tuple[float, float]:
        return round(0.5 * _SIZE + scale * right, 2), round(0.5 * _SIZE - scale * forward, 2)

    parts: list[Markup] = [_line(*at(0.0, 0.0), *at(float(a), float(b)), "arm")
                           for a, b in zip(x, y, strict=True)]  # fmt: skip
    parts.append(element("circle", cx=0.5 * _SIZE, cy=0.5 * _SIZE, r=3, class_="hub"))
    for i, (a, b, s) in enumerate(zip(x.tolist(), y.tolist(), spin.tolist(), strict=True), 1):
        u, v = at(a, b)
        parts.append(element("circle", cx=u, cy=v, r=round(radius, 2), class_="rotor"))
        parts.append(_turn(u, v, 0.68 * radius, s))
        parts.append(element("text", str(i), x=u, y=v + 4.5, class_="motor"))
    front = _SIZE / 2
    parts.append(element("path", d=f"M{front} 6 l7 12 h-14 z", class_="front"))
    u, v = at(float(cg[0]["value"]), float(cg[1]["value"]))
    halves = [half_of(e) or 0.0 for e in cg]
    parts.append(
        element(
            "ellipse",
            cx=u,
            cy=v,
            rx=round(max(scale * halves[1], 0.1), 2),
            ry=round(max(scale * halves[0], 0.1), 2),
            class_="doubt",
        )
    )
    parts.append(_line(u - 9, v, u + 9, v, "cg"))
    parts.append(_line(u, v - 9, u, v + 9, "cg"))
    parts.append(element("circle", cx=u, cy=v, r=5, class_="cg"))
    text = cg_text(cg)
    picture = element(
        "svg",
        element("title", f"Plan view. {text}"),
        *parts,
        viewBox=f"0 0 {_SIZE:g} {_SIZE:g}",
        role="img",
        class_="plan",
    )
    return element(
        "figure",
        picture,
        element(
            "figcaption",
            f"Seen from above, nose up. {text} Arrows: direction of rotation.",
        ),
        class_="vehicle",
    )


def cg_text(cg: list[Any]) -> str:
    """Where the center of gravity is, in words."""
    forward, right = (1e3 * float(e["value"]) for e in cg)
    along = f"{PAGE.fixed(abs(forward), 1)} mm {'ahead' if forward >= 0.0 else 'behind'}"
    across = f"{PAGE.fixed(abs(right), 1)} mm {'right' if right >= 0.0 else 'left'}"
    return f"The center of gravity (⊕) is {along} and {across} of the geometric center."


def _line(x1: float, y1: float, x2: float, y2: float, kind: str) -> Markup:
    return element("line", x1=x1, y1=y1, x2=x2, y2=y2, class_=kind)


def _turn(u: float, v: float, r: float, spin: float) -> Markup:
    """A three-quarter arc with an arrow head, counter-clockwise for positive spin."""
    way = -1.0 if spin > 0.0 else 1.0
    angles = np.radians([-90.0 - way * 130.0, -90.0 + way * 130.0])
    (x0, x1), (y0, y1) = u + r * np.cos(angles), v + r * np.sin(angles)
    along = angles[1] + way * 0.5 * np.pi
    head = []
    for turn in (2.55, -2.55):
        head.append((x1 + 6.0 * np.cos(along + turn), y1 + 6.0 * np.sin(along + turn)))
    (a, b), (c, d) = head
    sweep = 1 if way > 0.0 else 0
    path = f"M{x0:.1f} {y0:.1f}A{r:.1f} {r:.1f} 0 1 {sweep} {x1:.1f} {y1:.1f}"
    path += f"M{a:.1f} {b:.1f}L{x1:.1f} {y1:.1f}L{c:.1f} {d:.1f}"
    return element("path", d=path, class_="turn")
