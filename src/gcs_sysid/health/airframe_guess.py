"""Where the rotors are, by the airframe file, by the autopilot's own parameters, or
by how the vehicle turns.

The moments of a layout's rotors must be what turns the vehicle: of all layouts that are flown, one
explains the angular acceleration about roll and pitch and the others hardly any of it. Over tenths
of a second rotors turn a vehicle more than gusts do, which over seconds they only answer.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from operator import ne

import numpy as np

from gcs_sysid.arrays import Array, complete_rows
from gcs_sysid.errors import NoAnswerError
from gcs_sysid.health.hover import Averager
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.health.log_streams import Streams, flight_in, rate_of, streams_in, streams_of
from gcs_sysid.model.airframe import Airframe, Rotor, load_airframe
from gcs_sysid.session.reported_layout import (
    ReportedLayout,
    differences,
    place_words,
    reported_layout,
    usual_layouts,
)
from gcs_sysid.signals.columns import RecordBlock
from gcs_sysid.signals.records import Stream
from gcs_sysid.signals.sampling import Sampler
from gcs_sysid.telemetry.vehicles import GIVE_MULTIROTOR, MavlinkSystem

ASSUMED = "assumed"
"""In the words of an origin, after the order of motors."""
_BY_MOTION = "how the vehicle turns"
_USUAL_ARM = 0.25
"""m, where unknown."""
_UNKNOWN_ARM = 0.5
"""Relative standard deviation of an arm that was not given."""
_GIVE = "give --airframe FILE.toml (gcs-sysid airframe new writes one)"
_CORNERS = ((1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0))
_KINDS = {4: "quad", 6: "hexa", 8: "octo"}
_COUNTS = (8, 6)
"""Of rotors that may fly though the vehicle calls itself a quadrotor; the larger first."""


@dataclass(frozen=True)
class GuessedAirframe:
    """An airframe and its origin.

    Attributes:
        airframe: with or without a scale.
        origin: in words.
        arm_std: relative standard deviation of its size.
        assumed: whether the order of its rotors follows from the vehicle's type alone.
        shown: whether these rotors' moments turn the vehicle, as far as a flight shows.
        explained: share of roll or pitch acceleration, the lesser, that their moments explain over
            tenths of a second; None where too little was flown.
        explained_coupled: the same by all their moments and their lift at once, which allows for
            products of inertia and a CG off the center, in whatever order the motors are.
        as_flown: where the motors are by the motion, in words, where that contradicts `airframe`.
        reversed: whether all rotors turn the other way, by yaw.
        layout: the rotors that log or flight show; None where they are given, or only assumed.
    """

    airframe: Airframe
    origin: str
    arm_std: float = 0.0
    assumed: bool = False
    shown: bool = False
    explained: float | None = None
    explained_coupled: float | None = None
    as_flown: str = ""
    reversed: bool = False
    layout: ReportedLayout | None = None


def guess_airframe(
    vehicle: MavlinkSystem,
    parameters: Mapping[str, float],
    given: Airframe | None,
    arm: float | None,
) -> GuessedAirframe:
    """The airframe given, else one by the log.

    Args:
        vehicle: that flew.
        parameters: its autopilot's.
        given: by the user.
        arm: m, mean distance of the rotors, for one that is not given.

    Raises:
        NoAnswerError: the rotor positions are unknown.
        InputError: no vehicle has such an arm.
    """
    reported = reported_layout(vehicle.key, parameters)
    if given is not None:
        shown = reported is not None and reported.shown and not differences(given, reported)
        origin, std = f"{given.name}, as given", 0.0
        if not given.arm_known:
            origin, std = f"{origin}, its arm of {given.arm:g} m assumed: give --arm", _UNKNOWN_ARM
        return GuessedAirframe(given, origin, std, shown=shown)
    found = _by_type(vehicle, parameters, reported)
    if arm is not None:
        layout = found.origin.partition(", its arm")[0]
        origin = f"{layout}, {arm:g} m from the center to a rotor"
        return replace(found, airframe=found.airframe.with_arm(arm), origin=origin, arm_std=0.0)
    return found


def _bare(airframe: Airframe) -> Airframe:
    return replace(airframe, mass=None, k_T=None, T_max=None, priors={})


def _by_type(
    vehicle: MavlinkSystem, parameters: Mapping[str, float], reported: ReportedLayout | None
) -> GuessedAirframe:
    if vehicle.no_multirotor:
        raise NoAnswerError(vehicle.no_multirotor, GIVE_MULTIROTOR)
    size = f"its arm of {_USUAL_ARM:g} m assumed: give --arm"
    shape = _KINDS.get(vehicle.rotors or 0)
    if reported is not None:
        airframe = Airframe("reported", reported.rotors)
        if reported.sized:
            return GuessedAirframe(airframe, f"{reported.by} of the vehicle", layout=reported)
        origin = f"{reported.by}, {size}"
        return GuessedAirframe(
            airframe.with_arm(_USUAL_ARM), origin, _UNKNOWN_ARM, shown=reported.shown,
            layout=reported,
        )  # fmt: skip
    if vehicle.key == "ardupilot" and {"FRAME_CLASS", "FRAME_TYPE"} <= set(parameters):
        raise NoAnswerError(
            f"where are the rotors? FRAME_CLASS {parameters['FRAME_CLASS']:.0f} and FRAME_TYPE "
            f"{parameters['FRAME_TYPE']:.0f} are not a known frame",
            _GIVE,
        )
    if shape is None:
        raise NoAnswerError("where are the rotors? The log does not hold the frame", _GIVE)
    if vehicle.key not in ("px4", "ardupilot"):
        if shape != "quad":
            raise NoAnswerError("where are the rotors? The order of the motors is not known", _GIVE)
        airframe = _bare(load_airframe("betaflight-quad-x"))
        origin = f"quad X in Betaflight's order {ASSUMED}"
    else:
        airframe = _bare(load_airframe(f"{vehicle.key}-{shape}-x"))
        origin = f"{shape} X in the autopilot's order {ASSUMED}"
    airframe = airframe.with_arm(_USUAL_ARM)
    return GuessedAirframe(airframe, f"{origin}, {size}", _UNKNOWN_ARM, assumed=True)


def layout_by_motion(
    blocks: Sequence[RecordBlock],
    guess: GuessedAirframe,
    autopilot: str,
    parameters: Mapping[str, float],
    sampler: Sampler | None = None,
) -> tuple[GuessedAirframe, Streams]:
    """The layout by which the vehicle turns, where its order was only assumed.

    Args:
        blocks: of the log.
        guess: from the log, or from the user.
        autopilot: "px4", "ardupilot" or another key.
        parameters: the autopilot's.
        sampler: as of `flight_in`, for a guess that is not assumed.

    Returns:
        The guess, or where it was assumed the layout that the flight shows instead, and the
        streams of its rotors. A layout that was given or logged stays, and `as_flown` is the one
        that contradicts it.
    """
    if guess.assumed:
        guess = _of_as_many_as_carry(blocks, guess, autopilot, parameters)
    airframe = guess.airframe
    streams = streams_of(blocks, airframe, autopilot, parameters, sampler)
    count = len(airframe.rotors)
    delays = (0.0,) if streams.speeds else TUNING.order_delays
    seen = [*_motions(streams, TUNING.order_windows, delays)]
    if not seen:
        return guess, streams
    own = max((_explained(airframe.geometry, *motion) for motion in seen), key=_least)
    likeliest, rival = _likeliest([_ranked(_layouts(count, *each), *each) for each in seen])
    ours = _Candidate(airframe.name, airframe.with_arm(1.0).rotors, _least(own))
    best = likeliest is not None and not likeliest.differs(ours)
    shown = _least(own) >= (TUNING.least_explained if best else TUNING.surely_explained)
    shown &= not any(_rests(turning).any() for _, turning in seen)
    coupled = _most_coupled(airframe, seen)
    guess = replace(guess, explained=_least(own), explained_coupled=coupled)
    clear = max(TUNING.least_explained, TUNING.more_explained * rival)
    first = likeliest if likeliest is not None and likeliest.least >= clear else None
    if not guess.assumed:
        as_flown = "" if guess.shown or first is None else _contradiction(first, ours)
        as_flown = as_flown or _moved_in_flight(ours, seen)
        shown = (guess.shown or shown) and not as_flown
        turned = not as_flown and own[2] <= -TUNING.surely_explained
        return replace(guess, shown=shown, as_flown=as_flown, reversed=turned), streams
    if first is None:
        return replace(guess, shown=shown), streams
    size = guess.origin.partition(f" {ASSUMED}, ")[2]
    flown = Airframe("as flown", first.rotors)
    found = replace(
        guess, shown=True, explained=first.least,
        layout=ReportedLayout(flown.with_arm(1.0).rotors, False, _BY_MOTION, shown=True),
    )  # fmt: skip
    layout = flown.with_arm(airframe.arm)
    if np.allclose(layout.geometry, airframe.geometry, atol=1e-9):
        origin = guess.origin.replace(f"{ASSUMED}, ", "as the flight shows, ", 1)
        return replace(found, origin=origin), streams
    origin = f"{first.name} as the flight shows: motors {first.places}; {size}"
    coupled = _most_coupled(layout, seen)
    return replace(found, airframe=layout, origin=origin, explained_coupled=coupled), streams


@dataclass(frozen=True)
class _Candidate:
    """A layout, and the lesser share of roll and pitch acceleration that it explains."""

    name: str
    rotors: tuple[Rotor, ...]
    least: float

    @property
    def places(self) -> str:
        """Each motor's, in words."""
        return ", ".join(f"{i} {place_words(rotor)}" for i, rotor in enumerate(self.rotors, 1))

    def differs(self, other: "_Candidate") -> bool:
        """Whether a rotor stands elsewhere; spins do not count."""
        return not np.allclose(
            [(r.x, r.y) for r in self.rotors], [(r.x, r.y) for r in other.rotors], atol=0.1
        )


