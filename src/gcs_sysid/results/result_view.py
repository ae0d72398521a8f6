"""What a person is shown of a result: figures, rows, verdict, notes.

Terminal, screen, page, report and notebook draw what is made here; type, color and width are
theirs, but for the table in lines of text. A `Notation` says how numbers and units are written
there.
"""

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import CORE_OF, INERTIA, REGISTRY, Parameter, grouped
from gcs_sysid.results.result_data import ResultData, Scale
from gcs_sysid.results.words import (
    PAGE,
    PLAIN,
    STATUS,
    WAITING,
    Notation,
    decimals_for,
    event_text,
    percent_column,
    rounded,
    scaled_unit,
    significant,
    times_power,
)
from gcs_sysid.significance import Z95


@dataclass(frozen=True)
class Figures:
    """An estimate in figures.

    Attributes:
        kind: what is known: nothing, a limit of a value consistent with zero, an exact value, or
            one with its interval.
        value: the number; a sign where nothing is known, `~0` beside a limit.
        half: of the 95 % interval, or the limit; empty without one.
        percent: the half over the value; empty without one.
        unit: SI.
        exponent: power of ten of value and half.
        by_size: whether that power goes by the size of the value.
        interval: its two ends, on a power of their own; empty without one.
        notation: that it is written in.
    """

    kind: Literal["nothing", "limit", "exact", "interval"]
    value: str
    half: str = ""
    percent: str = ""
    unit: str = ""
    exponent: int = 0
    by_size: bool = True
    interval: str = ""
    notation: Notation = PLAIN

    @property
    def scaled_unit(self) -> str:
        """The unit with its power of ten: `mm`, `10⁻³ kg m²`."""
        return self.notation.unit(self.unit, self.exponent)

    @property
    def limit(self) -> str:
        """What stands behind the `~0` of a limit."""
        return f"(< {f'{self.half} {self.scaled_unit}'.rstrip()})"

    @property
    def half_text(self) -> str:
        """The half for a column: a limit in brackets, the sign where nothing is known."""
        if self.kind == "nothing":
            return self.value
        return f"(< {self.half})" if self.kind == "limit" else self.half

    @property
    def short(self) -> str:
        """Value and relative interval: `0.016553 ±0.49 %`, `~0 (< 0.00021)`, `-`."""
        if self.kind == "interval":
            return f"{self.value} ±{self.percent}"
        return f"{self.value} {self.half_text}" if self.kind == "limit" else self.value

    @property
    def measure(self) -> str:
        """Value, interval and unit: `(16.55 ± 0.08) × 10⁻³ kg m²`, `~0 (< 0.21 mm)`."""
        if self.kind == "limit":
            return f"{self.value} {self.limit}"
        both = f"{self.value} ± {self.half}" if self.half else self.value
        power = times_power(self.exponent) if self.by_size else ""
        if power:
            return f"({both}){power} {self.notation.unit(self.unit)}".rstrip()
        return f"{both} {self.scaled_unit}".rstrip()


def figures(
    estimate: Estimate | None,
    notation: Notation = PLAIN,
    *,
    exponent: int | None = None,
    digits: int = 6,
) -> Figures:
    """An estimate as people read it: rounded to its interval, nothing where it is unobservable.

    Args:
        estimate: None: not in the result.
        notation: of numbers and units.
        exponent: power of ten; None: SI, or by the size where powers are raised.
        digits: of the value at most, where powers are not raised.
    """
    if estimate is None or not estimate.shown or estimate.value is None or estimate.std is None:
        return Figures("nothing", notation.nothing, notation=notation)
    value, half, unit = estimate.value, estimate.half or 0.0, estimate.unit
    interval = _interval(value, half, estimate.ci95, notation)
    if estimate.limit is None:
        written = number_figures(value, half, unit, notation, exponent=exponent, digits=digits)
        return replace(written, interval=interval)
    limit = estimate.limit * 10.0 ** -(exponent or 0)
    by_size = exponent is None or not notation.raised
    text = notation.number(limit, 2) if by_size else notation.fixed(limit, decimals_for(limit))
    return Figures(
        "limit", "~0", text, "", unit, exponent or 0, exponent is None, interval, notation
    )


def number_figures(
    value: float,
    half: float,
    unit: str,
    notation: Notation = PLAIN,
    *,
    exponent: int | None = None,
    digits: int = 6,
) -> Figures:
    """A number with the half of its 95 % interval, 0 if it is exact, whatever its status.

    Arguments are SI; the others are as of `figures`.
    """
    power = exponent or 0
    scaled, around = value * 10.0**-power, half * 10.0**-power
    if not half:
        text = notation.number(scaled, 6) if notation.raised else rounded(scaled, None, digits)
        return Figures("exact", text, "", "", unit, power, exponent is None, "", notation)
    share = half / abs(value) if value else math.nan
    if not notation.raised:
        texts = rounded(scaled, around, digits), significant(around, 2), percent_column(share)
    else:
        number, half_text, _, power = notation.value_and_half(value, half, exponent)
        texts = number, half_text, notation.percent(share)
    return Figures("interval", *texts, unit, power, exponent is None, "", notation)


