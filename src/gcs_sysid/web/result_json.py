"""Results as the pages show them: numbers, units and words are made here, not in the browser."""

from collections.abc import Mapping
from typing import Any

from gcs_sysid.intervals import Z95
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.results.comparison import Comparison, Difference, comparison_sentences
from gcs_sysid.results.number_format import PAGE
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_view import (
    Figures,
    figures,
    number_figures,
    parameter_rows,
    verdict_sentence,
)
from gcs_sysid.results.words import CHANGE, VERDICT


def verdict_view(result: Result) -> dict[str, Any]:
    """The verdict in words."""
    word = VERDICT[result.verdict]
    return {
        "word": result.verdict,
        "sign": word.sign,
        "meaning": word.meaning,
        "sentence": verdict_sentence(result),
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


def value_view(shown: Figures) -> dict[str, str]:
    """Value, half of the 95 % interval and unit."""
    out = {"value": shown.value, "half": "", "unit": shown.scaled_unit, "percent": shown.percent}
    if shown.kind == "limit":
        return {**out, "half": shown.limit, "unit": ""}
    return {**out, "half": f"± {shown.half}" if shown.half else ""}


def result_rows(
    result: Result,
    truth: Mapping[str, float] | None = None,
    *,
    waiting: bool = False,
    ended: bool = False,
) -> list[dict[str, Any]]:
    """The parameters in the order of all tables; arguments as of `parameter_rows`."""
    found = parameter_rows(result, PAGE, truth=truth, waiting=waiting, ended=ended)
    return [
        {
            "name": row.name,
            "meaning": row.parameter.meaning,
            "status": row.status,
            "sign": row.sign,
            "hint": row.hint,
            "error": _error(row.error),
            **value_view(row.figures),
        }
        for row in found
    ]


def _error(error: float | None) -> str:
    if error is None:
        return ""
    return f"{'+' if error > 0.0 else ''}{PAGE.percent(error)}"


def comparison_rows(comparison: Comparison) -> dict[str, Any]:
    """Two results side by side."""
    return {
        "verdict": comparison.verdict,
        "sign": CHANGE[comparison.verdict].sign,
        "sentence": " ".join(comparison_sentences(comparison)),
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
        half, exponent = Z95 * found.std, REGISTRY[found.name].exponent
        shown = value_view(number_figures(found.value, half, found.unit, PAGE, exponent=exponent))
        out["difference"] = _in_one(shown)
    return out


def _both(estimate: Estimate | None, exponent: int | None) -> str:
    return _in_one(value_view(figures(estimate, PAGE, exponent=exponent)))


def _in_one(shown: Mapping[str, str]) -> str:
    return " ".join(filter(None, (shown["value"], shown["half"], shown["unit"])))
