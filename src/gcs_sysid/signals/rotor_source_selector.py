"""Selects the rotor stream: the soundest of those received, judged in flight.

Each source's samples over a stretch of flight are kept, then judged: does it cover all rotors,
often enough, do its values change, are measured speeds more than the command repeated, is rpm
really rpm. Measured speeds are preferred, because they do not depend on batteries and motors. The
decision depends on the records and their order alone. It is reviewed in every further stretch: a
source that dies is replaced by a sound one.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.model.airframe import Airframe, ScaleReference
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.signals.columns import Track
from gcs_sysid.signals.motor_order import (
    MotorOrder,
    in_any_order,
    is_function,
    is_in_several_orders,
    out_of_order,
)
from gcs_sysid.signals.records import ROTOR_STREAMS, Stream
from gcs_sysid.signals.redundant_commands import say_the_same, twin_of
from gcs_sysid.signals.rotor_readings import (
    AGE,
    OddReading,
    held_reading,
    late_reading,
    moved_columns,
    odd_reading,
    together,
    unbalanced_reading,
    unlike_squares,
)
from gcs_sysid.signals.rotor_units import (
    PARAMETER_NAMES,
    RADIANS,
    UNSIGNED,
    Range,
    RotorSource,
    UnitDoubt,
    command_range,
    normalized,
    seen_of,
    speed_scale,
    turns_either_way,
    unit_doubt,
)

STRETCH = 2.5
"""s of flight used for a judgement."""
MIN_RATE = 15.0
"""Hz. Slower streams do not follow the rotors."""
_LAGS = 0.5
"""Share of the others' new readings, below which those of one rotor are old."""
_MOST = 2048
"""Samples of a source kept in a stretch."""
_MOVES = 0.01
"""Change in a stretch, relative to the mean, from which a rotor counts as alive."""
_FULL_SCALES = (1.0, 2000.0, 2047.0, 8191.0, 65535.0)
"""Greatest commands of the usual units."""
_TOUCHES = 0.998
"""Share of the greatest speed or command from which another rotor has been at the same limit."""
_SAME = 0.02
"""Error, relative to the change, below which speeds are a function of the command."""
_LAG = 0.1
"""s, longer than any motor's."""

_ORDER = ("ESC_STATUS", "esc_status", "ESC", "ESC_TELEMETRY", "RPM",
          "actuator_motors", "ACTUATOR_OUTPUT_STATUS", "SERVO_OUTPUT_RAW", "RCOU")  # fmt: skip
"""Of equals, the first; others after them."""


def preference(source: str) -> int:
    """By which sources of one kind and rate are taken, the least first."""
    name = in_any_order(source)
    return _ORDER.index(name) if name in _ORDER else len(_ORDER)


def beside_escs(source: str, live: Iterable[str]) -> str:
    """Why RPM sensors, which are of any rotor, are no input where ESCs report; else empty."""
    other = next((name for name in live if name != source), "") if source == "RPM" else ""
    return other and f"is of RPM sensors, beside {other}"


def family(source: str) -> str:
    """Name of a source without the group of rotors that one of its messages is for."""
    return re.sub(r"_\d+_TO_\d+$", "", source)


@dataclass
class _RotorGroup:
    """What came for some neighboring rotors."""

    count: int = 0
    pieces: list[tuple[Array, Array]] = field(default_factory=list)

    def whole(self) -> tuple[Array, Array]:
        """(n,) times and (n, rotors) values; rotors that are in all messages."""
        width = min(values.shape[1] for _, values in self.pieces)
        t = np.concatenate([t for t, _ in self.pieces])
        return t, np.concatenate([values[:, :width] for _, values in self.pieces])


