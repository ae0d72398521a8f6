"""Numbers, units and signs as the screen writes them. Pure functions, no Textual.

All parameters of one unit share one power of ten (Ixx and Ixy both in 10⁻³ kg m²), so that they
compare at a glance and their decimal points stand in one column. The power follows the largest of
them and is held while it reads well, so that numbers do not jump as they converge.
"""

import math
from collections.abc import Iterable, Mapping

from gcs_sysid.estimation.status import Status
from gcs_sysid.intervals import Z95
from gcs_sysid.model.parameters import PARAMETERS, TIMING, Parameter
from gcs_sysid.results.comparison import Change
from gcs_sysid.results.result import Estimate, Result, Verdict
from gcs_sysid.results.snapshot import LinkState

UNKNOWN = "?"
"""Written where there is no number."""

WHOLE_WIDTH, FRACTION_WIDTH = 4, 4
"""Room left of the decimal point, and for the point with what follows it."""
NUMBER_WIDTH = WHOLE_WIDTH + FRACTION_WIDTH


MUTED = "$foreground 65%"
"""Style of what is not the message: labels, times. (`$text-muted` has no effect inside a text.)"""

# A sign and a colour for each state: colour is never the only sign.
STATUS_SIGN: dict[Status, str] = {
    "identified": "✓",
    "given": "•",
    "weak": "~",
    "unobservable": "✗",
}
STATUS_STYLE: dict[Status, str] = {
    "identified": "$text-success",
    "given": "$text-primary",
    "weak": "$text-warning",
    "unobservable": "$text-error",
}
VERDICT_SIGN: dict[Verdict, str] = {"identified": "✓", "partial": "~", "refused": "✗"}
LINK_SIGN: dict[LinkState, str] = {
    LinkState.WAITING: "○",
    LinkState.CONNECTED: "●",
    LinkState.REPLAY: "▶",
    LinkState.LOST: "✗",
    LinkState.ENDED: "■",
}
LINK_STYLE: dict[LinkState, str] = {
    LinkState.WAITING: "$text-warning",
    LinkState.CONNECTED: "$text-success",
    LinkState.REPLAY: "$text-success",
    LinkState.LOST: "$text-error",
    LinkState.ENDED: "$text-primary",
}

CHANGE_SIGN: dict[Change, str] = {"changed": "≠", "no_change_seen": "=", "cannot_tell": "?"}
CHANGE_STYLE: dict[Change, str] = {
    "changed": "bold",
    "no_change_seen": "$text-success",
    "cannot_tell": MUTED,
}

_LABELS = {
    "thrust_curve": "curve c",
    "moment_ratio": "k_M/k_T",
    "rotational_damping": "damping",
    "rotor_inertia": "J_rotor",
    "linear_drag": "drag",
    "rotor_delay": "delay",
    "motor_lag": "lag",
}
_PREFIX = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M"}
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_EIGHTHS = " ▏▎▍▌▋▊▉█"


def label(name: str) -> str:
    """A parameter's name in at most eight letters: the result's own name where it fits."""
    return _LABELS.get(name, name)


def rows(result: Result) -> list[tuple[Parameter, Estimate]]:
    """The parameters and timing values of a result, in the order of all tables."""
    found = [
        (p, result.parameters[name]) for name, p in PARAMETERS.items() if name in result.parameters
    ]
    found += [(p, result.timing[name]) for name, p in TIMING.items() if name in result.timing]
    return found


def pretty_unit(unit: str) -> str:
    """A unit with real exponents: `kg m^2` becomes `kg m²`; the unit 1 is left blank."""
    if unit == "1":
        return ""
    out, raised = "", False
    for char in unit:
        if char == "^":
            raised = True
            continue
        raised = raised and (char.isdigit() or char == "-")
        out += char.translate(_SUPERSCRIPT) if raised else char
    return out


def scaled_unit(unit: str, exponent: int) -> str:
    """A unit with its power of ten: `mm`, `10⁻³ kg m²`."""
    plain = pretty_unit(unit)
    if exponent == 0:
        return plain
    # A prefix reads fastest, but only where it can mean one thing: before m, s or N alone.
    if unit in ("m", "s", "N") and exponent in _PREFIX:
        return _PREFIX[exponent] + plain
    return f"10{str(exponent).translate(_SUPERSCRIPT)} {plain}".rstrip()


def engineering_exponent(magnitude: float, previous: int | None = None) -> int:
    """The power of ten, a multiple of three, that brings a magnitude between 1 and 1000.

    A previous power is held while the scaled magnitude lies between 0.5 and 1000.
    """
    if not math.isfinite(magnitude) or magnitude <= 0.0:
        return previous if previous is not None else 0
    if previous is not None and 0.5 <= magnitude / 10.0**previous < 1000.0:
        return previous
    return 3 * math.floor(math.log10(magnitude) / 3.0)


