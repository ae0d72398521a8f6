"""Flights that begin with a throw and turn for a second: another simulator's, with its truth."""

import json

import numpy as np
import pytest

from gcs_sysid.session.analysis import analyze_log
from testbed.recordings import THROWN_INERTIA, airframe_for


@pytest.mark.slow
@pytest.mark.parametrize(
    "numbers", [(157, 159), pytest.param((161, 163, 165, 167), marks=pytest.mark.thorough)]
)
def test_flights_that_turn_for_a_second_have_inertia_and_cg(shared_log, numbers):
    close, held = 0, 0
    for number in numbers:
        log = shared_log(f"field/indiflight/LOG00{number}.BFL")
        truth = json.loads(log.with_suffix(".truth.json").read_text())["derived"]
        found = analyze_log(log, airframe_for(log)).parameters
        assert found["k_T"].value == pytest.approx(truth["k_T_N_per_rad2_s2"], rel=0.1)
        for name in ("cg_x", "cg_y"):
            low, high = found[name].ci95
            held += low <= 0.0 <= high
        claimed = [found[name] for name in ("Ixx", "Iyy") if found[name].status != "unobservable"]
        errors = [abs(each.value / THROWN_INERTIA - 1.0) for each in claimed]
        close += len(errors) == 2 and bool(np.max(errors) < 0.1)
    assert close >= len(numbers) - 1
    assert held >= 2 * len(numbers) - 1  # at 95 %
