"""The streams of a whole log on one time axis, as hovering needs them."""

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.signals.columns import RecordBlock, Track, by_key
from gcs_sysid.signals.imu_checks import GyroAgainstAttitude, Saturated
from gcs_sysid.signals.motor_order import MotorOrder, in_any_order, out_of_order
from gcs_sysid.signals.records import Stream
from gcs_sysid.signals.rotor_readings import held_reading, odd_reading, together, unbalanced_reading
from gcs_sysid.signals.rotor_source_selector import (
    RotorSourceSelector,
    beside_escs,
    family,
    preference,
)
from gcs_sysid.signals.rotor_units import (
    UNSIGNED,
    Range,
    command_range,
    normalized,
    seen_of,
    turns_either_way,
)
from gcs_sysid.signals.sampling import Sampler

_LONGEST = 200_000.0
"""s of a log; what is stamped later is damaged."""
_CHANGE = 0.05
"""Share of its mean by which a speed changes in a flight; rounding to 100 rpm is half of that."""


@dataclass(frozen=True)
class RotorStream:
    """One source of rotor speeds or commands, rotor by rotor.

    Attributes:
        source: name of the message, without its group of rotors.
        samples: of each rotor, (n,) s and (n,) rad/s or commands of 0 to 1.
        rate: Hz, of the slowest rotor.
        range: of commands.
        outputs: commands in the autopilot's own unit; empty for speeds.
    """

    source: str
    samples: tuple[tuple[Array, Array], ...]
    rate: float
    range: Range | None = None
    outputs: tuple[tuple[Array, Array], ...] = ()

    @cached_property
    def share_times(self) -> bool:
        """Whether all rotors have their samples at the same times."""
        first = self.samples[0][0]
        return all(t is first or np.array_equal(t, first) for t, _ in self.samples)

    @cached_property
    def turned(self) -> float:
        """S for which the first rotor turns, or is to."""
        t, values = self.samples[0]
        apart = np.minimum(np.diff(t), 3.0 / self.rate)
        return float(apart[values[1:] > 0.0].sum())


@dataclass(frozen=True)
class FlightTimes:
    """When a vehicle flies, and how its IMU reads, as an analysis has it.

    Attributes:
        start: s on the vehicle's clock, of the session's time zero.
        t: (n,) s of the session, rising.
        flying: (n,) whether it flies from then on.
        gyro: what it reads of what the attitude turns.
        saturated: sensors at a limit.
    """

    start: float
    t: Array
    flying: Mask
    gyro: GyroAgainstAttitude | None = None
    saturated: tuple[Saturated, ...] = ()

    def at(self, t: Array) -> Mask:
        """(n,) whether it flies at (n,) s."""
        before = np.searchsorted(self.t, t, side="right") - 1
        flies: Mask = self.flying[np.maximum(before, 0)] & (before >= 0)
        return flies


@dataclass(frozen=True)
class Streams:
    """The streams of one log that hovering needs, on the session's time.

    Attributes:
        flight: in it.
        tracks: stream -> (n,) s and (n, width) values; IMU, attitude, velocity, states.
        speeds: the best source of measured speeds; None: none covers all rotors.
        commands: the best source of commands; None likewise.
        refused: source -> why not.
        misread: those of them of which a rotor reads what it does not do.
        doubts: what else the commands may be, where no speeds show it.
        extras: as of `telemetry.track_collector.Recording`.
    """

    flight: FlightTimes
    tracks: Mapping[Stream, tuple[Array, Array]]
    speeds: RotorStream | None
    commands: RotorStream | None
    refused: Mapping[str, str]
    misread: Mapping[str, str] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()
    extras: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)

    def rate(self, stream: Stream) -> float:
        """Hz between the gaps; 0 where there is none."""
        t, _ = self.tracks.get(stream, (np.empty(0), np.empty(0)))
        return rate_of(t)


def rate_of(t: Array) -> float:
    """Hz of times in s, by the median step; 0 where there are none."""
    steps = np.diff(t)
    steps = steps[steps > 0.0]
    return 1.0 / float(np.median(steps)) if len(steps) else 0.0


