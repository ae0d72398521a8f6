"""The true vehicles: Table 1, airframe files, clean refusals."""

from pathlib import Path

import numpy as np
import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import builtin_names
from gcs_sysid.model.parameters import PARAMETERS
from sim_bridge.simulated_vehicle import Vehicle, allocation, stack_vehicles
from sim_bridge.vehicle_files import load_vehicle, vehicle_names
from tests.known_theta import TABLE_1

AIRFRAME = 'name = "mine"\nmass = 1.2\n' + "".join(
    f'[[rotor]]\nx = {x}\ny = {y}\nspin = "{spin}"\n'
    for x, y, spin in ((0.2, 0.2, "ccw"), (-0.2, -0.2, "ccw"), (0.2, -0.2, "cw"), (-0.2, 0.2, "cw"))
)
SIMULATION = """
[simulation]
Ixx = 0.012
Iyy = 0.013
Izz = 0.022
k_T = 1e-5
k_M = 1.6e-7
T_max = 7.0
motor_lag = 0.04
imu_x = 0.02
"""


def write(tmp_path: Path, text: str) -> str:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return str(path)


def test_every_builtin_airframe_has_a_true_vehicle() -> None:
    assert vehicle_names() == builtin_names()
    for name in vehicle_names():
        assert load_vehicle(name).mass > 0


def test_the_paper_vehicle_is_table_1(paper_vehicle: Vehicle) -> None:
    truth = paper_vehicle.truth()
    assert {name: truth[name] for name in TABLE_1} == TABLE_1
    assert {n for n, p in PARAMETERS.items() if not p.optional} <= set(truth)
    assert truth["moment_ratio"] == pytest.approx(6.14e-6 / 2.05e-4)


def test_the_truth_tells_where_an_imu_off_the_cg_is(paper_vehicle: Vehicle) -> None:
    truth = load_vehicle("px4-octo-x").truth()
    assert (truth["imu_x"], truth["imu_y"], truth["imu_z"]) == (-0.02, 0.004, -0.03)
    assert "imu_x" not in paper_vehicle.truth()


def test_octorotors_are_numbered_as_both_autopilots_do() -> None:
    def degrees(name: str) -> list[float]:
        """Clockwise from the front, seen from above."""
        rotors = load_vehicle(name).rotors
        return [round(float(np.degrees(np.arctan2(r.y, r.x))), 1) for r in rotors]

    # AP_MotorsMatrix, octa X.
    expected = [22.5, -157.5, 67.5, 157.5, -22.5, -112.5, -67.5, 112.5]
    assert degrees("ardupilot-octo-x") == expected
    assert degrees("px4-octo-x") == expected
    assert degrees("ardupilot-hexa-x") == [90.0, -90.0, -30.0, 150.0, 30.0, -150.0]


def test_a_vehicle_from_an_airframe_file(tmp_path: Path) -> None:
    vehicle = load_vehicle(write(tmp_path, AIRFRAME + SIMULATION))
    assert vehicle.name == "mine"
    assert vehicle.mass == 1.2  # the airframe's own
    assert (vehicle.motor_lag, vehicle.imu_x, vehicle.Ixy) == (0.04, 0.02, 0.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (AIRFRAME, "[simulation] table"),
        (AIRFRAME + SIMULATION + "Ixxx = 1.0\n", "unknown key 'Ixxx'"),
        (AIRFRAME + SIMULATION.replace("Izz = 0.022\n", ""), "Izz is missing"),
        (AIRFRAME + SIMULATION.replace("0.022", "0.1"), "no body has this inertia"),
        (AIRFRAME + SIMULATION.replace("7.0", "-7.0"), "T_max must be positive"),
        (AIRFRAME + SIMULATION.replace("7.0", "3.0"), "too little"),
        (AIRFRAME + SIMULATION.replace("7.0", "'much'"), "T_max must be a number"),
        (AIRFRAME + SIMULATION + "cg_x = 0.3\n", "CG is so far out"),
        (AIRFRAME + SIMULATION + "motor_lag_ = 0.1\n", "motor_lag_"),
        (AIRFRAME + SIMULATION + "thrust_curve = 1.5\n", "thrust_curve must lie in 0..1"),
        (AIRFRAME + SIMULATION + "lag_of = 'all'\n", "one of speed, thrust, command, got 'all'"),
        (AIRFRAME.replace("[[rotor]]", "simulation = 3\n[[rotor]]", 1), "must be a table"),
    ],
)
def test_a_bad_file_gets_one_clear_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        load_vehicle(write(tmp_path, text))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("curve", [0.0, 0.3, 1.0])
def test_command_inverts_the_thrust_curve(paper_vehicle: Vehicle, curve: float) -> None:
    from dataclasses import replace

    v = replace(paper_vehicle, thrust_curve=curve)
    for u in (0.01, 0.3, 1.0):
        thrust = v.T_max * ((1 - curve) * u + curve * u * u)
        assert v.command_of((thrust / v.k_T) ** 0.5) == pytest.approx(u)
        assert v.command_of(v.speed_of(u)) == pytest.approx(u)
    assert v.command_of(0.0) == 0.0


@pytest.mark.parametrize("name", vehicle_names())
def test_allocation_makes_the_wrench_asked_for(name: str) -> None:
    v = load_vehicle(name)
    asked = np.array([20.0, 0.1, -0.2, 0.05])
    thrusts = np.array(allocation(v)) @ asked
    effect = np.array(
        [[1.0, -(r.y - v.cg_y), r.x - v.cg_x, r.spin * v.k_M / v.k_T] for r in v.rotors]
    ).T
    np.testing.assert_allclose(effect @ thrusts, asked, atol=1e-12)


def test_an_ensemble_needs_equal_layouts(paper_vehicle: Vehicle) -> None:
    with pytest.raises(ValueError, match="same rotors"):
        stack_vehicles([paper_vehicle, load_vehicle("px4-hexa-x")])
