"""Watches records go by, in bounded memory: flight, rates, gaps, repeats, ranges, motion.

Samples are gathered in chunks and looked at as arrays, because a log has a million of them.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.inspection.facts import AxisMotion, ChosenSource, FlightBy, RotorFacts, RotorMessage
from gcs_sysid.model.airframe import Airframe, Rotor, ScaleReference
from gcs_sysid.signals.columns import RecordBlock, stacked
from gcs_sysid.signals.imu_checks import GyroAgainstAttitude, Saturated
from gcs_sysid.signals.records import Stream
from gcs_sysid.signals.rotor_source_selector import RotorSourceSelector
from gcs_sysid.signals.rotor_units import RADIANS, RotorSource
from gcs_sysid.signals.sampling import SampleBlock, Sampler
from gcs_sysid.telemetry.clock import JUMP_BACK
from gcs_sysid.telemetry.monitor import Counts, SampleLoss


class FlightWatch:
    """When the vehicle flies, as the chain's samples have it.

    Attributes:
        known: s of the session up to which that is known.
    """

    def __init__(self, sampler: Sampler) -> None:
        self._sampler = sampler
        self.known = -math.inf

    def flying(self, t: Array) -> Mask:
        """(n,) whether it flies at (n,) s of what is known."""
        return np.searchsorted(self._sampler.turns, t, side="right") % 2 == 1

    @property
    def spans(self) -> list[tuple[float, float]]:
        """S from take-off to landing, of each flight; what still flies lands now."""
        detector, turns = self._sampler.flight_detector, [*self._sampler.turns, self._sampler.t]
        found: list[tuple[float, float]] = []
        for counted, t in zip(turns[::2], turns[1::2], strict=False):
            landed = min([t, *(a for a, b in detector.ground_test.stood if b > counted)])
            # Less than a second is a jump of the judgement.
            if landed - counted >= 1.0 and len(found) < 1000:
                found.append((detector.left_ground.get(counted, counted), landed))
        return found


class ChainWatch:
    """Asks the chain's own selector and detector, on the chain's own samples, which rotor stream to
    use, when the vehicle flies, and whether its IMU reads what it should.

    Args:
        airframe: whose rotors; its anchor is used where it has one.
        autopilot: "px4", "ardupilot".
    """

    def __init__(self, airframe: Airframe, autopilot: str) -> None:
        own = airframe.anchor()
        self._rotor_selector = RotorSourceSelector(airframe, ScaleReference(*own) if own else None)
        self._rotor_selector.autopilot = autopilot
        self._sampler = Sampler(self._rotor_selector, len(airframe.rotors))
        self._believed: RotorSource | None = None
        self.flight = FlightWatch(self._sampler)

    def add_records(self, block: RecordBlock) -> None:
        """Take records, of whatever streams."""
        self._note(self._sampler.feed_records(block))

    def finish(self) -> None:
        """Nothing follows."""
        self._note(self._sampler.finish())
        self.flight.known = math.inf

    @property
    def has_samples(self) -> bool:
        """Whether an IMU came, without which there are none."""
        return Stream.IMU in self._sampler.seen

    @property
    def recognized_by(self) -> FlightBy:
        """As `Inspection.flight_told_by` says."""
        seen = self._sampler.seen
        if Stream.IN_AIR in seen:
            return "autopilot"
        if seen & {Stream.ROTOR_SPEED, Stream.ROTOR_COMMAND}:
            return "rotors"
        return "arming" if Stream.ARMED in seen else ""

    @property
    def gyro(self) -> GyroAgainstAttitude | None:
        """What it reads of what the attitude turns."""
        return self._sampler.gyro_check.result()

    @property
    def saturated(self) -> tuple[Saturated, ...]:
        """Sensors that stood at a limit."""
        return self._sampler.time_base.saturation.found()

    def chosen(self, sources: Sequence[RotorMessage]) -> ChosenSource:
        """The source that identification uses at the end."""
        believed, rotor_selector = self._believed, self._rotor_selector
        refused = rotor_selector.refused if believed is None else believed.refused or {}
        reasons = [f"{name} {why}" for name, why in refused.items()]
        if believed is None:
            return ChosenSource(None, tuple(reasons), rotor_selector.judged)
        assumed = rotor_selector.doubt(believed, seen=True).assumed  # no IMU is looked at for lines
        if believed.kind.motors or believed.scale == RADIANS or assumed:
            reasons.append(f"rotors from {believed.name}, {believed.why}")
        span = believed.range
        return ChosenSource(
            next((source for source in sources if source.message == believed.name), None),
            tuple(reasons),
            rotor_selector.judged,
            None if span is None else (span.low, span.high),
            "" if span is None else span.origin,
            assumed,
        )

    def _note(self, blocks: Iterable[SampleBlock]) -> None:
        for block in blocks:
            self._believed = block.rotors or self._believed
            self.flight.known = float(block.t[-1])


USUAL = 4
"""Rotors of a vehicle whose type does not give their number."""


def assumed_airframe(rotors: int) -> Airframe:
    """So many rotors on a circle: enough to judge their telemetry, where no scale is known."""
    angles = [2.0 * math.pi * i / rotors for i in range(rotors)]
    return Airframe(
        "assumed",
        tuple(Rotor(math.cos(a), math.sin(a), 1 - 2 * (i % 2)) for i, a in enumerate(angles)),
    )


CHUNK = 4096
"""Samples gathered before they are looked at."""
UNWATCHED = (Stream.IN_AIR, Stream.ARMED, Stream.RATE_SETPOINT)
"""Of which no rate is shown: nothing needs them."""
BIN = 0.1
"""s over which the gyro is averaged for the motion of an axis."""


def set_back(t: Array, newest: float) -> list[int]:
    """Rows of (n,) times in s at which the clock was set back, from the newest before on."""
    found: list[int] = []
    at = 0
    while at < len(t):
        some = t[at : at + CHUNK]
        before = np.maximum.accumulate(np.append(newest, some))
        back = np.flatnonzero(some < before[:-1] - JUMP_BACK)
        if len(back):
            at += int(back[0])
            found.append(at)
            newest = float(t[at])
            at += 1
        else:
            newest = float(before[-1])
            at += len(some)
    return found


@dataclass
class Tally:
    """Counts of one stream."""

    loss: SampleLoss = field(default_factory=SampleLoss)
    compared: int = 0
    repeats: int = 0

    @property
    def counts(self) -> Counts:
        """By the stamps."""
        return self.loss.counts

    @property
    def rate(self) -> float | None:
        """Hz between gaps, counting what is missing; None until two samples came."""
        counts = self.counts
        return counts.steps / counts.seconds if counts.seconds > 0.0 else None

    @property
    def repeats_percent(self) -> float:
        """Samples with the values of the one before."""
        return 100.0 * self.repeats / max(self.compared, 1)


class StreamWatch:
    """Gathers the samples of one stream.

    Attributes:
        flying: whether what comes is of flight.
        boot: after how many reboots it comes.
        flight: counts while flying.
        ground: counts of all other time.
    """

    def __init__(self) -> None:
        self.flying, self.boot = False, 0
        self.flight = Tally()
        self.ground = Tally()
        self._t: list[Array] = []
        self._values: list[Array] = []
        self._room = CHUNK
        self._last: float | None = None
        self._last_values: Array | None = None

    def begin(self, *, flying: bool, boot: int) -> None:
        """What comes next is of flight or not, and of a boot: nothing joins on over a reboot."""
        if boot != self.boot:
            self._last = self._last_values = None
        self.flying, self.boot = flying, boot
        (self.flight if flying else self.ground).loss.restart()

    def add(self, t: Array, values: Array) -> int:
        """Add (n,) s and (n, width) values until there are enough to look at; how many it took."""
        taken = min(len(t), self._room)
        self._t.append(t[:taken])
        self._values.append(values[:taken])
        self._room -= taken
        return taken

    @property
    def full(self) -> bool:
        """Whether there is enough to look at."""
        return self._room == 0

    @property
    def tally(self) -> Tally:
        """The counts that matter: those in flight, where there was flight."""
        return self.flight if self.flight.counts.received > 1 else self.ground

    def cut_chunk(self) -> tuple[Array, Array]:
        """Look at what was gathered; the samples that came in rising time, (n,) s and values.

        NaN where a sample has fewer values than others.
        """
        if not self._t:
            return np.empty(0), np.empty((0, 0))
        t, values = np.concatenate(self._t), stacked(self._values)
        self._t.clear()
        self._values.clear()
        self._room = CHUNK
        before = -np.inf if self._last is None else self._last
        newest = np.maximum.accumulate(np.concatenate(([before], t)))
        fresh = t > newest[:-1]
        t, values = t[fresh], values[fresh]
        if not len(t):
            return t, values
        tally = self.flight if self.flying else self.ground
        tally.loss.add_times(t)
        self._count_repeats(tally, values)
        self._last = float(t[-1])
        self._last_values = values[-1].copy()
        return t, values

    def _count_repeats(self, tally: Tally, values: Array) -> None:
        if self._last_values is not None and len(self._last_values) == values.shape[1]:
            values = np.vstack([self._last_values, values])
        same = np.all((values[1:] == values[:-1]) | np.isnan(values[1:]), axis=1)
        tally.compared += len(same)
        tally.repeats += int(same.sum())


class RotorWatch:
    """Range of every rotor in one stream, while flying."""

    def __init__(self) -> None:
        self._count = np.zeros(0)
        self._sum = np.zeros(0)
        self._zeros = np.zeros(0)
        self._low = np.zeros(0)
        self._high = np.zeros(0)

    def add_values(self, values: Array) -> None:
        """(n, rotors) samples in flight."""
        more = values.shape[1] - len(self._count)
        if more > 0:
            self._count, self._sum, self._zeros = (
                np.pad(a, (0, more)) for a in (self._count, self._sum, self._zeros)
            )
            self._low = np.pad(self._low, (0, more), constant_values=np.inf)
            self._high = np.pad(self._high, (0, more), constant_values=-np.inf)
        known = np.isfinite(values)
        own = slice(0, values.shape[1])
        self._count[own] += known.sum(axis=0)
        self._sum[own] += np.where(known, values, 0.0).sum(axis=0)
        self._zeros[own] += (values == 0.0).sum(axis=0)
        self._low[own] = np.fmin(self._low[own], np.fmin.reduce(values, axis=0))
        self._high[own] = np.fmax(self._high[own], np.fmax.reduce(values, axis=0))

    def rotors(self) -> list[RotorFacts]:
        """One entry for each rotor; none before anything came."""
        return [
            RotorFacts(low, high, total / count, 100.0 * zeros / count)
            for low, high, total, zeros, count in zip(
                *(a.tolist() for a in (self._low, self._high, self._sum, self._zeros, self._count)),
                strict=True,
            )
            if count
        ]


class MotionWatch:
    """How the three axes are moved, from a gyro however noisy.

    The gyro is averaged over bins, even and odd samples apart. White noise of the two is
    independent, so that the mean of their product holds the motion alone.
    """

    def __init__(self) -> None:
        self._bins = self._pairs = 0
        self._sum = np.zeros(3)
        self._rate_power = np.zeros(3)
        self._acceleration_power = np.zeros(3)

    def add_rates(self, t: Array, gyro: Array) -> None:
        """Take (n,) times in s and (n, 3) rates in rad/s of one stretch of flight."""
        width = max(BIN, 4.0 * float(np.median(np.diff(t))))
        place = ((t - t[0]) / width).astype(int)
        if place[-1] > 10 * len(t):  # a hole of many minutes: empty bins beyond all measure
            return
        even = _means(place[::2], gyro[::2], place[-1] + 1)
        odd = _means(place[1::2], gyro[1::2], place[-1] + 1)
        there: Mask = np.asarray(np.isfinite(even + odd).all(axis=1))
        self._bins += int(there.sum())
        self._sum += 0.5 * (even + odd)[there].sum(axis=0)
        self._rate_power += (even * odd)[there].sum(axis=0)
        product = np.diff(even, axis=0) * np.diff(odd, axis=0) / width**2
        both = there[1:] & there[:-1]
        self._pairs += int(both.sum())
        self._acceleration_power += product[both].sum(axis=0)

    def motion(self) -> list[AxisMotion]:
        """Roll, pitch, yaw; empty when there was too little to say."""
        if self._pairs < 10:
            return []
        rate = self._rate_power / self._bins - (self._sum / self._bins) ** 2
        acceleration = self._acceleration_power / self._pairs
        return [
            AxisMotion(r, a)
            for r, a in zip(
                np.sqrt(np.maximum(rate, 0.0)).tolist(),
                np.sqrt(np.maximum(acceleration, 0.0)).tolist(),
                strict=True,
            )
        ]


def _means(place: Array, values: Array, count: int) -> Array:
    """(count, 3) means of the rows at each place; NaN where there are none."""
    n = np.bincount(place, minlength=count)
    sums = [np.bincount(place, weights=column, minlength=count) for column in values.T]
    return np.column_stack(sums) / np.where(n, n, np.nan)[:, None]
