"""The sections on the findings: verdict, parameters, convergence; the vehicle from above."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from gcs_sysid.model.estimate import Estimate, Status
from gcs_sysid.model.parameters import CORE_OF, REGISTRY
from gcs_sysid.report.data import ReportData
from gcs_sysid.report.drawing import PlanView
from gcs_sysid.report.page_figures import ChartData, add_histories
from gcs_sysid.report.parts import (
    Child,
    Markup,
    element,
    facts,
    figure,
    grid,
    joined,
    legend,
    note,
    numbers,
    section,
    table,
)
from gcs_sysid.results import words
from gcs_sysid.results.health_view import way
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_file import segment_estimates
from gcs_sysid.results.result_view import (
    ParameterRow,
    figures,
    parameter_rows,
    said_in_sentence,
    verdict_sentence,
)
from gcs_sysid.results.words import PAGE


def verdict(data: ReportData) -> Markup:
    """What is known, how well, and what is missing."""
    result = data.result
    missing = [
        element("li", text, element("span", help_, class_="advice") if help_ else None)
        for text, help_ in limitations(result, data.inspection)
    ]
    text = element(
        "div",
        element(
            "h2",
            element("span", words.VERDICT[result.verdict].sign, class_="sign", aria_hidden="true"),
            words.VERDICT[result.verdict].meaning,
            id="verdict-title",
        ),
        element("p", verdict_sentence(result), class_="sentence"),
        element("h3", "Limitations") if missing else None,
        element("ul", *missing, class_="missing") if missing else None,
    )
    return element(
        "section",
        element("div", text, plan_view(data), class_="columns"),
        _headline(data),
        id="verdict",
        class_=f"verdict {result.verdict}",
        aria_labelledby="verdict-title",
    )


def limitations(result: Result, inspection: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What is missing or stands in the way, and what would help."""
    out = [(reason, "") for reason in result.reasons if not said_in_sentence(reason)]
    said = {text for text, _ in out}
    for finding in inspection.get("reasons", ()):
        if finding["level"] != "note" and finding["text"] not in said:
            out.append((finding["text"], finding["advice"]))
    # Advice that several share is given once, with the last of them.
    last = {help_: place for place, (_, help_) in enumerate(out)}
    return [
        (text, help_ if last[help_] == place else "") for place, (text, help_) in enumerate(out)
    ]


_TILES = {
    name: p.group.capitalize() + (f", {name}" if name != p.group else "")
    for name, p in REGISTRY.items()
    if p.fit == "scale"
} | {"added_mass": "Added mass"}


def _headline(data: ReportData) -> Markup:
    """The few numbers that a pilot looks for first."""
    scale, telemetry = data.result.scale, data.result.telemetry
    tiles: dict[str, Child] = {}
    if scale is not None:
        origin = f"from {scale.origin}" if scale.origin else "given: sets the scale"
        value = f"{PAGE.number(scale.value, 4)} {PAGE.unit(scale.unit)}"
        tiles[_TILES[scale.anchor]] = _tile(value, origin)
    for name, what in _TILES.items():
        estimate = data.result.parameters.get(name)
        if estimate and estimate.value is not None and estimate.status == "identified":
            value = f"{PAGE.number(estimate.value, 4)} {PAGE.unit(estimate.unit)}"
            tiles.setdefault(what, _tile(value, f"± {PAGE.percent(estimate.relative_half)}"))
    seconds = telemetry.get("used_seconds")
    if seconds:
        tiles["Flight used"] = _tile(f"{PAGE.fixed(seconds, 1)} s", _of_flight(data))
    found = [v for v in data.result.validation.get("r_squared", {}).values() if v is not None]
    if found:
        # Cut, not rounded: 0.99996 is not 1.
        worst = math.floor(1e4 * min(found)) / 1e4
        tiles["Prediction of held-out data"] = _tile(
            f"R² {PAGE.fixed(worst, 4)}", "worst of three axes"
        )
    return element(
        "dl",
        *(element("div", element("dt", name), value) for name, value in tiles.items()),
        class_="tiles",
    )


def _tile(value: str, more: str) -> Markup:
    return joined(element("dd", value, class_="value"), element("dd", more, class_="more"))


def _of_flight(data: ReportData) -> str:
    in_air = data.inspection.get("in_air")
    return f"of {PAGE.fixed(in_air, 1)} s in the air" if in_air else "in the air"


def parameters(data: ReportData) -> Markup:
    """The table of values, intervals, status and what each rests on."""
    result = data.result
    core = CORE_OF[result.rotor_input]
    found = [
        row
        for row in parameter_rows(result, PAGE, si=True, truth=data.truth)
        if row.parameter.section == "parameters"
    ]
    found.sort(key=lambda row: row.name not in core)
    bounded = any(row.estimate.bound is not None for row in found)
    columns = ["Parameter", *numbers("Value ± 95 %", "95 % interval"), "Status", "Based on"]
    # What no flight reduces, where there is any.
    limited = any(row.estimate.std_given for row in found)
    columns += numbers("Of it given, 95 %") if limited else []
    columns += numbers("Cramér-Rao bound, 95 %") if bounded else []
    columns += numbers("Truth") if data.truth else []
    cells = []
    for row in found:
        line = [_name(row), *_numbers(row.estimate), _status(row.estimate.status), row.source]
        line += [_half(row.given_half)] if limited else []
        line += [_half(row.bound_half)] if bounded else []
        line += [_truth(row)] if data.truth else []
        cells.append(line)
    shown = {row.status for row in found}
    meanings = [
        element("li", _status(status), " ", word.with_advice)
        for status, word in words.STATUS.items()
        if status in shown
    ]
    return section(
        "parameters",
        "Parameters",
        table("Parameters with their 95 % intervals, SI units", columns, cells),
        element("ul", *meanings, class_="meanings"),
        note(
            "Of it given: the part due to errors of the given arm, scale and IMU, which no "
            "flight reduces."
        )
        if limited
        else None,
        _timing(result),
        _segments(result),
    )


