"""A flight plan on paper: maneuvers that should do, for a vehicle that has not flown yet."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gcs_sysid.coach.choice import Judge, choose
from gcs_sysid.coach.interval_targets import is_enough
from gcs_sysid.coach.manoeuvre_library import Limits, Manoeuvre, library, motion_words
from gcs_sysid.coach.predicted_information import predicted_information
from gcs_sysid.coach.prior_vehicle import RATE, SPEED_STD, PriorVehicle, prior_noise
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.rows.actuator_dynamics import Coordinate

HOVER = 5.0
"""s of quiet hover at the start."""
PAUSE = 3.0
"""s of hover between maneuvers."""
MARGIN = 1.5
"""The plan aims at the target over this: the vehicle is a guess, and so are its sensors."""
MOST = 300.0
"""s; a longer plan is none."""


@dataclass(frozen=True)
class Step:
    """One maneuver of a plan.

    Attributes:
        start: s after the plan's start.
        manoeuvre: to fly.
        now: shares before, see `interval_targets.shares`.
        expected: shares after.
        names: parameters that it narrows, the widest first.
    """

    start: float
    manoeuvre: Manoeuvre
    now: Mapping[str, float | None]
    expected: Mapping[str, float | None]
    names: tuple[str, ...]


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
    """A plan for a vehicle of which no more is known than is assumed.

    Args:
        name: of the airframe.
        prior_vehicle: of it.
        judge: gives the shares of a fit.
        target: share to reach.
        limits: of the maneuvers.
    """
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
        steps.append(Step(seconds, flown, now, found.expected, tuple(found.names)))
        prospect = prospect.then(found.added, flown.seconds, flown.effective_seconds)
        now = judge(prospect.after())
        seconds += flown.seconds + PAUSE
    total = seconds - PAUSE if steps else seconds
    return Plan(name, target, limits, tuple(steps), now, total, is_enough(now, target))


def _rounded(shares: Mapping[str, float | None]) -> dict[str, float | None]:
    return {
        name: None if share is None else float(f"{share:.2g}") for name, share in shares.items()
    }
