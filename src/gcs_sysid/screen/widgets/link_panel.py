"""The link panel: rates got and asked per message, losses, gaps, clock, recording."""

from gcs_sysid.results.number_format import data_rate, grouped
from gcs_sysid.results.snapshot import LinkStatus
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.snapshot_view import LINK_SIGN, MessageRate, message_rates
from gcs_sysid.screen.view import View
from gcs_sysid.screen.widgets.lines import Line, ScrolledLines

_WARNING = "$text-warning"


def facts(link: LinkStatus) -> list[tuple[str, str, str]]:
    """Name, text and style of each line above the messages."""
    rejected = f"rejected {grouped(link.rejected)}"
    lost = f"{grouped(link.lost)} ({link.lost_percent:.1f} %), {rejected}"
    gaps = "none" if not link.gaps else f"{link.gaps}, the last {link.last_gap or 0.0:.2f} s"
    drift = link.clock_ppm
    # No clock drifts by a hundredth; a computer that falls behind makes it seem so.
    known = drift is not None and abs(drift) <= 1e4
    clock = f"{drift:+.0f} ppm" if known else "unknown"
    return [
        ("link", f"{LINK_SIGN[link.state]} {link.url}", ""),
        ("received", f"{grouped(link.received)}, {data_rate(link.bytes_per_second)}", ""),
        ("lost", lost, _WARNING if link.lost_percent >= 1.0 or link.rejected else ""),
        ("IMU gaps", gaps, _WARNING if link.gaps else ""),
        ("clock", clock, ""),
        *(
            [("computer", f"too slow: {link.waiting:.1f} s wait", _WARNING)]
            if link.too_slow
            else []
        ),
        *(
            [("dropped", f"{grouped(link.dropped)} by the system", _WARNING)]
            if link.dropped
            else []
        ),
        *([("unknown", f"{grouped(link.unknown)} frames", "")] if link.unknown else []),
        ("record", link.recording or "off", "bold $text-error" if link.recording else ""),
    ]


def message_line(message: MessageRate, width: int) -> Line:
    """One message with its rates; a sign says whether it comes as asked."""
    name, room = message.name, max(8, width - 14)
    shown = name if len(name) <= room else name[: room - 1] + "…"
    parts = [(f"{shown:<{room}}{message.got:6.1f}", "")]
    if message.asked is None:
        return [*parts, (" " * 6, "")]
    return [
        *parts,
        (f"{message.asked:6.0f}", fmt.MUTED),
        (" !", "bold $text-warning") if message.slow else (" ✓", "bold $text-success"),
    ]


class LinkPanel(ScrolledLines):
    """Health of the link; scrolls where a vehicle sends more than fits."""

    BORDER_TITLE = "Link"

    def __init__(self) -> None:
        super().__init__("link")

    def lay_out(self, view: View) -> None:
        """Write figures and messages."""
        lines = self._lines(view)
        # Messages come and go; a panel that shrinks each time would force a new layout of the
        # screen.
        lines += [[]] * (len(self._text.lines) - len(lines))
        self._text.put(lines)

    def _lines(self, view: View) -> list[Line]:
        if view.snapshot is None:
            return [[("no link yet", fmt.MUTED)]]
        link = view.snapshot.link
        room = (self.content_size.width or 36) - 2  # of the scroll bar
        width = min(room, 44)
        lines: list[Line] = []
        for name, text, style in facts(link):
            # The end of a path or an address says more than its beginning.
            shown = text if len(text) <= room - 9 else "…" + text[max(1, len(text) - room + 10) :]
            lines.append([(f"{name:<9}", fmt.MUTED), (shown, style)])
        messages = message_rates(link)
        if messages:
            lines.append([(f"{'message':<{max(8, width - 14)}}{'Hz':>6}{'asked':>6}", fmt.MUTED)])
        lines += [message_line(message, width) for message in messages]
        return lines
