"""The page of a fleet: every vehicle's parameters over its flights, and its changes."""

import base64
import hashlib
import math
from collections.abc import Callable, Sequence
from importlib import resources

from gcs_sysid import __version__
from gcs_sysid.fleet.batch_table import Row
from gcs_sysid.fleet.trend import FEWEST, Change, Flight, Vehicle, is_sound, mean
from gcs_sysid.intervals import Z95
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import PARAMETERS, REGISTRY
from gcs_sysid.report.parts import (
    Child,
    Column,
    Markup,
    element,
    grid,
    legend,
    note,
    section,
    table,
)
from gcs_sysid.results.number_format import PAGE, power_of_ten, times_power
from gcs_sysid.results.result_view import names_text, number_figures
from gcs_sysid.results.words import VERDICT

_LEGEND = (
    ("identified", "identified, with its 95 % interval"),
    ("weak", "weak"),
    ("changed", "changed from earlier flights"),
    ("mean", "mean between changes"),
)
_RULE = (
    "Each flight is compared with the prediction from the flights since the last change, including "
    "their usual scatter. At most one unchanged vehicle in twenty is called changed at any of its "
    "flights."
)
_FEW = (
    f"With fewer than {FEWEST} flights the usual scatter is unknown: a difference need not be a "
    "change."
)
_Axis = Callable[[float], float]

WIDTH, HEIGHT = 360, 190
_LEFT, _RIGHT, _TOP, _BOTTOM = 56, WIDTH - 10, 18, HEIGHT - 28


def render(title: str, vehicles: Sequence[Vehicle], unused: Sequence[Row]) -> str:
    """The page as HTML text; the same table gives the same text."""
    style = "".join(
        (resources.files(package) / name).read_text(encoding="utf-8")
        for package, name in (
            ("gcs_sysid.report", "assets/charts.css"),
            ("gcs_sysid.report", "assets/report.css"),
            ("gcs_sysid.fleet", "trend.css"),
        )
    )
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=policy),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("title", f"{title}: fleet (gcs-sysid)"),
        element("style", Markup(style)),
    )
    contents = element(
        "nav",
        *(
            element("a", vehicle.name, href=f"#vehicle-{place}")
            for place, vehicle in enumerate(vehicles, 1)
        ),
        element("a", "Logs without a result", href="#unused") if unused else None,
        aria_label="Contents",
    )
    body = element(
        "body",
        element(
            "header",
            element("p", "Fleet", class_="kind"),
            element("h1", title),
            contents,
        ),
        element(
            "main",
            _overview(vehicles, unused),
            *(_vehicle(place, vehicle) for place, vehicle in enumerate(vehicles, 1)),
            _unused(unused) if unused else None,
        ),
        element("footer", f"gcs-sysid {__version__}"),
    )
    return f"<!DOCTYPE html>\n{element('html', head, body, lang='en')}\n"


def _overview(vehicles: Sequence[Vehicle], unused: Sequence[Row]) -> Markup:
    changed = [vehicle for vehicle in vehicles if vehicle.changed]
    flights = sum(len(vehicle.flights) for vehicle in vehicles)
    words = f"{_count(len(vehicles), 'vehicle')}, {_count(flights, 'flight')}. "
    if changed:
        words += f"Changed: {names_text([vehicle.name for vehicle in changed])}."
    else:
        words += "No change seen." if flights > len(vehicles) else ""
    if unused:
        words += f" {_count(len(unused), 'log')} without a result."
    rows: list[list[Child]] = [
        [
            element("a", vehicle.name, href=f"#vehicle-{place}"),
            str(len(vehicle.flights)),
            _date(vehicle.flights[0].row).partition(" ")[0],
            _date(vehicle.flights[-1].row).partition(" ")[0],
            _changes_text(vehicle),
        ]
        for place, vehicle in enumerate(vehicles, 1)
    ]
    columns = [
        Column("Vehicle"),
        Column("Flights", numbers=True),
        Column("First"),
        Column("Last"),
        Column("Changes"),
    ]
    return section(
        "overview",
        "Has a vehicle changed?",
        element("p", words, class_="sentence"),
        note(_RULE),
        table("Vehicles by the name of their airframe and their address", columns, rows)
        if rows
        else None,
    )


def _changes_text(vehicle: Vehicle) -> str:
    return "; ".join(
        f"flight {flight.number}: {names_text([d.name for d in flight.change.differences])}"
        for flight in vehicle.changed
        if flight.change is not None
    ) or ("no change seen" if len(vehicle.flights) > 1 else PAGE.nothing)


