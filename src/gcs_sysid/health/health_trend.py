"""Several flights of one vehicle: what its CG, shares, throttle and thrust coefficient do.

What is assumed of rotors and places is the same in every flight and cancels, so that flights are
compared by what each scatters by itself.
"""

import math
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

import numpy as np

from gcs_sysid.health.health_file import condition_text
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.health.vehicle_health import Health
from gcs_sysid.model.estimate import Quantity
from gcs_sysid.results.words import PLAIN, power_of_ten, times_power
from gcs_sysid.significance import FALSE_ALARM_RATE, Z95, holm, student_chance, student_limit

_SHARE = "share of rotor "
_FEWEST = 3
"""Flights that show a trend."""
_SIDE_BY_SIDE = 4
"""Rotors whose shares have room for their intervals."""
_NAME = 24
"""Columns of a log's name; its end says most."""


@dataclass(frozen=True)
class Series:
    """A number over flights.

    Attributes:
        name: of it.
        unit: of `values`, for people.
        values: of each flight; NaN where there is none.
        stds: of each by its own scatter alone.
    """

    name: str
    unit: str
    values: tuple[float, ...]
    stds: tuple[float, ...]

    @property
    def known(self) -> int:
        """Flights that have a value."""
        return int(np.isfinite(self.values).sum())

    def in_power(self) -> "Series":
        """The same in a power of ten that leaves digits before the point."""
        largest = max((abs(v) for v in self.values if math.isfinite(v)), default=0.0)
        power = power_of_ten(largest)
        if not power or 1e-3 < largest < 1e4:
            return self
        factor = 10.0**-power
        unit = f"{times_power(power).strip(' ×')} {self.unit}"
        values, stds = (tuple(factor * x for x in part) for part in (self.values, self.stds))
        return replace(self, unit=unit, values=values, stds=stds)

    def slope(self) -> tuple[float, float]:
        """Change from flight to flight and its standard deviation, by weighted least squares.

        Scatter beyond the flights' own, which weather makes, widens it (Birge's ratio).

        Raises:
            ValueError: fewer than three flights have a value.
        """
        v, s = np.array(self.values), np.array(self.stds)
        there = np.isfinite(v) & np.isfinite(s)
        n = int(there.sum())
        if n < 3:
            raise ValueError(f"{n} flights show no trend")
        v, s = v[there], np.maximum(s[there], 1e-12)
        columns = np.column_stack([np.ones(n), np.flatnonzero(there)]) / s[:, None]
        covariance = np.linalg.inv(columns.T @ columns)
        fit = covariance @ columns.T @ (v / s)
        left = float(np.sum((v / s - columns @ fit) ** 2)) / (n - 2)
        return float(fit[1]), math.sqrt(float(covariance[1, 1]) * max(left, 1.0))


def series_of(flights: Sequence[Health]) -> list[Series]:
    """Results of one vehicle's flights, in their order; only those that hovered count."""
    usable = [health for health in flights if health.available]
    if not usable:
        return []
    centers = _in_one_wind(usable)
    places = [
        _series(f"CG {way}", "mm", 1e3, [center[axis] for center in centers])
        for axis, way in ((0, "forward"), (1, "right"))
    ]
    names = {h.scale[0] for h in usable if h.scale is not None}
    scales = [
        _series(name, next(h.scale[1].unit for h in usable if h.scale and h.scale[0] == name), 1.0,
                [h.scale[1] if h.scale and h.scale[0] == name else None for h in usable])
        for name in sorted(names)
    ]  # fmt: skip
    throttle = _series("hover throttle", "%", 100.0, [h.hover_throttle for h in usable])
    yaw = _series("yaw imbalance", "%", 100.0, [h.yaw_imbalance for h in usable])
    count = max(len(h.rotors) for h in usable)
    shares = [
        _series(f"{_SHARE}{i + 1}", "%", 100.0,
                [h.rotors[i].thrust_share if i < len(h.rotors) else None for h in usable])
        for i in range(count)
    ]  # fmt: skip
    return [one for one in (*places, throttle, yaw, *scales, *shares) if one.known]


