"""The likeliest whitener of each axis: those of the bank, with continuous numbers.

The online estimator chooses from a bank (`noise.whitening`). Once the flight is over, the numbers
of such a whitener are those of least innovation power: it is monic and causal, so that this is
greatest likelihood. Of a disturbance, torque noise alone, and torque noise beside a gyro that has
been corrected at low frequency, as by attitude, the one is taken that predicts best, at a nat a
number (Akaike 1974, IEEE Transactions on Automatic Control 19); a disturbance, which is reported,
pays for a claim (Schwarz 1978, Annals of Statistics 6).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.noise.whitening import (
    TAU,
    Whitener,
    averaged,
    corrected,
    gauss_markov,
    torque_noise,
)
from gcs_sysid.signals.recursions import lfilter

_STEPS, _GAIN = 30, 0.1
"""Most steps of a search, and nats a number by which the last one gains less."""
_CHANGE = 1e-4
"""Of a number, for derivatives."""
_DECAYED = 1e-6
"""Of a whitener's response, below which what it held or was given has no part in what follows."""


def whitened(rows: Array, whitener: Whitener) -> Array:
    """(n, ...) rows, filtered from rest."""
    return lfilter([1.0, *whitener.numerator, 0.0], [1.0, *whitener.denominator], rows)[0]


def memory(whitener: Whitener) -> int:
    """Rows after which its response to one has decayed."""
    poles = np.abs(np.roots([1.0, *whitener.denominator]))
    slowest = min(float(poles.max(initial=0.5)), 1.0 - 1e-9)
    return len(poles) + math.ceil(math.log(_DECAYED) / math.log(slowest))


def innovations(run: Array, whitener: Whitener) -> Array:
    """(n, ...) of the (n, ...) rows of a run, from which nothing of what came before it is left.

    What the filter would hold at its start is not known: a few decaying responses, which are taken
    out of all columns alike.
    """
    out, factor = whitened(run, whitener), [1.0, *whitener.denominator]
    order = int(np.flatnonzero(factor)[-1])
    if not order:
        return out
    n = min(len(run), memory(whitener))
    late = np.zeros((n, order))
    late[:, 0] = lfilter([1.0], factor, np.eye(n, 1)[:, 0])[0]
    for i in range(1, min(n, order)):
        late[i:, i] = late[:-i, 0]
    basis = np.linalg.qr(late)[0]
    first = out[:n].reshape(n, -1)
    out[:n] -= (basis @ (basis.T @ first)).reshape(out[:n].shape)
    return out


@dataclass(frozen=True)
class _Family:
    """Whiteners of one kind.

    Attributes:
        made: of (k,) numbers: Hz, s and rad/s as logarithms, b as it is.
        spans: (2, k) least and greatest.
        starts: (m, k) where the search may begin.
    """

    made: Callable[[Array], Whitener]
    spans: Array
    starts: Array


def _families(T: float) -> tuple[_Family, ...]:
    """Those of a disturbance last."""

    def calm(x: Array) -> Whitener:
        return averaged(torque_noise(T, np.exp(x[0])), x[1])

    def slow(x: Array) -> Whitener:
        return averaged(corrected(T, np.exp(x[2]), np.exp(x[0])), x[1])

    def disturbed(x: Array) -> Whitener:
        f_u, f_d, tau = np.exp(x[[0, 2, 3]])
        return averaged(gauss_markov(T, f_d, f_u, tau), x[1])

    hz, corner = np.log([0.05, 0.5 / T]), np.log([0.05, 1.0 / T])
    some = np.stack([hz, [0.0, 0.95]], axis=1)
    starts = np.array([[np.log(f_u), 0.1] for f_u in (0.3, 3.0, 20.0)])
    others = np.array([[np.log(f_d), np.log(TAU)] for f_d in (2.0, 8.0, 23.0)])
    return (
        _Family(calm, some, starts),
        _Family(
            slow,
            np.column_stack([some, corner]),
            np.column_stack([starts, np.full(len(starts), np.log(5.0))]),
        ),
        _Family(
            disturbed,
            np.column_stack([some, hz, np.log([0.05, 10.0])]),
            np.array([[*start, *other] for start in starts for other in others]),
        ),
    )


