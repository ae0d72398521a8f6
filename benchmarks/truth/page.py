"""docs/truth.md, and the short table, from the outcomes: no number comes from anywhere else."""

import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from testbed.judge import MOMENTS, Claims, claims
from testbed.study import markdown, number

TEMPLATE = Path(__file__).with_name("template.md")
Outcome = dict[str, Any]
Rows = dict[str, dict[str, Any]]
"""Scenario -> what it is (`says`) and its outcomes."""

HEAD = [
    "scenario", "flights", "verdicts", "`identified` that hold", "by data alone", "all that hold",
    "moments claimed", "error of claimed moments: median", "largest", "largest z of any claim",
    "false changes", "held-out R²", "whiteness",
]  # fmt: skip
_SHORT = {"identified": "i", "partial": "p", "refused": "r", "error": "e"}


def judged(outcomes: list[Outcome], *, all_shown: bool = False) -> Claims:
    """The claims of several flights together."""
    return [claim for outcome in outcomes for claim in claims(outcome, all_shown=all_shown)]


def share(part: float, whole: float) -> str:
    """A share in whole per cent, with what it is of."""
    return f"{100.0 * part / whole:.0f} % of {whole:.0f}" if whole else "–"


def held(found: Claims) -> str:
    """How many of the intervals have a true value in them."""
    return share(sum(f["holds"] for _, f in found), len(found))


def percent(errors: list[float], of: Callable[[list[float]], Any]) -> str:
    """A statistic of relative errors."""
    return f"{number(100.0 * float(of(errors)))} %" if errors else "–"


def verdicts(outcomes: list[Outcome]) -> str:
    """How many of each."""
    counts = Counter(o["verdict"] for o in outcomes)
    return " ".join(f"{counts[v]}{letter}" for v, letter in _SHORT.items() if counts[v])


def row(name: str, outcomes: list[Outcome]) -> list[str]:
    """A scenario's row."""
    claimed = judged(outcomes)
    moments = [abs(f["error"]) for n, f in claimed if n in MOMENTS]
    sizes = [abs(f["z"]) for _, f in claimed]
    r_squared = [o["r_squared"] for o in outcomes if o.get("r_squared") is not None]
    white = [o["whiteness"] for o in outcomes if o.get("whiteness") is not None]
    return [
        name,
        str(len(outcomes)),
        verdicts(outcomes),
        held(claimed),
        held(judged([o["by_data"] for o in outcomes if "by_data" in o])),
        held(judged(outcomes, all_shown=True)),
        share(len(moments), len(MOMENTS) * len(outcomes)),
        percent(moments, np.median),
        percent(moments, max),
        number(max(sizes)) if sizes else "–",
        str(sum(len(o.get("events", [])) for o in outcomes)),
        number(float(np.median(r_squared))) if r_squared else "–",
        number(float(np.median(white))) if white else "–",
    ]


def worst(name: str, outcomes: list[Outcome]) -> list[str] | None:
    """The claim of a scenario that is furthest off, if any is by more than three sigma."""
    found = [(abs(f["z"]), name, f, o) for o in outcomes for name, f in claims(o)]
    if not found:
        return None
    z, parameter, claim, outcome = max(found, key=lambda each: each[0])
    if z <= 3.0:
        return None
    r_squared, white = outcome.get("r_squared"), outcome.get("whiteness")
    return [
        name,
        outcome["vehicle"],
        parameter,
        f"{number(100.0 * claim['error'])} %",
        number(z),
        outcome["verdict"],
        "–" if r_squared is None else number(r_squared),
        "–" if white is None else number(white),
    ]


def lines(rows: Rows) -> list[str]:
    """The main table."""
    return markdown(HEAD, [row(name, case["outcomes"]) for name, case in rows.items()])


def page(rows: Rows) -> str:
    """The whole page."""
    found = [w for n, case in rows.items() if (w := worst(n, case["outcomes"])) is not None]
    head = ["scenario", "vehicle", "parameter", "error", "z", "verdict", "held-out R²", "whiteness"]
    misses = markdown(head, found) if found else ["No claim is."]
    says = markdown(["scenario", "what is flown"], [[n, c["says"]] for n, c in rows.items()])
    wrong = [
        f"- {name}, {o['vehicle']}: {o['error']}"
        for name, case in rows.items()
        for o in case["outcomes"]
        if o["verdict"] == "error"
    ]
    flights = [o for case in rows.values() for o in case["outcomes"]]
    parts = {
        "scenarios": says,
        "table": lines(rows),
        "worst": misses,
        "errors": ["Defects:", "", *wrong] if wrong else [],
        "total": [total(flights)],
    }
    text = TEMPLATE.read_text(encoding="utf-8")
    for name, filled in parts.items():
        text = text.replace("{{" + name + "}}", "\n".join(filled).strip())
    while "\n\n\n" in text:
        text = text.replace("\n\n\n", "\n\n")
    return text.rstrip() + "\n"


def total(flights: list[Outcome]) -> str:
    """All flights in a sentence."""
    claimed = judged(flights)
    trusted = [o for o in flights if o["verdict"] == "identified"]
    far = sum(any(abs(f["z"]) > 3.0 for _, f in claims(outcome)) for outcome in trusted)
    hold = sum(f["holds"] for _, f in claimed)
    rate = 100.0 * hold / len(claimed) if claimed else math.nan
    return (
        f"{len(flights)} flights: {hold} of {len(claimed)} `identified` intervals hold "
        f"({number(rate)} %); {far} of {len(trusted)} results with verdict `identified` contain a "
        "claim off by more than three of its own standard deviations."
    )
