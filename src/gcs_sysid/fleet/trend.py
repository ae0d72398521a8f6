"""A fleet's vehicles over their flights, and where one changed from its earlier flights.

Flights of one vehicle differ by more than each flight's own uncertainty: air, battery, wind. That
scatter is estimated from the differences of neighboring flights, by their median, which single
changes do not affect: the moving range of control charts for single values (Shewhart's charts). A
flight is then compared with the prediction from the earlier ones.

The page shows every vehicle's parameters over its flights, and its changes.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from importlib import resources
from itertools import pairwise
from statistics import median
from typing import Any

from gcs_sysid import __version__
from gcs_sysid.fleet.batch import Row
from gcs_sysid.health.balance import pooled
from gcs_sysid.health.health_trend import Series, slopes
from gcs_sysid.model.estimate import Estimate, Quantity
from gcs_sysid.model.parameters import PARAMETERS, REGISTRY, TIMING
from gcs_sysid.report.drawing import FlightsChart, IntervalPoint, chart_of, line
from gcs_sysid.report.parts import (
    Child,
    Markup,
    element,
    grid,
    html_page,
    legend,
    note,
    numbers,
    section,
    table,
)
from gcs_sysid.results.comparison import Comparison, Difference, compare
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_data import SCHEMA
from gcs_sysid.results.result_file import parse_result
from gcs_sysid.results.result_view import figures, names_text, number_figures
from gcs_sysid.results.words import PAGE, VERDICT
from gcs_sysid.significance import FALSE_ALARM_RATE, Z95, normal_limit, student_limit

FEWEST = 4
"""Fewest flights for an estimate of their scatter."""
_FREEDOM = 0.55
"""Degrees of freedom that a difference brings to the median (a test counts false alarms)."""

Scatter = Mapping[str, float]
"""Parameter -> variance between flights, beyond their own."""


@dataclass(frozen=True)
class FlightChange:
    """A flight that differs from those before it.

    Attributes:
        first: number of the first flight compared with, from 1.
        last: of the last.
        comparison: of what these predict (A) with the flight (B).
        differences: the significant ones, corrected for all flights and parameters tested.
    """

    first: int
    last: int
    comparison: Comparison
    differences: tuple[Difference, ...]


@dataclass(frozen=True)
class Flight:
    """One flight of a vehicle.

    Attributes:
        number: from 1, in the order of time.
        row: of the table.
        result: the row's values of the vehicle.
        change: from the flights before, if there was one.
    """

    number: int
    row: Row
    result: Result
    change: FlightChange | None


@dataclass(frozen=True)
class FleetVehicle:
    """A vehicle's flights in the order of time, and how its parameters scatter between them.

    Flights that show no more than their hover are among them.
    """

    name: str
    flights: tuple[Flight, ...]
    scatter: Scatter

    @property
    def changed(self) -> list[Flight]:
        """Flights at which it had changed."""
        return [flight for flight in self.flights if flight.change is not None]

    @property
    def hover(self) -> list[Series]:
        """The numbers of the hover over all flights."""
        found: dict[tuple[str, str], dict[int, tuple[float, float]]] = {}
        for place, flight in enumerate(self.flights):
            for one in flight.row.get("hover") or ():
                at = found.setdefault((one["name"], one["unit"]), {})
                at[place] = one["value"], one["std"]
        nothing = math.nan, math.nan
        return [
            Series(name, unit, *zip(*(at.get(i, nothing) for i in range(len(self.flights))),
                                    strict=True))
            for (name, unit), at in found.items()
        ]  # fmt: skip

    @property
    def proposed(self) -> dict[str, tuple[Quantity, float | None, int]]:
        """Autopilot parameter -> its value by all flights, as it was last, and their number."""
        found: dict[str, list[dict[str, Any]]] = {}
        for flight in self.flights:
            for one in flight.row.get("proposed") or ():
                found.setdefault(one["name"], []).append(one)
        return {
            name: (
                pooled(
                    [
                        Quantity(one["value"], one["std"], std_given=one["std_given"] or 0.0)
                        for one in some
                    ]
                ),
                some[-1]["now"],
                len(some),
            )
            for name, some in found.items()
        }

    @property
    def eras(self) -> list[tuple[Flight, ...]]:
        """Flights between changes."""
        cuts = [0, *(flight.number - 1 for flight in self.changed), len(self.flights)]
        return [self.flights[a:b] for a, b in pairwise(cuts) if b > a]


def vehicles_of(rows: Iterable[Row]) -> tuple[list[FleetVehicle], list[Row]]:
    """Sort a table's rows into vehicles and their flights.

    Flights come in the order in which they were recorded; those without a time come last, by path.
    A log that is there twice counts once.

    Returns:
        Vehicles by name, and the rows of logs without results.
    """
    flights: dict[str, dict[str, Row]] = {}
    unused = []
    for row in sorted(rows, key=_when):
        shown = row["verdict"] not in (None, "refused") or row.get("hover")
        if row["vehicle"] is None or not shown:
            unused.append(row)
        else:
            flights.setdefault(row["vehicle"], {}).setdefault(row["sha256"], row)
    return [_vehicle(name, list(flights[name].values())) for name in sorted(flights)], unused


def _when(row: Row) -> tuple[bool, datetime, str]:
    recorded = row["recorded"]
    return recorded is None, recorded or datetime.min, row["path"]


def _vehicle(name: str, rows: Sequence[Row]) -> FleetVehicle:
    results = [result_of(row) for row in rows]
    identified = [result.verdict != "refused" for result in results]
    level = FALSE_ALARM_RATE / max(len(rows) - 1, 1)
    scatter = scatter_of(results, level)
    flights: list[Flight] = []
    first = 0
    for place, (row, result) in enumerate(zip(rows, results, strict=True)):
        change = None
        before = [results[i] for i in range(first, place) if identified[i]]
        if before and identified[place]:
            comparison = compare(predicted(before, scatter), result)
            found = tuple(
                difference
                for difference in comparison.differences.values()
                if difference.p_holm is not None and difference.p_holm < level
            )
            if found:
                change = FlightChange(first + 1, place, comparison, found)
                first = place
        flights.append(Flight(place + 1, row, result, change))
    return FleetVehicle(name, tuple(flights), scatter)


def scatter_of(results: Sequence[Result], level: float) -> Scatter:
    """How parameters scatter from flight to flight.

    Args:
        results: of a vehicle's flights, in the order of time.
        level: probability of a false alarm at one flight. The variances are larger than the
            likeliest, by Student's t, so that this holds though they are estimated from few
            flights.

    Returns:
        Variances; zero with fewer than `FEWEST` flights.
    """
    names = dict.fromkeys(name for result in results for name in result.estimates)
    series = {
        name: [e for r in results if (e := sound(r.estimates.get(name))) is not None]
        for name in names
    }
    tested = max(sum(len(known) > 1 for known in series.values()), 1)
    return {name: _variance(known, level / tested) for name, known in series.items()}


def _variance(known: Sequence[Quantity], level: float) -> float:
    if len(known) < FEWEST:
        return 0.0
    found = [(a.value - b.value) ** 2 for a, b in pairwise(known)]
    own = [_variance_of(a) + _variance_of(b) for a, b in pairwise(known)]
    freedom = max(_FREEDOM * len(found), 1.0)
    caution = (student_limit(freedom, level) / normal_limit(level)) ** 2
    middle = normal_limit(0.5) ** 2  # the median of chi squared with one degree of freedom
    return max(0.5 * (caution * median(found) / middle - median(own)), 0.0)


def result_of(row: Row) -> Result:
    """A row of the table as a result, without what the table does not hold."""
    known = {name: _present(row[name]) for name in REGISTRY if row[name] is not None}
    document = {
        "schema": SCHEMA,
        **{key: row[key] for key in ("verdict", "rotor_input", "estimator")},
        "reasons": row["reasons"] or [],
        "source": row["path"],
        "scale": row["scale"] and _present(row["scale"]),
        "vehicle": {key: row[key] for key in ("sysid", "compid", "autopilot")},
        "parameters": known,
        "timing": known,
    }
    return parse_result(document, row["path"])


def _present(entry: dict[str, Any]) -> dict[str, Any]:
    return {part: value for part, value in entry.items() if value is not None}


def predicted(flights: Sequence[Result], scatter: Scatter) -> Result:
    """Prediction for the next flight of an unchanged vehicle.

    Returns:
        The last one's result with the values expected, and their standard deviations with the
        scatter in them.
    """
    last = flights[-1]
    source = f"{len(flights)} flights from {flights[0].source} to {last.source}"
    names = dict.fromkeys(name for flight in flights for name in flight.estimates)
    expected = {}
    for name in names:
        known = [flight.estimates[name] for flight in flights if name in flight.estimates]
        well = [each for estimate in known if (each := sound(estimate)) is not None]
        expected[name] = known[-1]
        if well:
            value, variance = mean(well, scatter[name])
            std = math.sqrt(variance + scatter[name])
            expected[name] = replace(well[-1], value=value, std=std, std_given=0.0)
    return replace(
        last,
        source=source,
        parameters={name: e for name, e in expected.items() if name in PARAMETERS},
        timing={name: e for name, e in expected.items() if name in TIMING},
    )


def sound(estimate: Estimate | None) -> Quantity | None:
    """The estimate, where a flight alone determines the parameter well; else None."""
    if estimate is None or estimate.status not in ("identified", "zero"):
        return None
    return estimate.known if estimate.std_data and estimate.rests_on is None else None


def mean(known: Sequence[Quantity], between: float) -> tuple[float, float]:
    """Weighted mean of sound estimates and its variance.

    `between` is the variance between flights.
    """
    weights = [1.0 / (_variance_of(estimate) + between) for estimate in known]
    total = sum(weights)
    value = sum(w * e.value for w, e in zip(weights, known, strict=True)) / total
    return value, 1.0 / total


def _variance_of(estimate: Quantity) -> float:
    # What was given is wrong by as much in every flight.
    return (estimate.std_data or 0.0) ** 2


_LEGEND = (
    ("identified", "identified, with its 95 % interval"),
    ("weak", "weak"),
    ("changed", "changed from earlier flights"),
    ("mean", "mean between changes"),
)
_RULE = (
    "Each flight is compared with the prediction from the flights since the last change, including "
    "their usual scatter. At most one unchanged vehicle in a hundred is called changed at any of "
    "its flights."
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
            *(_section(place, vehicle) for place, vehicle in enumerate(vehicles, 1)),
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
    elif not any(_changes(vehicle) for vehicle in vehicles):
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
    columns = ["Vehicle", *numbers("Flights"), "First", "Last", "Changes"]
    return section(
        "overview",
        "Has a vehicle changed?",
        element("p", words, class_="sentence"),
        note(_RULE),
        table("Vehicles by the name of their airframe and their address", columns, rows)
        if rows
        else None,
    )


def _changes(vehicle: FleetVehicle) -> list[str]:
    """What is otherwise from a flight on, and what moves from flight to flight."""
    steps = (
        f"flight {flight.number}: {names_text([d.name for d in flight.change.differences])}"
        for flight in vehicle.changed
        if flight.change is not None
    )
    return [*steps, *slopes(vehicle.hover)]


def _changes_text(vehicle: FleetVehicle) -> str:
    nothing = "no change seen" if len(vehicle.flights) > 1 else PAGE.nothing
    return "; ".join(_changes(vehicle)) or nothing


def _section(place: int, vehicle: FleetVehicle) -> Markup:
    figures = [trend_figure(vehicle, name) for name in shown_names(vehicle)]
    changes = [row for flight in vehicle.changed for row in _change_rows(flight)]
    columns = ["Flight", "Compared with", "Parameter", *numbers("Expected", "Found", "Difference")]
    notes = [
        text.replace("the mass of B", f"the mass at flight {flight.number}")
        for flight in vehicle.changed
        if flight.change is not None
        for text in flight.change.comparison.notes
        if "the mass of B" in text
    ]
    return section(
        f"vehicle-{place}",
        vehicle.name,
        element("h3", "Changes") if changes else None,
        table("Differences with their 95 % intervals", columns, changes) if changes else None,
        *(note(text) for text in notes),
        note(_FEW) if changes and len(vehicle.flights) < FEWEST else None,
        *(
            [element("h3", "Parameters over flights"), legend(*_LEGEND), grid("three", figures)]
            if figures
            else []
        ),
        *_hover(vehicle),
        element("details", element("summary", "The flights"), _flights(vehicle)),
    )


def _hover(vehicle: FleetVehicle) -> Iterator[Markup]:
    """What hover shows of all flights, and the autopilot parameters by all of them."""
    series = vehicle.hover
    if not series:
        return
    yield element("h3", "Hover over flights")
    for text in slopes(series):
        yield note(f"{text}.")
    yield grid("three", [hover_figure(vehicle, one.in_power()) for one in series])
    rows: list[list[Child]] = [
        [
            name,
            PAGE.number(now, 4),
            PAGE.measure(estimate.value, estimate.half, ""),
            str(flights),
        ]
        for name, (estimate, now, flights) in vehicle.proposed.items()
    ]
    if rows:
        columns = ["Parameter", *numbers("Now", "By hover", "Flights")]
        about = "Autopilot parameters that fit, with 95 % intervals over the flights"
        yield table(about, columns, rows)


def hover_figure(vehicle: FleetVehicle, series: Series) -> Markup:
    """A number of the hover with its 95 % intervals, each by the flight's own scatter."""
    return _figure(vehicle, series.name, None, *chart_of(series, "", WIDTH, HEIGHT))