@dataclass(frozen=True)
class _Residuals:
    """Residuals of every run.

    Attributes:
        runs: (n,) changes of a rate.
        sound: (n,) which of these rows count.
    """

    runs: Sequence[Array]
    sound: Sequence[Mask]

    def white(self, whitener: Whitener) -> Array:
        """(rows that count,) innovations."""
        parts = zip(self.runs, self.sound, strict=True)
        return np.concatenate([innovations(run, whitener)[kept] for run, kept in parts])

    def slopes(self, family: _Family, x: Array) -> Array:
        """(rows that count, k) what (k,) numbers change of the innovations.

        Of e = N / C r the derivative by the factor of z^-i in N is z^-i / C r, by that in C
        -z^-i / C e.
        """
        whitener, out = family.made(x), []
        inward = np.where(x + _CHANGE > family.spans[1], -_CHANGE, _CHANGE)
        changed = [(_factors(family.made(x + h)), h.sum()) for h in np.diag(inward)]
        by_number = np.stack([(to - _factors(whitener)) / h for to, h in changed], axis=1)
        for run, kept in zip(self.runs, self.sound, strict=True):
            both = np.column_stack([run, whitened(run, whitener)])
            passed = lfilter([1.0], [1.0, *whitener.denominator], both * [1.0, -1.0])[0]
            late = np.zeros((len(run), len(by_number)))
            # Of N and of C, at powers of z^-1.
            for i, (side, lag) in enumerate([(0, 1), (0, 2), (1, 1), (1, 2), (1, 3)]):
                late[lag:, i] = passed[:-lag, side]
            out.append(late[kept] @ by_number)
        return np.concatenate(out)


def _factors(whitener: Whitener) -> Array:
    """(5,) of the numerator, then of the denominator."""
    return np.array([*whitener.numerator, *whitener.denominator])


class Likeliest(NamedTuple):
    """Whiteners of one axis.

    Attributes:
        best: of all.
        calm: of those without a disturbance.
        numbers: of each family, from which another search may begin.
    """

    best: Whitener
    calm: Whitener
    numbers: Sequence[Array]


def likeliest(
    runs: Sequence[Array], sound: Sequence[Mask], T: float, near: Sequence[Array] = ()
) -> Likeliest:
    """The whiteners of least innovation power.

    Args:
        runs: (n,) residuals of each run, changes of a rate.
        sound: (n,) which of these rows count.
        T: s of a row.
        near: numbers found for residuals much like these, where the search begins; none: not known.
    """
    residuals, found = _Residuals(runs, sound), []
    for i, family in enumerate(_families(T)):
        starts = near[i][None] if near else family.starts
        cost, x = _descended(family, residuals, starts)
        whitener = family.made(x)
        nats = 0.5 * math.log(sum(len(run) for run in runs)) if whitener.disturbed else 1.0
        found.append((cost + nats * len(x), whitener, x))
    calm = min(found[:-1], key=_cost)
    best = min(calm, found[-1], key=_cost)
    return Likeliest(best[1], calm[1], [x for _, _, x in found])


def _cost(found: tuple[float, Whitener, Array]) -> float:
    return found[0]


def _nats(e: Array) -> float:
    return 0.5 * len(e) * math.log(max(float(e @ e), 1e-300))


def _descended(family: _Family, residuals: _Residuals, starts: Array) -> tuple[float, Array]:
    """Fewest nats by damped Gauss-Newton, and the numbers there."""
    tried = [residuals.white(family.made(x)) for x in starts]
    best = int(np.argmin([_nats(e) for e in tried]))
    x, e = starts[best], tried[best]
    cost, damping = _nats(e), 1e-2
    for _ in range(_STEPS):
        slopes = residuals.slopes(family, x)
        power = max(float(e @ e), 1e-300) / len(e)
        gradient, information = -slopes.T @ e / power, slopes.T @ slopes / power
        gain = -1.0
        while gain < 0.0 and damping < 1e6:
            H = information + np.diag(damping * np.diag(information) + 1e-9)
            step = np.clip(np.linalg.solve(H, gradient), -1.5, 1.5)
            to = np.clip(x + step, *family.spans)
            there = residuals.white(family.made(to))
            gain = cost - _nats(there)
            damping *= 0.1 if gain >= 0.0 else 10.0
        if gain < 0.0:
            break
        x, e, cost = to, there, cost - gain
        if gain < _GAIN * len(x):
            break
    return cost, x
