"""Results as the pages show them: numbers, units and words are made here, not in the browser."""

from collections.abc import Mapping
from typing import Any

from gcs_sysid.intervals import Z95
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.report.wording import verdict_sentence
from gcs_sysid.results.comparison import Comparison, Difference
from gcs_sysid.results.number_format import PAGE, decimals_for, scaled_unit
from gcs_sysid.results.result import Result
from gcs_sysid.results.words import CHANGE, STATUS, VERDICT, WAITING, rows


def verdict_view(result: Result) -> dict[str, Any]:
    """The verdict in words."""
    word = VERDICT[result.verdict]
    return {
        "word": result.verdict,
        "sign": word.sign,
        "meaning": word.meaning,
        "sentence": verdict_sentence(result.as_json()),
        "reasons": list(result.reasons),
    }


def why_no_health(document: Mapping[str, Any]) -> list[str]:
    """Why a result's hover has no findings; empty where it has, or nothing hovers.

    Args:
        document: of a result's file.
    """
    found = document.get("health")
    if not isinstance(found, dict) or found.get("verdict") != "refused":
        return []
    return [f"no health: {reason}" for reason in found["reasons"]]


def value_view(estimate: Estimate, exponent: int | None = None) -> dict[str, str]:
    """Value, half of the 95 % interval and unit of an estimate, on one power of ten.

    Args:
        estimate: in SI.
        exponent: that power; None: by the size.
    """
    nothing = {"value": PAGE.nothing, "half": "", "unit": "", "percent": ""}
    if not estimate.shown or estimate.value is None:
        return nothing
    scale, unit = 1.0, PAGE.unit(estimate.unit)
    if exponent is not None:
        scale, unit = 10.0**-exponent, scaled_unit(estimate.unit, exponent)
    if estimate.limit is not None:
        limit = scale * estimate.limit
        text = PAGE.number(limit, 2)
        if exponent is not None:
            text = PAGE.fixed(limit, decimals_for(limit))
        return {**nothing, "value": "~0", "half": f"({f'< {text} {unit}'.rstrip()})"}
    if not estimate.half:
        return {
            **nothing,
            "value": PAGE.number(scale * estimate.value, 6),
            "unit": unit,
        }
    value, half, _, exponent = PAGE.value_and_half(estimate.value, estimate.half, exponent)
    return {
        "value": value,
        "half": f"± {half}",
        "unit": scaled_unit(estimate.unit, exponent).strip(),
        "percent": PAGE.percent(estimate.relative_half),
    }


def result_rows(
    result: Result, *, waiting: bool = False, ended: bool = False
) -> list[dict[str, Any]]:
    """The parameters in the order of all tables.

    Args:
        result: theirs.
        waiting: whether what is not observable may still become so by flying.
        ended: whether the flight is over, so that there is nothing more to fly.
    """
    out = []
    for parameter, estimate in rows(result):
        status, word = estimate.status, STATUS[estimate.status]
        if waiting and status == "unobservable":
            word, shown = WAITING, WAITING.meaning
        else:
            shown = status or ""
        out.append(
            {
                "name": parameter.name,
                "meaning": parameter.meaning,
                "status": shown,
                "sign": word.sign,
                "hint": word.meaning if ended else word.with_advice,
                **value_view(estimate, parameter.exponent),
            }
        )
    return out


def comparison_rows(comparison: Comparison) -> dict[str, Any]:
    """Two results side by side."""
    changed, unknown = comparison.named("changed"), comparison.named("cannot_tell")
    if comparison.verdict == "cannot_tell":
        sentence = "Undetermined: no parameter is identified in both results."
    elif changed:
        sentence = f"The vehicle has changed: {', '.join(changed)}."
    else:
        sentence = f"No change seen in {', '.join(comparison.named('no_change_seen'))}."
    if unknown and comparison.verdict != "cannot_tell":
        sentence += f" Undetermined: {', '.join(unknown)}."
    return {
        "verdict": comparison.verdict,
        "sign": CHANGE[comparison.verdict].sign,
        "sentence": sentence,
        "rows": [_difference(found) for found in comparison.differences.values()],
        "notes": list(comparison.notes),
    }


def _difference(found: Difference) -> dict[str, Any]:
    out: dict[str, Any] = {
        "name": found.name,
        "meaning": REGISTRY[found.name].meaning,
        "before": _both(found.before, REGISTRY[found.name].exponent),
        "after": _both(found.after, REGISTRY[found.name].exponent),
        "difference": PAGE.nothing,
        "verdict": CHANGE[found.verdict].meaning,
        "sign": CHANGE[found.verdict].sign,
        "why": found.why,
    }
    if found.value is not None and found.std:
        value, half, _, exponent = PAGE.value_and_half(
            found.value, Z95 * found.std, REGISTRY[found.name].exponent
        )
        unit = scaled_unit(found.unit, exponent).strip()
        out["difference"] = f"{value} ± {half} {unit}".rstrip()
    return out


def _both(estimate: Estimate | None, exponent: int | None) -> str:
    if estimate is None:
        return PAGE.nothing
    shown: Mapping[str, str] = value_view(estimate, exponent)
    return " ".join(filter(None, (shown["value"], shown["half"], shown["unit"])))
