"""A file that QGroundControl takes, with which PX4's SIH flies the identified vehicle.

SIH is part of the autopilot and in no package, so its equations (`simulator_sih/sih.cpp`) stand
here, and its own recording: the parameters it flew with are found in the export of its flight.
"""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.exports import FORMATS
from gcs_sysid.exports.autopilot_simulators import mission
from gcs_sysid.exports.exported_vehicle import MissingError, assemble
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.attitude import from_euler
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.signals.records import Samples
from gcs_sysid.signals.sampling import SampleBlock

from .known import FULL_SPEED, LAG, VALUES, Equations, command_result, speed_result, without

REAL32, INT32 = 9, 6


def parameters(text):
    """As QGroundControl reads: five columns with tabs, `#` for comments."""
    out = {}
    for line in text.splitlines():
        if line.startswith("#"):
            continue
        vehicle, component, name, value, kind = line.split("\t")
        assert (vehicle, component) == ("1", "1")
        assert len(name) <= 16
        out[name] = {REAL32: float, INT32: int}[int(kind)](value)
    return out


def sih(p, u, w):
    """Angular acceleration of SIH's quadcopter with parameters p, outputs u, rates w."""
    inertia = np.diag([p["SIH_IXX"], p["SIH_IYY"], p["SIH_IZZ"]])
    inertia[0, 1] = inertia[1, 0] = p["SIH_IXY"]
    inertia[0, 2] = inertia[2, 0] = p["SIH_IXZ"]
    inertia[1, 2] = inertia[2, 1] = p["SIH_IYZ"]
    moment = np.array(
        [
            p["SIH_L_ROLL"] * p["SIH_T_MAX"] * (-u[0] + u[1] + u[2] - u[3]),
            p["SIH_L_PITCH"] * p["SIH_T_MAX"] * (u[0] - u[1] + u[2] - u[3]),
            p["SIH_Q_MAX"] * (u[0] + u[1] - u[2] - u[3]),
        ]
    )
    drag = -p["SIH_KDW"] * w
    return np.linalg.solve(inertia, moment + drag - np.cross(w, inertia @ w))


