"""The page: head, sections, styles and script in one HTML text; and the picture of health.

That is the vehicle seen from above, with shares, CG and what to move: a section, or a file.
"""

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PureWindowsPath
from typing import Any

from gcs_sysid.health.health_trend import Series
from gcs_sysid.report import evidence_sections
from gcs_sysid.report import results_sections as findings
from gcs_sysid.report.data import ReportData
from gcs_sysid.report.drawing import BLUE, INK, RED, SOFT, PlanView, chart_of, picture, text
from gcs_sysid.report.page_figures import ChartData
from gcs_sysid.report.parts import (
    Child,
    Markup,
    asset,
    element,
    facts,
    html_page,
    note,
    numbers,
    section,
    table,
)
from gcs_sysid.results.health_view import cg_facts, first_answer, half_of, health_facts
from gcs_sysid.results.result_view import number_figures
from gcs_sysid.results.words import PAGE, VERDICT
from gcs_sysid.significance import Z95
from gcs_sysid.strict_json import json_text

_WIDTH, _HEIGHT = 900.0, 632.0


def health_picture(document: Mapping[str, Any], series: Sequence[Series] = ()) -> str:
    """The page as SVG; complete, nothing is loaded.

    Args:
        document: a health file's content, in which something hovers.
        series: numbers over several flights, drawn below it.
    """
    rotors = [(r["x"], r["y"]) for r in document["airframe"]["rotors"]]
    view = PlanView(rotors, (250.0, 304.0), 162.0, 60.0)
    name = PureWindowsPath(document["source"]).name  # of any system
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
        place = f"translate({40.0 + 280.0 * (i % 3):g} {top + 150.0 * (i // 3):g})"
        yield element("g", *chart_of(one, one.name, 266.0, 140.0), transform=place)


_KEYS = (
    "Drag across a figure to zoom, double click to see all again. With the keyboard: Tab to a "
    "figure, then + and − to zoom, ← and → to move, 0 to see all."
)


def render(data: ReportData) -> str:
    """The whole report as HTML text; the same data give the same text."""
    figures = ChartData()
    sections: dict[str, Child] = {
        "health": health_section(data.health) if data.health else None,
        "verdict": findings.verdict(data),
        "parameters": findings.parameters(data),
        "convergence": findings.convergence(data, figures),
        "prediction": evidence_sections.prediction(data, figures),
        "twin": evidence_sections.twin(data),
        "residual": evidence_sections.residual(data, figures),
        "excitation": evidence_sections.excitation(data, figures),
        "events": evidence_sections.events(data, figures),
        "telemetry": evidence_sections.telemetry(data),
        "settings": _settings(data),
    }
    name = PureWindowsPath(data.result.source).name
    contents = element(
        "nav",
        *(element("a", key.capitalize(), href=f"#{key}") for key in sections if sections[key]),
        aria_label="Contents",
    )
    answer = first_answer(data.health or None, data.result)
    return html_page(
        f"{name}: {VERDICT[data.result.verdict].meaning.lower()}",
        asset("charts.css") + asset("report.css"),
        element("header", _heading(data, name), contents),
        element(
            "main",
            element("p", element("strong", answer.line), class_="answer"),
            element("p", answer.action),
            sections.pop("health"),
            sections.pop("verdict"),
            element("p", _KEYS, id="keys", class_="note keys"),
            element("noscript", element("p", "Figures need scripts; tables do not.")),
            *sections.values(),
        ),
        element("footer", f"gcs-sysid {data.provenance.versions.get('gcs-sysid', '')}"),
        element("script", _json(figures), type="application/json", id="data"),
        script=asset("charts.js") + asset("report.js"),
    )


def _heading(data: ReportData, name: str) -> Markup:
    vehicle = data.result.vehicle
    about = [data.airframe.name]
    if vehicle:
        address = f"{vehicle['sysid']}:{vehicle['compid']}"
        systems = map(str, data.result.telemetry.get("systems", ()))
        named = next((name for name in systems if name.endswith(f" {address}")), None)
        about.insert(0, named or f"{vehicle['autopilot']} {address}")
    duration = data.inspection.get("duration")
    if duration:
        about.append(f"{PAGE.fixed(duration, 1)} s recorded")
    return element(
        "div",
        element("p", "Identification report", class_="kind"),
        element("h1", name),
        element("p", " · ".join(about), class_="about"),
        class_="heading",
    )


def _settings(data: ReportData) -> Markup:
    """What reproduces the report."""
    made, airframe, result = data.provenance, data.airframe, data.result
    scale = result.scale
    entries: dict[str, Child] = {
        "Command": element("code", _command_line(made.command)),
        "Recording": f"{PureWindowsPath(result.source).name}, {made.log_bytes} bytes",
        "SHA-256": element("code", made.log_sha256, class_="hash"),
        "Estimate": result.estimator,
        "Rotor input": result.rotor_input.words,
    }
    if scale is not None:
        entries["Scale"] = f"{scale.anchor} = {scale.value:.9g} {PAGE.unit(scale.unit)}"
    for name, prior in result.priors.items():
        entries[f"Prior on {name}"] = f"{prior['value']:.6g} ± {prior['std']:.3g}"
    entries["Airframe"] = f"{airframe.name}, {len(airframe.rotors)} rotors"
    if airframe.imu_position is not None:
        place = ", ".join(f"{PAGE.fixed(v, 4)} m" for v in airframe.imu_position)
        entries["IMU, forward, right, down"] = place
    if airframe.gyro_filter is not None:
        entries["Gyro filter given"] = f"{airframe.gyro_filter:g} Hz"
    entries |= dict(made.versions)
    rotors = [
        [
            str(i),
            f"{PAGE.fixed(r.x, 4)} m",
            f"{PAGE.fixed(r.y, 4)} m",
            "counter-clockwise" if r.spin > 0 else "clockwise",
        ]
        for i, r in enumerate(airframe.rotors, 1)
    ]
    columns = ["Motor", *numbers("Forward", "Right"), "Spin, seen from above"]
    return section(
        "settings",
        "Settings to reproduce this",
        facts(entries),
        table("Rotors of the airframe, from the geometric center", columns, rotors, layout="axes"),
    )


def _command_line(words: tuple[str, ...]) -> str:
    """The words as one types them; quoted where that is needed, in any shell's reading."""
    plain = set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_./:=+,@%\\±")
    return " ".join(
        word if word and set(word) <= plain else '"' + word.replace('"', '\\"') + '"'
        for word in words
    )


def _json(figures: ChartData) -> Markup:
    """The figures as JSON that cannot end the element that it is in."""
    text = json_text(figures.as_json(), separators=(",", ":"))
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(text)
