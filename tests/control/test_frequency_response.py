"""Measured frequency responses: of loops whose response is known, and of emulated flights."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.response import flown_by_pilot, outcome, true_vehicle
from benchmarks.tune import ATTITUDE_ONLY, DELAY, LAYOUTS, SETTLE, loop_of
from gcs_sysid.control.frequency_response import (
    FlownSignals,
    FrequencyResponse,
    controller_delay,
    flown_signals,
    lateness,
    measured_axes,
    measured_response,
    replay,
)
from gcs_sysid.control.loop_margins import (
    HoverDynamics,
    frequencies,
    hover_dynamics,
    margins_of,
    open_loops,
)
from gcs_sysid.control.rate_loops import read_loop
from gcs_sysid.control.tuning_study import (
    Change,
    answers,
    filter_objections,
    late_objections,
    parted_answers,
    propose,
    what_if,
)
from gcs_sysid.exports.exported_vehicle import drawn_vehicles
from gcs_sysid.model.parameters import INERTIA
from gcs_sysid.signals.recursions import lfilter
from sim_bridge.missions import Reference
from sim_bridge.rate_controllers import LOOP_RATE
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


@pytest.mark.parametrize("gusts", [3.0, 60.0])
def test_a_controller_shows_by_how_much_it_is_later_than_its_law(gusts):
    signals = closed_loop(gusts, 65.0, attitude=0.0).stretches[0]
    late, slow = signals[2:].copy(), signals.copy()
    late[:, 0] = signals[:-2, 0] + 0.3 * signals[:-2, 6]  # later, and with feed-forward
    slow[:, 6] = np.repeat(slow[::4, 6], 4)[: len(slow)]
    loop = proportional_loop(P)
    for rows, held, delay in ((signals, 0.0, 0.0), (slow, 4.0 * DT, 0.0), (late, 0.0, 2.0 * DT)):
        flight = FlownSignals((rows,), DT, 2.0 * np.pi * 20.0, held)
        seconds, std = controller_delay(flight, loop, 0)
        assert seconds == pytest.approx(delay, abs=0.4 * DT if held else max(3.0 * std, 1e-4))
        # Rates that do nothing but follow set-points show nothing where these are logged slowly.
        assert (std < 0.5 * DT) == (gusts > 10.0 or not held)
    of_means = controller_delay(flight, replace(loop, averaged=DT), 0)
    assert of_means == (pytest.approx(seconds + 0.5 * DT), std)
    assert controller_delay(flight, loop, 1) == (0.0, np.inf)
    wrong = FlownSignals((late * np.where(np.arange(9) == 0, -1.0, 1.0),), DT, 2.0 * np.pi * 20.0)
    assert controller_delay(wrong, loop, 0) == (0.0, np.inf)


def test_how_much_later_than_modeled_whatever_set_points_answer_to_gusts():
    omega, model, off = np.geomspace(5.0, 15.0, 12), np.ones((1, 12), complex), []
    for coherence in (1.0, 0.7):
        share, std = np.full(12, coherence), np.full(12, 0.02)
        values = np.exp(-0.006j * omega - 3.0j / omega)
        found = FrequencyResponse(omega, values, std, std, share, share > 0.6, "set-points")
        late, error = lateness([(found, model, 10.0)])
        off.append(abs(late - 0.006) / error)
    assert off[0] > 2.0 > 1.0 > off[1]
    assert lateness([]) == (0.0, np.inf)


def proportional_loop(gain):
    """PX4's with nothing but P on roll."""
    names = [f"MC_{axis}RATE_{x}" for axis in ("ROLL", "PITCH", "YAW") for x in "PID"]
    off = dict.fromkeys([*names, "IMU_GYRO_CUTOFF", "MC_YAW_TQ_CUTOFF"], 0.0)
    settings = {**off, "MC_ROLLRATE_P": gain, "IMU_GYRO_RATEMAX": 1.0 / DT}
    return read_loop("px4", settings, draw(0).vehicle.rotors)


def test_other_gains_along_the_same_set_points_in_the_same_gusts(monkeypatch):
    none, many = np.zeros((1, 3, 3)), np.eye(3)[None]
    dynamics = HoverDynamics(GAIN * many, none, none, np.zeros(1), np.zeros(1), np.ones((1, 4)))
    vehicles, flights = [], []
    for gain in (P, 1.5 * P):
        monkeypatch.setattr(sys.modules[__name__], "P", gain)
        flights.append(closed_loop(10.0, 65.0, attitude=0.0))
        vehicles.append((dynamics, proportional_loop(gain)))
    now, then = vehicles
    found = replay(flights[0], now, then, 1e3).error
    truth = replay(flights[1], then, then, 1e3).error["flown"]
    assert found["then"][0, 0] == pytest.approx(truth[0, 0], rel=0.005)
    assert found["then"][0, 0] < 0.95 * found["flown"][0, 0]


