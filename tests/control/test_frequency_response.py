"""Measured frequency responses: of loops whose response is known, and of emulated flights."""

import numpy as np
import pytest

from benchmarks.response import flown_by_pilot, outcome, true_vehicle
from benchmarks.tune import DELAY, LAYOUTS, loop_of
from gcs_sysid.control.frequency_response import (
    FlownSignals,
    flown_signals,
    measured_response,
)
from gcs_sysid.control.loop_margins import frequencies, hover_dynamics, margins_of, open_loops
from gcs_sysid.control.rate_loops import read_loop
from gcs_sysid.control.tuning_study import propose
from gcs_sysid.exports.exported_vehicle import drawn_vehicles
from gcs_sysid.signals.recursions import lfilter
from testbed.vehicles import draw

DT, GAIN, P, ATTITUDE = 0.005, 40.0, 0.3, 5.0


def closed_loop(gusts, seconds=125.0, seed=3, setpoints=True, attitude=ATTITUDE):
    """A body y' = GAIN u + gusts on roll, u = P (r - y), r = w - attitude * angle."""
    random = np.random.default_rng(seed)
    n = round(seconds / DT)
    wanted = lfilter([0.3], [1.0, -0.7], random.standard_normal(n))[0]
    pushes = gusts * lfilter([0.2], [1.0, -0.8], random.standard_normal(n))[0]
    y = angle = 0.0
    rows = []
    for w, push in zip(wanted.tolist(), pushes.tolist(), strict=True):
        r = w - attitude * angle
        u = P * (r - y)
        rows.append((u, y, r))
        angle, y = angle + DT * y, y + DT * (GAIN * u + push)
    signals = np.full((n, 9), np.nan)
    signals[:, :6] = 0.0
    u, y, r = np.array(rows).T
    signals[:, 0], signals[:, 3] = u, y
    if setpoints:
        signals[:, 6:] = 0.0
        signals[:, 6] = r
    return FlownSignals((signals,), DT, 2.0 * np.pi * 20.0)


def true(omega):
    return GAIN * DT / (np.exp(1j * omega * DT) - 1.0)


def off(found):
    return np.abs(found.values / true(found.omega) - 1.0)[found.claimed]


def test_the_response_is_free_of_what_the_loop_answers_to_gusts():
    flight = closed_loop(10.0)
    found = measured_response(flight, 0, ATTITUDE)
    assert found.claimed.sum() > 10
    assert (off(found) <= np.sqrt(2.0) * found.half_width[found.claimed]).mean() > 0.85
    assert np.median(off(found)) < 0.08
    # Set-points that answer to the vehicle are no instruments by themselves.
    gusty = measured_response(closed_loop(15.0), 0, 0.0)
    assert gusty.claimed.any()
    assert np.median(off(gusty)) > 0.3


def test_without_an_instrument_nothing_is_claimed():
    found = measured_response(closed_loop(20.0, setpoints=False), 0)
    assert found.instrument == ""
    assert not found.claimed.any()
    # It lies between the vehicle and the inverse of the controller, as theory says.
    assert np.abs(found.values[4]) < 0.8 * np.abs(true(found.omega[4]))


def test_the_band_holds_the_truth_as_often_as_it_says():
    held = []
    for seed in range(12):
        found = measured_response(closed_loop(10.0, 65.0, seed), 0, ATTITUDE)
        ratio = (found.values / true(found.omega))[found.claimed]
        half = found.half_width[found.claimed]
        held += [*(np.abs(1.0 / np.abs(ratio) - 1.0) <= half), *(np.abs(np.angle(ratio)) <= half)]
    assert 0.92 <= np.mean(held) <= 0.985
    assert len(held) > 200


def test_response_to_the_set_point():
    found = measured_response(closed_loop(1.0), 0, ATTITUDE, of="setpoint")
    expected = P * true(found.omega) / (1.0 + P * true(found.omega))
    apart = np.abs(found.values / expected - 1.0)[found.claimed]
    assert np.median(apart) < 0.02


def test_flight_in_pieces_too_short_or_without_commands_shows_nothing():
    assert flown_signals([], read_loop("px4", {}, draw(0).vehicle.rotors)) is None
    whole = closed_loop(5.0, 20.0).stretches[0]
    pieces = FlownSignals(tuple(whole[i : i + 400] for i in range(0, 4000, 400)), DT, 100.0)
    assert measured_response(pieces, 0) is None
    still = FlownSignals((np.zeros((8000, 9)),), DT, 100.0)
    assert measured_response(still, 0) is None


def test_as_python_control():
    control = pytest.importorskip("control")
    found = measured_response(closed_loop(5.0), 0, ATTITUDE)
    data = found.as_control()
    assert isinstance(data, control.FrequencyResponseData)
    assert data.frdata[0, 0] == pytest.approx(found.values[found.claimed])


@pytest.fixture(
    scope="module",
    params=[
        (0, "px4", 0.1),
        pytest.param((1, "ardupilot", 0.0), marks=pytest.mark.thorough),
    ],
)
def flight(request):
    seed, autopilot, gusts = request.param
    drawn = draw(seed, LAYOUTS)
    loop = loop_of(autopilot, true_vehicle(drawn.vehicle), drawn)
    dynamics = hover_dynamics([true_vehicle(drawn.vehicle)], loop, (DELAY, 0.0))
    loop = propose(dynamics, loop)
    with pytest.MonkeyPatch.context() as shorter:
        shorter.setattr("benchmarks.response.SECONDS", 42.0)
        return drawn, loop, dynamics, flown_by_pilot(drawn, loop, gusts, seed)


@pytest.mark.slow
def test_an_emulated_flight_shows_its_vehicle_and_phase_margin_and_objects_to_another(flight):
    drawn, loop, dynamics, signals = flight
    vehicles = [true_vehicle(drawn.vehicle, inertia) for inertia in (1.0, 4.0 / 3.0)]
    both = [hover_dynamics([v, *drawn_vehicles(v, 30, 1)], loop, (DELAY, 0.001)) for v in vehicles]
    loops = open_loops(dynamics, loop, omega := frequencies(loop))
    phases = [margins_of(omega, loops[:, :, axis]).phase[0] for axis in range(3)]
    found = outcome(signals, both, loop, phases)
    assert found["inside"] > 0.88 * found["claimed"] > 50
    assert all(abs(measured - true) < 3.0 for measured, _, true in found["margins"])
    assert len(found["margins"]) == 3
    assert found["objections"] == [False, True]
