"""A result as notebooks show it: one screen of text, a table in HTML, data frames and plots.

pandas and matplotlib are loaded when they are asked for, and are not needed otherwise.
"""

from collections.abc import Callable, Mapping
from html import escape
from typing import TYPE_CHECKING, Literal

import numpy as np

from gcs_sysid.errors import InputError, needed
from gcs_sysid.model.parameters import AXES
from gcs_sysid.results.result_data import ResultData
from gcs_sysid.results.result_view import parameter_rows, rows
from gcs_sysid.results.words import VERDICT, pretty_unit
from gcs_sysid.significance import Z95

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PlotKind = Literal["convergence", "correlation", "prediction"]
_COLORS = ("#1f6fb4", "#c2571a", "#2b8a3e")


def text(result: ResultData, most: int = 4) -> str:
    """The result in at most some thirty lines of eighty columns, `most` of them reasons."""
    lines = [f"{VERDICT[result.verdict].meaning}: {result.source or 'no source'}"]
    if result.scale is not None:
        scale = result.scale
        lines.append(
            f"scale: {scale.anchor} = {scale.value:.6g} {scale.unit}; rotors by "
            f"{result.rotor_input}"
        )
    lines += [f"- {reason}"[:79] for reason in result.reasons[:most]]
    if len(result.reasons) > most:
        lines.append(f"- and {len(result.reasons) - most} more in .reasons")
    lines.append(f"{'parameter':<19}{'value':>12}{'± 95 %':>13}  {'unit':<9}status")
    lines += [
        f"{row.name:<19}{row.figures.value:>12}{row.figures.half_text:>13}  {row.unit:<9}"
        f"{row.status}"
        for row in parameter_rows(result)
    ]
    return "\n".join(lines)


def html(result: ResultData) -> str:
    """The same as a table; nothing is loaded, and all text is escaped."""
    body = "".join(
        f"<tr><td>{escape(row.name)}</td><td>{escape(row.figures.value)}</td>"
        f"<td>{escape(row.figures.half_text)}</td><td>{escape(pretty_unit(row.unit))}</td>"
        f"<td>{row.sign} {row.status}</td>"
        f"<td>{escape(row.parameter.meaning)}</td></tr>"
        for row in parameter_rows(result)
    )
    reasons = "".join(f"<li>{escape(reason)}</li>" for reason in result.reasons)
    verdict = VERDICT[result.verdict]
    return (
        f"<div><p><b>{verdict.sign} {verdict.meaning}</b>: {escape(result.source)}</p>"
        + (f"<ul>{reasons}</ul>" if reasons else "")
        + "<table><thead><tr><th>parameter</th><th>value</th><th>± 95 %</th><th>unit</th>"
        f"<th>status</th><th></th></tr></thead><tbody>{body}</tbody></table></div>"
    )


def dataframe(result: ResultData) -> "pandas.DataFrame":
    """A row per parameter and timing value.

    Raises:
        InputError: pandas is not installed.
    """
    pandas = needed("pandas", "to_dataframe()")
    table = []
    for parameter, estimate in rows(result):
        low, high = estimate.ci95 or (np.nan, np.nan)
        table.append(
            {
                "parameter": parameter.name,
                "value": np.nan if estimate.value is None else estimate.value,
                "std": np.nan if estimate.std is None else estimate.std,
                "std_given": estimate.std_given,
                "low95": low,
                "high95": high,
                "unit": parameter.unit,
                "status": estimate.status,
            }
        )
    return pandas.DataFrame(table).set_index("parameter")


def plot(result: ResultData, kind: PlotKind | None = None) -> "Figure":
    """Draw convergence, correlation or prediction; by default all that there is to draw.

    Raises:
        InputError: matplotlib is not installed, or the result does not hold what is to be drawn.
    """
    figures = needed("matplotlib.figure", "plot()")
    drawings = _drawings(result)
    if kind is not None and kind not in _KINDS:
        raise InputError(f"plot: no kind {kind!r}; one of {', '.join(_KINDS)}")
    if kind is not None and kind not in drawings:
        raise InputError(f"plot: {_ABSENT[kind]}")
    chosen = drawings if kind is None else {kind: drawings[kind]}
    if not chosen:
        raise InputError("plot: nothing was identified, there is nothing to draw")
    figure = figures.Figure(figsize=(9.0, 4.5 * len(chosen)), layout="constrained")
    for row, draw in enumerate(chosen.values(), 1):
        draw(figure.add_subplot(len(chosen), 1, row))
    drawn: Figure = figure
    return drawn


_KINDS: tuple[PlotKind, ...] = ("convergence", "correlation", "prediction")
_ABSENT: dict[PlotKind, str] = {
    "convergence": "the result has no history: analyze(..., history=True) keeps it",
    "correlation": "the result has no covariance: nothing was identified",
    "prediction": "the result has no prediction: analyze(..., history=True) keeps it",
}


def _drawings(result: ResultData) -> "Mapping[PlotKind, Callable[[Axes], None]]":
    out: dict[PlotKind, Callable[[Axes], None]] = {}
    if result.history is not None and len(result.history.t):
        out["convergence"] = lambda axes: _convergence(result, axes)
    if result.covariance.get("names"):
        out["correlation"] = lambda axes: _correlation(result, axes)
    if result.prediction is not None and len(result.prediction.t):
        out["prediction"] = lambda axes: _prediction(result, axes)
    return out


def _convergence(result: ResultData, axes: "Axes") -> None:
    """Estimates over their final values, with their 95 % intervals."""
    history = result.history
    assert history is not None
    for name, estimate in result.parameters.items():
        final = estimate.value
        if estimate.status != "identified" or not final or name not in history.value:
            continue
        value = history.value[name] / final
        half = Z95 * history.std[name] / abs(final)
        (line,) = axes.plot(history.t, value, label=name)
        axes.fill_between(history.t, value - half, value + half, color=line.get_color(), alpha=0.15)
    axes.set(xlabel="time, s", ylabel="estimate / final estimate", ylim=(0.5, 1.5))
    axes.legend(ncols=2, fontsize="small")


def _correlation(result: ResultData, axes: "Axes") -> None:
    names = [str(name) for name in result.covariance["names"]]
    matrix = np.asarray(result.covariance["matrix"], np.float64)
    std = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    image = axes.imshow(matrix / np.outer(std, std), vmin=-1.0, vmax=1.0, cmap="RdBu_r")
    axes.set_xticks(range(len(names)), names, rotation=90)
    axes.set_yticks(range(len(names)), names)
    axes.set_title("correlation of the errors")
    axes.figure.colorbar(image, ax=axes)


def _prediction(result: ResultData, axes: "Axes") -> None:
    prediction = result.prediction
    assert prediction is not None
    for axis, (name, color) in enumerate(zip(AXES, _COLORS, strict=True)):
        axes.plot(prediction.t, prediction.measured[:, axis], color=color, alpha=0.35)
        axes.plot(prediction.t, prediction.predicted[:, axis], color=color, label=name)
    axes.set(xlabel="time, s", ylabel="angular acceleration, rad/s²")
    axes.set_title("measured (pale) and predicted")
    axes.legend(fontsize="small")
