"""The live screen's application: polls a snapshot source, does what keys ask; its themes.

That of a replay is the same with keys to pause, to go elsewhere and faster.
"""

import os
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, TypeGuard, TypeVar

from textual.app import App, SystemCommand
from textual.binding import Binding, BindingType
from textual.driver import Driver
from textual.screen import Screen
from textual.theme import Theme
from textual.worker import Worker, WorkerState

from gcs_sysid.errors import GcsSysidError, InputError, in_words
from gcs_sysid.model.airframe import ANCHORS
from gcs_sysid.results import words
from gcs_sysid.results.comparison import Comparison, compare
from gcs_sysid.results.result_file import read_result
from gcs_sysid.results.result_view import rows
from gcs_sysid.results.snapshot import Event, LinkState, Snapshot
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.bars import TransportBar
from gcs_sysid.screen.call_outs import Announcer
from gcs_sysid.screen.key_commands import (
    COMMANDS,
    PAGES,
    REPLAY_COMMANDS,
    Choose,
    Dialog,
    Enter,
    HelpScreen,
    bindings_of,
)
from gcs_sysid.screen.main_view import MainScreen, PageBar, PilotScreen
from gcs_sysid.screen.panels import ParameterRows
from gcs_sysid.screen.snapshot_view import shares
from gcs_sysid.screen.terminal import ending_with_its_terminal
from gcs_sysid.screen.view import EarlierResult, Scene, View

if TYPE_CHECKING:  # see `view`
    from gcs_sysid.live.live_session import LiveSession
    from gcs_sysid.live.live_view import Session

T = TypeVar("T")

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


