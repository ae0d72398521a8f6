"""Rotors against an earlier flight: which one is weak, or has the CG moved?

What a rotor must do in hover, lambda_i = Omega_i^2 over thrust per mass (or its commanded thrust
over it), changes by a share r_i against a flight before. Three things can change it:

- a rotor gives less thrust, with its torque or without: with four rotors it alone answers, with
  more the others take their part;
- the CG moved: the rotors on one side take from those on the other;
- everything at once: air, battery, payload.

All but the last ask for a change of thrust and moments, which the mixer answers within the span of
the rotors' effects (1, x, y, spin), by least squares.

A weak rotor of four differs from a moved CG by the sum and the yaw balance alone. Each hypothesis
is fitted by generalized least squares and costs its chi-square; a rotor is named where it beats all
others by a margin, and else the answer is that they cannot be separated.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array, complete_rows, long_run
from gcs_sysid.health.balance import lift_of, robust_values
from gcs_sysid.health.hover import Windows
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.model.airframe import USUAL, Airframe
from gcs_sysid.model.estimate import Quantity
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.model.rotor_input import RotorInput

_ALIKE = USUAL.rotor_thrust.of(1.0)
"""Of a rotor's thrust for its load: what it may lose or gain, before anything is known."""


@dataclass(frozen=True)
class Load:
    """What the rotors did for a unit of thrust over mass.

    Attributes:
        kind: of rotor stream.
        value: (rotors,) Omega_i^2 or thrust share of T_max, per m/s^2.
        covariance: (rotors, rotors) of the logarithms of `value`.
        seconds: of hover.
        thrust_curve: by which commands were read; None for speeds.
        force: (2,) m/s^2, mean specific force in the rotors' plane: the wind's drag, and how far
            the accelerometer is off level. None in older files.
        gusts: m/s^2, by how much that force varied (rms of both axes); 0 in older files.
    """

    kind: RotorInput
    value: Array
    covariance: Array
    seconds: float
    thrust_curve: float | None = None
    force: tuple[float, float] | None = None
    gusts: float = 0.0

    def as_json(self) -> dict[str, Any]:
        """As health files keep it for a later flight."""
        entries = vars(self).items()
        return {n: v.tolist() if isinstance(v, np.ndarray) else v for n, v in entries}

    @classmethod
    def of_json(cls, table: Mapping[str, Any]) -> "Load":
        """What `as_json` wrote.

        Raises:
            KeyError, TypeError, ValueError: it is no such table.
        """
        value = np.asarray(table["value"], dtype=float)
        covariance = np.asarray(table["covariance"], dtype=float)
        if value.ndim != 1 or covariance.shape != 2 * value.shape or not (value > 0.0).all():
            raise ValueError("loads of rotors must be positive, with a covariance")
        curve, force = table["thrust_curve"], table.get("force")
        return cls(
            RotorInput(table["kind"]),
            value,
            covariance,
            float(table["seconds"]),
            None if curve is None else float(curve),
            None if force is None else (float(force[0]), float(force[1])),
            float(table.get("gusts", 0.0)),
        )


