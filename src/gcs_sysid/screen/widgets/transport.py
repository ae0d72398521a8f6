"""The transport bar of a replay: where it stands, how fast it goes, and a click to go elsewhere."""

from collections.abc import Callable
from dataclasses import dataclass

from textual import events
from textual.content import Content
from textual.message import Message
from textual.widget import Widget

from gcs_sysid.results.number_format import clock
from gcs_sysid.results.snapshot import Playback
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.snapshot_view import playback_text
from gcs_sysid.screen.widgets.lines import Line

KEYS = "space · ← → 10 s · [ ] speed"


@dataclass(frozen=True)
class Transport:
    """What moves a replay. Each returns at once, with what happens in a few words.

    Attributes:
        toggle_pause: pause, or go on.
        change_speed: so many steps faster, or slower.
        seek: go to so many seconds of the flight.
        skip: go on by so many seconds, or back.
    """

    toggle_pause: Callable[[], str]
    change_speed: Callable[[int], str]
    seek: Callable[[float], str]
    skip: Callable[[float], str]


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
