"""The likeliest noise of each axis, with continuous numbers, and the whitener that follows.

A row of one step relates the change of a rate to what acted (`noise.whitening`). What it leaves has
the spectrum

    S_v = q_d / |1 - a z^-1|^2 + q_u + r |1 - z^-1|^2 |1 + b z^-1|^2 |1 - c z^-1|^2 / |1 - p z^-1|^2

an Ornstein-Uhlenbeck moment, torque noise, and the gyro's noise: averaged over neighbors (b), or
with less at low frequency (c > p), as where attitude has corrected it. The online estimator
chooses from a bank of such spectra; once the flight is over their numbers are those of greatest
likelihood. Over the periodogram of the residuals that is Whittle's (1953, Arkiv for Matematik 2),

    -2 ln L = sum over frequencies of ln S_v + P / S_v

and of the models with and without each part the one is taken that predicts best, at a nat a number
(Akaike 1974, IEEE Transactions on Automatic Control 19); one with a moment, which is reported, pays
for a claim (Schwarz 1978, Annals of Statistics 6). Its numbers then are those of least innovation
power in the time domain. Times its denominators S_v is a polynomial in z + 1/z, whose zeros within
the unit circle make the spectral factor, by which the whitener divides.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import product

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.noise.whitening import TAU, Whitener
from gcs_sysid.signals.recursions import lfilter

_TAUS = (0.05, 10.0)
"""s; a faster moment is torque noise, a slower one a trim."""
_CORNERS = 0.05
"""rad/s, least corner of the gyro's noise."""
_MOST_AVERAGED = 0.95
_GROUPED = 1.05
"""Ratio of frequencies within which a spectrum is flat enough for one mean."""
_FIRST = 2
"""Lowest frequencies of a run, into which its start leaks."""
_TAPER_LOSS = 35.0 / 18.0
"""Independent values that a Hann taper costs: neighbors in the spectrum are correlated."""
_STEPS, _GAIN = 30, 1e-2
"""Most steps of a search, and nats a number by which the last one gains less."""
_CHANGE = 1e-4
"""Of a number, for derivatives."""


