"""The thrust curve over commands: T/T_max = (1 - c) u + c u^2, from ordinary flight."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, Mask, complete_rows
from gcs_sysid.health.balance import BalanceFit, robust_fit
from gcs_sysid.health.hover import Windows, variations_of_lift
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.model.estimate import Quantity


@dataclass(frozen=True)
class Curve:
    """The thrust curve, and where it is known from.

    Attributes:
        c: of T/T_max = (1 - c) u + c u^2.
        origin: in words.
    """

    c: Quantity
    origin: str


@dataclass(frozen=True)
class Commanded:
    """Thrust in hover by commands, and what it would be by another curve or range of them.

    Attributes:
        curve: of thrust over commands.
        thrust: (n, rotors) by it.
        by_curve: thrust by a lower and by a higher c, and what they are apart in standard
            deviations of it; None where it is given.
        by_range: by an assumed range whose start is a standard deviation lower and higher; None
            where it is known.
    """

    curve: Curve
    thrust: Array
    by_curve: tuple[Array, Array, float] | None = None
    by_range: tuple[Array, Array] | None = None

    @classmethod
    def of(cls, hover: Windows, curve: Curve, ranged: Sequence[Array]) -> "Commanded":
        """Of the windows of a hover; `ranged` is `by_range`, empty where the range is known."""
        c, others = curve.c, None
        if c.std:
            step = min(c.std, 0.1)
            low, high = max(c.value - step, 0.0), min(c.value + step, 1.0)
            others = thrust_of(hover, low), thrust_of(hover, high), (high - low) / c.std
        by_range = (ranged[0], ranged[1]) if ranged else None
        return cls(curve, thrust_of(hover, c.value), others, by_range)

    def doubt(self, numbers: Callable[[Array], Array]) -> tuple[Array, Array]:
        """Standard deviations of numbers that follow from (n, rotors) thrusts.

        Returns:
            By what the flight leaves open of the curve; and by what is given or assumed, the same
            in every flight.
        """
        own = given = np.zeros_like(numbers(self.thrust))
        if self.by_curve is not None:
            low, high, apart = self.by_curve
            moved = np.abs(numbers(high) - numbers(low)) / apart
            share = self.curve.c.std_given / self.curve.c.std
            own, given = math.sqrt(max(1.0 - share**2, 0.0)) * moved, share * moved
        if self.by_range is not None:
            low, high = self.by_range
            given = np.hypot(given, 0.5 * (numbers(high) - numbers(low)))
        return own, given


def thrust_of(windows: Windows, c: float | None) -> Array:
    """(n, rotors) thrust, relative: mean squares of speeds, or of commands by their curve."""
    if c is None:
        return windows.speeds
    return (1.0 - c) * windows.commands + c * windows.squares


def curve_of(
    windows: Windows, given: float | None, own: float | None, autopilot_name: str
) -> Curve:
    """The thrust curve from commands, by speeds where there are any, else by the thrust needed.

    Args:
        windows: all those in flight.
        given: by the airframe file.
        own: the autopilot's own setting, where it is known.
        autopilot_name: of that setting.
    """
    if given is not None:
        return Curve(Quantity(given, 0.0, "1"), "given")
    guess, sigma, origin = 0.5, TUNING.curve_std, "assumed"
    if own is not None and 0.0 < own <= 1.0:
        # Half of the fleet never touched it: it says little more than the usual.
        guess, origin = own, f"{autopilot_name} of the vehicle, assumed to be near"
    by_speeds = bool(np.isfinite(windows.speeds).any())
    found = _by_speeds(windows) if by_speeds else _by_lift(windows)
    if found is None or not -TUNING.sure * found[1] < found[0] < 1.0 + TUNING.sure * found[1]:
        # None, or none of a propeller: something else moves thrust and commands.
        return Curve(Quantity(guess, sigma, "1", std_given=sigma), origin)
    c, std, by = found
    gain = sigma**2 / (sigma**2 + std**2)
    merged = guess + gain * (c - guess)
    clipped = float(np.clip(merged, 0.0, 1.0))
    widened = (1.0 if by_speeds else TUNING.gusts_beside) * math.sqrt(gain) * std
    whole = math.hypot(min(widened, sigma), merged - clipped)
    # What was assumed is the same in every flight.
    assumed = min((1.0 - gain) * sigma, whole)
    return Curve(Quantity(clipped, whole, "1", std_given=assumed), by if gain > 0.5 else origin)


def _ratio(fit: BalanceFit) -> tuple[float, float]:
    """The curve c = b / (a + b) of coefficients a, b of u and u^2, and its standard deviation."""
    a, b = fit.value[:2]
    total = a + b
    slope = np.array([-b, a]) / total**2
    return float(b / total), math.sqrt(float(slope @ fit.covariance[:2, :2] @ slope))


def _by_speeds(windows: Windows) -> tuple[float, float, str] | None:
    """Omega_i^2 of every rotor over its command, each rotor with a gain of its own."""
    rotors = windows.speeds.shape[1]
    rows, noises, targets = [], [], []
    t = windows.t - windows.t.mean()
    span = float(np.abs(t).max()) or 1.0
    for i in range(rotors):
        u, uu, w = windows.commands[:, i], windows.squares[:, i], windows.speeds[:, i]
        noise = np.column_stack([windows.jitter[:, i], np.zeros(len(t))])
        there = np.isfinite(u) & np.isfinite(w) & complete_rows(noise)
        if there.sum() < TUNING.fewest_windows or np.std(u[there]) < TUNING.least_throttle_motion:
            return None
        if not w[there].any():
            return None
        # Each rotor scaled to the thrust of the mean one at its own mean command.
        rows.append(np.column_stack([u, uu, u * t / span])[there])
        noises.append(noise[there])
        targets.append(w[there] / w[there].mean())
    fits = [
        robust_fit(a, y, None, d, between=windows.half)
        for a, d, y in zip(rows, noises, targets, strict=True)
    ]
    values = np.array([_ratio(fit) for fit in fits])
    weight = 1.0 / values[:, 1] ** 2
    mean = float(weight @ values[:, 0] / weight.sum())
    # Rotors differ in more than noise: their scatter counts. What their own deviations have beyond
    # it is common to all of them, as the battery is, and their mean has it too.
    own, apart = 1.0 / weight.sum(), weight @ (values[:, 0] - mean) ** 2 / weight.sum()
    variance = max(own, apart / max(rotors - 1, 1), rotors * own - apart)
    return mean, math.hypot(math.sqrt(variance), TUNING.curve_floor), "speeds over commands"


def _by_lift(windows: Windows) -> tuple[float, float, str] | None:
    """Thrust over mass in climbs and descents over the sum of commands, by two estimators.

    A gust that the accelerometer feels makes the autopilot answer: commands and noise correlate,
    and least squares finds too flat a curve, by about the gusts' share of the power. That is its
    bias. Commands of seconds before are independent of a gust: as instruments they have no such
    bias, but few flights climb enough for that. Both are merged by what they are off by. The
    accelerometer gives the thrust, or the velocity does, whichever the commands explain better:
    some velocities are late, some accelerometers have a bias that their filter moves about.
    """
    found = [
        _by_one_lift(windows, lift)
        for lift in (variations_of_lift(windows.lift, windows.force), windows.lift)
    ]
    answers = [answer for answer in found if answer is not None]
    if not answers:
        return None
    _, c, std = min(answers)
    return c, std, "thrust over commands"


def _by_one_lift(windows: Windows, lift: Array) -> tuple[float, float, float] | None:
    """Residual in m/s^2, c and its standard deviation, by one measure of thrust over mass."""
    total, squares = windows.commands.sum(axis=1), windows.squares.sum(axis=1)
    t = windows.t - windows.t.mean()
    span = float(np.abs(t).max()) or 1.0
    sink = np.where(np.isfinite(windows.sink), windows.sink, 0.0)
    columns = np.column_stack([total, squares, total * t / span, sink])
    noise = np.column_stack([windows.jitter.sum(axis=1), np.zeros((len(t), 2))])
    before = [_earlier(windows, total, lag) for lag in TUNING.instrument_lags]
    steady = np.column_stack([np.ones(len(t)), t / span, sink])
    instruments = np.column_stack(
        [steady, *before, _earlier(windows, squares, TUNING.instrument_lags[0])]
    )
    there = complete_rows(np.column_stack([columns, lift, noise])) & gentle_of(windows)
    if there.sum() < 2 * TUNING.fewest_windows or not lift[there].any():
        return None
    if np.std(total[there] / windows.commands.shape[1]) < TUNING.least_throttle_motion:
        return None
    fit = robust_fit(columns[there], lift[there], jitter=noise[there])
    residual = fit.residual
    answers = [_with_gusts(fit, columns[there], lift[there], windows.commands.shape[1])]
    there &= complete_rows(instruments)
    if there.sum() > 3 * TUNING.fewest_windows:
        instruments = instruments[there]
        explained = instruments @ np.linalg.lstsq(instruments, columns[there], rcond=None)[0]
        fit = robust_fit(columns[there], lift[there], projected=explained)
        other = _ratio(fit)
        if other[1] < TUNING.instruments_std:
            answers.append(other)
    values, weights = np.array([(c, 1.0 / std**2) for c, std in answers]).T
    merged = float(values @ weights / weights.sum())
    # The same flight twice: the better one alone could be as good.
    std = math.hypot(1.0 / math.sqrt(float(weights.max())), TUNING.curve_floor)
    return residual, merged, std


def gentle_of(windows: Windows) -> Mask:
    """(n,) whether it turns so slowly that thrust is that of the mean command; climbs may be."""
    slow = np.abs(windows.rates).max(axis=1) < TUNING.most_rate
    calm = np.abs(windows.turning).max(axis=1) < TUNING.most_turning
    gentle: Mask = np.logical_and.reduce([slow, calm, ~(windows.speed > TUNING.most_speed)])
    return gentle


def _with_gusts(fit: BalanceFit, columns: Array, lift: Array, rotors: int) -> tuple[float, float]:
    """The curve of a fit, its deviation widened by the bias that gusts make.

    White noise of the accelerometer makes none: its correlation through overlapping windows is
    taken off the residuals' autocorrelation.
    """
    c, std = _ratio(fit)
    model = columns @ fit.value
    residual = lift - model
    steps = np.clip(residual, -3.0 * fit.residual, 3.0 * fit.residual)
    neighbors = float(np.corrcoef(steps[1:], steps[:-1])[0, 1])
    white, gust = TUNING.white_neighbors
    colored = float(np.clip((neighbors - white) / (gust - white), 0.0, 1.0))
    flat = TUNING.gust_bias * colored * (fit.residual / max(float(np.std(model)), 1e-9)) ** 2
    # Of thrust a u + b u^2, bent by s = b u^2 / T: c = s / (s + (1 - s) u).
    u = float(columns[:, 0].mean()) / rotors
    s = float(np.clip(c * u / (1.0 - c + c * u), 0.0, 1.0)) if 0.0 < c < 1.0 else float(c >= 1.0)
    return c, math.hypot(std, flat * u / (s + (1.0 - s) * u) ** 2)


def _earlier(windows: Windows, values: Array, lag: int) -> Array:
    """(n,) what a value was so many windows before; NaN where that was not in flight."""
    place = np.rint(windows.t / windows.half).astype(int)
    i = np.searchsorted(place, place - lag)
    out: Array = np.where(place[i] == place - lag, values[i], np.nan)
    return out