@dataclass
class Stretch:
    """What one source sent over a stretch of flight.

    Attributes:
        stream: speeds or commands.
        count: of rotors.
        groups: first rotor -> the messages for that group.
    """

    stream: Stream
    count: int
    groups: dict[int, _RotorGroup] = field(default_factory=dict)

    def extend(self, track: Track) -> None:
        """Keep the samples of a track, while there is room."""
        group = self.groups.setdefault(track.offset, _RotorGroup())
        room = max(_MOST - group.count, 0)
        if room:
            group.pieces.append((track.t[:room], track.values[:room]))
            group.count += len(track.t[:room])

    @property
    def rotors(self) -> list[tuple[Array, Array]]:
        """Times and values of each rotor that there is, up to `count`, in order."""
        out: list[tuple[Array, Array]] = []
        for offset, group in sorted(self.groups.items()):
            if offset == len(out):
                t, values = group.whole()
                out += [(t, column) for column in values.T]
        return out[: self.count]

    @property
    def values(self) -> list[Array]:
        """(n,) of each rotor."""
        return [v for _, v in self.rotors]

    @property
    def together(self) -> Array:
        """(n, rotors) of all."""
        return together(self.rotors)


@dataclass
class Repeats:
    """Messages of one source that repeat the values of the one before under a later stamp."""

    compared: int = 0
    repeated: int = 0
    _last: dict[int, tuple[Array, Array]] = field(default_factory=dict)

    def extend(self, track: Track) -> None:
        """Compare the messages of a track with those before for the same rotors."""
        t, values = track.t, track.values
        last_t, last = self._last.get(track.offset, (t[:0], values[:0]))
        if last.shape[1:] == values.shape[1:]:
            t, values = np.concatenate([last_t, t]), np.concatenate([last, values])
        elif len(last) and t[0] > last_t[0]:  # it had more or fewer rotors
            self.compared += 1
        later = np.diff(t) > 0.0
        self.compared += int(np.count_nonzero(later))
        same = (values[1:] == values[:-1]).all(axis=1)
        self.repeated += int(np.count_nonzero(same & later))
        self._last[track.offset] = t[-1:], values[-1:]

    def as_dict(self) -> dict[str, float]:
        """For the result's `telemetry`."""
        return {
            "count": self.repeated,
            "percent": 100.0 * self.repeated / max(self.compared, 1),
        }