def exponent_key(parameter: Parameter) -> str:
    """What shares one power of ten: a unit; a rotor's inertia is too small for the body's."""
    return parameter.name if parameter.name == "rotor_inertia" else parameter.unit


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
        if estimate.value is not None and math.isfinite(estimate.value):
            group.setdefault(exponent_key(parameter), []).append(abs(estimate.value))
        if parameter.name in truth:
            sure.setdefault(exponent_key(parameter), []).append(abs(truth[parameter.name]))
    chosen = dict(previous)
    for unit, values in {**unsure, **sure}.items():
        # Kilograms and plain numbers are read as they are at any size that flies.
        if unit in ("kg", "1") and 0.1 <= max(values) < 1000.0:
            chosen[unit] = 0
        else:
            chosen[unit] = engineering_exponent(max(values), previous.get(unit))
    return chosen


def half_interval(estimate: Estimate) -> float | None:
    """Half the width of the 95 % interval, or None where there is none (or nothing to say)."""
    if estimate.value is None or estimate.std is None or estimate.status == "given":
        return None
    half = Z95 * estimate.std
    return half if math.isfinite(half) else None


def relative_half(estimate: Estimate) -> float | None:
    """Half the 95 % interval as a fraction of the value."""
    half = half_interval(estimate)
    if half is None or not estimate.value or not math.isfinite(estimate.value):
        return None
    return half / abs(estimate.value)


def decimals_for(half: float | None) -> int:
    """Decimals that show two digits of an interval (0.081, 1.2, 35), three at most."""
    if half is None or not math.isfinite(half) or half <= 0.0:
        return FRACTION_WIDTH - 1
    return min(FRACTION_WIDTH - 1, max(0, 1 - math.floor(math.log10(half))))


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
    half = half_interval(estimate)
    half = None if half is None else half * factor
    decimals = decimals_for(half)
    value = aligned(None if estimate.value is None else estimate.value * factor, decimals)
    if estimate.status == "given":
        return value, "exact".ljust(NUMBER_WIDTH - 1)
    return value, aligned(half, decimals, WHOLE_WIDTH - 1)


def percent(fraction: float | None, signed: bool = False) -> str:
    """A fraction in per cent with two or three digits: `0.49 %`, `+12.3 %`, `>999 %`."""
    if fraction is None or math.isnan(fraction):
        return ""
    number = 100.0 * fraction
    size = abs(number)
    if size >= 999.5:
        return ">999 %" if number > 0 or not signed else "<-999 %"
    digits = 2 if size < 9.995 else 1 if size < 99.95 else 0
    return f"{number:+.{digits}f} %" if signed else f"{number:.{digits}f} %"


def rough(fraction: float) -> str:
    """A fraction in per cent with two digits at most, as one says it: `12 %`, `3 %`, `0.5 %`."""
    return f"{float(f'{100.0 * fraction:.2g}'):g} %" if fraction < 9.995 else ">999 %"


def bar(fraction: float, width: int) -> str:
    """A horizontal bar in eighths of a cell."""
    eighths = round(min(1.0, max(0.0, fraction)) * width * 8)
    full, rest = divmod(eighths, 8)
    return ("█" * full + (_EIGHTHS[rest] if rest else "")).ljust(width)


def converged(share: float | None, target: float) -> float:
    """How far a parameter has come, on a logarithmic scale: 0 at ±100 %, 1 at the target."""
    if share is None or share <= 0.0:
        return 0.0
    return min(1.0, max(0.0, math.log(share) / math.log(min(target, 0.99))))


def clock(seconds: float) -> str:
    """Flight time as `mm:ss` (minutes run past 59)."""
    minutes, rest = divmod(max(0, math.floor(seconds)), 60)
    return f"{minutes:02d}:{rest:02d}"


def clock_tenths(seconds: float) -> str:
    """Event time as `mm:ss.s`."""
    tenths = max(0, round(10.0 * seconds))
    minutes, rest = divmod(tenths, 600)
    return f"{minutes:02d}:{rest // 10:02d}.{rest % 10}"


def duration(seconds: float) -> str:
    """A short span in words: `4 s`, `2 min 5 s`."""
    whole = max(0, math.floor(seconds))
    return f"{whole} s" if whole < 60 else f"{whole // 60} min {whole % 60} s"


def grouped(count: int) -> str:
    """A count with its thousands apart: `12 345`."""
    return f"{count:,}".replace(",", " ")


def data_rate(bytes_per_second: float) -> str:
    """A data rate: `870 B/s`, `23.4 kB/s`."""
    if bytes_per_second < 1000.0:
        return f"{bytes_per_second:.0f} B/s"
    return f"{bytes_per_second / 1000.0:.1f} kB/s"


def one_line(parts: Iterable[str]) -> str:
    """Several sentences on one line."""
    return " · ".join(p for p in parts if p)


def wrapped(texts: Iterable[str], width: int) -> int:
    """Lines that texts take, about: a layout of the screen is dear, and rarely needed."""
    return sum(max(1, -(-len(text) // max(1, width))) for text in texts)
