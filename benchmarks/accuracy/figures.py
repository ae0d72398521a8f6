"""Figures of docs/accuracy.md, as SVG that comes out the same from the same numbers."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from benchmarks.accuracy.statistics import Data, bound, least, summary
from benchmarks.accuracy.tables_errors import at_noise
from testbed.article import NAMES, TABLE_3

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.ticker import LogLocator, NullLocator

STYLE = {
    "svg.hashsalt": "gcs-sysid",
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "savefig.facecolor": "white",
}
_OURS, _BETTER, _THEIRS, _BOUND = "#1f77b4", "#2ca02c", "#d62728", "#666666"

UNTIL = 20.0
"""s from the start of the excitation that are drawn; little happens later on."""


def noise(data: Data) -> Any:
    """Errors against noise: exact and telemetered rotor speeds."""
    figure, grid = plt.subplots(2, 2, figsize=(7.2, 5.2), sharex=True, layout="constrained")
    sigmas = list(TABLE_3)
    for axes, speeds in zip(grid, ("exact", "telemetered"), strict=True):
        axes[0].set_ylabel(f"error, %; {speeds} speeds")
        floors = [least(bound(data, "paper", s, speeds)) for s in sigmas]
        histories = [("article", _THEIRS, "s-", list(TABLE_3.values()))]
        for name, color in (("online", _OURS), ("offline", _BETTER)):
            found = [summary(at_noise(data, s, f"{name} {speeds}")) for s in sigmas]
            histories.append((name, color, "o-", found))
        histories.append(("Cramér-Rao bound", _BOUND, "--", floors))
        for i, (axis, what) in enumerate(
            zip(axes, ("mean of the ten, median", "largest, 95th percentile"), strict=True)
        ):
            for label, color, style, points in histories:
                axis.plot(sigmas, [p[i] for p in points], style, color=color, label=label)
            axis.set(yscale="log", xticks=sigmas)
            if speeds == "exact":
                axis.set_title(what)
            axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.yaxis.set_minor_locator(NullLocator())
            axis.yaxis.set_major_formatter("{x:g}")
    figure.supxlabel("noise, rad/s")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4)
    return figure


def convergence(data: Data) -> Any:
    """Errors of the first seconds, median and the band that holds 95 % of the runs."""
    outcomes = data["course"]["outcomes"]
    t = np.array(outcomes[0]["t"])
    errors = np.array([o["error"] for o in outcomes])
    figure, axes = plt.subplots(
        2, 5, figsize=(8.4, 3.8), sharex=True, sharey=True, layout="constrained"
    )
    for i, (name, axis) in enumerate(zip(NAMES, axes.flat, strict=True)):
        known = (t >= 0.0) & (t <= UNTIL) & np.isfinite(errors[:, :, i]).all(axis=0)
        low, middle, high = np.percentile(errors[:, known, i], [2.5, 50.0, 97.5], axis=0)
        axis.fill_between(t[known], low, high, color=_OURS, alpha=0.25, linewidth=0)
        axis.plot(t[known], middle, color=_OURS, linewidth=1.0)
        axis.axhline(5.0, color=_BOUND, linewidth=0.7, linestyle="--")
        axis.axhline(-5.0, color=_BOUND, linewidth=0.7, linestyle="--")
        axis.set(title=name, ylim=(-10, 10), xlim=(0, UNTIL))
    figure.supxlabel("s from the start of the excitation")
    figure.supylabel("error, %")
    return figure


FIGURES: dict[str, tuple[tuple[str, ...], str, Callable[[Data], Any]]] = {
    "noise": (("bounds", "baseline", "sweep", "noisiest"), "Errors against noise", noise),
    "convergence": (
        ("course",),
        "Errors of the first 20 s, 95 % of runs",
        convergence,
    ),
}
"""File to the cases that it needs, what it shows, and who draws it."""


def draw(data: Data, folder: Path) -> set[str]:
    """Draw what can be; the names of those drawn."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn = set()
    for name, (needs, _, figure_of) in FIGURES.items():
        if any(need not in data for need in needs):
            continue
        with plt.rc_context(STYLE):
            figure = figure_of(data)
            figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
            plt.close(figure)
        drawn.add(name)
    return drawn