@dataclass(frozen=True)
class AxisNoise:
    """Noise of one axis, of rows of changes of a rate in a step of T; densities per row.

    Attributes:
        r: (rad/s)^2, of the gyro.
        u: torque noise, (rad/s)^2.
        d: (rad/s)^2, that drives the moment; 0: there is none.
        tau: s, of the moment.
        b: of neighboring samples of the gyro.
        c: zero of its color.
        p: pole of its color.
    """

    r: float
    u: float = 0.0
    d: float = 0.0
    tau: float = TAU
    b: float = 0.0
    c: float = 0.0
    p: float = 0.0

    def parts(self, T: float) -> tuple[tuple[float, list[Array], list[Array]], ...]:
        """Of each component its strength, and the factors above and below of its spectrum."""
        a = np.array([1.0, -np.exp(-T / self.tau)])
        gyro = [np.array([1.0, -1.0]), np.array([1.0, self.b]), np.array([1.0, -self.c])]
        return (
            (self.d, [], [a]),
            (self.u, [], []),
            (self.r, gyro, [np.array([1.0, -self.p])]),
        )

    def spectrum(self, T: float, cos: Array) -> Array:
        """(n,) S_v at (n,) cosines of the frequency in a row."""

        def power(factors: list[Array]) -> Array:
            product = np.ones_like(cos)
            for one, late in factors:
                product = product * (one * one + late * late + 2.0 * one * late * cos)
            return product

        total = np.zeros_like(cos)
        for strength, above, below in self.parts(T):
            if strength:
                total += strength * power(above) / power(below)
        return total

    def whitener(self, T: float, name: str) -> "FittedWhitener":
        """The whitener of this noise."""
        parts = [part for part in self.parts(T) if part[0] > 0.0]
        below = [f for _, _, factors in parts for f in factors if f[1]]
        made = []
        for strength, above, own in parts:
            others = [f for _, _, factors in parts if factors is not own for f in factors if f[1]]
            polynomial = reduce(np.convolve, [*above, *others], np.ones(1))
            made.append(strength * np.convolve(polynomial, polynomial[::-1]))
        length = max(len(m) for m in made)
        total = np.sum([np.pad(m, (length - len(m)) // 2) for m in made], axis=0)
        zeros = np.roots(np.trim_zeros(total))
        inside = zeros[np.argsort(np.abs(zeros))][: len(zeros) // 2]
        factor = np.atleast_1d(np.poly(inside / np.maximum(np.abs(inside), 1.0)).real)
        passed = reduce(np.convolve, below, np.ones(1))
        slow = self.r * (1.0 + self.b) ** 2
        f_d = (self.d / slow) ** 0.25 / (2.0 * np.pi * T)
        # Of an innovation, by the spectrum at half the rate of the rows.
        signs = (-1.0) ** np.arange(len(factor))
        at = (-1.0) ** (np.arange(length) - length // 2)
        variance = float((at @ total) / (signs @ factor) ** 2)
        return FittedWhitener(
            name,
            float(np.exp(-T / self.tau)) if self.d else 0.0,
            0.0,
            0.0,
            f_d,
            quick=bool(self.d) and self.tau < 0.5 * TAU,
            above=tuple(passed.tolist()),
            under=tuple(factor.tolist()),
            gyro_share=slow / variance,
            variance=variance,
        )


@dataclass(frozen=True)
class FittedWhitener(Whitener):
    """The whitener of any such noise.

    Attributes:
        above: coefficients of the numerator, monic.
        under: of the denominator, monic.
        gyro_share: see `Whitener`.
        variance: (rad/s)^2, of an innovation.
    """

    above: tuple[float, ...] = (1.0,)
    under: tuple[float, ...] = (1.0,)
    gyro_share: float = 0.0
    variance: float = 1.0

    def power(self, omega: Array) -> Array:
        """See `Whitener`."""
        z = np.exp(-1j * omega)
        passed = np.polyval(self.above[::-1], z) / np.polyval(self.under[::-1], z)
        return np.abs(passed) ** 2


def _filter_of(whitener: Whitener) -> tuple[Array, Array]:
    """Numerator and denominator of a whitener, of one length."""
    if isinstance(whitener, FittedWhitener):
        above, under = np.array(whitener.above), np.array(whitener.under)
    else:
        above, under = np.array([1.0, -whitener.a]), np.array([1.0, *whitener.factor])
    under = np.trim_zeros(under, "b")
    above = np.trim_zeros(above, "b")
    length = max(len(above), len(under), 2)
    return tuple(np.pad(part, (0, length - len(part))) for part in (above, under))  # type: ignore[return-value]


def whitened(rows: Array, whitener: Whitener) -> Array:
    """(n, ...) rows, filtered from rest."""
    return lfilter(*_filter_of(whitener), rows)[0]


def innovations(run: Array, whitener: Whitener) -> Array:
    """(n, ...) of the (n, ...) rows of a run, from which nothing of what came before it is left.

    What the filter would hold at its start is not known: a few decaying responses, which are taken
    out of all columns alike.
    """
    above, under = _filter_of(whitener)
    out, _ = lfilter(above, under, run)
    order = int(np.flatnonzero(under)[-1])
    if not order:
        return out
    n = len(run)
    start = np.zeros((n, order))
    start[: min(n, order)] = np.eye(min(n, order), order)
    basis = np.linalg.qr(lfilter([1.0], under, start)[0])[0]
    flat = out.reshape(n, -1)
    return (flat - basis @ (basis.T @ flat)).reshape(out.shape)


class Periodogram:
    """Power of the residuals of an axis over frequency, in groups that are nearly flat.

    Args:
        runs: (n,) residuals of each run, changes of a rate.
        T: s of a row.
    """

    def __init__(self, runs: Sequence[Array], T: float) -> None:
        self._T = T
        cos, power, counts = [], [], []
        for run in runs:
            n = len(run)
            taper = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(n) / n)
            bins = np.arange(_FIRST, (n - 1) // 2)
            if len(bins) < 2 * _FIRST:
                continue
            p = np.abs(np.fft.rfft(run * taper)[bins]) ** 2 / np.sum(taper * taper)
            group = np.floor(np.log(bins / bins[0]) / np.log(_GROUPED))
            starts = np.flatnonzero(np.diff(group, prepend=-1.0))
            size = np.diff([*starts, len(bins)])
            power.append(np.add.reduceat(p, starts) / size)
            cos.append(np.cos(2.0 * np.pi / n * np.add.reduceat(bins, starts) / size))
            counts.append(size)
        self.empty = not power
        if not self.empty:
            self._cos, self._power = np.concatenate(cos), np.concatenate(power)
            self._counts = np.concatenate(counts) / _TAPER_LOSS

    @cached_property
    def _level(self) -> float:
        return float(np.log(np.mean(self._power / (2.1 - 2.0 * self._cos))))

    def likeliest(self, least: float) -> tuple["NoiseModel", "NoiseModel"]:
        """Of all models, and of those without a moment.

        Args:
            least: (rad/s)^2, of torque noise: no model is exact.
        """
        found = []
        schwarz = 0.5 * float(np.log(max(self._counts.sum(), 2.0)))
        for gyro, walk, moment in product(("", "b", "p", "pc"), ("", "u"), ("", "dt")):
            model = NoiseModel.first(f"r{gyro}{walk}{moment}", self._level, least, self._T)
            cost, model = self._fitted(model)
            found.append((cost + (schwarz if moment else 1.0) * len(model.free), model))
        calm = [pair for pair in found if "d" not in pair[1].free]
        return min(found, key=_cost)[1], min(calm, key=_cost)[1]

    def _fitted(self, model: "NoiseModel") -> tuple[float, "NoiseModel"]:
        """-ln likelihood in nats, and the likeliest numbers of a model."""
        counts = self._counts

        def log_spectrum(model: NoiseModel) -> Array:
            return np.log(model.noise.spectrum(self._T, self._cos))

        def cost_of(log: Array) -> float:
            return 0.5 * float(counts @ (log + self._power * np.exp(-log)))

        def downhill(log: Array, slopes: Array) -> tuple[Array, Array]:
            # Power of a group of m, at the model: variance 1 / m of its relative error.
            gradient = 0.5 * slopes.T @ (counts * (self._power * np.exp(-log) - 1.0))
            return gradient, 0.5 * (slopes * counts[:, None]).T @ slopes

        return _descended(model, log_spectrum, cost_of, downhill)


@dataclass(frozen=True)
class NoiseModel:
    """Some of the numbers of a noise free, for a search.

    Attributes:
        free: their names: r, b, p, c, u, d, and t for tau.
        x: they: logarithms, but for b, and c as a logit between p and 1.
        least: (rad/s)^2, of torque noise.
        T: s of a row.
        low, high: between which they mean something.
    """

    free: str
    x: Array
    least: float
    T: float
    low: Array
    high: Array

    @classmethod
    def first(cls, free: str, level: float, least: float, T: float) -> "NoiseModel":
        """To start from, where the gyro's noise has about exp(level)."""
        start = {"r": level, "b": 0.3, "p": np.log(5.0), "c": 1.0, "u": level - 3.0,
                 "d": level - 6.0, "t": 0.0}  # fmt: skip
        bounds = {
            "b": (0.0, _MOST_AVERAGED),
            "p": (np.log(_CORNERS), np.log(1.0 / T)),
            "c": (-4.0, 8.0),
            "t": tuple(np.log(_TAUS)),
        }
        span = [bounds.get(name, (level - 30.0, level + 10.0)) for name in free]
        low, high = np.array(span).T
        return cls(free, np.array([start[name] for name in free]), least, T, low, high)

    def moved(self, step: Array) -> "NoiseModel":
        """The model a step away."""
        return replace(self, x=np.clip(self.x + step, self.low, self.high))

    @property
    def noise(self) -> AxisNoise:
        """What the numbers mean."""
        v = dict(zip(self.free, self.x.tolist(), strict=True))
        p = float(np.exp(-np.exp(v["p"]) * self.T)) if "p" in v else 0.0
        share = 1.0 / (1.0 + np.exp(-v["c"])) if "c" in v else 1.0
        return AxisNoise(
            float(np.exp(v["r"])),
            self.least + (float(np.exp(v["u"])) if "u" in v else 0.0),
            float(np.exp(v["d"])) if "d" in v else 0.0,
            float(np.exp(v["t"])) if "t" in v else TAU,
            v.get("b", 0.0),
            float(p + (1.0 - p) * share) if "p" in v else 0.0,
            p,
        )

    def polished(self, runs: Sequence[Array], weights: Sequence[Array]) -> "NoiseModel":
        """That of least innovation power over (n,) residuals of each run, with (n,) weights.

        Of rows whose noise comes and goes the periodogram shows the loudest.
        """
        if len(self.free) == 1:
            return self
        rows = float(sum(weight.sum() for weight in weights))

        def white(model: NoiseModel) -> Array:
            whitener = model.noise.whitener(self.T, "")
            return np.concatenate(
                [
                    np.sqrt(weight) * innovations(run, whitener)
                    for run, weight in zip(runs, weights, strict=True)
                ]
            )

        def cost_of(e: Array) -> float:
            return 0.5 * rows * float(np.log(e @ e))

        def downhill(e: Array, slopes: Array) -> tuple[Array, Array]:
            power = float(e @ e) / rows
            return -slopes.T @ e / power, slopes.T @ slopes / power

        return _descended(self, white, cost_of, downhill)[1]


def _descended(
    model: NoiseModel,
    values_of: Callable[[NoiseModel], Array],
    cost_of: Callable[[Array], float],
    downhill: Callable[[Array, Array], tuple[Array, Array]],
) -> tuple[float, NoiseModel]:
    """Cost in nats, and the model where damped Gauss-Newton makes it least."""
    values, damping = values_of(model), 1e-2
    cost, size = cost_of(values), len(model.free)
    for _ in range(_STEPS):
        inward = np.where(model.x + _CHANGE > model.high, -_CHANGE, _CHANGE)
        slopes = np.stack(
            [(values_of(model.moved(h)) - values) / h.sum() for h in np.diag(inward)], axis=1
        )
        gradient, information = downhill(values, slopes)
        gain = -1.0
        while gain < 0.0 and damping < 1e6:
            H = information + np.diag(damping * np.diag(information) + 1e-9)
            to = model.moved(np.clip(np.linalg.solve(H, gradient), -1.5, 1.5))
            tried = values_of(to)
            gain = cost - cost_of(tried)
            damping *= 0.1 if gain >= 0.0 else 10.0
        if gain < 0.0:
            break
        model, values, cost = to, tried, cost - gain
        if gain < _GAIN * size:
            break
    return cost, model


def _cost(pair: tuple[float, NoiseModel]) -> float:
    return pair[0]
