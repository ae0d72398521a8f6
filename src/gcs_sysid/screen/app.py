"""The live screen's application: polls a snapshot source, answers keys; its themes."""

import os
import time
from collections.abc import Callable, Iterable, Mapping
from typing import ClassVar

from textual.app import SystemCommand
from textual.binding import Binding, BindingType
from textual.driver import Driver
from textual.screen import Screen
from textual.theme import Theme

from gcs_sysid.errors import InputError
from gcs_sysid.results import words
from gcs_sysid.results.comparison import Comparison, compare
from gcs_sysid.results.result_view import rows
from gcs_sysid.results.snapshot import Event, LinkState, Snapshot
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.actions import ActingApp
from gcs_sysid.screen.call_outs import Announcer
from gcs_sysid.screen.dialogs import HelpScreen
from gcs_sysid.screen.key_commands import COMMANDS, PAGES
from gcs_sysid.screen.main_view import MainScreen, PageBar
from gcs_sysid.screen.pilot_view import PilotScreen
from gcs_sysid.screen.snapshot_view import shares
from gcs_sysid.screen.terminal import ending_with_its_terminal
from gcs_sysid.screen.view import Actions, EarlierResult, SnapshotSource, View
from gcs_sysid.screen.widgets.parameter_table import ParameterRows

DARK = Theme(
    name="gcs-dark",
    dark=True,
    primary="#3d8bd9",
    secondary="#5a7fa3",
    accent="#f0b429",
    success="#57c285",
    warning="#f0b429",
    error="#e0607e",
    foreground="#e4e8ec",
    background="#101418",
    surface="#151a20",
    panel="#232c36",
)
LIGHT = Theme(
    name="gcs-light",
    dark=False,
    primary="#1769c2",
    secondary="#44617d",
    accent="#0b5cad",
    success="#17803d",
    warning="#c07a00",
    error="#d61f55",
    foreground="#14191e",
    background="#f1f4f7",
    surface="#ffffff",
    panel="#e3e9ef",
    # Paler than derived: muted and warning text on the chosen row must reach a contrast of 4.5.
    variables={"primary-muted": "#c9dcf0"},
)
"""Bright ground for sunlight on a field."""
POLL_SECONDS = 0.2
"""At most five redraws a second."""