def _figure(vehicle: FleetVehicle, name: str, meaning: str | None, *parts: Child) -> Markup:
    """A chart's parts under its name."""
    drawing = element(
        "svg", *parts, viewBox=f"0 0 {WIDTH} {HEIGHT}", role="img",
        aria_label=f"{name} over the flights of {vehicle.name}",
    )  # fmt: skip
    more = None if meaning is None else element("span", meaning, class_="more")
    caption = element("figcaption", element("span", name, class_="title"), more)
    return element("figure", caption, element("div", drawing, class_="plot trend"), class_="drawn")


def _change_rows(flight: Flight) -> list[list[Child]]:
    change = flight.change
    assert change is not None
    out: list[list[Child]] = []
    for found in change.differences:
        expected = None if found.before is None else found.before.value
        by, share = Estimate(found.value, found.std, found.unit), ""
        if expected and found.value is not None:
            share = f" ({PAGE.fixed(100.0 * found.value / abs(expected), 1)} %)"
        out.append(
            [
                str(flight.number),
                _span(change),
                found.name,
                value_text(found.name, found.before),
                value_text(found.name, found.after),
                value_text(found.name, by) + share,
            ]
        )
    return out


def _span(change: FlightChange) -> str:
    if change.first == change.last:
        return f"flight {change.first}"
    return f"flights {change.first} to {change.last}"