def _likeliest(ranked: Sequence[list[_Candidate]]) -> tuple[_Candidate | None, float]:
    """The layout that explains any motion best, and what the best with rotors elsewhere does."""
    best = max(filter(None, ranked), key=lambda layouts: layouts[0].least, default=None)
    if best is None:  # no usual layout has as many rotors
        return None, 0.0
    first = best[0]
    rival = max((other.least for other in best[1:] if other.differs(first)), default=0.0)
    return first, rival


def _contradiction(first: _Candidate, own: _Candidate) -> str:
    """Where the motors are as flown; empty where the airframe explains the motion as well."""
    if first.least < TUNING.more_explained * own.least or not first.differs(own):
        return ""
    return "motor " + first.places.replace(" ", " is ", 1)


def _moved_in_flight(own: _Candidate, seen: Sequence[tuple[Array, Array]]) -> str:
    """Where the motors are in a third of a flight that the airframe's places in another order
    explain, while it surely explains another third; empty: in none.
    """
    own_geometry = Airframe(own.name, own.rotors).geometry
    long = [motion for motion in seen if len(motion[0]) >= 3 * TUNING.fewest_for_order]
    if not long:
        return ""
    thrust, turning = max(long, key=lambda motion: _least(_explained(own_geometry, *motion)))
    thirds = np.array_split(np.arange(len(thrust)), 3)
    parts = [(thrust[rows], turning[rows] - turning[rows].mean(axis=0)) for rows in thirds]
    owns = [_least(_explained(own_geometry, *part)) for part in parts]
    if max(owns) < TUNING.surely_explained:
        return ""
    for part, least in zip(parts, owns, strict=True):
        first, rival = _likeliest([_ranked(_reordered(own), *part)])
        here = replace(own, least=least)
        clear = max(TUNING.surely_explained, TUNING.more_explained * rival)
        if first is not None and first.least >= clear and (places := _contradiction(first, here)):
            return f"for a part of the flight {places}"
    return ""


