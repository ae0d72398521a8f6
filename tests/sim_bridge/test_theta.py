"""Emulator, flight model and the equations of the fits agree on every entry of theta."""

from dataclasses import fields, replace

import numpy as np
import pytest

from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.flight_model import MotionState
from gcs_sysid.model.parameters import ARM, PARAMETERS, REGISTRY
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_data import Scale
from sim_bridge.dynamics import Dynamics
from sim_bridge.simulated_vehicle import Vehicle
from sim_bridge.vehicle_files import load_vehicle

OWN = [name for name in rb.THETA if name in {f.name for f in fields(Vehicle)}]
"""Entries that are fields of the emulator; k_M/k_T is read off k_M and k_T."""
RATES = np.array([2.0, -3.0, 1.5])
AGREED = 1e-9


def with_all(name):
    """A built-in vehicle with something of every entry: for zero, half the reference value."""
    v = load_vehicle(name)
    others = v.truth() | {ARM: 0.25}
    return replace(
        v, **{n: getattr(v, n) or 0.5 * REGISTRY[n].reference.size(0.0, others) for n in OWN}
    )


def speeds_of(v):
    return np.linspace(0.9, 1.1, len(v.rotors)) * v.speed_of(0.45)


def accelerations(v, changes):
    """(3,) angular acceleration by theta, and (N_THETA, 3) what each entry has of it.

    Args:
        v: the vehicle.
        changes: (rotors,) rad/s^2 of the rotors' speeds.
    """
    geometry = np.array([[r.x for r in v.rotors], [r.y for r in v.rotors],
                         [r.spin for r in v.rotors]])  # fmt: skip
    signals, H = rb.rotor_signals(geometry, speeds_of(v))
    coupled = [RATES[1] * H, RATES[0] * H, geometry[2] @ changes]
    x = np.concatenate([signals, rb.rate_signals(RATES), coupled])
    theta = rb.theta_of(v.truth(), v.k_T)
    Q, G = rb.forward_jacobian(theta)
    return Q @ x, theta[:, None] * (G @ x)


@pytest.mark.parametrize("name", ["px4-quad-x", "px4-hexa-x"])
def test_the_emulator_turns_as_theta_says(name):
    v = with_all(name)
    speeds = speeds_of(v)
    targets = speeds * np.linspace(1.05, 0.93, len(speeds))
    dynamics = Dynamics(v)
    body = [0.0] * 6 + [1.0, 0.0, 0.0, 0.0, *RATES.tolist()]
    turned = dynamics.derivative(body, dynamics.wrench(speeds.tolist(), targets.tolist()))[10:]
    expected, parts = accelerations(v, (targets - speeds) / v.motor_lag)
    scale = np.abs(parts).max()
    assert np.abs(parts).max(axis=1).min() > 1e3 * AGREED * scale  # each would be missed
    np.testing.assert_allclose(turned, expected, rtol=0.0, atol=AGREED * scale)


def test_the_flight_model_of_a_result_turns_as_theta_says():
    v = with_all("px4-quad-x")
    truth = v.truth()
    own = {
        name: Estimate(truth[name], 0.0, p.unit, "given")
        for name, p in PARAMETERS.items()
        if p.in_result("speed")
    }
    rotors = [{"x": r.x, "y": r.y, "spin": "ccw" if r.spin > 0 else "cw"} for r in v.rotors]
    model = Result(
        "identified", (), "flight.tlog", {}, Scale("mass", v.mass, "kg"), RotorInput.SPEED, own,
        airframe={"name": "x", "rotors": rotors},
    ).model()  # fmt: skip
    h = 1e-6
    speeds = np.tile(speeds_of(v), (2, 1))
    flown = model.simulate([0.0, h], speeds, MotionState(RATES)).rates
    expected, parts = accelerations(v, np.zeros(len(v.rotors)))
    # In a step, rates change by h w' and accelerations by h w''.
    rounding = 1e-7 * np.abs(parts).max() + 1e3 * h
    assert np.abs(parts).max(axis=1).min() > 10.0 * rounding
    np.testing.assert_allclose((flown[1] - flown[0]) / h, expected, rtol=0.0, atol=rounding)
