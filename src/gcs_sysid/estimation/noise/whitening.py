"""Whiteners of row residuals: recursive, causal, monic; and the moments of rows whitened by them.

A row of one step T = h dt relates the change of a rate to what acted in the step,

    D_k = g_k - g_(k-1) = Q(theta) xbar_k + v_k

and the residual v is an unmodeled moment d (gusts, blade flapping), white torque noise (that of the
rotors), and the gyro's noise, which differencing makes grow with frequency:

    S_v = q_d / |1 - a z^-1|^2 + q_u + r |1 - z^-1|^2 ,    a = exp(-T / tau)

with d of Ornstein-Uhlenbeck form, or of one that passed such a lag twice, as gusts do that the
vehicle's size averages: |1 - a z^-1|^4 in place of its square. The rate loop answers d, so that
torque and d are correlated, and least squares attributes d to inertia. A strictly causal loop
responds only to the past, though: torque is uncorrelated with the *innovation* of v. Filtered by
the inverse of its spectral factor, all columns alike, rows have innovations for residuals and least
squares is unbiased, however strong the feedback (prediction-error identification in closed loop:
Forssell and Ljung 1999, Automatica 35, 1215-1241). Filters that look both ways, and windows, lose
that.

The strength of d is not known beforehand, so a bank of whiteners runs in parallel. All of them are
monic and causal, so that the log likelihood of n rows is -(n / 2) ln sigma^2 up to a constant,
sigma^2 the power of the innovations: every axis takes the whitener of least innovation power.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array, Mask, runs

TAU = 1.0
"""s, of a disturbance: between a gust and a change of trim."""
LEAKS = (0.3, 1.0)
"""s: without disturbance or torque noise, the gyro's noise integrated is white, but for drift."""
WALKS = (2.0, 6.0, 18.0, 40.0, 120.0)
"""Hz, below which torque noise exceeds the gyro's noise."""
DISTURBED = (1.0, 2.0, 4.0, 8.0, 11.0, 16.0, 23.0, 32.0, 45.0, 64.0)
"""Hz, below which a disturbance exceeds the gyro's noise."""
QUICK, QUICKLY_DISTURBED = 0.15, (4.0, 11.0, 23.0)
"""s and Hz, of a disturbance that leaves slow motion, and with it the CG, more alone."""
SMOOTH = (4.0, 6.0, 8.0, 11.0, 16.0, 23.0)
"""Hz, of one smoothed twice."""
BOTH = (
    (4.0, 15.0), (8.0, 15.0), (16.0, 15.0),
    (6.0, 40.0), (11.0, 40.0), (16.0, 40.0), (23.0, 40.0), (32.0, 40.0),
    (22.0, 120.0),
)  # fmt: skip
"""Hz, of a disturbance and of torque noise beside it."""
AVERAGED = (0.4, 0.9)
"""b, of neighboring samples of a gyro."""
_AVERAGED = 5
"""Whiteners without disturbance that are tried with them too: leaks, and the slower torque
noise."""
_ORDER = 3
"""Of the denominator."""
PIECE = 32
"""Rows whitened by one product."""
MOST_WEIGHT = 3.0
"""Of a batch whose innovations are weak, by chance or because nothing moved."""


@dataclass(frozen=True)
class Whitener:
    """w = N / C z, of monic polynomials of the delay z^-1.

    Attributes:
        name: what it assumes.
        numerator: (2,) of z^-1 and z^-2 in N, by which a disturbance is white noise again.
        denominator: (3,) of z^-1, z^-2 and z^-3 in C.
        gyro_share: variance of the gyro's slow noise over that of an innovation, r / sigma^2.
        below: Hz, where the disturbance exceeds the gyro's noise; 0: none is assumed.
        b: of a gyro whose noise is averaged over neighboring samples; 0: it is white.
        quick: whether the disturbance's time constant is the shorter one.
        strength: variance of the disturbance over the gyro's.
    """

    name: str
    numerator: tuple[float, float] = (0.0, 0.0)
    denominator: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gyro_share: float = 0.0
    below: float = 0.0
    b: float = 0.0
    quick: bool = False
    strength: float = 0.0

    @property
    def disturbed(self) -> bool:
        """Whether it assumes a disturbance."""
        return self.below != 0.0

    def power(self, omega: Array) -> Array:
        """(n,) |N / C|^2 at (n,) rad a row."""
        late = np.exp(-1j * omega)
        above, below = (1.0, *self.numerator), (1.0, *self.denominator)
        return np.abs(np.polyval(above[::-1], late) / np.polyval(below[::-1], late)) ** 2


