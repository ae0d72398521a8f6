"""The flight model against first principles, integrated by others."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from gcs_sysid import FlightModel, InputError, MotionState
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.model.rotor_input import RotorInput

PLACES = np.array([[0.25, -0.25, 0.25, -0.25], [0.25, -0.25, -0.25, 0.25], [1.0, 1.0, -1.0, -1.0]])


def model(**changed):
    values = {
        "geometry": PLACES,
        "rotor_input": RotorInput.SPEED,
        "mass": np.array(1.5),
        "inertia": np.array([0.0165, 0.0167, 0.0294, 0.00135, 0.00254, -0.00166]),
        "cg": np.array([0.01, -0.02]),
        "thrust": np.array([2.0, 2.1, 2.05, 1.95]) * 1e-4,
        "torque": np.array([6.0, 6.2, 6.1, 6.3]) * 1e-6,
        "damping": np.array([0.01, 0.02, 0.005]),
        "rotor_inertia": np.array(6e-5),
        "drag": np.array(0.4),
    }
    return FlightModel(**values | changed)


def speeds_at(t):
    """Smooth speeds of four rotors, rad/s, and their derivatives."""
    phase = np.array([0.0, 1.0, 2.0, 3.0])
    t = np.asarray(t)[..., None]
    return 134.0 + 8.0 * np.sin(6.0 * t + phase), 48.0 * np.cos(6.0 * t + phase)


def first_principles(m):
    """Newton and Euler in vectors, with the rotors' momentum, as of docs/method/model.md."""
    J = np.array([[m.inertia[i] for i in row] for row in ((0, 3, 5), (3, 1, 4), (5, 4, 2))])
    z = np.array([0.0, 0.0, 1.0])
    arms = np.stack([PLACES[0] - m.cg[0], PLACES[1] - m.cg[1], np.zeros(4)], axis=1)

    def derivative(t, state):
        w, q, v = state[:3], state[3:7], state[7:10]
        speed, change = speeds_at(t)
        thrusts = m.thrust * speed**2
        moment = sum(np.cross(arm, -T * z) for arm, T in zip(arms, thrusts, strict=True))
        moment = moment + (PLACES[2] * m.torque * speed**2).sum() * z
        h = -m.rotor_inertia * (PLACES[2] * speed).sum() * z
        h_rate = -m.rotor_inertia * (PLACES[2] * change).sum() * z
        w_rate = np.linalg.solve(J, moment - np.cross(w, J @ w + h) - h_rate - m.damping * w)
        turn = Rotation.from_quat(q[[1, 2, 3, 0]] / np.linalg.norm(q))
        v_rate = GRAVITY * z + (turn.apply(-thrusts.sum() * z) - m.drag * v) / m.mass
        p, qq, r = w
        a, b, c, d = q
        q_rate = 0.5 * np.array(
            [-b * p - c * qq - d * r, a * p + c * r - d * qq,
             a * qq - b * r + d * p, a * r + b * qq - c * p]
        )  # fmt: skip
        return np.concatenate([w_rate, q_rate, v_rate, v])

    return derivative


def test_it_flies_as_newton_and_euler_say():
    m = model()
    t = np.arange(0.0, 1.0001, 0.002)
    w, q, v = [0.3, -0.2, 0.5], [1.0, 0.0, 0.0, 0.0], [2.0, -1.0, 0.5]
    exact = solve_ivp(
        first_principles(m), (0.0, 1.0), [*w, *q, *v, 0.0, 0.0, 0.0], t_eval=t, rtol=1e-10,
        atol=1e-12,
    ).y.T  # fmt: skip
    flown = m.simulate(t, speeds_at(t)[0], MotionState(w, q, v))
    for values, true in (
        (flown.rates, exact[:, :3]),
        (flown.attitude, exact[:, 3:7]),
        (flown.velocity, exact[:, 7:10]),
        (flown.position, exact[:, 10:]),
    ):
        # Of what each moves by in that second.
        assert np.abs(values - true).max() < 3e-5 * np.ptp(true, axis=0).max()


def test_slow_samples_are_divided():
    m = model()
    fine, coarse = np.arange(0.0, 1.001, 0.005), np.arange(0.0, 1.001, 0.05)
    inputs = speeds_at(coarse)[0]
    between = np.stack([np.interp(fine, coarse, column) for column in inputs.T], axis=1)
    a = m.simulate(coarse, inputs)
    b = m.simulate(fine, between)
    assert np.abs(a.rates[-1] - b.rates[-1]).max() < 2e-3 * np.ptp(b.rates, axis=0).max()


