"""Which maneuver to fly next; and all of them on paper, for a vehicle that has not flown yet.

Maneuvers are for intervals that are too wide. A share of the value is what one asks for; but a
product of inertia or an offset of the CG may be zero. These are measured against themselves or,
where they are smaller, against what they matter to: a twentieth of the moments that a product
couples, a twentieth of the arm.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from gcs_sysid.arrays import Array
from gcs_sysid.coach.information import (
    RATE,
    SPEED_STD,
    Motion,
    PredictedInformation,
    PriorVehicle,
    information,
    motion_of,
    predicted_information,
    prior_noise,
    within_reach,
)
from gcs_sysid.coach.manoeuvre_library import Limits, Manoeuvre, library, motion_words
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.rows.actuator_dynamics import Coordinate
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import ARM, CORE_OF, REGISTRY
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.significance import Z95

_SMALL = 0.05


def shares(
    values: Mapping[str, Estimate], arm: float, rotor_input: RotorInput
) -> dict[str, float | None]:
    """Half of each 95 % interval over its reference value; None where nothing is known.

    Parameters that are given do not count, nor do those that only a vehicle with something beside
    a rigid body and rotors has (damping, rotor inertia, drag).
    """
    sizes = {name: entry.value or 0.0 for name, entry in values.items()} | {ARM: arm}
    out: dict[str, float | None] = {}
    for name in CORE_OF[rotor_input]:
        found = values[name]
        if found.std == 0.0:  # given
            continue
        if found.value is None or found.std is None:
            out[name] = None
            continue
        reference = max(abs(found.value), _SMALL * REGISTRY[name].reference.counterpart(sizes))
        out[name] = Z95 * found.std / reference if reference > 0.0 else None
    return out


def is_enough(found: Mapping[str, float | None], target: float) -> bool:
    """Whether every interval meets the target."""
    return bool(found) and all(share is not None and share <= target for share in found.values())


def excess(found: Mapping[str, float | None], target: float) -> float:
    """How far intervals are from the target: the sum of ln(share / target) of those beyond."""
    return sum(
        math.log(max(_FAR if share is None else min(share, _FAR), target) / target)
        for share in found.values()
    )


_FAR = 3.0
"""A share beyond which nothing is known in any case."""


Judge = Callable[[Fit], Mapping[str, float | None]]
"""Shares of a fit, see `shares`."""

USUAL = 10.0
"""s that a maneuver lasts."""
_LENGTHS = (*range(5, 16), 18, 20)
_BOTH = 0.1
"""Of roll's and pitch's squared rates, what the lesser needs of the greater to start a fit."""
_CLOSE = 0.9
"""Factor by which expected intervals must be narrower than the target: they are an estimate."""


@dataclass(frozen=True)
class Choice:
    """A maneuver and what it is expected to bring.

    Attributes:
        manoeuvre: within the vehicle's reach, with its length.
        motion: of it.
        now: shares before.
        expected: shares after.
        added: (N_UNKNOWNS, N_UNKNOWNS) information from one second of it.
    """

    manoeuvre: Manoeuvre
    motion: Motion
    now: Mapping[str, float | None]
    expected: Mapping[str, float | None]
    added: Array

    @property
    def names(self) -> list[str]:
        """Parameters that it narrows, the widest first; what is unknown in its usual order."""
        # To gain less than 3 % is not worth a word.
        gained = [
            (-math.inf if before is None or before > 1.0 else -before, place, name)
            for place, (name, share) in enumerate(self.expected.items())
            for before in (self.now.get(name),)
            if share is not None and (before is None or share < 0.97 * before)
        ]
        return [name for _, _, name in sorted(gained)]

    def names_above(self, target: float) -> list[str]:
        """Of `names`, those not yet within the target share; all of them where every one is."""
        names = self.names
        wide = [n for n in names if (before := self.now.get(n)) is None or before > target]
        return wide or names


def choose(
    prospect: PredictedInformation,
    library: Iterable[Manoeuvre],
    judge: Judge,
    target: float,
    achieved: Callable[[Manoeuvre], Manoeuvre] | None = None,
) -> Choice | None:
    """The maneuver that brings the widest intervals nearest to the target; None: none can.

    `achieved` is a maneuver as the vehicle was seen to fly it: the same with smaller swings, whose
    information is expected.
    """
    now = judge(prospect.after())
    far = excess(now, _CLOSE * target)
    best: tuple[float, Manoeuvre, Motion, Array] | None = None
    for manoeuvre in library:
        found = within_reach(manoeuvre, prospect.craft)
        if found is None:
            continue
        reached, motion = found
        if achieved is not None and (flown := achieved(reached)) != reached:
            motion = motion_of(flown, prospect.craft)
        if prospect.fit.rotation is None and not _starts(motion):
            continue
        added = information(
            motion, prospect.craft, prospect.noise, float(prospect.coordinates[Coordinate.LAG])
        )
        reached = reached.lasting(USUAL)
        left = excess(judge(_after(prospect, added, reached)), _CLOSE * target)
        if best is None or left < best[0]:
            best = left, reached, motion, added
    if best is None or not best[0] < far:
        return None
    _, chosen, motion, added = best
    for seconds in _LENGTHS:
        tried = chosen.lasting(float(seconds))
        if is_enough(judge(_after(prospect, added, tried)), _CLOSE * target):
            chosen = tried
            break
    return Choice(chosen, motion, now, judge(_after(prospect, added, chosen)), added)


def _starts(motion: Motion) -> bool:
    """Whether a fit can start from it alone: that takes motion in roll and in pitch."""
    roll, pitch, _ = (motion.rates**2).mean(axis=0)
    return bool(min(roll, pitch) > _BOTH * max(roll, pitch))


def _after(prospect: PredictedInformation, added: Array, manoeuvre: Manoeuvre) -> Fit:
    return prospect.after(added, manoeuvre.seconds, manoeuvre.effective_seconds)


HOVER = 5.0
"""s of quiet hover at the start."""
PAUSE = 3.0
"""s of hover between maneuvers."""
MARGIN = 1.5
"""The plan aims at the target over this: the vehicle is a guess, and so are its sensors."""
MOST = 300.0
"""s; a longer plan is none."""


@dataclass(frozen=True)
class Step(Choice):
    """One of a plan; `start` is s after the plan's start."""

    start: float