class SysidApp(ActingApp):
    """The live screen on a snapshot source.

    Args:
        source: the session.
        truth: true values by parameter name, where the vehicle is an emulator that reports them.
        actions: what can be done with the source.
        baseline: an earlier result to compare with.
        title: shown until the vehicle has a name.
        time_source: seconds that only grow; tests put their own here.
    """

    CSS_PATH = "screen.tcss"
    ENABLE_COMMAND_PALETTE = True
    # The keys of the main screen are in main_view.py; this one works everywhere.
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+c,ctrl+q", "quit", "Quit", show=False, priority=True),
    ]

    def __init__(
        self,
        source: SnapshotSource,
        truth: Mapping[str, float] | None = None,
        actions: Actions | None = None,
        baseline: EarlierResult | None = None,
        title: str = "gcs-sysid",
        time_source: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(actions or Actions(), baseline)
        self.source = source
        self.truth: Mapping[str, float] = dict(truth or {})
        self.title = title
        self.selected = ""
        self.paused = False
        self._time = time_source
        self._snapshot: Snapshot | None = None
        self._exponents: dict[str, int] = {}
        self._received = (-1, time_source())
        self._last_event: Event | None = None
        self._compared: Comparison | None = None
        self.announcer = Announcer(now=time_source)
        """Calls out what is new; the creator of the application may replace it."""
        self._large: PilotScreen | None = None
        """The pilot view, while it covers the main screen."""
        self.begins_large = False
        """Whether the pilot view comes first."""
        self.defect: Exception | None = None
        """What the screen has failed of."""
        self._main = MainScreen(title)
        self.register_theme(DARK)
        self.register_theme(LIGHT)
        self.theme = DARK.name

    @property
    def snapshot(self) -> Snapshot | None:
        """What is shown."""
        return self._snapshot

    def get_driver_class(self) -> type[Driver]:
        """Textual's, which ends when its terminal is closed."""
        return ending_with_its_terminal(super().get_driver_class())

    @property
    def is_abandoned(self) -> bool:
        """Whether the terminal it is shown on has gone, and with it all keys."""
        return bool(getattr(self._driver, "is_gone", False))

    def _handle_exception(self, error: Exception) -> None:
        """Leave; its message is printed by the caller, in a line."""
        super()._handle_exception(error)
        self.defect = self.defect or error
        if not os.environ.get("GCS_SYSID_DEBUG"):
            self._exit_renderables.clear()

    # -- the flow of snapshots

    def get_default_screen(self) -> Screen[None]:
        """The main screen."""
        return self._main

    def on_mount(self) -> None:
        """Start polling; the first snapshot is drawn as soon as the screen stands."""
        self.announcer.ring = self.bell
        self.set_interval(POLL_SECONDS, self.poll)

    def on_unmount(self) -> None:
        """No call-out outlives the screen."""
        self.announcer.close()

    def on_main_screen_ready(self) -> None:
        """Draw at once, without waiting for the next tick."""
        self.poll(force=True)
        if self.begins_large:
            self.action_pilot_view()

    def poll(self, force: bool = False) -> None:
        """Take the newest snapshot and draw it, if there is something new to draw."""
        if self.is_abandoned:
            self.exit()
            return
        if not self._main.ready:  # a tick can come while the screen is built up or torn down
            return
        snapshot = self.source.latest()
        if snapshot is not None and snapshot.link.received != self._received[0]:
            self._received = (snapshot.link.received, self._time())
        self.announcer.see(snapshot)
        if self.paused and not force:
            return
        changed = snapshot is not self._snapshot
        # While a link is silent nothing arrives, yet the time of silence grows.
        lost = snapshot is not None and snapshot.link.state is LinkState.LOST
        if not (changed or lost or force):
            return
        if not self.paused:
            self._snapshot = snapshot
            self._report_newest_event()
        self.draw()

    def draw(self) -> None:
        """Draw the present view, unless the screen is being left: nothing can be added then."""
        if not self._main.is_attached:
            return
        if self._snapshot is not None:
            self._exponents = fmt.choose_exponents(
                self._snapshot.result, self.truth, self._exponents
            )
        names = self._names()
        if self.selected not in names:
            self.selected = self._first_choice()
        view = View(
            snapshot=self._snapshot,
            truth=self.truth,
            selected=self.selected,
            exponents=self._exponents,
            silence=self._time() - self._received[1],
            paused=self.paused,
            shares={} if self._snapshot is None else shares(self._snapshot.result),
            baseline="" if self.baseline is None else self.baseline.name,
            comparison=self._compare(),
        )
        if self._large is None:
            self._main.show(view)
        elif self._large.picture.is_attached:
            self._large.picture.show(view)

    def _compare(self) -> Comparison | None:
        """The present result with the baseline; built again only where either is new."""
        if self._snapshot is None or self.baseline is None:
            return None
        before, after = self.baseline.result, self._snapshot.result
        known = self._compared
        if known is None or known.before is not before or known.after is not after:
            try:
                self._compared = known = compare(before, after)
            except InputError as error:  # another vehicle was chosen
                self.baseline = None
                self.say(f"Baseline removed: {error}")
                return None
        return known

    def _names(self) -> list[str]:
        if self._snapshot is None:
            return []
        return [parameter.name for parameter, _ in rows(self._snapshot.result)]

    def _first_choice(self) -> str:
        """The first parameter that is being identified: a given one has no history to watch."""
        if self._snapshot is None:
            return ""
        found = rows(self._snapshot.result)
        free = [p.name for p, estimate in found if estimate.status != "given"]
        return (free or self._names() or [""])[0]

    def _report_newest_event(self) -> None:
        newest = self._snapshot.events[-1] if self._snapshot and self._snapshot.events else None
        if newest is not None and newest != self._last_event:
            self._answer(newest.text, newest.t)
        self._last_event = newest

    # -- answers

    def say(self, text: str) -> None:
        """Answer an action with a sentence above the footer."""
        self._answer(text, None if self._snapshot is None else self._snapshot.t)

    def _answer(self, text: str, t: float | None) -> None:
        self._main.answer.say(text, t)
        if self._large is not None and self._large.answer.is_attached:
            self._large.answer.say(text, t)

    # -- actions

    async def action_quit(self) -> None:
        """End the session and leave."""
        self.source.stop()
        self.exit()

    def action_select(self, step: int) -> None:
        """Choose the next or previous parameter for the plot."""
        names = self._names()
        if not names:
            self.say("No parameters yet.")
            return
        self._select(names[(names.index(self.selected) + step) % len(names)])

    def _select(self, name: str) -> None:
        self.selected = name
        self.draw()
        self._main.table.reveal(name)
        self.say(f"Plot: {words.label(name)}")

    def action_pause(self) -> None:
        """Freeze or resume the display."""
        self.paused = not self.paused
        self.say("Display paused." if self.paused else "Display resumed.")
        self.poll(force=True)

    def action_pilot_view(self) -> None:
        """The coach in large print."""

        def back(_: None) -> None:
            # The main screen has what came meanwhile to draw.
            self._large = None
            self.draw()

        if self._large is None:
            self._large = PilotScreen()
            self.push_screen(self._large, back)

    def action_call_outs(self) -> None:
        """Off, voice, bell."""
        self.say(self.announcer.next_mode())

    def action_toggle_dark(self) -> None:
        """Dark or light; from any other theme, to the one of opposite brightness."""
        wanted = LIGHT if self.current_theme.dark else DARK
        self.theme = wanted.name
        self.say("Light theme." if wanted is LIGHT else "Dark theme.")

    def action_page(self, step: int) -> None:
        """The next page, or the next plot where the panels have room."""
        pages = self._main.pages
        if not pages:
            self.say("All panels are on the screen.")
            return
        now = self._main.page
        place = pages.index(now) if now in pages else 0
        self.action_go(pages[(place + step) % len(pages)])

    def action_go(self, page: str) -> None:
        """A page by name."""
        if page not in self._main.pages:
            self.say(f"{PAGES[page]}: is on the screen.")
            return
        self._main.select_page(page)
        self.say(f"Page: {PAGES[page]}")

    def action_scroll_events(self, step: int) -> None:
        """Scroll the event log."""
        log = self._main.events
        log.scroll_relative(y=step * max(1, log.size.height - 1), animate=False)

    def action_help(self) -> None:
        """Show the help screen."""
        snapshot = self._snapshot
        ended = snapshot is not None and snapshot.link.state is LinkState.ENDED
        self.push_screen(HelpScreen(ended=ended))

    def on_parameter_rows_parameter_chosen(self, message: ParameterRows.ParameterChosen) -> None:
        """A click on a parameter chooses it."""
        self._select(message.parameter_name)

    def on_page_bar_page_chosen(self, message: PageBar.PageChosen) -> None:
        """A click on a page title shows the page."""
        self.action_go(message.page)

    def get_system_commands(self, screen: Screen[object]) -> Iterable[SystemCommand]:
        """The actions, in the command palette."""
        for command in COMMANDS:
            if command.title:
                action = getattr(self, f"action_{command.bindings[0][1]}")
                yield SystemCommand(command.title, command.meaning, action)
        for page in self._main.pages:
            yield SystemCommand(
                f"Page {PAGES[page]}", "Show it", lambda page=page: self.action_go(page)
            )
        for name in self._names():
            yield SystemCommand(
                f"Plot {words.label(name)}",
                "Show its convergence",
                lambda name=name: self._select(name),
            )
        yield from super().get_system_commands(screen)
