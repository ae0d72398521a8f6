"""The panels of the vehicle: parameters, link, attitude and rotors, health in hover, events.

A row of the parameter table is value, interval, unit, status, the way to the target, change, error.
"""

import math
import textwrap
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from textual import events
from textual.app import ComposeResult
from textual.containers import VerticalScroll
from textual.geometry import Region
from textual.message import Message

from gcs_sysid.model.parameters import AXES, Parameter
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results import words
from gcs_sysid.results.health_view import (
    absent_health,
    cg_facts,
    half_of,
    health_facts,
    rotor_cells,
    unequal_rotors,
)
from gcs_sysid.results.result_view import ParameterRow, exponent_key
from gcs_sysid.results.snapshot import Event, LinkStatus
from gcs_sysid.results.words import (
    PLAIN,
    clock_tenths,
    data_rate,
    grouped,
    percent_column,
    scaled_unit,
)
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.lines import Line, Lines, ScrolledLines, Shown, WrappedLines
from gcs_sysid.screen.snapshot_view import LINK_SIGN, MessageRate, converged, message_rates
from gcs_sysid.screen.view import View

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
    received = grouped(link.received)
    if link.bytes_per_second:  # a log has none
        received += f", {data_rate(link.bytes_per_second)}"
    some = [
        ("link", f"{LINK_SIGN[link.state]} {link.url}", ""),
        ("received", received, ""),
        ("lost", lost, _WARNING if link.lost_percent >= 1.0 or link.rejected else ""),
        ("IMU gaps", gaps, _WARNING if link.gaps else ""),
        ("clock", clock, ""),
    ]
    if link.too_slow:
        some.append(("computer", f"too slow: {link.waiting:.1f} s wait", _WARNING))
    if link.dropped:
        some.append(("dropped", f"{grouped(link.dropped)} by the system", _WARNING))
    if link.unknown:
        some.append(("unknown", f"{grouped(link.unknown)} frames", ""))
    record = link.recording or "off"
    return [*some, ("record", record, "bold $text-error" if link.recording else "")]


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


HORIZON_WIDTH = 25
WINGS = "━━━┫◆┣━━━"
_GROUND, _SKY = "#8a5a2b", "#2d6a9f"


def horizon(roll: float, pitch: float, height: int) -> list[str]:
    """An artificial horizon: the ground in half blocks, the sky blank, the wings in the middle.

    Args:
        roll: rad, right wing down positive; the ground then rises on the right.
        pitch: rad, nose up positive; the ground then sinks.
        height: lines of the drawing, an odd number.
    """
    rows = 2 * height
    sink = math.degrees(pitch) * rows / 60.0  # 60° from the top to the bottom
    sine, cosine = math.sin(roll), math.cos(roll)

    def ground(column: int, row: int) -> bool:
        # Half a cell is about as high as a cell is wide, so that angles look right.
        x = column - (HORIZON_WIDTH - 1) / 2
        y = row - (rows - 1) / 2 - sink
        return y * cosine + x * sine > 0.0

    blocks = {(False, False): " ", (True, True): "█", (True, False): "▀", (False, True): "▄"}
    lines = [
        [
            blocks[ground(column, 2 * line), ground(column, 2 * line + 1)]
            for column in range(HORIZON_WIDTH)
        ]
        for line in range(height)
    ]
    middle, start = height // 2, (HORIZON_WIDTH - len(WINGS)) // 2
    lines[middle][start : start + len(WINGS)] = WINGS
    return ["".join(line) for line in lines]


def deflection(value: float, limit: float, width: int) -> str:
    """A bar from the middle outwards: left for negative values, right for positive ones."""
    half = width // 2
    cells = min(half, round(abs(value) / limit * half))
    left = "━" * cells if value < 0 else ""
    right = "━" * cells if value > 0 else ""
    return f"{left:>{half}}│{right:<{half}}"