class RotorSourceSelector:
    """Chooses the source of the rotors' input.

    Args:
        airframe: that flies.
        anchor: of the scale; may be replaced. With k_T or T_max only one kind of input makes sense;
            None while unknown: then it cannot be checked whether the speeds could carry the
            vehicle.
    """

    def __init__(self, airframe: Airframe, anchor: ScaleReference | None) -> None:
        self.choice: RotorSource | None = None
        """None until there was a stretch of flight, and while no source is sound."""
        self.twin: str | None = None
        """Another source of commands that says what the chosen one says."""
        self.refused: dict[str, str] = {}
        """Source -> why it was not chosen, from the latest judgement."""
        self._autopilot = ""
        self.parameters: dict[str, float] = {}
        """Those of the autopilot that matter here."""
        self.judged = False
        """Whether there was any judgement yet."""
        self.repeats: dict[str, Repeats] = {}
        """Source -> repeats in flight."""
        self.never_moved = False
        """Whether the latest choice was lost for a rotor that has stood still ever since."""
        self.stale: dict[str, str] = {}
        """Source of speeds -> that it held old readings at any time, where it does not show too."""
        self._standing: set[tuple[int, float]] = set()
        self._misread: dict[str, str] = {}
        self._found_dead: dict[str, set[tuple[int, float]]] = {}
        self.airframe = airframe
        self._order: MotorOrder | None = None
        self.anchor = anchor
        self._restart()

    @property
    def autopilot(self) -> str:
        """The vehicle's, "px4", "ardupilot" or another key; "" while unknown."""
        return self._autopilot

    @autopilot.setter
    def autopilot(self, key: str) -> None:
        self._autopilot, self._order = key, None

    @property
    def order(self) -> MotorOrder:
        """Which motor each output drives: what the choice rests on, else by what is known now."""
        return self._known_order if self.choice is None else self.choice.order

    @property
    def _known_order(self) -> MotorOrder:
        if self._order is None:
            count = len(self.airframe.rotors)
            self._order = MotorOrder.of(self._autopilot, self.parameters, count)
        return self._order

    def learn(self, name: str, value: float) -> None:
        """Take a parameter of the autopilot."""
        if name.startswith(PARAMETER_NAMES) or is_function(name):
            self.parameters[name] = value
            self._order = None

    def extend(self, tracks: Sequence[Track]) -> None:
        """Take the samples of a while of flight; those of rotors count."""
        for track in tracks:
            if track.stream in ROTOR_STREAMS and len(track.t):
                name = family(track.source)
                stretch = Stretch(track.stream, len(self.airframe.rotors))
                self._stretches.setdefault(name, stretch).extend(track)
                self.repeats.setdefault(name, Repeats()).extend(track)

    @property
    def outdated(self) -> bool:
        """Whether parameters that came since would have given the commands another range."""
        if self.choice is None:
            return False
        used, now = self.choice.range, self._range_now(self.choice)
        if self.choice.order != self._known_order:
            return True
        return used is not None and now is not None and (now.low, now.high) != (used.low, used.high)

    def _range_now(self, source: RotorSource) -> Range | None:
        """The range of commands by the parameters that there are now."""
        if source.range is None:
            return None
        command, seen = self.airframe.command, (source.range.low, source.range.high)
        found = command_range(source.name, command, self.autopilot, self.parameters, seen)
        return source.range if isinstance(found, str) else found

    def doubt(self, source: RotorSource, *, seen: bool = False) -> UnitDoubt:
        """What the unit of a source is still in doubt by, as of `unit_doubt`."""
        range_ = self._range_now(source)
        return unit_doubt(source.name, range_, self.parameters, self.airframe, seen=seen)

    def gap(self) -> None:
        """The clock or the stream restarted: so does the stretch."""
        self._restart()

    def is_due(self, seconds: float) -> bool:
        """Whether so much more flight brings a judgement."""
        return self._seconds + seconds >= STRETCH

    def fly(self, seconds: float) -> bool:
        """So much flight went by. Returns whether a judgement was made."""
        self._seconds += seconds
        if self._seconds < STRETCH:
            return False
        self.judge()
        return True

    def judge(self) -> None:
        """Judge what came since the last judgement."""
        if self._seconds <= 0.0:
            return
        self.judged = True
        refused = {}
        judgements = {}
        for name, stretch in self._stretches.items():
            problem = self._unsound(name, stretch) or self._dead(name, stretch)
            if problem:
                refused[name] = problem
            else:
                judgements[name] = stretch
        for name, problem in self._out_of_order(judgements).items():
            if self.choice is None or self.choice.name != name:  # an order is decided once
                refused[name] = problem
                del judgements[name]
        for name, problem in self._moved(judgements).items():
            refused[name] = problem
            del judgements[name]
        if self.choice is not None:
            self._standing &= self._standing_in(self._stretches.get(self.choice.name))
            self.never_moved = bool(self._standing)
        if self.choice is not None and self.choice.name in judgements:
            self.twin = self._twin(self.choice, judgements)
            self._restart()
            return
        chosen = self._choose(judgements, refused)
        gone = ""
        if self.choice is not None:
            name = self.choice.name
            gone = f"{name} died in flight ({refused.get(name, 'no data')}); "
        if chosen is not None:
            assumed = self.doubt(chosen, seen=True).assumed  # what the IMU shows comes later
            why = gone + chosen.why + (f" ({assumed})" if assumed else "")
            chosen = replace(chosen, why=why, refused=refused, order=self.order)
        self.choice, self.refused = chosen, refused
        self.twin = None if chosen is None else self._twin(chosen, judgements)
        if chosen is not None:
            self._standing = self._standing_in(self._stretches[chosen.name])
        self._restart()

    def _restart(self) -> None:
        self._stretches: dict[str, Stretch] = {}
        self._seconds = 0.0

    def _unsound(self, name: str, stretch: Stretch) -> str:
        """Why a stretch of a source cannot be used; empty when it can."""
        rotors, n = stretch.rotors, len(stretch.rotors)
        if n < stretch.count:
            return f"lacks rotor {n + 1} of {stretch.count}{self.order.gap_in(name, n)}"
        rotors, seconds = _until_landing(rotors, self._seconds)
        rate = min(len(t) for t, _ in rotors) / seconds
        if rate < MIN_RATE:
            return f"comes at {rate:.1f} Hz, too slow to follow the rotors"
        values = [v for _, v in rotors]
        if not any(v.any() for v in values):
            return "reads 0 in flight"
        if stretch.stream is Stream.ROTOR_SPEED:
            if turns_either_way(self.parameters):
                return UNSIGNED
            if beside := beside_escs(name, self._live):
                return beside
            fresh = [_readings(*rotor) for rotor in rotors]
            if max(fresh) < MIN_RATE:
                return f"repeats old readings, {max(fresh):.0f} new ones a second"
            known = {i: new for i, new in enumerate(fresh) if np.ptp(values[i]) and new < math.inf}
            if known:
                rotor = min(known, key=known.__getitem__)
                least, usual = known[rotor], float(np.median([*known.values()]))
                # Whole rpm repeat by chance, but not every other time.
                if least < _LAGS * usual and 0.5 / least - 0.5 / usual > AGE:
                    return (
                        f"repeats old readings of rotor {rotor + 1}, {least:.0f} new ones a second"
                    )
            if all(map(np.ptp, values)) and (held := held_reading(rotors)):
                self.stale[name] = f"{name} {held}"
                return held
        return ""

    @property
    def _live(self) -> Iterator[str]:
        """Sources of speeds that read any."""
        for name, stretch in self._stretches.items():
            if stretch.stream is Stream.ROTOR_SPEED and any(v.any() for v in stretch.values):
                yield name

    def _dead(self, name: str, stretch: Stretch) -> str:
        """Why a rotor of a stretch that is otherwise sound is dead telemetry; empty if none is.

        One that was found dead stays so while it reads the same, whether the others move or not.
        """
        values = stretch.values
        standing = _standing(values)
        still = [i for i, _ in sorted(standing) if not _saturates(i, values)]
        known = self._found_dead.pop(name, set()) & standing
        if not still:
            return ""
        turn = [v for i, v in enumerate(values) if i not in still]
        moves = [np.ptp(v) / max(np.abs(v).mean(), 1e-9) for v in turn]
        stopped = stretch.stream is Stream.ROTOR_SPEED and any(not values[i].any() for i in still)
        moving = bool(turn) and (stopped or float(np.median(moves)) > _MOVES)
        if not moving and not known:
            return ""
        self._found_dead[name] = standing if moving else known
        rotor = min(still if moving else (i for i, _ in known))
        reads = f"reads {values[rotor][0]:.0f}" if values[rotor][0] == 0.0 else "stands still"
        return f"rotor {rotor + 1} {reads}" + (" while the others move" if moving else " as before")

    def _standing_in(self, stretch: Stretch | None) -> set[tuple[int, float]]:
        """Rotors of constant reading in a stretch, with that reading."""
        return set() if stretch is None else _standing(stretch.values)

    def _choose(
        self, stretches: Mapping[str, Stretch], refused: dict[str, str]
    ) -> RotorSource | None:
        wanted = self.airframe.wanted_input
        if wanted is None and self.anchor is not None:
            wanted = RotorInput.scaled_by(self.anchor.kind)
        commands = self._ranked(stretches, Stream.ROTOR_COMMAND)
        speeds = self._ranked(stretches, Stream.ROTOR_SPEED)
        for name in speeds if wanted in (None, RotorInput.SPEED) else ():
            stretch = stretches[name]
            copied = next((c for c in commands if self._copies(stretch, stretches[c])), None)
            if copied is not None:
                refused[name] = f"is {copied} under another name, not a measurement"
                continue
            odd = next(filter(None, (self._odd(stretch, stretches[c]) for c in commands)), None)
            if odd is not None and odd.by_command:
                refused[name] = odd.words
                continue
            measured = stretch.together
            if not commands and (odd := unbalanced_reading(measured, self.airframe.geometry)):
                self._misread[name] = odd.words
            if name in self._misread:  # a pole count is the same all the time
                refused[name] = self._misread[name]
                continue
            why, anchor = RotorInput.SPEED.words, self.anchor
            mass = None if anchor is None or anchor.kind != "mass" else anchor.value
            scale = speed_scale(name, stretch.values, self.airframe, mass, self.parameters)
            if scale == RADIANS:
                why += ", read as rad/s in an rpm field, by the thrust needed"
            return RotorSource(
                RotorInput.SPEED,
                name,
                why,
                scale=scale,
                interval=_apart(stretch),
                stops=_stops(stretch.rotors),
                unlike=self._unlike(measured, stretches, commands[:1]),
            )
        for name in commands if wanted in (None, RotorInput.COMMAND) else ():
            range_ = self._range(name, stretches[name])
            if isinstance(range_, str):
                refused[name] = range_
                continue
            if all(v.max() <= range_.low for v in stretches[name].values):
                refused[name] = "shows rotors stopped or idling all the time"
                continue
            asked = wanted is not None
            why = "commands, as requested" if asked else "commands: no usable measured speeds"
            return RotorSource(RotorInput.COMMAND, name, why, range=range_)
        for name in stretches:
            refused.setdefault(name, f"{wanted or 'auto'} is wanted")
        return None

    def _out_of_order(self, stretches: Mapping[str, Stretch]) -> dict[str, str]:
        """Of streams that came in several orders those not to be used, and why."""
        sources = {name: (each.stream, each.rotors) for name, each in stretches.items()}
        return out_of_order(sources, self.order)

    def _moved(self, stretches: Mapping[str, Stretch]) -> dict[str, str]:
        """Of speeds that follow another's command, or late, those not to be used, and why."""
        commands = self._ranked(stretches, Stream.ROTOR_COMMAND)[:1]
        found = {
            name: moved_columns(*both) or late_reading(*both)
            for asked in commands
            for name in self._ranked(stretches, Stream.ROTOR_SPEED)
            if not is_in_several_orders(name)
            for both in [[stretches[each].rotors for each in (name, asked)]]
        }
        return {name: problem for name, problem in found.items() if problem}

    def _twin(self, choice: RotorSource, stretches: Mapping[str, Stretch]) -> str | None:
        name = twin_of(choice.name)
        if name is None or name not in stretches or choice.name not in stretches:
            return None
        same = say_the_same(stretches[choice.name].rotors, stretches[name].rotors)
        return name if same else None

    def _ranked(self, stretches: Mapping[str, Stretch], stream: Stream) -> list[str]:
        """The sources of a stream, the best first: those near the highest rate, in order."""
        rates = {
            name: min(len(t) for t, _ in stretch.rotors)
            for name, stretch in stretches.items()
            if stretch.stream is stream
        }
        most = max(rates.values(), default=0)

        def rank(name: str) -> tuple[bool, int, str]:
            return rates[name] < 0.7 * most, preference(name), name

        return sorted(rates, key=rank)

    def _range(self, name: str, stretch: Stretch) -> Range | str:
        command, seen = self.airframe.command, seen_of(stretch.values)
        return command_range(name, command, self.autopilot, self.parameters, seen)

    def _copies(self, speeds: Stretch, commands: Stretch) -> bool:
        """Whether the speeds are a function of the commands at the same time."""
        pairs = zip(speeds.rotors, commands.rotors, strict=True)
        return all(_is_function(*speed, *command) for speed, command in pairs)

    def _odd(self, speeds: Stretch, commands: Stretch) -> OddReading | None:
        """The rotor whose speed is not that of the others at its command."""
        return odd_reading(speeds.together, commands.together, self.airframe.geometry[2])

    def _unlike(
        self, measured: Array, stretches: Mapping[str, Stretch], commands: Sequence[str]
    ) -> float | None:
        """Share by which squares of speeds are not those of the commands; None: it is not known."""
        for name in commands:
            range_ = self._range(name, stretches[name])
            if not isinstance(range_, str):
                return unlike_squares(measured, normalized(stretches[name].together, range_))
        return None


