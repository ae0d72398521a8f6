"""Changes before a detector could watch: found afterwards, on thrust alone."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gcs_sysid.estimation.changes.change_detection import ChangeTuning
from gcs_sysid.estimation.changes.change_reference import actuator_of
from gcs_sysid.estimation.changes.change_watch import LEAST_BEFORE, early_change
from gcs_sysid.estimation.changes.tracking import Tracker
from gcs_sysid.estimation.record.tuning import tuning_for
from gcs_sysid.model.airframe import ScaleReference
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.summary import next_anchor
from sim_bridge.doublets import ALL_MISSIONS
from sim_bridge.ensemble import fly_ensemble
from sim_bridge.simulation import mass_step
from sim_bridge.vehicle_files import load_vehicle
from testbed.article_flights import exact

RATE, END = 100, 11.0
DT = 1.0 / RATE
VEHICLE = load_vehicle("paper")
GEOMETRY = np.array([[r.x, r.y, float(r.spin)] for r in VEHICLE.rotors]).T
UNKNOWN = actuator_of(None, (-0.2, 1.2))
"""Commands of which nothing is known yet."""


@cache
def flown(at, factor, seed=1):
    changes = (mass_step(at, factor),) if at else ()
    clean = fly_ensemble(VEHICLE, ALL_MISSIONS["doublets"], RATE, END, changes=changes, seed=seed)
    return clean.with_noise("mems", 0.0, [seed])


def of_commands(flight):
    return replace(exact(flight), speeds=flight.commands[0])


def found(flight, rotor_input, until=END, samples_until=END):
    samples = exact(flight) if not rotor_input.motors else of_commands(flight)
    samples = samples.part(slice(0, round(samples_until / DT)))
    actuator = UNKNOWN if rotor_input.motors else None
    t = flight.t[: len(samples.gyro)]
    return early_change(t, samples, DT, GEOMETRY, actuator, until)


@pytest.mark.slow
@pytest.mark.parametrize("rotor_input", list(RotorInput))
@pytest.mark.parametrize(
    ("at", "factor"), [(2.0, 1.2), pytest.param(5.0, 0.85, marks=pytest.mark.thorough)]
)
def test_an_early_mass_step_is_found_and_weighed(rotor_input, at, factor):
    _, judgement = found(flown(at, factor), rotor_input)
    assert judgement.verdict == "changed"
    assert judgement.onset == pytest.approx(at, abs=0.06)
    cause = judgement.cause
    assert cause.mass_std < 0.02
    # Measured: 0.1 to 0.6 %, one standard deviation 0.3 to 0.5 %.
    assert abs(cause.mass_ratio - factor) < max(3.0 * cause.mass_std, 0.01)


@pytest.mark.slow
@pytest.mark.parametrize("rotor_input", list(RotorInput))
def test_nothing_is_found_where_nothing_changed(rotor_input):
    _, judgement = found(flown(None, 1.0), rotor_input)
    assert judgement.verdict != "changed"


@pytest.mark.slow
def test_what_a_detector_watched_is_left_to_it():
    assert found(flown(2.0, 1.2), RotorInput.SPEED, until=1.8) is None


@pytest.mark.slow
def test_a_step_with_too_little_flight_around_it_is_not_judged():
    assert found(flown(2.0, 1.2), RotorInput.SPEED, samples_until=LEAST_BEFORE + 0.5) is None


@pytest.mark.slow
def test_rotors_that_stand_still_have_no_thrust():
    flight = flown(None, 1.0)
    samples = replace(exact(flight), speeds=np.zeros_like(flight.speeds[0]))
    assert early_change(flight.t, samples, DT, GEOMETRY, None, END) is None


@pytest.mark.slow
def test_gaps_before_a_step_leave_it_a_mean_to_be_held_against():
    """Where most samples of each mean are missing, the first is of what flies after the step."""
    flight = flown(2.0, 1.2)
    samples, gaps = exact(flight), (np.arange(len(flight.t)) % 15 < 9) & (flight.t < 2.2)
    force = np.where(gaps[:, None], np.nan, samples.force)
    found = early_change(flight.t, replace(samples, force=force), DT, GEOMETRY, None, END)
    assert found is None or found[0].onset > 2.2


@pytest.mark.slow
@pytest.mark.thorough
def test_a_flight_with_an_early_step_is_two_segments_however_it_comes():
    flights = [follow_blocks(n) for n in (25, 700)]
    for tracker in flights:
        (event,), (segment,) = tracker.events, tracker.segments
        assert event.onset == segment.end == pytest.approx(4.0, abs=0.05)
        ratio, std = segment.mass_ratio
        assert abs(ratio - 1.2) < max(3.0 * std, 0.01)
    one, other = flights
    assert one.events[0].decided == other.events[0].decided
    kappa = other.fit().translation.kappa
    assert one.fit().translation.kappa == pytest.approx(kappa, rel=1e-9)


def follow_blocks(size):
    mission = ALL_MISSIONS["doublets"]
    clean = fly_ensemble(VEHICLE, mission, 250, 14.0, changes=(mass_step(4.0, 1.2),))
    flight = clean.with_noise("mems", 0.0, [1])
    samples = of_commands(flight)
    tracker = Tracker(GEOMETRY, 0.004, tuning_for(RotorInput.COMMAND, 0.004), ChangeTuning())
    for k in range(0, len(flight.t), size):
        part = slice(k, k + size)
        tracker.update(flight.t[part], samples.part(part))
    return tracker


@pytest.mark.parametrize(
    ("thrust", "kind", "value", "std"),
    [
        (
            Estimate(None, None, status="unobservable"),
            "mass",
            1.8,
            0.03,
        ),  # nothing but the jump tells
        (Estimate(8.0, 1.6, status="weak"), "mass", 1.8, 0.03),  # 20 %: the jump tells more
        (Estimate(8.0, 0.04, status="identified"), "T_max", 8.0, 0.04),  # 0.5 %: thrust does
    ],
)
def test_the_scale_after_a_change_is_by_what_is_known_best(thrust, kind, value, std):
    after = next_anchor(ScaleReference("mass", 1.5), {"T_max": thrust}, 4.0, (1.2, 0.02))
    assert (after.kind, after.value, after.std) == (kind, pytest.approx(value), pytest.approx(std))
    assert after.origin == "the flight before 4.0 s"


def test_without_a_jump_that_tells_the_scale_is_that_of_thrust():
    anchor, unknown = (
        ScaleReference("mass", 1.5),
        {"T_max": Estimate(None, None, status="unobservable")},
    )
    assert next_anchor(anchor, unknown, 4.0) is anchor
    given = ScaleReference("T_max", 8.0)
    after = next_anchor(given, {"T_max": Estimate(8.0, 0.0, status="given")}, 4.0, (1.2, 0.02))
    assert (after.kind, after.value, after.std) == ("T_max", 8.0, 0.0)