def whitener_of(name: str, spectrum: np.poly1d, poles: Sequence[float] = ()) -> Whitener:
    """Whitener of a residual whose spectral factor is C / N.

    A root s of the spectrum is two zeros of z^2 - s z + 1, of which C has the inner one. The
    highest lag of sigma^2 |C|^2 has the same coefficient as r times the spectrum.

    Args:
        name: of the whitener.
        spectrum: S_v |N|^2 / r, of s = z + 1 / z: of degree 3 at most.
        poles: of N, 2 at most, 0 to 1.
    """
    s = spectrum.roots.astype(complex)
    apart = np.sqrt(s * s - 4.0)
    pairs = np.stack([0.5 * (s + apart), 0.5 * (s - apart)])
    zeros = np.where(np.abs(pairs[0]) < np.abs(pairs[1]), *pairs)
    factor, shaping = np.poly(zeros).real.tolist(), np.atleast_1d(np.poly(poles)).tolist()
    n1, n2 = (*shaping, 0.0, 0.0)[1:3]
    c1, c2, c3 = (*factor, 0.0, 0.0)[1:4]
    return Whitener(name, (n1, n2), (c1, c2, c3), float(factor[-1] / spectrum.coeffs[0]))


def _smoothed(pole: float) -> np.poly1d:
    """|1 - p z^-1|^2 as a polynomial of s = z + 1 / z."""
    return np.poly1d([-pole, 1.0 + pole * pole])


def gauss_markov(
    T: float, f_d: float, f_u: float = 0.0, tau: float = TAU, lags: int = 1
) -> Whitener:
    """Whitener of an Ornstein-Uhlenbeck moment, torque noise and gyro noise.

    Args:
        T: s between rows.
        f_d: Hz where the moment's spectrum meets that of the gyro's noise: the change of a rate
            in a step is T d, d's spectrum q_d / (omega T)^(2 m), the noise's r (omega T)^2, so that
            q_d / r = (2 pi f_d T)^(2 + 2 m).
        f_u: Hz where torque noise does: q_u / r = (2 pi f_u T)^2.
        tau: s, of the moment.
        lags: m, 1 or 2.
    """
    a = float(np.exp(-T / tau))
    rho_d, rho_u = (2.0 * np.pi * f_d * T) ** (2 + 2 * lags), (2.0 * np.pi * f_u * T) ** 2
    name = f"moment to {f_d:g} Hz" + (f", torque noise to {f_u:g} Hz" if f_u else "")
    name += f", {tau:g} s" if tau != TAU else ""
    name += " twice" if lags > 1 else ""
    # Of 1 / (1 - a z^-1) and of its square, driven by white noise.
    gain = 1.0 / (1.0 - a * a) if lags == 1 else (1.0 + a * a) / (1.0 - a * a) ** 3
    spectrum = (_smoothed(1.0) + rho_u) * _smoothed(a) ** lags + rho_d
    white = whitener_of(name, spectrum, [a] * lags)
    return replace(white, below=f_d, quick=tau < TAU, strength=gain * rho_d)


def torque_noise(T: float, f_u: float) -> Whitener:
    """Whitener of torque noise that exceeds the gyro's noise below f_u Hz, and of the latter."""
    rho_u = (2.0 * np.pi * f_u * T) ** 2
    return whitener_of(f"torque noise to {f_u:g} Hz", _smoothed(1.0) + rho_u)


