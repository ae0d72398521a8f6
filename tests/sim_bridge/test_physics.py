"""Effects switched on: from the command line, from Python, into the truth file."""

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_bridge.choices import Span
from sim_bridge.cli import main
from sim_bridge.doublets import ALL_MISSIONS, DOUBLETS
from sim_bridge.ensemble import fly_ensemble
from sim_bridge.missions import MISSIONS
from sim_bridge.physics import IDEAL, KINDS, Physics, Weakening, make_physics, parse_physics
from sim_bridge.simulated_vehicle import Vehicle
from sim_bridge.simulation import Simulation
from sim_bridge.vehicle_files import load_vehicle

Read = Callable[[Path], Iterator[tuple[int, Any]]]


def fly(tmp_path: Path, *words: str) -> tuple[Path, dict[str, Any]]:
    log, truth = tmp_path / "flight.tlog", tmp_path / "flight.json"
    assert main([*words, "--force", "--tlog", str(log), "--truth", str(truth)]) == 0
    return log, json.loads(truth.read_text())


def usual() -> Physics:
    return make_physics([parse_physics("all")])


def test_every_effect_has_a_name_and_nothing_is_on_by_default() -> None:
    assert {name.replace("-", "_") for name in KINDS} == set(vars(IDEAL))
    assert not IDEAL.switched_on
    # A usual command at idle and a usual lag are the defaults themselves.
    assert set(usual().switched_on) >= set(KINDS) - {"idle"}


