"""What wrong rotor positions, scale and IMU pose do to an estimate whose truth is known."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from gcs_sysid.estimation.fit.translation import TranslationFit
from gcs_sysid.estimation.fit.window_fit import fit_rotation
from gcs_sysid.estimation.online.fit import Fit, FitMoments
from gcs_sysid.estimation.parameters.given_errors import (
    Given,
    aligned,
    alignment_of,
    given_stds,
)
from gcs_sysid.estimation.rows.actuator_dynamics import PLAIN, WIDTH
from gcs_sysid.estimation.rows.regression import NormalEquations
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import UNCERTAIN, Airframe, Rotor, ScaleReference
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.rotor_input import RotorInput
from tests.known_theta import theta_from

ROWS = 4000
QUAD = Airframe(
    "quad",
    (Rotor(0.2, 0.22, 1), Rotor(-0.2, -0.22, 1), Rotor(0.21, -0.2, -1), Rotor(-0.2, 0.2, -1)),
    mass=1.5,
)
EXACT = QUAD.with_uncertainty(dict.fromkeys(UNCERTAIN, 0), "here")
# Over k_T, in m^2 and m.
THETA = theta_from(80.0, 81.0, 143.0, 6.6, 12.4, -8.1, 0.01, 0.005, 0.03, 20.0, 0.3)
MOTION = TranslationFit(1.4e-4, 1e-8, 0.1, 0.01, "momentum")


def fit_of(airframe, turned=(0.0, 0.0, 0.0), sigma=0.3, seed=1):
    """The fit to the motion of `QUAD` with `THETA`, had the rotors been where an airframe says.

    Args:
        airframe: that is believed.
        turned: rotation of the IMU, rad.
        sigma: rad/s^2, noise of the angular acceleration.
        seed: of all that is drawn.
    """
    rng = np.random.default_rng(seed)
    slow = lfilter([0.3], [1.0, -0.95], rng.standard_normal((ROWS, 7)), axis=0)
    speeds, rates = 130.0 + 20.0 * slow[:, 3:], slow[:, :3]

    def inputs(geometry, rates):
        signals, H = rb.rotor_signals(geometry, speeds)
        momentum = np.column_stack([rates[:, 1] * H, rates[:, 0] * H, 10.0 * np.gradient(H)])
        return np.column_stack([signals, rb.rate_signals(rates), momentum])

    R = Rotation.from_rotvec(turned).as_matrix().T
    y = inputs(QUAD.geometry, rates) @ rb.forward_matrix(THETA).T
    y = (y + sigma * rng.standard_normal(y.shape)) @ R.T
    moments = NormalEquations((1, WIDTH, WIDTH), 40)
    moments.add(np.column_stack([inputs(airframe.geometry, rates @ R.T), y])[None])
    fit = fit_rotation(moments.batches, moments.counts, PLAIN, np.zeros((1, WIDTH, WIDTH)))
    total = moments.total[0]
    told = FitMoments(np.broadcast_to(total, (3, WIDTH, WIDTH)), total)
    return Fit(fit, MOTION, 30.0, moments=told)


def moved(airframe, x, y):
    """The airframe with its rotors elsewhere, m."""
    rotors = zip(airframe.rotors, np.broadcast_to(x, 4), np.broadcast_to(y, 4), strict=True)
    return replace(airframe, rotors=tuple(Rotor(r.x + a, r.y + b, r.spin) for r, a, b in rotors))


def off(fit):
    """Errors of theta in standard deviations."""
    return (fit.rotation.theta - THETA) / fit.rotation.std


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("degrees", [1.0, -2.0])
def test_the_flight_tells_how_the_imu_is_turned(axis, degrees):
    turned = np.zeros(3)
    turned[axis] = math.radians(degrees)
    fit = fit_of(QUAD, turned, sigma=0.1)
    found = alignment_of(fit, QUAD)
    assert np.abs(off(fit)).max() > 8.0  # as it is, intervals are wrong
    assert np.all(np.abs(found.turned - turned) < 2.0 * found.turned_std)
    # What air may imitate is 0.3 degrees; the others' fits suffer from what is not explained yet.
    assert found.turned_std[axis] < math.radians(0.36)
    assert np.all(found.turned_std < math.radians(0.7))
    assert np.abs(off(aligned(fit, found))).max() < 2.5


def test_an_imu_known_to_be_aligned_is_not_turned():
    fit = fit_of(QUAD, (0.0, 0.02, 0.0))
    straight = QUAD.with_uncertainty({"imu_rotation": 0, "rotor_position": 0}, "here")
    assert alignment_of(fit, straight) is None
    assert aligned(fit, None) is fit
    assert alignment_of(replace(fit, moments=None), QUAD) is None


def test_where_nothing_turns_the_prior_is_all_there_is():
    fit = fit_of(QUAD, sigma=300.0)
    found = alignment_of(fit, QUAD)
    np.testing.assert_allclose(np.degrees(found.turned_std), 1.0, rtol=0.02)
    assert np.all(np.abs(np.degrees(found.turned)) < 0.2)


def test_single_rotors_elsewhere_are_in_the_interval():
    # Rotors 1 % of the arm off, given so; what remains of it are a common shift and scale.
    told = QUAD.with_uncertainty({"rotor_position": "1%", "imu_rotation": 0}, "here")
    worst = []
    for seed in range(12):
        x, y = 0.01 * QUAD.arm * np.random.default_rng([seed, 5]).standard_normal((2, 4))
        fit = fit_of(moved(told, x, y), seed=seed)
        better = aligned(fit, alignment_of(fit, moved(told, x, y)))
        theta, std = better.rotation.theta, better.rotation.std
        values = {
            name: Estimate(float(v), float(s), status="identified")
            for name, v, s in zip(rb.THETA, theta, std, strict=True)
            if name in ("Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz", "cg_x", "cg_y")
        }
        unit = Given(told, ScaleReference("k_T", 1.0), RotorInput.SPEED, {})
        for name, given in given_stds(values, better, unit).items():
            off = abs(values[name].value - THETA[rb.THETA.index(name)])
            worst.append(off / math.hypot(values[name].std, given))
    assert np.mean(np.array(worst) < 1.96) > 0.88
    assert np.max(worst) < 4.0


def test_all_lengths_go_with_the_arm():
    # Numerically: arms 3 % too long make all of theta 3 % too large.
    fit = fit_of(QUAD, sigma=1e-3)
    long = fit_of(QUAD.with_arm(1.03 * QUAD.arm), sigma=1e-3)
    np.testing.assert_allclose(long.rotation.theta / fit.rotation.theta, 1.03, rtol=1e-4)


def test_shares_of_what_was_given():
    told = QUAD.with_uncertainty({"rotor_position": 0, "arm": "3%", "mass": "4%"}, "here")
    fit = fit_of(told)
    names = ("mass", "k_T", "Ixx", "k_M", "moment_ratio", "cg_x", "linear_drag")
    values = {name: Estimate(2.0, 0.01, status="identified") for name in names}
    anchor = ScaleReference("mass", 1.5, given=told.uncertainty.scale_share("mass", 1.5))
    stds = given_stds(values, fit, Given(told, anchor, RotorInput.SPEED, {}))
    expected = {"mass": 4, "k_T": 4, "Ixx": 5, "k_M": 5, "moment_ratio": 3, "cg_x": 3}
    for name, percent in (expected | {"linear_drag": 4}).items():
        assert stds[name] == pytest.approx(0.02 * percent), name
    # Known k_T instead: the mass goes with it.
    by_thrust = ScaleReference("k_T", 2e-4, given=0.02)
    stds = given_stds(values, fit, Given(told, by_thrust, RotorInput.SPEED, {}))
    assert stds["mass"] == pytest.approx(0.04)
    assert stds["Ixx"] == pytest.approx(2.0 * math.hypot(0.02, 0.03))
    # A prior that tells k_T far better than the mass does leaves little of the mass' error.
    known = {"k_T": (MOTION.kappa * 1.5, MOTION.kappa * 1.5 * 0.004)}
    stds = given_stds(values, fit, Given(told, anchor, RotorInput.SPEED, known))
    assert stds["k_T"] == pytest.approx(0.08 * 0.004**2 / (0.004**2 + 0.04**2), rel=1e-3)


def test_exactly_given_adds_nothing():
    fit = fit_of(EXACT)
    values = {
        "Ixx": Estimate(2.0, 0.01, status="identified"),
        "mass": Estimate(1.5, 0.0, status="given"),
    }
    stds = given_stds(values, fit, Given(EXACT, ScaleReference("mass", 1.5), RotorInput.SPEED, {}))
    assert not any(stds.values())


def test_an_imu_off_the_center_matters_to_the_accelerometer_alone():
    fit = fit_of(QUAD)
    values = {"k_T": Estimate(2e-4, 1e-7, status="identified")}
    given = Given(EXACT.with_uncertainty({"imu_position": 0.02}, "here"),
                  ScaleReference("mass", 1.5), RotorInput.SPEED, {})  # fmt: skip
    assert given_stds(values, fit, given)["k_T"] == 0.0
    # Without angular acceleration, which has no mean in flight.
    window = fit.moments.window.copy()
    window[rb.N_SIGNALS :] = window[:, rb.N_SIGNALS :] = 0.0
    felt = replace(
        fit,
        translation=replace(MOTION, source="accelerometer"),
        moments=fit.moments._replace(window=window),
    )
    share = given_stds(values, felt, given)["k_T"] / 2e-4
    # -z (p^2 + q^2) of 2 cm, against the mean specific force
    p, q = (rb.SIGNALS.index(name) for name in "pq")
    thrust = MOTION.kappa * math.sqrt(window[2, 2] / ROWS)
    expected = 0.02 * (window[p, p] + window[q, q]) / ROWS / thrust
    assert share == pytest.approx(expected, rel=0.1)