def corrected(T: float, corner: float, f_u: float) -> Whitener:
    """Whitener of torque noise and of a gyro whose noise at low frequency has been corrected.

    With p = exp(-corner T), S_v |1 - p z^-1|^2 is r |1 - z^-1|^4 + q_u |1 - p z^-1|^2.

    Args:
        T: s between rows.
        corner: rad/s, below which it is.
        f_u: Hz, see `torque_noise`.
    """
    p, rho_u = float(np.exp(-corner * T)), (2.0 * np.pi * f_u * T) ** 2
    name = f"corrected to {corner:g} rad/s, torque noise to {f_u:g} Hz"
    return whitener_of(name, _smoothed(1.0) ** 2 + rho_u * _smoothed(p), [p])


def leak(T: float, memory: float) -> Whitener:
    """Whitener of gyro noise alone: rows summed up again, with a memory in s."""
    kept = float(np.exp(-T / memory))
    return Whitener(f"leak {memory:g} s", denominator=(-kept, 0.0, 0.0), gyro_share=kept)


def averaged(whitener: Whitener, b: float) -> Whitener:
    """The same for a gyro whose noise is that of 1 + b z^-1, another factor of C, of two before.

    Filters, means over the samples sent and interpolation to even steps all make neighbors alike.
    """
    c1, c2, _ = whitener.denominator
    return replace(
        whitener,
        name=f"{whitener.name}, averaged {b:g}",
        denominator=(c1 + b, c2 + b * c1, b * c2),
        gyro_share=(1.0 + b) ** 2 * whitener.gyro_share,
        b=b,
    )


NONE = Whitener("none")


def bank_for(T: float) -> tuple[Whitener, ...]:
    """Whiteners to choose from for rows of T seconds: those without disturbance first."""
    calm = [NONE, *(leak(T, memory) for memory in LEAKS), *(torque_noise(T, f) for f in WALKS)]
    return (
        *calm,
        *(averaged(whitener, b) for b in AVERAGED for whitener in calm[1:_AVERAGED]),
        *(gauss_markov(T, f) for f in DISTURBED),
        *(gauss_markov(T, f, tau=QUICK) for f in QUICKLY_DISTURBED),
        *(gauss_markov(T, f, tau=QUICK, lags=2) for f in SMOOTH),
        *(gauss_markov(T, f_d, f_u) for f_d, f_u in BOTH),
    )


def bank_for_commands(T: float) -> tuple[Whitener, ...]:
    """Whiteners for rows of commands, whose steps are too long for the fastest disturbances."""
    return (
        NONE,
        *(leak(T, memory) for memory in LEAKS),
        *(torque_noise(T, f) for f in WALKS[:3]),
        *(gauss_markov(T, f) for f in DISTURBED[:7]),
        *(gauss_markov(T, f, tau=QUICK) for f in QUICKLY_DISTURBED),
        *(gauss_markov(T, f_d, f_u) for f_d, f_u in ((4.0, 15.0), (16.0, 40.0))),
    )


def find_whiteners(wanted: Sequence[Whitener], bank: Sequence[Whitener]) -> list[int | None]:
    """Where whiteners are in a bank; None: it lacks one of that name."""
    places = {whitener.name: i for i, whitener in enumerate(bank)}
    return [places.get(whitener.name) for whitener in wanted]


def essential(whiteners: Sequence[Whitener], picked: Sequence[int]) -> list[int]:
    """Indices of the whiteners to go on with once a flight has shown what it is like.

    Those picked, what they are compared with, those for the same gyro, and some of every kind,
    should the weather change.
    """
    kept = {*picked, *(slower(whiteners, i) for i in picked)}
    means = {whiteners[i].b for i in picked} - {0.0}
    kept |= {i for i, whitener in enumerate(whiteners) if whitener.b in means}
    kept |= {i for i, whitener in enumerate(whiteners) if whitener.name in _OF_EVERY_KIND}
    return sorted(kept)