def _ranked(
    layouts: Iterable[tuple[str, tuple[Rotor, ...]]], thrust: Array, turning: Array
) -> list[_Candidate]:
    """Layouts, the best first, their spins as yaw has them."""
    found = []
    for name, rotors in layouts:
        shares = _explained(Airframe(name, rotors).geometry, thrust, turning)
        if shares[2] < 0.0:
            rotors = tuple(Rotor(r.x, r.y, -r.spin) for r in rotors)
        found.append(_Candidate(name, rotors, round(_least(shares), 9)))
    return sorted(found, key=lambda candidate: -candidate.least)


def _least(shares: Sequence[float]) -> float:
    return min(shares[:2])


def _of_as_many_as_carry(
    blocks: Sequence[RecordBlock],
    guess: GuessedAirframe,
    autopilot: str,
    parameters: Mapping[str, float],
) -> GuessedAirframe:
    """The guess with more rotors, where more do what the first four do."""
    flight, tracks = flight_in(blocks, guess.airframe, autopilot, parameters)
    for count in _COUNTS:
        if count <= len(guess.airframe.rotors):
            break
        rotors = usual_layouts(count)[f"{_KINDS[count]} x"]
        wider = Airframe(f"{_KINDS[count]}-x", rotors).with_arm(guess.airframe.arm)
        streams = streams_in(flight, tracks, wider, autopilot, parameters)
        motion = next(_motions(streams, TUNING.order_windows[:1], (0.0,)), None)
        if motion is None:
            continue
        thrust, _ = motion
        load, moved = thrust.mean(axis=0), thrust.std(axis=0)
        if (load > TUNING.carrying * load[:4].mean()).all() and (
            moved > TUNING.carrying * moved[:4].mean()
        ).all():
            size = guess.origin.partition(f" {ASSUMED}, ")[2]
            origin = f"{_KINDS[count]} X in the autopilot's order {ASSUMED}, {size}"
            return replace(guess, airframe=wider, origin=origin)
    return guess


