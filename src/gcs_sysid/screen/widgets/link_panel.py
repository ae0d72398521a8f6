"""The link panel: rates got and asked per message, losses, gaps, clock, recording."""

from textual.app import ComposeResult
from textual.containers import VerticalScroll

from gcs_sysid.results.snapshot import LinkStatus
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.view import View
from gcs_sysid.screen.widgets.lines import Line, Lines

SCROLLBAR = 2
"""Columns that the scroll bar takes when there are many messages."""
ENOUGH = 0.9
"""A message that comes at less than this fraction of the rate asked for is marked."""

_WARNING = "$text-warning"
_MOST_PPM = 10_000.0
"""No clock drifts by a hundredth; a computer that falls behind makes it seem so."""


def facts(link: LinkStatus) -> list[tuple[str, str, str]]:
    """Name, text and style of each line above the messages."""
    rejected = f"rejected {fmt.grouped(link.rejected)}"
    lost = f"{fmt.grouped(link.lost)} ({link.lost_percent:.1f} %), {rejected}"
    gaps = "none" if not link.gaps else f"{link.gaps}, the last {link.last_gap or 0.0:.2f} s"
    drift = link.clock_ppm
    known = drift is not None and abs(drift) <= _MOST_PPM
    clock = f"{drift:+.0f} ppm" if known else "unknown"
    return [
        ("link", f"{fmt.LINK_SIGN[link.state]} {link.url}", ""),
        ("received", f"{fmt.grouped(link.received)}, {fmt.data_rate(link.bytes_per_second)}", ""),
        ("lost", lost, _WARNING if link.lost_percent >= 1.0 or link.rejected else ""),
        ("IMU gaps", gaps, _WARNING if link.gaps else ""),
        ("clock", clock, ""),
        *(
            [("computer", f"too slow: {link.waiting:.1f} s wait", _WARNING)]
            if link.too_slow
            else []
        ),
        *(
            [("dropped", f"{fmt.grouped(link.dropped)} by the system", _WARNING)]
            if link.dropped
            else []
        ),
        *([("unknown", f"{fmt.grouped(link.unknown)} frames", "")] if link.unknown else []),
        ("record", link.recording or "off", "bold $text-error" if link.recording else ""),
    ]


def message_line(name: str, got: float, asked: float | None, width: int) -> Line:
    """One message with its rates; a sign says whether it comes as asked."""
    room = max(8, width - 14)
    shown = name if len(name) <= room else name[: room - 1] + "…"
    parts = [(f"{shown:<{room}}{got:6.1f}", "")]
    if asked is None:
        return [*parts, (" " * 6, "")]
    low = got < ENOUGH * asked
    return [
        *parts,
        (f"{asked:6.0f}", fmt.MUTED),
        (" !" if low else " ✓", "bold $text-warning" if low else "$text-success"),
    ]


class LinkPanel(VerticalScroll, can_focus=False):
    """Health of the link; scrolls where a vehicle sends more than fits."""

    BORDER_TITLE = "Link"

    def __init__(self) -> None:
        super().__init__(id="link")
        self._text = Lines(id="link-lines")
        self._view: View | None = None

    def compose(self) -> ComposeResult:
        """One text for all lines."""
        yield self._text

    def show(self, view: View) -> None:
        """Bring the panel up to date."""
        self._view = view
        lines = self._lines(view)
        # Messages come and go; a panel that shrinks each time would force a new layout of the
        # screen.
        lines += [[]] * (len(self._text.lines) - len(lines))
        self._text.put(lines)

    def on_resize(self) -> None:
        """Lay out the columns again."""
        if self._view is not None:
            self.show(self._view)

    def _lines(self, view: View) -> list[Line]:
        if view.snapshot is None:
            return [[("no link yet", fmt.MUTED)]]
        link = view.snapshot.link
        room = (self.content_size.width or 36) - SCROLLBAR
        width = min(room, 44)
        lines: list[Line] = []
        for name, text, style in facts(link):
            # The end of a path or an address says more than its beginning.
            shown = text if len(text) <= room - 9 else "…" + text[max(1, len(text) - room + 10) :]
            lines.append([(f"{name:<9}", fmt.MUTED), (shown, style)])
        # What was asked for first: the identification needs it.
        names = sorted(set(link.rates) | set(link.asked), key=lambda n: (n not in link.asked, n))
        if names:
            lines.append([(f"{'message':<{max(8, width - 14)}}{'Hz':>6}{'asked':>6}", fmt.MUTED)])
        lines += [
            message_line(name, link.rates.get(name, 0.0), link.asked.get(name), width)
            for name in names
        ]
        return lines