_STALE = 1.5
"""Times between messages, from which a source repeats its readings."""


def _apart(stretch: Stretch) -> float:
    """S between new readings of the first rotor."""
    t, values = stretch.rotors[0]
    if len(t) < 2:
        return 0.0
    sent, new = float(np.median(np.diff(t))), 1.0 / _readings(t, values)
    return new if new > _STALE * sent else sent  # some readings are the same by chance


def _readings(t: Array, values: Array) -> float:
    """Readings a second while they change; infinite where rounding alone may repeat them.

    What moves little is repeated by rounding, so that each counts as much as it changed.
    """
    new = np.flatnonzero(np.diff(values)) + 1
    if len(new) < 2:
        return math.inf
    jumps, apart = np.abs(values[new] - values[new - 1])[1:], np.diff(t[new])
    if float(np.median(jumps)) <= 2.0 * _step(values):
        return math.inf
    order = np.argsort(apart)
    moved = np.cumsum(jumps[order])
    usual = float(apart[order][np.searchsorted(moved, 0.5 * moved[-1])])
    return 1.0 / usual if usual > 0.0 else math.inf


_SLOW = 0.1
"""Of the greatest speed, below which a rotor hardly has any thrust."""


def _stops(rotors: Sequence[tuple[Array, Array]]) -> bool:
    """Whether readings of 0 are of rotors that stand: each has slowed down before."""
    before = [v[:-1][(v[:-1] > 0.0) & (v[1:] == 0.0)] / max(v.max(), 1e-9) for _, v in rotors]
    last = np.concatenate(before)
    return bool(len(last) and (last < _SLOW).all())


