"""A fleet's vehicles over their flights, and where one changed from its earlier flights.

Flights of one vehicle differ by more than each flight's own uncertainty: air, battery, wind. That
scatter is estimated from the differences of neighboring flights, by their median, which single
changes do not affect: the moving range of control charts for single values (Shewhart's charts). A
flight is then compared with the prediction from the earlier ones.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise
from statistics import median
from typing import Any

from gcs_sysid.change_test import FALSE_ALARM_RATE, normal_limit, student_limit
from gcs_sysid.fleet.batch_table import Row
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import PARAMETERS, TIMING, Parameter
from gcs_sysid.results.comparison import Comparison, Difference, compare
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_data import Scale

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
    """A vehicle's flights in the order of time, and how its parameters scatter between them."""

    name: str
    flights: tuple[Flight, ...]
    scatter: Scatter

    @property
    def changed(self) -> list[Flight]:
        """Flights at which it had changed."""
        return [flight for flight in self.flights if flight.change is not None]

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
        if row["vehicle"] is None or row["verdict"] in (None, "refused"):
            unused.append(row)
        else:
            flights.setdefault(row["vehicle"], {}).setdefault(row["sha256"], row)
    return [_vehicle(name, list(flights[name].values())) for name in sorted(flights)], unused


def _when(row: Row) -> tuple[bool, datetime, str]:
    recorded = row["recorded"]
    return recorded is None, recorded or datetime.min, row["path"]


def _vehicle(name: str, rows: Sequence[Row]) -> FleetVehicle:
    results = [result_of(row) for row in rows]
    level = FALSE_ALARM_RATE / max(len(rows) - 1, 1)
    scatter = scatter_of(results, level)
    flights: list[Flight] = []
    first = 0
    for place, (row, result) in enumerate(zip(rows, results, strict=True)):
        change = None
        if place > first:
            comparison = compare(predicted(results[first:place], scatter), result)
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
    names = dict.fromkeys(name for result in results for name in _estimates(result))
    series = {
        name: [e for r in results if (e := _estimates(r).get(name)) is not None and is_sound(e)]
        for name in names
    }
    tested = max(sum(len(known) > 1 for known in series.values()), 1)
    return {name: _variance(known, level / tested) for name, known in series.items()}


def _variance(known: Sequence[Estimate], level: float) -> float:
    if len(known) < FEWEST:
        return 0.0
    found = [(_value(a) - _value(b)) ** 2 for a, b in pairwise(known)]
    own = [_std(a) ** 2 + _std(b) ** 2 for a, b in pairwise(known)]
    freedom = max(_FREEDOM * len(found), 1.0)
    caution = (student_limit(freedom, level) / normal_limit(level)) ** 2
    middle = normal_limit(0.5) ** 2  # the median of chi squared with one degree of freedom
    return max(0.5 * (caution * median(found) / middle - median(own)), 0.0)


def result_of(row: Row) -> Result:
    """A row of the table as a result, without what the table does not hold."""

    def estimates(known: Mapping[str, Parameter]) -> dict[str, Estimate]:
        return {
            name: _estimate(row[name], parameter.sign == "not negative")
            for name, parameter in known.items()
            if row[name] is not None
        }

    return Result(
        verdict=row["verdict"],
        reasons=tuple(row["reasons"] or ()),
        source=row["path"],
        vehicle={key: row[key] for key in ("sysid", "compid", "autopilot")},
        scale=_scale(row["scale"]),
        rotor_input=row["rotor_input"],
        parameters=estimates(PARAMETERS),
        estimator=row["estimator"],
        timing=estimates(TIMING),
    )


def _estimate(entry: dict[str, Any], not_negative: bool) -> Estimate:
    return Estimate(
        entry["value"],
        entry["std"],
        entry["unit"],
        entry["status"],
        rests_on=entry["rests_on"],
        std_given=entry.get("std_given") or 0.0,
        not_negative=not_negative,
    )


def _scale(entry: dict[str, Any] | None) -> Scale | None:
    if entry is None:
        return None
    return Scale(entry["anchor"], entry["value"], entry["unit"], entry["std"] or 0.0)


def predicted(flights: Sequence[Result], scatter: Scatter) -> Result:
    """Prediction for the next flight of an unchanged vehicle.

    Args:
        flights: at least one.
        scatter: between flights.

    Returns:
        The last one's result with the values expected, and their standard deviations with the
        scatter in them.
    """
    last = flights[-1]
    source = f"{len(flights)} flights from {flights[0].source} to {last.source}"
    names = dict.fromkeys(name for flight in flights for name in _estimates(flight))
    expected = {}
    for name in names:
        known = [_estimates(flight)[name] for flight in flights if name in _estimates(flight)]
        sound = [estimate for estimate in known if is_sound(estimate)]
        expected[name] = known[-1]
        if sound:
            value, variance = mean(sound, scatter[name])
            std = math.sqrt(variance + scatter[name])
            expected[name] = replace(sound[-1], value=value, std=std, std_given=0.0)
    return replace(
        last,
        source=source,
        parameters={name: e for name, e in expected.items() if name in PARAMETERS},
        timing={name: e for name, e in expected.items() if name in TIMING},
    )


def _estimates(result: Result) -> dict[str, Estimate]:
    return result.parameters | result.timing


def is_sound(estimate: Estimate) -> bool:
    """Whether a flight alone determines the parameter well."""
    return (
        estimate.status in ("identified", "zero")
        and estimate.value is not None
        and bool(estimate.std_data)
        and estimate.rests_on is None
    )


def mean(sound: Sequence[Estimate], between: float) -> tuple[float, float]:
    """Weighted mean of sound estimates and its variance.

    Args:
        sound: at least one.
        between: variance between flights.
    """
    weights = [1.0 / (_std(estimate) ** 2 + between) for estimate in sound]
    total = sum(weights)
    value = sum(w * _value(e) for w, e in zip(weights, sound, strict=True)) / total
    return value, 1.0 / total


def _value(estimate: Estimate) -> float:
    return math.nan if estimate.value is None else estimate.value


def _std(estimate: Estimate) -> float:
    # What was given is wrong by as much in every flight.
    return math.nan if estimate.std_data is None else estimate.std_data