_OF_EVERY_KIND = frozenset(
    ("leak 0.3 s", "leak 1 s", "torque noise to 18 Hz", "moment to 4 Hz", "moment to 11 Hz",
     "moment to 23 Hz", "moment to 16 Hz, torque noise to 40 Hz", "moment to 11 Hz, 0.15 s")
)  # fmt: skip


def slower(whiteners: Sequence[Whitener], i: int) -> int:
    """Index of a whitener that weighs low frequencies more than the one of index i does.

    Of a disturbance, that of one up to about half its frequency; of a quick one or none a leak, the
    other one where i is a leak itself.
    """
    leaks = [k for k, w in enumerate(whiteners) if w.name.startswith("leak") and not w.b] or [i]
    short, long = leaks[0], leaks[-1]
    if not whiteners[i].disturbed or whiteners[i].quick:
        return long if i == short else short
    most = 0.6 * whiteners[i].below
    below = [k for k, w in enumerate(whiteners) if 0.0 < w.below <= most and not w.quick]
    return max(below, key=lambda k: whiteners[k].below, default=short)


class WhitenerBank:
    """Whitens rows with all whiteners at once, over each run of complete ones.

    A piece of n rows z is whitened by one product with the Toeplitz matrix of the filter's
    impulse response h, w = H z, to which the past adds the response of 1 / C to the state of the
    transposed form,

        (n1 z_(-1) + n2 z_(-2) - c1 w_(-1) - c2 w_(-2) - c3 w_(-3),
         n2 z_(-1) - c2 w_(-1) - c3 w_(-2), -c3 w_(-1)) .

    Args:
        whiteners: of the bank.
    """

    def __init__(self, whiteners: Sequence[Whitener]) -> None:
        self.whiteners = tuple(whiteners)
        n1, n2 = np.array([whitener.numerator for whitener in whiteners]).T
        c1, c2, c3 = np.array([whitener.denominator for whitener in whiteners]).T
        self._n = n1[:, None], n2[:, None]
        self._c = c1[:, None], c2[:, None], c3[:, None]
        # g: response of 1 / C; h: of (1 + n1 z^-1 + n2 z^-2) / C.
        g = np.zeros((len(n1), PIECE + 2))
        g[:, 2] = 1.0
        for k in range(2, PIECE + 1):
            g[:, k + 1] = -c1 * g[:, k] - c2 * g[:, k - 1] - c3 * g[:, k - 2]
        h = g[:, 2:] + n1[:, None] * g[:, 1:-1] + n2[:, None] * g[:, :-2]
        age = np.arange(PIECE)[:, None] - np.arange(PIECE)
        self._toeplitz = np.where(age >= 0, h[:, np.maximum(age, 0)], 0.0)
        self._past = np.stack([g[:, 2:], g[:, 1:-1], g[:, :-2]], axis=2)
        """(bank, PIECE, 3) of what the past adds to the first three rows."""
        self._carried = np.zeros((len(n1), _ORDER, _ORDER))
        """What the last rows of a piece leave of the state: row i is of its part i."""
        for i in range(_ORDER):
            for k in range(i, _ORDER):
                self._carried[:, i, _ORDER - 1 - k + i] = -self._c[k][:, 0]
        self._state: Array | None = None

    def restart(self) -> None:
        """Start from nothing: what is left undisturbed starts from nothing on both sides."""
        self._state = None

    def narrowed(self, keep: Sequence[int], columns: Sequence[int]) -> "WhitenerBank":
        """Some of the whiteners, of rows with some of the columns, from where this one stands."""
        other = WhitenerBank([self.whiteners[i] for i in keep])
        if self._state is not None:
            other._state = self._state[np.ix_(keep, range(self._state.shape[1]), columns)]
        return other

    def update(self, rows: Array) -> Array:
        """(n, width) rows to (bank, at most n, width) innovations, of the complete ones."""
        if np.isfinite(rows.sum()):
            return self._add(rows)
        complete: Mask = np.asarray(np.isfinite(rows).all(axis=1))
        out = [np.empty((len(self.whiteners), 0, rows.shape[1]))]
        for run, there in runs(complete):
            if there:
                out.append(self._add(rows[run]))
            else:
                self.restart()
        return np.concatenate(out, axis=1)

    def _add(self, rows: Array) -> Array:
        n = len(rows)
        out = np.empty((len(self.whiteners), n, rows.shape[1]))
        if self._state is None:
            self._state = np.zeros((len(self.whiteners), 3, rows.shape[1]))
        for start in range(0, n, PIECE):
            part = rows[start : start + PIECE]
            m = len(part)
            w = np.matmul(self._toeplitz[:, :m, :m], part, out=out[:, start : start + m])
            w += self._past[:, :m] @ self._state
            self._state = self._next_state(part, w)
        return out

    def _next_state(self, rows: Array, w: Array) -> Array:
        """(bank, 3, width) after a piece: its last rows, and its innovations."""
        (n1, n2), (c1, c2, c3) = self._n, self._c
        before = self._state
        assert before is not None
        last, m = rows[-1], w.shape[1]
        if m >= _ORDER:
            state = self._carried @ w[:, -_ORDER:]
            state[:, 0] += n1 * last + n2 * rows[-2]
            state[:, 1] += n2 * last
            return state
        zero = np.zeros_like(w[:, 0])
        # State i after a row: n_i z - c_i w + state i + 1 before it.
        second = before[:, 2] if m == 1 else -c3 * w[:, -2]
        first = n2 * rows[-2] - c2 * w[:, -2] + before[:, 2] if m == 2 else before[:, 1]
        return np.stack(
            [
                n1 * last - c1 * w[:, -1] + first,
                n2 * last - c2 * w[:, -1] + second,
                -c3 * w[:, -1] + zero,
            ],
            axis=1,
        )


