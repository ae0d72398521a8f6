"""Drake loads URDF and SDF (with Gazebo's own parser) and finds the vehicle of all links."""

import logging
from xml.etree import ElementTree

import numpy as np
import pytest

from gcs_sysid.exports import FORMATS
from gcs_sysid.exports.exported_vehicle import assemble

from .known import FULL_SPEED, LAG, TURN, VALUES, Equations, command_result, without

parsing = pytest.importorskip("pydrake.multibody.parsing")
from pydrake.multibody.math import SpatialForce  # noqa: E402
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant  # noqa: E402

logging.getLogger("drake").setLevel(logging.ERROR)
"""It warns of Gazebo's plugins, which it does not know."""
TRUTH = Equations()
CG = TURN @ TRUTH.cg
J = TURN @ TRUTH.J @ TURN
WRITERS = {"urdf": FORMATS["urdf"].write, "sdf": FORMATS["gazebo-sdf"].write}


def load(text, kind):
    plant = MultibodyPlant(0.0)
    parsing.Parser(plant).AddModelsFromString(text, kind)
    plant.Finalize()
    return plant, plant.CreateDefaultContext()


@pytest.mark.parametrize("kind", WRITERS)
def test_mass_inertia_and_cg_are_found_in_its_frame(vehicle, kind):
    plant, context = load(WRITERS[kind](vehicle), kind)
    bodies = plant.GetBodyIndices(plant.GetModelInstanceByName(vehicle.name))
    frame = plant.GetFrameByName("base_link")
    whole = plant.CalcSpatialInertia(context, frame, bodies)
    assert whole.get_mass() == pytest.approx(VALUES["mass"])
    assert whole.get_com() == pytest.approx(CG, abs=1e-9)
    about_cg = whole.Shift(whole.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    assert about_cg == pytest.approx(J, rel=1e-7)
    assert whole.IsPhysicallyValid()


@pytest.mark.parametrize(("kind", "first"), [("urdf", 1), ("sdf", 0)])
def test_rotors_are_where_they_were(vehicle, kind, first):
    plant, context = load(WRITERS[kind](vehicle), kind)
    base = plant.GetFrameByName("base_link")
    for i, place in enumerate(TRUTH.rotors @ TURN):
        rotor = plant.GetFrameByName(f"rotor_{i + first}")
        found = rotor.CalcPose(context, base)
        assert found.translation() == pytest.approx(place)
        assert found.rotation().matrix() == pytest.approx(np.eye(3))


@pytest.mark.parametrize("thrusts", [(4.0, 4.0, 4.0, 4.0), (4.5, 3.5, 3.5, 4.5), (5, 5, 3, 3)])
def test_gazebos_motor_model_makes_the_identified_acceleration(vehicle, thrusts):
    """Forces as `MulticopterMotorModel` applies them, by the settings in the file."""
    text = FORMATS["gazebo-sdf"].write(vehicle)
    plant, context = load(text, "sdf")
    forces, base = [], plant.GetBodyByName("base_link")
    for i, motor in enumerate(motors(text)):
        thrust = motor["motorConstant"] * (thrusts[i] / VALUES["k_T"])
        turning = {"ccw": 1.0, "cw": -1.0}[motor["turningDirection"]]
        torque = [0.0, 0.0, -turning * thrust * motor["momentConstant"]]
        rotor = plant.GetBodyByName(motor["linkName"])
        forces.append(applied(rotor, SpatialForce([0.0] * 3, [0.0, 0.0, thrust])))
        forces.append(applied(base, SpatialForce(torque, [0.0] * 3)))
    plant.get_applied_spatial_force_input_port().FixValue(context, forces)
    plant.get_actuation_input_port().FixValue(context, np.zeros(plant.num_actuators()))
    change = plant.EvalTimeDerivatives(context).CopyToVector()[plant.num_positions() :]
    # Rotors that turn freely take their inertia about the axis up out of the body.
    rates = TURN @ change[:3]
    expected = TRUTH.J.copy()
    expected[2, 2] -= 4 * VALUES["rotor_inertia"]
    assert rates == pytest.approx(np.linalg.solve(expected, TRUTH.moment(thrusts)), rel=1e-6)


def applied(body, force):
    out = ExternallyAppliedSpatialForce()
    out.body_index = body.index()
    out.p_BoBq_B = np.zeros(3)
    out.F_Bq_W = force
    return out


def motors(text):
    """Settings of the motor plugins, in the order of their numbers."""
    found = []
    for plugin in ElementTree.fromstring(text).iter("plugin"):
        assert plugin.get("name") == "gz::sim::systems::MulticopterMotorModel"
        assert plugin.get("filename") == "gz-sim-multicopter-motor-model-system"
        words = {"turningDirection", "linkName", "jointName", "robotNamespace"}
        words |= {"commandSubTopic", "motorType"}
        found.append({e.tag: e.text if e.tag in words else float(e.text) for e in plugin})
    assert [motor["motorNumber"] for motor in found] == list(range(len(found)))
    return found


@pytest.mark.parametrize("by", ["speed", "command"])
def test_motors_are_as_identified(vehicle, by):
    if by == "command":
        vehicle = assemble(command_result(), given={"rotor_speed_max": FULL_SPEED})
    for motor, spin in zip(motors(FORMATS["gazebo-sdf"].write(vehicle)), TRUTH.spins, strict=True):
        assert motor["motorConstant"] == pytest.approx(VALUES["k_T"])
        assert motor["momentConstant"] == pytest.approx(VALUES["moment_ratio"])
        assert motor["maxRotVelocity"] == pytest.approx(FULL_SPEED)
        assert motor["timeConstantUp"] == motor["timeConstantDown"] == pytest.approx(LAG)
        assert motor["turningDirection"] == ("ccw" if spin > 0 else "cw")
        assert motor["rotorDragCoefficient"] == motor["rollingMomentCoefficient"] == 0.0


def test_without_a_lag_gazebos_own_is_left_and_said(result):
    vehicle = assemble(result, given={"rotor_speed_max": FULL_SPEED})
    assert "timeConstantUp" not in motors(FORMATS["gazebo-sdf"].write(vehicle))[0]
    assert any("motor_lag is not known" in note for note in FORMATS["gazebo-sdf"].notes(vehicle))


def test_a_rotors_inertia_that_is_not_known_is_next_to_nothing(result):
    vehicle = assemble(without(result, "rotor_inertia"), given={"rotor_speed_max": FULL_SPEED})
    plant, context = load(FORMATS["gazebo-sdf"].write(vehicle), "sdf")
    rotor = plant.GetBodyByName("rotor_0").CalcSpatialInertiaInBodyFrame(context)
    assert rotor.CalcRotationalInertia().get_moments()[2] == pytest.approx(1e-4 * VALUES["Izz"])
    bodies = plant.GetBodyIndices(plant.GetModelInstanceByName(vehicle.name))
    whole = plant.CalcSpatialInertia(context, plant.GetFrameByName("base_link"), bodies)
    about_cg = whole.Shift(whole.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    assert about_cg == pytest.approx(J, rel=1e-7)
