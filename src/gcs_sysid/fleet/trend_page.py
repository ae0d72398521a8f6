"""The page of a fleet: every vehicle's parameters over its flights, and its changes."""

from collections.abc import Sequence
from importlib import resources

from gcs_sysid import __version__
from gcs_sysid.fleet.batch_table import Row
from gcs_sysid.fleet.trend import FEWEST, FleetVehicle, Flight, FlightChange, is_sound, mean
from gcs_sysid.intervals import Z95
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import PARAMETERS, REGISTRY
from gcs_sysid.report.drawing import FlightsChart, IntervalPoint, line
from gcs_sysid.report.parts import (
    Child,
    Column,
    Markup,
    element,
    grid,
    html_page,
    legend,
    note,
    section,
    table,
)
from gcs_sysid.results.number_format import PAGE
from gcs_sysid.results.result_view import figures, names_text, number_figures
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
WIDTH, HEIGHT = 360, 190


def render(title: str, vehicles: Sequence[FleetVehicle], unused: Sequence[Row]) -> str:
    """The page as HTML text; the same table gives the same text."""
    style = "".join(
        (resources.files(package) / name).read_text(encoding="utf-8")
        for package, name in (
            ("gcs_sysid.report", "assets/charts.css"),
            ("gcs_sysid.report", "assets/report.css"),
            ("gcs_sysid.fleet", "trend.css"),
        )
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
    return html_page(
        f"{title}: fleet",
        style,
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


def _overview(vehicles: Sequence[FleetVehicle], unused: Sequence[Row]) -> Markup:
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


def _changes_text(vehicle: FleetVehicle) -> str:
    return "; ".join(
        f"flight {flight.number}: {names_text([d.name for d in flight.change.differences])}"
        for flight in vehicle.changed
        if flight.change is not None
    ) or ("no change seen" if len(vehicle.flights) > 1 else PAGE.nothing)


def _vehicle(place: int, vehicle: FleetVehicle) -> Markup:
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
                value_text(found.name, Estimate(found.value, found.std, found.unit)) + share,
            ]
        )
    return out


def _span(change: FlightChange) -> str:
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


def _flights(vehicle: FleetVehicle) -> Markup:
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


def shown_names(vehicle: FleetVehicle) -> list[str]:
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


def trend_figure(vehicle: FleetVehicle, name: str) -> Markup:
    """The parameter of this name with its 95 % intervals, and the mean between changes."""
    known = [
        (flight, flight.result.parameters[name])
        for flight in vehicle.flights
        if _drawn(flight.result.parameters.get(name))
    ]
    # Rough numbers count only where there is nothing better.
    sure = [e for _, e in known if e.status != "weak"] or [e for _, e in known]
    ends = [end for e in sure for end in e.ci95 or ()]
    unit = PAGE.unit(PARAMETERS[name].unit)
    chart = FlightsChart("", unit, len(vehicle.flights), (min(ends), max(ends)), WIDTH, HEIGHT)
    drawing = element(
        "svg",
        *chart.axes(),
        *(_mean_line(era, name, vehicle.scatter.get(name, 0.0), chart) for era in vehicle.eras),
        *(chart.cut(flight.number) for flight in vehicle.changed),
        *chart.points(_point(flight, estimate, name) for flight, estimate in known),
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


def _mean_line(
    era: Sequence[Flight], name: str, scatter: float, chart: FlightsChart
) -> Markup | None:
    estimates = [f.result.parameters[name] for f in era if name in f.result.parameters]
    sound = [estimate for estimate in estimates if is_sound(estimate)]
    if len(sound) < 2:
        return None
    at = chart.y(mean(sound, scatter)[0])
    return line(chart.x(era[0].number - 0.35), at, chart.x(era[-1].number + 0.35), at, "mean")


def _point(flight: Flight, estimate: Estimate, name: str) -> IntervalPoint:
    low, high = estimate.ci95 or (0.0, 0.0)
    change = flight.change
    changed = change is not None and name in {d.name for d in change.differences}
    kind = f"{estimate.status}{' changed' if changed else ''}"
    text = figures(estimate, PAGE).measure
    words = f"flight {flight.number}: {text}, {kind.replace(' ', ', ')}"
    return IntervalPoint(flight.number, estimate.value or 0.0, low, high, words, kind)