def _vehicle(place: int, vehicle: Vehicle) -> Markup:
    figures = [trend_figure(vehicle, name) for name in shown_names(vehicle)]
    changes = [row for flight in vehicle.changed for row in _change_rows(flight)]
    columns = [
        Column("Flight"),
        Column("Compared with"),
        Column("Parameter"),
        Column("Expected", numbers=True),
        Column("Found", numbers=True),
        Column("Difference", numbers=True),
    ]
    notes = [
        text.replace("the mass of B", f"the mass at flight {flight.number}")
        for flight in vehicle.changed
        if flight.change is not None
        for text in flight.change.comparison.notes
        if "changed at the masses given" in text
    ]
    return section(
        f"vehicle-{place}",
        vehicle.name,
        element("h3", "Changes") if changes else None,
        table("Differences with their 95 % intervals", columns, changes) if changes else None,
        *(note(text) for text in notes),
        note(_FEW) if changes and len(vehicle.flights) < FEWEST else None,
        element("h3", "Parameters over flights"),
        legend(*_LEGEND),
        grid("three", figures),
        element("details", element("summary", "The flights"), _flights(vehicle)),
    )


def _change_rows(flight: Flight) -> list[list[Child]]:
    change = flight.change
    assert change is not None
    out: list[list[Child]] = []
    for found in change.differences:
        assert found.value is not None
        assert found.std is not None
        expected = None if found.before is None else found.before.value
        share = f" ({PAGE.fixed(100.0 * found.value / abs(expected), 1)} %)" if expected else ""
        out.append(
            [
                str(flight.number),
                _span(change),
                found.name,
                value_text(found.name, found.before),
                value_text(found.name, found.after),
                value_text(found.name, Estimate(found.value, found.std, found.unit, "identified"))
                + share,
            ]
        )
    return out


def _span(change: Change) -> str:
    if change.first == change.last:
        return f"flight {change.first}"
    return f"flights {change.first} to {change.last}"


def value_text(name: str, estimate: Estimate | None) -> str:
    """An estimate with its interval, in the unit that people read it in."""
    if estimate is None:
        return PAGE.nothing
    if estimate.value is None or estimate.std is None:
        return PAGE.nothing
    exponent = REGISTRY[name].exponent
    half = Z95 * estimate.std
    return number_figures(estimate.value, half, estimate.unit, PAGE, exponent=exponent).measure


def _flights(vehicle: Vehicle) -> Markup:
    rows: list[list[Child]] = []
    for flight in vehicle.flights:
        row, scale = flight.row, flight.result.scale
        words = VERDICT[flight.result.verdict].meaning
        rows.append(
            [
                str(flight.number),
                _date(row),
                row["path"],
                f"{words}; changed in flight" if row["changes"] else words,
                PAGE.nothing
                if scale is None
                else f"{scale.anchor} {PAGE.number(scale.value, 4)} {PAGE.unit(scale.unit)}",
            ]
        )
    columns = [
        Column("Flight"),
        Column("Recorded"),
        Column("Log"),
        Column("Verdict"),
        Column("Scale", numbers=True),
    ]
    return table("In order of time; those without a time last, by path", columns, rows)


def _unused(rows: Sequence[Row]) -> Markup:
    return section(
        "unused",
        "Logs without a result",
        table(
            "Refused or unreadable",
            [Column("Log"), Column("Why")],
            [[row["path"], row["error"] or "; ".join(row["reasons"] or ())] for row in rows],
        ),
    )


def _date(row: Row) -> str:
    recorded = row["recorded"]
    return f"{recorded:%Y-%m-%d %H:%M}" if recorded else PAGE.nothing


def _count(count: int, word: str) -> str:
    return f"{count} {word}{'s' if count != 1 else ''}"


def shown_names(vehicle: Vehicle) -> list[str]:
    """Parameters that at least one flight determines, and that were not given."""
    return [
        name
        for name in PARAMETERS
        if any(_drawn(flight.result.parameters.get(name)) for flight in vehicle.flights)
    ]


def _drawn(estimate: Estimate | None) -> bool:
    return (
        estimate is not None
        and estimate.status in ("identified", "zero", "weak")
        and estimate.ci95 is not None
        and bool(estimate.std)
    )


