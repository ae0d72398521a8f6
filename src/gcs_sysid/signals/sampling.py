"""From records to aligned samples: time base, complementary filter, flight detection."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gcs_sysid.arrays import Array, Mask, complete_rows, runs
from gcs_sysid.model import attitude
from gcs_sysid.signals.columns import Track
from gcs_sysid.signals.complementary import ComplementaryFilter
from gcs_sysid.signals.flight_detection import FlightDetector
from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.signals.redundant_commands import SLOW_COMMANDS, mean_of
from gcs_sysid.signals.rotor_source_selector import STRETCH, RotorSourceSelector, family
from gcs_sysid.signals.rotor_units import RotorSource
from gcs_sysid.signals.samples import Samples
from gcs_sysid.signals.time_base import Block, TimeBase

_STEP_BACK = 1.0
"""s; records further back than this are not late: the clock was set back."""
_MOST_HELD = 10.0
"""s of samples held back while no rotor stream is chosen."""


@dataclass(frozen=True)
class SampleBlock:
    """Consecutive samples on the grid.

    Attributes:
        t: (n,) s since the session's first record, vehicle clock; goes on over a reboot.
        samples: n of them.
        flying: (n,) whether the vehicle flies.
        dt: s, the grid's step.
        fresh: whether nothing before joins on to this block.
        rotors: the stream that `samples.speeds` come from; None: none is believed.
    """

    t: Array
    samples: Samples
    flying: Mask
    dt: float
    fresh: bool
    rotors: RotorSource | None = None

    def since(self, first: int) -> "SampleBlock":
        """The block without the samples before `first`."""
        rest = slice(first, None)
        return replace(
            self, t=self.t[rest], samples=self.samples.part(rest), flying=self.flying[rest]
        )


@dataclass(frozen=True)
class _Held:
    """A block whose rotor stream is not chosen yet, with those that there are, by name.

    Attributes:
        block: without its rotors.
        rotors: (n, rotors) of each stream.
        stamps: (n,) s of each stream of commands.
    """

    block: SampleBlock
    rotors: dict[str, Array]
    stamps: dict[str, Array]


class Sampler:
    """Aligns records, filters the attitude, takes the gyro's bias off, marks flight.

    Until it is known which rotor stream to believe, blocks are held back, so that nothing of the
    flight is lost.

    Args:
        selector: of the rotor stream.
        rotors: how many the airframe has.
        tick: s of vehicle time between blocks.
        start: s after the first record; earlier records are not used.
        end: s after the first record; later ones are not used.
        imu_arm: m, the accelerometer from the CG, where known.
    """

    def __init__(
        self,
        rotor_selector: RotorSourceSelector,
        rotors: int,
        tick: float = 0.1,
        start: float = 0.0,
        end: float = np.inf,
        imu_arm: tuple[float, float, float] | None = None,
    ) -> None:
        self.time_base = TimeBase(tick, imu_arm)
        self.attitude: tuple[float, float, float] | None = None
        """Roll, pitch, yaw in rad of the newest sample that has them."""
        self.rates: tuple[float, float, float] | None = None
        self.rotor_speeds: tuple[float, ...] = ()
        self.flying = False
        self.t = 0.0
        """Time of the newest sample, s since the first record."""
        self.seen: set[Stream] = set()
        """Streams that came between start and end."""
        self.rotor_selector = rotor_selector
        self._rotors = rotors
        self._held: list[_Held] = []
        self._start, self._end = start, end
        self._flight = FlightDetector()
        self._filter: ComplementaryFilter | None = None
        self._first: float | None = None
        self._began = self._newest = 0.0

    @property
    def recorded(self) -> float | None:
        """Seconds of vehicle clock from the first record to the newest; None without any."""
        return None if self._first is None else self._newest - self._began

    def push(self, record: Record) -> tuple[SampleBlock, ...]:
        """Take one record; the next blocks when there are any."""
        if record.stream is Stream.PARAMETER:
            self.rotor_selector.push(record, flying=self.flying)
            return ()
        if self._first is None:
            self._first = self._began = self._newest = record.t
        if record.t < self._newest - _STEP_BACK:
            # The vehicle's clock was set back (a reboot); start and end go on counting.
            self._began += record.t - self._newest
            self._newest = record.t
        self._newest = max(self._newest, record.t)
        if not self._start <= max(record.t - self._began, 0.0) <= self._end:
            return ()
        self.seen.add(record.stream)
        self.rotor_selector.push(record, flying=self.flying)
        block = self.time_base.push(record)
        return () if block is None else self._take(block)

    def copy(self) -> "Sampler":
        """One in the same state, that goes its own way."""
        shared = self.rotor_selector.settings
        return deepcopy(self, {id(thing): thing for thing in shared})

    def take(self, tracks: Sequence[Track]) -> tuple[SampleBlock, ...] | None:
        """Take the records of a while at once, where that tells what one by one would tell.

        Args:
            tracks: with their orders; the last record is one of the IMU.

        Returns:
            The next blocks; None where something happens in that while (a take-off, a rotor stream
            that is no longer sound, see also `TimeBase.take`). Then this sampler is spoilt.
        """
        first = min(float(track.t[0]) for track in tracks)
        last = max(float(track.t[-1]) for track in tracks)
        steady = not self._held and (not self.flying or self.rotor_selector.choice is not None)
        inside = self._start <= first - self._began and last - self._began <= self._end
        if self._first is None or not (steady and inside):
            return None
        block = self.time_base.take(tracks)
        if block is None or block.fresh:
            return None
        flew, choice, twin = self.flying, self.rotor_selector.choice, self.rotor_selector.twin
        held = self._samples(block)
        if (held.block.flying != flew).any():
            return None
        self._newest = max(self._newest, last)
        self.seen |= {track.stream for track in tracks}
        if flew:
            self._judge(tracks)
            if self.rotor_selector.choice is not choice or self.rotor_selector.twin != twin:
                return None
        self._held.append(held)
        return self._release()

    def _judge(self, tracks: Sequence[Track]) -> None:
        """Have the selector look at stretches of a flight in which nothing else happens."""
        imu = next(track for track in tracks if track.stream is Stream.IMU)
        starts = np.flatnonzero(np.diff((imu.t - imu.t[0]) // STRETCH)) + 1
        edges = [0, *imu.order[starts].tolist(), int(imu.order[-1]) + 1]
        counts = np.diff([0, *starts, len(imu.t)])
        for orders, count in zip(pairwise(edges), counts.tolist(), strict=True):
            self.rotor_selector.extend([track.between(*orders) for track in tracks])
            self.rotor_selector.fly(count * self.time_base.dt)

    def catch_up(self) -> tuple[SampleBlock, ...]:
        """The next blocks, up to now instead of to the last tick."""
        block = self.time_base.catch_up()
        return () if block is None else self._take(block)

    def finish(self) -> tuple[SampleBlock, ...]:
        """What is still held back."""
        block = self.time_base.finish()
        ready = () if block is None else self._take(block)
        if not self.rotor_selector.judged:
            self.rotor_selector.judge()
        return (*ready, *self._release())

    def _take(self, block: Block) -> tuple[SampleBlock, ...]:
        flew = self.flying
        held = self._samples(block)
        self._held.append(held)
        if block.fresh:
            self.rotor_selector.gap()
        flown = int(np.isfinite(held.block.samples.gyro[:, 0]).sum()) * held.block.dt
        if flew:  # else the selector has not seen what came in that time
            self.rotor_selector.fly(flown)
        if flew and not self.flying and self.rotor_selector.choice is not None:
            self.rotor_selector.gap()  # what came since it landed tells nothing of the next flight
        if self.rotor_selector.choice is None and self._may_still_choose():
            return ()
        return self._release()

    def _may_still_choose(self) -> bool:
        """Whether what is held could be of use yet."""
        waits = sum(len(held.block.t) * held.block.dt for held in self._held)
        flies = any(np.isfinite(held.block.samples.gyro).any() for held in self._held)
        return flies and not self.rotor_selector.judged and waits < _MOST_HELD

    def _release(self) -> tuple[SampleBlock, ...]:
        """The blocks held back, with the rotor stream that is believed now."""
        choice, ready = self.rotor_selector.choice, []
        for held in self._held:
            samples = held.block.samples
            if choice is not None and choice.name in held.rotors:
                rotors, apart = self._joined(held, choice.name)
                samples = replace(samples, speeds=choice.read(rotors), apart=apart)
            ready.append(replace(held.block, samples=samples, rotors=choice))
        self._held.clear()
        if ready:
            self._show_rotors(ready[-1].samples.speeds[-1])
        return tuple(ready)

    def _joined(self, held: _Held, name: str) -> tuple[Array, Array]:
        """(n, rotors) of a stream, with its twin where they are slow; (n, 1) s between both."""
        rotors, second = held.rotors[name], self.rotor_selector.twin
        apart = np.full(len(rotors), np.nan)
        if second in held.rotors and held.block.dt >= SLOW_COMMANDS:
            twin = held.rotors[second]
            both = complete_rows(rotors + twin)
            apart[both] = (held.stamps[name] - held.stamps[second])[both]
            rotors = mean_of(rotors, twin)
        return rotors, apart[:, None]

    def _samples(self, block: Block) -> _Held:
        assert self._first is not None
        if block.fresh and block.t[0] - self._first < self.t:
            # The vehicle's clock stepped back (a reboot); the session's time goes on.
            self._first = float(block.t[0]) - self.t
        n, dt = len(block.t), self.time_base.dt
        t = block.t - self._first
        imu = _stream(block, Stream.IMU, n, 6)
        gyro, force = imu[:, :3], imu[:, 3:]
        reference = _stream(block, Stream.ATTITUDE, n, 4)
        reference = reference / np.linalg.norm(reference, axis=1, keepdims=True)
        if self._filter is None or self._filter.dt != dt:
            bias = self._filter.bias if self._filter else np.zeros(3)
            self._filter = ComplementaryFilter(dt)
            self._filter.bias = bias
        elif block.fresh:
            self._filter.restart()
        filtered, bias = self._attitude(self._filter, gyro, reference)
        rotors = self._rotor_streams(block, n)
        velocity = _stream(block, Stream.VELOCITY, n, 6)
        flying = self._flight.update(
            t,
            _stream(block, Stream.IN_AIR, n, 1)[:, 0],
            _stream(block, Stream.ARMED, n, 1)[:, 0],
            self._turning(block, n),
            velocity[:, 3:],
        )
        self.time_base.flown += dt * int(np.count_nonzero(flying))
        gyro = np.where(flying[:, None], gyro, np.nan)
        samples = Samples(
            gyro=gyro,
            rates=gyro - bias,
            speeds=np.full((n, self._rotors), np.nan),
            attitude=filtered,
            force=force,
            velocity=velocity[:, :3],
        )
        self.t = float(t[-1])
        self.flying = bool(flying[-1])
        self._show(samples)
        stamps = {family(key[1]): stamps for key, stamps in block.stamps.items()}
        return _Held(SampleBlock(t, samples, flying, dt, block.fresh), rotors, stamps)

    def _attitude(
        self, flt: ComplementaryFilter, gyro: Array, reference: Array
    ) -> tuple[Array, Array]:
        """Attitude and gyro bias, filtered over the runs in which both sources are there."""
        out = np.full_like(reference, np.nan)
        bias = np.empty_like(gyro)
        there = complete_rows(gyro) & complete_rows(reference)
        for run, both in runs(there):
            if both:
                out[run] = flt.update(gyro[run], reference[run])
                bias[run] = flt.biases
            else:
                flt.restart()
                bias[run] = flt.bias
        return out, bias

    def _rotor_streams(self, block: Block, n: int) -> dict[str, Array]:
        """(n, rotors) of every source of rotor speeds or commands, as they came."""
        out: dict[str, Array] = {}
        for (stream, source, offset), values in block.values.items():
            if stream in (Stream.ROTOR_SPEED, Stream.ROTOR_COMMAND) and offset < self._rotors:
                name = family(source)
                whole = out.setdefault(name, np.full((n, self._rotors), np.nan))
                width = min(values.shape[1], self._rotors - offset)
                whole[:, offset : offset + width] = values[:, :width]
        return out

    def _turning(self, block: Block, n: int) -> Array:
        """(n, rotors) above zero where a rotor turns, as far as any stream tells."""
        turning = np.full((n, self._rotors), np.nan)
        for (stream, _, offset), values in block.values.items():
            if stream in (Stream.ROTOR_SPEED, Stream.ROTOR_COMMAND) and offset < self._rotors:
                if stream is Stream.ROTOR_COMMAND:
                    # Pulses of stopped motors are at most 1000 us; other units start from zero.
                    stopped = (values >= 600.0) & (values <= 1000.0)
                    values = np.where(stopped, 0.0, values)
                part = turning[:, offset : offset + values.shape[1]]
                np.fmax(part, values[:, : part.shape[1]], out=part)
        return turning

    def _show(self, samples: Samples) -> None:
        if np.isfinite(samples.attitude[-1]).all():
            roll, pitch, yaw = attitude.to_euler(samples.attitude[-1])
            self.attitude = (float(roll), float(pitch), float(yaw))
        if np.isfinite(samples.rates[-1]).all():
            p, q, r = samples.rates[-1]
            self.rates = (float(p), float(q), float(r))

    def _show_rotors(self, newest: Array) -> None:
        if np.isfinite(newest).all():
            self.rotor_speeds = tuple(float(v) for v in newest)


def _stream(block: Block, stream: Stream, n: int, width: int) -> Array:
    values = block.values.get((stream, "", 0))
    return np.full((n, width), np.nan) if values is None else values
