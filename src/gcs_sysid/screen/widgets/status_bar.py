"""The top line (vehicle, link, flight), the banner below it, and the line of answers."""

from textual.content import Content
from textual.widgets import Static

from gcs_sysid.results.number_format import clock, clock_tenths, pretty_unit
from gcs_sysid.results.snapshot import LinkState
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.snapshot_view import LINK_SIGN
from gcs_sysid.screen.view import View
from gcs_sysid.screen.widgets.lines import Line


class StatusLine(Static):
    """One line that says at a glance how the session stands."""

    def __init__(self, title: str) -> None:
        super().__init__(id="status")
        self.title_text = title
        self._parts: Line = []

    def show(self, view: View) -> None:
        """Bring the line up to date."""
        parts = self._parts_of(view)
        if parts != self._parts:
            self._parts = parts
            self.refresh()

    def _parts_of(self, view: View) -> Line:
        snapshot = view.snapshot
        if snapshot is None:
            return [(self.title_text, "bold"), ("○ opening", "$text-warning")]
        link, result = snapshot.link, snapshot.result
        state = (f"{LINK_SIGN[link.state]} {link.state}", fmt.LINK_STYLE[link.state])
        if link.state is LinkState.WAITING:  # no flight and no verdict yet
            return [(self.title_text, "bold"), state]
        flight = "flying" if snapshot.flying else "on ground"
        parts = [
            (link.vehicle or self.title_text, "bold"),
            state,
            (f"{clock(snapshot.t)} {flight}", ""),
            (f"used {clock(snapshot.used_seconds)}", ""),
        ]
        if result.scale is not None:
            scale = result.scale
            parts.append((f"scale: {scale.anchor} {scale.value:.4g} {pretty_unit(scale.unit)}", ""))
        if len(link.vehicles) > 1:
            parts.append((f"v: {len(link.vehicles)} vehicles", "bold $text-warning"))
        if link.recording:
            parts.append(("◉ REC", "bold $text-error"))
        return parts

    def render(self) -> Content:
        """The parts, as many as the width takes; the first (a name) is cut when it must be."""
        width = max(1, self.size.width - 2)
        parts = list(self._parts)
        while len(parts) > 2 and sum(len(text) + 2 for text, _ in parts[1:]) + 8 > width:
            parts.pop(3 if len(parts) > 4 else 2)
        rest = sum(len(text) + 2 for text, _ in parts[1:])
        pieces: list[Content | tuple[str, str]] = []
        for index, (text, style) in enumerate(parts):
            if index == 0:
                room = max(1, width - rest)
                text = text if len(text) <= room else text[: room - 1] + "…"
            else:
                pieces.append(("  ", ""))
            pieces.append((text, style))
        return Content(" ") + Content.assemble(*pieces)


class Banner(Static):
    """What the user should know before reading on; hidden while all is well."""

    LEVELS = ("info", "warning", "error")

    def __init__(self) -> None:
        super().__init__(id="banner")
        self._shown: tuple[str, str] | None = None
        self._text = ""
        self.display = False

    def show(self, view: View) -> None:
        """Bring the banner up to date."""
        notice = view.notice()
        if notice == self._shown:
            return
        self._shown = notice
        self.display = notice is not None
        if notice is not None:
            text, level = notice
            for name in self.LEVELS:
                self.set_class(name == level, f"-{name}")
            before, self._text = self._text, text
            width = self.size.width
            grown = fmt.wrapped([before], width) != fmt.wrapped([text], width)
            self.update(Content(text), layout=grown)


class AnswerLine(Static):
    """The line above the footer: the answer to the last key, or the newest event."""

    def __init__(self) -> None:
        super().__init__(id="answer")
        self.text = ""

    def say(self, text: str, t: float | None = None) -> None:
        """Put a sentence on the line, with the session's time where there is one."""
        self.text = text
        stamp = "" if t is None else f"{clock_tenths(t)} "
        self.update(Content.assemble((stamp, fmt.MUTED), text), layout=False)
