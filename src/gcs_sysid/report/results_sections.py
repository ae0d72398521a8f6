"""The sections on the findings: verdict, parameters, convergence."""

import math
from collections.abc import Mapping
from typing import Any

from gcs_sysid.estimation.status import Status
from gcs_sysid.intervals import Z95
from gcs_sysid.model.parameters import CORE_OF, PARAMETERS, REGISTRY, TIMING
from gcs_sysid.report import wording
from gcs_sysid.report.data import ReportData
from gcs_sysid.report.markup import Child, Markup, element, joined
from gcs_sysid.report.page_figures import Figures, add_course
from gcs_sysid.report.parts import Column, facts, figure, grid, legend, note, section, table
from gcs_sysid.report.vehicle_plan import plan_view
from gcs_sysid.results import words
from gcs_sysid.results.number_format import PAGE, decimals_for


def verdict(data: ReportData) -> Markup:
    """What is known, how well, and what is missing."""
    word = data.result["verdict"]
    missing = [
        element("li", text, element("span", help_, class_="advice") if help_ else None)
        for text, help_ in wording.advice(data.result, data.inspection)
    ]
    text = element(
        "div",
        element(
            "h2",
            element("span", words.VERDICT[word].sign, class_="sign", aria_hidden="true"),
            words.VERDICT[word].meaning,
            id="verdict-title",
        ),
        element("p", wording.verdict_sentence(data.result), class_="sentence"),
        element("h3", "Limitations") if missing else None,
        element("ul", *missing, class_="missing") if missing else None,
    )
    return element(
        "section",
        element("div", text, plan_view(data), class_="columns"),
        _headline(data),
        id="verdict",
        class_=f"verdict {word}",
        aria_labelledby="verdict-title",
    )


_TILES = {
    name: p.group.capitalize() + (f", {name}" if name != p.group else "")
    for name, p in REGISTRY.items()
    if p.fit == "scale"
} | {"added_mass": "Added mass"}


