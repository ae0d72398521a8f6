"""A parameter over a vehicle's flights, as a drawing that needs no script."""

import math
from collections.abc import Callable, Sequence

from gcs_sysid.fleet.trend import Flight, Vehicle, is_sound, mean
from gcs_sysid.model.parameters import PARAMETERS
from gcs_sysid.report.markup import Markup, element
from gcs_sysid.results.number_format import PAGE, power_of_ten, times_power
from gcs_sysid.results.result import Estimate

_Axis = Callable[[float], float]

WIDTH, HEIGHT = 360, 190
_LEFT, _RIGHT, _TOP, _BOTTOM = 56, WIDTH - 10, 18, HEIGHT - 28


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
