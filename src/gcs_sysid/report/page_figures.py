"""What each figure shows, as plain JSON values that the page's script draws.

Series of numbers are thinned to what a figure can show, and packed for the page.
"""

import base64
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from gcs_sysid.arrays import Array, complete_rows, runs
from gcs_sysid.model.parameters import AXES, REGISTRY
from gcs_sysid.report.data import ReportData
from gcs_sysid.results.history import History, known_history, settled_range
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_file import segment_estimates
from gcs_sysid.results.words import PAGE, event_text
from gcs_sysid.significance import Z95

MOST_ROWS, MOST_INSTANTS = 6000, 1200
"""Points of a series of rows, and of the estimates' history."""
_MOST_SPANS = 400
SECONDS = {"label": "Time since the first record", "unit": "s"}


class ChartLine(NamedTuple):
    """A line of a chart: its name and class, and its values under the name of their array."""

    name: str
    kind: str
    array: str
    y: Array


@dataclass
class ChartData:
    """The charts of a page, and the arrays that they share.

    Attributes:
        arrays: name -> base64 of float32.
        figures: id -> figure.
    """

    arrays: dict[str, str] = field(default_factory=dict)
    figures: dict[str, dict[str, Any]] = field(default_factory=dict)

    def array(self, name: str, values: Array) -> str:
        """Keep an array; its name."""
        self.arrays[name] = packed(values)
        return name

    def add_lines(
        self,
        name: str,
        title: str,
        group: str,
        x: str,
        unit: str,
        lines: Iterable[ChartLine],
        *,
        axis: Mapping[str, Any] = SECONDS,
        log: bool = False,
        marks: Sequence[Any] = (),
    ) -> dict[str, Any]:
        """Add a chart of lines.

        Charts of a group are zoomed together; `x` names the array of all lines' abscissas, `unit`
        is of y.
        """
        drawn = [
            {"x": x, "y": self.array(line.array, line.y), "class": line.kind, "name": line.name}
            for line in lines
        ]
        chart: dict[str, Any] = {
            "group": group,
            "title": title,
            "x": axis,
            "y": {"unit": unit, "range": None, "log": log},
            "lines": drawn,
            "marks": list(marks),
        }
        self.figures[name] = chart
        return chart

    def as_json(self) -> dict[str, Any]:
        """As the page's script takes it."""
        return {"arrays": self.arrays, "figures": self.figures}


def events_of(result: Result) -> list[dict[str, Any]]:
    """Events as marks on a time axis, numbered as in their table."""
    return [
        {"x": event["t"], "label": str(number), "text": event_text(event)}
        for number, event in enumerate(result.events, 1)
    ]


def add_histories(figures: ChartData, data: ReportData) -> list[str]:
    """Every parameter's estimate over the flight, with its band; the names that have one."""
    segments = [segment_estimates(part) for part in data.result.segments]
    shown = []
    for name, estimate in data.result.parameters.items():
        if estimate.value is None or estimate.status == "given":
            continue
        # What held at the end of each segment is seen.
        held = [estimates[name] for estimates in (*segments, data.result.parameters)
                if name in estimates]  # fmt: skip
        ends = [end for each in held for end in each.ci95 or ()]
        truth, unit = data.truth.get(name), estimate.unit
        if add_history(figures, data.history, name, MOST_INSTANTS, truth, ends, unit):
            figures.figures[f"history-{name}"]["marks"] = events_of(data.result)
            shown.append(name)
    return shown


def add_history(
    figures: ChartData,
    history: History,
    name: str,
    most: int,
    truth: float | None = None,
    also: Iterable[float] = (),
    unit: str | None = None,
) -> bool:
    """One parameter's estimate over the flight; whether there is one.

    At most about `most` instants are drawn, the truth as a level; what `also` has must be seen.
    """
    t, value, half = known_history(history, name)
    if len(t) < 2:
        return False
    seen = [*also] if truth is None else [*also, truth]
    low, high = settled_range(t, (value, value), (value - half, value + half), seen)
    # All figures share the instants; where there is no estimate they are empty.
    every = math.ceil(len(history.t) / most)
    part = slice((len(history.t) - 1) % every, None, every)
    value, half = history.value[name][part], Z95 * history.std[name][part]
    x = figures.array("history.t", history.t[part])
    unit = PAGE.unit(unit or REGISTRY[name].unit)
    line = ChartLine(name, "estimate", f"history.{name}", value)
    title = f"{name} over the flight"
    chart = figures.add_lines(f"history-{name}", title, "history", x, unit, [line])
    chart["y"]["range"] = [low, high]
    ends = {"low": value - half, "high": value + half}
    chart["bands"] = [
        {"x": x} | {key: figures.array(f"history.{name}.{key}", y) for key, y in ends.items()}
    ]
    chart["levels"] = [] if truth is None else [{"y": truth, "text": "truth"}]
    return True


def add_prediction(figures: ChartData, data: ReportData) -> bool:
    """Measured and predicted angular acceleration on what was not fitted; whether there is any."""
    found = data.prediction
    if found is None or not found.held_out.any():
        return False
    first, last = np.flatnonzero(found.held_out)[[0, -1]]
    part = slice(first, last + 1)
    both = np.column_stack([found.measured[part], found.predicted[part]])
    both[~found.held_out[part]] = np.nan
    t, both = thinned(found.t[part], both, MOST_ROWS)
    there = np.isfinite(t)
    t, both = t[there], both[there]
    time = figures.array("held.t", t)
    for axis, name in enumerate(AXES):
        figures.add_lines(
            f"prediction-{name}",
            f"{name.capitalize()}: measured and predicted angular acceleration",
            "prediction",
            time,
            "rad/s²",
            [
                ChartLine(kind, kind, f"held.{kind}.{name}", both[:, axis + offset])
                for kind, offset in (("measured", 0), ("predicted", 3))
            ],
            marks=events_of(data.result),
        )
    return True


