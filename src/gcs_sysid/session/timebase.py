"""One time base: streams with their own stamps and rates, brought to one uniform grid.

The grid runs on the vehicle's clock at the IMU's own rate. A grid point is given out a fixed
lag behind the newest IMU stamp, so that the outcome depends on the order of the records alone,
never on when they happened to be read. Between samples a cubic through the four nearest is
taken; where a stream has a gap its values are marked as missing.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.records import Record, Stream

Key = tuple[Stream, str, int]
"""Stream, source, first rotor."""

STEP_SAMPLES = 64
"""IMU samples from which the grid's step is taken."""
_KEEP = 8
"""Samples of each stream kept behind the grid for interpolation."""
_SAME = 5e-7
"""Times closer than this (s) are the same: stamps are whole microseconds."""
_BREAK = 1.0
"""An IMU silence longer than this (s), or a step back in time by more, starts the grid anew."""
_SAME_RATE = 0.1
"""Relative change of the IMU's interval that a pause may bring without a new grid step."""
_MOST = 4096
"""Samples of each stream kept while no grid takes them (an IMU that is silent)."""


@dataclass(frozen=True)
class Block:
    """Consecutive grid points with every stream's values.

    Attributes:
        t: (n,) s, vehicle clock, uniform.
        values: stream key -> (n, width), NaN where missing.
    """

    t: Array
    values: dict[Key, Array]
    fresh: bool = False
    """Whether the grid started anew: nothing before this block joins on to it."""


class StreamBuffer:
    """Recent samples of one stream, in strictly rising time."""

    def __init__(self, width: int, *, hold: bool = False) -> None:
        self.width = width
        self.hold = hold
        """Whether the last value holds (states) instead of being interpolated (signals)."""
        self.repeated = 0
        """Samples dropped because their stamp was not newer."""
        self._t: deque[float] = deque(maxlen=_MOST)
        self._values: deque[tuple[float, ...]] = deque(maxlen=_MOST)
        self._steps: deque[float] = deque(maxlen=STEP_SAMPLES)

    def push(self, t: float, values: tuple[float, ...]) -> None:
        """Add a sample; one whose stamp is not newer than the last is dropped."""
        if self._t:
            step = t - self._t[-1]
            if step <= 0.0:
                self.repeated += 1
                return
            self._steps.append(step)
        self._t.append(t)
        self._values.append(values)

    @property
    def is_steady(self) -> bool:
        """Whether enough samples came to know the interval."""
        return len(self._steps) >= STEP_SAMPLES - 1

    @property
    def oldest(self) -> float:
        """Time of the oldest sample kept."""
        return self._t[0]

    @property
    def interval(self) -> float:
        """Usual time between samples in s (median); 0 until two samples came."""
        return float(np.median(self._steps)) if self._steps else 0.0

    def at(self, grid: Array) -> Array:
        """(n, width) values at the grid times, NaN where the stream has a gap."""
        if not self._t:
            return np.full((len(grid), self.width), np.nan)
        t = np.array(self._t)
        v = np.array(self._values)
        if self.hold:
            index = np.searchsorted(t, grid + _SAME, side="right") - 1
            return np.where(index[:, None] >= 0, v[np.maximum(index, 0)], np.nan)
        return interpolate(t, v, grid, gap=max(2.6 * self.interval, 0.03))

    def forget_before(self, t: float) -> None:
        """Drop what no later grid point needs."""
        while len(self._t) > _KEEP and self._t[_KEEP] < t:
            self._t.popleft()
            self._values.popleft()


def interpolate(t: Array, v: Array, grid: Array, gap: float) -> Array:
    """Cubic interpolation through the four nearest samples (Lagrange, any spacing).

    Args:
        t: (m,) rising sample times.
        v: (m, width) samples.
        grid: (n,) times wanted.
        gap: samples further apart than this have nothing between them.

    Returns:
        (n, width), NaN outside the samples and inside gaps. Next to a gap or an end the two
        neighbours alone are used.
    """
    out = np.full((len(grid), v.shape[1]), np.nan)
    if len(t) < 2:
        return out
    right = np.clip(np.searchsorted(t, grid, side="left"), 1, len(t) - 1)
    left = right - 1
    inside = (grid >= t[left]) & (grid <= t[right])
    inside &= t[right] - t[left] <= gap
    u = (grid - t[left]) / (t[right] - t[left])
    out[inside] = (v[left] + u[:, None] * (v[right] - v[left]))[inside]
    # A sample exactly on the grid is taken as it is, even beside a gap.
    nearest = np.where(t[right] - grid < grid - t[left], right, left)
    exact = np.abs(t[nearest] - grid) < _SAME
    out[exact] = v[nearest[exact]]
    outer = inside & ~exact & (left >= 1) & (right <= len(t) - 2)
    outer[outer] &= (t[left] - t[left - 1])[outer] <= gap
    outer[outer] &= (t[np.minimum(right + 1, len(t) - 1)] - t[right])[outer] <= gap
    if np.any(outer):
        index = left[outer, None] + np.arange(-1, 3)
        ts = t[index]
        x = grid[outer]
        weights = np.ones_like(ts)
        for i in range(4):
            for j in range(4):
                if i != j:
                    weights[:, i] *= (x - ts[:, j]) / (ts[:, i] - ts[:, j])
        out[outer] = np.einsum("ni,niw->nw", weights, v[index])
    return out


