"""One time base: streams with their own stamps and rates, brought to one uniform grid.

The grid runs on the vehicle's clock at the IMU's own rate. At each tick of that clock (0.1 s) the
points are given out that samples to come change no more, a lag behind the newest IMU stamp. Values
given out at a tick depend on the samples received before it: how they are cut into pieces on the
way here, a frame or a whole log at once, changes no number. Between samples a cubic through four of
them is taken; where a stream has a gap its values are marked as missing.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.signals.columns import Key, Track, by_key
from gcs_sysid.signals.imu_checks import Saturation
from gcs_sysid.signals.inertial_stream import FaultCounts, InertialBuffer
from gcs_sysid.signals.records import Stream
from gcs_sysid.signals.rotor_speed_stream import RotorBuffer
from gcs_sysid.signals.stream_buffer import BREAK, StreamBuffer

_IMU: Key = (Stream.IMU, "", 0)

_AWAITED = (Stream.ATTITUDE, Stream.VELOCITY, Stream.ROTOR_COMMAND)
"""Streams whose next sample the grid waits for; IMU and measured speeds have rules of their own."""

_LEAST_STEP = 1e-4
"""s, of the grid. No IMU is sent faster; stamps that claim it would make a second of flight a
million samples."""
_LEAST_LAG, _MOST_LAG = 0.04, 0.3
"""s, of the grid behind the newest sample."""
_CARRIED = 0.15
"""s between velocities that still show the impulse in between. A velocity is a sum already: across
lost samples its change is the whole impulse, which the momentum balance would lose, and restart
with the velocity's error at that moment."""
_ROUNDING = 1e-6
"""s, of sums of ticks."""
_SAME_RATE = (0.7, 1.4)
"""The IMU's interval over the grid's step, between which the rate is what it was."""
_MOST_POINTS = 16384
"""Of the grid in a block, but for a single tick: stamps that jump on by most of a second each would
make a block of any size."""
_WORTH_KEEPING = 10.0
"""s. The estimate on a grid is given up for a rate that brings as many samples in this time."""


@dataclass(frozen=True)
class Block:
    """Consecutive grid points with every stream's values.

    Attributes:
        t: (n,) s, vehicle clock, uniform.
        values: stream key -> (n, width), NaN where missing.
        stamps: stream key of commands -> (n,) s, times of the samples at or before the points.
        ends: (ticks,) rising, how many of the points had been given out after each tick.
        orders: (ticks,) order of the IMU sample that completed each tick.
        fresh: whether the grid restarted: nothing before is continuous with this block.
    """

    t: Array
    values: dict[Key, Array]
    stamps: dict[Key, Array]
    ends: Array
    orders: Array
    fresh: bool = False


class _Arrivals:
    """The samples of a while, taken off in the order in which they came."""

    def __init__(self, tracks: Iterable[Track]) -> None:
        self._tracks = by_key(tracks)
        self._taken = dict.fromkeys(self._tracks, 0)

    def imu(self) -> tuple[Array, Array]:
        """(n,) times and orders of the IMU's samples."""
        track = self._tracks.get(_IMU)
        return (np.empty(0), np.empty(0, int)) if track is None else (track.t, track.order)

    def ahead(self, stop: int | None) -> Iterator[tuple[Key, Track]]:
        """Those of each stream with an order before `stop`, without taking them off."""
        for key, track in self._tracks.items():
            rows = self._rows(key, stop)
            if rows.stop - rows.start == len(track.t):
                yield key, track
            elif rows.stop > rows.start:
                yield key, track.part(rows)

    def take_before(self, stop: int | None) -> Iterator[tuple[Key, Track]]:
        """The same, taken off."""
        for key, part in self.ahead(stop):
            self._taken[key] += len(part.t)
            yield key, part

    def _rows(self, key: Key, stop: int | None) -> slice:
        order = self._tracks[key].order
        end = len(order) if stop is None else int(np.searchsorted(order, stop))
        return slice(self._taken[key], end)


