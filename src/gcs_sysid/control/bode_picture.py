"""Bode diagram of the loops as SVG, complete, with the band of the covariance.

Every axis has a column: magnitude above, phase below, of the loop broken at the axis' torque with
the attitude loop closed. The band holds 95 % of the draws.
"""

import math
from collections.abc import Iterator

import numpy as np

from gcs_sysid.control.loop_margins import frequencies, open_loops
from gcs_sysid.control.rate_loops import AXES, RateLoop
from gcs_sysid.control.tuning_study import BAND, Tuning
from gcs_sysid.report.markup import Markup, element, joined

_COLUMN, _UPPER, _LOWER, _LEFT, _TOP, _GAP = 300.0, 190.0, 170.0, 58.0, 66.0, 26.0
_LOW, _HIGH = 0.5, 300.0
"""rad/s, shown."""
_DECIBELS, _DEGREES = (-40.0, 40.0), (-270.0, -90.0)
_STROKES = {"now": "#c2571a", "proposed": "#1f6fb4"}
_POINTS = 160


def bode_svg(tuning: Tuning) -> str:
    """The diagram of the gains now and proposed."""
    width = _LEFT + 3 * (_COLUMN + _GAP)
    height = _TOP + _UPPER + _GAP + _LOWER + 60.0
    parts: list[str] = [
        element("rect", width="100%", height="100%", fill="#fff"),
        _text(
            _LEFT, 22.0, f"Loops of {tuning.vehicle.name} with {tuning.proposed.autopilot}", size=16
        ),
    ]
    for i, (name, stroke) in enumerate((n, _STROKES[n]) for n in tuning.studies):
        parts.append(
            _text(_LEFT + 180.0 * i, 42.0, f"{name} (band: 95 % of the interval)", fill=stroke)
        )
    for axis in range(3):
        parts += _grid(axis)
    for name, loop in tuning.loops.items():
        parts += _curves(tuning, loop, _STROKES[name])
    body = joined(*(Markup(part) for part in parts))
    picture = element(
        "svg",
        body,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {width:.0f} {height:.0f}",
        font_family="sans-serif",
        font_size="12",
        fill="#222",
    )
    return picture + "\n"


def _curves(tuning: Tuning, loop: RateLoop, stroke: str) -> Iterator[str]:
    omega = frequencies(loop, _POINTS)
    omega = omega[(omega >= _LOW) & (omega <= _HIGH)]
    loops = open_loops(tuning.dynamics, loop, omega)
    for axis in range(3):
        own = loops[:, :, axis]
        size = 20.0 * np.log10(np.maximum(np.abs(own), 1e-9))
        first = np.angle(own[:, :1])
        first = np.where(first > 1e-6, first - 2.0 * np.pi, first)
        phase = np.degrees(np.unwrap(np.angle(own), axis=1) - np.angle(own[:, :1]) + first)
        for values, place in ((size, _upper), (phase, _lower)):
            low, high = np.percentile(values, BAND, axis=0)
            band = [*zip(omega, high, strict=True), *zip(omega[::-1], low[::-1], strict=True)]
            yield element(
                "polygon", points=_points(axis, band, place), fill=stroke, fill_opacity="0.2"
            )
            line = list(zip(omega, values[0], strict=True))
            yield element(
                "polyline",
                points=_points(axis, line, place),
                fill="none",
                stroke=stroke,
                stroke_width="1.5",
            )


def _x(axis: int, omega: float) -> float:
    share = math.log(omega / _LOW) / math.log(_HIGH / _LOW)
    return _LEFT + axis * (_COLUMN + _GAP) + share * _COLUMN


def _upper(decibels: float) -> float:
    low, high = _DECIBELS
    return _TOP + _UPPER * (high - min(max(decibels, low), high)) / (high - low)


def _lower(degrees: float) -> float:
    low, high = _DEGREES
    share = (high - min(max(degrees, low), high)) / (high - low)
    return _TOP + _UPPER + _GAP + _LOWER * share


def _points(axis: int, pairs: list[tuple[float, float]], place: object) -> str:
    assert callable(place)
    return " ".join(f"{_x(axis, float(w)):.1f},{place(float(v)):.1f}" for w, v in pairs)


def _grid(axis: int) -> Iterator[str]:
    left, right = _x(axis, _LOW), _x(axis, _HIGH)
    yield _text(left, _TOP - 4.0, AXES[axis])
    for decibels in range(-40, 41, 20):
        yield _line(left, _upper(decibels), right, _upper(decibels), bold=decibels == 0)
        if axis == 0:
            yield _text(left - 8.0, _upper(decibels) + 4.0, f"{decibels} dB", anchor="end")
    for degrees in range(-270, -89, 45):
        yield _line(left, _lower(degrees), right, _lower(degrees), bold=degrees == -180)
        if axis == 0:
            yield _text(left - 8.0, _lower(degrees) + 4.0, f"{degrees}°", anchor="end")
    bottom = _TOP + _UPPER + _GAP + _LOWER
    for omega in (1.0, 10.0, 100.0):
        x = _x(axis, omega)
        yield _line(x, _TOP, x, _TOP + _UPPER)
        yield _line(x, _TOP + _UPPER + _GAP, x, bottom)
        yield _text(x, bottom + 16.0, f"{omega:g}", anchor="middle")
    yield _text(0.5 * (left + right), bottom + 34.0, "rad/s", anchor="middle")


def _line(x1: float, y1: float, x2: float, y2: float, *, bold: bool = False) -> Markup:
    return element(
        "line",
        x1=f"{x1:.1f}",
        y1=f"{y1:.1f}",
        x2=f"{x2:.1f}",
        y2=f"{y2:.1f}",
        stroke="#555" if bold else "#ddd",
    )


def _text(
    x: float, y: float, text: str, *, anchor: str = "start", size: int = 12, fill: str = "#222"
) -> Markup:
    return element(
        "text",
        text,
        x=f"{x:.1f}",
        y=f"{y:.1f}",
        text_anchor=anchor,
        font_size=str(size),
        fill=fill,
    )
