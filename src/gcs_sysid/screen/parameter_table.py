"""The parameter table: value, interval, unit, status, the way to the target, change, error."""

from collections.abc import Callable
from dataclasses import dataclass

from textual import events
from textual.app import ComposeResult
from textual.containers import VerticalScroll
from textual.geometry import Region
from textual.message import Message

from gcs_sysid.model.parameters import Parameter
from gcs_sysid.results import words
from gcs_sysid.results.result_view import ParameterRow, exponent_key
from gcs_sysid.results.words import percent_column, scaled_unit
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.lines import Line, Lines, Shown, WrappedLines
from gcs_sysid.screen.snapshot_view import converged
from gcs_sysid.screen.view import View

Cell = tuple[str, str]
"""Text of exactly the column's width, and its style."""


@dataclass(frozen=True)
class TableColumn:
    """One column: its head, and how to write its cell for a parameter."""

    head: str
    cell: Callable[[View, ParameterRow], Cell]
    rank: int = 0
    """Where there is no room for all columns, those of the highest rank go first."""
    wanted: Callable[[View], bool] = lambda view: True


def _exponent(view: View, row: ParameterRow) -> int:
    return view.exponents.get(exponent_key(row.parameter), 0)


def _value(view: View, row: ParameterRow) -> Cell:
    text = fmt.value_with_half(row.estimate, _exponent(view, row))
    return text, "bold" * row.estimate.shown


def _unit(view: View, row: ParameterRow) -> Cell:
    return scaled_unit(row.parameter.unit, _exponent(view, row)).ljust(11), ""


def _percent(view: View, row: ParameterRow) -> Cell:
    return row.figures.percent.rjust(6), ""


def _status(view: View, row: ParameterRow) -> Cell:
    known = row.status == row.estimate.status
    style = fmt.STATUS_STYLE[row.estimate.status] if known else fmt.MUTED
    return f"{row.sign} {row.status}".ljust(14), style


def _converged(view: View, row: ParameterRow) -> Cell:
    if row.estimate.status == "given":
        done = 1.0
    elif row.name in view.shares and view.snapshot is not None:
        done = converged(view.shares[row.name], view.snapshot.target)
    else:
        return " " * BAR, ""  # not requested
    return fmt.bar(done, BAR), f"{fmt.STATUS_STYLE[row.estimate.status]} on $panel"


def _truth(view: View, row: ParameterRow) -> Cell:
    if row.truth is None:
        return " " * fmt.NUMBER_WIDTH, ""
    return fmt.aligned(row.truth / 10.0 ** _exponent(view, row), 3), ""


def _error(view: View, row: ParameterRow) -> Cell:
    return percent_column(row.error, signed=True).rjust(7), ""


def _change(view: View, row: ParameterRow) -> Cell:
    found = None if view.comparison is None else view.comparison.differences.get(row.name)
    if found is None or row.estimate.status == "given":
        return " " * 8, ""
    share = None
    if found.value is not None and found.before is not None and found.before.value:
        share = found.value / abs(found.before.value)
    text = f"{words.CHANGE[found.verdict].sign}{percent_column(share, signed=True):>7}"
    return text, fmt.CHANGE_STYLE[found.verdict]


def _has_truth(view: View) -> bool:
    return bool(view.truth)


def _has_baseline(view: View) -> bool:
    return view.comparison is not None


BAR = 7
COLUMNS = (
    TableColumn("   value ± 95 %    ", _value),
    TableColumn("unit       ", _unit),
    TableColumn("  ± % ", _percent, 1),
    TableColumn("status        ", _status),
    TableColumn("target ", _converged, 3),
    TableColumn(" change ", _change, 2, _has_baseline),
    TableColumn("   truth", _truth, 5, _has_truth),
    TableColumn("  error", _error, 4, _has_truth),
)
"""In this order from left to right."""
NAME_HEAD = f" {'name':<{fmt.LABEL_WIDTH}}"


