"""The pilot view: the coach in letters that are read from two meters, and nothing else."""

from collections.abc import Sequence
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.screen import Screen
from textual.widgets import Footer

from gcs_sysid.results.number_format import clock
from gcs_sysid.results.snapshot import LinkState, Snapshot
from gcs_sysid.results.summary import contradicted
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.bars import AnswerLine
from gcs_sysid.screen.formatting import big, height_of
from gcs_sysid.screen.lines import Line, Lines, Shown
from gcs_sysid.screen.snapshot_view import (
    Known,
    headline,
    seconds_left,
    short_headline,
    standing_of,
)
from gcs_sysid.screen.view import View

_LINK_WORDS = {
    LinkState.WAITING: "NO VEHICLE YET",
    LinkState.CONNECTED: "LINK OK",
    LinkState.REPLAY: "REPLAY",
    LinkState.LOST: "LINK LOST",
    LinkState.ENDED: "STREAM ENDED",
}
Block = tuple[Sequence[str], str]
"""Texts of one block, the first that fits is taken, and the style."""


def blocks(view: View) -> tuple[list[Block], float | None]:
    """What is written large, from top to bottom, and the share flown of the maneuver."""
    snapshot = view.snapshot
    if snapshot is None:
        return [(["OPENING"], "$text-warning")], None
    state = snapshot.link.state
    link = _LINK_WORDS[state]
    if state is LinkState.LOST:
        timed = [f"{link} {view.silence:.0f} S", link]
    elif state is LinkState.CONNECTED:
        timed = [f"{link} {clock(snapshot.t)}", link]
    else:
        timed = [link]
    out: list[Block] = [(timed, fmt.LINK_STYLE[state])]
    if state is LinkState.WAITING:
        return out, None
    advice, share = snapshot.advice, None
    if advice is not None and advice.manoeuvre:
        out += [([order.upper()], "bold") for order in advice.axes or (advice.manoeuvre,)]
        out.append(([f"{seconds_left(advice):.0f} S LEFT"], "$text-primary"))
        share = advice.progress
    elif contradicted(snapshot.result):
        out.append(([headline(snapshot), short_headline(snapshot)], "$text-error"))
    elif not snapshot.flying and state is not LinkState.ENDED:
        out.append((["ON GROUND"], "bold"))
    else:
        out.append(([headline(snapshot), short_headline(snapshot)], "bold"))
    out.append((_missing(snapshot), "$text-warning" if _short(snapshot) else "$text-success"))
    return out, share


def _short(snapshot: Snapshot) -> list[Known]:
    """The parameters short of the target: what is unobservable, then the widest first."""
    standing = standing_of(snapshot)
    target = snapshot.target
    wide = [known for known in standing.known if known[1] is None or known[1] > target]
    return [*standing.missing, *standing.weak, *wide]


def _missing(snapshot: Snapshot, most: int = 6) -> list[str]:
    """How many reach the target, and as many names as there may be room for of those short."""
    standing = standing_of(snapshot)
    count = f"{standing.reached}/{standing.total}"
    names = [name.upper() for name, _ in _short(snapshot)]
    if not names:
        return [f"{count} ALL", count]
    out = []
    for head in (f"{count} NEED", count):
        for shown in range(min(len(names), most), 0, -1):
            rest = len(names) - shown
            out.append(" ".join([head, *names[:shown], *([f"+{rest}"] if rest else [])]))
    return [*out, count]


def pilot_lines(view: View, width: int, height: int) -> list[Line]:
    """The picture: each block in the largest letters that leave room for the others.

    Args:
        view: to draw.
        width: columns.
        height: lines; where even small letters do not fit, the last lines are cut.
    """
    wanted, share = blocks(view)
    # Columns of a dot; larger letters would leave no room for a maneuver's axes.
    scale = 4
    bar = 0 if share is None else 1
    while scale > 1 and len(wanted) * height_of(scale) + bar > height:
        scale -= 1
    drawn = [_letters(texts, width, scale) for texts, _ in wanted]
    lines: list[Line] = []
    spare = height - sum(map(len, drawn)) - bar
    gap = 1 if spare >= len(drawn) - 1 else 0
    for number, (letters, (_, style)) in enumerate(zip(drawn, wanted, strict=True)):
        if number and gap:
            lines.append([])
        if share is not None and number == len(drawn) - 1:
            lines.append([(fmt.bar(share, width), "$text-primary on $panel")])
        lines += [[(line, style)] for line in letters]
    return lines[:height]


def _letters(texts: Sequence[str], width: int, largest: int) -> list[str]:
    """The first text that fits, as large as it can be; plain where none does."""
    for text in texts:
        least = 1 if text is texts[-1] else min(2, largest)
        for scale in range(largest, least - 1, -1):
            letters = big(text, scale)
            if len(letters[0]) <= width:
                return letters
    for text in texts:
        letters = big(text)
        if len(letters[0]) <= width:
            return letters
    return [texts[-1][:width]]


class PilotView(Lines, Shown):
    """Draws the pilot view of the newest snapshot."""

    def __init__(self) -> None:
        super().__init__(id="pilot-view")

    def lay_out(self, view: View) -> None:
        """Draw the picture in letters for the size."""
        lost = view.snapshot is not None and view.snapshot.link.state is LinkState.LOST
        self.set_class(lost, "-lost")
        size = self.content_size
        if size.width > 0:
            self.put(pilot_lines(view, size.width, size.height))


class PilotScreen(Screen[None]):
    """The coach in large print over the main screen; its key, or escape, leads back."""

    AUTO_FOCUS = None
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("l,escape", "dismiss", "Back", key_display="l"),
        Binding("m", "app.mark", "Mark"),
        Binding("a", "app.call_outs", "Call-outs"),
        Binding("d", "app.toggle_dark", "Dark/light"),
        Binding("question_mark", "app.help", "Help", key_display="?"),
        Binding("q", "app.quit", "Quit"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self.picture, self.answer = PilotView(), AnswerLine()

    def compose(self) -> ComposeResult:
        """The picture over a line of answers."""
        yield self.picture
        yield self.answer
        yield Footer(compact=True, show_command_palette=False)

    def on_mount(self) -> None:
        """Draw what the main screen shows."""
        self.call_after_refresh(self.app.draw)  # type: ignore[attr-defined]
