"""The record of whitened rows of a flight, in bounded memory.

The last quarter-minute is kept in batches of a quarter of a second, so that a shock can be
separated from its surroundings and left out. When these batches fill up, the older half is judged
by a fit to all of them, which no other fit of the flight influences, and what is sound joins longer
batches. Their number is fixed; as they fill up, neighbors are merged.
"""

from collections.abc import Callable, Sequence

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.priors import Unknown
from gcs_sysid.estimation.fit.whitened_fit import ShockReference, shocks_in
from gcs_sysid.estimation.fit.whitener_choice import BankProblem
from gcs_sysid.estimation.noise.whitening import (
    WhitenedMoments,
    Whitener,
    WhitenerBank,
    essential,
    find_whiteners,
)
from gcs_sysid.estimation.rows.actuator_dynamics import BODY, SIGNALS, ActuatorDynamics
from gcs_sysid.estimation.rows.regression import NormalEquations
from gcs_sysid.signals.one_step import OneStep

SHORT = 0.25
"""s, of the batches in which shocks are found."""
_RECENT = 40
_LONG = 64
"""Batches that are kept apart; an even number."""
_AT_ONCE = 256
"""Rows whitened at a time."""
_LEARNED = 60.0
"""s of flight, after which it is known what whiteners and delays are needed."""
_DELAYS = 4
"""Delays kept then: the one found lies between them."""
_RUNG_OUT = 6.0
"""s after which a whitener's response has."""


