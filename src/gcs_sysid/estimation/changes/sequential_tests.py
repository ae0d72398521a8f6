"""Sequential tests on normalized residuals, and the levels that normalize them."""

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.signals.recursions import lfilter

CLIPPED = 4.0
"""Noise levels, from which on a value does not move mean and level further."""


class Cusum:
    """Two-sided cumulative-sum tests on several channels.

    Args:
        channels: how many.
        allowance: what a value may deviate without being counted.
        clip: what a value counts at most, so that an outlier alone cannot alarm.
        threshold: of the sum.
    """

    def __init__(self, channels: int, allowance: float, clip: float, threshold: float) -> None:
        self.allowance, self.clip, self.threshold = allowance, clip, threshold
        self._sum = np.zeros((channels, 2))
        self._began = np.zeros((channels, 2), dtype=np.int64)

    @property
    def rising(self) -> Mask:
        """(channels,) where a sum is above zero."""
        return np.asarray(self._sum.any(axis=1))

    def clear(self) -> None:
        """Forget all sums."""
        self._sum[:] = 0.0

    def update(self, values: Array, first: int) -> tuple[int, int, int] | None:
        """Take (n, channels) values, NaN: no news; stops at the first alarm.

        Args:
            values: in noise levels.
            first: index of the first row.

        Returns:
            Row of the alarm, its channel, and the index at which the sum left zero.
        """
        beyond = np.abs(values) > self.allowance  # never, where nothing is there
        if not beyond.any() and not self._sum.any():
            return None
        best: tuple[int, int, int] | None = None
        for c in range(values.shape[1]):
            if not beyond[:, c].any() and not self._sum[c].any():
                continue
            for side, sign in enumerate((1.0, -1.0)):
                alarm = self._run(sign * values[:, c], first, c, side)
                if alarm is not None and (best is None or alarm[0] < best[0]):
                    best = alarm
        return best

    def _run(self, values: Array, first: int, c: int, side: int) -> tuple[int, int, int] | None:
        total, began = float(self._sum[c, side]), int(self._began[c, side])
        for i, value in enumerate(values.tolist()):
            if value != value:
                continue
            if total == 0.0:
                began = first + i
            total = max(total + min(value, self.clip) - self.allowance, 0.0)
            if total > self.threshold:
                return i, c, began
        self._sum[c, side], self._began[c, side] = total, began
        return None


class Level:
    """Running mean and noise level of several channels, moved by whole frames."""

    def __init__(self, channels: int, least_gain: float) -> None:
        self.mean = np.zeros(channels)
        self.variance = np.zeros(channels)
        self.frames = np.zeros(channels, dtype=np.int64)
        self._least_gain = least_gain

    def forget(self, which: Mask) -> None:
        """Restart on some channels."""
        self.frames[which] = 0

    def update(self, frame: Array, floor: Array) -> None:
        """Take a frame (n, channels); a channel with less than half of it present is held."""
        if np.isfinite(frame.sum()) and self.frames.all():
            self._learn(
                frame, len(frame), np.maximum(1.0 / (self.frames + 1), self._least_gain), floor
            )
            self.frames += 1
            return
        there = np.isfinite(frame)
        count = there.sum(axis=0)
        enough = 2 * count > len(frame)
        for c in np.flatnonzero(enough & (self.frames == 0)):
            e = frame[there[:, c], c]
            self.mean[c] = np.median(e)
            # Rough: the frames that follow in the warm-up outweigh it.
            self.variance[c] = max((1.5 * np.median(np.abs(e - self.mean[c]))) ** 2, 1e-12)
        share = np.where(enough, np.maximum(1.0 / (self.frames + 1), self._least_gain), 0.0)
        self._learn(np.where(there, frame, self.mean), np.maximum(count, 1), share, floor)
        self.frames += enough

    def _learn(self, frame: Array, count: Array | int, gain: Array, floor: Array) -> None:
        """Move towards a frame without gaps; what is far off counts less."""
        limit = CLIPPED * np.maximum(np.sqrt(self.variance), floor)
        d = np.minimum(np.maximum(frame - self.mean, -limit), limit)
        self.mean += gain * (d.sum(axis=0) / count)
        self.variance += gain * (np.einsum("nc,nc->c", d, d) / count - self.variance)

    def move(self, mean: Array, square: Array) -> None:
        """Take a frame without gaps, of which nothing is clipped, on channels with frames before.

        Args:
            mean: (channels,) of its values.
            square: (channels,) of their squares.
        """
        gain = np.maximum(1.0 / (self.frames + 1), self._least_gain)
        scatter = square - self.mean * (2.0 * mean - self.mean)
        self.mean += gain * (mean - self.mean)
        self.variance += gain * (scatter - self.variance)
        self.frames += 1

    def std(self, floor: Array) -> Array:
        """(channels,) noise level, at least the floor."""
        return np.maximum(np.sqrt(self.variance), floor)


class RecentMean:
    """What a signal was just before each sample: an exponential mean of the samples until then.

    Args:
        channels: how many.
        memory: in samples.
    """

    def __init__(self, channels: int, memory: float) -> None:
        self.last = np.full(channels, np.nan)
        self._keep = float(np.exp(-1.0 / memory))
        self._of: tuple[Array, Array] = np.empty((1, 0)), np.ones((1, 1))
        """Baselines from (n, channels) values and the baseline before them: (n + 1, n) weights and
        (n + 1, 1), for the latest n."""

    def ahead(self, values: Array) -> Array:
        """(n + 1, channels) the baseline before each of the values and after them; not taken yet.

        Args:
            values: (n, channels), none of which is clipped.
        """
        keep = self._keep
        filtered, _ = lfilter([1.0 - keep], [1.0, -keep], values, keep * self.last[None])
        return np.concatenate([self.last[None], filtered])

    def update(self, values: Array, low: Array, high: Array) -> Array:
        """(n, channels) the baseline before each of the values; NaN values are passed over.

        Args:
            values: (n, channels).
            low: (channels,) values count as no less than this: an outlier moves little.
            high: (channels,) nor as more than this.
        """
        keep = self._keep
        weights = [1.0 - keep], [1.0, -keep]
        if np.isfinite(values.sum()) and np.isfinite(self.last.sum()):
            clipped = np.minimum(np.maximum(values, low), high)
            if len(values) != len(self._of[0]) - 1:
                self._of = self._weights(len(values))
            weight, kept = self._of
            whole: Array = weight @ clipped + kept * self.last
            self.last = whole[-1].copy()
            return whole[:-1]
        before = np.full_like(values, np.nan)
        for c in range(values.shape[1]):
            there = np.isfinite(values[:, c])
            v = np.clip(values[there, c], low[c], high[c])
            if not len(v):
                continue
            if np.isnan(self.last[c]):
                self.last[c] = v[0]
            filtered, _ = lfilter(*weights, v, keep * self.last[c : c + 1])
            before[there, c] = np.append(self.last[c], filtered[:-1])
            self.last[c] = filtered[-1]
        return before

    def _weights(self, n: int) -> tuple[Array, Array]:
        age = np.arange(n + 1)[:, None] - np.arange(n) - 1
        weight = (1.0 - self._keep) * np.where(age >= 0, self._keep ** np.maximum(age, 0), 0.0)
        return weight, self._keep ** np.arange(n + 1.0)[:, None]