@dataclass(frozen=True)
class WhitenedMoments:
    """Moments of rows of elements under every whitener of a bank, batch by batch.

    Attributes:
        parts: arrays of (k, bank, width, width), in time order; views, not to be written to.
        counts: (k,) rows in each batch of all parts.
        noise: (bank, width, width) known noise of the inputs in one row.
        whiteners: of the bank.
        time: s, T of a row.
        grouped: rows that a batch should have before its score counts as one.
        gains: (bank,) variance of a row over that of white noise of the gyro, where rows are the
            window's, which share samples; None: they are of one step.
        muted: columns that are taken as zero.
        likeliest: of each axis, that of the whole record, and no other axis takes it: innovations
            are as white as they can be, and rows count by how strong these are in their batch.
            Empty: the flight may go on.
        judges: of each axis, those used for how much of the motion is explained and predicted: of
            offline estimates the online one's, with which its bounds were found; of rows of the
            window no leak. Empty: those of the fit.
        weights: (k,) of each batch's moments; None: all are alike.
    """

    parts: tuple[Array, ...]
    counts: NDArray[np.int64]
    noise: Array
    whiteners: tuple[Whitener, ...]
    time: float
    grouped: int
    gains: Array | None = None
    muted: tuple[int, ...] = ()
    likeliest: tuple[int, ...] = ()
    judges: tuple[int, ...] = ()
    weights: Array | None = None
    _latest: dict[tuple[int, ...], Array] = field(init=False, default_factory=dict, repr=False)
    """Of the axes asked for last, which are asked for again and again."""

    @property
    def of_steps(self) -> bool:
        """Whether rows are of one step."""
        return self.gains is None

    @property
    def is_whole(self) -> bool:
        """Whether the flight is over, and its likeliest whiteners are known."""
        return bool(self.likeliest)

    @property
    def edges(self) -> NDArray[np.int64]:
        """Index of each part's first batch, and of the end."""
        return np.cumsum([0, *(len(part) for part in self.parts)])

    @property
    def motion(self) -> Array:
        """(k,) share of the whole that each batch has of the angular acceleration's power, mean of
        whiteners and axes.
        """
        power = np.concatenate([np.einsum("kbii->kbi", part)[..., -3:] for part in self.parts])
        return (power / np.maximum(power.sum(axis=0), 1e-300)).mean(axis=(1, 2))

    def total(self, kept: Mask) -> Array:
        """(bank, width, width) sum over the batches kept."""
        out = np.zeros(self.noise.shape)
        weights = kept.astype(float) if self.weights is None else kept * self.weights
        for part, start in zip(self.parts, self.edges[:-1], strict=True):
            out += np.tensordot(weights[start : start + len(part)], part, 1)
        return self._mute(out)

    @property
    def summed(self) -> Self:
        """The same in one batch."""
        total = self.total(np.ones(len(self.counts), dtype=bool))[None]
        counts = self.counts.sum(keepdims=True)
        return replace(self, parts=(total,), counts=counts, weights=None)

    def under(self, some: Sequence[int]) -> Self:
        """The same with some of the whiteners alone; of a single one, views."""
        at = _places(some)
        return replace(
            self,
            parts=tuple(part[:, at] for part in self.parts),
            noise=self.noise[at],
            whiteners=tuple(self.whiteners[i] for i in some),
            gains=None if self.gains is None else self.gains[at],
            judges=(),
        )

    def places(self, whiteners: Sequence[Whitener]) -> list[int]:
        """Where whiteners are in the bank."""
        return [self.whiteners.index(whitener) for whitener in whiteners]

    def of_axes(self, pick: Sequence[int]) -> Array:
        """(k, 3, width, width) of each axis' whitener; not to be written to.

        (k, 1, ...) where that is one and the same.
        """
        key = tuple(pick)
        if key not in self._latest:
            self._latest.clear()
            self._latest[key] = self._of_axes(key if len(set(key)) > 1 else key[:1])
        return self._latest[key]

    def _of_axes(self, pick: tuple[int, ...]) -> Array:
        some = [part[:, _places(pick)] for part in self.parts]
        every = some[0] if len(some) == 1 else np.concatenate(some)
        if self.weights is not None:
            every = every * self.weights[:, None, None, None]
        return self._mute(every.copy() if self.muted else every)

    def weighed(self, power: Array) -> Self:
        """The same, where rows of a batch count by the inverse of its innovations' power.

        Gusts and propeller wash come and go: the likelihood of innovations whose variance changes
        from batch to batch. A batch with weight w counts as w times its rows. Of how far logarithms
        of powers scatter, a part is chance, 2 / n of n innovations: they are shrunk by that.

        Args:
            power: (k,) of the innovations in each batch, relative to the median: of three axes.
        """
        chance = 2.0 / 3.0 * float(np.mean(1.0 / np.maximum(self.counts, 1)))
        spread = max(float(np.var(np.log(np.maximum(power, 1e-300)))), 1e-300)
        power = power ** max(0.0, 1.0 - chance / spread)
        weights = 1.0 / np.maximum(power, 1.0 / MOST_WEIGHT)
        weights *= self.counts.sum() / float(weights @ self.counts)
        counts = np.maximum(np.round(weights * self.counts), 1).astype(np.int64)
        # Known noise of the inputs is stronger where innovations are, too.
        share = float(counts @ power / counts.sum() / (self.counts @ power / self.counts.sum()))
        weights = counts / np.maximum(self.counts, 1)
        return replace(self, counts=counts, weights=weights, noise=share * self.noise)

    def _mute(self, moments: Array) -> Array:
        if not self.muted:
            return moments
        columns = list(self.muted)
        moments[..., columns, :] = 0.0
        moments[..., :, columns] = 0.0
        return moments


def _places(some: Sequence[int]) -> slice | list[int]:
    """An index of some whiteners; of a single one, for a view."""
    return slice(some[0], some[0] + 1) if len(some) == 1 else list(some)


def joined(values: Array, counts: NDArray[np.int64], least: int) -> Array:
    """(g, ...) sums of (k, ...) values over batches joined until each has so many rows."""
    starts, size = [0], 0
    for i, count in enumerate(counts):
        if size >= least:
            starts.append(i)
            size = 0
        size += int(count)
    return np.add.reduceat(values, starts, axis=0)