def flight_in(
    blocks: Sequence[RecordBlock],
    airframe: Airframe,
    autopilot: str,
    parameters: Mapping[str, float],
    sampler: Sampler | None = None,
) -> tuple[FlightTimes, list[Track]]:
    """When the vehicle flies, and the log's tracks on the session's time, which rises.

    Args:
        blocks: of the chosen vehicle.
        airframe: gives the number of rotors, and perhaps the range of commands.
        autopilot: "px4", "ardupilot" or another key.
        parameters: the autopilot's.
        sampler: that took all of it; None: another takes it.
    """
    if sampler is None:
        selector = RotorSourceSelector(airframe, None)
        selector.autopilot = autopilot
        for name, value in parameters.items():
            selector.learn(name, value)
        sampler = Sampler(selector, len(airframe.rotors))
        for block in blocks:
            deque(sampler.feed_records(block), 0)
        deque(sampler.finish(), 0)
    turns, last = np.array(sampler.turns), min(sampler.t, _LONGEST)
    stood = sampler.flight_detector.ground_test.stood
    t = np.unique([*turns, *np.ravel(stood), last])
    t = t[np.isfinite(t) & (t <= last)]
    flying = (np.searchsorted(turns, t, side="right") % 2 == 1) & (t < last)
    for start, end in stood:
        flying &= (t < start) | (t > end)
    boots = sampler.boots or [(0, 0.0)]
    gyro, saturation = sampler.gyro_check.result(), sampler.time_base.saturation
    tracks = [_in_session(track, boots) for block in blocks for track in block.tracks]
    flight = FlightTimes(boots[0][1], t, flying, gyro, saturation.found())
    return flight, [_steady(track) for track in by_key(tracks).values()]


def streams_of(
    blocks: Iterable[RecordBlock],
    airframe: Airframe,
    autopilot: str,
    parameters: Mapping[str, float],
    sampler: Sampler | None = None,
) -> Streams:
    """Gather the streams of a log; arguments as of `flight_in`."""
    flight, tracks = flight_in([*blocks], airframe, autopilot, parameters, sampler)
    return streams_in(flight, tracks, airframe, autopilot, parameters)


def streams_in(
    flight: FlightTimes,
    tracks: Iterable[Track],
    airframe: Airframe,
    autopilot: str,
    parameters: Mapping[str, float],
) -> Streams:
    """The streams in what `flight_in` gives, whose arguments the others are."""
    order = MotorOrder.of(autopilot, parameters, len(airframe.rotors))
    plain: dict[Stream, tuple[Array, Array]] = {}
    rotors: dict[tuple[Stream, str], list[Track]] = {}
    for track in order.tracks(tracks):
        if track.stream in (Stream.ROTOR_SPEED, Stream.ROTOR_COMMAND):
            rotors.setdefault((track.stream, family(track.source)), []).append(track)
        elif track.stream is not Stream.PARAMETER and len(track.t) > 1:
            plain[track.stream] = track.t, track.values
    refused: dict[str, str] = {}
    misread: dict[str, str] = {}
    count = len(airframe.rotors)
    live = [
        name
        for (stream, name), parts in rotors.items()
        if stream is Stream.ROTOR_SPEED and any(track.values.any() for track in parts)
    ]
    found: dict[Stream, list[RotorStream]] = {}
    for (stream, name), parts in rotors.items():
        samples = _per_rotor(parts, count)
        problem = _problem(samples, count)
        if stream is Stream.ROTOR_SPEED:
            unsigned = UNSIGNED if turns_either_way(parameters) else ""
            problem = problem or unsigned or beside_escs(name, live)
        if len(samples) < count:
            problem += order.gap_in(name, len(samples))
        if not problem and (wrong := _wrong_reading(stream, samples)):
            problem = wrong + order.unknown(name)
            if problem == wrong:
                misread[name] = wrong
        if problem:
            refused[name] = problem
            continue
        one = RotorStream(name, samples, min(rate_of(t) for t, _ in samples))
        if stream is Stream.ROTOR_COMMAND:
            seen = seen_of([v for _, v in samples])
            range_ = command_range(name, airframe.command, autopilot, parameters, seen)
            if isinstance(range_, str):
                refused[name] = range_
                continue
            raw = samples
            samples = tuple((t, normalized(v, range_).clip(0.0, None)) for t, v in samples)
            one = RotorStream(name, samples, one.rate, range_, raw)
        found.setdefault(stream, []).append(one)
    sources = {one.source: (stream, one.samples) for stream, some in found.items() for one in some}
    refused |= (unordered := out_of_order(sources, order))
    found = {
        stream: sound
        for stream, some in found.items()
        if (sound := [one for one in some if one.source not in unordered])
    }

    def rank(one: RotorStream) -> tuple[bool, float, int]:
        known = one.range is None or not one.range.assumed
        return known, min(one.rate, TUNING.enough_rate), -preference(one.source)

    best = {stream: max(sources, key=rank) for stream, sources in found.items()}
    speeds, commands = best.get(Stream.ROTOR_SPEED), best.get(Stream.ROTOR_COMMAND)
    if speeds is not None and commands is not None:
        odd = odd_reading(_turning(speeds), _turning(commands), airframe.geometry[2])
        if odd is not None and odd.by_command:
            misread[speeds.source], speeds = odd.words, None
    elif speeds is not None and (odd := unbalanced_reading(_turning(speeds), airframe.geometry)):
        misread[speeds.source], speeds = odd.words, None
    if speeds is not None:  # what is no rotor's in another order is not misread
        own = in_any_order(speeds.source)
        misread = {name: why for name, why in misread.items() if in_any_order(name) != own}
    doubt = order.doubt(commands.source) if commands is not None and speeds is None else ""
    doubts = (f"{commands.source} {doubt}",) if commands is not None and doubt else ()
    return Streams(flight, plain, speeds, commands, refused | misread, misread, doubts)


