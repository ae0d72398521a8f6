"""The bars above and below the panels: status, banner, verdict, coach, transport, answers."""

from textwrap import shorten, wrap

from textual import events
from textual.content import Content
from textual.message import Message
from textual.widget import Widget
from textual.widgets import Static

from gcs_sysid.results.snapshot import Advice, LinkState, Playback, Snapshot
from gcs_sysid.results.summary import before_data, contradicted
from gcs_sysid.results.words import clock, clock_tenths, pretty_unit
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.formatting import HEIGHT, big
from gcs_sysid.screen.lines import Line, Shown, WrappedLines
from gcs_sysid.screen.snapshot_view import (
    LINK_SIGN,
    Level,
    Standing,
    compared,
    gain_text,
    headline,
    level_of,
    named,
    playback_text,
    seconds_left,
    short_headline,
    sign_of,
    standing_of,
)
from gcs_sysid.screen.view import View


class StatusLine(Static, Shown):
    """One line that says at a glance how the session stands."""

    def __init__(self, title: str) -> None:
        super().__init__(id="status")
        self.title_text = title
        self._parts: Line = []

    def lay_out(self, view: View) -> None:
        """Put the parts together."""
        parts = self._parts_of(view)
        if parts != self._parts:
            self._parts = parts
            self.refresh()

    def _parts_of(self, view: View) -> Line:
        snapshot = view.snapshot
        if snapshot is None:
            return [(self.title_text, "bold"), ("○ opening", "$text-warning")]
        link, result = snapshot.link, snapshot.result
        state = (f"{LINK_SIGN[link.state]} {link.state}", fmt.LINK_STYLE[link.state])
        if link.state is LinkState.WAITING:  # no flight and no verdict yet
            return [(self.title_text, "bold"), state]
        flight = "flying" if snapshot.flying else "on ground"
        parts = [
            (link.vehicle or self.title_text, "bold"),
            state,
            (f"{clock(snapshot.t)} {flight}", ""),
            (f"used {clock(snapshot.used_seconds)}", ""),
        ]
        if result.scale is not None:
            scale = result.scale
            parts.append((f"scale: {scale.anchor} {scale.value:.4g} {pretty_unit(scale.unit)}", ""))
        if len(link.vehicles) > 1:
            parts.append((f"v: {len(link.vehicles)} vehicles", "bold $text-warning"))
        if link.recording:
            parts.append(("◉ REC", "bold $text-error"))
        return parts

    def render(self) -> Content:
        """The parts, as many as the width takes; the first (a name) is cut when it must be."""
        width = max(1, self.size.width - 2)
        parts = list(self._parts)
        while len(parts) > 2 and sum(len(text) + 2 for text, _ in parts[1:]) + 8 > width:
            parts.pop(3 if len(parts) > 4 else 2)
        rest = sum(len(text) + 2 for text, _ in parts[1:])
        pieces: list[Content | tuple[str, str]] = []
        for index, (text, style) in enumerate(parts):
            if index == 0:
                room = max(1, width - rest)
                text = text if len(text) <= room else text[: room - 1] + "…"
            else:
                pieces.append(("  ", ""))
            pieces.append((text, style))
        return Content(" ") + Content.assemble(*pieces)


class Banner(WrappedLines, Shown):
    """What the user should know before reading on; hidden while all is well."""

    LEVELS = ("info", "warning", "error")

    def __init__(self) -> None:
        super().__init__(id="banner")
        self.display = False

    def lay_out(self, view: View) -> None:
        """Write the notice, if there is one."""
        notice = view.notice()
        self.display = notice is not None
        if notice is not None:
            text, level = notice
            for name in self.LEVELS:
                self.set_class(name == level, f"-{name}")
            self.put([[(text, "")]], self.size.width)


class AnswerLine(Static):
    """The line above the footer: the answer to the last key, or the newest event."""

    def __init__(self) -> None:
        super().__init__(id="answer")
        self.text = ""

    def say(self, text: str, t: float | None = None) -> None:
        """Put a sentence on the line, with the session's time where there is one."""
        self.text = text
        stamp = "" if t is None else f"{clock_tenths(t)} "
        self.update(Content.assemble((stamp, fmt.MUTED), text), layout=False)


_TITLE = len("✗ unobservable ")


