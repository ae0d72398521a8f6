"""Moments of whitened rows, batch by batch, as a record hands them to a fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.noise.whitening import Whitener

_MOST_WEIGHT = 3.0
"""Of a batch whose innovations are weak, by chance or because nothing moved."""


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
        muted: columns that are taken as zero.
        own: places of the likeliest of the whole record, of each axis, which no other axis takes.
            Their innovations are as white as they can be, and rows count by how strong these are in
            their batch. Empty: there is none.
        judges: of each axis, those of the online estimate, used for how much of the motion is
            explained and predicted: its bounds were found with them.
    """

    parts: tuple[Array, ...]
    counts: NDArray[np.int64]
    noise: Array
    whiteners: tuple[Whitener, ...]
    time: float
    grouped: int
    muted: tuple[int, ...] = ()
    own: tuple[int, ...] = ()
    judges: tuple[int, ...] = ()

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
        share: Array = (power / np.maximum(power.sum(axis=0), 1e-300)).mean(axis=(1, 2))
        return share

    def total(self, kept: Mask) -> Array:
        """(bank, width, width) sum over the batches kept."""
        out = np.zeros(self.noise.shape)
        for part, start in zip(self.parts, self.edges[:-1], strict=True):
            weights = kept[start : start + len(part)].astype(float)
            out += np.tensordot(weights, part, 1)
        return self._mute(out)

    def of_axes(self, pick: Sequence[int]) -> Array:
        """(k, 3, width, width) of each axis' whitener."""
        some = [part[:, list(pick)] for part in self.parts]
        return self._mute(some[0] if len(some) == 1 else np.concatenate(some))

    def weighed(self, power: Array) -> "WhitenedMoments":
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
        weights = 1.0 / np.maximum(power, 1.0 / _MOST_WEIGHT)
        weights *= self.counts.sum() / float(weights @ self.counts)
        counts = np.maximum(np.round(weights * self.counts), 1).astype(np.int64)
        share = counts / np.maximum(self.counts, 1)
        starts = self.edges[:-1]
        parts = tuple(
            part * share[start : start + len(part), None, None, None]
            for part, start in zip(self.parts, starts, strict=True)
        )
        return replace(self, parts=parts, counts=counts)

    def _mute(self, moments: Array) -> Array:
        if not self.muted:
            return moments
        columns = list(self.muted)
        moments[..., columns, :] = 0.0
        moments[..., :, columns] = 0.0
        return moments


def grouped(
    batches: Array, counts: NDArray[np.int64], least: int
) -> tuple[Array, NDArray[np.int64]]:
    """Batches joined until each has so many rows."""
    starts, size = [0], 0
    for i, count in enumerate(counts):
        if size >= least:
            starts.append(i)
            size = 0
        size += int(count)
    if len(starts) == len(batches):
        return batches, counts.copy()
    out = np.empty((len(starts), *batches.shape[1:]))
    for joined, start, stop in zip(out, starts, [*starts[1:], len(batches)], strict=True):
        batches[start:stop].sum(axis=0, out=joined)
    return out, np.add.reduceat(counts, starts)
