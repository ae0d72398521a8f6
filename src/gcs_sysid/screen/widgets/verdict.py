"""The verdict: what is identified, how well, and what is not. To be read from two meters."""

from textwrap import shorten, wrap

from textual.content import Content
from textual.widgets import Static

from gcs_sysid.results.snapshot import LinkState, Snapshot
from gcs_sysid.results.summary import before_data, contradicted
from gcs_sysid.screen.snapshot_view import (
    Level,
    Standing,
    compared,
    headline,
    level_of,
    named,
    short_headline,
    sign_of,
    standing_of,
)
from gcs_sysid.screen.text_drawing import HEIGHT, big
from gcs_sysid.screen.view import View
from gcs_sysid.screen.widgets.lines import Line

_TITLE = len("✗ unobservable")


def verdict_lines(snapshot: Snapshot, width: int, *, large: bool) -> list[Line]:
    """The verdict in large letters with three lines beside them, or in one line where none fit.

    Args:
        snapshot: to show.
        width: columns.
        large: whether there are lines enough for large letters.
    """
    standing = standing_of(snapshot)
    for text in (headline(snapshot), short_headline(snapshot)) if large else ():
        why = _contradiction(snapshot)
        if why:
            lines = _large_contradiction(why, text, width)
        else:
            lines = _large(text, snapshot, standing, width)
        if lines:
            return lines
    return [_small(snapshot, standing, width)]


def _absent(snapshot: Snapshot) -> str:
    """What parameters without an estimate are: before there are data, none is unobservable."""
    return "○ waiting" if before_data(snapshot) else "✗ unobservable"


def _small(snapshot: Snapshot, standing: Standing, width: int) -> Line:
    text = short_headline(snapshot) if width < 78 else headline(snapshot)
    head = f"{sign_of(snapshot)} {text} {standing.reached}/{standing.total}"
    parts: Line = [(head, "bold")]
    why = _contradiction(snapshot)
    if why:
        return [*parts, (f"   {shorten(why, width - len(head) - 3, placeholder='…')}", "bold")]
    room = width - len(head)
    groups = [("~ weak", standing.weak), (_absent(snapshot), standing.missing)]
    groups = [(title, group) for title, group in groups if group]
    if not groups:
        groups = [("widest", standing.known[:1])]
    for number, (title, group) in enumerate(groups):
        share = room // (len(groups) - number)
        shares = group is not standing.missing
        text = named(group, share - len(title) - 4, shares=shares, target=snapshot.target)
        parts += [(f"   {title} ", "bold"), (text, "")]
        room -= len(title) + len(text) + 4
    return parts


def _contradiction(snapshot: Snapshot) -> str:
    """What is wrong with the airframe: the one thing to be known before take-off."""
    return contradicted(snapshot.result).partition(": ")[2]


def _large_contradiction(why: str, text: str, width: int) -> list[Line]:
    letters = big(text)
    room = width - len(letters[0]) - 3
    beside = wrap(why, max(room, 1), max_lines=HEIGHT, placeholder="…")
    if room < 40:  # columns that three lines of words need
        return []
    beside += [""] * (HEIGHT - len(beside))
    return [
        [(line, ""), ("   ", ""), (words, "bold")]
        for line, words in zip(letters, beside, strict=True)
    ]


def _large(text: str, snapshot: Snapshot, standing: Standing, width: int) -> list[Line]:
    """Nothing where it does not fit: a line that wraps would shift the letters."""
    letters = big(f"{text} {standing.reached}/{standing.total}")
    # Beside the letters stand a title, how many there are in its group, and their names.
    room = width - len(letters[0]) - 3 - _TITLE - 4
    target = snapshot.target
    known = f"{standing.reached} within the target of ±{100.0 * target:g} %"
    if len(known) > room:
        return []
    if standing.known:
        widest = f"{known}, widest {named(standing.known[:1], width, target=target)}"
        known = widest if len(widest) <= room else known
    beside = (
        ("✓ identified", len(standing.known), known),
        ("~ weak", len(standing.weak), named(standing.weak, room, target=target)),
        (_absent(snapshot), len(standing.missing), named(standing.missing, room, shares=False)),
    )
    assert len(beside) == HEIGHT
    return [
        [
            (line, ""),
            ("   ", ""),
            (f"{title:<{_TITLE}}", "bold"),
            (f"{count:>2}  ", "bold"),
            (text, ""),
        ]
        for line, (title, count, text) in zip(letters, beside, strict=True)
    ]


class VerdictPanel(Static):
    """One line on a small terminal, large letters with three lines beside them on others."""

    LEVELS: tuple[Level, ...] = ("identified", "partial", "refused", "waiting")

    def __init__(self) -> None:
        super().__init__(id="verdict")
        self.large = False
        self._view: View | None = None
        self.lines: list[Line] = []
        """What it shows."""
        self.display = False

    def show(self, view: View) -> None:
        """Bring the panel up to date."""
        self._view = view
        snapshot = view.snapshot
        self.display = snapshot is not None and snapshot.link.state is not LinkState.WAITING
        if snapshot is None or not self.display:
            return
        for level in self.LEVELS:
            self.set_class(level == level_of(snapshot), f"-{level}")
        width = max(40, self.screen.size.width - 2)
        lines = verdict_lines(snapshot, width, large=self.large)
        if view.comparison is not None:
            name = f"against {view.baseline}"
            sign, text = compared(view.comparison, width - len(name) - 4)
            lines.append([(f"{sign} ", "bold"), (f"{name}: ", ""), (text, "bold")])
        if lines != self.lines:
            grown = len(lines) != len(self.lines)
            self.lines = lines
            text_lines = [Content.assemble(*line) for line in lines]
            self.update(Content("\n").join(text_lines), layout=grown)

    def on_resize(self) -> None:
        """Lay out the lines again."""
        if self._view is not None:
            self.show(self._view)
