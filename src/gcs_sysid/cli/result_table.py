"""A result as lines of text."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from gcs_sysid.intervals import Z95
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import PARAMETERS
from gcs_sysid.results.number_format import PLAIN, percent_column, rounded, significant
from gcs_sysid.results.result import Result
from gcs_sysid.results.words import event_text, shown


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
_MOST_LISTED = 3
"""Disturbances that are listed one by one."""
_LISTED = ("rotor_input", "senders")
"""Kinds of events beside changes of the vehicle that affect the numbers."""


def result_table(
    result: Result, truth: Mapping[str, float] | None = None, width: int | None = None
) -> str:
    """The result as lines of text, with truth and error where truth is known.

    Args:
        result: to show.
        truth: name -> true value.
        width: columns to keep to, from 80 on; what is least needed is left out then. None: no
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
    notes = _notes(result)
    if _GIVEN in rows[0]:
        notes.insert(0, f"{_GIVEN}: the part of ± due to errors of the given arm, scale and IMU, "
                     "which no flight reduces")  # fmt: skip
    if notes:
        lines.append("")
    for note in notes:
        wrapped = [note] if width is None else textwrap.wrap(note, width - 2)
        lines += [f"{'  ' if i else '- '}{line}" for i, line in enumerate(wrapped)]
    return "\n".join(lines)


def _rows(result: Result, truth: Mapping[str, float] | None, style: _Style) -> list[str]:
    names = list(result.parameters)
    estimates = list(result.parameters.values())
    cells = [shown(estimate, style.digits) for estimate in estimates]
    columns: dict[str, list[str]] = {
        "parameter": names,
        "value": [cell.value for cell in cells],
        "± 95 %": [cell.half for cell in cells],
        "%": ["-" if cell.value == "-" else cell.percent for cell in cells],
    }
    if any(e.std_given for e in estimates):
        columns[_GIVEN] = [
            significant(Z95 * e.std_given, 2) if e.std_given and e.shown else "" for e in estimates
        ]
    columns |= {
        "unit": [PARAMETERS[name].unit for name in names],
        "status": [e.status or "" for e in estimates],
    }
    if any(e.bound is not None for e in estimates):
        bounds = [Z95 * e.bound if e.bound else None for e in estimates]
        columns["bound 95 %"] = [PLAIN.number(bound, 2) for bound in bounds]
    if truth:
        true = [truth.get(name) for name in names]
        columns["truth"] = [rounded(value, None, style.digits) for value in true]
        columns["error %"] = [_error(e, t) for e, t in zip(estimates, true, strict=True)]
    kept = {head: cells for head, cells in columns.items() if head not in style.without}
    padded = [_column(head, cells) for head, cells in kept.items()]
    gap = " " * style.gap
    return [gap.join(row).rstrip() for row in zip(*padded, strict=True)]


def _column(head: str, cells: Sequence[str]) -> list[str]:
    """Head and cells in one width, words to the left and numbers to the right."""
    wide = max(map(len, (head, *cells)))
    side = "<" if head in ("parameter", "unit", "status") else ">"
    return [f"{cell:{side}{wide}}" for cell in (head, *cells)]


def _error(estimate: Estimate, true: float | None) -> str:
    if not estimate.shown or estimate.value is None or not true:
        return "-"
    return percent_column(estimate.value / true - 1.0, signed=True).removesuffix(" %")


def _notes(result: Result) -> list[str]:
    """What is worth knowing beside the numbers, a line each."""
    leaning: dict[str, list[str]] = {}
    for name, estimate in result.parameters.items():
        if estimate.rests_on:
            leaning.setdefault(estimate.rests_on, []).append(name)
    notes = [f"{', '.join(names)}: mostly from {what}" for what, names in leaning.items()]
    listed = [e for e in result.events if "detected" in e or e["kind"] in _LISTED]
    passed = [e for e in listed if e["kind"] == "disturbance" and not e.get("undecided")]
    many = passed if len(passed) > _MOST_LISTED else []
    notes += [f"{e['t']:.2f} s: {event_text(e)}" for e in listed if e not in many]
    if many:
        notes.append(f"{len(many)} disturbances; the vehicle is unchanged")
    volts = result.telemetry.get("thrust_voltage")
    if volts:
        notes.append(
            f"T_max refers to {volts:.1f} V, the battery voltage at the start of the flight"
        )
    spikes = result.telemetry.get("imu_outliers", {}).get("spikes", 0)
    if spikes:
        were = "spike was" if spikes == 1 else "spikes were"
        notes.append(f"{spikes} gyro {were} replaced by interpolation")
    found = result.telemetry.get("rotor_input", {}).get("gyro_filter_found")
    if found:
        notes.append(
            f"the gyro is low-passed, late as by a filter of {found:.0f} Hz, and is treated so; "
            "declare [imu] gyro_filter in the airframe file"
        )
    if result.estimator == "offline":
        notes.insert(0, f"offline estimate: {result.method or 'maximum likelihood'}")
    return [*notes, *result.reasons]


def _scale_lines(result: Result) -> list[str]:
    """What sets the scale, where it is not simply the mass or k_T given."""
    scale = result.scale
    if scale is None or not (scale.origin or scale.anchor == "added_mass"):
        return []
    source = f" from {scale.origin}" if scale.origin else ""
    return [f"scale: {scale.anchor} = {scale.value:.6g} {scale.unit}{source}"]