def test_a_vehicle_that_cannot_hover_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # With its CG out so far, canting the rotors by this much leaves the paper's vehicle no trim.
    words = ["--physics", "weak=1.15", "--physics", "thrust-curve=0.3", "--physics", "tilt=40"]
    assert main([*words, "--tlog", str(tmp_path / "x.tlog"), "--duration", "1"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_an_effect_of_no_strength_changes_no_byte(tmp_path: Path) -> None:
    words = ("--duration", "3", "--rate", "50", "--mission", "all-axes")
    plain, truth = fly(tmp_path, *words)
    before = plain.read_bytes()
    none, same = fly(tmp_path, *words, "--physics", "rotor-drag=0", "--physics", "idle=0.05")
    assert none.read_bytes() == before
    assert same == truth
    assert "physics" not in truth


def test_effects_leave_noise_and_gusts_as_they_were(paper_vehicle: Vehicle) -> None:
    hover = MISSIONS["hover"]
    faint = Physics(quadratic_drag=1e6, ou_force=(1e-12, 1.0), scatter=1e-12)
    plain, nearly = (
        fly_ensemble(paper_vehicle, hover, 50.0, duration=4.0, seed=3, physics=on)
        for on in (IDEAL, faint)
    )
    assert abs(plain.gyro).max() > 0.01
    np.testing.assert_allclose(nearly.gyro, plain.gyro, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(
    "autopilot", [pytest.param("px4", marks=pytest.mark.thorough), "ardupilot"]
)
def test_both_autopilots_fly_with_everything_on(
    tmp_path: Path, read_tlog: Read, autopilot: str
) -> None:
    log, truth = fly(
        tmp_path,
        *("--autopilot", autopilot, "--airframe", f"{autopilot}-quad-x", "--mission", "climbs"),
        *("--rate", "20", "--duration", "25", "--physics", "all"),
    )
    heights, volts, frozen = [], [], 0
    for _, message in read_tlog(log):
        kind = message.get_type()
        if kind == "LOCAL_POSITION_NED":
            heights.append(-message.z)
        elif kind == "SYS_STATUS":
            volts.append(1e-3 * message.voltage_battery)
        frozen += kind == "HIGHRES_IMU" and not math.isfinite(message.xgyro)
    assert 8.0 < min(heights) < max(heights) < 14.0
    assert volts[-1] < 0.985 * volts[0]
    assert not frozen
    assert set(truth["physics"]) >= set(KINDS) - {"idle"}
    assert truth["k_T"] == pytest.approx(np.mean(truth["k_T_rotors"]))
    assert (truth["damping"][2], truth["rotor_tilt"]) == (
        pytest.approx(0.05 * truth["Izz"]),
        pytest.approx(math.radians(4.0)),
    )
    (event,) = truth["events"]
    assert (event["kind"], event["t"]) == ("rotor_failure", 20.0)
    ratio = event["after"]["k_T_rotors"][0] / event["before"]["k_T_rotors"][0]
    assert ratio == pytest.approx(0.9)


def test_the_seed_fixes_every_byte_with_everything_on(tmp_path: Path) -> None:
    words = ("--duration", "2", "--rate", "50", "--physics", "all", "--seed", "4")
    first = fly(tmp_path, *words)[0].read_bytes()
    assert fly(tmp_path, *words)[0].read_bytes() == first
    assert fly(tmp_path, *words[:-1], "5")[0].read_bytes() != first


def simulation(vehicle: Vehicle, physics: Physics, mission: str = "hover") -> Simulation:
    return Simulation(
        vehicle, ALL_MISSIONS[mission], np.random.SeedSequence(0), 0.0, physics=physics
    )


def until(sim: Simulation, seconds: float) -> Simulation:
    while sim.time < seconds - 1e-9:
        sim.step()
    return sim


def test_a_throttle_cut_lets_the_vehicle_fall(paper_vehicle: Vehicle) -> None:
    sim = simulation(paper_vehicle, Physics(throttle_cut=Span(1.0, 0.4), idle=0.0))
    until(sim, 1.399)
    assert sim.targets == [0.0] * 4
    assert sim.state.velocity[2] > 2.0
    until(sim, 8.0)
    assert abs(sim.state.position[2] + 10.0) < 1.0


def test_a_punch_out_takes_a_rotor_to_its_limit_and_keeps_attitude(paper_vehicle: Vehicle) -> None:
    sim = simulation(paper_vehicle, Physics(punch_out=Span(1.0, 0.5)))
    until(sim, 1.45)
    most = max(paper_vehicle.command_of(target) for target in sim.targets)
    assert most == pytest.approx(1.0)
    assert sim.state.velocity[2] < -3.0
    _, b, c, _ = sim.state.quaternion
    assert 2.0 * math.hypot(b, c) < 0.2


def test_a_rotor_weakens_in_flight_and_the_truth_says_when(paper_vehicle: Vehicle) -> None:
    sim = simulation(paper_vehicle, Physics(weakening=Weakening(2, 1.0, 0.2, 0.5)))
    until(sim, 1.25)
    assert sim.vehicle.traits is not None
    assert sim.vehicle.traits.thrust[1] == pytest.approx(0.9, abs=0.002)
    until(sim, 3.0)
    assert sim.vehicle.traits.thrust == pytest.approx((1.0, 0.8, 1.0, 1.0))
    ((change, before, after),) = sim.done
    assert (change.kind, change.time) == ("rotor_failure", 1.0)
    assert before.traits is not None
    assert after.traits is not None
    assert (before.traits.thrust[1], after.traits.thrust[1]) == (1.0, pytest.approx(0.8))


def test_a_sagging_battery_asks_for_more_command(paper_vehicle: Vehicle) -> None:
    sim = until(simulation(paper_vehicle, Physics(battery=(0.1, 10.0))), 10.0)
    # Thrust still carries the weight; the commands ask for 1 / (1 - 0.1) of the speed.
    asked = np.array(sim.targets) / np.array(sim.state.speeds)
    np.testing.assert_allclose(asked, 1.0 / 0.9, rtol=0.01)
    assert sim.voltage == pytest.approx(0.9 * 16.4, rel=1e-6)


def test_a_turned_imu_reads_turned_axes(paper_vehicle: Vehicle) -> None:
    on = Physics(imu_rotation=(0.0, 0.0, 0.5 * math.pi))
    plain, turned = (until(simulation(paper_vehicle, p, "all-axes"), 4.0) for p in (IDEAL, on))
    (p, q, r), (x, y, z) = plain.imu()
    # Turned to the right by a quarter: its x axis looks along the body's y.
    np.testing.assert_allclose(turned.imu()[0], [q, -p, r], atol=1e-12)
    np.testing.assert_allclose(turned.imu()[1], [y, -x, z], atol=1e-12)
    assert turned.rates() == turned.imu()[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "mission",
    ["climbs", *(pytest.param(m, marks=pytest.mark.thorough) for m in ("gentle", "acro"))],
)
def test_doublets_reach_their_rates_and_stay_in_place(mission: str) -> None:
    flown = ALL_MISSIONS[mission]
    flight = fly_ensemble(load_vehicle("px4-quad-x"), flown, 50.0, 34.0)
    most = abs(flight.gyro[0]).max(axis=0)
    asked = next(m for m in DOUBLETS if m.name == mission)
    np.testing.assert_allclose(most[:2], asked.rate, rtol=0.1)
    assert most[2] > 0.8 * asked.yaw_rate
    height = -np.cumsum(flight.velocity[0, :, 2]) * flight.interval
    assert height.max() == pytest.approx(asked.climb, abs=0.12)
    assert abs(height.min()) < 0.12
