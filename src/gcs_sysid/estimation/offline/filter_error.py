"""Filter error in innovations form: maximum-likelihood noise for each axis of the whole record.

Online a bank of whiteners is given, each with an Ornstein-Uhlenbeck moment and torque noise of a
strength of its own (`whitening`). Once the flight is over there is time to look for
the likeliest: strength and time constant of the moment, strength of the torque noise (under which
the rate walks), and how far the gyro's noise is averaged. In steady state the Kalman filter of that
model is the whitener itself, so that the likelihood of n one-step predictions is
-(n / 2) ln sigma^2 with sigma^2 their power (Ljung, System Identification, ch. 7), and a trial
costs one pass of a recursive filter over the residuals. Each axis takes the model of least

    BIC = n ln sigma^2 + k ln n

among those with and without a moment, with and without torque noise, and the bank's own whitener,
whose numbers were chosen from a list and count as none (Schwarz 1978, Annals of Statistics 6).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from gcs_sysid.arrays import Array, Mask, complete_rows, runs
from gcs_sysid.estimation.fit.problem import residual_maker
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.shocks import SHOCK
from gcs_sysid.estimation.noise.whitened_moments import OfflineBank
from gcs_sysid.estimation.noise.whitening import (
    QUICK,
    TAU,
    Whitener,
    bank_for,
    gauss_markov,
    torque_noise,
)
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics
from gcs_sysid.estimation.rows.regression import RowMaker
from gcs_sysid.estimation.rows.rotor_signals import RotorPath
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.one_step import step_for
from gcs_sysid.signals.samples import Samples
from gcs_sysid.signals.smoothers import WindowSmoother

_BATCH = 0.25
"""s, in which shocks are found."""
_SHORTEST = 1.0
"""s of a run between gaps; the filter's start counts for less in longer ones."""
_EVALUATIONS = 160
"""Most trials of one model of one axis."""
_LEAST_F, _MOST_F = 0.3, 0.4
"""Hz, and share of the sample rate, between which moments and torque noise may exceed the gyro's
noise."""
_TAUS = (0.05, 10.0)
"""s; a faster moment is torque noise, a slower one a trim."""
_MOST_AVERAGED = 0.95
_FIRST_STEP = 0.4
_FASTER = 1.6
"""How much faster the moment of the whitener is that the likeliest is contrasted with."""
_KEPT_OF_BANK = frozenset(
    ("none", "leak 0.3 s", "leak 1 s", "torque noise to 18 Hz", "moment to 4 Hz",
     "moment to 11 Hz", "moment to 23 Hz")
)  # fmt: skip
"""What the likeliest are compared with."""


@dataclass(frozen=True)
class AxisModel:
    """The likeliest noise of one axis.

    Attributes:
        whitener: of it.
        calm: the likeliest without a moment.
        gain: nats by which `whitener` is likelier than the bank's, BIC's price taken off; 0 where
            that is kept.
        shown: f_d, f_u (Hz), tau (s) and b, as far as the model has them, else 0.
    """

    whitener: Whitener
    calm: Whitener
    gain: float
    shown: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class ResidualRun:
    """Residuals of a fit over rows of one step without a gap.

    Attributes:
        residual: (n, 3) rad/s^2.
        slope: (n, 2) by how much the predicted roll and pitch acceleration changes with ln Ixx and
            ln Iyy, rad/s^2.
        setpoint: (n, 3) rad/s, NaN where none is reported.
        sound: (n,) which rows belong to no shock, see `whitened_fit`.
    """

    residual: Array
    slope: Array
    setpoint: Array
    sound: Mask