def _in_one_wind(flights: Sequence[Health]) -> list[tuple[Quantity, ...]]:
    """The CG of each flight in the mean wind of all.

    Drag moves the center of thrust by the same lever in every flight of a vehicle, and what the
    accelerometer is off level by is much the same in all: at one specific force, wind has no part
    in the differences. Thirds of a flight of a real 18 kg quad then agree to 2.7 mm, and to 9 mm as
    flown (`benchmarks.health_logs --part repeated`).
    """
    centers = [h.center for h in flights]
    places: list[tuple[Quantity, ...]] = [h.cg or () for h in flights]
    known = [center for center in centers if center is not None]
    if len(known) < max(len(flights), 2):
        return places
    stds = np.maximum([center.lever_std for center in known], 1e-9)
    weights = stds**-2.0
    total = weights.sum(axis=0)
    lever = (weights * [center.lever for center in known]).sum(axis=0) / total
    force = np.array([center.force for center in known])
    away = force - force.mean(axis=0)
    # A bias is another one after each start.
    moved = np.hypot(away / np.sqrt(total), lever * TUNING.accelerometer_std / math.sqrt(2.0))
    out = []
    for center, shift, std in zip(known, lever * away, moved, strict=True):
        values = center.at_force - shift
        both = zip(values.tolist(), np.hypot(center.scatter, std).tolist(), strict=True)
        out.append(tuple(Quantity(value, whole, "m") for value, whole in both))
    return out


def _series(name: str, unit: str, factor: float, usable: Sequence[Quantity | None]) -> Series:
    values, stds = [], []
    for quantity in usable:
        if quantity is None:
            values.append(math.nan)
            stds.append(math.nan)
            continue
        flown = math.sqrt(max(quantity.std**2 - quantity.std_given**2, 0.0))
        values.append(factor * quantity.value)
        stds.append(factor * flown)
    return Series(name, unit, tuple(values), tuple(stds))


def trend_text(flights: Sequence[Health]) -> list[str]:
    """The flights side by side and what changed, in lines; empty for less than two that hovered.

    Flights of other vehicles are left out.
    """
    # What is surely another vehicle is not one of its flights.
    usable = [health for health in flights if health.available and not health.apart]
    if len(usable) < 2:
        return []
    series = series_of(usable)
    lines = ["Over the flights (95 %, each by its own scatter; CG in their mean wind)", ""]
    names = [_short(health.source) for health in usable]
    for number, (name, health) in enumerate(zip(names, usable, strict=True), 1):
        lines.append(f"  {number:>2}  {name}, {health.seconds:.0f} s of hover")
    lines.append("")
    shares = [one for one in series if one.name.startswith(_SHARE)]
    lines += _table([one for one in series if one not in shares], 15)
    lines += ["", "      share of the thrust"]
    lines += _table(shares, 15 if len(shares) <= _SIDE_BY_SIDE else 9)
    changes = [
        *slopes(series),
        *(
            f"{name}: {condition_text(health.condition)}"
            for health, name in zip(usable[1:], names[1:], strict=True)
            if health.condition is not None and health.condition.verdict != "unchanged"
        ),
    ]
    for text in changes:
        lines += ["", *textwrap.wrap(text, 77, initial_indent="  ", subsequent_indent="    ")]
    return lines


def _table(series: Sequence[Series], width: int) -> Iterator[str]:
    """A row a flight; narrow columns have no intervals."""
    scaled = [one.in_power() for one in series]
    yield "      " + "".join(f"{one.name.replace(_SHARE, 'rotor '):>{width}}" for one in scaled)
    yield "      " + "".join(f"{one.unit:>{width}}" for one in scaled)
    for number in range(len(scaled[0].values)):
        cells = (_cell(one.values[number], one.stds[number], width) for one in scaled)
        yield f"  {number + 1:>2}  " + "".join(cells)


def _short(source: str) -> str:
    name = PurePath(source.replace("\\", "/")).name
    return name if len(name) <= _NAME else f"…{name[1 - _NAME :]}"


def _cell(value: float, std: float, width: int) -> str:
    if not math.isfinite(value):
        return f"{'-':>{width}}"
    text = f"{value:.1f}" if width < 12 else PLAIN.measure(value, Z95 * std, "").strip()
    return f"{text:>{width}}"


def slopes(series: Sequence[Series]) -> Iterator[str]:
    """The trends that are surely some, among all, in words."""
    steady = [one.in_power() for one in series if one.known >= _FEWEST]
    found = [one.slope() for one in steady]
    chances = [
        student_chance(slope / std, one.known - 2)
        for one, (slope, std) in zip(steady, found, strict=True)
    ]
    for one, (slope, std), chance in zip(steady, found, holm(chances), strict=True):
        if chance < FALSE_ALARM_RATE:
            half = student_limit(one.known - 2, 0.05) * std
            text = PLAIN.measure(slope, half, one.unit)
            yield f"{one.name} changes by {text} from flight to flight"