def _name(row: ParameterRow) -> Markup:
    return joined(
        element("span", row.name, class_="symbol"),
        element("span", row.parameter.meaning, class_="meaning"),
    )


def _status(status: Status | None) -> Markup:
    sign = element("span", words.STATUS[status].sign, class_="sign", aria_hidden="true")
    return element("span", sign, status, class_=f"status {status}")


def _numbers(estimate: Estimate) -> list[Child]:
    """Value with its uncertainty, and the interval."""
    shown = figures(estimate, PAGE)
    value: Child = shown.measure
    share = estimate.relative_half
    if shown.kind == "interval" and share is not None and share <= 1.0:
        value = joined(
            element("span", shown.measure), element("span", f"± {shown.percent}", class_="share")
        )
    return [value, shown.interval or PAGE.nothing]


def _half(half: float | None) -> str:
    """Half of a 95 % interval; nothing where there is none."""
    return f"± {PAGE.number(half, 2)}" if half else PAGE.nothing


def _truth(row: ParameterRow) -> Child:
    error = None
    if row.error is not None:
        error = element("span", f"error {PAGE.percent(row.error)}", class_="share")
    return PAGE.nothing if row.truth is None else joined(PAGE.number(row.truth, 5), error)


def _timing(result: Result) -> Markup | None:
    entries: dict[str, Child] = {}
    for row in parameter_rows(result, PAGE):
        if row.parameter.section == "timing" and row.estimate.shown:
            meaning = element("span", row.parameter.meaning, class_="share")
            name = row.name.replace("_", " ").capitalize()
            entries[name] = joined(row.figures.measure, meaning)
    return facts(entries) if entries else None


def _segments(result: Result) -> Markup | None:
    """What held before each change, where the vehicle changed."""
    segments = result.segments
    if not segments:
        return None
    parts = [(f"{s['start']:.1f} to {s['end']:.1f} s", segment_estimates(s)) for s in segments]
    parts.append((f"from {segments[-1]['end']:.1f} s on", result.parameters))
    columns = ["Parameter", *numbers(*(title for title, _ in parts))]
    rows = [
        [name, *(_numbers(held[name])[0] if name in held else PAGE.nothing for _, held in parts)]
        for name in result.parameters
    ]
    return joined(
        element("h3", "Before and after the changes"),
        table("Value ± 95 % in each segment of the flight", columns, rows),
    )


def convergence(data: ReportData, figures: ChartData) -> Markup:
    """How every estimate settled."""
    names = add_histories(figures, data)
    if not names:
        return section("convergence", "Convergence", note("Too little flight."))
    entries = [("estimate", "estimate"), ("band", "95 % band")]
    if data.truth:
        entries.append(("level", "truth"))
    if data.result.events:
        entries.append(("mark", "event, numbered as below"))
    by_name = data.result.parameters
    return section(
        "convergence",
        "Convergence",
        note(
            "Each estimate with its 95 % band over the flight, on the scale of the final "
            "estimate: early values may leave the plot."
        ),
        legend(*entries),
        grid(
            "three",
            (
                figure(
                    f"history-{name}", name, by_name[name].status or "",
                    size="small",
                )
                for name in names
            ),
        ),
    )  # fmt: skip


def plan_view(data: ReportData) -> Markup | None:
    """Rotors in the autopilot's order and the CG; None where the CG is not known at all."""
    cg = [data.result.parameters.get(name) for name in ("cg_x", "cg_y")]
    if not all(e is not None and e.shown for e in cg):
        return None
    along, across = (float(e.value or 0.0) for e in cg if e is not None)
    x, y, spin = data.airframe.geometry.tolist()
    size = 300.0
    middle = 0.5 * size
    view = PlanView(list(zip(x, y, strict=True)), (middle, middle), 104.0, 36.0)
    parts = [*view.frame(5.0), element("circle", cx=middle, cy=middle, r=3, class_="hub")]
    for i, ((u, v), s) in enumerate(zip(view.places, spin, strict=True), 1):
        parts += [
            element("circle", cx=round(u, 1), cy=round(v, 1), r=round(view.radius, 1),
                    class_="rotor"),
            _turn(u, v, 0.68 * view.radius, s),
            element("text", str(i), x=round(u, 1), y=round(v + 4.5, 1), class_="motor"),
        ]  # fmt: skip
    halves = [e.half or 0.0 for e in cg if e is not None]
    parts += view.cg((along, across), (halves[0], halves[1]), 9.0)
    text = cg_text(along, across, data.result.parameters["cg_x"].unit)
    picture = element(
        "svg",
        element("title", f"Plan view. {text}"),
        *parts,
        viewBox=f"0 0 {size:g} {size:g}",
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


def cg_text(x: float, y: float, unit: str) -> str:
    """Where the center of gravity is, in words: forward and right of the geometric center."""
    factor, shown = (100.0, "% of the arm") if unit == "m/m" else (1e3, "mm")
    along, across = (
        f"{PAGE.fixed(abs(factor * v), 1)} {shown} {way(axis, v)}"
        for axis, v in (("x", x), ("y", y))
    )
    return f"The center of gravity (⊕) is {along} and {across} of the geometric center."


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