def residual_runs(
    parts: Sequence[Samples], geometry: Array, dt: float, fit: RotationFit
) -> list[ResidualRun]:
    """What a fit leaves of every gapless run.

    Args:
        parts: samples, in time order.
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        fit: to them, with a whitener for each axis.
    """
    step, asked = step_for(dt), step_for(dt)
    basis = ActuatorDynamics(step.delays, half_width=None, dt=dt)
    alone = ActuatorDynamics((0.0,), half_width=4 * dt, dt=dt)
    maker = RowMaker(
        RotorPath(geometry, dt, basis), alone, WindowSmoother(dt, 4, (0.0,)), (step, basis)
    )
    P = basis.map_at(fit.coordinates)
    G = rb.forward_jacobian(fit.theta, fit.deviating.torque(fit.deviations))[1]
    slopes = np.stack([fit.theta[i] * G[i, i] @ P[: G.shape[-1]] for i in (0, 1)])
    columns = np.vstack([residual_maker(fit.Q) @ P, slopes])
    blocks = [np.empty((0, 8))]
    for part in parts:
        rows = maker.update(part).one_step @ columns.T
        blocks.append(np.hstack([rows, asked.update(part.setpoint, 0).average]))
    made = np.concatenate(blocks)
    least = _SHORTEST / step.time
    runs_ = [
        made[run]
        for run, there in runs(complete_rows(made[:, :5]))
        if there and run.stop - run.start >= least
    ]
    sound = _sound([run[:, :3] for run in runs_], step.time, fit.whiteners)
    return [
        ResidualRun(run[:, :3], run[:, 3:5], run[:, 5:], mask)
        for run, mask in zip(runs_, sound, strict=True)
    ]


def likeliest_noise(
    found: Sequence[ResidualRun], T: float, whiteners: Sequence[Whitener]
) -> tuple[AxisModel, ...]:
    """The likeliest noise of each axis.

    Args:
        found: of each run.
        T: s between rows.
        whiteners: of each axis, that the fit took.
    """
    sound = [run.sound for run in found]
    return tuple(
        _AxisSearch([run.residual[:, axis] for run in found], sound, T).best(whiteners[axis])
        for axis in range(3)
    )


def offline_bank(T: float, models: Sequence[AxisModel], judges: Sequence[Whitener]) -> OfflineBank:
    """Whiteners for a second look at a record: the likeliest, and what they are compared with.

    Args:
        T: s between rows.
        models: of the axes.
        judges: those of the online estimate, by which predictions are judged.
    """
    own = tuple(model.whitener for model in models)
    calm = [model.calm for model in models]
    faster = [
        _whitener(T, _FASTER * f_d, f_u, tau, b)
        for f_d, f_u, tau, b in (model.shown for model in models)
        if f_d
    ]
    known = [w for w in bank_for(T) if w.name in _KEPT_OF_BANK]
    by_name = {whitener.name: whitener for whitener in (*known, *judges, *calm, *faster, *own)}
    # Those without a disturbance come first.
    whiteners = tuple(sorted(by_name.values(), key=lambda whitener: whitener.disturbed))
    return OfflineBank(whiteners, own, tuple(judges))


def innovations(run: Array, whitener: Whitener) -> Array:
    """(n,) of (n,) residuals."""
    out: Array = lfilter([1.0, -whitener.a], [1.0, *whitener.factor], run)
    return out


def _sound(residuals: Sequence[Array], T: float, bank: Sequence[Whitener]) -> list[Mask]:
    """Of each run (n,) which rows belong to no shock."""
    if not residuals:
        return []
    size = max(round(_BATCH / T), 1)
    powers = []
    for run in residuals:
        white = np.stack([innovations(run[:, i], bank[i]) for i in range(3)], axis=1)
        starts = np.arange(0, len(run), size)
        counts = np.diff([*starts, len(run)])[:, None]
        powers.append(np.add.reduceat(white * white, starts, axis=0) / counts)
    usual = np.median(np.concatenate(powers), axis=0)
    return [
        np.repeat((power / usual).mean(axis=1) <= SHOCK, size)[: len(run)]
        for power, run in zip(powers, residuals, strict=True)
    ]


def _whitener(T: float, f_d: float, f_u: float, tau: float, b: float) -> Whitener:
    """Of a moment (f_d > 0) or none, torque noise (f_u > 0) or none, an averaged gyro (b > 0)."""
    if f_d:
        found = gauss_markov(T, f_d, f_u, tau)
        name = f"moment to {f_d:.3g} Hz of {tau:.2g} s"
        name += f", torque noise to {f_u:.3g} Hz" if f_u else ""
    else:
        found = torque_noise(T, f_u)
        name = f"torque noise to {f_u:.3g} Hz"
    name += f", averaged {b:.2f}" if b else ""
    return replace(found, name=f"{name}, likeliest", b=b, quick=bool(f_d) and tau < 0.5 * TAU)


