"""A result as lines of text."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from gcs_sysid.results.number_format import PLAIN, percent_column, rounded, significant
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_view import parameter_rows, result_notes


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


def _rows(result: Result, truth: Mapping[str, float] | None, style: _Style) -> list[str]:
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


def _scale_lines(result: Result) -> list[str]:
    """What sets the scale, where it is not simply the mass or k_T given."""
    scale = result.scale
    if scale is None or not (scale.origin or scale.anchor == "added_mass"):
        return []
    source = f" from {scale.origin}" if scale.origin else ""
    return [f"scale: {scale.anchor} = {scale.value:.6g} {scale.unit}{source}"]