def load_of(windows: Windows, thrust: Array, c: float | None) -> Load | None:
    """The rotors' load in hover.

    Args:
        windows: of hover.
        thrust: (n, rotors) as of `balance.thrust_of`.
        c: the thrust curve of commands; None for speeds.

    Returns:
        None where there is too little hover, or where a rotor carries nothing: loads are compared
        by their ratio.
    """
    if len(thrust) < TUNING.fewest_windows or not (thrust.mean(axis=0) > 0.0).all():
        return None
    lift = lift_of(windows)
    turning = windows.turning
    # A moment that turns the vehicle is no load: what its means are not zero by is taken out.
    columns = np.column_stack([lift / lift.mean(), turning])
    ridge = np.array([np.inf, *(3.0 * TUNING.turning_share,) * 3])
    mean = thrust.mean(axis=0)
    relative = thrust / mean
    fitted = robust_values(columns, relative, ridge)
    values = fitted[0] * mean / lift.mean()
    if not (values > 0.0).all():
        return None
    residual, n = np.clip(relative - columns @ fitted, -0.3, 0.3), len(lift)
    lags = min(max(2, round(1.5 * n ** (1.0 / 3.0))), n - 1)
    covariance = long_run(residual, lags) / n**2
    sideways = windows.force[:, :2][complete_rows(windows.force[:, :2])]
    force, gusts = None, 0.0
    if len(sideways):
        x, y = sideways.mean(axis=0).tolist()
        force, gusts = (x, y), math.sqrt(float(sideways.var(axis=0).mean()))
    kind = RotorInput.SPEED if c is None else RotorInput.COMMAND
    return Load(kind, values, covariance, windows.seconds, c, force, gusts)


@dataclass(frozen=True)
class Condition:
    """What became of the rotors since the baseline.

    Attributes:
        verdict: "unchanged", "rotor", "cg", "all" (all rotors alike: air, battery, payload), or
            "unclear": something changed, but these data cannot separate the causes.
        rotor: which, from 0, where one is named.
        loss: share of thrust that it lost, where one is named.
        margin: chi-square by which the best explanation beats the next one of another kind; where
            it is "unclear", by which the likeliest rotor does, if at all.
        moved: (2,) m that the CG would have moved by, were it that.
        changes: (rotors,) relative change of load.
        efficiency: of each rotor against the baseline, shrunk to the mean.
        suspect: which rotor it would be, from 0, where the verdict is "unclear" and the data
            separate it from the other rotors.
    """

    verdict: str
    rotor: int | None
    loss: Quantity | None
    margin: float
    moved: tuple[float, float]
    changes: Array
    efficiency: tuple[Quantity, ...]
    suspect: int | None = None

    def as_json(self) -> dict[str, Any]:
        """As health files write it; rotors count from 0."""
        return {
            "verdict": self.verdict,
            "rotor": self.rotor,
            "suspect": self.suspect,
            "loss": None if self.loss is None else self.loss.as_json(),
            "margin": self.margin,
            "cg_moved": list(self.moved),
            "load_change": self.changes.tolist(),
        }