class TimeBase:
    """Collects samples and gives out blocks of grid points.

    Args:
        tick: s of vehicle time between blocks.
        imu_arm: m, the accelerometer from the CG, where known; forces are given at the CG.
    """

    def __init__(
        self, tick: float = 0.1, imu_arm: tuple[float, float, float] | None = None
    ) -> None:
        self.tick = tick
        self._imu_arm = imu_arm
        self.dt = 0.0
        """Grid step in s; 0 until it is known."""
        self.late = 0
        """Samples that came after the grid had passed them."""
        self.restarts = 0
        """How often the grid restarted (silence, reboot, changed rate)."""
        self.flown = 0.0
        """s of flight on a grid of this step, set by the owner; the estimate depends on it."""
        self.faults = FaultCounts()
        """Outliers of the IMU, found so far."""
        self.saturation = Saturation()
        """Of the IMU, as it came."""
        self._buffers: dict[Key, StreamBuffer] = {}
        self._wild_before = self._still_before = 0
        self._newest = -np.inf
        self._started = False
        self._fresh = True
        self._origin = 0.0
        self._next_index = 0
        self._next_tick = 0  # counted from where the grid began
        self._ticks_from = 0.0

    @property
    def until_tick(self) -> float:
        """S of the vehicle's clock from the newest IMU sample to the next tick."""
        next_tick = self._ticks_from + self._next_tick * self.tick
        return max(next_tick - self._newest, 0.0) if self._started else self.tick

    @property
    def imu_interval(self) -> float:
        """Usual time between IMU samples in s, which need not be the grid's step any more."""
        imu = self._buffers.get(_IMU)
        return 0.0 if imu is None else imu.interval

    @property
    def is_usable(self) -> bool:
        """Whether the IMU is fast enough to be interpolated between its samples."""
        return 1.2 * self.imu_interval <= self._imu_buffer().gap

    @property
    def frozen_share(self) -> float:
        """Share of the IMU's samples that repeat the one before in all values."""
        return self.faults.frozen / max(self.saturation.samples, 1)

    @property
    def disordered_share(self) -> float:
        """Share of the IMU's samples whose stamp was not newer than the one before."""
        passed = self._buffers[_IMU].repeated if _IMU in self._buffers else 0
        return passed / max(self.saturation.samples + passed, 1)

    @property
    def repeated(self) -> int:
        """Samples dropped because their stamp was not newer than the one before."""
        return sum(b.repeated for b in self._buffers.values())

    @property
    def wild_speeds(self) -> int:
        """Messages of rotor speeds with a wild value, taken for lost."""
        return self._wild_before + sum(b.wild for b in self._rotor_buffers())

    @property
    def still_speeds(self) -> int:
        """Messages of rotor speeds that stood still, taken for lost."""
        return self._still_before + sum(b.still for b in self._rotor_buffers())

    def feed_tracks(self, tracks: Sequence[Track]) -> Iterator[Block]:
        """Take samples, with their orders; gives the blocks that they complete, one by one.

        Each block is made before samples after it are looked at: what its receiver sets (`flown`)
        counts from then on.
        """
        arrivals = _Arrivals(tracks)
        t, orders = arrivals.imu()
        done = 0
        while done < len(t):
            newest = np.maximum.accumulate(np.concatenate([[self._newest], t[done:]]))
            step = t[done:] - newest[:-1]
            breaks = step < -BREAK
            if self._started:
                breaks |= step > BREAK
            if breaks[0]:
                self._extend(arrivals, int(orders[done]))
                yield from self._end_grid(int(orders[done]), clear=bool(step[0] < 0.0))
            elif not self._started:
                self._extend(arrivals, int(orders[done]) + 1)
                self._newest = float(newest[1])
                self._try_start()
                done += 1
            else:
                until = int(np.argmax(breaks)) if breaks.any() else len(step)
                here = slice(done, done + until)
                taken, blocks = self._tick_on(arrivals, t[here], orders[here], newest[1:])
                done += taken
                yield from blocks
        self._extend(arrivals, None)

    def catch_up(self) -> Iterator[Block]:
        """Give out what there is, tick or no tick: all but the samples of the last lag."""
        if self._started:
            self._look()
            yield from self._emit(self._horizon(np.array([self._newest])), np.zeros(1, int))

    def finish(self, order: int = 0) -> Iterator[Block]:
        """Give out what is left, up to the newest IMU sample.

        Args:
            order: of the sample that ends the grid.
        """
        if self._started:
            self._look()
            yield from self._emit(np.array([self._newest]), np.array([order]))

    def _tick_on(
        self, arrivals: _Arrivals, t: Array, orders: Array, newest: Array
    ) -> tuple[int, Iterator[Block]]:
        """Take samples up to the last tick before which nothing unusual happens.

        Args:
            arrivals: from which they are taken.
            t: (n,) s, of IMU samples without a break.
            orders: (n,) of these.
            newest: (n,) s, the newest of them up to each.

        Returns:
            How many IMU samples that were, all of them if there is no tick, and the blocks.
        """
        if newest[len(t) - 1] + _ROUNDING < self._ticks_from + self._next_tick * self.tick:
            self._newest = float(newest[len(t) - 1])
            return len(t), iter(())
        number = np.floor((t + _ROUNDING - self._ticks_from) / self.tick).astype(np.int64)
        before = np.maximum.accumulate(np.concatenate([[self._next_tick - 1], number]))[:-1]
        rows = np.flatnonzero(number > before)
        if not len(rows):
            self._newest = float(newest[len(t) - 1])
            return len(t), iter(())
        most = newest[rows] <= self._newest + _MOST_POINTS * self.dt
        rows = rows[: max(int(np.count_nonzero(most)), 1)]
        rows = rows[: self._regular(arrivals, orders[rows])]
        last = int(rows[-1])
        arrived = self._extend(arrivals, int(orders[last]) + 1, orders[rows])
        self._newest = float(newest[last])
        self._next_tick = int(number[last]) + 1
        if len(rows) == 1 and self._is_outgrown():
            return last + 1, self._grow(int(orders[last]), arrived)
        return last + 1, self._emit(self._horizon(newest[rows]), orders[rows], arrived)

    def _regular(self, arrivals: _Arrivals, ticks: Array) -> int:
        """How many of the next ticks, of these orders, one pass over the samples can serve.

        That is where none of them changes the values of an earlier tick (samples that come late or
        stand still), or the grid itself. One tick always can.
        """
        count = len(ticks)
        if count == 1:
            return 1
        for key, track in arrivals.ahead(int(ticks[-1]) + 1):
            buffer = self._buffer(key, track.values.shape[1])
            odd = buffer.first_irregular(track.t, track.values)
            if odd < len(track.t):
                count = min(count, max(int(np.searchsorted(ticks, track.order[odd])), 1))
            if key == _IMU:
                interval = buffer.intervals_ahead(
                    track.t, np.searchsorted(track.order, ticks, side="right")
                )
                rate = np.maximum(interval, _LEAST_STEP) / self.dt
                usable = 1.2 * interval <= self._imu_buffer().gap
                same = (rate > _SAME_RATE[0]) & (rate < _SAME_RATE[1])
                same &= usable == self.is_usable
                count = min(count, len(same) if same.all() else max(int(np.argmin(same)), 1))
        return count

    def _extend(
        self, arrivals: _Arrivals, stop: int | None, ticks: Array | None = None
    ) -> list[tuple[Array, Array]]:
        """Take samples off, up to an order.

        Args:
            arrivals: from which.
            stop: the order; None: all.
            ticks: (k,) orders of the ticks among them; None: there are none.

        Returns:
            Times, s, and marks of those ticks, see `StreamBuffer.extend`, of the streams beside
            the IMU.
        """
        arrived, seen = [], set()
        none = np.zeros(0, np.int64)
        for key, track in arrivals.take_before(stop):
            buffer = self._buffer(key, track.values.shape[1])
            marks = none if ticks is None else np.searchsorted(track.order, ticks, side="right")
            buffer.extend(track.t, track.values, marks)
            seen.add(key)
            if key != _IMU:
                arrived.append((track.t, marks))
        if ticks is None:
            self._count_late(arrived, np.array([self._next_index]))
        else:
            for key in self._buffers.keys() - seen:
                self._buffers[key].look(len(ticks))
        return arrived

    def _count_late(self, arrived: Iterable[tuple[Array, Array]], passed: Array) -> None:
        """Count samples that the grid had passed; `passed`: points given out between the ticks."""
        if self._started:
            for t, marks in arrived:
                index = passed[np.searchsorted(marks, np.arange(len(t)), side="right")]
                late = t < self._origin + (index - 1) * self.dt
                self.late += int(np.count_nonzero(late))

    def _look(self) -> None:
        for buffer in self._buffers.values():
            buffer.look()

    def _horizon(self, newest: Array) -> Array:
        """(ticks,) s up to which samples to come change nothing.

        The grid stays two samples of the slowest signal behind the (ticks,) `newest` stamps of
        the IMU, so that the cubic has both its right neighbors. Where a stream has lost samples
        it waits for the next one, for a while.
        """
        signals = [b.intervals for b in self._buffers.values() if not b.hold]
        slowest = np.maximum.reduce(signals)
        lag = np.clip(np.maximum(4.0 * self.dt, 2.2 * slowest), _LEAST_LAG, _MOST_LAG)
        horizon = newest - lag
        waits = [b.known_until(horizon) for key, b in self._buffers.items() if key[0] in _AWAITED]
        if waits:
            known = np.maximum.reduce([np.minimum.reduce(waits), newest - _MOST_LAG])
            horizon = np.minimum(horizon, known)
        settled = [b.settled(newest) for b in self._rotor_buffers()]
        settled.append(self._imu_buffer().settled())
        return np.minimum.reduce([horizon, *settled])

    def _emit(
        self, horizon: Array, orders: Array, arrived: Iterable[tuple[Array, Array]] = ()
    ) -> Iterator[Block]:
        """The block of all points up to (ticks,) horizons, s, if there are any."""
        last = np.floor((horizon - self._origin) / self.dt + 1e-6).astype(np.int64)
        first = self._next_index
        ends = np.maximum.accumulate(np.maximum(last + 1, first))
        self._count_late(arrived, np.concatenate([[first], ends]))
        self._next_index = int(ends[-1])
        if self._next_index == first:
            return
        index = np.arange(first, self._next_index)
        t = self._origin + index * self.dt
        tick = np.searchsorted(ends, index, side="right")
        values = {key: buffer.at(t, tick) for key, buffer in self._buffers.items()}
        stamps = {
            key: buffer.stamps(t, tick)
            for key, buffer in self._buffers.items()
            if key[0] is Stream.ROTOR_COMMAND
        }
        for buffer in self._buffers.values():
            buffer.forget_before(t[-1])
        fresh, self._fresh = self._fresh, False
        lasting = np.diff(ends, prepend=first) > 0
        yield Block(t, values, stamps, ends[lasting] - first, orders[lasting], fresh)

    def _end_grid(self, order: int, *, clear: bool) -> Iterator[Block]:
        yield from self.finish(order)
        self._stop(clear=clear)

    def _grow(self, order: int, arrived: Iterable[tuple[Array, Array]]) -> Iterator[Block]:
        """End the grid and begin another, of the IMU's new rate."""
        self._count_late(arrived, np.array([self._next_index] * 2))
        yield from self._end_grid(order, clear=False)
        self._try_start()

    def _buffer(self, key: Key, width: int) -> StreamBuffer:
        buffer = self._buffers.get(key)
        if buffer is None:
            stream, _, _ = key
            if stream is Stream.IMU:
                return self._imu_buffer()
            if stream is Stream.ROTOR_SPEED:
                buffer = RotorBuffer(width)
            else:
                # A setpoint or a voltage holds until the next one, without waiting for that.
                hold = stream in (
                    *(Stream.IN_AIR, Stream.ARMED),
                    *(Stream.RATE_SETPOINT, Stream.VOLTAGE),
                )
                bridged = _CARRIED if stream is Stream.VELOCITY else 0.0
                buffer = StreamBuffer(width, hold=hold, bridged=bridged)
            self._buffers[key] = buffer
        return buffer

    def _rotor_buffers(self) -> list[RotorBuffer]:
        return [b for b in self._buffers.values() if isinstance(b, RotorBuffer)]

    def _imu_buffer(self) -> InertialBuffer:
        buffer = self._buffers.get(_IMU)
        if not isinstance(buffer, InertialBuffer):
            buffer = self._buffers[_IMU] = InertialBuffer(
                self.faults, self.saturation, self._imu_arm
            )
            buffer.step = self.dt
        return buffer

    def _try_start(self) -> None:
        imu = self._imu_buffer()
        if not imu.knows_interval:
            return
        if not self.dt or self._is_outgrown():
            # Whole microseconds, as the stamps are.
            self.dt = max(round(imu.interval * 1e6) * 1e-6, _LEAST_STEP)
            self.flown = 0.0
        imu.step = self.dt
        self._origin = self._newest
        # A clock that is set right after a few samples leaves the oldest years behind.
        if not self.restarts and self._newest - imu.oldest <= _MOST_POINTS * self.dt:
            self._origin = imu.oldest
        self._next_index = 0
        self._ticks_from, self._next_tick = self._newest, 1
        self._started = True

    def _is_outgrown(self) -> bool:
        """Whether the IMU's rate has changed and the grid shall follow.

        It need not: the estimate holds for one step alone. A faster stream is taken at the grid's
        times, and so is a slower one as long as it can be interpolated.
        """
        imu = self._imu_buffer()
        low, high = _SAME_RATE
        interval = max(imu.interval, _LEAST_STEP)
        if not imu.is_settled or low < interval / self.dt < high:
            return False
        if imu.keeps_step(self.dt):  # a link that loses samples makes no other rate
            return False
        if self.flown / self.dt < _WORTH_KEEPING / interval:
            return True
        return not self.is_usable and self.flown < _WORTH_KEEPING

    def _stop(self, *, clear: bool) -> None:
        self._started = False
        self._fresh = True
        self.restarts += 1
        if clear:
            self._wild_before, self._still_before = self.wild_speeds, self.still_speeds
            self._buffers.clear()
            self._newest = -np.inf