def _interval(
    value: float, half: float, ends: tuple[float, float] | None, notation: Notation
) -> str:
    """The ends of a 95 % interval, with the decimals of its half."""
    if not half or ends is None:
        return ""
    _, _, power, exponent = notation.value_and_half(value, half)
    scale = 10.0**-exponent
    decimals = decimals_for(scale * half, scale * abs(value))
    low, high = (notation.fixed(scale * end, decimals) for end in ends)
    return f"{low} … {high}{power}"


@dataclass(frozen=True)
class ParameterRow:
    """What tables say of one parameter.

    Attributes:
        parameter: which.
        estimate: in SI.
        figures: value and interval.
        unit: of the figures, as a program writes it: `kg m^2`, `ms`.
        status: the status, or `waiting` before there are data.
        sign: of it.
        hint: what it means, and what improves it while there is more to fly.
        source: what the estimate is based on, or what it needs.
        given_half: half of the 95 % interval by what was given alone, SI; None without any.
        bound_half: the same of the Cramér-Rao bound.
        truth: SI; None: unknown.
        error: relative, of what is shown; None where the truth is not known, or zero.
    """

    parameter: Parameter
    estimate: Estimate
    figures: Figures
    unit: str
    status: str
    sign: str
    hint: str
    source: str
    given_half: float | None = None
    bound_half: float | None = None
    truth: float | None = None
    error: float | None = None

    @property
    def name(self) -> str:
        """Of the parameter, as in the result's file."""
        return self.parameter.name


def rows(result: ResultData) -> list[tuple[Parameter, Estimate]]:
    """The parameters and timing values of a result, in the order of all tables."""
    there = result.estimates
    return [(p, there[name]) for name, p in REGISTRY.items() if name in there]


def parameter_rows(
    result: ResultData,
    notation: Notation = PLAIN,
    *,
    si: bool = False,
    digits: int = 6,
    truth: Mapping[str, float] | None = None,
    waiting: bool = False,
    ended: bool = False,
) -> list[ParameterRow]:
    """The parameters and timing values of a result, in the order of all tables.

    Args:
        result: theirs.
        notation: of numbers and units.
        si: whether units that people read on a power of ten, as ms, are left in SI.
        digits: of a value, at most, where powers are not raised.
        truth: name -> true value.
        waiting: whether what is not observable may still become so by flying.
        ended: whether the flight is over, so that there is nothing more to fly.
    """
    out = []
    for parameter, estimate in rows(result):
        exponent = None if si else parameter.exponent
        unit = estimate.unit if exponent is None else scaled_unit(estimate.unit, exponent)
        unknown = waiting and estimate.status == "unobservable"
        word = WAITING if unknown else STATUS[estimate.status]
        true, error = (truth or {}).get(parameter.name), None
        if true and estimate.shown and estimate.value is not None:
            error = estimate.value / true - 1.0
        out.append(
            ParameterRow(
                parameter,
                estimate,
                figures(estimate, notation, exponent=exponent, digits=digits),
                unit,
                WAITING.meaning if unknown else estimate.status or "",
                word.sign,
                word.meaning if ended else word.with_advice,
                source_of(parameter, estimate, result.scale),
                Z95 * estimate.std_given if estimate.std_given and estimate.shown else None,
                Z95 * estimate.bound if estimate.bound else None,
                true,
                error,
            )
        )
    return out


def source_of(parameter: Parameter, estimate: Estimate, scale: Scale | None) -> str:
    """What an estimate is based on, or what it needs."""
    if estimate.status == "given":
        return "given: sets the scale"
    if estimate.rests_on:
        return f"mostly from {estimate.rests_on}"
    if estimate.status == "unobservable":
        return f"needs {parameter.excited_by}"
    if scale is not None and parameter.name == scale.anchor and scale.origin:
        return f"from {scale.origin}"
    return parameter.excited_by


def exponent_key(parameter: Parameter) -> str:
    """What shares one power of ten: a unit; a rotor's inertia is too small for the body's."""
    body = INERTIA if parameter.unit == REGISTRY["Ixx"].unit else ()
    return parameter.name if body and parameter.name not in body else parameter.unit


# The verdict ------------------------------------------------------------------------------------


