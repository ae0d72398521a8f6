"""Numbers and findings in the words of the report."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from gcs_sysid.intervals import Z95
from gcs_sysid.model.parameters import CORE_OF, PARAMETERS

TIE = "\N{NO-BREAK SPACE}"
"""A space at which lines do not break."""
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
NOTHING = "\N{EN DASH}"
_MOST_DIGITS = 7

STATUS_SIGNS = {"identified": "●", "given": "◆", "weak": "◐", "unobservable": "○"}
STATUS_WORDS = {
    "identified": "identified",
    "given": "given",
    "weak": "roughly",
    "unobservable": "not told",
}
STATUS_MEANINGS = {
    "identified": "standard deviation below 5 % of the yardstick: use it",
    "given": "the value that sets the scale, taken as it was given",
    "weak": "below 50 %: a rough number",
    "unobservable": "more, or the model does not hold: do not use it",
}
VERDICT_WORDS = {
    "identified": "Identified",
    "partial": "Partly identified",
    "refused": "Not identified",
}
VERDICT_SIGNS = {"identified": "✓", "partial": "◐", "refused": "✕"}

_TOLD_BY = {
    "mass": "climbing and sinking against gravity",
    "Ixx": "roll", "Iyy": "pitch", "Izz": "yaw and gyroscopic torque",
    "Ixy": "coupling of roll and pitch", "Iyz": "coupling of pitch and yaw",
    "Ixz": "coupling of roll and yaw",
    "cg_x": "mean pitch torque of the rotors", "cg_y": "mean roll torque of the rotors",
    "k_T": "climbing and sinking against gravity", "T_max": "climbing and sinking against gravity",
    "k_M": "yaw and gyroscopic torque", "moment_ratio": "yaw and gyroscopic torque",
    "thrust_curve": "torque at low and at high command",
    "rotational_damping": "decay of turning", "rotor_inertia": "rotors speeding up",
    "linear_drag": "horizontal speed",
}  # fmt: skip


def unit_text(unit: str) -> str:
    """A unit with raised powers; nothing for pure numbers."""
    return "" if unit == "1" else unit.replace("^2", "²").replace(" ", TIE)


def power_of_ten(size: float) -> int:
    """The multiple of three by which numbers of this size are shown."""
    if not (size > 0.0 and math.isfinite(size)) or 0.1 <= size < 1e4:
        return 0
    return 3 * math.floor(math.log10(size) / 3.0)


def times_power(exponent: int) -> str:
    """Such as " × 10⁻³"; nothing for one."""
    return f" × 10{str(exponent).translate(_SUPERSCRIPT)}" if exponent else ""


def fixed(value: float, decimals: int) -> str:
    """A number with so many decimals and a true minus sign."""
    text = f"{value:.{decimals}f}"
    if text.startswith("-") and not text.strip("-0."):
        text = text[1:]
    return text.replace("-", "\N{MINUS SIGN}")


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits."""
    if value is None or not math.isfinite(value):
        return NOTHING
    exponent = power_of_ten(abs(value))
    scaled = value / 10.0**exponent
    if scaled == 0.0:
        return "0"
    size = math.floor(math.log10(abs(scaled)))
    return fixed(scaled, max(digits - 1 - size, 0)) + times_power(exponent)


def percent(share: float | None, digits: int = 2) -> str:
    """A share as per cent."""
    if share is None or not math.isfinite(share):
        return NOTHING
    value = 100.0 * share
    if abs(value) >= 1000.0:
        return f">{TIE}999{TIE}%"
    size = math.floor(math.log10(abs(value))) if value else 0
    return f"{fixed(value, max(digits - 1 - size, 0))}{TIE}%"


def measure(value: float, half: float | None, unit: str) -> str:
    """A value in a unit that suits its size, with the half of its interval where there is one."""
    if not half:
        return f"{number(value)} {unit}"
    half = max(half, 1e-3 * abs(value), 1e-3)
    decimals = max(1 - math.floor(math.log10(half)), 0)
    return f"{fixed(value, decimals)} ± {fixed(half, decimals)} {unit}"


def decimals_of(half: float, size: float) -> int:
    """Decimals that show two digits of the uncertainty, within reason."""
    if not half > 0.0:
        return max(5 - math.floor(math.log10(size)), 0) if size > 0.0 else 0
    wanted = 1 - math.floor(math.log10(half))
    most = _MOST_DIGITS - 1 - math.floor(math.log10(size)) if size > 0.0 else wanted
    return max(min(wanted, most), 0)


def value_text(value: float, half: float) -> tuple[str, str, str, int]:
    """A value and the half of its interval on one scale.

    Returns:
        The value, the half, the power of ten as text, and that power.
    """
    exponent = power_of_ten(max(abs(value), half))
    scale = 10.0**exponent
    decimals = decimals_of(half / scale, abs(value) / scale)
    return (
        fixed(value / scale, decimals),
        fixed(half / scale, decimals),
        times_power(exponent),
        exponent,
    )


def told_by(name: str, estimate: Mapping[str, Any], scale: Mapping[str, Any] | None) -> str:
    """What a parameter's knowledge rests on."""
    if estimate["status"] == "given":
        return "given: it sets the scale"
    if estimate.get("rests_on"):
        return f"mostly from {estimate['rests_on']}"
    if estimate["status"] == "unobservable":
        return f"would need: {_TOLD_BY[name]}"
    if scale and name == scale["anchor"] and scale.get("from"):
        return f"from {scale['from']}"
    return _TOLD_BY[name]