@dataclass(frozen=True)
class Plan:
    """What to fly, and what it should bring.

    Attributes:
        airframe: its name.
        target: share that every interval is to reach.
        limits: of the pilot.
        steps: in order.
        expected: shares at the end.
        seconds: from the first hover to the last maneuver's end.
        enough: whether every interval should meet the target.
    """

    airframe: str
    target: float
    limits: Limits
    steps: tuple[Step, ...]
    expected: Mapping[str, float | None]
    seconds: float
    enough: bool

    def as_json(self) -> dict[str, Any]:
        """For programs, and for the emulator to fly."""
        return {
            "schema": "gcs-sysid-plan/1",
            "airframe": self.airframe,
            "target": self.target,
            "enough": self.enough,
            "seconds": self.seconds,
            "manoeuvres": [
                {
                    **step.manoeuvre.as_json(),
                    "start": step.start,
                    "text": motion_words(step.manoeuvre),
                    "expected": _rounded(step.expected),
                }
                for step in self.steps
            ],
            "expected": _rounded(self.expected),
            "assumed": {"imu_hz": RATE, "rotor_speed_std": SPEED_STD},
        }


def make_plan(
    name: str, prior_vehicle: PriorVehicle, judge: Judge, target: float, limits: Limits
) -> Plan:
    """A plan for a vehicle of which no more is known than is assumed."""
    free = (
        (Coordinate.DELAY, Coordinate.LAG, Coordinate.CURVE)
        if prior_vehicle.craft.rotor_input.motors
        else (Coordinate.DELAY,)
    )
    prospect = predicted_information(
        Fit(None, None, HOVER), prior_vehicle, prior_noise(prior_vehicle.craft), free
    )
    choices = library(limits)
    steps: list[Step] = []
    now = judge(prospect.after())
    seconds = HOVER
    while not is_enough(now, target / MARGIN) and seconds < MOST:
        found = choose(prospect, choices, judge, target / MARGIN)
        if found is None:
            break
        flown = found.manoeuvre
        steps.append(Step(**vars(found), start=seconds))
        prospect = prospect.then(found.added, flown.seconds, flown.effective_seconds)
        now = judge(prospect.after())
        seconds += flown.seconds + PAUSE
    total = seconds - PAUSE if steps else seconds
    return Plan(name, target, limits, tuple(steps), now, total, is_enough(now, target))


def _rounded(shares: Mapping[str, float | None]) -> dict[str, float | None]:
    return {
        name: None if share is None else float(f"{share:.2g}") for name, share in shares.items()
    }
