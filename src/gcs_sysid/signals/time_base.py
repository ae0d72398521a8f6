"""One time base: streams with their own stamps and rates, brought to one uniform grid.

The grid runs on the vehicle's clock at the IMU's own rate. A grid point is given out a fixed
lag behind the newest IMU stamp, so that the outcome depends on the order of the records alone,
never on when they happened to be read. Between samples a cubic through four of them is taken;
where a stream has a gap its values are marked as missing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.signals.columns import Track
from gcs_sysid.signals.inertial_stream import FaultCounts, InertialBuffer
from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.signals.rotor_speed_stream import RotorBuffer
from gcs_sysid.signals.stream_buffer import BREAK, StreamBuffer, usual_gap

Key = tuple[Stream, str, int]
"""Stream, source, first rotor."""
_IMU: Key = (Stream.IMU, "", 0)

_AWAITED = (Stream.ATTITUDE, Stream.VELOCITY, Stream.ROTOR_COMMAND)
"""Streams whose next sample the grid waits for; IMU and measured speeds have rules of their own."""

_LEAST_STEP = 1e-4
"""s, of the grid. No IMU is sent faster; stamps that claim it would make a second of flight a
million samples."""
_LEAST_LAG, _MOST_LAG = 0.04, 0.3
"""s, of the grid behind the newest sample."""
_CARRIED = 0.15
"""s between velocities that still tell what moved the vehicle in between. A velocity is a sum
already: across lost samples its change is the whole impulse, which the momentum balance would
lose, and begin anew with what the velocity is off at that moment."""
_ROUNDING = 1e-6
"""s, of sums of ticks."""
_FEW = 16
"""Samples whose mean interval tells a changed rate."""
_SAME_RATE = (0.7, 1.4)
"""The IMU's interval over the grid's step, between which the rate is what it was."""
_WORTH_KEEPING = 10.0
"""s. What is learnt on a grid is given up for a rate that brings as many samples in this time."""


def _key(samples: Record | Track) -> Key:
    return samples.stream, samples.source, samples.offset


@dataclass(frozen=True)
class Block:
    """Consecutive grid points with every stream's values.

    Attributes:
        t: (n,) s, vehicle clock, uniform.
        values: stream key -> (n, width), NaN where missing.
        stamps: stream key of commands -> (n,) s, times of the samples at or before the points.
    """

    t: Array
    values: dict[Key, Array]
    stamps: dict[Key, Array]
    fresh: bool = False
    """Whether the grid started anew: nothing before this block joins on to it."""


class TimeBase:
    """Collects records and gives out blocks of grid points.

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
        """Records that came after the grid had passed them."""
        self.restarts = 0
        """How often the grid started anew (silence, reboot, changed rate)."""
        self.flown = 0.0
        """s of flight on a grid of this step, as the owner tells; what is learnt rests on it."""
        self.faults = FaultCounts()
        """Outliers of the IMU, found so far."""
        self._buffers: dict[Key, StreamBuffer] = {}
        self._wild_before = self._still_before = 0
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
        return min(max(4.0 * self.dt, 2.2 * slowest, _LEAST_LAG), _MOST_LAG)

    @property
    def imu_interval(self) -> float:
        """Usual time between IMU samples in s, which need not be the grid's step any more."""
        imu = self._buffers.get(_IMU)
        return 0.0 if imu is None else imu.interval

    @property
    def is_usable(self) -> bool:
        """Whether the IMU is fast enough to be interpolated between its samples."""
        return 1.2 * self.imu_interval <= self._imu_gap

    @property
    def _imu_gap(self) -> float:
        return usual_gap(self.dt)

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
        if step < -BREAK or (self._started and step > BREAK):
            block = self.finish()
            self._stop(clear=step < 0.0)
        imu = self._imu_buffer()
        imu.push(record.t, record.values)
        self._newest = max(self._newest, record.t)
        if not self._started:
            self._try_start(imu)
        elif record.t >= self._next_tick - _ROUNDING:
            self._tick_on(record.t)
            if self._is_outgrown(imu):
                block = self.finish()
                self._stop(clear=False)
                self._try_start(imu)
            else:
                block = self.catch_up()
        return block

    def take(self, tracks: Sequence[Track]) -> Block | None:
        """Take the records of a while at once, where blocks in between would tell no more.

        Args:
            tracks: with their orders; the last record is one of the IMU.

        Returns:
            The next block; None where the records are not regular: a stream that begins, a pause,
            a changed rate, stamps that stand still or come late. Then nothing was taken.
        """
        if not self._started or not self._are_regular(tracks):
            return None
        for track in tracks:
            self._buffers[_key(track)].extend(track.t, track.values)
        self._newest = max(track.t[-1] for track in tracks if track.stream is Stream.IMU)
        self._tick_on(self._newest)
        return self.catch_up()

    def catch_up(self) -> Block | None:
        """Give out what there is, tick or no tick: all but the samples of the last `lag`.

        Where a stream has lost samples the grid waits for the next one, for a while.
        """
        if not self._started:
            return None
        horizon = self._newest - self.lag
        waits = (b for key, b in self._buffers.items() if key[0] in _AWAITED)
        known = min((b.known_until(horizon) for b in waits), default=np.inf)
        horizon = min(horizon, max(known, self._newest - _MOST_LAG))
        settled = [b.settled(self._newest) for b in self._rotor_buffers()]
        return self._emit(min(horizon, self._imu_buffer().settled(), *settled))

    def _tick_on(self, t: float) -> None:
        past = t + _ROUNDING - self._next_tick
        self._next_tick += self.tick * max(1 + past // self.tick, 0)

    def _are_regular(self, tracks: Sequence[Track]) -> bool:
        imu = next((track for track in tracks if track.stream is Stream.IMU), None)
        if imu is None or len({_key(track) for track in tracks}) < len(tracks):
            return False
        buffers = [self._buffers.get(_key(track)) for track in tracks]
        for track, buffer in zip(tracks, buffers, strict=True):
            if buffer is None or not buffer.extends(track.t, track.values):
                return False
        if not np.isfinite(imu.values[:, :3].sum()):
            return False
        steps = np.diff(imu.t, prepend=self._newest)
        few = len(steps) // _FEW * _FEW
        rates = steps[:few].reshape(-1, _FEW).mean(axis=1) / self.dt
        if not (_SAME_RATE[0] < rates).all() or not (rates < _SAME_RATE[1]).all():
            return False
        if steps.max() > BREAK:
            return False
        known = np.append(self._newest, imu.t)
        for track in tracks:
            late = known[np.searchsorted(imu.order, track.order)] - track.t
            if late.max() > _LEAST_LAG or late.min() < -BREAK:
                return False
        return True

    def finish(self) -> Block | None:
        """Give out what is left, up to the newest IMU sample."""
        return self._emit(self._newest) if self._started else None

    def _buffer(self, record: Record) -> StreamBuffer:
        key = _key(record)
        buffer = self._buffers.get(key)
        if buffer is None:
            hold = record.stream in (Stream.IN_AIR, Stream.ARMED)
            width = len(record.values)
            if record.stream is Stream.ROTOR_SPEED:
                buffer = RotorBuffer(width)
            else:
                bridged = _CARRIED if record.stream is Stream.VELOCITY else 0.0
                buffer = StreamBuffer(width, hold=hold, bridged=bridged)
            self._buffers[key] = buffer
        return buffer

    def _rotor_buffers(self) -> list[RotorBuffer]:
        return [b for b in self._buffers.values() if isinstance(b, RotorBuffer)]

    @property
    def wild_speeds(self) -> int:
        """Messages of rotor speeds with a wild value, taken for lost."""
        return self._wild_before + sum(b.wild for b in self._rotor_buffers())

    @property
    def still_speeds(self) -> int:
        """Messages of rotor speeds that stood still, taken for lost."""
        return self._still_before + sum(b.still for b in self._rotor_buffers())

    def _imu_buffer(self) -> InertialBuffer:
        buffer = self._buffers.get(_IMU)
        if not isinstance(buffer, InertialBuffer):
            buffer = self._buffers[_IMU] = InertialBuffer(self.faults, self._imu_arm)
        return buffer

    def _grid_time(self, index: int) -> float:
        return self._origin + index * self.dt

    def _try_start(self, imu: InertialBuffer) -> None:
        if not imu.knows_interval:
            return
        if not self.dt or self._is_outgrown(imu):
            # Whole microseconds, as the stamps are.
            self.dt = max(round(imu.interval * 1e6) * 1e-6, _LEAST_STEP)
            self.flown = 0.0
        imu.step = self.dt
        self._origin = imu.oldest if self._fresh and not self.restarts else self._newest
        self._next_index = 0
        self._next_tick = self._newest + self.tick
        self._started = True

    def _is_outgrown(self, imu: StreamBuffer) -> bool:
        """Whether the IMU's rate has changed and the grid shall follow.

        It need not: what is learnt holds for one step alone. A faster stream is taken at the
        grid's times, and so is a slower one as long as it can be interpolated.
        """
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

    def _emit(self, horizon: float) -> Block | None:
        last = int(np.floor((horizon - self._origin) / self.dt + 1e-6))
        if last < self._next_index:
            return None
        t = self._origin + np.arange(self._next_index, last + 1) * self.dt
        self._next_index = last + 1
        values = {
            key: buffer.at(t, self._imu_gap if key == _IMU else None)
            for key, buffer in self._buffers.items()
        }
        stamps = {
            key: buffer.stamps(t)
            for key, buffer in self._buffers.items()
            if key[0] is Stream.ROTOR_COMMAND
        }
        block = Block(t, values, stamps, self._fresh)
        self._fresh = False
        for buffer in self._buffers.values():
            buffer.forget_before(t[-1])
        return block
