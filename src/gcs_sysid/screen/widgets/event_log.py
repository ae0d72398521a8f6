"""The event log, the newest at the bottom."""

import textwrap

from gcs_sysid.results.number_format import clock_tenths
from gcs_sysid.results.snapshot import Event
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.view import View
from gcs_sysid.screen.widgets.lines import Line, ScrolledLines


def event_lines(event: Event, width: int) -> list[Line]:
    """An event, its text wrapped beside its time."""
    stamp = f"{clock_tenths(event.t)}  "
    texts = textwrap.wrap(event.text, max(1, width - len(stamp))) or [""]
    stamps = [stamp, *[" " * len(stamp)] * (len(texts) - 1)]
    return [[(time, fmt.MUTED), (text, "")] for time, text in zip(stamps, texts, strict=True)]


class EventLog(ScrolledLines):
    """What happened, with times."""

    BORDER_TITLE = "Events"

    def __init__(self) -> None:
        super().__init__("events")
        self._shown: tuple[tuple[Event, ...], int] | None = None
        self._scrolling = True

    def lay_out(self, view: View) -> None:
        """Write the log, and follow its end unless the user has scrolled up."""
        found = () if view.snapshot is None else view.snapshot.events
        width = self.scrollable_content_region.width
        if (found, width) == self._shown:
            return
        follows = self._scrolling or self.scroll_offset.y >= self.max_scroll_y
        self._shown = found, width
        lines = [line for event in found for line in event_lines(event, width)]
        self._text.put(lines or [[("no events yet", fmt.MUTED)]])
        if follows:
            # Where the end is, is known once the new lines are laid out.
            self._scrolling = True
            self.call_after_refresh(self._to_end)

    def _to_end(self) -> None:
        self._scrolling = False
        # At once: a later event would find the log above its end, as if the user had scrolled.
        self.scroll_end(animate=False, immediate=True)
