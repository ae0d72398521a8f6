"""A fleet's vehicles over their flights, and where one changed from its earlier flights.

Flights of one vehicle differ by more than each flight's own uncertainty: air, battery, wind. That
scatter is learnt from the flights themselves (DerSimonian and Laird 1986), so a new flight is
compared with what the earlier ones predict for it, not with their mean alone.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from gcs_sysid.fleet.table import Row
from gcs_sysid.model.parameters import PARAMETERS, TIMING
from gcs_sysid.session.comparison import LEVEL, Comparison, Difference, compare
from gcs_sysid.session.result import Estimate, Result, Scale


@dataclass(frozen=True)
class Change:
    """A flight that differs from those before it.

    Attributes:
        first: number of the first flight compared with, from 1.
        last: of the last.
        comparison: of what these predict (A) with the flight (B).
        differences: those that count, reckoning with all flights and parameters looked at.
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
        result: what the row tells of the vehicle.
        change: from the flights before, if there was one.
    """

    number: int
    row: Row
    result: Result
    change: Change | None


@dataclass(frozen=True)
class Vehicle:
    """A vehicle's flights in the order of time."""

    name: str
    flights: tuple[Flight, ...]

    @property
    def changed(self) -> list[Flight]:
        """Flights at which it had changed."""
        return [flight for flight in self.flights if flight.change is not None]

    @property
    def eras(self) -> list[tuple[Flight, ...]]:
        """Flights between changes."""
        cuts = [0, *(flight.number - 1 for flight in self.changed), len(self.flights)]
        return [self.flights[a:b] for a, b in pairwise(cuts) if b > a]


def vehicles_of(rows: Iterable[Row]) -> tuple[list[Vehicle], list[Row]]:
    """Sort a table's rows into vehicles and their flights.

    Flights come in the order in which they were recorded; those that do not tell come last, by
    path. A log that is there twice counts once.

    Returns:
        Vehicles by name, and the rows of logs that tell nothing of any.
    """
    flights: dict[str, dict[str, Row]] = {}
    unused = []
    for row in sorted(rows, key=_when):
        if row["vehicle"] is None or row["verdict"] in (None, "refused"):
            unused.append(row)
        else:
            flights.setdefault(row["vehicle"], {}).setdefault(row["sha256"], row)
    return [_vehicle(name, list(flights[name].values())) for name in sorted(flights)], unused


def _when(row: Row) -> tuple[bool, float, str]:
    recorded = row["recorded"]
    return recorded is None, recorded.timestamp() if recorded else 0.0, row["path"]


def _vehicle(name: str, rows: Sequence[Row]) -> Vehicle:
    flights: list[Flight] = []
    earlier: list[Result] = []
    level = LEVEL / max(len(rows) - 1, 1)
    for number, row in enumerate(rows, 1):
        result, change = result_of(row), None
        if earlier:
            last = number - 1
            first = number - len(earlier)
            comparison = compare(predicted(earlier), result)
            found = tuple(
                difference
                for difference in comparison.differences.values()
                if difference.p_holm is not None and difference.p_holm < level
            )
            if found:
                change = Change(first, last, comparison, found)
                earlier = []
        earlier.append(result)
        flights.append(Flight(number, row, result, change))
    return Vehicle(name, tuple(flights))


def result_of(row: Row) -> Result:
    """A row of the table as a result, without what the table does not hold."""

    def estimates(known: Iterable[str]) -> dict[str, Estimate]:
        return {name: _estimate(row[name]) for name in known if row[name] is not None}

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


def _estimate(entry: dict[str, Any]) -> Estimate:
    return Estimate(
        entry["value"], entry["std"], entry["unit"], entry["status"], rests_on=entry["rests_on"]
    )


def _scale(entry: dict[str, Any] | None) -> Scale | None:
    if entry is None:
        return None
    return Scale(entry["anchor"], entry["value"], entry["unit"], entry["std"] or 0.0)


def predicted(flights: Sequence[Result]) -> Result:
    """What flights of a vehicle that stays as it is predict for one more.

    Args:
        flights: at least one.

    Returns:
        The last one's result with the values expected, and their standard deviations with the
        scatter between flights in them.
    """
    last = flights[-1]
    source = f"{len(flights)} flights from {flights[0].source} to {last.source}"

    def table(kind: str) -> dict[str, Estimate]:
        tables: list[dict[str, Estimate]] = [getattr(flight, kind) for flight in flights]
        names = dict.fromkeys(name for known in tables for name in known)
        return {name: _pooled([known[name] for known in tables if name in known]) for name in names}

    return replace(last, source=source, parameters=table("parameters"), timing=table("timing"))


def _pooled(estimates: Sequence[Estimate]) -> Estimate:
    """The estimate that is expected next; the last one where there is nothing to put together."""
    sound = [e for e in estimates if is_sound(e)]
    if not sound:
        return estimates[-1]
    value, std, scatter = pool(sound)
    return replace(sound[-1], value=value, std=math.hypot(std, scatter), bound=None)


def is_sound(estimate: Estimate) -> bool:
    """Whether a flight itself tells the parameter well."""
    return (
        estimate.status == "identified"
        and estimate.value is not None
        and bool(estimate.std)
        and estimate.rests_on is None
    )


def pool(estimates: Sequence[Estimate]) -> tuple[float, float, float]:
    """Sound estimates of one thing that scatters from flight to flight.

    Returns:
        Their mean, its standard deviation, and the scatter's, after DerSimonian and Laird,
        "Meta-analysis in clinical trials", 1986.
    """
    known = [(e.value or 0.0, (e.std or 0.0) ** 2) for e in estimates]
    mean, precision = _mean(known)
    # Precisions by their sum: sums of squares of tiny variances' inverses need not overflow.
    weights = [1.0 / variance / precision for _, variance in known]
    misfit = precision * sum(w * (v - mean) ** 2 for w, (v, _) in zip(weights, known, strict=True))
    free = precision * (1.0 - sum(w * w for w in weights))
    between = max((misfit - (len(known) - 1)) / free, 0.0) if len(known) > 1 else 0.0
    mean, precision = _mean([(value, variance + between) for value, variance in known])
    return mean, math.sqrt(1.0 / precision), math.sqrt(between)


def _mean(known: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Weighted mean of (value, variance), and its precision."""
    precision = sum(1.0 / variance for _, variance in known)
    return sum(value / variance for value, variance in known) / precision, precision
