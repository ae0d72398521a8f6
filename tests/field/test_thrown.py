"""Flights that begin with a throw and turn for a second: another simulator's, with its truth."""

import json

import numpy as np
import pytest

from gcs_sysid.model.airframe import parse_airframe
from gcs_sysid.session.analysis import analyze_log

INERTIA = 6e-4
"""kg m^2; the truth is of accelerations, and so of arms over inertia."""


def flown(shared_log, number):
    """Airframe and log of a flight; its origin is the CG."""
    log = shared_log(f"field/indiflight/LOG00{number}.BFL")
    truth = json.loads(log.with_suffix(".truth.json").read_text())["derived"]
    k_T = truth["k_T_N_per_rad2_s2"]
    rotors = [
        {"x": p * INERTIA / k_T, "y": -r * INERTIA / k_T, "spin": "ccw" if y > 0.0 else "cw"}
        for r, p, y in zip(
            truth["roll_acc_per_omega2"],
            truth["pitch_acc_per_omega2"],
            truth["yaw_acc_per_omega2"],
            strict=True,
        )
    ]
    table = {"name": "thrown", "mass": truth["mass_kg"], "rotor": rotors}
    return parse_airframe(table, "thrown"), log, k_T


@pytest.mark.slow
@pytest.mark.parametrize(
    "numbers",
    [(157, 159), pytest.param((161, 163, 165, 167), marks=pytest.mark.thorough)],
)
def test_flights_that_turn_for_a_second_have_inertia_and_cg(shared_log, numbers):
    close, held = 0, 0
    for number in numbers:
        airframe, log, k_T = flown(shared_log, number)
        found = analyze_log(log, airframe).parameters
        assert found["k_T"].value == pytest.approx(k_T, rel=0.1)
        for name in ("cg_x", "cg_y"):
            low, high = found[name].ci95
            held += low <= 0.0 <= high
        claimed = [found[name] for name in ("Ixx", "Iyy") if found[name].status != "unobservable"]
        errors = [abs(each.value / INERTIA - 1.0) for each in claimed]
        close += len(errors) == 2 and bool(np.max(errors) < 0.1)
    assert close >= len(numbers) - 1
    assert held >= 2 * len(numbers) - 1  # at 95 %
