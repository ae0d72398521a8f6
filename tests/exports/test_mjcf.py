"""MuJoCo loads the file, finds the vehicle, and it flies."""

from pathlib import Path

import numpy as np
import pytest

import gcs_sysid
from gcs_sysid.exports import FORMATS
from gcs_sysid.exports.exported_vehicle import assemble
from gcs_sysid.model.airframe import load_airframe
from testbed.ensemble_spread import SECONDS, STEP, spread_of

from .known import FULL_SPEED, LAG, TURN, VALUES, Equations, speed_result, without
from .pilot import GRAVITY, Pilot

mujoco = pytest.importorskip("mujoco")

SAMPLE = Path(__file__).resolve().parents[2] / "logs" / "sample.tlog"
TRUTH = Equations()
CG = TURN @ TRUTH.cg
J = TURN @ TRUTH.J @ TURN


def load(vehicle):
    model = mujoco.MjModel.from_xml_string(FORMATS["mjcf"].write(vehicle))
    return model, mujoco.MjData(model)


def unlagged(result):
    """The model without a lag, so that controls are thrusts at once."""
    return load(assemble(result))


def rotation(data):
    return data.body("base").xmat.reshape(3, 3)


def test_mass_inertia_and_cg_are_found_in_its_frame(vehicle):
    model, _ = load(vehicle)
    body = model.body("base")
    assert body.mass[0] == VALUES["mass"]
    assert body.ipos == pytest.approx(CG, abs=1e-12)
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, body.iquat)
    axes = axes.reshape(3, 3)
    assert axes @ np.diag(body.inertia) @ axes.T == pytest.approx(J, rel=1e-8)


def test_actuators_are_as_identified(vehicle):
    model, _ = load(vehicle)
    full = VALUES["k_T"] * FULL_SPEED**2
    assert model.actuator_ctrlrange == pytest.approx(np.tile([0.0, full], (4, 1)))
    assert model.actuator_dynprm[:, 0] == pytest.approx(LAG)
    for i, place in enumerate(TRUTH.rotors @ TURN, 1):
        assert model.site(f"rotor_{i}").pos == pytest.approx(place)


@pytest.mark.parametrize("rates", [(0.0, 0.0, 0.0), (1.0, -2.0, 3.0)])
@pytest.mark.parametrize("thrusts", [(4.0, 4.0, 4.0, 4.0), (4.5, 3.5, 3.5, 4.5), (5, 5, 3, 3)])
def test_torque_becomes_the_identified_acceleration(result, thrusts, rates):
    model, data = unlagged(result)
    data.qvel[3:] = TURN @ rates
    data.ctrl[:] = thrusts
    mujoco.mj_forward(model, data)
    told = TURN @ data.qacc[3:]
    expected = TRUTH.acceleration(thrusts, np.array(rates), VALUES["rotational_damping"])
    assert told == pytest.approx(expected, rel=1e-8, abs=1e-8)


def test_drag_brakes_the_cg(result):
    model, data = unlagged(result)
    data.qvel[:3] = velocity = np.array([3.0, -1.0, 2.0])
    mujoco.mj_forward(model, data)
    weight = np.array([0.0, 0.0, GRAVITY])
    assert data.qacc[:3] == pytest.approx(
        -VALUES["linear_drag"] / VALUES["mass"] * velocity - weight
    )


def fly(model, data, goal, seconds=8.0):
    """Flies to the goal; the CG's place at the end, and the furthest from the start."""
    torques = -TRUTH.spins * VALUES["moment_ratio"]
    pilot = Pilot(VALUES["mass"], J, TRUTH.rotors @ TURN - CG, torques)
    furthest = 0.0
    while data.time < seconds:
        mujoco.mj_step1(model, data)
        R = rotation(data)
        data.ctrl[:] = pilot.thrusts(goal, data.qpos[:3], data.qvel[:3], R, data.qvel[3:])
        mujoco.mj_step2(model, data)
        furthest = max(furthest, float(np.linalg.norm(data.qpos[:3])))
    return data.qpos[:3].copy(), furthest, rotation(data)[2, 2]


def hovering(model, data):
    """Lets the lagged rotors begin at the thrust of hover."""
    if model.na:
        torques = -TRUTH.spins * VALUES["moment_ratio"]
        pilot = Pilot(VALUES["mass"], J, TRUTH.rotors @ TURN - CG, torques)
        data.act[:] = pilot.thrusts(np.zeros(3), np.zeros(3), np.zeros(3), np.eye(3), np.zeros(3))
    return model, data


@pytest.mark.slow
def test_it_hovers_in_place_because_the_numbers_are_right(vehicle):
    place, furthest, upright = fly(*hovering(*load(vehicle)), np.zeros(3))
    assert furthest < 1e-4
    assert np.linalg.norm(place) < 1e-4
    assert upright == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "factor"), [("cg_x", -1.0), ("cg_y", -1.0), ("mass", 1.1)])
def test_it_would_not_with_wrong_numbers(result, name, factor):
    """What the hover above proves: the pilot does not put errors right by itself."""
    known = {name: factor * VALUES[name], "motor_lag": LAG, "rotor_speed_max": FULL_SPEED}
    model, data = hovering(*load(assemble(result, given=known)))
    _, furthest, _ = fly(model, data, np.zeros(3), 4.0)
    assert furthest > 0.05


def test_what_is_not_known_is_left_out(result):
    vehicle = assemble(without(result, "linear_drag", "rotational_damping"))
    model, _ = load(vehicle)
    assert not model.dof_damping.any()
    assert not model.actuator_ctrllimited.any()
    assert not model.na
    notes = "\n".join(FORMATS["mjcf"].notes(vehicle))
    for name in ("linear_drag", "rotational_damping", "T_max", "motor_lag"):
        assert f"without {name}" in notes


def test_a_hexacopter_loads():
    airframe = load_airframe("px4-hexa-x").with_arm(0.3)
    vehicle = assemble(speed_result(airframe=airframe.as_json()))
    model, _ = load(vehicle)
    assert model.nu == 6
    assert model.actuator_gear[:, 5] == pytest.approx(
        [-r.spin * VALUES["moment_ratio"] for r in airframe.rotors]
    )


@pytest.mark.slow
def test_an_exported_ensemble_spreads_as_the_covariance_says(tmp_path, capsys):
    told = gcs_sysid.analyze(SAMPLE, "paper", mass=1.5, uncertainty={"mass": "2%"})
    spread = spread_of(told, 60, tmp_path)
    assert "note: weak" in capsys.readouterr().err
    assert (spread.expected > 0.0).all()
    # 60 vehicles tell a standard deviation to 9 %; four of them by chance within 0.1 %.
    assert (spread.p > 1e-3).all()
    assert spread.flown == pytest.approx(spread.expected, rel=0.35)
    # Of the climb there is nothing but the mass.
    thrust_to_weight = 1.0 + np.mean(STEP)
    assert spread.expected[3] == pytest.approx(
        0.02 * GRAVITY * thrust_to_weight * SECONDS, rel=0.01
    )
