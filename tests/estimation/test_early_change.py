"""Changes before a detector could watch: found afterwards, on thrust alone."""

from functools import cache

import numpy as np
import pytest

from gcs_sysid.estimation.early_change import LEAST_BEFORE, actuator_of, early_change
from gcs_sysid.estimation.status import Value
from gcs_sysid.model.scale_reference import ScaleReference
from gcs_sysid.results.summary import next_anchor
from gcs_sysid.signals.samples import Samples
from sim_bridge.doublets import ALL_MISSIONS
from sim_bridge.ensemble import fly_ensemble
from sim_bridge.simulation import mass_step
from sim_bridge.vehicle_files import load_vehicle

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


def found(flight, rotor_input, until=END, samples_until=END):
    samples = Samples(
        gyro=flight.gyro[0],
        rates=flight.gyro[0],
        speeds=(flight.commands if rotor_input == "command" else flight.speeds)[0],
        attitude=flight.quaternion[0],
        force=flight.specific_force[0],
        velocity=flight.velocity[0],
    ).part(slice(0, round(samples_until / DT)))
    actuator = UNKNOWN if rotor_input == "command" else None
    t = flight.t[: len(samples.gyro)]
    return early_change(t, samples, DT, GEOMETRY, actuator, until)


@pytest.mark.parametrize("rotor_input", ["speed", "command"])
@pytest.mark.parametrize(("at", "factor"), [(2.0, 1.2), (5.0, 0.85)])
def test_an_early_mass_step_is_found_and_weighed(rotor_input, at, factor):
    change, judgement = found(flown(at, factor), rotor_input)
    assert judgement.verdict == "changed"
    assert judgement.onset == pytest.approx(at, abs=0.06)
    cause = judgement.cause
    assert cause.mass_std < 0.02
    # Measured: 0.1 to 0.6 %, one standard deviation 0.3 to 0.5 %.
    assert abs(cause.mass_ratio - factor) < max(3.0 * cause.mass_std, 0.01)
    assert np.sign(change.size) == np.sign(factor - 1.0)


@pytest.mark.parametrize("rotor_input", ["speed", "command"])
def test_nothing_is_found_where_nothing_changed(rotor_input):
    _, judgement = found(flown(None, 1.0), rotor_input)
    assert judgement.verdict != "changed"


def test_what_a_detector_watched_is_left_to_it():
    found_then = found(flown(5.0, 0.85), "speed", until=4.0)
    assert found_then is None or abs(found_then[1].onset - 5.0) > 0.5


def test_a_step_with_too_little_flight_around_it_is_not_judged():
    assert found(flown(5.0, 0.85), "speed", samples_until=LEAST_BEFORE + 0.5) is None


def test_rotors_that_stand_still_have_no_thrust():
    flight = flown(None, 1.0)
    still = np.zeros_like(flight.speeds[0])
    samples = Samples(
        flight.gyro[0], flight.gyro[0], still, flight.quaternion[0], flight.specific_force[0],
        flight.velocity[0],
    )  # fmt: skip
    assert early_change(flight.t, samples, DT, GEOMETRY, None, END) is None


@pytest.mark.parametrize(
    ("thrust", "kind", "value", "std"),
    [
        (Value(None, None, "unobservable"), "mass", 1.8, 0.03),  # nothing but the jump tells
        (Value(8.0, 1.6, "weak"), "mass", 1.8, 0.03),  # 20 %: the jump tells more
        (Value(8.0, 0.04, "identified"), "T_max", 8.0, 0.04),  # 0.5 %: thrust does
    ],
)
def test_the_scale_after_a_change_is_by_what_is_known_best(thrust, kind, value, std):
    after = next_anchor(ScaleReference("mass", 1.5), {"T_max": thrust}, 4.0, (1.2, 0.02))
    assert (after.kind, after.value, after.std) == (kind, pytest.approx(value), pytest.approx(std))
    assert after.origin == "the flight before 4.0 s"


def test_without_a_jump_that_tells_the_scale_is_that_of_thrust():
    anchor, unknown = ScaleReference("mass", 1.5), {"T_max": Value(None, None, "unobservable")}
    assert next_anchor(anchor, unknown, 4.0) is anchor
    given = ScaleReference("T_max", 8.0)
    after = next_anchor(given, {"T_max": Value(8.0, 0.0, "given")}, 4.0, (1.2, 0.02))
    assert (after.kind, after.value, after.std) == ("T_max", 8.0, 0.0)