def compare_loads(
    before: Load,
    now: Load,
    airframe: Airframe,
    cg: Sequence[float],
    *,
    unchanged: bool,
) -> Condition:
    """Judge what changed between two stretches of hover.

    Args:
        before: the baseline.
        now: what is judged.
        airframe: places of the rotors.
        cg: (2,) m, of the baseline.
        unchanged: whether nothing was moved or loaded in between.
    """
    x, y, spin = airframe.geometry
    n = len(x)
    r: Array = now.value / before.value - 1.0
    w = before.value / before.value.sum()
    lever = np.array([x - cg[0], y - cg[1]])
    effect = np.vstack([np.ones(n), lever, spin])
    # Whatever must be balanced, the mixer asks for it within the span of the rotors' effects.
    answer = effect.T @ np.linalg.inv(effect @ effect.T)  # (n, 4)

    def asked(moments: Array) -> Array:
        """(n, ...) relative change of loads that makes these thrusts and moments."""
        change: Array = answer @ moments / w[:, None] if moments.ndim > 1 else answer @ moments / w
        return change

    unit = np.eye(4)
    ones, yaw = np.ones(n), asked(unit[3])
    moves = asked(unit[:, 1:3])  # (n, 2) of a meter
    own = TUNING.rotor_repeats**2 * np.eye(n)
    common = TUNING.common_command if now.kind.motors else TUNING.common_speed
    of_before, of_now = _pooled(before, now)
    noise = of_before + of_now + own
    gusts = math.sqrt(max(max(before.gusts, now.gusts) ** 2 - TUNING.calm**2, 0.0))
    by_gusts = TUNING.moved_by_gusts * gusts
    common, yawed = math.hypot(common, by_gusts), math.hypot(TUNING.yaw_repeats, by_gusts)
    noise = noise + common**2 * np.outer(ones, ones) + yawed**2 * np.outer(yaw, yaw)
    still = (TUNING.cg_stays if unchanged else TUNING.cg_repeats) * airframe.arm
    places = np.full(2, math.hypot(still, by_gusts * airframe.arm))
    if before.force is not None and now.force is not None:
        # Drag above the CG moves the center of thrust with the force that the wind makes. A bias
        # that is another one after a start looks like it: the rotors are then judged less sharply.
        wind = np.abs(np.subtract(now.force, before.force))
        places = np.hypot(places, TUNING.drag_lever * airframe.arm / GRAVITY * wind)
    noise = noise + moves @ np.diag(places**2) @ moves.T
    inverse = np.linalg.inv(noise)

    def fitted(patterns: Array) -> tuple[float, Array, Array]:
        """Chi-square left, coefficients and their covariance."""
        covariance = np.linalg.inv(patterns.T @ inverse @ patterns)
        value = covariance @ patterns.T @ inverse @ r
        rest = r - patterns @ value
        return float(rest @ inverse @ rest), value, covariance

    left_unchanged = float(r @ inverse @ r)
    left_cg, moved, _ = fitted(moves)
    # More numbers explain more; where nothing was moved the CG stays.
    each, fixed = TUNING.parameter_penalty, TUNING.cg_fixed if unchanged else 0.0
    left_cg += 2.0 * each + fixed
    left_all = fitted(ones[:, None])[0] + each
    left_both = fitted(np.column_stack([ones, moves]))[0] + 3.0 * each + fixed
    left_yaw = fitted(yaw[:, None])[0] + each
    best: list[tuple[float, int, float, float]] = []
    for i in range(n):
        whole = effect[:, i] * w[i]
        answers = []
        # With its torque less by as much, or the thrust alone.
        for moments in (whole, whole * (1.0, 1.0, 1.0, 0.0)):
            pattern = asked(moments)
            left, value, covariance = fitted(pattern[:, None])
            lacks, std = float(value[0]), math.sqrt(float(covariance[0, 0]))
            # What it lacks is a share of its load as it is now.
            more = 1.0 + lacks * float(pattern[i])
            answers.append((left + each, i, lacks / more, std / more**2))
        likeliest = min(answers)
        if likeliest[2] > 0.0:
            best.append(likeliest)
    best.sort()
    margin = 0.0
    others = min(left_unchanged, left_cg, left_all, left_both, left_yaw)
    changes, efficiency = r, _shrunk(np.log1p(r), noise, n)
    shift = float(moved[0]), float(moved[1])
    large = bool(best) and best[0][2] > TUNING.least_loss
    if best:
        left, rotor, lost, std = best[0]
        second = _rival(best)
        margin = min(others - left, second - left)
        if large and others - left > TUNING.named_margin and second - left > TUNING.rival_margin:
            # What is answered how rests on rotors that are alike.
            loss = Quantity(lost, math.hypot(std, _ALIKE * lost), "1")
            return Condition("rotor", rotor, loss, margin, shift, changes, efficiency)
    # Where no rotor is weaker, the best weak rotor has lost nothing.
    left_best = min((entry[0] for entry in best), default=left_unchanged)
    least = min(others, left_best)
    suspect = None
    if large and _rival(best) - best[0][0] > TUNING.rival_margin:
        suspect = best[0][1]
    if left_unchanged - least < TUNING.named_margin:
        return Condition("unchanged", None, None, 0.0, shift, changes, efficiency)
    for verdict, left in (("all", left_all), ("cg", min(left_cg, left_both))):
        if left_best - left > TUNING.rival_margin and left < least + each:
            margin = left_best - left
            return Condition(verdict, None, None, margin, shift, changes, efficiency)
    margin = max(margin, 0.0)
    return Condition("unclear", None, None, margin, shift, changes, efficiency, suspect)


