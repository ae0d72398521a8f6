"""Numbers, units and signs as the screen writes them. Pure functions, no Textual.

All parameters of one unit share one power of ten (Ixx and Ixy both in 10⁻³ kg m²), so that they
compare at a glance and their decimal points are in one column. The power follows the largest of
them and is held while it reads well, so that numbers do not jump as they converge.
"""

import math
from collections.abc import Iterable, Mapping

from gcs_sysid.model.estimate import Estimate, Status
from gcs_sysid.results.number_format import decimals_for, engineering_exponent
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_view import exponent_key, rows
from gcs_sysid.results.snapshot import LinkState
from gcs_sysid.results.words import Change

UNKNOWN = "?"
"""Written where there is no number."""

WHOLE_WIDTH, FRACTION_WIDTH = 4, 4
"""Room left of the decimal point, and for the point with what follows it."""
NUMBER_WIDTH = WHOLE_WIDTH + FRACTION_WIDTH
LABEL_WIDTH = 13


MUTED = "$foreground 65%"
"""Style of what is not the message: labels, times. (`$text-muted` has no effect inside a text.)"""

# Colors beside the signs of `results.words`.
STATUS_STYLE: dict[Status | None, str] = {
    "identified": "$text-success",
    "given": "$text-primary",
    "zero": "$text-success",
    "weak": "$text-warning",
    "unobservable": "$text-error",
}
LINK_STYLE: dict[LinkState, str] = {
    LinkState.WAITING: "$text-warning",
    LinkState.CONNECTED: "$text-success",
    LinkState.REPLAY: "$text-success",
    LinkState.LOST: "$text-error",
    LinkState.ENDED: "$text-primary",
}

CHANGE_STYLE: dict[Change, str] = {
    "changed": "bold",
    "no_change_seen": "$text-success",
    "cannot_tell": MUTED,
}

_EIGHTHS = " ▏▎▍▌▋▊▉█"


def choose_exponents(
    result: Result, truth: Mapping[str, float], previous: Mapping[str, int]
) -> dict[str, int]:
    """One power of ten for every unit in a result.

    Values that mean nothing (unobservable) do not take part unless there is nothing better.
    """
    sure: dict[str, list[float]] = {}
    unsure: dict[str, list[float]] = {}
    for parameter, estimate in rows(result):
        group = unsure if estimate.status == "unobservable" else sure
        shown = estimate.value if estimate.limit is None else estimate.limit
        if shown is not None and math.isfinite(shown):
            group.setdefault(exponent_key(parameter), []).append(abs(shown))
        if parameter.name in truth:
            sure.setdefault(exponent_key(parameter), []).append(abs(truth[parameter.name]))
    chosen = dict(previous)
    fixed = {exponent_key(p): p.exponent for p, _ in rows(result) if p.exponent is not None}
    for unit, values in {**unsure, **sure}.items():
        # Kilograms and plain numbers are read as they are at any size that flies.
        if unit in fixed:
            chosen[unit] = fixed[unit]
        elif unit in ("kg", "1") and 0.1 <= max(values) < 1000.0:
            chosen[unit] = 0
        else:
            chosen[unit] = engineering_exponent(max(values), previous.get(unit))
    return chosen


def aligned(value: float | None, decimals: int, whole: int = WHOLE_WIDTH) -> str:
    """A number whose decimal point stands at a fixed place, in a field of fixed width."""
    width = whole + FRACTION_WIDTH
    if value is None or not math.isfinite(value):
        return UNKNOWN.rjust(whole).ljust(width)
    head, point, tail = f"{value:.{decimals}f}".partition(".")
    if len(head) > whole:
        return f"{value:.0e}".rjust(width)
    return head.rjust(whole) + (point + tail).ljust(FRACTION_WIDTH)


def value_and_half(estimate: Estimate, exponent: int) -> tuple[str, str]:
    """Value and half interval as two aligned fields with the same decimals."""
    factor = 10.0**-exponent
    half = estimate.half
    half = None if half is None else half * factor
    decimals = decimals_for(half or 0.0, most=FRACTION_WIDTH - 1)
    value = aligned(None if estimate.value is None else estimate.value * factor, decimals)
    if estimate.status == "given" and half is None:
        return value, "exact".ljust(NUMBER_WIDTH - 1)
    return value, aligned(half, decimals, WHOLE_WIDTH - 1)


def value_with_half(estimate: Estimate, exponent: int) -> str:
    """Value and half interval in a field of fixed width: `2.05 ± 0.01`, `~0 (< 0.21)`, `-`."""
    width = 2 * NUMBER_WIDTH + 2
    if not estimate.shown:
        return "-".rjust(WHOLE_WIDTH).ljust(width)
    if estimate.limit is not None:
        limit = estimate.limit * 10.0**-exponent
        decimals = decimals_for(limit, most=FRACTION_WIDTH - 1)
        return f"{'~0':>{WHOLE_WIDTH}} (< {aligned(limit, decimals).strip()})".ljust(width)
    value, half = value_and_half(estimate, exponent)
    return f"{value}{'   ' if estimate.status == 'given' else ' ± '}{half}"


def bar(fraction: float, width: int) -> str:
    """A horizontal bar in eighths of a cell."""
    eighths = round(min(1.0, max(0.0, fraction)) * width * 8)
    full, rest = divmod(eighths, 8)
    return ("█" * full + (_EIGHTHS[rest] if rest else "")).ljust(width)


def one_line(parts: Iterable[str]) -> str:
    """Several sentences on one line."""
    return " · ".join(p for p in parts if p)