def half_of(estimate: Mapping[str, Any]) -> float | None:
    """Half of a parameter's 95 % interval."""
    return None if estimate["std"] is None else Z95 * float(estimate["std"])


def names_text(names: Sequence[str]) -> str:
    """Names in a sentence."""
    shown = [name.replace("_", TIE) if name in _PLAIN else name for name in names]
    if len(shown) < 2:
        return "".join(shown)
    return ", ".join(shown[:-1]) + " and " + shown[-1]


_PLAIN = frozenset({"moment_ratio", "thrust_curve"})


def verdict_sentence(result: Mapping[str, Any]) -> str:
    """What is known, and how well, in words that a pilot understands."""
    parameters = result["parameters"]
    core = [name for name in CORE_OF[result["rotor_input"]] if name in parameters]
    of = {
        status: [name for name in core if parameters[name]["status"] == status]
        for status in STATUS_WORDS
    }
    if result["verdict"] == "refused":
        return "This recording does not tell what the vehicle is like."
    since = ""
    if result["segments"]:
        since = f"The vehicle changed at {result['segments'][-1]['end']:.1f} s. Since then: "
    if result["verdict"] == "identified":
        word = "every" if since else "Every"
        return f"{since}{word} core parameter is known: {_listed(_how_well(parameters))}."
    known = _how_well(parameters)
    out = [f"{since}Known: {_listed(known)}."] if known else []
    if of["weak"]:
        out.append(f"Only roughly known: {names_text(of['weak'])}.")
    if of["unobservable"]:
        out.append(f"Not told by this flight: {names_text(of['unobservable'])}.")
    return " ".join(out)


def _listed(words: Sequence[str]) -> str:
    """Words in a sentence; the first says what the numbers are."""
    return ", ".join([f"{words[0]} (95{TIE}% intervals)", *words[1:]])


def _how_well(parameters: Mapping[str, Any]) -> list[str]:
    """How well groups of parameters are known."""
    out = []
    for names, what in (
        (("mass",), "mass"),
        (("Ixx", "Iyy", "Izz"), "moments of inertia"),
        (("Ixy", "Iyz", "Ixz"), "products of inertia"),
        (("cg_x", "cg_y"), "balance point"),
        (("k_T", "T_max"), "thrust"),
        (("k_M", "moment_ratio"), "rotor torque"),
    ):
        told = {n: parameters[n] for n in names if n in parameters}
        told = {n: e for n, e in told.items() if e["status"] == "identified"}
        if not told:
            continue
        halves = [(half_of(e) or 0.0, abs(e["value"] or 0.0)) for e in told.values()]
        either = what in ("thrust", "rotor torque")
        complete = either or len(told) == len(names)
        subject = what if complete else names_text(list(told))
        if what == "balance point":
            millimetres = max(1e3 * max(half for half, _ in halves), 0.01)
            decimals = max(1 - math.floor(math.log10(millimetres)), 0)
            out.append(f"{subject} to within {fixed(millimetres, decimals)}{TIE}mm")
        elif what == "products of inertia":
            # Near zero a share of itself says nothing.
            moments = [parameters[n]["value"] for n in ("Ixx", "Iyy", "Izz") if n in parameters]
            least = min((m for m in moments if m), default=math.inf)
            share = max(half for half, _ in halves) / least
            out.append(f"{subject} to within {percent(share)} of the moments")
        else:
            worst = max(half / size if size else math.inf for half, size in halves)
            out.append(f"{subject} to within {percent(worst)}")
    return out


_IN_VERDICT = ("the data do not tell ", "only roughly known: ")
"""How reasons begin that the verdict's sentence has told."""


def advice(result: Mapping[str, Any], inspection: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What is missing or stands in the way, and what would help."""
    out = [(reason, "") for reason in result["reasons"] if not reason.startswith(_IN_VERDICT)]
    said = {text for text, _ in out}
    for finding in inspection.get("reasons", ()):
        if finding["level"] != "note" and finding["text"] not in said:
            out.append((finding["text"], finding["advice"]))
    # Advice that several share is given once, with the last of them.
    last = {help_: place for place, (_, help_) in enumerate(out)}
    return [
        (text, help_ if last[help_] == place else "") for place, (text, help_) in enumerate(out)
    ]


def meaning(name: str) -> str:
    """What a parameter is."""
    return PARAMETERS[name].meaning


def event_text(event: Mapping[str, Any]) -> str:
    """What happened, in one line."""
    if event.get("text"):
        return str(event["text"])
    text = str(event["kind"]).replace("_", " ")
    if "loss" in event:
        low, high = (100.0 * v for v in event["loss"]["ci95"])
        return f"{text}: rotor {event['rotor'] + 1} lost {low:.0f} to {high:.0f} % of its thrust"
    told = []
    for name, change in event.get("parameters", {}).items():
        before, after, ci95 = (change.get(key) for key in ("before", "after", "ci95"))
        if before is None or after is None or ci95 is None or ci95[0] <= 0.0 <= ci95[1]:
            continue
        unit = unit_text(PARAMETERS[name].unit) if name in PARAMETERS else ""
        told.append(f"{name} {number(before, 4)} → {number(after, 4)} {unit}".rstrip())
    return f"{text}: {', '.join(told)}" if told else text
