"""What a check has found: how it stands, and what to do about it."""

import enum
import sys
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any


class Sign(enum.StrEnum):
    """How something stands."""

    OK = "ok"
    WARNING = "warning"
    PROBLEM = "problem"


_MARKS = {Sign.OK: "✓", Sign.WARNING: "!", Sign.PROBLEM: "✗"}
_PLAIN_MARKS = {Sign.OK: "+", Sign.WARNING: "!", Sign.PROBLEM: "x"}


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        topic: what it is about, such as "UDP 14550".
        sign: how it stands.
        text: what was found.
        advice: what to do, one line each; commands as they are to be typed.
    """

    topic: str
    sign: Sign
    text: str
    advice: Sequence[str] = ()

    def as_json(self) -> dict[str, Any]:
        """For a machine to read."""
        return {
            "topic": self.topic,
            "sign": str(self.sign),
            "text": self.text,
            "advice": list(self.advice),
        }


def can_show(text: str, encoding: str | None = None) -> bool:
    """Whether an encoding has every character of a text; by default standard output's."""
    try:
        text.encode(encoding or sys.stdout.encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def worst(findings: Iterable[Finding]) -> Sign:
    """The gravest of the signs; ok where there is none."""
    order = list(Sign)
    return max((finding.sign for finding in findings), key=order.index, default=Sign.OK)


def as_text(findings: Iterable[Finding], width: int, *, unicode: bool) -> str:
    """Findings as lines: a mark and a word for the sign, then what was found and what to do.

    Args:
        findings: in the order to show.
        width: columns to keep to; advice is kept whole, to be copied.
        unicode: whether marks beyond ASCII can be shown.
    """
    marks = _MARKS if unicode else _PLAIN_MARKS
    lines = []
    for finding in findings:
        head = f"{marks[finding.sign]} {finding.sign:<8} "
        said = textwrap.wrap(
            f"{finding.topic}: {finding.text}",
            max(width, 40),
            initial_indent=head,
            subsequent_indent=" " * len(head),
            break_on_hyphens=False,
            break_long_words=False,
        )
        lines += [*said, *(f"{'':{len(head)}}-> {line}" for line in finding.advice)]
    return "\n".join(lines)