def _standing(values: Sequence[Array]) -> set[tuple[int, float]]:
    """Rotors of constant reading among the (n,) readings of each, with that reading."""
    return {(i, float(v[0])) for i, v in enumerate(values) if np.ptp(v) == 0.0}


def _saturates(rotor: int, values: Sequence[Array]) -> bool:
    """Whether a rotor that does not move is at its limit, and not dead.

    It stays at the greatest value of all, which is a full scale or where another has been too.
    """
    value = float(values[rotor][0])
    others = [float(v.max()) for i, v in enumerate(values) if i != rotor]
    greatest = max(others, default=0.0)
    if value <= 0.0 or value < greatest:
        return False
    return value in _FULL_SCALES or greatest >= _TOUCHES * value


def _until_landing(
    rotors: list[tuple[Array, Array]], seconds: float
) -> tuple[list[tuple[Array, Array]], float]:
    """A stretch without the end in which all rotors stand: a landing is reported a little late."""
    share = max(_moving(v) / len(v) for _, v in rotors) or 1.0
    kept = [math.ceil(share * len(t)) for t, _ in rotors]
    return [(t[:n], v[:n]) for (t, v), n in zip(rotors, kept, strict=True)], share * seconds


def _moving(values: Array) -> int:
    """How many values there are without the zeros at the end."""
    moving = np.flatnonzero(values)
    return int(moving[-1]) + 1 if len(moving) else 0