class WhitenedRecord:
    """Rows of elements in, moments of whitened rows out.

    Args:
        basis: of the elements.
        step: that made the rows.
        whiteners: of the bank.
        dt: s between samples.
        batch_time: s, of long batches.
        judged: which short batches hold shocks, as far as rows of the same samples have shown it.
    """

    def __init__(
        self,
        basis: ActuatorDynamics,
        step: OneStep,
        whiteners: Sequence[Whitener],
        dt: float,
        batch_time: float,
        judged: Sequence[bool] = (),
    ) -> None:
        self.basis = basis
        self.time = step.time
        self.whiteners = tuple(whiteners)
        self._step, self._dt = step, dt
        self._bank = WhitenerBank(whiteners)
        shape = (len(self.whiteners), basis.width, basis.width)
        self._per_short = max(round(SHORT / step.time), 1)
        self._per_long = max(round(batch_time / step.time), 1)
        self._long = NormalEquations(shape, self._per_long, _LONG)
        self._recent = np.zeros((_RECENT, *shape))
        """Those without rows hold anything."""
        self._counts = np.zeros(_RECENT, dtype=np.int64)
        self._full = 0
        self._overlaps: Array | None = None
        self._delays = list(range(len(basis.delays)))
        """Which of the step's each of the basis' delays is."""
        self._columns: list[int] | None = None
        """Those taken of the rows; None: all."""
        self._narrows = not basis.motors
        self.narrowed = False
        """Whether whiteners and delays are fewer than at first: their numbers changed."""
        self._reference: ShockReference | None = None
        self._known, self.judged = judged, list[bool]()
        """Which short batches hold shocks: of rows of the same samples, and so far."""
        self.total = np.zeros(shape)
        """(bank, width, width) sum over all rows, shocks included; not to be written to."""
        self.rows = 0
        """In them."""

    def reserve(self) -> None:
        """Have all memory now that a long flight will need."""
        self._long.reserve()
        self._recent[self._begun :] = 0.0

    def restart(self) -> None:
        """A gap: what comes next does not join on to what came before."""
        self._bank.restart()

    def add(self, rows: Array, noise: Callable[[], Array]) -> None:
        """Add (n, width) rows, in time order; those that are not complete are left out.

        Args:
            rows: as `OneStep` makes them, of elements.
            noise: gives the input noise in one row, (bank, width, width), as known by now.
        """
        for start in range(0, len(rows), _AT_ONCE):
            some = rows[start : start + _AT_ONCE]
            white = self._bank.update(some if self._columns is None else some[:, self._columns])
            done, n = 0, white.shape[1]
            while done < n:
                if self._full == _RECENT:
                    self._settle(noise())
                    learned = self.rows * self.time >= _LEARNED
                    if self._narrows and self._columns is None and learned:
                        white = self._narrow(white, noise())
                room = self._per_short - int(self._counts[self._full])
                part = white[:, done : done + room]
                turned, recent = np.swapaxes(part, 1, 2), self._recent[self._full]
                if self._counts[self._full]:
                    products = turned @ part
                    recent += products
                else:
                    products = np.matmul(turned, part, out=recent)
                self.total += products
                self._counts[self._full] += part.shape[1]
                self.rows += part.shape[1]
                done += part.shape[1]
                self._full += int(self._counts[self._full] == self._per_short)

    def moments(self, noise: Array) -> WhitenedMoments:
        """All that is kept, for a fit; views of it."""
        recent = self._begun
        return WhitenedMoments(
            (self._long.batches, self._recent[:recent]),
            np.concatenate([self._long.counts, self._counts[:recent]]),
            noise,
            self.whiteners,
            self.time,
            self._per_short,
        )

    def places(self, whiteners: Sequence[Whitener]) -> list[int]:
        """Where whiteners are in the bank; of those that were given up, where the first leak is."""
        first = next(i for i, own in enumerate(self.whiteners) if own.name == "leak 0.3 s")
        return [first if i is None else i for i in find_whiteners(whiteners, self.whiteners)]

    def gyro_densities(self, whiteners: Sequence[Whitener]) -> Array:
        """(3,) density of the gyro's noise over the power of an innovation."""
        # Without a whitener the gyro's part is unknown: half of a change, at most.
        return np.array([whitener.gyro_share or 0.5 for whitener in whiteners]) * self.time**3

    @property
    def silence(self) -> Array:
        """(bank, width, width) of inputs without noise."""
        return np.zeros((len(self.whiteners), self.basis.width, self.basis.width))

    @property
    def batches(self) -> int:
        """How many long batches' worth of rows have come."""
        return self.rows // self._per_long

    def forget_last(self, seconds: float) -> None:
        """Leave out at least the last `seconds` of the record (whole batches)."""
        rows = int(np.ceil(seconds / self.time))
        dropped = 0
        while dropped < rows and self._begun:
            last = self._begun - 1
            dropped += int(self._counts[last])
            self._counts[last] = 0
            self._full = last
        if dropped < rows:
            self._long.drop_last(rows - dropped)
        self.total = self._long.total + self._recent[: self._begun].sum(axis=0)
        self.rows = self._long.rows + int(self._counts.sum())

    @property
    def _begun(self) -> int:
        return self._full + int(self._full < _RECENT and self._counts[self._full] > 0)

    def _settle(self, noise: Array) -> None:
        """Make room: what is sound of the older half joins the long batches."""
        half, done = _RECENT // 2, len(self.judged)
        shocks = self._known[done : done + half]
        if len(shocks) < half:
            known = WhitenedMoments(
                (self._recent,), self._counts, noise, self.whiteners, self.time, self._per_long
            )
            # Early fits are poor, and what is narrowed to rests on the latest. Records of commands
            # are made again, and never narrowed.
            quick = self._columns is not None or self.basis.motors
            found, self._reference = shocks_in(known, self.basis, self._reference, quick=quick)
            shocks = found[:half].tolist()
        self.judged += shocks
        for i in range(half):
            if not shocks[i]:
                self._long.add_sum(self._recent[i], int(self._counts[i]))
        self._recent[:half], self._counts[:half] = self._recent[half:], self._counts[half:]
        self._counts[half:] = 0
        self._full = half

    def _narrow(self, white: Array, noise: Array) -> Array:
        """Go on with fewer whiteners, and with the delays about the one found.

        Most of the cost of a long flight is for whiteners and delays that it does not need.

        Args:
            white: (bank, n, width) innovations that were made with all of them.
            noise: that of the inputs in one row.

        Returns:
            Those that go on.
        """
        # By all of the record: a fit to the first or the last quarter-minute may be a poor one, and
        # what it gives up is gone.
        whole = BankProblem(self.moments(noise), self.basis).fitted()
        if whole is None:
            return white
        unknowns = whole.point.unknowns[0]
        keep = essential(self.whiteners, (*whole.pick, *whole.trial.pick))
        away = np.abs(self.basis.delays - unknowns[Unknown.DELAY])
        delays = np.sort(np.argsort(away, kind="stable")[:_DELAYS])
        rotors = np.arange(self.basis.width - BODY).reshape(-1, SIGNALS)[delays].ravel()
        columns = [*rotors.tolist(), *range(self.basis.width - BODY, self.basis.width)]
        self.basis = ActuatorDynamics(self.basis.delays[delays], half_width=None, dt=self._dt)
        self._delays, self._columns, self._overlaps = delays.tolist(), columns, None
        self.whiteners = tuple(self.whiteners[i] for i in keep)
        self._bank = self._bank.narrowed(keep, columns)
        self._long = self._long.narrowed(keep, columns)
        some = np.ix_(keep, columns, columns)
        self._recent = np.stack([batch[some] for batch in self._recent])
        self.total = self.total[some]
        pick = tuple(keep.index(i) for i in whole.pick)
        self._reference = ShockReference(unknowns, pick, whole.point.variance[0])
        self.narrowed = True
        return white[np.ix_(keep, range(white.shape[1]), columns)]

    def noise(self, covariance: Array, some: Sequence[int] | None = None) -> Array:
        """(bank, width, width) what white noise of measured speeds adds to one row of elements.

        Args:
            covariance: (5, 5) of roll, pitch, thrust, yaw and H of a sample.
            some: whiteners; None: all.
        """
        if self._overlaps is None:
            self._overlaps = self._overlapping()
        overlaps = self._overlaps if some is None else self._overlaps[list(some)]
        of_average, of_both, of_slope = np.zeros((3, SIGNALS, SIGNALS))
        of_average[:4, :4], of_both[4, :4] = covariance[:4, :4], covariance[4, :4]
        of_slope[4, 4] = covariance[4, 4]
        n = self.basis.width - BODY
        mixed = overlaps[:, 1]
        signals = sum(
            np.einsum("bxy,ij->bxiyj", overlap, of_signals)
            for overlap, of_signals in (
                (overlaps[:, 0], of_average),
                (mixed, of_both.T),
                (np.swapaxes(mixed, 1, 2), of_both),
                (overlaps[:, 2], of_slope),
            )
        )
        out = np.zeros((len(overlaps), self.basis.width, self.basis.width))
        out[:, :n, :n] = np.reshape(signals, (len(overlaps), n, n))
        return out

    def _overlapping(self) -> Array:
        """(bank, 3, delays, delays) of elements' responses to a sample, whitened.

        Averages with averages, averages with derivatives, derivatives with derivatives.
        """
        h, n = self._step.step, len(self._delays)
        taps = np.stack([self._step.late_taps, self._step.late_slopes])[:, self._delays]
        room = int(np.ceil(_RUNG_OUT / self._dt))
        driven = np.zeros(((taps.shape[2] + room) // h * h, 2, n))
        driven[: taps.shape[2]] = np.moveaxis(taps, 2, 0)
        out = np.zeros((len(self.whiteners), 3, n, n))
        for phase in range(h):
            rows = driven[phase::h].reshape(-1, 2 * n)
            bank = WhitenerBank(self.whiteners)
            for start in range(0, len(rows), _AT_ONCE):
                white = bank.update(rows[start : start + _AT_ONCE])
                both = (np.swapaxes(white, 1, 2) @ white).reshape(len(out), 2, n, 2, n)
                out[:, 0] += both[:, 0, :, 0]
                out[:, 1] += both[:, 0, :, 1]
                out[:, 2] += both[:, 1, :, 1]
        return out
