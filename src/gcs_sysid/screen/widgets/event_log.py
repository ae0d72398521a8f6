"""The event log, the newest at the bottom."""

from textual.app import ComposeResult
from textual.containers import VerticalScroll
from textual.content import Content
from textual.widgets import Static

from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.view import View
from gcs_sysid.session.snapshot import Event


class EventLog(VerticalScroll, can_focus=False):
    """What happened, with times."""

    BORDER_TITLE = "Events"

    def __init__(self) -> None:
        super().__init__(id="events")
        self._text = Static(id="event-lines")
        self._events: tuple[Event, ...] | None = None

    def compose(self) -> ComposeResult:
        """One text for all lines: the log is short and changes rarely."""
        yield self._text

    def show(self, view: View) -> None:
        """Bring the log up to date, and follow its end unless the user has scrolled up."""
        found = () if view.snapshot is None else view.snapshot.events
        if found == self._events:
            return
        at_end = self._events is None or self.scroll_offset.y >= self.max_scroll_y
        self._events = found
        lines = [
            Content.assemble((f"{fmt.clock_tenths(e.t)}  ", fmt.MUTED), e.text) for e in found
        ] or [Content.styled("nothing yet", fmt.MUTED)]
        self._text.update(Content("\n").join(lines))
        if at_end:
            self.scroll_end(animate=False)