def _turning(stream: RotorStream) -> Array:
    """(n, rotors) readings while all rotors turn fast, as in flight; each at its own times."""
    values = together(stream.samples)
    least = values.min(axis=1)
    out: Array = values[least > 0.5 * float(np.percentile(least, 95.0))]
    return out


def _in_session(track: Track, boots: Sequence[tuple[int, float]]) -> Track:
    """A track on the session's time."""
    orders, zeros = zip(*boots, strict=True)
    boot = np.searchsorted(orders[1:], track.order, side="right")
    return replace(track, t=track.t - np.array(zeros)[boot])


def _steady(track: Track) -> Track:
    """The samples with a time that rises, and is that of a log."""
    if (np.diff(track.t) < 0.0).any():
        track = track.part(np.argsort(track.t, kind="stable"))
    sound = (np.diff(track.t, prepend=-np.inf) > 0.0) & (track.t < _LONGEST)
    return track if sound.all() else track.part(sound)


def _per_rotor(parts: Sequence[Track], count: int) -> tuple[tuple[Array, Array], ...]:
    """Times and values of each rotor that there is, up to `count`, in order."""
    out: list[tuple[Array, Array]] = []
    for track in sorted(parts, key=lambda track: track.offset):
        if track.offset != len(out):
            continue
        t, whole = track.t, bool(np.isfinite(track.values).all())
        for column in track.values.T:
            if whole:
                out.append((t, np.ascontiguousarray(column)))
            else:
                there = np.isfinite(column)
                out.append((t[there], column[there]))
    return tuple(out[:count])


def _problem(samples: Sequence[tuple[Array, Array]], count: int) -> str:
    if len(samples) < count:
        return f"lacks rotor {len(samples) + 1} of {count}"
    if any(len(t) < TUNING.fewest_samples for t, _ in samples):
        return "has too few samples"
    rate = min(rate_of(t) for t, _ in samples)
    if rate < TUNING.slowest_rotors:
        return f"comes at {rate:.1f} Hz; a hover needs {TUNING.slowest_rotors:g} Hz"
    return ""


def _wrong_reading(stream: Stream, samples: Sequence[tuple[Array, Array]]) -> str:
    """Which rotor reads what it does not do, if any does: nothing, one speed, or an old one."""
    silent = [i for i, (_, v) in enumerate(samples, 1) if not v.any()]
    if silent:
        return f"rotor {silent[0]} always reads 0"
    if stream is not Stream.ROTOR_SPEED:
        return ""
    turning = [v[v != 0.0] for _, v in samples]
    changes = np.array([float(np.ptp(v) / np.abs(v).mean()) for v in turning])
    constant = changes == 0.0
    if constant.any() and not constant.all() and changes[~constant].min() > _CHANGE:
        return f"rotor {int(np.argmax(constant)) + 1} always reads the same"
    return held_reading(samples)