def names_text(names: Sequence[str]) -> str:
    """Names in a sentence."""
    if len(names) < 2:
        return "".join(names)
    return ", ".join(names[:-1]) + " and " + names[-1]


def verdict_sentence(result: ResultData) -> str:
    """What is known, and how well, in words that a pilot understands."""
    if result.verdict == "refused":
        return "The vehicle cannot be identified from this recording."
    core = {n: e for n in CORE_OF[result.rotor_input] if (e := result.parameters.get(n))}
    known = _how_well(core)
    since = ""
    if result.segments:
        since = f"The vehicle changed at {result.segments[-1]['end']:.1f} s. Since then: "
    if result.verdict == "identified":
        word = "every" if since else "Every"
        return f"{since}{word} core parameter is known: {_listed(known)}."
    out = [f"{since}Known: {_listed(known)}."] if known else []
    for title, status in (("Weak", "weak"), ("Not observable from this flight", "unobservable")):
        names = [_roughly(n, estimate) for n, estimate in core.items() if estimate.status == status]
        out += [f"{title}: {names_text(names)}."] if names else []
    return " ".join(out)


def _roughly(name: str, estimate: Estimate) -> str:
    """A parameter, and how well it is known where that is better than nothing."""
    if REGISTRY[name].sign == "any" or not estimate.shown or not (estimate.value and estimate.half):
        return name
    share = estimate.half / abs(estimate.value)
    return f"{name} (±{PAGE.space}{PAGE.percent(share)})" if share < 1.0 else name


def said_in_sentence(reason: str) -> bool:
    """Whether `verdict_sentence` says what a reason of the result does."""
    return reason.startswith(("not observable from this flight: ", "weak: "))


def _listed(known: Sequence[str]) -> str:
    """Words in a sentence; the first says what the numbers are."""
    return ", ".join([f"{known[0]} (95{PAGE.space}% intervals)", *known[1:]])


def _how_well(core: Mapping[str, Estimate]) -> list[str]:
    """How well groups of core parameters are known."""
    out: list[str] = []
    for group in dict.fromkeys(REGISTRY[name].group for name in core):
        names = [name for name in core if REGISTRY[name].group == group]
        entries = {n: core[n] for n in names if core[n].status in ("identified", "zero")}
        if not entries or (group == "products of inertia" and not out):
            continue  # of unknown moments a share says nothing
        subject = group if len(entries) == len(names) else names_text(list(entries))
        out.append(f"{subject} to within {_within(REGISTRY[names[0]], entries, core)}")
    return out


def _within(first: Parameter, entries: Mapping[str, Estimate], core: Mapping[str, Estimate]) -> str:
    """The widest half interval of a group, against what it is measured by."""
    halves = [(e.half or 0.0, abs(e.value or 0.0)) for e in entries.values()]
    widest = max(half for half, _ in halves)
    if first.sign != "any":
        return PAGE.percent(max(half / size if size else math.inf for half, size in halves))
    if {e.unit for e in entries.values()} == {"m/m"}:
        return f"{PAGE.percent(widest)} of the arm"
    if first.unit == "m":
        millimeters = max(1e3 * widest, 0.01)
        return f"{PAGE.fixed(millimeters, decimals_for(millimeters))}{PAGE.space}mm"
    # Near zero a share of itself says nothing.
    moments = [core[n].value for n in grouped("moments of inertia") if n in core]
    least = min((m for m in moments if m), default=math.inf)
    return f"{PAGE.percent(widest / least)} of the moments"


# Notes ------------------------------------------------------------------------------------------


def result_notes(result: ResultData) -> list[str]:
    """What is worth knowing beside the numbers, a line each; the reasons come last."""
    leaning: dict[str, list[str]] = {}
    for name, estimate in result.parameters.items():
        if estimate.rests_on:
            leaning.setdefault(estimate.rests_on, []).append(name)
    notes = [f"{', '.join(names)}: mostly from {what}" for what, names in leaning.items()]
    notes += _event_notes(result.events)
    telemetry = result.telemetry
    if volts := telemetry.get("thrust_voltage"):
        notes.append(
            f"T_max refers to {volts:.1f} V, the battery voltage at the start of the flight"
        )
    if spikes := telemetry.get("imu_outliers", {}).get("spikes", 0):
        were = "spike was" if spikes == 1 else "spikes were"
        notes.append(f"{spikes} gyro {were} replaced by interpolation")
    if found := telemetry.get("rotor_input", {}).get("gyro_filter_found"):
        notes.append(
            f"the gyro is low-passed, late as by a filter of {found:.0f} Hz, and is treated so; "
            "declare [imu] gyro_filter in the airframe file"
        )
    if result.estimator == "offline":
        notes.insert(0, f"offline estimate: {result.method or 'prediction error'}")
    return [*notes, *result.reasons]