class TimeBase:
    """Collects records and gives out blocks of grid points.

    Args:
        tick: s of vehicle time between blocks.
    """

    def __init__(self, tick: float = 0.1) -> None:
        self.tick = tick
        self.dt = 0.0
        """Grid step in s; 0 until it is known."""
        self.late = 0
        """Records that came after the grid had passed them."""
        self.restarts = 0
        """How often the grid started anew (silence, reboot, changed rate)."""
        self._buffers: dict[Key, StreamBuffer] = {}
        self._newest = -np.inf
        self._started = False
        self._fresh = True
        self._origin = 0.0
        self._next_index = 0
        self._next_tick = np.inf

    @property
    def lag(self) -> float:
        """How far the grid stays behind the newest IMU stamp, in s.

        Two samples of the slowest signal, so that the cubic has both its right neighbours.
        """
        slowest = max(b.interval for b in self._buffers.values() if not b.hold)
        return min(max(4.0 * self.dt, 2.2 * slowest, 0.04), 0.3)

    @property
    def repeated(self) -> int:
        """Samples dropped because their stamp was not newer than the one before."""
        return sum(b.repeated for b in self._buffers.values())

    def push(self, record: Record) -> Block | None:
        """Take one record; returns the next block when a tick is complete."""
        if record.stream is not Stream.IMU:
            self._buffer(record).push(record.t, record.values)
            if self._started and record.t < self._grid_time(self._next_index) - self.dt:
                self.late += 1
            return None
        block = None
        step = record.t - self._newest
        if step < -_BREAK or (self._started and step > _BREAK):
            block = self.finish()
            self._stop(clear=step < 0.0)
        imu = self._buffer(record)
        imu.push(record.t, record.values)
        self._newest = max(self._newest, record.t)
        if not self._started:
            self._try_start(imu)
        elif record.t >= self._next_tick:
            self._next_tick += self.tick * (1 + (record.t - self._next_tick) // self.tick)
            if imu.is_steady and not 0.7 < imu.interval / self.dt < 1.4:
                block = self.finish()
                self._stop(clear=False)
                self._try_start(imu)
            else:
                block = self._emit(record.t - self.lag)
        return block

    def finish(self) -> Block | None:
        """Give out what is left, up to the newest IMU sample."""
        return self._emit(self._newest) if self._started else None

    def _buffer(self, record: Record) -> StreamBuffer:
        key = (record.stream, record.source, record.offset)
        buffer = self._buffers.get(key)
        if buffer is None:
            hold = record.stream in (Stream.IN_AIR, Stream.ARMED)
            buffer = self._buffers[key] = StreamBuffer(len(record.values), hold=hold)
        return buffer

    def _grid_time(self, index: int) -> float:
        return self._origin + index * self.dt

    def _try_start(self, imu: StreamBuffer) -> None:
        if not imu.is_steady:
            return
        # Whole microseconds, as the stamps are. After a pause the old step is kept where it still
        # fits: what was learnt with it then still counts.
        if not (self.dt and abs(imu.interval / self.dt - 1.0) < _SAME_RATE):
            self.dt = max(round(imu.interval * 1e6), 1) * 1e-6
        self._origin = imu.oldest if self._fresh and not self.restarts else self._newest
        self._next_index = 0
        self._next_tick = self._newest + self.tick
        self._started = True

    def _stop(self, *, clear: bool) -> None:
        self._started = False
        self._fresh = True
        self.restarts += 1
        if clear:
            self._buffers.clear()
            self._newest = -np.inf

    def _emit(self, horizon: float) -> Block | None:
        last = int(np.floor((horizon - self._origin) / self.dt + 1e-6))
        if last < self._next_index:
            return None
        t = self._origin + np.arange(self._next_index, last + 1) * self.dt
        self._next_index = last + 1
        block = Block(t, {key: b.at(t) for key, b in self._buffers.items()}, self._fresh)
        self._fresh = False
        for buffer in self._buffers.values():
            buffer.forget_before(t[-1])
        return block