def _is_function(t: Array, speeds: Array, command_t: Array, commands: Array) -> bool:
    """Whether speeds follow from the commands nearest in time, without lag or noise.

    Rounding to whole numbers is allowed for; where nothing but rounding moves, there is no answer.
    A motor's lag leaves as much as speeds change in a lag: little of a slow climb.
    """
    right = np.clip(np.searchsorted(command_t, t), 1, len(command_t) - 1)
    nearest = np.where(command_t[right] - t < t - command_t[right - 1], right, right - 1)
    near = np.abs(command_t[nearest] - t) < 0.6 * np.median(np.diff(command_t))
    if near.sum() < 20:
        return False
    y, u = speeds[near], commands[nearest[near]]
    spread = float(np.std(u))
    if spread == 0.0:
        return False
    z = (u - u.mean()) / spread
    fit = np.polynomial.Polynomial.fit(z, y, min(3, len(np.unique(z)) - 1))
    slope = float(np.std(fit(z))) / spread
    rounding = math.hypot(_step(y), slope * _step(u)) / math.sqrt(12.0)
    late = np.searchsorted(t[near], t[near][0] + _LAG)
    if len(y) - late < 20:
        return False
    changes = float(np.std(y[late:] - y[: len(y) - late]))
    if changes < 5.0 * rounding:
        return False
    return float(np.std(y - fit(z))) < 1.5 * rounding + _SAME * changes


def _step(values: Array) -> float:
    """The least difference between values: what they are rounded to."""
    steps = np.diff(np.unique(values))
    return float(steps.min()) if len(steps) else 0.0