class SysidApp(App[None]):
    """The live screen on a snapshot source.

    `time_source` gives seconds that only grow; tests put their own here.
    """

    CSS_PATH = "screen.tcss"
    ENABLE_COMMAND_PALETTE = True
    # The keys of the main screen are in main_view.py; this one works everywhere.
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+c,ctrl+q", "quit", "Quit", show=False, priority=True),
    ]

    def __init__(
        self,
        source: "Session",
        scene: Scene | None = None,
        time_source: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self.source = source
        self.scene = scene = scene or Scene()
        self.baseline = scene.baseline
        self._marks = 0
        self._at_work: set[str] = set()
        self.truth = scene.truth
        self.title = "gcs-sysid"
        self.selected = ""
        self.paused = False
        self._time = time_source
        self.snapshot: Snapshot | None = None
        self._exponents: dict[str, int] = {}
        self._received = (-1, time_source())
        self._last_event: Event | None = None
        self._compared: Comparison | None = None
        self.announcer = scene.announcer or Announcer(now=time_source)
        self._large: PilotScreen | None = None
        """The pilot view, while it covers the main screen."""
        self.defect: Exception | None = None
        """What the screen has failed of."""
        self._main = MainScreen(self.title)
        self.register_theme(DARK)
        self.register_theme(LIGHT)
        self.theme = DARK.name

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
        # At most five redraws a second.
        self.set_interval(0.2, self.poll)

    def on_unmount(self) -> None:
        """No call-out outlives the screen."""
        self.announcer.close()

    def on_main_screen_ready(self) -> None:
        """Draw at once, without waiting for the next tick."""
        self.poll(force=True)
        if self.scene.large:
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
        changed = snapshot is not self.snapshot
        # While a link is silent nothing arrives, yet the time of silence grows.
        lost = snapshot is not None and snapshot.link.state is LinkState.LOST
        if not (changed or lost or force):
            return
        if not self.paused:
            self.snapshot = snapshot
            self._report_newest_event()
        self.draw()

    def draw(self) -> None:
        """Draw the present view, unless the screen is being left: nothing can be added then."""
        if not self._main.is_attached:
            return
        if self.snapshot is not None:
            self._exponents = fmt.choose_exponents(
                self.snapshot.result, self.truth, self._exponents
            )
        names = self._names()
        if self.selected not in names:
            self.selected = self._first_choice()
        view = View(
            snapshot=self.snapshot,
            truth=self.truth,
            selected=self.selected,
            exponents=self._exponents,
            silence=self._time() - self._received[1],
            paused=self.paused,
            shares={} if self.snapshot is None else shares(self.snapshot.result),
            baseline="" if self.baseline is None else self.baseline.name,
            comparison=self._compare(),
        )
        if self._large is None:
            self._main.show(view)
        elif self._large.picture.is_attached:
            self._large.picture.show(view)

    def _compare(self) -> Comparison | None:
        """The present result with the baseline; built again only where either is new."""
        if self.snapshot is None or self.baseline is None:
            return None
        before, after = self.baseline.result, self.snapshot.result
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
        if self.snapshot is None:
            return []
        return [parameter.name for parameter, _ in rows(self.snapshot.result)]

    def _first_choice(self) -> str:
        """The first parameter that is being identified: a given one has no history to watch."""
        if self.snapshot is None:
            return ""
        found = rows(self.snapshot.result)
        free = [p.name for p, estimate in found if estimate.status != "given"]
        return (free or self._names() or [""])[0]

    def _report_newest_event(self) -> None:
        newest = self.snapshot.events[-1] if self.snapshot and self.snapshot.events else None
        if newest is not None and newest != self._last_event:
            self._answer(newest.text, newest.t)
        self._last_event = newest

    # -- answers

    def say(self, text: str) -> None:
        """Answer an action with a sentence above the footer."""
        self._answer(text, None if self.snapshot is None else self.snapshot.t)

    def _answer(self, text: str, t: float | None) -> None:
        self._main.answer.say(text, t)
        if self._large is not None and self._large.answer.is_attached:
            self._large.answer.say(text, t)

    # -- what is done to the session, each with a word of what happened

    def _ask(self, action: Callable[[], str]) -> None:
        """Do something with the source, and say what came of it, even if it failed."""
        try:
            self.say(action())
        except (GcsSysidError, OSError) as error:
            self.say(f"Not done: {error}")

    def _offers(self, action: T | None, what: str) -> TypeGuard[T]:
        """Whether the source can do this; where it cannot, that is said."""
        if action is None:
            self.say(f"{what}: not {self.scene.absent}.")
        return action is not None

    def _in_thread(self, what: str, action: Callable[[], str]) -> None:
        """Do something that takes its time, beside the flow of data."""
        if what in self._at_work:
            self.say(f"{what}: the last one is not finished.")
            return
        self._at_work.add(what)
        self.say(f"{what}: working ...")

        def work() -> None:
            try:
                answer = action()
            except (GcsSysidError, OSError) as error:
                answer = f"Not done: {error}"
            if self.is_running:  # else the user has left meanwhile
                self.call_from_thread(self.say, answer)

        # A defect in there is reported too, and must not end a session in flight.
        self.run_worker(work, name=what, thread=True, exit_on_error=False)

    def on_worker_state_changed(self, event: Worker.StateChanged) -> None:
        """Something beside the flow of data has come to its end."""
        if event.worker.is_finished:
            self._at_work.discard(event.worker.name)
        if event.state is WorkerState.ERROR:
            assert event.worker.error is not None
            self.say(f"{event.worker.name}: {in_words(event.worker.error)}")

    def _answered(self, question: Dialog, nothing: str, do: Callable[[str], None]) -> None:
        """Ask, and do something with the answer; say so where there is none."""
        self.push_screen(question, lambda got: self.say(nothing) if got is None else do(got))

    # -- marks, the estimate, the recording

    def action_mark(self) -> None:
        """Mark the present instant with a number; a pilot has no hand free to type."""
        live = self.scene.live
        if not self._offers(live, "Mark"):
            return

        def mark() -> str:
            live.mark(f"mark {self._marks + 1}")
            self._marks += 1
            return f"Marked: mark {self._marks}"

        self._ask(mark)

    def action_reset(self) -> None:
        """Restart the estimate, once the user has confirmed: the data so far are discarded."""
        live = self.scene.live
        if not self._offers(live, "Reset"):
            return

        def reset() -> str:
            live.reset()
            return "Reset: the estimate restarts."

        def confirmed(answer: str | None) -> None:
            if answer == "reset":
                self._ask(reset)
            else:
                self.say("Reset: cancelled.")

        choices = [("keep", "keep the estimate"), ("reset", "discard the data so far")]
        self.push_screen(Choose("Reset the estimate?", choices), confirmed)

    def action_record(self) -> None:
        """Start or stop recording."""
        if self._offers(live := self.scene.live, "Record"):
            self._ask(live.toggle_recording)

    # -- files

    def action_export(self) -> None:
        """Write the present result for a simulator."""
        act = self.scene.export
        if not self._offers(act, "Export"):
            return
        if self.snapshot is None:
            self.say("Nothing to export yet.")
            return
        result = self.snapshot.result

        def write(target: str) -> None:
            self._in_thread("Export", lambda: act(target, result))

        targets = [(name, name) for name in self.scene.export_targets]
        hint = "Writes the present values to a new file."
        choose = Choose("Export for a simulator", targets, hint)
        self._answered(choose, "Export: nothing written.", write)

    def action_report(self) -> None:
        """Write a report of the flight so far."""
        if self._offers(act := self.scene.report, "Report"):
            self._in_thread("Report", act)

    # -- scale and vehicle

    def action_scale(self) -> None:
        """Set the scale: first which quantity, then its value."""
        live = self.scene.live
        if not self._offers(live, "Scale"):
            return
        if self.snapshot is None:
            self.say("No result yet.")
            return
        result = self.snapshot.result
        thrust = result.rotor_input.thrust
        words = {
            "mass": "mass, weighed, kg",
            "k_T": "k_T, thrust over speed squared, N s²",
            "T_max": "T_max, thrust of a rotor at full command, N",
        }
        now = "nothing" if result.scale is None else f"{result.scale.anchor} {result.scale.value:g}"

        def ask_value(kind: str) -> None:
            known = result.parameters.get(kind)
            value = "" if known is None or known.value is None else f"{known.value:.6g}"
            hint = f"{words[kind]}. Scales all masses, inertias and coefficients."
            enter, unchanged = Enter("Scale", hint, value), "Scale unchanged."
            self._answered(enter, unchanged, lambda text: self._set_anchor(live, kind, text))

        kinds = [(kind, words[kind]) for kind in ("mass", thrust)]
        choose = Choose("What sets the scale?", kinds, f"Now: {now}")
        self._answered(choose, "Scale unchanged.", ask_value)

    def _set_anchor(self, live: "LiveSession", kind: str, text: str) -> None:
        try:
            value = float(text.replace(",", "."))
        except ValueError:
            self.say(f"Not done: {text!r} is not a number ({ANCHORS[kind]} wanted)")  # type: ignore[index]
            return
        self._ask(lambda: live.set_anchor(kind, value))

    def action_vehicle(self) -> None:
        """Choose among the vehicles on the link."""
        live = self.scene.live
        if not self._offers(live, "Vehicle"):
            return
        received = () if self.snapshot is None else self.snapshot.link.vehicles
        if len(received) < 2:
            self.say("Only one vehicle on the link." if received else "No vehicle yet.")
            return
        by_name = {vehicle.name: vehicle for vehicle in received}

        def choose(name: str) -> None:
            if by_name[name].chosen:
                self.say("Vehicle unchanged.")
                return
            self._ask(lambda: live.choose_vehicle(by_name[name].address))

        listed = [(v.name, f"{'●' if v.chosen else '○'} {v.name}") for v in received]
        hint = "Another vehicle restarts the session in a new recording."
        self._answered(Choose("Which vehicle?", listed, hint), "Vehicle unchanged.", choose)

    # -- an earlier result

    def action_baseline(self) -> None:
        """Ask for an earlier result to compare with."""
        near = sorted(str(path) for path in Path().glob("*.json"))
        hint = "A result written by --json; empty: no baseline."
        value = "" if self.baseline is None else self.baseline.name
        enter = Enter("Compare with", hint, value, near)
        self._answered(enter, "Baseline unchanged.", self._load_baseline)

    def _load_baseline(self, name: str) -> None:
        if not name:
            self.baseline = None
            self.say("Baseline removed.")
            self.draw()
            return

        def load() -> str:
            found = read_result(Path(os.path.expanduser(name)))
            if self.snapshot is not None:
                compare(found, self.snapshot.result)  # another vehicle is refused
            self.baseline = EarlierResult(name, found)
            return f"Compared with {name}: {found.verdict}, from {found.source or 'one flight'}"

        self._ask(load)
        self.draw()

    # -- what is shown

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
        snapshot = self.snapshot
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


class ReplayApp(SysidApp):
    """The screen on a recorded flight, which can be moved."""

    BINDINGS: ClassVar[list[BindingType]] = [*bindings_of(REPLAY_COMMANDS)]

    def __init__(
        self,
        source: "Session",
        scene: Scene,
        time_source: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(source, scene, time_source)
        assert scene.replay is not None
        self.replay = scene.replay
        self._bar = TransportBar()

    def on_main_screen_ready(self) -> None:
        """Put the transport bar above the answers."""
        self._main.mount(self._bar, before="#answer")

    def draw(self) -> None:
        """Draw the present view."""
        super().draw()
        self._bar.show(None if self.snapshot is None else self.snapshot.playback)

    def action_pause(self) -> None:
        """Pause the replay, or let it go on."""
        self._ask(self.replay.toggle_pause)

    def action_speed(self, step: int) -> None:
        """Faster or slower."""
        self._ask(lambda: self.replay.change_speed(step))

    def action_skip(self, seconds: float) -> None:
        """Go on by so many seconds, or back."""
        self._ask(lambda: self.replay.skip(seconds))

    def action_seek(self, position: float) -> None:
        """Go to so many seconds of the flight."""
        self._ask(lambda: self.replay.seek(position))

    def action_to_end(self) -> None:
        """Go to the end, where the numbers are final."""
        playback = None if self.snapshot is None else self.snapshot.playback
        self.action_seek(0.0 if playback is None else playback.duration)

    def on_transport_bar_position_chosen(self, message: TransportBar.PositionChosen) -> None:
        """A click into the bar goes there."""
        self.action_seek(message.position)

    def action_help(self) -> None:
        """Show the help screen."""
        live = [command for command in COMMANDS if command.title != "Pause"]
        self.push_screen(HelpScreen((*REPLAY_COMMANDS, *live)))

    def get_system_commands(self, screen: Screen[object]) -> Iterable[SystemCommand]:
        """The actions, in the command palette."""
        for title, meaning, action in (
            ("Beginning", "Replay from the start", lambda: self.action_seek(0.0)),
            ("End", "To the final numbers", self.action_to_end),
            ("Faster", "1x, 10x, max", lambda: self.action_speed(1)),
            ("Slower", "max, 10x, 1x", lambda: self.action_speed(-1)),
        ):
            yield SystemCommand(title, meaning, action)
        yield from super().get_system_commands(screen)


def app_of(source: "Session", scene: Scene) -> SysidApp:
    """A new application on a source; there may be several."""
    return (SysidApp if scene.replay is None else ReplayApp)(source, scene)