def _event_notes(events: Sequence[Mapping[str, Any]], most: int = 3) -> list[str]:
    """What affects the numbers, a line each; more than `most` disturbances make one line."""
    listed = [e for e in events if "detected" in e or e["kind"] in ("rotor_input", "senders")]
    passed = [e for e in listed if e["kind"] == "disturbance" and not e.get("undecided")]
    many = passed if len(passed) > most else []
    notes = [f"{e['t']:.2f} s: {event_text(e)}" for e in listed if e not in many]
    if many:
        notes.append(f"{len(many)} disturbances; the vehicle is unchanged")
    return notes


class _Style(NamedTuple):
    digits: int
    gap: int
    """Spaces between columns."""
    without: frozenset[str]
    """Columns left out."""


_GIVEN = "given 95 %"
_STYLES = (
    _Style(6, 2, frozenset()),
    _Style(6, 2, frozenset({"%"})),
    _Style(5, 1, frozenset({"%"})),
    _Style(5, 1, frozenset({"%", _GIVEN})),
    _Style(5, 1, frozenset({"%", _GIVEN, "bound 95 %"})),
    _Style(4, 1, frozenset({"%", _GIVEN, "bound 95 %"})),
)
"""The roomiest first."""


def result_table(
    result: ResultData, truth: Mapping[str, float] | None = None, width: int | None = None
) -> str:
    """The result as lines of text, with truth and error where truth is known.

    `width` is columns to keep to, from 80 on; what is least needed is left out then. None: no
    limit.
    """
    if (
        result.verdict == "refused"
        and not result.vehicle
        and not any(
            estimate.shown and estimate.status != "given" for estimate in result.parameters.values()
        )
    ):
        return "\n".join([f"nothing identified from {result.source}", *result.reasons])
    lines = [f"{result.verdict}: {result.source}", *_scale_lines(result), ""]
    for style in _STYLES:
        rows = _rows(result, truth, style)
        if width is None or max(map(len, rows)) <= width:
            break
    lines += rows
    notes = result_notes(result)
    if _GIVEN in rows[0]:
        notes.insert(0, f"{_GIVEN}: the part of ± due to errors of the given arm, scale and IMU, "
                     "which no flight reduces")  # fmt: skip
    if notes:
        lines.append("")
    for note in notes:
        wrapped = [note] if width is None else textwrap.wrap(note, width - 2)
        lines += [f"{'  ' if i else '- '}{line}" for i, line in enumerate(wrapped)]
    return "\n".join(lines)


def _rows(result: ResultData, truth: Mapping[str, float] | None, style: _Style) -> list[str]:
    rows = parameter_rows(result, si=True, digits=style.digits, truth=truth)
    rows = [row for row in rows if row.name in result.parameters]
    columns: dict[str, list[str]] = {
        "parameter": [row.name for row in rows],
        "value": [row.figures.value for row in rows],
        "± 95 %": [row.figures.half_text for row in rows],
        "%": [
            row.figures.value
            if row.figures.kind == "nothing"
            else row.figures.percent.removesuffix(" %")
            for row in rows
        ],
    }
    if any(row.estimate.std_given for row in rows):
        columns[_GIVEN] = [significant(row.given_half, 2) if row.given_half else "" for row in rows]
    columns |= {"unit": [row.unit for row in rows], "status": [row.status for row in rows]}
    if any(row.estimate.bound is not None for row in rows):
        columns["bound 95 %"] = [PLAIN.number(row.bound_half, 2) for row in rows]
    if truth:
        columns["truth"] = [rounded(row.truth, None, style.digits) for row in rows]
        errors = [percent_column(row.error, signed=True).removesuffix(" %") for row in rows]
        columns["error %"] = [error or "-" for error in errors]
    kept = {head: cells for head, cells in columns.items() if head not in style.without}
    padded = [_column(head, cells) for head, cells in kept.items()]
    gap = " " * style.gap
    return [gap.join(row).rstrip() for row in zip(*padded, strict=True)]


def _column(head: str, cells: Sequence[str]) -> list[str]:
    """Head and cells in one width, words to the left and numbers to the right."""
    wide = max(map(len, (head, *cells)))
    side = "<" if head in ("parameter", "unit", "status") else ">"
    return [f"{cell:{side}{wide}}" for cell in (head, *cells)]


def _scale_lines(result: ResultData) -> list[str]:
    """What sets the scale, where it is not simply the mass or k_T given."""
    scale = result.scale
    if scale is None or not (scale.origin or scale.anchor == "added_mass"):
        return []
    source = f" from {scale.origin}" if scale.origin else ""
    return [f"scale: {scale.anchor} = {scale.value:.6g} {scale.unit}{source}"]
