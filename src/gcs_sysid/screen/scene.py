"""The application of a session or a replay, wherever it stands: a terminal or a browser.

That of a replay is the live screen with keys to pause, to go elsewhere and faster.
"""

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from textual.app import SystemCommand
from textual.binding import BindingType
from textual.screen import Screen

from gcs_sysid.screen.app import SysidApp
from gcs_sysid.screen.call_outs import Announcer
from gcs_sysid.screen.dialogs import HelpScreen
from gcs_sysid.screen.key_commands import COMMANDS, REPLAY_COMMANDS, bindings_of
from gcs_sysid.screen.view import Actions, EarlierResult, SnapshotSource
from gcs_sysid.screen.widgets.transport import Transport, TransportBar


class ReplayApp(SysidApp):
    """The screen on a recorded flight.

    Args:
        source: the replay.
        transport: what moves it.
        truth: as of `SysidApp`.
        actions: as of `SysidApp`.
        baseline: as of `SysidApp`.
        time_source: as of `SysidApp`.
    """

    BINDINGS: ClassVar[list[BindingType]] = [*bindings_of(REPLAY_COMMANDS)]

    def __init__(
        self,
        source: SnapshotSource,
        transport: Transport,
        truth: Mapping[str, float] | None = None,
        actions: Actions | None = None,
        baseline: EarlierResult | None = None,
        time_source: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(source, truth, actions, baseline, time_source)
        self.transport = transport
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
        self._ask(self.transport.toggle_pause)

    def action_speed(self, step: int) -> None:
        """Faster or slower."""
        self._ask(lambda: self.transport.change_speed(step))

    def action_skip(self, seconds: float) -> None:
        """Go on by so many seconds, or back."""
        self._ask(lambda: self.transport.skip(seconds))

    def action_seek(self, position: float) -> None:
        """Go to so many seconds of the flight."""
        self._ask(lambda: self.transport.seek(position))

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


@dataclass(frozen=True)
class Scene:
    """All that an application is made of but its source.

    Attributes:
        truth: true values by parameter name, where known.
        actions: what can be done with the source.
        transport: what moves it, where it is a replay.
        baseline: an earlier result to compare with.
        announcer: calls out what is new; None: one that is off.
        large: whether the pilot view comes first.
    """

    truth: Mapping[str, float] = field(default_factory=dict)
    actions: Actions = field(default_factory=Actions)
    transport: Transport | None = None
    baseline: EarlierResult | None = None
    announcer: Announcer | None = None
    large: bool = False

    def app(self, source: SnapshotSource) -> SysidApp:
        """A new application on a source; there may be several."""
        made = (
            SysidApp(source, self.truth, self.actions, self.baseline)
            if self.transport is None
            else ReplayApp(source, self.transport, self.truth, self.actions, self.baseline)
        )
        made.announcer = self.announcer or made.announcer
        made.begins_large = self.large
        return made
