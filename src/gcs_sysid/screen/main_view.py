"""The main screen: lays the panels out for the terminal's size and passes views on to them."""

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

from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.bars import AnswerLine, Banner, CoachPanel, StatusLine, VerdictPanel
from gcs_sysid.screen.key_commands import COMMANDS, PAGES, bindings_of
from gcs_sysid.screen.lines import Shown
from gcs_sysid.screen.panels import AttitudePanel, EventLog, HealthPanel, LinkPanel
from gcs_sysid.screen.parameter_table import ParameterTable
from gcs_sysid.screen.plots import AccelerationPanel, Convergence
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
        self._health = HealthPanel()
        self._link, self._attitude, self.events = LinkPanel(), AttitudePanel(), EventLog()

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
            if isinstance(panel, Shown) and (isinstance(panel, Hiding) or _displayed(panel)):
                panel.show(view)

    def _show_again(self) -> None:
        if self._view is not None:
            self.show(self._view)


def _displayed(panel: Widget) -> bool:
    return all(node.display for node in panel.ancestors_with_self)
