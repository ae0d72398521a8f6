"""Findings in the words of the report."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from gcs_sysid.intervals import Z95
from gcs_sysid.model.parameters import CORE_OF, REGISTRY, grouped
from gcs_sysid.results.number_format import PAGE, decimals_for
from gcs_sysid.results.words import STATUS


def half_of(estimate: Mapping[str, Any]) -> float | None:
    """Half of a parameter's 95 % interval."""
    return None if estimate["std"] is None else Z95 * float(estimate["std"])


def names_text(names: Sequence[str]) -> str:
    """Names in a sentence."""
    if len(names) < 2:
        return "".join(names)
    return ", ".join(names[:-1]) + " and " + names[-1]


def verdict_sentence(result: Mapping[str, Any]) -> str:
    """What is known, and how well, in words that a pilot understands."""
    parameters = result["parameters"]
    core = [name for name in CORE_OF[result["rotor_input"]] if name in parameters]
    of = {
        status: [name for name in core if parameters[name]["status"] == status] for status in STATUS
    }
    if result["verdict"] == "refused":
        return "The vehicle cannot be identified from this recording."
    known = _how_well(parameters, core)
    since = ""
    if result["segments"]:
        since = f"The vehicle changed at {result['segments'][-1]['end']:.1f} s. Since then: "
    if result["verdict"] == "identified":
        word = "every" if since else "Every"
        return f"{since}{word} core parameter is known: {_listed(known)}."
    out = [f"{since}Known: {_listed(known)}."] if known else []
    if of["weak"]:
        out.append(f"Weak: {names_text(of['weak'])}.")
    if of["unobservable"]:
        out.append(f"Not observable from this flight: {names_text(of['unobservable'])}.")
    return " ".join(out)


def _listed(words: Sequence[str]) -> str:
    """Words in a sentence; the first says what the numbers are."""
    return ", ".join([f"{words[0]} (95{PAGE.space}% intervals)", *words[1:]])


def _how_well(parameters: Mapping[str, Any], core: Sequence[str]) -> list[str]:
    """How well groups of core parameters are known."""
    out = []
    for group in dict.fromkeys(REGISTRY[name].group for name in core):
        names = [name for name in core if REGISTRY[name].group == group]
        entries = {n: parameters[n] for n in names if parameters[n]["status"] in _KNOWN}
        if not entries:
            continue
        halves = [(half_of(e) or 0.0, abs(e["value"] or 0.0)) for e in entries.values()]
        subject = group if len(entries) == len(names) else names_text(list(entries))
        if REGISTRY[names[0]].unit == "m" and REGISTRY[names[0]].sign == "any":
            millimeters = max(1e3 * max(half for half, _ in halves), 0.01)
            length = PAGE.fixed(millimeters, decimals_for(millimeters))
            out.append(f"{subject} to within {length}{PAGE.space}mm")
        elif REGISTRY[names[0]].sign == "any":
            # Near zero a share of itself says nothing.
            moments = [parameters[n]["value"] for n in _MOMENTS if n in parameters]
            least = min((m for m in moments if m), default=math.inf)
            share = max(half for half, _ in halves) / least
            out.append(f"{subject} to within {PAGE.percent(share)} of the moments")
        else:
            worst = max(half / size if size else math.inf for half, size in halves)
            out.append(f"{subject} to within {PAGE.percent(worst)}")
    return out


_KNOWN = ("identified", "zero")
_MOMENTS = grouped("moments of inertia")
_IN_VERDICT = ("not observable from this flight: ", "weak: ")
"""How reasons begin that the verdict's sentence contains."""


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
