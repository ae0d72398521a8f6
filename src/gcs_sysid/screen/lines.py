"""What panels are made of: lines of styled text, of which only those changed are drawn again.

Textual's own widgets format all their text again for any change of it. On a large screen whose
numbers change several times a second that was most of what the whole program cost.
"""

from itertools import groupby, zip_longest

from rich.segment import Segment
from rich.style import Style as SegmentStyle
from textual.app import ComposeResult
from textual.containers import VerticalScroll
from textual.content import Content
from textual.geometry import Region, Size
from textual.strip import Strip
from textual.style import Style
from textual.widget import Widget
from textual.widgets import Static

from gcs_sysid.errors import printable
from gcs_sysid.screen.view import View

Part = tuple[str, str]
"""Text without line ends, and its style as in Textual's markup."""
Line = list[Part]


class Lines(Widget):
    """Shows lines as they are, cut at the right edge."""

    ALLOW_SELECT = False

    def __init__(self, id: str | None = None, classes: str | None = None) -> None:
        super().__init__(id=id, classes=classes)
        self.lines: list[Line] = []
        """What is shown."""
        self._base: Style | None = None
        self._styles: dict[str, SegmentStyle] = {}

    def put(self, lines: list[Line]) -> None:
        """Show other lines; the terminal is touched only where they differ."""
        before, self.lines = self.lines, lines
        if len(before) != len(lines) and self.styles.auto_dimensions:
            self.refresh(layout=True)
            return
        pairs = enumerate(zip_longest(before, lines))
        stretches = groupby(pairs, key=lambda pair: pair[1][0] != pair[1][1])
        width = self.content_size.width
        changed = [[y for y, _ in stretch] for differs, stretch in stretches if differs]
        if changed:
            self.refresh(*(Region(0, ys[0], width, len(ys)) for ys in changed))

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        """All lines."""
        return len(self.lines)

    def render_line(self, y: int) -> Strip:
        """One line."""
        base = self.visual_style
        if base is not self._base:  # another theme, another class
            self._base = base
            self._styles = {"": base.rich_style}
        line = self.lines[y] if y < len(self.lines) else []
        strip = Strip([Segment(printable(text), self._style(style)) for text, style in line])
        return strip.adjust_cell_length(self.content_size.width, self._styles[""])

    def _style(self, style: str) -> SegmentStyle:
        found = self._styles.get(style)
        if found is None:
            assert self._base is not None
            self._styles[style] = found = (self._base + Style.parse(style)).rich_style
        return found


class Shown(Widget):
    """A panel that draws a view, and draws it again for another size.

    Comes last among bases: Textual takes the styles of the first.
    """

    _view: View | None = None

    def show(self, view: View) -> None:
        """Bring the panel up to date."""
        self._view = view
        self.lay_out(view)

    def lay_out(self, view: View) -> None:
        """Draw a view for the present size; does nothing where nothing of it has changed."""
        raise NotImplementedError

    def on_resize(self) -> None:
        """Lay out the panel again."""
        if self._view is not None:
            self.lay_out(self._view)


class WrappedLines(Static):
    """Lines that wrap. A layout of the screen is dear: only another number of rows asks for one."""

    def __init__(self, id: str) -> None:
        super().__init__(id=id)
        self.lines: list[Line] = []
        """What it shows."""

    def put(self, lines: list[Line], width: int) -> None:
        """Show other lines, in about so many columns."""
        if lines == self.lines:
            return
        before, self.lines = _rows(self.lines, width), lines
        content = Content("\n").join([Content.assemble(*line) for line in lines])
        self.update(content, layout=_rows(lines, width) != before)


def _rows(lines: list[Line], width: int) -> int:
    lengths = [sum(len(text) for text, _ in line) for line in lines]
    return sum(max(1, -(-length // max(1, width))) for length in lengths)


class ScrolledLines(VerticalScroll, Shown, can_focus=False):
    """Lines that scroll."""

    def __init__(self, id: str) -> None:
        super().__init__(id=id)
        self._text = Lines(classes="scrolled")

    def compose(self) -> ComposeResult:
        """One text for all lines."""
        yield self._text