def value_text(name: str, estimate: Estimate | None) -> str:
    """An estimate with its interval, in the unit that people read it in."""
    known = None if estimate is None else estimate.known
    if known is None:
        return PAGE.nothing
    exponent, half = REGISTRY[name].exponent, Z95 * known.std
    return number_figures(known.value, half, known.unit, PAGE, exponent=exponent).measure


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
    columns = ["Flight", "Recorded", "Log", "Verdict", *numbers("Scale")]
    return table("In order of time; those without a time last, by path", columns, rows)


def _unused(rows: Sequence[Row]) -> Markup:
    return section(
        "unused",
        "Logs without a result",
        table(
            "Refused or unreadable",
            ["Log", "Why"],
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
    return _figure(
        vehicle,
        name,
        PARAMETERS[name].meaning,
        *chart.axes(),
        *(_mean_line(era, name, vehicle.scatter.get(name, 0.0), chart) for era in vehicle.eras),
        *(chart.cut(flight.number) for flight in vehicle.changed),
        *chart.points(_point(flight, estimate, name) for flight, estimate in known),
    )


def _mean_line(
    era: Sequence[Flight], name: str, scatter: float, chart: FlightsChart
) -> Markup | None:
    known = [e for f in era if (e := sound(f.result.parameters.get(name))) is not None]
    if len(known) < 2:
        return None
    at = chart.y(mean(known, scatter)[0])
    return line(chart.x(era[0].number - 0.35), at, chart.x(era[-1].number + 0.35), at, "mean")


def _point(flight: Flight, estimate: Estimate, name: str) -> IntervalPoint:
    low, high = estimate.ci95 or (0.0, 0.0)
    change = flight.change
    changed = change is not None and name in {d.name for d in change.differences}
    kind = f"{estimate.status}{' changed' if changed else ''}"
    text = figures(estimate, PAGE).measure
    words = f"flight {flight.number}: {text}, {kind.replace(' ', ', ')}"
    return IntervalPoint(flight.number, estimate.value or 0.0, low, high, words, kind)