def _columns(view: View, width: int) -> list[TableColumn]:
    wanted = [column for column in COLUMNS if column.wanted(view)]
    while len(NAME_HEAD) + sum(len(c.head) + 1 for c in wanted) > width:
        least = max(wanted, key=lambda column: column.rank)
        if not least.rank:
            break
        wanted.remove(least)
    return wanted


def _line(name: Cell, cells: list[Cell]) -> Line:
    return [name, *(part for cell in cells for part in ((" ", ""), cell))]


def _lit(line: Line, width: int) -> Line:
    """A line on the color of what is chosen, to the edge of the table."""
    missing = width - sum(len(text) for text, _ in line)
    return [
        (text, style if " on " in style else f"{style} on $primary-muted")
        for text, style in (*line, (" " * missing, ""))
    ]


class ParameterRows(Lines):
    """The parameters, one a line."""

    class ParameterChosen(Message):
        """The user clicked on a parameter."""

        def __init__(self, name: str) -> None:
            super().__init__()
            self.parameter_name = name

    def __init__(self) -> None:
        super().__init__(id="parameter-rows")
        self.parameters: list[Parameter] = []
        """From top to bottom."""
        self._pointed: Parameter | None = None

    def write(self, view: View, columns: list[TableColumn]) -> None:
        """Write the cells again."""
        found = view.rows()
        self.parameters = [row.parameter for row in found]
        lines = [self._row(view, columns, row) for row in found]
        self.put(lines or [[(" No estimate yet.", fmt.MUTED)]])

    def _row(self, view: View, columns: list[TableColumn], row: ParameterRow) -> Line:
        chosen = view.selected == row.name
        name = ("▸" if chosen else " ") + words.label(row.name).ljust(fmt.LABEL_WIDTH)
        cells = [column.cell(view, row) for column in columns]
        line = _line((name, "bold" * chosen), cells)
        return _lit(line, self.content_size.width) if chosen else line

    def on_click(self, event: events.Click) -> None:
        """Choose the parameter under the mouse for the plot."""
        if event.y < len(self.parameters):
            self.post_message(self.ParameterChosen(self.parameters[event.y].name))

    def on_mouse_move(self, event: events.MouseMove) -> None:
        """Say what the parameter under the mouse is."""
        pointed = self.parameters[event.y] if event.y < len(self.parameters) else None
        if pointed is not self._pointed:
            self._pointed = pointed
            self.tooltip = None if pointed is None else f"{pointed.symbol}: {pointed.meaning}"


class ParameterTable(Shown):
    """All parameters of the result, and below them why a verdict is not better."""

    BORDER_TITLE = "Parameters"

    def __init__(self) -> None:
        super().__init__(id="parameters")
        self._head = Lines(id="parameters-head")
        self._holder = VerticalScroll(can_focus=False)
        self._why = WrappedLines("reasons")
        self._rows = ParameterRows()
        self._columns: list[TableColumn] = []

    def compose(self) -> ComposeResult:
        """Head, rows, reasons."""
        yield self._head
        with self._holder:
            yield self._rows
        yield self._why

    def lay_out(self, view: View) -> None:
        """Choose the columns, and write the rows and the reasons."""
        width = self.content_size.width
        columns = _columns(view, width)
        if columns != self._columns:
            self._columns = columns
            self._head.put([_line((NAME_HEAD, ""), [(c.head, "") for c in columns])])
        self._rows.write(view, columns)
        reasons = "" if view.snapshot is None else fmt.one_line(view.snapshot.result.reasons)
        self._why.display = bool(reasons)
        self._why.put([[("why  ", "bold"), (reasons, "")]], width - 2)

    def reveal(self, name: str) -> None:
        """Scroll a parameter into view."""
        names = [parameter.name for parameter in self._rows.parameters]
        if name in names:
            line = Region(0, names.index(name), 1, 1)
            self._holder.scroll_to_region(line, animate=False)
