"""Missing IMU samples, by the vehicle's own stamps.

Sequence numbers count modulo 256, so that a burst of any length looks like a short one, and they do
not show what the autopilot never sent: PX4 skips 0.4 to 2 % of its samples with no packet lost.
Stamps show both: steps of several usual intervals have samples missing in them.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from gcs_sysid.arrays import Array


class Counts(NamedTuple):
    """What came, and what did not."""

    received: int = 0
    missing: int = 0
    longest: float = 0.0
    """s, the longest step with samples missing in it."""

    @property
    def share(self) -> float:
        """`missing` as a part of what was to come."""
        return self.missing / max(self.received + self.missing, 1)


class ImuLoss:
    """Counts samples by their stamps.

    Steps are compared with the shortest interval that some samples in a row have kept. A stream
    that comes evenly at another rate has another one. The counts depend on the order of samples
    alone, however they are cut into blocks; what is late by less than half of `_HELD` is not lost.
    """

    PAUSE = 10.0
    """s. A longer step is no loss: the link was away, or the vehicle's clock was set."""
    _HELD, _SETTLED = 512, 256
    """Samples that wait for late ones, and how many of them are settled then."""
    _AT_ONCE = 2048
    """Samples settled together."""
    _FEW = 8
    """Steps in a row, the shortest mean of which is the interval: half of all samples may be lost,
    and still some of so many are not. One step is not enough: stamps jitter, and ArduPilot sends by
    turns after 2.5 and 5 ms."""
    _CALM, _ALIKE = 64, 1.2
    """Steps in a row whose means over `_FEW` all lie within that ratio: a stream without losses."""
    _CHANGED = 1.5
    """Ratio of intervals that makes another rate."""

    def __init__(self) -> None:
        self._counts = Counts()
        self._held = np.empty(0)
        self._before = np.empty(0)  # the last that are settled
        self._interval = 0.0

    def add_times(self, t: Array) -> None:
        """Take (n,) times of samples, s, in the order in which they came."""
        while len(t):
            room = self._rising(t) if len(t) >= self._HELD else 0
            if room:
                # One settling for many: of those that all come in order nothing is sorted out.
                self._held, t = np.append(self._held, t[:room]), t[room:]
                self._settle(len(self._held) - self._HELD + self._SETTLED)
                continue
            room = self._HELD - len(self._held)
            self._held, t = np.append(self._held, t[:room]), t[room:]
            if len(self._held) == self._HELD:
                self._held = self._new()
                if len(self._held) == self._HELD:
                    self._settle(self._SETTLED)

    def _rising(self, t: Array) -> int:
        """How many of (n,) times to settle together: a multiple of what is settled at a time."""
        most = min(len(t), self._AT_ONCE) + len(self._held)
        count = self._HELD + (most - self._HELD) // self._SETTLED * self._SETTLED
        room = count - len(self._held)
        times = np.concatenate([self._before[-1:], self._held, t[:room]])
        return room if bool((times[1:] > times[:-1]).all()) else 0

    def restart(self) -> None:
        """The clock has gone back: later samples are not compared with earlier ones."""
        self._settle(len(self._held))
        self._before, self._interval = np.empty(0), 0.0

    @property
    def counts(self) -> Counts:
        """Of all that came so far."""
        t = self._new()
        return self._counted(t, len(t))[0]

    def as_dict(self) -> dict[str, Any]:
        """For the result's `telemetry`."""
        counts = self.counts
        return {
            "received": counts.received,
            "missing": counts.missing,
            "missing_percent": 100.0 * counts.share,
            "longest": counts.longest,
        }

    def _settle(self, count: int) -> None:
        t = self._new()
        count = min(count, len(t))
        self._counts, self._interval = self._counted(t, count)
        self._before = np.append(self._before, t[:count])[-self._CALM :]
        self._held = t[count:]

    def _new(self) -> Array:
        """(n,) rising times held, without those that came twice, or too late."""
        t = np.unique(self._held)
        return t[t > self._before[-1]] if len(self._before) else t

    def _counted(self, t: Array, count: int) -> tuple[Counts, float]:
        """The counts with the first so many of (n,) rising times, and the interval then."""
        before = self._before
        counts = self._counts._replace(received=self._counts.received + count)
        times = np.concatenate([before, t])
        at, end = max(len(before) - 1, 0), len(before) + count - 1
        if end <= at or len(times) <= self._FEW:
            return counts, self._interval
        steps = np.diff(times)
        # Of the steps that begin with each: mean of a few, and where they are calm, of more.
        few = (times[self._FEW :] - times[: -self._FEW]) / self._FEW
        calm = np.full(len(few), np.nan)
        if len(steps) >= self._CALM:
            runs = sliding_window_view(few, self._CALM - self._FEW + 1)
            even = runs.max(axis=1) < self._ALIKE * runs.min(axis=1)
            calm[: len(runs)] = np.where(even, runs.mean(axis=1), np.nan)
        interval = self._interval or float(few[min(at, len(few) - 1)])
        missing, longest = counts.missing, counts.longest
        # Those that are settled together are compared with one interval.
        settled = (
            range(len(before) + self._SETTLED - 1, end, self._SETTLED)
            if count >= self._HELD
            else ()
        )
        for stop_at in (*settled, end):
            while at < stop_at:
                here = slice(at, stop_at)
                changed = (calm[here] > self._CHANGED * interval) | (
                    few[here] < interval / self._CHANGED
                )
                stop = at + int(np.argmax(changed)) if changed.any() else stop_at
                if stop == at:
                    stop, interval = at + 1, float(few[at] if np.isnan(calm[at]) else calm[at])
                interval = float(few[at:stop].min(initial=interval))
                ratio = np.round(steps[at:stop] / interval)
                lost = (ratio > 1.0) & (steps[at:stop] <= self.PAUSE)
                missing += int((ratio[lost] - 1.0).sum())
                longest = max(longest, float(steps[at:stop][lost].max(initial=0.0)))
                at = stop
        return Counts(counts.received, missing, longest), interval
