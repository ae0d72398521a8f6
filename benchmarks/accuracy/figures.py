"""Figures of docs/accuracy.md, as SVG that comes out the same from the same numbers."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from benchmarks.accuracy.statistics import Data, bound, kind, least, summary
from benchmarks.accuracy.tables_errors import at_noise
from testbed.article import INERTIA_AFTER_MASS_STEP, NAMES, TABLE_3

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
_PEERS = ("#7f0000", "#d62728", "#ff7f0e", "#8c564b", "#9467bd", "#e377c2", "#17becf")


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


def peers(data: Data) -> Any:
    """RMS error per parameter, ours and others'."""
    case = data["peers"]
    figure, axis = plt.subplots(figsize=(7.2, 4.6), layout="constrained")
    labels = [name for name in case["outcomes"][0] if name != "settings"]
    # k_T is the same for all: it comes from the momentum balance.
    drawn = [i for i, name in enumerate(NAMES) if name != "k_T"]
    for i, name in enumerate(labels):
        rms = np.sqrt((kind(case, name)[0] ** 2).mean(axis=0))[drawn]
        own = {"ours, online": (_OURS, "o"), "ours, offline": (_BETTER, "D")}.get(name)
        color, marker = own or (_PEERS[i % len(_PEERS)], "sv^<>Pd"[i % 7])
        at = np.arange(len(drawn)) + 0.07 * (i - len(labels) / 2)
        size = 6.0 if own else 4.5
        axis.plot(at, rms, marker, color=color, label=name, markersize=size)
    axis.set_xticks(range(len(drawn)), [NAMES[i] for i in drawn])
    axis.set(yscale="log", ylabel="RMS error, %", ylim=(1e-3, 2e2))
    axis.yaxis.set_major_formatter("{x:g}")
    figure.legend(loc="outside lower center", ncols=2, fontsize=8)
    return figure


def mass_step(data: Data) -> Any:
    """Mass and moments around the step."""
    outcomes = [o["mass"] for o in data["changes"]["outcomes"]]
    t = np.array(outcomes[0]["t"])
    errors = np.array([o["error"] for o in outcomes], dtype=float)
    figure, axes = plt.subplots(1, 2, figsize=(7.2, 2.8), layout="constrained")
    for axis, names, until, limit in (
        (axes[0], {"mass": 0}, 2.0, 20.0),
        (axes[1], {"Ixx": 1, "Iyy": 2, "Izz": 3}, 20.0, 5.0),
    ):
        for (name, i), color in zip(names.items(), (_OURS, _BETTER, _THEIRS), strict=False):
            known = (t <= until) & np.isfinite(errors[:, :, i]).all(axis=0)
            low, middle, high = np.percentile(errors[:, known, i], [2.5, 50.0, 97.5], axis=0)
            axis.fill_between(t[known], low, high, color=color, alpha=0.2, linewidth=0)
            axis.plot(t[known], middle, ".-" if i == 0 else "-", color=color, label=name)
        axis.set(xlabel="s after the step", ylim=(-limit, limit), xlim=(0, until))
        axis.legend(fontsize=8, loc="lower right", ncols=3)
    for bar in (-INERTIA_AFTER_MASS_STEP, INERTIA_AFTER_MASS_STEP):
        axes[1].axhline(bar, color=_BOUND, linewidth=0.7, linestyle="--")
    axes[0].set_ylabel("error, %")
    return figure


FIGURES: dict[str, tuple[tuple[str, ...], str, Callable[[Data], Any]]] = {
    "noise": (("bounds", "baseline", "sweep", "noisiest"), "Errors against noise", noise),
    "convergence": (
        ("course",),
        "Errors of the first 20 s, 95 % of runs",
        convergence,
    ),
    "mass-step": (("changes",), "Mass and moments of inertia after the step", mass_step),
    "peers": (("peers",), "Rms error of each parameter", peers),
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
