"""What the program is held to beside what was measured, and tables of Markdown."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

from testbed.study import markdown

Outcome = Literal["met", "not met", "below the bound"]


@dataclass(frozen=True)
class Verdict:
    """A bar and what came of it.

    Attributes:
        quantity: what is held to the bar.
        bar: as text.
        measured: as text.
        outcome: "below the bound" where no unbiased estimator could have met the bar.
        why: what there is to say of a miss.
        case: of the list of bars.
        seeds: that it was measured over; 0 where that says nothing.
    """

    quantity: str
    bar: str
    measured: str
    outcome: Outcome
    why: str = ""
    case: str = ""
    seeds: int = 0

    def cells(self) -> list[str]:
        """Its row."""
        said = self.outcome if self.outcome == "met" else f"**{self.outcome}**"
        said = said.replace("below", "limit below")
        said += f" ({self.why})" if self.why and self.outcome != "met" else ""
        seeds = str(self.seeds) if self.seeds else ""
        return [self.case, self.quantity, self.bar, self.measured, seeds, said]


class Section(NamedTuple):
    """What a study says: for the table of verdicts, and for its own place in the page."""

    verdicts: list[Verdict]
    lines: list[str]


def at_most(
    quantity: str, value: float, bar: float, unit: str = "%", bound: float | None = None
) -> Verdict:
    """A value that must not exceed a bar.

    Args:
        quantity: what it is.
        value: measured; NaN and infinity miss any bar.
        bar: most that is allowed.
        unit: of both.
        bound: least that any unbiased estimator reaches, as far as it is known.
    """
    outcome: Outcome = "met" if value <= bar else "not met"
    why = ""
    if bound is not None:
        if outcome == "not met" and bound > bar:
            outcome = "below the bound"
        why = f"Cramér-Rao {_with_unit(bound, unit)} or more"
    return Verdict(quantity, f"≤ {bar:g} {unit}".strip(), _with_unit(value, unit), outcome, why)


def at_least(quantity: str, value: float, bar: float, unit: str = "%") -> Verdict:
    """A value that must reach a bar; see `at_most`."""
    outcome: Outcome = "met" if value >= bar else "not met"
    return Verdict(quantity, f"≥ {bar:g} {unit}".strip(), _with_unit(value, unit), outcome)


def within(quantity: str, value: float, low: float, high: float) -> Verdict:
    """A share in % that must lie between two."""
    outcome: Outcome = "met" if low <= value <= high else "not met"
    return Verdict(quantity, f"{low:g}–{high:g} %", f"{value:.1f} %", outcome)


def of(case: str, seeds: int, verdicts: Sequence[Verdict]) -> list[Verdict]:
    """The same under the name of a case."""
    return [replace(verdict, case=case, seeds=seeds) for verdict in verdicts]


def verdict_table(verdicts: Sequence[Verdict]) -> list[str]:
    """All of them, and how many came out how."""
    count = {name: sum(v.outcome == name for v in verdicts) for name in get_args(Outcome)}
    rows = []
    last = ""
    for verdict in verdicts:
        # A case is named once.
        rows.append([verdict.case if verdict.case != last else "", *verdict.cells()[1:]])
        last = verdict.case
    return [
        f"{count['met']} of {len(verdicts)} met, {count['not met']} not met, "
        f"{count['below the bound']} below what any unbiased estimator can reach on this flight "
        "(“limit below the bound”).",
        "",
        *table(["case", "quantity", "limit", "measured", "seeds", "outcome"], rows),
    ]


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of Markdown."""
    return [*markdown(head, rows), ""]


def number(value: float) -> str:
    """Three digits."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "never"
    if abs(value) >= 100.0:
        return f"{value:.0f}"
    # Plain decimals: 3.6e-05 beside 0.12 is hard to read.
    return f"{value:.3g}" if abs(value) >= 1e-4 or value == 0.0 else f"{value:.5f}"


def _with_unit(value: float, unit: str) -> str:
    return f"{number(value)} {unit}".strip() if math.isfinite(value) else number(value)
