"""A twin's flight: its errors, as JSON, as a table, as a figure in notebooks."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from gcs_sysid.results.result import Result
from gcs_sysid.results.words import significant, wrapped
from gcs_sysid.twin.prediction_errors import QUANTITIES, Accuracy, Growth

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = "gcs-sysid-twin/1"
SHOWN = {
    "rates": (180.0 / math.pi, "deg/s"),
    "attitude": (180.0 / math.pi, "deg"),
    "velocity": (1.0, "m/s"),
}
"""Scale and unit of each quantity for people."""
_RULES = (
    "error and band: rms over the axes at the end of the stretches; band: 95 % half-width from "
    "the covariance of the parameters (alone: params), noise and disturbance",
    "guess: body rates and velocity assumed constant; R2 is at the end, relative to the measured "
    "variance",
    "basic: the same model without drag, damping, rotor inertia and differences between rotors",
)


@dataclass(frozen=True)
class TwinFlight:
    """The identified model flown beside the vehicle.

    Attributes:
        result: flown; for a result of the same flight, the fit to its first part.
        source: the result that was given.
        log: that it was flown along.
        same_flight: whether the given result is from this log.
        judged: (start, end) of the parts of the log that were judged, s.
        accuracy: length of the stretches in s -> quantity -> errors and band.
        growth: of the errors over the longest stretches.
        notes: remarks on the numbers.
    """

    result: Result
    source: str
    log: str
    same_flight: bool
    judged: tuple[tuple[float, float], ...]
    accuracy: dict[float, dict[str, Accuracy]]
    growth: Growth
    notes: tuple[str, ...] = ()

    @property
    def held_out(self) -> str:
        """In words, the part of the log that the model has not seen."""
        spans = " and ".join(f"{start:.0f} to {end:.0f} s" for start, end in self.judged)
        if self.same_flight:
            return (
                f"{spans}; the result is from this same flight, so the model is refitted to the "
                "data before them"
            )
        return f"{spans}: the result is from another flight"

    def as_json(self) -> dict[str, Any]:
        """As `twin --json` writes it."""
        return {
            "schema": SCHEMA,
            "result": self.source,
            "log": self.log,
            "same_flight": self.same_flight,
            "held_out": [list(span) for span in self.judged],
            "verdict": self.result.verdict,
            "rotor_input": self.result.rotor_input,
            "parameters": {name: e.as_json() for name, e in self.result.parameters.items()},
            "horizons": [
                {"seconds": seconds, **{name: a.as_json() for name, a in each.items()}}
                for seconds, each in self.accuracy.items()
            ],
            "growth": {
                "t": self.growth.t.tolist(),
                "rms": {name: values.tolist() for name, values in self.growth.rms.items()},
                "guess": {name: values.tolist() for name, values in self.growth.guess.items()},
            },
            "notes": list(self.notes),
        }

    def plot(self) -> "Figure":
        """Draw the growth of the errors with matplotlib.

        Raises:
            InputError: matplotlib is not installed.
        """
        return plot_growth(self)

    def __repr__(self) -> str:
        """The table of `gcs-sysid twin`."""
        return twin_table(self)


def twin_table(twin: TwinFlight) -> str:
    """The errors as lines of text."""
    lines = [
        f"{twin.source or 'result'} along {twin.log}",
        *wrapped(twin.held_out, "held out: "),
        "",
        f"{'quantity':<13}{'ahead':>6}{'error':>8}{'± 95 %':>8}{'params':>8}{'inside':>7}"
        f"{'R2':>8}{'basic':>8}{'guess':>7}{'count':>6}",
    ]
    for name in QUANTITIES:
        scale, unit = SHOWN[name]
        for seconds, each in twin.accuracy.items():
            if name in each:
                lines.append(_row(f"{name}, {unit}", seconds, each[name], scale))
    lines.append("")
    for note in (*twin.notes, *_RULES):
        lines += wrapped(note, "- ")
    return "\n".join(lines)


def _row(name: str, seconds: float, a: Accuracy, scale: float) -> str:
    def number(value: float) -> str:
        return significant(scale * value, 3) if math.isfinite(value) else "-"

    share = f"{100.0 * a.inside:.0f} %" if math.isfinite(a.inside) else "-"
    # Far below zero it says no more than that the model is worse than the mean.
    squared = "-" if not math.isfinite(a.r_squared) else f"{max(a.r_squared, -99.0):.3f}"
    return (
        f"{name:<13}{seconds:>4g} s{number(a.rms):>8}{number(a.band):>8}"
        f"{number(a.band_parameters):>8}{share:>7}{squared:>8}{number(a.basic):>8}"
        f"{number(a.guess):>7}{a.count:>6}"
    )


_MODEL, _GUESS, _BAND = "#1f6fb4", "#888888", "#c2571a"


def plot_growth(twin: TwinFlight) -> "Figure":
    """The errors over the stretches with matplotlib.

    Raises:
        InputError: it is not installed.
    """
    from gcs_sysid.errors import needed

    figures = needed("matplotlib.figure", "plot()")
    names = list(twin.growth.rms)
    figure = figures.Figure(figsize=(4.2 * len(names), 3.6), layout="constrained")
    for i, name in enumerate(names, 1):
        scale, unit = SHOWN[name]
        axes = figure.add_subplot(1, len(names), i)
        axes.semilogy(twin.growth.t, scale * twin.growth.guess[name], color=_GUESS, label="guess")
        axes.semilogy(twin.growth.t, scale * twin.growth.rms[name], color=_MODEL, label="model")
        bands = [(s, 0.5 * scale * each[name].band) for s, each in twin.accuracy.items()]
        axes.semilogy(*zip(*bands, strict=True), "o", color=_BAND, label="predicted rms")
        axes.set(xlabel="s since the measured state", title=f"{name}, {unit}")
        axes.legend(fontsize="small")
    drawn: Figure = figure
    return drawn