def _motions(
    streams: Streams, halves: Sequence[float], delays: Sequence[float]
) -> Iterator[tuple[Array, Array]]:
    """(n, rotors) thrust over its mean and (n, 3) rad/s^2 in flight, where there is enough.

    Args:
        streams: of the flight.
        halves: s, half widths of the windows.
        delays: s, each by which thrust may lag behind the rotor stream.
    """
    source = streams.speeds or streams.commands
    if source is None or Stream.IMU not in streams.tracks:
        return
    times, imu = streams.tracks[Stream.IMU]
    slowest = min(source.rate, rate_of(times))
    if slowest <= 0.0:
        return
    if not streams.flight.flying.any():
        return
    power = 1 if source.range is not None else 2
    gyro = Averager(times, imu[:, :3])
    thrusts = [Averager(at, v**power) for at, v in source.samples]
    for half in (max(half, 2.0 / slowest) for half in halves):
        t = np.arange(half, float(streams.flight.t[-1]) - half, half)
        t = t[streams.flight.at(t)]
        turning = gyro.means(t, half, slope=True)
        for delay in delays:
            thrust = np.hstack([one.means(t - delay, half) for one in thrusts])
            there = complete_rows(np.column_stack([turning, thrust])) & (thrust.sum(axis=1) > 0.0)
            if np.count_nonzero(there) >= TUNING.fewest_for_order:
                load, turned = thrust[there], turning[there]
                yield load / load[:, :4].mean(), turned - turned.mean(axis=0)