class AttitudePanel(Lines, Shown):
    """Attitude of the vehicle and its rotor signals."""

    BORDER_TITLE = "Attitude and rotors"

    def __init__(self) -> None:
        super().__init__(id="attitude")
        self._top_speed = 1.0

    def lay_out(self, view: View) -> None:
        """Write horizon, angles and rotors."""
        self.put(self._horizon_lines(view) + self._angle_lines(view) + self._rotor_lines(view))

    def _horizon_lines(self, view: View) -> list[Line]:
        if view.snapshot is None or view.snapshot.attitude is None:
            return [[("no attitude yet", fmt.MUTED)]]
        roll, pitch, _ = view.snapshot.attitude
        rows = self.screen.size.height
        drawing = horizon(roll, pitch, 7 if rows >= 48 else 3 if 32 <= rows < 44 else 5)
        colors = f"{_GROUND} on {_SKY}"
        lines = []
        for line in drawing:
            left, wings, right = line.partition(WINGS)
            lines.append(
                [("  ", ""), (left, colors), (wings, f"bold #ffffff on {_SKY}"), (right, colors)]
            )
        return lines

    def _angle_lines(self, view: View) -> list[Line]:
        if view.snapshot is None or view.snapshot.attitude is None:
            return []
        lines = []
        rates = view.snapshot.rates
        limits = (45.0, 45.0, 180.0)
        for index, name in enumerate(AXES):
            angle = math.degrees(view.snapshot.attitude[index])
            # Rounded before the sign is written, so that there is no "-0.0".
            angle = round(angle, 1) + 0.0
            rate = "" if rates is None else f"{round(math.degrees(rates[index])) + 0:+5d} °/s"
            lines.append(
                [
                    (f"{name:<6}", fmt.MUTED),
                    (f"{angle:+6.1f}°", "bold"),
                    (f" {deflection(angle, limits[index], 10)} ", "$text-primary"),
                    (rate, ""),
                ]
            )
        return lines

    def _rotor_lines(self, view: View) -> list[Line]:
        if view.snapshot is None or not view.snapshot.rotor_speeds:
            return [[("no rotor speeds", fmt.MUTED)]]
        values = view.snapshot.rotor_speeds
        if view.snapshot.result.rotor_input.motors:
            shown, unit, top = (100.0, ".1f"), " %     ", 1.0
        else:
            # The scale only grows, in steps, so that bars compare from one moment to the next.
            top = self._top_speed = max(
                self._top_speed, 100.0 * math.ceil(max(values) * 1.1 / 100.0)
            )
            shown, unit = (1.0, ".0f"), " rad/s "
        factor, digits = shown
        return [
            [
                (f"rotor {number:<2}", fmt.MUTED),
                (f"{factor * value:5{digits}}", "bold"),
                (unit, ""),
                (fmt.bar(value / top, 14), "$text-primary on $panel"),
            ]
            for number, value in enumerate(values, start=1)
        ]


_NAME = 16
_BAR = 12
_BOLD_WARNING = "bold $text-warning"


def health_lines(health: Mapping[str, Any] | None, width: int) -> list[Line]:
    """A health file's content as lines.

    `health` is None before the first look.
    """
    if health is None or health["verdict"] == "refused":
        return [[(line, fmt.MUTED)] for line in textwrap.wrap(absent_health(health), width)]
    lines = [_source(health), *_weak(health, width), *_places(health), *_rotors(health, width)]
    for name, text in health_facts(health):
        lines.append([(f"{name:<{_NAME}}", fmt.MUTED), (text, "")])
    for text in health["advice"]:
        lines += _wrapped(f"→ {text}", width, "")
    return lines


def _wrapped(text: str, width: int, style: str) -> list[Line]:
    lines = textwrap.wrap(text, width, subsequent_indent="  ", break_on_hyphens=False)
    return [[(line, style)] for line in lines]


def _source(health: Mapping[str, Any]) -> Line:
    by = RotorInput(health["rotor_input"]).words
    source = f"{health['seconds_of_hover']:.0f} s of hover, rotors by {by}"
    return [("; ".join(filter(None, [source, unequal_rotors(health)])), fmt.MUTED)]


def _weak(health: Mapping[str, Any], width: int) -> Iterator[Line]:
    weakened = health["weakened"]
    if weakened is not None and weakened["rotor"] is not None and weakened["loss"]:
        loss = PLAIN.measure(
            100.0 * weakened["loss"]["value"], 100.0 * half_of(weakened["loss"]), "%"
        )
        text = f"! rotor {weakened['rotor'] + 1} gives {loss} less thrust than before"
        yield from _wrapped(text, width, _BOLD_WARNING)


