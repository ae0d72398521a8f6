"""SITL frames, crazyflow, l2f and INDI: their own laws give the identified acceleration.

crazyflow's sibling drone-models and l2f load the file with their own code where they are installed;
the laws of the others stand in C (`SIM_Frame.cpp`, Indiflight's `indi_init.c`), and are repeated.
"""

import json
import os
import re
import subprocess
import sys
import tomllib
from dataclasses import replace
from importlib.util import find_spec
from xml.etree import ElementTree

import numpy as np
import pytest

from gcs_sysid.exports import FORMATS
from gcs_sysid.exports.exported_vehicle import assemble, drawn_vehicles
from gcs_sysid.model.parameters import GRAVITY

from .known import FULL_SPEED, TURN, VALUES, Equations, command_result, estimate

FULL = VALUES["k_T"] * FULL_SPEED**2
U = np.array([0.5, 0.45, 0.55, 0.4])
"""Thrusts over full thrust."""
TRUTH = Equations()


def acceleration(thrusts):
    """(3,) of the identified equations at rest, forward, right, down."""
    return TRUTH.acceleration(thrusts, np.zeros(3), 0.0)


def without_comments(text):
    """As `load_frame_params` does: from the first brace on, and nothing behind a #."""
    return re.sub("#[^\n]*", "", text[text.index("{") :])


def test_a_sitl_frame_is_read_as_sitl_reads_it_and_turns_as_identified():
    vehicle = assemble(command_result())
    model = json.loads(without_comments(FORMATS["ardupilot-sitl"].write(vehicle)))
    assert model["num_motors"] == 4
    assert model["mass"] == VALUES["mass"]
    # Frame::init and Motor::calc_thrust, and the yaw torque's slope about hover.
    full = model["mass"] * GRAVITY / (4 * model["hoverThrOut"])
    assert full == pytest.approx(FULL)
    e = model["propExpo"]
    J = np.diag(model["moment_inertia"])

    def moments(u):
        thrusts = full * ((1.0 - e) * u + e * u * u)
        total = np.zeros(3)
        for i, (T, c) in enumerate(zip(thrusts, u, strict=True), 1):
            total += np.cross(model[f"motor{i}_position"], [0.0, 0.0, -T])
            total[2] += model[f"motor{i}_yaw"] * c * 0.05 * model["diagonal_size"] * T
        return total, thrusts

    share = model["hoverThrOut"]
    hover = np.full(4, share**0.5)
    (before, level), (after, turned) = moments(hover), moments(hover + 1e-4 * TRUTH.spins)
    assert level.sum() == pytest.approx(model["mass"] * GRAVITY)
    expected = VALUES["moment_ratio"] * TRUTH.spins @ (turned - level)
    assert (after - before)[2] == pytest.approx(expected, rel=1e-3)
    own = Equations()
    assert moments(U)[0][:2] == pytest.approx(own.moment(moments(U)[1])[:2])
    assert np.diag(J) == pytest.approx(np.diag(TRUTH.J))
    assert model["refRotRate"] == pytest.approx(
        np.radians(400.0) * 0.5 * (VALUES["Ixx"] + VALUES["Iyy"]) / VALUES["rotational_damping"]
    )


def test_crazyflow_turns_as_identified(vehicle):
    text = FORMATS["crazyflow"].write(vehicle)
    p = tomllib.loads(text)[vehicle.name]
    rpm = np.sqrt(U) * FULL_SPEED * 60.0 / (2.0 * np.pi)
    thrusts = np.array(p["rpm2thrust"][2]) * rpm**2
    mixing = np.array(p["mixing_matrix"])
    torque = mixing @ thrusts * [p["L"], p["L"], 0.0]
    torque[2] += mixing[2] @ (p["rpm2torque"][2] * rpm**2)
    assert TURN @ np.linalg.solve(np.array(p["J"]), torque) == pytest.approx(acceleration(U * FULL))
    assert p["drag_matrix"][0][0] == -VALUES["linear_drag"]
    assert p["rotor_dyn_coef"][0] == pytest.approx(1.0 / vehicle["motor_lag"])


