"""Claims compared with the truth, and docs/benchmark.md: no number comes from anywhere else."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.public.flight import Claims
from testbed.judge import against
from testbed.study import markdown, number

OURS = "gcs-sysid"
MOMENTS = ("Ixx", "Iyy", "Izz")
SCORED = (*MOMENTS, "Ixy", "Iyz", "Ixz", "k_T", "k_M", "cg_x", "cg_y")
RIGHT, FALSE = 0.05, 0.10
"""Largest error of a claim that is useful; least of one whose interval fails to be called false."""
TEMPLATE = Path(__file__).with_name("template.md")
Flown = dict[str, Any]
"""A flight: `group`, `flight`, `possible`, and of each estimator `claims` or `error`."""


def judge(claims: Claims, truth: Mapping[str, Any], arm: float) -> dict[str, dict[str, Any]]:
    """Each scored claim against the truth.

    Args:
        claims: of an estimator.
        truth: parameter -> value, or values of which any will do.
        arm: m, which errors of the CG are a share of; those of products are one of the mean of
            the true moments about their axes.
    """
    judged = {}
    for name in SCORED:
        if name not in claims or name not in truth:
            continue
        value, std = map(float, claims[name])
        if not (math.isfinite(value) and math.isfinite(std) and std > 0.0):
            continue
        found = against(value, std, truth[name])
        error = abs(found["z"]) * std / size(name, truth, arm)
        judged[name] = {"error": error, "z": found["z"], "holds": bool(found["holds"])}
    return judged


def size(name: str, truth: Mapping[str, Any], arm: float) -> float:
    """What an error is a share of."""
    if name.startswith("cg"):
        return arm
    if name in ("Ixy", "Iyz", "Ixz"):
        return 0.5 * (truth[f"I{2 * name[1]}"] + truth[f"I{2 * name[2]}"])
    return float(np.mean(np.abs(truth[name])))


def totals(flights: list[Flown], who: str) -> dict[str, float]:
    """An estimator's figures over flights; NaN where nothing was claimed."""
    claims = [c for f in flights for c in f["estimators"].get(who, {}).get("claims", {}).values()]
    possible = sum(len(f["possible"]) for f in flights)
    useful = sum(c["holds"] and c["error"] <= RIGHT for c in claims)
    return {
        "possible": possible,
        "claimed": len(claims),
        "score": useful / possible if possible else math.nan,
        "median": float(np.median([c["error"] for c in claims])) if claims else math.nan,
        "worst": max((c["error"] for c in claims), default=math.nan),
        "holds": sum(c["holds"] for c in claims) / len(claims) if claims else math.nan,
        "false": sum(not c["holds"] and c["error"] > FALSE for c in claims),
        "failed": sum("error" in f["estimators"].get(who, {}) for f in flights),
        "seconds": sum(f["estimators"].get(who, {}).get("seconds", 0.0) for f in flights),
    }


def names_of(flights: list[Flown]) -> list[str]:
    """All estimators that there are outcomes of, ours first."""
    return list(dict.fromkeys([OURS, *(who for f in flights for who in f["estimators"])]))


def grouped(flights: list[Flown]) -> dict[str, list[Flown]]:
    """Flights by their group, in the order of their first."""
    groups: dict[str, list[Flown]] = {}
    for flight in flights:
        groups.setdefault(flight["group"], []).append(flight)
    return groups


def percent(share: float) -> str:
    """A share for the table."""
    return f"{number(100.0 * share)} %" if math.isfinite(share) else "–"


def main_table(flights: list[Flown]) -> list[str]:
    """A row for each group and estimator; ours says where another is better."""
    rows = []
    for group, some in grouped(flights).items():
        found = {who: totals(some, who) for who in names_of(some)}
        for who, t in found.items():
            better = [w for w, other in found.items() if other["score"] > found[OURS]["score"]]
            mark = f" (better: {', '.join(better)})" if who == OURS and better else ""
            rows.append(
                [
                    f"{group} ({len(some)})" if who == OURS else "",
                    f"**{who}**{mark}" if who == OURS else who,
                    percent(t["score"]),
                    f"{t['claimed']:.0f} of {t['possible']:.0f}",
                    percent(t["median"]),
                    percent(t["worst"]),
                    percent(t["holds"]),
                    f"{t['false']:.0f}",
                    f"{t['seconds'] / len(some):.1f}",
                ]
            )
    head = [
        "flights", "estimator", "score", "claims", "median error", "largest",
        "intervals that hold", "false claims", "s a flight",
    ]  # fmt: skip
    return [*markdown(head, rows), ""]


def duel(flights: list[Flown], who: str, parameter: str) -> tuple[float, float, int]:
    """Median errors, ours and theirs, where both claim a parameter, and how often they do."""
    both = [
        (f["estimators"][OURS]["claims"][parameter], f["estimators"][who]["claims"][parameter])
        for f in flights
        if parameter in f["estimators"].get(OURS, {}).get("claims", {})
        and parameter in f["estimators"].get(who, {}).get("claims", {})
    ]
    if not both:
        return math.nan, math.nan, 0
    ours, theirs = ([pair[i]["error"] for pair in both] for i in (0, 1))
    return float(np.median(ours)), float(np.median(theirs)), len(both)


def duels_table(flights: list[Flown]) -> list[str]:
    """Where both claim: ours, theirs; what is worse than theirs is marked as such."""
    others = [who for who in names_of(flights) if who != OURS]
    rows = []
    for group, some in grouped(flights).items():
        for parameter in SCORED:
            cells = []
            for who in others:
                ours, theirs, count = duel(some, who, parameter)
                worse = " **worse**" if ours > theirs else ""
                cells.append(
                    f"{percent(ours)} / {percent(theirs)} ({count}){worse}" if count else "–"
                )
            if any(cell != "–" for cell in cells):
                rows.append([group, parameter, *cells])
    return [*markdown(["flights", "parameter", *(f"against {who}" for who in others)], rows), ""]


def errors(flights: list[Flown]) -> list[str]:
    """What failed, a line each."""
    lines = [
        f"- {f['flight']}, {who}: {outcome['error']}"
        for f in flights
        for who, outcome in f["estimators"].items()
        if "error" in outcome
    ]
    return ["No answer:", "", *lines] if lines else []


def page(flights: list[Flown]) -> str:
    """The whole page."""
    worse = sum(
        "**worse**" in cell for line in duels_table(flights)[2:] for cell in line.split("|")
    )
    parts = {
        "table": main_table(flights),
        "duels": duels_table(flights),
        "worse": [f"Ours is the larger in {worse} cells."],
        "errors": errors(flights),
    }
    text = TEMPLATE.read_text(encoding="utf-8")
    for name, lines in parts.items():
        mark = "{{" + name + "}}"
        # What is empty takes its blank line along; others are code's own.
        text = text.replace(mark if lines else f"{mark}\n\n", "\n".join(lines))
    return text.rstrip() + "\n"