def test_an_ensemble_flies_each_sample_on_each_stretch():
    masses = np.array([1.4, 1.5, 1.6])
    inertia = model().inertia * np.array([0.9, 1.0, 1.1])[:, None]
    shares = {
        "cg": np.tile(model().cg, (3, 1)),
        "thrust": np.tile(model().thrust, (3, 1)),
        "torque": np.tile(model().torque, (3, 1)),
        "damping": np.tile(model().damping, (3, 1)),
    }
    several = model(mass=masses, inertia=inertia, **shares).over_stretches()
    t = np.arange(0.0, 0.2, 0.004)
    inputs = np.stack([speeds_at(t)[0], speeds_at(t + 0.7)[0]])
    flown = several.simulate(t, inputs, MotionState(rates=[[0.1, 0.0, 0.0], [0.0, 0.2, 0.0]]))
    assert flown.rates.shape == (3, 2, len(t), 3)
    alone = model(mass=masses[2], inertia=inertia[2])
    one = alone.simulate(t, inputs[1], MotionState(rates=[0.0, 0.2, 0.0]))
    for name in ("rates", "attitude", "velocity", "position"):
        np.testing.assert_allclose(getattr(flown, name)[2, 1], getattr(one, name), atol=1e-12)


@pytest.mark.parametrize("curve", [0.0, 0.4, 1.0])
def test_it_hovers_by_speeds_and_by_commands(curve):
    level = {"cg": np.zeros(2), "thrust": np.full(4, 2e-4), "torque": np.full(4, 6e-6)}
    command = {
        "rotor_input": RotorInput.COMMAND, "cg": np.zeros(2), "thrust": np.full(4, 9.0),
        "torque": np.full(4, 0.3), "thrust_curve": np.array(curve), "motor_lag": np.array(0.04),
    }  # fmt: skip
    for m in (model(**level), model(**command)):
        t = np.arange(0.0, 2.0, 0.01)
        flown = m.simulate(t, np.tile(m.hover, (len(t), 4)))
        assert np.abs(flown.velocity).max() < 1e-9
        assert np.abs(flown.rates).max() < 1e-9


def test_commands_lag_as_a_first_order_motor_does():
    tau = 0.04
    m = model(rotor_input=RotorInput.COMMAND, motor_lag=np.array(tau))
    t = np.arange(0.0, 0.3, 0.004)
    ramp = np.tile((0.3 + 0.5 * t)[:, None], (1, 4))
    lagged = m.lagged(t, ramp)
    # A ramp from rest: u - slope tau (1 - exp(-t / tau)), whatever the step.
    np.testing.assert_allclose(
        lagged[:, 0], ramp[:, 0] - 0.5 * tau * (1.0 - np.exp(-t / tau)), atol=1e-12
    )
    np.testing.assert_allclose(m.lagged(t[:2], ramp[:2], np.full(4, 0.5))[0], 0.5)


def test_disturbances_are_accelerations_of_each_step():
    m = model(damping=np.zeros(3), drag=np.array(0.0), cg=np.zeros(2), rotor_inertia=np.array(0.0),
              thrust=np.full(4, 2e-4), torque=np.full(4, 6e-6),
              inertia=np.array([0.02, 0.02, 0.03, 0.0, 0.0, 0.0]))  # fmt: skip
    t = np.arange(0.0, 0.5001, 0.01)
    hover = np.tile(m.hover, (len(t), 4))
    yaw = np.zeros((len(t) - 1, 3))
    yaw[:, 2] = 0.8
    east = np.zeros((len(t) - 1, 3))
    east[:, 1] = 0.3
    flown = m.simulate(t, hover, angular_disturbance=yaw, linear_disturbance=east)
    assert flown.rates[-1] == pytest.approx([0.0, 0.0, 0.4])
    assert flown.velocity[-1] == pytest.approx([0.0, 0.15, 0.0])


@pytest.mark.parametrize(
    ("t", "rotors", "more", "says"),
    [
        ([0.0, 0.0], np.ones((2, 4)), {}, "increasing"),
        ([0.0], np.ones((1, 4)), {}, "two or more"),
        ([0.0, 0.1], np.ones((2, 3)), {}, r"\(\.\.\., 2, 4\), not \(2, 3\)"),
        ([0.0, 0.1], np.full((2, 4), np.nan), {}, "rotors: must be finite"),
        ([0.0, 0.1], "fast", {}, "rotors: not an array of numbers"),
        ([0.0, 0.1], np.ones((2, 4)), {"initial": MotionState(rates=[np.inf, 0, 0])}, "rates"),
        ([0.0, 0.1], np.ones((2, 4)), {"initial": MotionState(rates=np.ones((2, 4, 3)),
          velocity=np.ones((3, 1, 3)), attitude=np.ones((7, 4, 4)))}, "differ"),
        ([0.0, 0.1], np.ones((2, 4)), {"linear_disturbance": np.ones((2, 3))}, r"\(\.\.\., 1, 3\)"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_named(t, rotors, more, says):
    with pytest.raises(InputError, match=says):
        model().simulate(t, rotors, **more)


def test_impossible_bodies_are_refused():
    with pytest.raises(InputError, match="rigid body"):
        model(inertia=np.array([0.01, 0.01, 0.05, 0.0, 0.0, 0.0]))
    with pytest.raises(InputError, match="mass"):
        model(mass=np.array(0.0))