def _places(health: Mapping[str, Any]) -> Iterator[Line]:
    for name, size, way, alike in cg_facts(health):
        head = (f"{name:<{_NAME}}", fmt.MUTED)
        yield [head, (f"{size} {way}", "bold"), (f"  ({alike})", fmt.MUTED)]


def _rotors(health: Mapping[str, Any], width: int) -> Iterator[Line]:
    """A table; the bar is the rotor's load over the most that any has to do."""
    rotors = health["rotors"]
    shares = [rotor["thrust_share"]["value"] for rotor in rotors]
    wide = width >= 70
    head = f"{'rotor':<6}{'share':>8}{'':>{_BAR + 3}}{'motor gain':>11}{'margin':>9}"
    yield [(head + (f"{'at full':>10}{'vibration':>14}" if wide else ""), fmt.MUTED)]
    for number, (rotor, share) in enumerate(zip(rotors, shares, strict=True), 1):
        carried, gain, margin, full, vibration = rotor_cells(rotor, "m/s²")
        parts: Line = [
            (f"{number:<6}", fmt.MUTED),
            (f"{carried:>8} ", "bold"),
            (fmt.bar(share / max(shares), _BAR), "$text-primary on $panel"),
            (f"{gain:>13}{margin:>9}", ""),
        ]
        if wide:
            parts.append((f"{full:>10}", _BOLD_WARNING if rotor["saturated"] else ""))
            parts.append((f"{vibration:>14}", ""))
        yield parts


class HealthPanel(Lines, Shown):
    """The vehicle's health by the hover of the last minutes, or of a whole log that is played."""

    BORDER_TITLE = "Health in hover"

    def lay_out(self, view: View) -> None:
        """Write the latest look."""
        health = None if view.snapshot is None else view.snapshot.health
        self.put(health_lines(health, self.content_size.width or 76))


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
        self._end = 0

    def lay_out(self, view: View) -> None:
        """Write the log, and follow its end unless the user has scrolled up."""
        found = () if view.snapshot is None else view.snapshot.events
        width = self.scrollable_content_region.width
        if (found, width) == self._shown:
            return
        # The end that was gone to: another size may have moved it since.
        end = min(self._end, self.max_scroll_y)
        follows = self._scrolling or self.scroll_offset.y >= end
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
        self._end = self.max_scroll_y


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


def _change(view: View, row: ParameterRow) -> Cell:
    found = None if view.comparison is None else view.comparison.differences.get(row.name)
    if found is None or row.estimate.status == "given":
        return " " * 8, ""
    share = None
    if found.value is not None and found.before is not None and found.before.value:
        share = found.value / abs(found.before.value)
    text = f"{words.CHANGE[found.verdict].sign}{percent_column(share, signed=True):>7}"
    return text, fmt.CHANGE_STYLE[found.verdict]


BAR = 7
COLUMNS = (
    TableColumn("   value ± 95 %    ", _value),
    TableColumn("unit       ", _unit),
    TableColumn("  ± % ", lambda _, row: (row.figures.percent.rjust(6), ""), 1),
    TableColumn("status        ", _status),
    TableColumn("target ", _converged, 3),
    TableColumn(" change ", _change, 2, lambda view: view.comparison is not None),
    TableColumn("   truth", _truth, 5, lambda view: bool(view.truth)),
    TableColumn(
        "  error",
        lambda _, row: (percent_column(row.error, signed=True).rjust(7), ""),
        4,
        lambda view: bool(view.truth),
    ),
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
    """All parameters of the result, and below them why a verdict is not better, and notes."""

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
        result = None if view.snapshot is None else view.snapshot.result
        reasons = "" if result is None else fmt.one_line(result.reasons)
        self._why.display = bool(reasons)
        label = "note " if result is not None and result.verdict == "identified" else "why  "
        self._why.put([[(label, "bold"), (reasons, "")]], width - 2)

    def reveal(self, name: str) -> None:
        """Scroll a parameter into view."""
        names = [parameter.name for parameter in self._rows.parameters]
        if name in names:
            line = Region(0, names.index(name), 1, 1)
            self._holder.scroll_to_region(line, animate=False)