def trend_figure(vehicle: Vehicle, name: str) -> Markup:
    """The parameter of this name with its 95 % intervals, and the mean between changes."""
    known = [
        (flight, flight.result.parameters[name])
        for flight in vehicle.flights
        if _drawn(flight.result.parameters.get(name))
    ]
    low, high = _range([estimate for _, estimate in known])
    power = power_of_ten(max(abs(low), abs(high)))
    count = len(vehicle.flights)

    def x(number: float) -> float:
        return _LEFT + (_RIGHT - _LEFT) * (number - 0.5) / count

    def y(value: float) -> float:
        share = (value - low) / (high - low)
        return _BOTTOM - (_BOTTOM - _TOP) * min(max(share, -0.02), 1.02)

    parts: list[Markup] = []
    values, decimals = _ticks(low / 10.0**power, high / 10.0**power)
    for value in values:
        at = y(value * 10.0**power)
        parts += [
            element("line", x1=_LEFT, x2=_RIGHT, y1=_at(at), y2=_at(at), class_="gridline"),
            _text(PAGE.fixed(value, decimals), _LEFT - 6, at + 4, "end"),
        ]
    every = max(1, math.ceil(count / 8))
    parts += [_text(str(n), x(n), HEIGHT - 10, "middle") for n in range(1, count + 1, every)]
    unit = " ".join(filter(None, [times_power(power).strip(), PAGE.unit(PARAMETERS[name].unit)]))
    parts.append(_text(unit, _LEFT, 11, ""))
    for era in vehicle.eras:
        parts += _mean_line(era, name, vehicle.scatter.get(name, 0.0), x, y)
    for flight in vehicle.changed:
        cut = _at(x(flight.number - 0.5))
        parts.append(element("line", x1=cut, x2=cut, y1=_TOP, y2=_BOTTOM, class_="cut"))
    parts.append(element("line", x1=_LEFT, x2=_RIGHT, y1=_BOTTOM, y2=_BOTTOM, class_="axis"))
    parts += [_point(flight, estimate, x(flight.number), y, name) for flight, estimate in known]
    drawing = element(
        "svg",
        *parts,
        viewBox=f"0 0 {WIDTH} {HEIGHT}",
        role="img",
        aria_label=f"{name} over the flights of {vehicle.name}",
    )
    caption = element(
        "figcaption",
        element("span", name, class_="title"),
        element("span", PARAMETERS[name].meaning, class_="more"),
    )
    return element("figure", caption, element("div", drawing, class_="plot trend"), class_="drawn")


def _range(estimates: Sequence[Estimate]) -> tuple[float, float]:
    """What y spans: all that is identified; rough numbers only where there is nothing better."""
    sure = [e for e in estimates if e.status != "weak"] or estimates
    ends = [end for e in sure for end in e.ci95 or ()]
    low, high = min(ends), max(ends)
    room = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    return low - room, high + room


def _ticks(low: float, high: float) -> tuple[list[float], int]:
    """Round values between, about five, and the decimals that show them."""
    raw = (high - low) / 5.0
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(k * power for k in (1.0, 2.0, 5.0, 10.0) if k * power >= 0.999 * raw)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [k * step for k in range(first, last + 1)], max(0, -math.floor(math.log10(step) + 1e-9))


def _mean_line(
    era: Sequence[Flight], name: str, scatter: float, x: _Axis, y: _Axis
) -> list[Markup]:
    estimates = [f.result.parameters[name] for f in era if name in f.result.parameters]
    sound = [estimate for estimate in estimates if is_sound(estimate)]
    if len(sound) < 2:
        return []
    at = _at(y(mean(sound, scatter)[0]))
    first, last = _at(x(era[0].number - 0.35)), _at(x(era[-1].number + 0.35))
    return [element("line", x1=first, x2=last, y1=at, y2=at, class_="mean")]


def _point(flight: Flight, estimate: Estimate, x: float, y: _Axis, name: str) -> Markup:
    low, high = estimate.ci95 or (0.0, 0.0)
    value, half, power, _ = PAGE.value_and_half(estimate.value or 0.0, estimate.half or 0.0)
    change = flight.change
    changed = change is not None and name in {d.name for d in change.differences}
    kind = f"{estimate.status}{' changed' if changed else ''}"
    unit = PAGE.unit(PARAMETERS[name].unit)
    text = f"({value} ± {half}){power}"
    if estimate.limit is not None:
        text = f"~0 < {PAGE.number(estimate.limit, 2)}"
    words = f"flight {flight.number}: {text} {unit}, {kind.replace(' ', ', ')}"
    return element(
        "g",
        element("title", words),
        element("line", x1=_at(x), x2=_at(x), y1=_at(y(low)), y2=_at(y(high)), class_="whisker"),
        element("circle", cx=_at(x), cy=_at(y(estimate.value or 0.0)), r=3.5),
        class_=f"estimate {kind}",
    )


def _text(words: str, x: float, y: float, anchor: str) -> Markup:
    return element("text", words, x=_at(x), y=_at(y), class_=anchor or None)


def _at(value: float) -> str:
    return f"{value:.1f}"