def add_spectrum(figures: ChartData, data: ReportData) -> bool:
    """The residual's spectrum beside that of white sensor noise; whether there is one."""
    found = None if data.prediction is None else data.prediction.spectrum
    if found is None:
        return False
    f = figures.array("spectrum.f", found.frequency)
    for axis, name in enumerate(AXES):
        figures.add_lines(
            f"spectrum-{name}",
            f"{name.capitalize()}: power density of the residual",
            "spectrum",
            f,
            "(rad/s²)²/Hz",
            [
                ChartLine(words, kind, f"spectrum.{kind}.{name}", values[:, axis])
                for kind, words, values in (
                    ("residual", "residual", found.density),
                    ("white", "white sensor noise", found.white),
                )
            ],
            axis={"label": "Frequency", "unit": "Hz", "log": True},
            log=True,
        )
    return True


def add_rates(figures: ChartData, data: ReportData) -> bool:
    """How the axes were moved over the whole flight; whether it flew."""
    found = data.prediction
    if found is None:
        return False
    t, rates = thinned(found.t, found.rates, MOST_ROWS)
    there = np.isfinite(t)
    t, rates = t[there], rates[there]
    if not np.isfinite(rates).any():
        return False
    time = figures.array("flight.t", t)
    for axis, name in enumerate(AXES):
        line = ChartLine(f"{name} rate", "measured", f"flight.{name}", rates[:, axis])
        title, marks = f"{name.capitalize()} rate over the flight", events_of(data.result)
        figures.add_lines(f"rate-{name}", title, "flight", time, "rad/s", [line], marks=marks)
    return True


def add_timeline(figures: ChartData, data: ReportData) -> bool:
    """When it flew, what was used and what was kept apart; whether there is anything to show."""
    rows = []
    flights = [[f["start"], f["end"]] for f in data.inspection.get("flights", ())]
    if flights:
        rows.append({"name": "in the air", "class": "air", "spans": flights[:_MOST_SPANS]})
    found = data.prediction
    if found is not None and len(found.t):
        usable = complete_rows(found.measured)
        predicted = complete_rows(found.predicted)
        fitted = predicted & ~found.held_out
        for name, kind, mask in (
            ("usable samples", "usable", usable),
            ("fitted", "fitted", fitted),
            ("predicted", "held", found.held_out),
        ):
            spans = _spans(found.t, mask, found.step)
            if spans:
                rows.append({"name": name, "class": kind, "spans": spans})
    for number, segment in enumerate(data.result.segments, 1):
        span = [segment["start"], segment["end"]]
        rows.append({"name": f"segment {number}", "class": "segment", "spans": [span]})
    if not rows:
        return False
    figures.figures["timeline"] = {
        "group": "flight",
        "title": "The flight on the time axis",
        "x": SECONDS,
        "rows": rows,
        "marks": events_of(data.result),
    }
    return True


def _spans(t: Array, mask: Array, step: float) -> list[list[float]]:
    """From where to where a mask holds; short breaks are bridged, most spans first."""
    spans: list[list[float]] = []
    for run, there in runs(mask & np.isfinite(t)):
        if not there:
            continue
        first, last = float(t[run][0]), float(t[run][-1]) + step
        if spans and first - spans[-1][1] < 2.0 * step:
            spans[-1][1] = last
        else:
            spans.append([round(first, 3), last])
    spans = sorted(spans, key=lambda span: span[0] - span[1])[:_MOST_SPANS]
    return sorted([a, round(b, 3)] for a, b in spans)


def thinned(t: Array, values: Array, most: int) -> tuple[Array, Array]:
    """At most about `most` instants that keep every peak of every column.

    Of each bucket of neighbors a column keeps its least and its greatest value, in the order in
    which they came; a bucket with something missing keeps that as a break.

    Args:
        t: (n,) s.
        values: (n, columns).
        most: instants; an even number.
    """
    n, pairs = len(t), most // 2
    if n <= most:
        return t, values
    size = -(-n // pairs)
    whole = np.full((-(-n // size) * size, values.shape[1]), np.nan)
    whole[:n] = values
    buckets = whole.reshape(-1, size, values.shape[1])
    there = np.isfinite(buckets)
    low = np.where(there, buckets, np.inf)
    high = np.where(there, buckets, -np.inf)
    rises = low.argmin(axis=1) <= high.argmax(axis=1)
    least, greatest = low.min(axis=1), high.max(axis=1)
    out = np.empty((len(buckets), 2, values.shape[1]))
    out[:, 0] = np.where(rises, least, greatest)
    out[:, 1] = np.where(rises, greatest, least)
    inner = there.all(axis=1)
    inner[-1] = there[-1].any(axis=0)  # filled up above
    out[:, 1][~inner] = np.nan
    out[:, 0][~np.isfinite(out[:, 0])] = np.nan
    first = np.arange(0, n, size)
    middle = np.minimum(first + size // 2, n - 1)
    return np.stack([t[first], t[middle]], axis=1).reshape(-1), out.reshape(-1, values.shape[1])


def packed(values: Array) -> str:
    """(n,) numbers as base64 of little-endian float32; NaN is a break."""
    return base64.b64encode(np.asarray(values, "<f4").tobytes()).decode("ascii")
