"""Margins and steps of loops whose answers are known, and those measured in the emulator."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.response import true_vehicle
from benchmarks.tune import RATE_MODE, SLOW, Steps
from gcs_sysid.control.loop_margins import (
    HoverDynamics,
    frequencies,
    hover_dynamics,
    margins_of,
    open_loops,
    step_response,
)
from gcs_sysid.control.rate_loops import read_loop
from gcs_sysid.control.tuning_study import LIMITS, propose
from gcs_sysid.exports.exported_vehicle import KnownEstimate, MissingError, drawn_vehicles
from sim_bridge.controller import Gains
from sim_bridge.rate_controllers import CONTROLLERS
from sim_bridge.simulation import Simulation
from sim_bridge.vehicle_files import load_vehicle

OMEGA = np.geomspace(0.1, 1000.0, 1500)


def known_vehicle(share=0.01, **changes):
    """The emulator's `paper` as identified, every standard deviation a share of the value."""
    truth = load_vehicle("paper")
    whole = true_vehicle(truth)
    values = {n: estimate.value for n, estimate in whole.known.items()} | changes
    known = {
        n: KnownEstimate(v, abs(share * v) or None, origin="identified")
        for n, v in values.items()
        if v is not None
    }
    return truth, replace(whole, known=known)


def test_a_payload_is_a_point_mass_and_a_low_battery_another_full_thrust():
    _, vehicle = known_vehicle(cg_x=0.01, cg_y=-0.02)
    laden = vehicle.changed(0.4, place := np.array([0.1, 0.05, 0.03]), 0.8)
    whole, own = vehicle["mass"] + 0.4, np.array([0.01, -0.02, 0.0])
    cg = (vehicle["mass"] * own + 0.4 * place) / whole
    expected = vehicle.inertia
    for mass, arm in ((vehicle["mass"], own - cg), (0.4, place - cg)):
        expected = expected + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    assert laden.inertia == pytest.approx(expected)
    assert [laden[n] for n in ("mass", "cg_x", "cg_y")] == pytest.approx([whole, *cg[:2]])
    assert laden["T_max"] == pytest.approx(0.8 * vehicle["T_max"])


def test_margins_of_a_known_loop():
    # k / (s (1 + s/10)^2): -180 deg at 10 rad/s, where it is k/20; k = 5 leaves 12.04 dB.
    s = 1j * OMEGA
    margins = margins_of(OMEGA, (5.0 / (s * (1.0 + s / 10.0) ** 2))[None])
    assert margins.gain[0] == pytest.approx(12.04, abs=0.02)
    w = margins.crossover[0]
    assert margins.phase[0] == pytest.approx(90.0 - 2.0 * np.degrees(np.arctan(w / 10.0)), abs=0.1)
    assert margins.delay[0] == pytest.approx(np.radians(margins.phase[0]) / w)
    assert np.isinf(margins.reduction[0])


def test_a_loop_with_too_much_gain_is_unstable():
    s = 1j * OMEGA
    margins = margins_of(OMEGA, (50.0 / (s * (1.0 + s / 10.0) ** 2))[None])
    assert margins.phase[0] < 0.0
    assert margins.gain[0] == pytest.approx(-7.96, abs=0.05)


def test_a_conditionally_stable_loop_may_lose_gain_only_so_far():
    # Three integrators with lead: unstable with little gain.
    s = 1j * OMEGA
    loop = 20.0 * (s + 1.0) ** 2 / s**3 / (1.0 + s / 200.0)
    margins = margins_of(OMEGA, loop[None])
    assert margins.phase[0] > 0.0
    assert np.isfinite(margins.reduction[0])
    assert margins.reduction[0] > 0.0


def simple_dynamics(gain=100.0, lag=0.03, delay=0.005):
    zero = np.zeros((1, 3, 3))
    return HoverDynamics(
        gain * np.eye(3)[None], zero, zero, np.array([lag]), np.array([delay]), np.full((1, 4), 0.4)
    )


def test_the_step_response_is_that_of_the_loop_simulated_in_time():
    dynamics = simple_dynamics()
    loop = read_loop("ardupilot", {}, load_vehicle("paper").rotors)
    step = step_response(dynamics, loop, 0)
    # The same loop stepped forward: exact lag over sub-steps, delay of two loops.
    gains, T, sub = loop.gains[0], loop.period, 20
    a = np.exp(-T / sub / 0.03)
    torque, rate, angle = 0.0, 0.0, 0.0
    share = T / (T + 1.0 / (2.0 * np.pi * 20.0))
    target = error = slope = integral = 0.0
    k = np.tan(np.pi * 20.0 * T / sub)
    c = 1.0 + np.sqrt(2.0) * k + k * k
    d1 = d2 = 0.0
    queue, track = [0.0, 0.0], []
    filtered = 0.0
    for _ in range(800):
        track.append(angle)
        target += share * (gains.attitude * (1.0 - angle) - target)
        new = target - filtered
        slope += share * ((new - error) / T - slope)
        error = new
        integral += gains.I * error * T
        queue.append(gains.P * error + integral + gains.D * slope)
        u = queue.pop(0)
        for _ in range(sub):
            torque = u + (torque - u) * a
            rate += 100.0 * torque * T / sub
            angle += rate * T / sub
            d0 = rate - 2.0 * (k * k - 1.0) / c * d1 - (1.0 - np.sqrt(2.0) * k + k * k) / c * d2
            filtered = k * k / c * (d0 + 2.0 * d1 + d2)
            d1, d2 = d0, d1
    assert np.abs(step.values[0, :800] - track).max() < 0.02
    assert step.overshoot[0] == pytest.approx(max(max(track) - 1.0, 0.0), abs=0.01)


