"""What happened to the vehicle: competing explanations of the seconds around an alarm.

Residuals of a reference fit, in means over a twentieth of a second, are explained on four
channels (thrust, roll, pitch, yaw) by generalized least squares:

    e = b + sum c_j z_j + step s(t >= tau) + n

z_j are what moves residuals of an unchanged vehicle, each with a prior on its coefficient, and n
wanders as residuals did in the flight so far (`change_window`). A gust, a climb, full throttle, a
sagging battery or a slow model error has its likelihood there.

What steps at tau is, on trial, a mass (thrust over all of kappa, moments by a moved CG), one
rotor's share of thrust and torque, or a disturbance of any force and moment. The vehicle changed
when a mass or a rotor explains the step, its interval excludes zero by a margin, it stays the same
from one part of the time since to the next, and thrust still answers to the rotors, which on the
ground it does not, and carries the vehicle, which it does not where one fell. Else it was a
disturbance.

That is shortly after an alarm. Later, the fits before and after give what changed, by how much, and
how certainly (`describe`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from scipy.linalg import solve_triangular

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.changes.change_reference import TOTAL, Reference
from gcs_sysid.estimation.changes.change_window import (
    TUNING,
    AlarmWindow,
    HypothesisTuning,
    ResidualHistory,
    covariance,
    covariates,
    strengths,
)
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.parameters import GRAVITY, INERTIA, grouped
from gcs_sysid.signals.records import Samples
from gcs_sysid.significance import interval95

Kind = Literal["mass_change", "payload", "cg_shift", "inertia_change", "rotor_failure", "change"]
CauseKind = Literal[
    "mass_change", "payload", "cg_shift", "inertia_change", "rotor_failure", "passing", "change"
]

Disturbance = Literal["contact", "thrust", "climb", "airspeed", "force", "moment"]
"""Contact with the ground; thrust far from the usual; climb or descent; forward flight; a force or
a moment, as of a gust."""

_SURE = 3.0
"""Standard deviations of a difference that names the kind."""


@dataclass(frozen=True)
class Cause:
    """What explains the residuals after a detection best.

    Attributes:
        kind: "passing" when the vehicle is what it was.
        rotor: index of the failing rotor, else None.
        loss: share of its thrust that is gone, else 0.
        loss_std: of the loss.
        mass_ratio: mass after over mass before, were it the mass.
        cg_shift: m, forward and right, at the inertia before.
        explained: likelihood over that of any force and moment.
        disturbance: of "passing", what passed.
        mass_std: of the mass ratio.
    """

    kind: CauseKind
    rotor: int | None = None
    loss: float = 0.0
    loss_std: float = 0.0
    mass_ratio: float = 1.0
    cg_shift: tuple[float, float] = (0.0, 0.0)
    explained: float = 0.0
    disturbance: Disturbance | None = None
    mass_std: float = 0.0


def describe(
    before: Mapping[str, tuple[float | None, float | None]],
    after: Mapping[str, tuple[float | None, float | None]],
) -> dict[str, Any]:
    """The event of a change, from the estimates on both sides of it.

    Args:
        before: value and standard deviation by parameter name; None where there is none.
        after: the same of the estimate that began after the change, at the scale of unchanged
            rotors (k_T given).

    Returns:
        {"kind": ..., "parameters": {name: {before, after, difference, ci95}}}, the parameters
        being those that both know.
    """
    parameters: dict[str, dict[str, Any]] = {}
    changed = set()
    for name, (old, old_std) in before.items():
        new, new_std = after.get(name, (None, None))
        if old is None or new is None or old_std is None or new_std is None:
            continue
        difference, std = new - old, float(np.hypot(old_std, new_std))
        if not np.isfinite(std):
            continue
        parameters[name] = {
            "before": old,
            "after": new,
            "difference": difference,
            "ci95": list(interval95(difference, std)),
        }
        if abs(difference) > max(_SURE * std, 0.01 * abs(old)):
            changed.add(name)
    kind: str = kind_of(
        "mass" in changed,
        not changed.isdisjoint(grouped("center of gravity")),
        not changed.isdisjoint(INERTIA),
    )
    return {"kind": kind, "parameters": parameters}


def kind_of(mass: bool, cg: bool, inertia: bool) -> Kind:
    """Of a changed body, by what changed."""
    if mass:
        return "payload" if cg or inertia else "mass_change"
    if cg:
        return "cg_shift"
    return "inertia_change" if inertia else "change"


Verdict = Literal["changed", "disturbance", "undecided"]


@dataclass(frozen=True)
class Classification:
    """Classification of one alarm at one time.

    Attributes:
        verdict: "undecided" until more has been seen.
        onset: s, session time of the step.
        cause: what changed, or the disturbance's name.
        doubtful: whether thrust is off by what a change may be.
        settled: s, from when on samples are surely of the changed vehicle; None: from the onset on.
    """

    verdict: Verdict
    onset: float
    cause: Cause
    doubtful: bool = False
    settled: float | None = None


def judge(
    t: Array,
    samples: Samples,
    dt: float,
    reference: Reference,
    history: ResidualHistory,
    onset: float,
    age_index: int,
    *,
    force: bool = True,
    decide: bool = True,
    tuning: HypothesisTuning = TUNING,
) -> Classification:
    """Explain what an alarm was raised for.

    Args:
        t: (n,) s, session times of samples around the alarm, gaps marked by NaN samples.
        samples: n of them.
        dt: s between samples.
        reference: the fit before the alarm.
        history: of the flight before it.
        onset: s, session time at which the alarm's sum left zero.
        age_index: which of `TUNING.ages` has come.
        force: whether the alarm was one of thrust, for the disturbance's name.
        decide: whether a change may be called; else nothing is known but whether it is doubtful.
        tuning: as of `AlarmWindow`.
    """
    window = AlarmWindow(t, samples, dt, reference, onset, tuning)
    last = age_index == len(TUNING.ages) - 1
    if window.after < 6 or window.at < 10 or not np.isfinite(reference.matrix).any():
        return Classification("disturbance" if last else "undecided", onset, Cause("passing"))
    trial = StepTrial(window, reference, history)
    cause, sure = trial.best(TUNING.sure[age_index], last=last)
    onset = window.time_of(trial.at)
    if sure and decide:
        return Classification("changed", onset, cause)
    if decide and trial.may_be_mass() and (calm := window.calm()) is not None:
        # A payload dropped in a punch-out shows in the calm flight before and since.
        later = StepTrial(calm, reference, history)
        cause_since, holds = later.best(TUNING.sure[age_index], last=last)
        if holds and cause_since.kind != "rotor_failure":
            settled = calm.time_of(later.at)
            return Classification("changed", onset, cause_since, settled=settled)
    over = trial.is_over() and not sure and not (decide and trial.may_be_rotor(cause))
    probability = trial.disturbance(cause, force=force)
    return Classification(
        "disturbance" if over or last else "undecided", onset, probability, not over
    )


class StepTrial:
    """The hypotheses on one window.

    Args:
        window: of the means.
        reference: of its residuals.
        history: of the flight before it.
        places: indices of means with which a step may begin; none: those around the alarm.

    Attributes:
        at: index of the mean with which the likeliest step begins.
    """

    def __init__(
        self,
        window: AlarmWindow,
        reference: Reference,
        history: ResidualHistory,
        places: Sequence[int] = (),
    ) -> None:
        self._window, self._reference = window, reference
        self._watched = reference.watched
        self._thrust = reference.kappa * window.x[:, TOTAL]
        self._Q = np.nan_to_num(reference.matrix[1:, : rb.N_SIGNALS])
        self._level = np.nan_to_num(history.level)
        floors, moved = window.floors(reference), covariates(window, reference)
        self._roots = {}
        for c in np.flatnonzero(self._watched).tolist():
            noise = covariance(window, c, strengths(window, history, c), float(floors[c]))
            noise += moved[c] @ moved[c].T
            # What is next to nothing keeps the matrix definite.
            noise += 1e-9 * np.trace(noise) / len(noise) * np.eye(len(noise))
            self._roots[c] = np.linalg.cholesky(noise)
        self._scale = np.ones(4)
        self.at = self._likeliest(places)
        self._scale = self._inflation()

    # ---- what is said of the step ------------------------------------------------------------

    def best(self, sure: float, *, last: bool = False) -> tuple[Cause, bool]:
        """The best explanation by a change, and whether it holds.

        Args:
            sure: standard deviations by which its interval must exclude zero.
            last: whether it is decided now or never.
        """
        window, since, mass = self._window, self._since(self.at), self._mass_gone
        free, moved = self._fit(self._free(since)), self._fit(self._balance(since))
        losses = [self._fit(self._rotor(i, since)) for i in range(window.squares.shape[1])]
        i = int(np.argmax([fit.likelihood for fit in losses]))
        rotor = losses[i]
        penalty = 0.5 * float(np.log(max(window.after, 2)))
        body = mass.likelihood + max(moved.likelihood - 2.0 * penalty, 0.0)
        whole = max(free.likelihood, 1e-9)
        # With an axis less, one rotor or another points where any moment does.
        if self._watched[:3].all() and rotor.likelihood > body and rotor.value[0] > 0.0:
            loss, std = float(rotor.value[0]), float(rotor.std[0])
            share = rotor.likelihood / whole
            cause = Cause("rotor_failure", i, loss, std, explained=share)
            speed, pull = self._away()
            lift = self._fit({0: self._rotor(i, since)[0]})
            less, off = float(lift.value[0]), float(lift.std[0])
            # Of vehicles whose thrust is not well known, that it agrees must do, in the end.
            agrees = (
                last and less > TUNING.agreeing * off and abs(less - loss) < TUNING.agreeing * off
            )
            holds = (
                loss >= max(TUNING.least_loss, sure * std)
                and (less > TUNING.named * off or agrees)
                and share > TUNING.explained
                and speed < TUNING.far[0]
                and pull < TUNING.far[1]
                and self._stays(lambda since: self._rotor(i, since), loss)
                and not self._is_misread(rotor.likelihood - penalty)
            )
            return cause, holds
        share, std = float(mass.value[0]), float(mass.std[0])
        least = np.maximum(TUNING.named * moved.std, TUNING.least_cg)
        moves = bool(moved.std.any()) and bool((np.abs(moved.value) > least).any())
        # Thrust alone cannot distinguish a heavier vehicle from a weaker rotor.
        kind = kind_of(True, moves, False) if self._watched[1:3].all() else "change"
        shift = (float(moved.value[0]), float(moved.value[1])) if moved.std.any() else (0.0, 0.0)
        ratio = 1.0 / max(1.0 - share, 0.1)
        cause = Cause(
            kind,
            mass_ratio=ratio,
            cg_shift=shift,
            explained=(mass.likelihood + moved.likelihood) / whole,
            mass_std=ratio * ratio * std,
        )
        holds = (
            abs(share) >= max(TUNING.least_mass, sure * std, self._strange())
            and self._stays(lambda since: {0: self._mass(since)}, share)
            and self._is_new(share)
            and self._is_aloft(share)
        )
        return cause, holds

    def may_be_rotor(self, cause: Cause) -> bool:
        """Whether a weaker rotor explains it: a tenth of its thrust hardly shows in all."""
        return (
            cause.kind == "rotor_failure"
            and cause.loss >= max(TUNING.least_loss, TUNING.named * cause.loss_std)
            and cause.explained > TUNING.explained
        )

    @cached_property
    def _mass_gone(self) -> "_StepFit":
        """Of the share of thrust over mass that is gone since the step; zero where none is seen."""
        return self._fit({0: self._mass(self._since(self.at))}) if self._watched[0] else _NOTHING

    def may_be_mass(self) -> bool:
        """Whether a mass explains it, or would if the vehicle had not been far from hover."""
        return not self.is_over() and self._is_aloft(float(self._mass_gone.value[0]))

    def is_over(self) -> bool:
        """Whether nothing is left of the step."""
        fit = self._mass_gone
        return bool(abs(fit.value[0]) <= TUNING.named * fit.std[0])

    def disturbance(self, cause: Cause, *, force: bool) -> Cause:
        """Name of a disturbance that is not a change."""
        name = self._name() if force and self._watched[0] else "moment"
        return Cause("passing", explained=cause.explained, disturbance=name)

    def _name(self) -> Disturbance:
        window, thrust = self._window, self._thrust
        later, before = slice(self.at, None), slice(0, self.at)
        if self._stands() or float(np.median(window.y[later, 0])) > TUNING.falls * GRAVITY:
            return "contact"
        usual = float(np.median(thrust[before]))
        if thrust[later].max() > TUNING.punch * usual or thrust[later].min() < usual / TUNING.punch:
            return "thrust"
        if np.abs(window.air[later, 2]).max() > TUNING.calm[0]:
            return "climb"
        if np.linalg.norm(window.air[later, :2], axis=1).max() > TUNING.speed:
            return "airspeed"
        return "force"

    # ---- conditions ---------------------------------------------------------------------------

    def _stays(self, columns: "Columns", size: float) -> bool:
        """Whether the parts of the time since agree."""
        n, at = len(self._window.e), self.at
        middle = at + 1 + (n - at) // 2
        parts = (self._since(at, middle), self._since(middle))
        first, second = (columns(part) for part in parts)
        both = self._fit({c: np.column_stack([first[c], second[c]]) for c in first})
        if (both.value * size <= 0.0).any():
            return False
        difference = float(both.value[1] - both.value[0])
        variance = float(both.covariance[0, 0] + both.covariance[1, 1] - 2 * both.covariance[0, 1])
        allowed = max(TUNING.agree * abs(size), min(2.0 * variance**0.5, abs(size)))
        return bool(abs(difference) < allowed)

    def _away(self) -> tuple[float, float]:
        """Vertical speed in m/s, and how far thrust is off the usual, from a second before on."""
        begin = max(self.at - round(1.0 / self._window.step), 0)
        usual = float(np.median(self._thrust[: self.at]))
        pull = np.abs(self._thrust[begin:] / max(usual, 1e-9) - 1.0)
        return float(np.abs(self._window.climb[begin:]).max()), float(pull.max())

    def _strange(self) -> float:
        """Relative change of mass that speed and thrust far from hover may feign."""
        speed, pull = self._away()
        return TUNING.by_climb * speed + TUNING.by_thrust * pull

    def _is_new(self, share: float) -> bool:
        """Whether thrust is off by the step from what it was in all of the flight before."""
        later = slice(self.at + 1, None)
        # What inflow does to thrust while the vehicle sinks is no part of the level.
        off = (self._window.e[later, 0] - self._level[0]) / np.mean(self._thrust[later])
        return bool(float(np.mean(off)) * np.sign(share) > 0.5 * abs(share))

    def _is_misread(self, likelihood: float) -> bool:
        """Whether a speed that was always read wrong, by twice at most, explains as much.

        Once that rotor is used otherwise, as by the first yaw of a flight, residuals follow the
        changes of its thrust, and not all of it.
        """
        if self._reference.actuator is not None:
            return False
        every = np.ones(len(self._window.e), dtype=bool)
        for i in range(self._window.squares.shape[1]):
            columns = self._rotor(i, every)
            fit = self._fit({c: a - a[: self.at].mean() for c, a in columns.items()})
            if fit.likelihood > likelihood and fit.value[0] < 0.75:
                return True
        return False

    def _is_aloft(self, share: float) -> bool:
        """Whether rotors carry the vehicle, at a share of thrust over mass that is gone."""
        return self._is_carried() and (share > 0.0 or self._flies(share))

    def _is_carried(self) -> bool:
        """Whether thrust carries the vehicle: one that fell, or lies on its back, has no mass."""
        later = slice(self.at + 1, None)
        return float(np.median(self._window.y[later, 0])) < -TUNING.falls * GRAVITY

    def _flies(self, share: float) -> bool:
        """Whether specific force answers to the rotors; on the ground it is that of gravity.

        Args:
            share: of thrust over mass that is gone.
        """
        later = slice(self.at + 1, None)
        measured, thrust = self._window.y[later, 0], self._thrust[later]
        if len(thrust) < 4:
            return True
        left = measured + (1.0 - share) * thrust
        # The median, as what hits the ground rings.
        answers = np.median(np.abs(left - np.median(left)))
        stands = np.median(np.abs(measured - np.median(measured)))
        return bool(answers < stands) or not self._stands()

    def _stands(self) -> bool:
        """Whether something carries the vehicle that the rotors alone do not."""
        later = slice(self.at + 1, None)
        off = np.abs(self._window.y[later, 0] + GRAVITY)
        carried = float(np.median(self._thrust[later])) < TUNING.carried * GRAVITY
        return carried and float(np.median(off)) < 0.5 * (1.0 - TUNING.carried) * GRAVITY

    # ---- fits ---------------------------------------------------------------------------------

    def _since(self, at: int, until: int | None = None) -> Mask:
        mask = np.zeros(len(self._window.e), dtype=bool)
        mask[at:until] = True
        return mask

    def _mass(self, since: Mask) -> Array:
        return (self._thrust * since)[:, None]

    def _balance(self, since: Mask) -> dict[int, Array]:
        """A CG moved forward, to the right: the first columns of Q are those of J^-1."""
        total = self._window.x[:, _THRUST] * since
        return {
            c: np.column_stack([-total * self._Q[c - 1, 1], total * self._Q[c - 1, 0]])
            for c in self._roots
            if c
        }

    def _rotor(self, i: int, since: Mask) -> dict[int, Array]:
        """All thrust of one rotor gone."""
        x, y, spin = self._reference.geometry[:, i]
        square = self._window.squares[:, i] * since
        effect = self._Q[:, :4] @ np.array([-y, x, 1.0, spin])
        columns = {c: (-square * effect[c - 1])[:, None] for c in self._roots if c}
        if self._watched[0]:
            columns[0] = (self._reference.kappa * square)[:, None]
        return columns

    def _free(self, since: Mask) -> dict[int, Array]:
        """A step of force and moment of any size, each with an unknown of its own."""
        places = {c: i for i, c in enumerate(self._roots)}
        columns = {}
        for c, i in places.items():
            columns[c] = np.zeros((len(since), len(places)))
            columns[c][:, i] = self._thrust * since if c == 0 else since
        return columns

    def _fit(self, columns: dict[int, Array]) -> "_StepFit":
        """Unknowns shared by channels, by generalized least squares."""
        normal = right = None
        for c, column in columns.items():
            root = self._roots[c]
            white = solve_triangular(
                root, np.column_stack([column, self._window.e[:, c]]), lower=True
            )
            white = white / self._scale[c]
            A, y = white[:, :-1], white[:, -1]
            normal = A.T @ A if normal is None else normal + A.T @ A
            right = A.T @ y if right is None else right + A.T @ y
        if normal is None or right is None:
            return _NOTHING
        # A step after the last frame leaves nothing to see: its unknown stays zero.
        seen = np.diag(normal)
        d = np.sqrt(np.where(seen > 0.0, seen, 1.0))
        inverse = np.linalg.inv(normal / np.outer(d, d) + 1e-9 * np.eye(len(d)))
        covariance = inverse / np.outer(d, d)
        value = covariance @ right
        return _StepFit(value, covariance, 0.5 * float(right @ value))

    def _likeliest(self, places: Sequence[int]) -> int:
        """Where a free step is likeliest to begin; without places, near the alarm."""
        window = self._window
        reach = round(TUNING.search / window.step)
        places = (
            places
            or [
                i
                for i in range(4, len(window.e) - 4)
                if abs(window.index[i]) <= reach or i == window.at
            ]
            or [min(window.at, len(window.e) - 1)]
        )
        gains = [self._fit(self._free(self._since(i))).likelihood for i in places]
        return places[int(np.argmax(gains))]

    def _inflation(self) -> Array:
        """(4,) by how much what is left after the step exceeds what the flight showed before."""
        since = self._since(self.at)
        free = self._free(since)
        scale = np.ones(4)
        for i, (c, column) in enumerate(free.items()):
            fit = self._fit({c: column[:, i : i + 1]})
            left = self._window.e[:, c] - column[:, i] * fit.value[0]
            white = solve_triangular(self._roots[c], left, lower=True)[self.at :]
            scale[c] = np.sqrt(max(1.0, float(np.mean(white * white))))
        return scale


@dataclass(frozen=True)
class _StepFit:
    """Generalized least squares.

    Attributes:
        value: (p,) unknowns.
        covariance: (p, p).
        likelihood: gain of the logarithm over no step.
    """

    value: Array
    covariance: Array
    likelihood: float

    @property
    def std(self) -> Array:
        """(p,) standard deviations."""
        return np.sqrt(np.diag(self.covariance))


Columns = Callable[[Mask], dict[int, Array]]
_NOTHING = _StepFit(np.zeros(1), np.zeros((1, 1)), 0.0)
_THRUST = rb.SIGNALS.index("thrust")
