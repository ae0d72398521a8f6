"""From records to aligned samples: time base, complementary filter, flight detection."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.arrays import Array, Mask, complete_rows, runs
from gcs_sysid.model import attitude
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.columns import RecordBlock, Track
from gcs_sysid.signals.complementary import ComplementaryFilter
from gcs_sysid.signals.flight_detection import FlightDetector
from gcs_sysid.signals.imu_checks import GyroCheck
from gcs_sysid.signals.records import Samples, Stream
from gcs_sysid.signals.recursions import lfilter
from gcs_sysid.signals.redundant_commands import SLOW_COMMANDS, mean_of
from gcs_sysid.signals.rotor_source_selector import RotorSourceSelector, family
from gcs_sysid.signals.rotor_units import RotorSource, are_digital, starts_of
from gcs_sysid.signals.time_base import Block, TimeBase
from gcs_sysid.significance import FALSE_ALARM_RATE, normal_limit

WINDOW = 8192
"""IMU samples that are best taken at once."""
_STEP_BACK = 1.0
"""s; records further back than this are not late: the clock was set back."""


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
        newest_at: s, the newest sample there was when the block was given out.
        rebooted: whether it is fresh because the vehicle's clock was set back.
    """

    t: Array
    samples: Samples
    flying: Mask
    dt: float
    fresh: bool
    rotors: RotorSource | None = None
    newest_at: float = 0.0
    rebooted: bool = False

    def since(self, first: int) -> "SampleBlock":
        """The block without the samples before `first`."""
        return self.part(first, len(self.t))

    def part(self, first: int, stop: int) -> "SampleBlock":
        """Samples `first` to before `stop` of the block."""
        rows = slice(first, stop)
        return replace(
            self,
            t=self.t[rows],
            samples=self.samples.part(rows),
            flying=self.flying[rows],
            fresh=self.fresh and first == 0,
            rebooted=self.rebooted and first == 0,
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

    def part(self, first: int, stop: int) -> "_Held":
        """Samples `first` to before `stop`."""
        return _Held(
            self.block.part(first, stop),
            {name: values[first:stop] for name, values in self.rotors.items()},
            {name: values[first:stop] for name, values in self.stamps.items()},
        )

    @property
    def seconds(self) -> float:
        """How long it is."""
        return len(self.block.t) * self.block.dt

    @property
    def flies(self) -> bool:
        """Whether any of it is of flight."""
        return bool(np.isfinite(self.block.samples.gyro).any())


_Reading = tuple[RotorSource | None, str | None]
"""The selected rotor stream, and its twin."""


class Sampler:
    """Aligns records, filters the attitude, takes the gyro's bias off, marks flight.

    Until a rotor stream is selected, blocks are held back, so that none of the flight is lost.

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
        self.flight_detector = FlightDetector(rotor_selector.airframe.geometry)
        self._digital: set[str] = set()
        self._turned: dict[str, bool] = {}
        """Whether any rotor turned, by each rotor stream."""
        self.gyro_check = GyroCheck()
        """The gyro against the reported attitude, in flight."""
        self._filter: ComplementaryFilter | None = None
        self._jumps = VelocityJumps()
        self.boots: list[tuple[int, float]] = []
        """Order of the first sample of each, and s of its clock at the session's time zero."""
        self.turns: list[float] = []
        """s, rising, of take-offs and landings in turn."""
        self._first: float | None = None
        self._began = self._newest = 0.0

    @property
    def recorded(self) -> float | None:
        """Seconds of vehicle clock from the first record to the newest; None without any."""
        return None if self._first is None else self._newest - self._began

    @property
    def stands(self) -> str:
        """That no rotor ever turned, in words; empty where one did, or no stream shows any."""
        if not self._turned or any(self._turned.values()):
            return ""
        order = self.rotor_selector.order
        names = ", ".join(name + order.unknown(name) for name in sorted(self._turned))
        return f"never seen in the air: no rotor turns by {names}"

    def feed_records(self, block: RecordBlock) -> Iterator[SampleBlock]:
        """Take records that follow each other, parameters too; as of `feed_tracks`."""
        for part in block.windows(WINDOW):
            for _, parameter in part.parameters:
                self.rotor_selector.learn(parameter.source, parameter.values[0])
            yield from self.feed_tracks(part.tracks)

    def feed_tracks(self, tracks: Sequence[Track]) -> Iterator[SampleBlock]:
        """Take samples that follow each other, with their orders; the next blocks, one by one.

        How samples are grouped changes no number: what is decided (a rotor stream, flight, what
        is still held back) is decided at the ticks of the time base.
        """
        for part in self._without_steps_back([*self.rotor_selector.order.tracks(tracks)]):
            inside = list(self._inside(part))
            if not inside:
                continue
            self.seen |= {track.stream for track in inside}
            unseen = _Unseen(inside, self.rotor_selector)
            for block in self.time_base.feed_tracks(
                [track for track in inside if track.values.size]
            ):
                yield from self._take(block, unseen)
            unseen.show(None, flying=self.flying)

    def _without_steps_back(self, tracks: Sequence[Track]) -> Iterator[list[Track]]:
        """The samples, in parts in which the vehicle's clock is not set back (a reboot).

        The times of start and end go on counting over such a step.
        """
        left = [track for track in tracks if len(track.t)]
        while left:
            order = np.concatenate([track.order for track in left])
            t = np.concatenate([track.t for track in left])
            sorting = np.argsort(order, kind="stable")
            order, t = order[sorting], t[sorting]
            if self._first is None:
                self._first = self._began = self._newest = float(t[0])
                self.boots.append((int(order[0]), self._began))
            newest = np.maximum.accumulate(np.concatenate([[self._newest], t]))
            back = t < newest[:-1] - _STEP_BACK
            stop = int(np.argmax(back)) if back.any() else len(t)
            self._newest = float(newest[stop])
            if stop:
                rows = int(order[0]), int(order[stop - 1]) + 1
                yield [part for track in left if len((part := track.between(*rows)).t)]
            if stop == len(t):
                return
            self._began += float(t[stop]) - self._newest
            self._newest = float(t[stop])
            rows = int(order[stop]), int(order[-1]) + 1
            self.boots.append((rows[0], self._began))
            left = [part for track in left if len((part := track.between(*rows)).t)]

    def _inside(self, tracks: Iterable[Track]) -> Iterator[Track]:
        """Samples from start to end."""
        for track in tracks:
            since = np.maximum(track.t - self._began, 0.0)
            inside = (since >= self._start) & (since <= self._end)
            if inside.all():
                yield track
            elif inside.any():
                yield track.part(inside)

    def catch_up(self) -> Iterator[SampleBlock]:
        """The next blocks, up to now instead of to the last tick."""
        for block in self.time_base.catch_up():
            yield from self._take(block)

    def finish(self) -> Iterator[SampleBlock]:
        """What is still held back."""
        for block in self.time_base.finish():
            yield from self._take(block)
        if not self.rotor_selector.judged:
            self.rotor_selector.judge()
        yield from self._release(self.t)

    def _take(self, block: Block, unseen: "_Unseen | None" = None) -> Iterator[SampleBlock]:
        """Take a block of the grid, tick by tick; the blocks of samples that are ready.

        `unseen` are samples that the selector has not seen yet; None: it has seen all.
        """
        selector, flies = self.rotor_selector, self.flying
        held = self._samples(block)
        t, dt = held.block.t.tolist(), held.block.dt
        there = np.cumsum(np.isfinite(held.block.samples.gyro[:, 0])).tolist()
        flown = dt * np.diff(np.array([0, *there])[[0, *block.ends]])
        waits = bool(self._held)
        ready = first = 0  # points given out or held; points before the tick
        newest_at = t[0]
        for stop, order, seconds in zip(
            block.ends.tolist(), block.orders.tolist(), flown.tolist(), strict=True
        ):
            before, flew = self._reading, flies
            flies = bool(held.block.flying[stop - 1])
            fresh = block.fresh and first == 0
            if unseen is not None and (flies != flew or fresh or selector.is_due(seconds)):
                unseen.show(order, flying=flew)
            if fresh:
                selector.gap()
            if flew:  # else the selector has not seen what came in that time
                selector.fly(seconds)
            if flew and not flies and selector.choice is not None:
                selector.gap()  # samples since landing do not bear on the next flight
            waited = waits
            # Once there was a judgement nothing waits any more.
            judged = selector.choice is not None or selector.judged
            waits = not judged and self._waits(held.part(ready if waits else first, stop))
            if not waited and first > ready and (waits or self._reading != before):
                # What was ready at earlier ticks is read as was believed then.
                yield self._read(held.part(ready, first), before, newest_at)
                ready = first
            if waited and not waits:
                self._held.append(held.part(ready, stop))
                yield from self._release(t[stop - 1])
                ready = stop
            if ready >= first:
                newest_at = t[stop - 1]
            first = stop
        if waits:
            self._held.append(held.part(ready, first))
        elif first > ready:
            yield self._read(held.part(ready, first), self._reading, newest_at)

    @property
    def _reading(self) -> _Reading:
        return self.rotor_selector.choice, self.rotor_selector.twin

    def _waits(self, newest: _Held) -> bool:
        """Whether what is held, with the newest, may have a rotor stream yet."""
        held = [*self._held, newest]
        # For 10 s while no rotor stream is chosen.
        return sum(each.seconds for each in held) < 10.0 and any(e.flies for e in held)

    def _release(self, newest_at: float) -> Iterator[SampleBlock]:
        """The blocks held back, with the rotor stream now selected."""
        held, self._held = self._held, []
        for each in held:
            yield self._read(each, self._reading, newest_at)

    def _read(self, held: _Held, reading: _Reading, newest_at: float) -> SampleBlock:
        """A block with the rotor stream that was believed when it was ready."""
        choice, twin = reading
        samples = held.block.samples
        if choice is not None and choice.name in held.rotors:
            rotors, apart = self._joined(held, choice.name, twin)
            samples = replace(samples, speeds=choice.read(rotors), apart=apart)
        if np.isfinite(samples.speeds[-1]).all():
            self.rotor_speeds = tuple(samples.speeds[-1].tolist())
        return replace(held.block, samples=samples, rotors=choice, newest_at=newest_at)

    @staticmethod
    def _joined(held: _Held, name: str, second: str | None) -> tuple[Array, Array]:
        """(n, rotors) of a stream, with its twin where they are slow; (n, 1) s between both."""
        rotors = held.rotors[name]
        apart = np.full(len(rotors), np.nan)
        if second is not None and second in held.rotors and held.block.dt >= SLOW_COMMANDS:
            twin = held.rotors[second]
            both = complete_rows(rotors + twin)
            apart[both] = (held.stamps[name] - held.stamps[second])[both]
            rotors = mean_of(rotors, twin)
        return rotors, apart[:, None]

    def _samples(self, block: Block) -> _Held:
        assert self._first is not None
        rebooted = block.fresh and block.t[0] - self._first < self.t
        if rebooted:
            # The vehicle's clock stepped back; the session's time continues by that of all records.
            self._first = min(self._began, float(block.t[0]) - self.t)
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
        commands = {family(name) for kind, name, _ in block.values if kind is Stream.ROTOR_COMMAND}
        velocity = self._velocity(block, n, force)
        flying = self.flight_detector.update(
            t,
            _stream(block, Stream.IN_AIR, n, 1)[:, 0],
            _stream(block, Stream.ARMED, n, 1)[:, 0],
            self._turning(rotors, commands, n),
            velocity[:, 3:],
            force,
            gyro,
            self._thrust(rotors, commands, n),
        )
        # No vehicle flies on over it, whatever its recording left out.
        flying[0] &= not rebooted
        if rebooted and self.flying:
            self.turns.append(self.t)
        self.turns += t[np.diff(flying, prepend=self.flying and not rebooted)].tolist()
        self.time_base.flown += dt * int(np.count_nonzero(flying))
        gyro = np.where(flying[:, None], gyro, np.nan)
        self.gyro_check.update(t, gyro, reference, fresh=block.fresh)
        samples = Samples(
            gyro=gyro,
            rates=gyro - bias,
            speeds=np.full((n, self._rotors), np.nan),
            attitude=filtered,
            force=force,
            velocity=velocity[:, :3],
            setpoint=_stream(block, Stream.RATE_SETPOINT, n, 3),
            voltage=_stream(block, Stream.VOLTAGE, n, 1),
        )
        self.t = float(t[-1])
        self.flying = bool(flying[-1])
        self._show(samples)
        stamps = {family(key[1]): stamps for key, stamps in block.stamps.items()}
        return _Held(
            SampleBlock(t, samples, flying, dt, block.fresh, rebooted=rebooted), rotors, stamps
        )

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

    def _velocity(self, block: Block, n: int, force: Array) -> Array:
        """(n, 6) velocity as if no estimator had reset it, and position."""
        velocity = _stream(block, Stream.VELOCITY, n, 6)
        dt, known = self.time_base.dt, velocity[:, :3]
        velocity[:, :3] = self._jumps.without(dt, known, force, fresh=block.fresh)
        return velocity

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

    def _turning(self, rotors: dict[str, Array], commands: set[str], n: int) -> Array:
        """(n, rotors) above zero where a rotor turns, as far as any stream shows."""
        turning = np.full((n, self._rotors), np.nan)
        for name, values in rotors.items():
            least = _STOPPED_SPEED
            if name in commands:
                least = _STOPPED_COMMAND
                # The half is for what interpolation adds.
                start = self._starts(name, values)
                values = np.where((start > 0.0) & (values <= start + 0.5), 0.0, values)
            values = np.where(values <= least, 0.0, values)
            self._turned[name] = self._turned.get(name, False) or bool((values > 0.0).any())
            np.fmax(turning, values, out=turning)
        return turning

    def _starts(self, name: str, values: Array) -> Array:
        """(n, rotors) from where on a source's commands turn a motor."""
        if name not in self._digital and are_digital(name, self.rotor_selector.parameters, values):
            self._digital.add(name)
        return starts_of(name, values, digital=name in self._digital)

    def _thrust(self, rotors: dict[str, Array], commands: set[str], n: int) -> Array:
        """(n, 2) mean over rotors of squared speeds, and of commands: what thrust grows with."""
        out = np.full((n, 2), np.nan)
        for name, values in rotors.items():
            if name in commands:
                values = np.maximum(values - self._starts(name, values), 0.0)
            else:
                values = values**2
            k = int(name in commands)
            # A part of the rotors does not show what all do.
            out[:, k] = np.fmax(out[:, k], values.mean(axis=1))
        return out

    def _show(self, samples: Samples) -> None:
        if np.isfinite(samples.attitude[-1]).all():
            roll, pitch, yaw = attitude.to_euler(samples.attitude[-1])
            self.attitude = (float(roll), float(pitch), float(yaw))
        if np.isfinite(samples.rates[-1]).all():
            p, q, r = samples.rates[-1]
            self.rates = (float(p), float(q), float(r))


_STOPPED_SPEED, _STOPPED_COMMAND = 5.0, 1e-6
"""rad/s and commands up to which a rotor stands: none turns as slowly, but ESCs are noisy."""


@dataclass(frozen=True)
class _Jump:
    """A jump of the velocity.

    Attributes:
        first, last: grid points that it leads to, from the next block's first.
        before, after: (3,) m/s.
        felt: m/s^2, the most that the accelerometer measured from its ripples on.
    """

    first: int
    last: int
    before: Array
    after: Array
    felt: float

    def added(self, dt: float) -> Array:
        """(3,) m/s by which the velocity was reset: what the IMU felt too adds none."""
        change, lasted = self.after - self.before, dt * (self.last - self.first + 1)
        pace = change / lasted - (0.0, 0.0, GRAVITY)
        is_set = lasted <= RIPPLES and np.linalg.norm(pace) > self.felt
        return change if is_set else np.zeros(3)


RIPPLES = 0.1
"""s before and after a jump of the velocity: between slow readings it is a ramp, with ripples."""


class VelocityJumps:
    """Finds where a velocity changes by more than the accelerometer measured.

    Whatever the attitude, v' less gravity is as long as the specific force. By how much it is
    longer scatters with the noise of both; an estimator that resets its velocity stands out. One
    wind holds for a flight, so that what is added to the velocity is taken off it from then on.
    """

    _MEMORY = 10.0
    """s over which that scatter is averaged."""
    _LIMIT = normal_limit(FALSE_ALARM_RATE / 1000.0)
    """Of the scatter: one false jump in a minute or two, which costs a short gap."""

    def __init__(self) -> None:
        self._past = np.full((1, 6), np.nan)
        self._power = GRAVITY**2
        self._added = np.zeros(3)
        self._jump: _Jump | None = None

    def without(self, dt: float, velocity: Array, force: Array, *, fresh: bool) -> Array:
        """(n, 3) velocity without its jumps, missing while one and its ripples last.

        Args:
            dt: s between grid points.
            velocity: (n, 3) m/s.
            force: (n, 3) m/s^2, specific.
            fresh: whether nothing before them goes on.
        """
        n, ripples = len(velocity), round(RIPPLES / dt)
        if fresh or len(self._past) != ripples + 1:
            self._past = np.full((ripples + 1, 6), np.nan)
            self._added, self._jump = np.zeros(3), None
        values = np.vstack([self._past, np.hstack([velocity, force])])
        self._past = values[n:]
        apart = np.diff(values[ripples:, :3], axis=0) / dt - (0.0, 0.0, GRAVITY)
        norms = np.linalg.norm(values[:, 3:], axis=1)
        felt = np.maximum(norms[1:], norms[:-1])  # from the ripples before on
        excess = np.linalg.norm(apart, axis=1) - felt[ripples:]
        jumps: Mask = np.zeros(n, bool)
        known = np.isfinite(excess)
        if known.any():
            keep = math.exp(-dt / self._MEMORY)
            counted = np.clip(excess[known], -GRAVITY, GRAVITY) ** 2
            power, _ = lfilter([1.0 - keep], [1.0, -keep], counted, np.array([keep * self._power]))
            self._power = float(power[-1])
            jumps[known] = excess[known] > self._LIMIT * np.sqrt(power)
        out = velocity - self._added
        for at in (*np.flatnonzero(jumps).tolist(), n + ripples):
            if (jump := self._jump) is not None:
                over = jump.last + ripples + 1
                out[max(jump.last, 0) : over] = np.nan
                around = felt[max(jump.first, 0) : over + ripples]
                self._jump = jump = replace(jump, felt=float(np.nanmax(around, initial=jump.felt)))
                if over <= min(at, n):
                    added = jump.added(dt)
                    self._added = self._added + added
                    out[over:] -= added
                    self._jump = None
            if at < n:
                before, after = values[ripples + at : ripples + at + 2, :3]
                jump = self._jump or _Jump(at, at, before, after, 0.0)
                self._jump = replace(jump, last=at, after=after)
        if (jump := self._jump) is not None:
            self._jump = replace(jump, first=jump.first - n, last=jump.last - n)
        return out


class _Unseen:
    """Samples of rotors that the selector has not seen yet."""

    def __init__(self, tracks: Iterable[Track], selector: RotorSourceSelector) -> None:
        self._tracks = [
            track for track in tracks if track.stream in (Stream.ROTOR_SPEED, Stream.ROTOR_COMMAND)
        ]
        self._taken = [0] * len(self._tracks)
        self._selector = selector

    def show(self, order: int | None, *, flying: bool) -> None:
        """Show it those up to an order (None: all), if they came in flight."""
        came = []
        for number, track in enumerate(self._tracks):
            n = len(track.t) if order is None else int(np.searchsorted(track.order, order + 1))
            if n > self._taken[number]:
                came.append(track.part(slice(self._taken[number], n)))
            self._taken[number] = n
        if flying:
            self._selector.extend(sorted(came, key=lambda track: int(track.order[0])))


def _stream(block: Block, stream: Stream, n: int, width: int) -> Array:
    values = block.values.get((stream, "", 0))
    return np.full((n, width), np.nan) if values is None else values