def _pooled(before: Load, now: Load) -> tuple[Array, Array]:
    """(rotors, rotors) covariances of both loads, by the noise of both stretches of hover.

    Ten seconds hold too few gusts to estimate their power: alone, a calm stretch gives intervals
    that are too narrow, and a windy one hides a weak rotor. One that is far windier keeps its own.
    """
    own = [load.covariance * load.seconds for load in (before, now)]
    total = before.seconds + now.seconds
    both = (own[0] * before.seconds + own[1] * now.seconds) / total
    most = TUNING.windier * float(np.trace(both))
    power = [each if float(np.trace(each)) > most else both for each in own]
    return power[0] / before.seconds, power[1] / now.seconds


def _rival(best: Sequence[tuple[float, int, float, float]]) -> float:
    """Chi-square of the second best rotor; infinite where there is none."""
    return min((left for left, i, *_ in best if i != best[0][1]), default=math.inf)


@dataclass(frozen=True)
class Weakened:
    """A rotor that became weak in a flight.

    Attributes:
        t: s, end of the stretch of hover that named it.
        condition: against the begin of the flight.
    """

    t: float
    condition: Condition

    def as_json(self) -> dict[str, Any]:
        """As health files write it."""
        return {"t": self.t, **self.condition.as_json()}


def watch_rotors(
    hover: Windows, thrust: Array, c: float | None, airframe: Airframe, cg: Sequence[float]
) -> tuple[Weakened | None, int]:
    """Whether a rotor became weak in a flight: stretches of hover against its begin.

    Within a flight nothing is moved or loaded, so that a CG that shifts is the less likely.

    Args:
        hover: windows.
        thrust: (n, rotors) of them.
        c: the thrust curve of commands; None for speeds.
        airframe: places of the rotors.
        cg: (2,) m.

    Returns:
        The first rotor named in two stretches that follow each other, or beyond doubt in one; and
        how many were judged.
    """
    first, count = (round(s / hover.half) for s in (TUNING.learned_from, TUNING.judged_by))
    if len(hover.t) < first + count:
        return None, 0
    base = load_of(hover.part(slice(0, first)), thrust[:first], c)
    if base is None:
        return None, 0
    judged, before = 0, None
    per_lift = np.log(np.maximum(thrust, 1e-12) / lift_of(hover)[:, None])
    usual = per_lift[:first].mean(axis=0)
    for start in range(first, len(hover.t) - count + 1, count // 2):
        rows = slice(start, start + count)
        if float(np.ptp(per_lift[rows].mean(axis=0) - usual)) < TUNING.least_change:
            judged, before = judged + 1, None
            continue
        now = load_of(hover.part(rows), thrust[rows], c)
        if now is None:
            continue
        judged += 1
        found = compare_loads(base, now, airframe, cg, unchanged=True)
        named = found.rotor if found.verdict == "rotor" else None
        # Twice the margin shows as much as two stretches do.
        sure = named == before or found.margin > 2.0 * TUNING.named_margin
        if named is not None and sure:
            return Weakened(float(hover.t[start + count - 1]), found), judged
        before = named
    return None, judged


def _shrunk(r: Array, noise: Array, n: int) -> tuple[Quantity, ...]:
    """Thrust per load against the baseline, each rotor shrunk to no change.

    The mean of normal e_i of standard deviation s given r = -e + noise: -s^2 (s^2 I + noise)^-1 r.
    """
    prior = _ALIKE**2 * np.eye(n)
    gain = prior @ np.linalg.inv(prior + noise)
    value, covariance = -gain @ r, prior - gain @ prior
    return tuple(
        Quantity(float(1.0 + e), math.sqrt(float(v)), "1")
        for e, v in zip(value, np.diag(covariance), strict=True)
    )