def test_set_points_that_are_logged_slowly_are_not_later_for_that():
    flight = closed_loop(1.0, 65.0, attitude=0.0)
    slow = flight.stretches[0].copy()
    slow[:, 6] = np.repeat(slow[::5, 6], 5)[: len(slow)]
    found = measured_response(replace(flight, stretches=(slow,), held=5 * DT), 0, of="setpoint")
    expected = P * true(found.omega) / (1.0 + P * true(found.omega))
    late = -(np.angle(found.values / expected) / found.omega)[found.claimed]
    assert np.abs(np.median(late)) < 0.002


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
    params=[(0, "px4", 0.1), pytest.param((1, "ardupilot", 0.0), marks=pytest.mark.thorough)],
)
def flight(request):
    seed, autopilot, gusts = request.param
    drawn = draw(seed, LAYOUTS)
    loop = loop_of(autopilot, true_vehicle(drawn.vehicle), drawn)
    dynamics = hover_dynamics([true_vehicle(drawn.vehicle)], loop, (DELAY, 0.0))
    loop = replace(propose(dynamics, loop), assumed=())
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
    assert found["inside"] > 0.88 * found["claimed"] > 40
    assert all(abs(measured - true) < 3.0 for measured, _, true in found["margins"])
    assert len(found["margins"]) >= 2
    assert found["objections"] == [False, True, True]
    double = loop.with_gains(0, replace(loop.gains[0], P=2.0 * loop.gains[0].P))
    parts = [answers(signals, (both[0], one)) for one in (loop, double)]
    assert not parted_answers(parts[0])
    (objection,) = parted_answers(parts[1])
    assert "roll" in objection.evidence
    for share, way in ((0.2, "earlier"), (1.0, ""), (0.0, "later")):
        given = replace(loop, gyro_cutoff=share * loop.gyro_cutoff)
        late = late_objections(both[0], given, measured_axes(signals, both[0], given))
        expected = way if loop.logs_raw_gyro or share < 0.1 else ""
        assert len(late) == bool(expected)
        faster = "filters act that are faster" in late[0].reason if late else False
        assert faster is (expected == "earlier")
        said = filter_objections(given, measured_axes(signals, both[0], given))
        near = [0.6 < each.evidence["cutoff"] / loop.gyro_cutoff < 1.7 for each in said]
        assert near == [True] * (not loop.logs_raw_gyro)
    assert not filter_objections(loop, measured_axes(signals, both[1], loop))


class Logged:
    """A mission of rate set-points that were logged, from `SETTLE` on."""

    name, duration, turbulence = "logged", 60.0, 0.0

    def __init__(self, rates):
        self._rates = np.vstack([np.zeros((round(SETTLE * LOOP_RATE), 3)), rates])

    def reference(self, t):
        at, zero, level = (0.0, 0.0, -10.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
        rates = self._rates[min(round(t * LOOP_RATE), len(self._rates) - 1)]
        return Reference(at, zero, zero, level, level, tuple(rates.tolist()), zero, zero)


@pytest.mark.thorough
def test_an_emulated_vehicle_flies_as_was_said_with_other_gains_payload_and_battery(
    flight, monkeypatch
):
    drawn, loop, dynamics, signals = flight
    place = 0.3 * abs(drawn.vehicle.rotors[0].x) * np.array([1.0, 0.7, 1.0])
    laden = true_vehicle(drawn.vehicle).changed(0.2 * drawn.vehicle.mass, place, 0.8)
    other = loop
    for axis, gains in enumerate(loop.gains):
        other = other.with_gains(axis, replace(gains, P=0.7 * gains.P, I=0.5 * gains.I))
    then = hover_dynamics([laden], other, (DELAY, 0.0)), other
    flown = answers(signals, (dynamics, loop))
    said = what_if(Change({}), signals, (dynamics, loop), then, flown)
    assert said.axes == (0, 1, 2)
    for axis, gains in enumerate(other.gains):  # set-points are those of the log
        other = other.with_gains(axis, replace(gains, attitude=0.0))
    values = {name: laden[name] for name in ("mass", "cg_x", "cg_y", "T_max", *INERTIA)}
    vehicle = replace(drawn.vehicle, **values)
    monkeypatch.setattr("benchmarks.response.SECONDS", 42.0)
    again = Logged(signals.stretches[0][:, 6:9])
    gusts = 0.1 if loop.autopilot == "px4" else 0.0  # as of the flight before
    flew = flown_by_pilot(replace(drawn, vehicle=vehicle), other, gusts, 0, again, ATTITUDE_ONLY)
    highest = said.replay.highest
    truth = replay(flew, then, then, highest).error["flown"][0]
    assert said.replay.error["then"][0] == pytest.approx(truth, rel=0.03)
    assert (truth > 1.1 * said.replay.error["flown"][0]).all()
    weak = hover_dynamics([laden.changed(0.0, place, 0.2)], other, (DELAY, 0.0)), other
    said = what_if(Change({}), signals, (dynamics, loop), weak, flown)
    assert said.replay is None
    assert said.why == ("a hover takes more than full thrust with 1 of 1 vehicles drawn",)
