"""The main screen, which lays the panels out for the terminal's size; and the pilot view.

That is the coach in letters that are read from two meters, and nothing else.
"""

from collections.abc import Sequence
from typing import ClassVar

from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container
from textual.content import Content
from textual.message import Message
from textual.screen import Screen
from textual.widget import Widget
from textual.widgets import Footer

from gcs_sysid.results.snapshot import LinkState, Snapshot
from gcs_sysid.results.summary import contradicted
from gcs_sysid.results.words import clock
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.bars import AnswerLine, Banner, CoachPanel, StatusLine, VerdictPanel
from gcs_sysid.screen.formatting import big, height_of
from gcs_sysid.screen.key_commands import COMMANDS, PAGES, bindings_of
from gcs_sysid.screen.lines import Line, Lines, Shown
from gcs_sysid.screen.panels import AttitudePanel, EventLog, HealthPanel, LinkPanel, ParameterTable
from gcs_sysid.screen.plots import AccelerationPanel, Convergence
from gcs_sysid.screen.snapshot_view import (
    Known,
    headline,
    seconds_left,
    short_headline,
    standing_of,
)
from gcs_sysid.screen.view import View

Hiding = Banner | VerdictPanel | CoachPanel
"""Panels that hide themselves while they have nothing to say."""


class PageBar(Widget):
    """One line of page titles; a click or a number key chooses one."""

    class PageChosen(Message):
        """The user clicked on a page."""

        def __init__(self, page: str) -> None:
            super().__init__()
            self.page = page

    def __init__(self) -> None:
        super().__init__(id="pages")
        self.page = next(iter(PAGES))

    def select(self, page: str) -> None:
        """Light up another title."""
        self.page = page
        self.refresh()

    def _titles(self) -> list[tuple[str, str]]:
        """Number and title of each; where all do not fit, only the selected page has its title."""
        numbered = list(enumerate(PAGES.items(), start=1))
        whole = [(name, f" {number} {title} ") for number, (name, title) in numbered]
        if sum(len(text) + 1 for _, text in whole) - 1 <= self.size.width:
            return whole
        return [
            (name, text if name == self.page else f" {number} ")
            for number, (name, text) in enumerate(whole, start=1)
        ]

    def render(self) -> Content:
        """The titles; brackets as well as color say which page it is."""
        parts: list[tuple[str, str]] = []
        for name, title in self._titles():
            on = name == self.page
            text = f"[{title[1:-1]}]" if on else title
            parts += [(text, "bold $text-primary on $primary-muted" if on else fmt.MUTED)]
            parts += [(" ", "")]
        return Content.assemble(*parts[:-1])

    def on_click(self, event: events.Click) -> None:
        """Find the title under the mouse."""
        x = 0
        for name, title in self._titles():
            if x <= event.x < x + len(title):
                self.post_message(self.PageChosen(name))
                return
            x += len(title) + 1


def layout_classes(width: int, height: int) -> set[str]:
    """The CSS classes of a terminal size."""
    classes = set()
    # From this size on, all panels stand side by side; below it, pages.
    if width < 118 or height < 34:
        classes.add("-paged")
        # From this height on, the first page holds the plot too.
        if height >= 40:
            classes.add("-tall")
        # Below it the table needs the columns of the scroll bar.
        if width < 62:
            classes.add("-narrow")
    else:
        # From this size on, the right side has two columns of its own.
        wide = width >= 196 and height >= 40
        classes.add("-wide" if wide else "-columns")
    return classes


class MainScreen(Screen[None]):
    """Verdict, coach, parameters, plots, health, link, attitude, events."""

    # Nothing here takes the focus, so that every key means the same everywhere.
    AUTO_FOCUS = None
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("q", "app.quit", "Quit"),
        *bindings_of(COMMANDS),
    ]

    class Ready(Message):
        """All panels stand and can be drawn."""

    def __init__(self, title: str) -> None:
        super().__init__(classes="page-parameters")
        self.page = "parameters"
        self._view: View | None = None
        # A new panel is added here, in compose and in the style sheet.
        self.ready = False
        self.answer = AnswerLine()
        self._pages = PageBar()
        self._status, self._banner = StatusLine(title), Banner()
        self.table, self._plot = ParameterTable(), Convergence()
        self._verdict, self._coach = VerdictPanel(), CoachPanel()
        # Two places for one panel, of which the size of the terminal shows one at most.
        self._motion = AccelerationPanel("motion")
        self._motion_aside = AccelerationPanel("motion-aside")
        self._health = HealthPanel("health")
        self._link, self._attitude, self.events = LinkPanel("link"), AttitudePanel(), EventLog()

    def compose(self) -> ComposeResult:
        """The panels; where they stand is up to the style sheet."""
        yield self._status
        yield self._banner
        yield self._verdict
        yield self._coach
        yield self._pages
        with Container(id="body"):
            with Container(id="left"):
                yield self.table
                yield self._plot
                yield self._motion
                yield self._health
            with Container(id="right"):
                with Container(id="vehicle"):
                    yield self._link
                    yield self._attitude
                yield self._motion_aside
                yield self.events
        yield self.answer
        yield Footer(compact=True, show_command_palette=False)

    def on_mount(self) -> None:
        """Choose the layout before the first drawing, then ask for it."""
        self._lay_out(self.app.size.width, self.app.size.height)
        self.ready = True
        self.post_message(self.Ready())

    def on_unmount(self) -> None:
        """Nothing may be drawn any more."""
        self.ready = False

    def on_resize(self, event: events.Resize) -> None:
        """Choose the layout for the new size."""
        self._lay_out(event.size.width, event.size.height)

    def _lay_out(self, width: int, height: int) -> None:
        wanted = layout_classes(width, height)
        for name in ("-paged", "-tall", "-narrow", "-columns", "-wide"):
            self.set_class(name in wanted, name)
        self._verdict.large = "-paged" not in wanted
        self.call_after_refresh(self._show_again)

    @property
    def pages(self) -> list[str]:
        """Those that there is a choice of, at this size of the terminal."""
        if self.has_class("-paged"):
            return list(PAGES)
        return ["plot", "motion", "health"] if self.has_class("-columns") else ["plot", "health"]

    def select_page(self, page: str) -> None:
        """Show another page (seen only on small terminals, kept for when it shrinks)."""
        for name in PAGES:
            self.set_class(name == page, f"page-{name}")
        self.page = page
        self._pages.select(page)
        self._show_again()

    def show(self, view: View) -> None:
        """Bring everything that is visible up to date; hidden panels cost nothing."""
        self._view = view
        for panel in self.walk_children():
            if isinstance(panel, Shown):
                shown = all(node.display for node in panel.ancestors_with_self)
                if shown or isinstance(panel, Hiding):
                    panel.show(view)

    def _show_again(self) -> None:
        if self._view is not None:
            self.show(self._view)


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

    Where even small letters do not fit, the last lines are cut.
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
        self.picture, self.answer = PilotView("pilot-view"), AnswerLine()

    def compose(self) -> ComposeResult:
        """The picture over a line of answers."""
        yield self.picture
        yield self.answer
        yield Footer(compact=True, show_command_palette=False)

    def on_mount(self) -> None:
        """Draw what the main screen shows."""
        self.call_after_refresh(self.app.draw)  # type: ignore[attr-defined]