class _AxisSearch:
    """Trials of noise models on one axis' residuals.

    Args:
        residuals: of each run, (n,).
        sound: of each run, (n,) which rows count.
        T: s between rows.
    """

    def __init__(self, residuals: Sequence[Array], sound: Sequence[Mask], T: float) -> None:
        self._residuals, self._sound, self._T = residuals, sound, T
        self._rows = int(sum(int(mask.sum()) for mask in sound))
        fastest = _MOST_F / T
        self._low = np.array([np.log(_LEAST_F), np.log(_LEAST_F), np.log(_TAUS[0]), 0.0])
        self._high = np.array([np.log(fastest), np.log(fastest), np.log(_TAUS[1]), _MOST_AVERAGED])

    def best(self, given: Whitener) -> AxisModel:
        """The likeliest model by BIC, or a given whitener."""
        price = 0.5 * np.log(max(self._rows, 2))
        start = np.append(np.log([given.below or 8.0, 15.0, TAU]), given.b or 0.3)
        found = {}
        for free in _FAMILIES:
            values, cost = self._minimum(free, start)
            found[free] = cost + price * len(free), values
            if free == (_F_D, _F_U, _TAU, _B):
                start = values
        calm = min((free for free in found if _F_D not in free), key=lambda free: found[free][0])
        best = min(found, key=lambda free: found[free][0])
        cost, values = found[best]
        without = self._made(calm, found[calm][1])
        own = self._cost(given)
        if own <= cost:
            return AxisModel(given, without, 0.0, self._shown_of(given))
        return AxisModel(
            self._made(best, values), without, float(own - cost), self._shown(best, values)
        )

    def _minimum(self, free: tuple[int, ...], start: Array) -> tuple[Array, float]:
        """(4,) values of a model and its cost, nats."""
        from scipy.optimize import minimize  # takes a while to load

        places = list(free)

        def cost(x: Array) -> float:
            values = start.copy()
            values[places] = np.clip(x, self._low[places], self._high[places])
            beyond = float(np.sum((x - values[places]) ** 2))
            return self._cost(self._made(free, values)) + 1e3 * beyond

        result = minimize(
            cost, start[places], method="Nelder-Mead",
            options={"xatol": 0.02, "fatol": 0.1, "maxfev": _EVALUATIONS,
                     "initial_simplex": _simplex(start[places])},
        )  # fmt: skip
        values = start.copy()
        values[places] = np.clip(result.x, self._low[places], self._high[places])
        return values, self._cost(self._made(free, values))

    def _cost(self, whitener: Whitener) -> float:
        """-ln likelihood, nats, up to a constant."""
        power = sum(
            float(np.sum(innovations(run, whitener)[sound] ** 2))
            for run, sound in zip(self._residuals, self._sound, strict=True)
        )
        return 0.5 * self._rows * float(np.log(max(power, 1e-300) / self._rows))

    def _shown(self, free: tuple[int, ...], values: Array) -> tuple[float, float, float, float]:
        f_d, f_u, tau = (float(np.exp(values[i])) if i in free else 0.0 for i in (_F_D, _F_U, _TAU))
        return f_d, f_u, tau, float(values[_B]) if _B in free else 0.0

    @staticmethod
    def _shown_of(whitener: Whitener) -> tuple[float, float, float, float]:
        if not whitener.disturbed:
            return 0.0, 0.0, 0.0, whitener.b
        return whitener.below, 0.0, QUICK if whitener.quick else TAU, whitener.b

    def _made(self, free: tuple[int, ...], values: Array) -> Whitener:
        return _whitener(self._T, *self._shown(free, values))


_F_D, _F_U, _TAU, _B = range(4)
_FAMILIES = (
    (_F_D, _F_U, _TAU, _B), (_F_D, _TAU, _B), (_F_D, _TAU), (_F_D, _F_U, _TAU), (_F_U, _B), (_F_U,)
)  # fmt: skip
"""What each model leaves free: f_d, f_u and tau as logarithms, b."""


def _simplex(start: Array) -> Array:
    """(k + 1, k) first points of Nelder and Mead's search: half an octave apart."""
    return np.vstack([start, start + _FIRST_STEP * np.eye(len(start))])