@pytest.mark.parametrize("rates", [(0.0, 0.0, 0.0), (1.0, -2.0, 3.0)])
@pytest.mark.parametrize(
    "outputs", [(0.4, 0.3, 0.3, 0.4), (0.5, 0.5, 0.3, 0.3), (0.5, 0.3, 0.5, 0.3)]
)
def test_torque_becomes_the_identified_acceleration(vehicle, outputs, rates):
    found = sih(parameters(FORMATS["px4-sih"].write(vehicle)), outputs, np.array(rates))
    thrusts = VALUES["k_T"] * FULL_SPEED**2 * np.array(outputs)
    # SIH has no place for a CG that is off.
    expected = Equations().acceleration(
        thrusts, np.array(rates), VALUES["rotational_damping"], cg=np.zeros(3)
    )
    assert found == pytest.approx(expected, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("by", ["speed", "command"])
def test_values_units_and_signs(vehicle, by):
    flown = vehicle if by == "speed" else assemble(command_result())
    found = parameters(FORMATS["px4-sih"].write(flown))
    full = VALUES["k_T"] * FULL_SPEED**2
    at = 0.3 / math.sqrt(2.0)
    expected = {
        "SIH_MASS": VALUES["mass"], "SIH_IXX": VALUES["Ixx"], "SIH_IYY": VALUES["Iyy"],
        "SIH_IZZ": VALUES["Izz"], "SIH_IXY": VALUES["Ixy"], "SIH_IYZ": VALUES["Iyz"],
        "SIH_IXZ": VALUES["Ixz"], "SIH_T_MAX": full, "SIH_Q_MAX": full * VALUES["moment_ratio"],
        "SIH_L_ROLL": at, "SIH_L_PITCH": at, "SIH_KDV": VALUES["linear_drag"],
        "SIH_KDW": VALUES["rotational_damping"], "SIH_T_TAU": LAG, "SIH_VEHICLE_TYPE": 0,
        "CA_AIRFRAME": 0, "CA_ROTOR_COUNT": 4, "THR_MDL_FAC": 0.0,
    }  # fmt: skip
    for i, (x, y, spin) in enumerate([(at, at, 1), (-at, -at, 1), (at, -at, -1), (-at, at, -1)]):
        expected |= {f"CA_ROTOR{i}_PX": x, f"CA_ROTOR{i}_PY": y}
        expected[f"CA_ROTOR{i}_KM"] = spin * VALUES["moment_ratio"]
    assert found == pytest.approx(expected, rel=1e-6)


def test_what_has_no_place_is_said(vehicle):
    text = FORMATS["px4-sih"].write(vehicle)
    note = next(n for n in FORMATS["px4-sih"].notes(vehicle) if "no place" in n)
    assert "cg_x (0.06 m)" in note
    assert "cg_y (-0.025 m)" in note
    assert f"# Note: {note}\n" in text


def test_what_is_not_known_keeps_its_value(result):
    vehicle = assemble(without(result, "linear_drag"), given={"T_max": 9.0})
    found = parameters(FORMATS["px4-sih"].write(vehicle))
    assert found["SIH_T_MAX"] == 9.0
    assert not {"SIH_KDV", "SIH_T_TAU"} & found.keys()
    notes = FORMATS["px4-sih"].notes(vehicle)
    assert any("SIH_KDV (linear_drag), SIH_T_TAU" in note for note in notes)


def test_full_thrust_and_lag_come_from_hover_where_speeds_have_commands_beside_them(result):
    hover = {"thrust_to_weight": {"value": 2.0, "std": 0.02}, "motor_lag": 0.04}
    vehicle = assemble(replace(result, health=hover))
    found = parameters(FORMATS["px4-sih"].write(vehicle))
    weight = VALUES["mass"] * GRAVITY
    assert found["SIH_T_MAX"] == pytest.approx(2.0 * weight / 4)
    assert found["SIH_T_TAU"] == pytest.approx(0.04)
    known = vehicle.known["T_max"]
    assert known.std == pytest.approx(0.01 * known.value)
    by_hand = assemble(replace(result, health=hover), given={"rotor_speed_max": FULL_SPEED})
    assert by_hand["T_max"] == pytest.approx(VALUES["k_T"] * FULL_SPEED**2)


@pytest.mark.parametrize(
    "ratio", [None, 2.0, {"value": 2.0}, {"value": 2.0, "std": 1.1}, {"value": "2", "std": 0.1}]
)
def test_what_hover_does_not_show_is_still_asked_for(result, ratio):
    vehicle = assemble(replace(result, health={"thrust_to_weight": ratio}))
    with pytest.raises(MissingError, match=r"needs T_max.*--set rotor_speed_max=RAD_S"):
        FORMATS["px4-sih"].write(vehicle)


HEXA = {
    # Of roll, pitch (over sqrt(3) / 2) and yaw: what rotors 0 to 5 add, as sih.cpp has them.
    "px4-sih-1.17": [(-.5, -1, -.5, .5, 1, .5), (1, 0, -1, -1, 0, 1), (1, -1, 1, -1, 1, -1)],
    "px4-sih": [(-1, 1, .5, -.5, -.5, .5), (0, 0, 1, -1, 1, -1), (-1, 1, -1, 1, 1, -1)],
}  # fmt: skip


@pytest.mark.parametrize("name", [*HEXA])
def test_a_hexacopter_is_allocated_as_sih_of_its_version_flies(name):
    airframe = load_airframe("px4-hexa-x").with_arm(0.4).as_json()
    vehicle = assemble(speed_result(airframe=airframe), given={"T_max": 9.0})
    found = parameters(FORMATS[name].write(vehicle))
    assert found["SIH_VEHICLE_TYPE"] == 4
    assert found["SIH_L_ROLL"] == found["SIH_L_PITCH"] == pytest.approx(0.4)
    assert found["THR_MDL_FAC"] == (name == "px4-sih")
    x, y, spin = (
        np.array([found[f"CA_ROTOR{i}_{of}"] for i in range(6)]) for of in ("PX", "PY", "KM")
    )
    roll, pitch, yaw = np.array(HEXA[name])
    assert -y / 0.4 == pytest.approx(roll)
    assert x / 0.4 == pytest.approx(math.sqrt(0.75) * pitch)
    assert np.sign(spin).tolist() == yaw.tolist()


@pytest.mark.parametrize("change", ["order", "spins", "lopsided"])
def test_layouts(result, change):
    rotors = [dict(rotor) for rotor in result.airframe["rotors"]]
    if change == "order":
        rotors = rotors[::-1]
    elif change == "spins":
        for rotor in rotors:
            rotor["spin"] = {"cw": "ccw", "ccw": "cw"}[rotor["spin"]]
    else:
        rotors[0]["x"] *= 1.5
    changed = speed_result(airframe={"name": "mine", "rotors": rotors})
    vehicle = assemble(changed, given={"T_max": 9.0})
    if change == "order":  # SIH has its own
        usual = assemble(result, given={"T_max": 9.0})
        assert parameters(FORMATS["px4-sih"].write(vehicle)) == parameters(
            FORMATS["px4-sih"].write(usual)
        )
    else:
        with pytest.raises(InputError, match="px4-sih"):
            FORMATS["px4-sih"].write(vehicle)


def test_the_way_of_a_flight_is_a_mission_of_straight_legs():
    t = np.arange(0.0, 30.0, 0.1)
    velocity = np.zeros((len(t), 3))
    velocity[100:200, 0] = velocity[200:, 1] = 3.0
    attitude = np.tile(from_euler(0.0, 0.0, 0.5), (len(t), 1))
    nothing = np.zeros((len(t), 3))
    samples = Samples(nothing, nothing, np.zeros((len(t), 4)), attitude, nothing, velocity)
    block = SampleBlock(t, samples, t >= 0.0, 0.1, fresh=True)
    place = 47.0, 8.0, 400.0
    items = json.loads(mission([block], place, px4=True))["mission"]["items"]
    assert [item["command"] for item in items] == [22, 19, 178, 16, 178, 16, 21]
    assert [items[i]["params"][1] for i in (2, 4)] == pytest.approx([3.0, 3.0], rel=0.05)
    *_, heading, north, east, height = items[-2]["params"]
    assert (heading, height) == pytest.approx((math.degrees(0.5), 2.0))
    assert 111.2e3 * (north - 47.0) == pytest.approx(30.0, abs=1.0)
    assert 111.3e3 * math.cos(math.radians(47.0)) * (east - 8.0) == pytest.approx(29.0, abs=1.0)
    with pytest.raises(InputError, match="no flight with velocity"):
        mission([replace(block, flying=t < 0.0)], place, px4=True)


@pytest.mark.thorough
def test_the_parameters_sih_flew_with_are_found_in_the_export_of_its_flight(shared_logs):
    airframe = load_airframe("px4-sih").with_anchor("mass", 1.0)
    result = analyze_log(shared_logs / "px4-sih-default.ulg", airframe)
    found = parameters(FORMATS["px4-sih"].write(assemble(result)))
    truth = json.loads((shared_logs / "px4-sih-default.truth.json").read_text())
    exported = {
        "ixx": "Ixx", "iyy": "Iyy", "izz": "Izz", "t_max": "T_max", "kdw": "rotational_damping",
        "kdv": "linear_drag",
    }  # fmt: skip
    for name, parameter in exported.items():
        estimate = result.parameters[parameter]
        assert estimate.std < 0.025 * abs(estimate.value)
        assert found[f"SIH_{name.upper()}"] == pytest.approx(truth[name], abs=2.2 * estimate.std)
    assert found["SIH_Q_MAX"] == pytest.approx(truth["q_max"], rel=0.04)
    assert found["SIH_L_ROLL"] == pytest.approx(truth["l_roll"], rel=1e-4)
    # Delay and lag trade against each other within a sample of 4 ms.
    assert found["SIH_T_TAU"] == pytest.approx(truth["t_tau"], abs=0.004)