def _explained(geometry: Array, thrust: Array, turning: Array) -> list[float]:
    """Share of the angular acceleration about each axis that a layout's moments explain.

    Negative where they turn the vehicle the other way.
    """
    x, y, spin = geometry
    moved = thrust - thrust.mean(axis=0)
    out = []
    for lever, turned in zip((-y, x, spin), turning.T, strict=True):
        moment = moved @ lever
        both = float(moment @ turned)
        power = float(moment @ moment) * float(turned @ turned)
        out.append(float(np.copysign(both**2 / power, both)) if power > 0.0 else 0.0)
    return [1.0 if rests else share for rests, share in zip(_rests(turning), out, strict=True)]


def _rests(turning: Array) -> Array:
    """(3,) whether roll or pitch does so little of what the other does that it may be crosstalk.

    Crosstalk fits any order, so nothing there is left to explain.
    """
    moved = turning.std(axis=0)
    rests: Array = moved < TUNING.crosstalk * moved[:2].max()
    rests[2] = False
    return rests


def _coupled(geometry: Array, thrust: Array, turning: Array) -> float:
    """Share of roll or pitch acceleration, the lesser, that all moments and the lift explain.

    Zero where an axis turns against its own moment.
    """
    x, y, spin = geometry
    moved = thrust - thrust.mean(axis=0)
    columns = np.column_stack([moved @ np.column_stack([-y, x, spin]), moved.sum(axis=1)])
    gains = np.linalg.lstsq(columns, turning, rcond=None)[0]
    rest = ((turning - columns @ gains) ** 2).sum(axis=0)
    power = (turning**2).sum(axis=0)
    answered = (np.diag(gains) > 0.0) & (power > 0.0)
    shares = 1.0 - np.divide(rest, power, out=np.ones(3), where=answered)
    return float(np.where(_rests(turning), 1.0, shares)[:2].min())


def _most_coupled(airframe: Airframe, seen: Sequence[tuple[Array, Array]]) -> float:
    return max(_coupled(airframe.geometry, *motion) for motion in seen)


def _reordered(own: _Candidate) -> Iterator[tuple[str, tuple[Rotor, ...]]]:
    """The same places in every order; of more than four rotors, with two that change places."""
    places = range(len(own.rotors))
    for order in permutations(places):
        if len(places) == 4 or sum(map(ne, order, places)) <= 2:
            yield own.name, tuple(own.rotors[i] for i in order)


def _layouts(count: int, thrust: Array, turning: Array) -> Iterator[tuple[str, tuple[Rotor, ...]]]:
    """All that are flown: names and rotors, at a distance of about 1."""
    if count == 4:
        side = math.sqrt(0.5)
        for order in permutations(_CORNERS):
            rotors = (Rotor(side * x, side * y, 1 if x == y else -1) for x, y in order)
            yield "quad X", tuple(rotors)
    yield from usual_layouts(count).items()
    if count == 8:
        yield from _coaxial(thrust, turning)


def _coaxial(thrust: Array, turning: Array) -> Iterator[tuple[str, tuple[Rotor, ...]]]:
    """Four pairs at the corners: each rotor where its effect, by minimum norm, has it.

    Commands lie within the mixer's span, and there the minimum norm is that of the mixer itself.
    """
    effect = np.linalg.pinv(thrust - thrust.mean(axis=0), rcond=1e-2) @ turning  # (8, 3)
    corners = [(float(np.sign(pitch)), float(-np.sign(roll))) for roll, pitch, _ in effect]
    if sorted(corners) != sorted(2 * _CORNERS):
        return
    spins = [0] * len(corners)
    for corner in _CORNERS:
        pair = sorted((effect[i, 2], i) for i, at in enumerate(corners) if at == corner)
        (_, low), (_, high) = pair
        spins[low], spins[high] = -1, 1
    yield "octo coaxial X", tuple(Rotor(x, y, s) for (x, y), s in zip(corners, spins, strict=True))