def verdict_lines(snapshot: Snapshot, width: int, *, large: bool) -> list[Line]:
    """The verdict in large letters with three lines beside them, or in one line where none fit.

    `large`: there are lines enough for large letters.
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


class VerdictPanel(WrappedLines, Shown):
    """One line on a small terminal, large letters with three lines beside them on others."""

    LEVELS: tuple[Level, ...] = ("identified", "partial", "refused", "waiting")

    def __init__(self) -> None:
        super().__init__(id="verdict")
        self.large = False
        self.display = False

    def lay_out(self, view: View) -> None:
        """Write the verdict, and beside it what has changed since the baseline."""
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
        self.put(lines, width)


def advice_lines(advice: Advice, width: int) -> list[Line]:
    """The advice as lines: what to fly, then progress and gains."""
    if advice.enough:
        return [[("✓ ENOUGH  ", "bold $text-success"), (advice.text, "bold")]]
    if not advice.manoeuvre:
        return [[("COACH  ", "bold $text-primary"), (advice.text, "")]]
    parts: Line = [
        (fmt.bar(advice.progress, 20), "$text-primary on $panel"),
        (f" {100.0 * advice.progress:3.0f} %  {seconds_left(advice):.0f} s left", "bold"),
    ]
    room = width - sum(len(text) for text, _ in parts)
    for gain in advice.gains:
        text = f"   {gain_text(gain)}"
        room -= len(text)
        if room < 0:
            break
        parts.append((text, ""))
    return [[("▶ FLY  ", "bold $text-primary"), (advice.text, "bold")], parts]


class CoachPanel(WrappedLines, Shown):
    """Draws the advice of the snapshot; hidden while there is none."""

    def __init__(self) -> None:
        super().__init__(id="coach")
        self.display = False

    def lay_out(self, view: View) -> None:
        """Write the advice, if there is any."""
        advice = None if view.snapshot is None else view.snapshot.advice
        self.display = advice is not None
        if advice is not None:
            width = max(40, self.screen.size.width - 2)
            self.put(advice_lines(advice, width), width)


KEYS = "space · ← → 10 s · [ ] speed"


class TransportBar(Widget):
    """One line above the answers."""

    DEFAULT_CSS = "TransportBar { height: 1; background: $panel; padding: 0 1; }"

    class PositionChosen(Message):
        """The user clicked into the bar."""

        def __init__(self, position: float) -> None:
            super().__init__()
            self.position = position
            """s of the flight."""

    def __init__(self) -> None:
        super().__init__(id="transport")
        self._playback: Playback | None = None

    def show(self, playback: Playback | None) -> None:
        """Bring the line up to date."""
        if playback != self._playback:
            self._playback = playback
            if self.is_mounted:
                self.refresh()

    def _layout(self) -> tuple[Line, int, int, Line]:
        """What stands before the bar, its first column and width, and what stands after it."""
        playback = self._playback
        if playback is None:
            return [], 0, 0, []
        before: Line = [
            (f"{playback_text(playback):<14} ", "bold $text-primary"),
            (f"{clock(playback.position)} ", ""),
        ]
        after: Line = [(f" {clock(playback.duration)}", "")]
        if self.size.width >= 76:
            after.append((f"  {KEYS}", fmt.MUTED))
        start = sum(len(text) for text, _ in before)
        room = self.size.width - start - sum(len(text) for text, _ in after)
        # A bar of a few columns gives way to the numbers.
        return before, start, room if room >= 10 else 0, after

    def render(self) -> Content:
        """State, position, bar, duration, keys."""
        playback = self._playback
        before, _, width, after = self._layout()
        if playback is None:
            return Content("")
        share = playback.position / playback.duration if playback.duration > 0.0 else 0.0
        done = min(round(share * width), width)
        bar: Line = [("━" * done, "$text-primary"), ("─" * (width - done), fmt.MUTED)]
        return Content.assemble(*before, *bar, *after)

    def on_click(self, event: events.Click) -> None:
        """Go where the mouse points."""
        _, start, width, _ = self._layout()
        # The padding's column comes before the line.
        column = event.x - 1 - start
        if self._playback is not None and width and 0 <= column < width:
            share = column / max(width - 1, 1)
            self.post_message(self.PositionChosen(share * self._playback.duration))