@pytest.mark.slow
def test_proposed_gains_keep_the_margins_on_every_draw():
    _, vehicle = known_vehicle(share=0.03)
    loop = read_loop("px4", {}, vehicle.rotors)
    draws = [vehicle, *drawn_vehicles(vehicle, 12, 3)]
    dynamics = hover_dynamics(draws, loop, (0.005, 0.001))
    loop = propose(dynamics, loop)
    omega = frequencies(loop)
    loops = open_loops(dynamics, loop, omega)
    for axis in range(3):
        phase, gain = margins_of(omega, loops[:, :, axis]).worst()
        assert phase >= LIMITS.phase_margin - 0.5
        assert gain >= LIMITS.gain_margin - 0.2
    # A vehicle that is known worse is given gains no higher.
    _, rough = known_vehicle(share=0.12)
    wide = hover_dynamics([rough, *drawn_vehicles(rough, 12, 3)], loop, (0.005, 0.001))
    assert propose(wide, loop).gains[0].P < loop.gains[0].P


@pytest.mark.slow
@pytest.mark.parametrize(
    "autopilot",
    ["px4", "betaflight-adrc", *(pytest.param(a, marks=pytest.mark.thorough)
                                 for a in ("ardupilot", "betaflight", "inav"))],
)  # fmt: skip
def test_the_predicted_loop_is_that_measured_in_the_emulator(autopilot):
    """Tones on the roll torque of the flying emulator: the loop transfer at each."""
    truth, vehicle = known_vehicle()
    loop = read_loop(autopilot, SLOW, vehicle.rotors)
    dynamics = hover_dynamics([vehicle], loop, (0.005, 0.0))
    loop = propose(dynamics, loop)
    tones = 2.0 * np.pi * np.array([2.0, 3.5, 5.0, 8.0, 12.0])
    settings = {**loop.as_parameters(), **RATE_MODE}

    def injection(t):
        return 0.005 * float(np.cos(tones * t).sum()), 0.0, 0.0

    sim = Simulation(
        truth,
        Steps(0, at=np.inf),
        np.random.SeedSequence(1),
        0.0,
        step_us=1250,
        control_steps=2,
        controller=lambda v, period: CONTROLLERS[autopilot](
            v, period, settings, 2, Gains(position=0.0, velocity=0.0), injection
        ),
    )
    rows = []
    for _ in range(4800):
        sim.step()
        if sim.tick % 2 == 0:
            controller = sim._controller
            rows.append((sim.time, controller.asked[0], controller.sent[0]))
    t, asked, sent = np.array(rows)[-800:].T
    wave = np.exp(-1j * np.outer(tones, t))
    found = -(wave @ asked) / (wave @ sent)
    expected = open_loops(dynamics, loop, tones)[0, :, 0]
    assert np.abs(20.0 * np.log10(np.abs(found / expected))).max() < 1.0
    assert np.abs(np.degrees(np.angle(found / expected))).max() < 5.0


@pytest.mark.parametrize(
    ("gone", "says"),
    [("motor_lag", "flight with commands"), ("Ixx", "doublets"), ("mass", "--mass KG"),
     ("moment_ratio", "yaw together")],
)  # fmt: skip
def test_what_a_result_does_not_carry_is_refused_with_the_flight_that_helps(gone, says):
    _, vehicle = known_vehicle(**{gone: None})
    loop = read_loop("px4", {}, vehicle.rotors)
    with pytest.raises(MissingError, match=rf"{gone}.*{says}"):
        hover_dynamics([vehicle], loop, (0.005, 0.0))


def test_unknown_rotor_inertia_widens_yaw_alone():
    _, vehicle = known_vehicle(rotor_inertia=None)
    loop = read_loop("px4", {}, vehicle.rotors)
    draws = [vehicle, *drawn_vehicles(vehicle, 20, 1)]
    dynamics = hover_dynamics(draws, loop, (0.005, 0.0))
    assert any("rotor inertia" in note for note in dynamics.notes)
    spread = np.ptp(np.abs(dynamics.response(np.array([20.0]))[:, 0]), axis=0)
    size = np.abs(dynamics.response(np.array([20.0]))[0, 0])
    assert spread[2, 2] / size[2, 2] > 0.5
    assert spread[0, 0] / size[0, 0] < 0.2


def test_the_plant_as_an_object_of_python_control():
    control = pytest.importorskip("control")
    _, vehicle = known_vehicle()
    loop = read_loop("px4", {}, vehicle.rotors)
    dynamics = hover_dynamics([vehicle], loop, (0.005, 0.0))
    plant = dynamics.as_control(0)
    omega = np.array([3.0, 20.0])
    expected = dynamics.response(omega)[0, :, 0, 0]
    # Off-diagonal inertia is not in one axis' transfer function: within its share.
    assert control.frequency_response(plant, omega).complex == pytest.approx(expected, rel=0.05)
