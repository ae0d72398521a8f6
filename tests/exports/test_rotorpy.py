"""RotorPy takes the parameters, and the vehicle flies."""

import numpy as np
import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.exports import FORMATS
from gcs_sysid.exports.exported_vehicle import MissingError, assemble
from gcs_sysid.model.airframe import load_airframe

from .known import FULL_SPEED, LAG, TURN, VALUES, Equations, command_result, speed_result
from .pilot import Pilot

multirotor = pytest.importorskip("rotorpy.vehicles.multirotor")

TRUTH = Equations()
CG = TURN @ TRUTH.cg
J = TURN @ TRUTH.J @ TURN
TORQUES = -TRUTH.spins * VALUES["moment_ratio"]


def parameters(vehicle):
    module = {}
    exec(compile(FORMATS["rotorpy"].write(vehicle), "quad_params.py", "exec"), module)
    return module["quad_params"]


def load(vehicle, aero=True):
    return multirotor.Multirotor(parameters(vehicle), aero=aero)


def state(speeds, rates=(0.0, 0.0, 0.0)):
    zero = np.zeros(3)
    return {
        "x": zero, "v": zero, "q": np.array([0.0, 0.0, 0.0, 1.0]), "w": np.array(rates, float),
        "wind": zero, "rotor_speeds": np.asarray(speeds, float),
    }  # fmt: skip


def rotation(q):
    i, j, k, w = q
    return np.array(
        [
            [1 - 2 * (j * j + k * k), 2 * (i * j - k * w), 2 * (i * k + j * w)],
            [2 * (i * j + k * w), 1 - 2 * (i * i + k * k), 2 * (j * k - i * w)],
            [2 * (i * k - j * w), 2 * (j * k + i * w), 1 - 2 * (i * i + j * j)],
        ]
    )


def test_mass_inertia_and_cg_are_found_in_its_frame(vehicle):
    quad = load(vehicle)
    assert quad.mass == VALUES["mass"]
    assert quad.inertia == pytest.approx(J, rel=1e-9)
    assert quad.rotor_geometry == pytest.approx(TRUTH.rotors @ TURN - CG)
    assert quad.k_eta == pytest.approx(VALUES["k_T"])
    assert quad.k_m == pytest.approx(VALUES["k_M"])
    assert quad.tau_m == LAG
    assert quad.rotor_speed_max == FULL_SPEED


@pytest.mark.parametrize("rates", [(0.0, 0.0, 0.0), (1.0, -2.0, 3.0)])
@pytest.mark.parametrize("thrusts", [(4.0, 4.0, 4.0, 4.0), (4.5, 3.5, 3.5, 4.5), (5, 5, 3, 3)])
def test_torque_becomes_the_identified_acceleration(vehicle, thrusts, rates):
    quad = load(vehicle, aero=False)
    speeds = np.sqrt(np.array(thrusts) / VALUES["k_T"])
    now = state(speeds, TURN @ rates)
    told = TURN @ quad.statedot(now, {"cmd_motor_speeds": speeds}, 0.0)["wdot"]
    assert told == pytest.approx(TRUTH.acceleration(thrusts, np.array(rates), 0.0), rel=1e-8)


def test_drag_in_hover_is_as_identified(vehicle):
    quad = load(vehicle)
    hover = np.full(4, np.sqrt(VALUES["mass"] * 9.80665 / (4.0 * VALUES["k_T"])))
    still, _ = quad.compute_body_wrench(np.zeros(3), hover, np.zeros(3))
    for velocity in np.eye(3):
        moving, _ = quad.compute_body_wrench(np.zeros(3), hover, velocity)
        assert moving - still == pytest.approx(-VALUES["linear_drag"] * velocity, rel=1e-6)


def fly(quad, goal, seconds):
    """Flies to the goal from hover; the CG's place at the end, and the furthest from the start."""
    pilot = Pilot(VALUES["mass"], J, TRUTH.rotors @ TURN - CG, TORQUES)
    zero = np.zeros(3)
    now = state(np.sqrt(pilot.thrusts(zero, zero, zero, np.eye(3), zero) / VALUES["k_T"]))
    furthest = 0.0
    for _ in range(round(seconds / 0.01)):
        thrusts = pilot.thrusts(goal, now["x"], now["v"], rotation(now["q"]), now["w"])
        speeds = np.sqrt(thrusts / VALUES["k_T"])
        now = quad.step(now, {"cmd_motor_speeds": speeds}, 0.01)
        furthest = max(furthest, float(np.linalg.norm(now["x"])))
    return now["x"], furthest


@pytest.mark.slow
def test_it_hovers_in_place_because_the_numbers_are_right(vehicle):
    place, furthest = fly(load(vehicle), np.zeros(3), 4.0)
    assert furthest < 1e-4
    assert np.linalg.norm(place) < 1e-4


def test_commands_make_the_same_vehicle(vehicle):
    by_speed = parameters(vehicle)
    by_command = parameters(assemble(command_result(), given={"rotor_speed_max": FULL_SPEED}))
    assert by_command.keys() == by_speed.keys()
    for name in ("mass", "k_eta", "k_m", "tau_m", "Ixy", "k_d"):
        assert by_command[name] == pytest.approx(by_speed[name])


def test_what_no_flight_with_speeds_tells_is_asked_for(result):
    with pytest.raises(MissingError) as refused:
        FORMATS["rotorpy"].write(assemble(result))
    told = str(refused.value)
    assert "rotorpy needs motor_lag, rotor_speed_max" in told
    assert "--set motor_lag=VALUE" in told
    assert "--set rotor_speed_max=RAD_S" in told


def test_other_than_four_rotors_are_refused():
    airframe = load_airframe("px4-hexa-x").with_arm(0.3).as_json()
    with pytest.raises(InputError, match="6"):
        FORMATS["rotorpy"].write(assemble(speed_result(airframe=airframe)))