def _headline(data: ReportData) -> Markup:
    """The few numbers that a pilot looks for first."""
    result = data.result
    scale, telemetry = result["scale"], result["telemetry"]
    tiles: dict[str, Child] = {}
    if scale is not None:
        origin = f"from {scale['from']}" if scale.get("from") else "given: sets the scale"
        what = _TILES[scale["anchor"]]
        tiles[what] = _tile(f"{PAGE.number(scale['value'], 4)} {PAGE.unit(scale['unit'])}", origin)
    for name, what in _TILES.items():
        estimate = result["parameters"].get(name)
        if estimate and estimate["value"] is not None and estimate["status"] == "identified":
            share = (wording.half_of(estimate) or 0.0) / abs(estimate["value"])
            unit = PAGE.unit(estimate["unit"])
            tiles.setdefault(
                what,
                _tile(f"{PAGE.number(estimate['value'], 4)} {unit}", f"± {PAGE.percent(share)}"),
            )
    seconds = telemetry.get("used_seconds")
    if seconds:
        tiles["Flight used"] = _tile(f"{PAGE.fixed(seconds, 1)} s", _of_flight(data))
    found = [v for v in result["validation"].get("r_squared", {}).values() if v is not None]
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
    entries: Mapping[str, Any] = result["parameters"]
    bounded = any("bound" in e for e in entries.values())
    columns = [
        Column("Parameter"),
        Column("Value ± 95 %", numbers=True),
        Column("95 % interval", numbers=True),
        Column("Status"),
        Column("Based on"),
    ]
    # What no flight reduces, where there is any.
    limited = any(e.get("std_given") for e in entries.values())
    columns += [Column("Of it given, 95 %", numbers=True)] if limited else []
    columns += [Column("Cramér-Rao bound, 95 %", numbers=True)] if bounded else []
    columns += [Column("Truth", numbers=True)] if data.truth else []
    core = CORE_OF[result["rotor_input"]]
    rows = []
    for name in sorted(entries, key=lambda n: n not in core):
        estimate = entries[name]
        status: Status = estimate["status"]
        known = status != "unobservable"
        cells = [_name(name), *_numbers(estimate), _status(status, words.STATUS[status])]
        cells.append(words.source_of(name, estimate, result["scale"]))
        if limited:
            cells.append(_half_of(estimate.get("std_given") if known else None))
        if bounded:
            cells.append(_half_of(estimate.get("bound")))
        if data.truth:
            cells.append(_truth(estimate, data.truth.get(name)))
        rows.append(cells)
    shown = dict.fromkeys(e["status"] for e in entries.values())
    meanings = [
        element("li", _status(status, word), " ", word.with_advice)
        for status, word in words.STATUS.items()
        if status in shown
    ]
    return section(
        "parameters",
        "Parameters",
        table("Parameters with their 95 % intervals, SI units", columns, rows),
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


def _name(name: str) -> Markup:
    return joined(
        element("span", name, class_="symbol"),
        element("span", PARAMETERS[name].meaning, class_="meaning"),
    )


def _status(status: Status, word: words.Word) -> Markup:
    sign = element("span", word.sign, class_="sign", aria_hidden="true")
    return element("span", sign, status, class_=f"status {status}")


def _numbers(estimate: Mapping[str, Any]) -> list[Child]:
    """Value with its uncertainty, and the interval."""
    half = wording.half_of(estimate)
    value, unit = estimate["value"], PAGE.unit(estimate["unit"])
    if value is None or half is None or estimate["status"] == "unobservable":
        return [PAGE.nothing] * 2
    text, half_text, power, exponent = PAGE.value_and_half(value, half)
    if estimate["status"] == "given" and not half:
        return [f"{PAGE.number(value, 6)} {unit}", PAGE.nothing]
    decimals = decimals_for(half / 10.0**exponent, abs(value) / 10.0**exponent)
    ends = [PAGE.fixed(end / 10.0**exponent, decimals) for end in estimate["ci95"] or ()]
    interval = f"{ends[0]} … {ends[1]}{power}" if ends else PAGE.nothing
    if estimate["ci95"] and estimate["ci95"][0] <= 0.0 <= estimate["ci95"][1]:
        limit = PAGE.number(max(map(abs, estimate["ci95"])), 2)
        return [f"~0 (< {limit} {unit})".replace(" )", ")"), interval]
    share = half / abs(value) if value else math.inf
    relative = f"± {PAGE.percent(share)}" if half and share <= 1.0 else ""
    both = f"({text} ± {half_text}){power}" if power else f"{text} ± {half_text}"
    shown = joined(
        element("span", f"{both} {unit}".rstrip()),
        element("span", relative, class_="share") if relative else None,
    )
    return [shown, interval]


def _half_of(std: float | None) -> str:
    """Half of a 95 % interval; nothing where there is none."""
    return f"± {PAGE.number(Z95 * std, 2)}" if std else PAGE.nothing


def _truth(estimate: Mapping[str, Any], true: float | None) -> Child:
    if true is None:
        return PAGE.nothing
    value = estimate["value"]
    error = None if value is None or not true else value / true - 1.0
    return joined(
        PAGE.number(true, 5),
        None if error is None
        else element("span", f"error {PAGE.percent(error)}", class_="share"),
    )  # fmt: skip


def _timing(result: Mapping[str, Any]) -> Markup | None:
    entries: dict[str, Child] = {}
    for name, estimate in result["timing"].items():
        if estimate["value"] is None or estimate["status"] == "unobservable":
            continue
        half = wording.half_of(estimate)
        text = PAGE.measure(1e3 * estimate["value"], 1e3 * half if half else None, "ms")
        if estimate["status"] == "zero":
            text = f"~0 (< {PAGE.number(1e3 * max(map(abs, estimate['ci95'])), 2)} ms)"
        entries[name.replace("_", " ").capitalize()] = joined(
            text, element("span", TIMING[name].meaning, class_="share")
        )
    return facts(entries) if entries else None


def _segments(result: Mapping[str, Any]) -> Markup | None:
    """What held before each change, where the vehicle changed."""
    segments = result["segments"]
    if not segments:
        return None
    parts = [(f"{s['start']:.1f} to {s['end']:.1f} s", s["parameters"]) for s in segments]
    parts.append((f"from {segments[-1]['end']:.1f} s on", result["parameters"]))
    columns = [Column("Parameter"), *(Column(title, numbers=True) for title, _ in parts)]
    rows = [
        [name, *(_numbers(held[name])[0] if name in held else PAGE.nothing for _, held in parts)]
        for name in result["parameters"]
    ]
    return joined(
        element("h3", "Before and after the changes"),
        table("Value ± 95 % in each segment of the flight", columns, rows),
    )


def convergence(data: ReportData, figures: Figures) -> Markup:
    """How every estimate settled."""
    names = add_course(figures, data)
    if not names:
        return section("convergence", "Convergence", note("Too little flight."))
    entries = [("estimate", "estimate"), ("band", "95 % band")]
    if data.truth:
        entries.append(("level", "truth"))
    if data.result["events"]:
        entries.append(("mark", "event, numbered as below"))
    by_name = data.result["parameters"]
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
                    f"course-{name}", name, by_name[name]["status"],
                    size="small",
                )
                for name in names
            ),
        ),
    )  # fmt: skip