DRONE_MODELS = """
import json, sys, tomllib
import drone_models
import numpy as np
from drone_models.first_principles import dynamics

(p,) = tomllib.load(open(sys.argv[1], "rb")).values()
rpm, J = np.array(json.loads(sys.argv[2])), np.array(p["J"])
names = ("mass", "L", "prop_inertia", "gravity_vec", "rpm2thrust", "rpm2torque", "mixing_matrix",
         "drag_matrix", "rotor_dyn_coef")
level, still = np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3)
out = dynamics(still, level, still, still, rpm, rpm, J=J, J_inv=np.linalg.inv(J),
               **{n: np.asarray(p[n]) for n in names})
print(json.dumps([out[2].tolist(), out[3].tolist()]))
"""


@pytest.mark.skipif(find_spec("drone_models") is None, reason="drone-models is not installed")
def test_drone_models_flies_the_file(vehicle, tmp_path):
    (tmp_path / "params.toml").write_text(FORMATS["crazyflow"].write(vehicle))
    rpm = np.sqrt(U) * FULL_SPEED * 60.0 / (2.0 * np.pi)
    # It wants SciPy imported its own way: a process of its own.
    done = subprocess.run(
        [sys.executable, "-c", DRONE_MODELS, tmp_path / "params.toml", json.dumps(rpm.tolist())],
        env={**os.environ, "SCIPY_ARRAY_API": "1"},
        capture_output=True,
        encoding="utf-8",
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    force, turning = json.loads(done.stdout)
    assert TURN @ turning == pytest.approx(acceleration(U * FULL))
    assert force[2] == pytest.approx(U.sum() * FULL / VALUES["mass"] - 9.81)


@pytest.mark.parametrize("by", ["speed", "command"])
def test_l2f_turns_as_identified(vehicle, by):
    vehicle = vehicle if by == "speed" else assemble(command_result())
    p = json.loads(FORMATS["l2f"].write(vehicle))["dynamics"]
    x = np.sqrt(U)
    torque = np.zeros(3)
    for i in range(4):
        c0, c1, c2 = p["rotor_thrust_coefficients"][i]
        T = c0 + c1 * x[i] + c2 * x[i] ** 2
        assert pytest.approx(U[i] * FULL) == T
        torque += np.cross(p["rotor_positions"][i], T * np.array(p["rotor_thrust_directions"][i]))
        torque += T * p["rotor_torque_constants"][i] * np.array(p["rotor_torque_directions"][i])
    assert TURN @ np.array(p["J_inv"]) @ torque == pytest.approx(acceleration(U * FULL))
    assert np.array(p["J"]) @ np.array(p["J_inv"]) == pytest.approx(np.eye(3))
    hover = p["hovering_throttle_relative"]
    assert 4 * FULL * hover**2 == pytest.approx(VALUES["mass"] * GRAVITY)


@pytest.mark.parametrize("by", ["speed", "command"])
def test_l2f_itself_turns_as_identified(vehicle, by):
    l2f_itself = pytest.importorskip("l2f")  # half an hour to build: not among the dependencies
    vehicle = vehicle if by == "speed" else assemble(command_result())
    device, rng, flown = l2f_itself.Device(), l2f_itself.Rng(), l2f_itself.Environment()
    parameters, state, after = l2f_itself.Parameters(), l2f_itself.State(), l2f_itself.State()
    l2f_itself.initialize_rng(device, rng, 0)
    l2f_itself.initialize_environment(device, flown)
    l2f_itself.initial_parameters(device, flown, parameters)
    theirs = json.loads(l2f_itself.parameters_to_json(device, flown, parameters))
    theirs["dynamics"] = json.loads(FORMATS["l2f"].write(vehicle))["dynamics"]
    l2f_itself.parameters_from_json(device, flown, json.dumps(theirs), parameters)
    l2f_itself.initial_state(device, flown, parameters, state)
    state.orientation = np.array([1.0, 0.0, 0.0, 0.0])
    state.linear_velocity = state.angular_velocity = np.zeros(3)
    state.rpm = np.sqrt(U)  # settled: the action asks for the same
    dt = l2f_itself.step(device, flown, parameters, state, 2.0 * np.sqrt(U) - 1.0, after, rng)
    # Single precision, and what turning adds to turning within its step of 10 ms.
    turned = TURN @ np.array(after.angular_velocity) / dt
    assert turned == pytest.approx(acceleration(U * FULL), rel=0.02, abs=0.01)
    climbed = U.sum() * FULL / VALUES["mass"] - GRAVITY
    assert np.array(after.linear_velocity)[2] / dt == pytest.approx(climbed, rel=0.02)


def numbers_of(text, name):
    return np.array([float(v) for v in re.search(rf"{name} = (.*)", text)[1].split(",")])


def test_indiflight_has_the_identified_effectiveness(vehicle):
    text = FORMATS["indiflight"].write(vehicle)
    found = np.array([0.1 * numbers_of(text, f"indi_act_g1_{a}") for a in ("roll", "pitch", "yaw")])
    assert found @ U == pytest.approx(acceleration(U * FULL), abs=0.1 * 2)
    assert 0.01 * numbers_of(text, "indi_act_g1_fz") == pytest.approx(
        np.full(4, -FULL / VALUES["mass"]), abs=0.006
    )
    reaction = 1e-5 * numbers_of(text, "indi_act_g2_yaw")
    expected = np.linalg.solve(TRUTH.J, [0.0, 0.0, VALUES["rotor_inertia"]])[2] * TRUTH.spins
    assert reaction == pytest.approx(expected, abs=6e-6)
    assert numbers_of(text, "indi_act_time_const_ms").tolist() == [40.0] * 4


def test_paparazzi_has_the_slopes_about_hover(vehicle):
    section = ElementTree.fromstring(FORMATS["paparazzi"].write(vehicle))
    values = {
        d.get("name"): np.array([float(v) for v in d.get("value").split(",")]) for d in section
    }
    # T = T_max u by speeds (no curve known): 9600 units are full thrust.
    per_unit = FULL / 9600.0
    change = np.array([30.0, -20.0, 10.0, 5.0])
    found = [values[f"G1_{a}"] @ change / 1000.0 for a in ("ROLL", "PITCH", "YAW")]
    hover = np.full(4, 0.5 * FULL)
    expected = acceleration(hover + change * per_unit) - acceleration(hover)
    assert found == pytest.approx(expected, rel=1e-6)
    assert values["ACT_FREQ"].tolist() == [25.0] * 4
    speed = np.sqrt(VALUES["mass"] * GRAVITY / 4 / VALUES["k_T"])
    turning = per_unit / (2.0 * VALUES["k_T"] * speed) * 512.0
    inertia = np.linalg.solve(TRUTH.J, [0.0, 0.0, VALUES["rotor_inertia"]])[2]
    assert values["G2"] / 1000.0 == pytest.approx(inertia * turning * TRUTH.spins, rel=1e-6)


def test_gazebo_has_each_rotors_own_coefficients(result):
    shares = (1.02, 0.98, 1.01, 0.99)
    rotors = tuple(
        {n: estimate(n, s * VALUES[n]) for n in ("k_T", "k_M")} for s in shares
    )  # k_M / k_T stays
    vehicle = assemble(
        replace(result, rotors=rotors), given={"rotor_speed_max": FULL_SPEED, "motor_lag": 0.04}
    )
    text = FORMATS["gazebo-sdf"].write(vehicle)
    constants = [float(v) for v in re.findall("<motorConstant>(.*)</motorConstant>", text)]
    assert constants == pytest.approx([s * VALUES["k_T"] for s in shares])
    assert "each rotor has its own" in " ".join(FORMATS["gazebo-sdf"].notes(vehicle))


@pytest.mark.slow
def test_an_ensemble_has_the_covariance_of_the_result(result):
    names = ["Izz", "k_M"]
    stds = [0.02 * VALUES["Izz"], 0.02 * VALUES["k_M"]]
    matrix = np.outer(stds, stds) * [[1.0, 0.95], [0.95, 1.0]]
    known = result.parameters | {n: estimate(n, VALUES[n], 0.02) for n in names}
    vehicle = assemble(
        replace(result, parameters=known, covariance={"names": names, "matrix": matrix.tolist()})
    )
    drawn = drawn_vehicles(vehicle, 400, seed=7)
    table = np.array([[v[n] for n in ("Izz", "k_M", "Ixx")] for v in drawn])
    correlation = np.corrcoef(table.T)
    assert correlation[0, 1] == pytest.approx(0.95, abs=0.03)
    assert abs(correlation[0, 2]) < 0.15
    assert table.std(axis=0)[:2] == pytest.approx(stds, rel=0.12)
    assert table[:, 0].mean() == pytest.approx(VALUES["Izz"], rel=0.005)
    assert all(v["moment_ratio"] == pytest.approx(v["k_M"] / v["k_T"]) for v in drawn)
    assert [v["Izz"] for v in drawn_vehicles(vehicle, 3, 7)] == table[:3, 0].tolist()
