"""What wrong rotor positions, scale and IMU place do to an estimate whose truth is known."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.fit.translation import TranslationFit
from gcs_sysid.estimation.online.fit import Fit, FitMoments
from gcs_sysid.estimation.parameters.given_errors import Given, given_stds
from gcs_sysid.estimation.rows.actuator_dynamics import PLAIN, WIDTH
from gcs_sysid.estimation.rows.regression import NormalEquations
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import UNCERTAIN, Airframe, Rotor, ScaleReference
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import PARAMETERS
from gcs_sysid.model.rotor_input import RotorInput
from tests.estimation.rows_fit import fit_rows
from tests.known_theta import prior_of, theta_from

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


def fit_of(airframe, sigma=0.3, prior=None):
    """The fit to the motion of `QUAD` with `THETA`, had the rotors been where an airframe says.

    Args:
        airframe: that is believed.
        sigma: rad/s^2, noise of the angular acceleration.
        prior: on the unknowns.
    """
    rng = np.random.default_rng(1)
    slow = lfilter([0.3], [1.0, -0.95], rng.standard_normal((ROWS, 7)), axis=0)
    speeds, rates = 130.0 + 20.0 * slow[:, 3:], slow[:, :3]

    def inputs(geometry, rates):
        signals, H = rb.rotor_signals(geometry, speeds)
        momentum = np.column_stack([rates[:, 1] * H, rates[:, 0] * H, 10.0 * np.gradient(H)])
        return np.column_stack([signals, rb.rate_signals(rates), momentum])

    y = inputs(QUAD.geometry, rates) @ rb.forward_matrix(THETA).T
    y += sigma * rng.standard_normal(y.shape)
    moments = NormalEquations((1, WIDTH, WIDTH), 40)
    moments.add(np.column_stack([inputs(airframe.geometry, rates), y])[None])
    fit = fit_rows(moments.batches, moments.counts, PLAIN, np.zeros((1, WIDTH, WIDTH)), prior)
    total = moments.total[0]
    told = FitMoments(np.broadcast_to(total, (3, WIDTH, WIDTH)), total)
    return Fit(fit, MOTION, 30.0, moments=told)


def test_all_lengths_go_with_the_arm():
    # Numerically: arms 3 % too long make all of theta 3 % too large.
    fit = fit_of(QUAD, sigma=1e-3)
    long = fit_of(QUAD.with_arm(1.03 * QUAD.arm), sigma=1e-3)
    np.testing.assert_allclose(long.rotation.theta / fit.rotation.theta, 1.03, rtol=1e-4)


def test_shares_of_what_was_given():
    told = QUAD.with_uncertainty({"rotor_position": 0, "arm": "3%", "mass": "4%"}, "here")
    fit, k_T = fit_of(told), 1.5 * MOTION.kappa
    anchor = ScaleReference("mass", 1.5, given=told.uncertainty.scale_share("mass", 1.5))

    def shares(anchor, thrust, **priors):
        values = dict.fromkeys(("mass", "k_T", "linear_drag"), 2.0)
        for name in ("Ixx", "k_M", "moment_ratio", "cg_x"):
            value = fit.rotation.theta[rb.THETA.index(PARAMETERS[name].theta)]
            values[name] = value * (thrust if PARAMETERS[name].scale == "thrust" else 1.0)
        entries = {name: Estimate(value, 0.01) for name, value in values.items()}
        stds = given_stds(entries, fit, Given(told, anchor, RotorInput.SPEED, priors))
        return {name: std / abs(values[name]) for name, std in stds.items()}

    expected = dict.fromkeys(("mass", "k_T", "linear_drag"), 0.04)
    expected |= {"Ixx": 0.05, "k_M": 0.05, "moment_ratio": 0.03, "cg_x": 0.03}
    assert shares(anchor, k_T) == pytest.approx(expected)
    # Known k_T instead: the mass goes with it.
    found = shares(ScaleReference("k_T", 2e-4, given=0.02), 2e-4)
    assert found["mass"] == pytest.approx(0.02)
    assert found["Ixx"] == pytest.approx(math.hypot(0.02, 0.03))
    # A prior that tells k_T far better than the mass does leaves little of the mass' error.
    found = shares(anchor, k_T, k_T=(k_T, 0.004 * k_T))
    assert found["k_T"] == pytest.approx(0.04 * 0.004**2 / (0.004**2 + 0.04**2), rel=1e-3)


def ratio_known(shift=0.0):
    """A prior on the moment ratio, from which Izz follows."""
    ratio = float(THETA[rb.MOMENT_RATIO])
    return prior_of({rb.MOMENT_RATIO: (ratio * (1.0 + shift), 1e-5 * ratio)})


@pytest.mark.parametrize(
    ("prior", "arm", "scale", "izz", "ratio"),
    [
        # By half, Izz is what the prior makes of it.
        ("moment_ratio", "3%", 0.0, 0.45 * 0.03, 0.0),
        ("moment_ratio", 0, 0.04, 0.04, 0.0),
        ("k_M", 0, 0.04, 0.45 * 0.04, 0.04),
    ],
)
def test_what_follows_from_a_prior_moves_as_that_does(prior, arm, scale, izz, ratio):
    """Izz was as sure as the prior on the moment ratio, whatever the scale: 4 % off at 3 sigma."""
    told = QUAD.with_uncertainty({"rotor_position": 0, "arm": arm}, "here")
    fit, moved = (fit_of(told, prior=ratio_known(shift)) for shift in (0.0, 1e-4))
    follows = (moved.rotation.theta - fit.rotation.theta)[2] / (1e-4 * THETA[2])
    assert follows == pytest.approx(0.55, abs=0.01)
    k_T = 2e-4
    values = {"Izz": Estimate(k_T * float(fit.rotation.theta[2]), 0.0)}
    values["moment_ratio"] = Estimate(float(fit.rotation.theta[rb.MOMENT_RATIO]), 0.0)
    given = Given(told, ScaleReference("k_T", k_T, given=scale), RotorInput.SPEED, {prior: (1, 1)})
    shares = {n: std / values[n].value for n, std in given_stds(values, fit, given).items()}
    assert shares == pytest.approx({"Izz": izz, "moment_ratio": ratio}, rel=0.02, abs=1e-6)


def test_exactly_given_adds_nothing():
    fit = fit_of(EXACT)
    values = {
        "Ixx": Estimate(2.0, 0.01, status="identified"),
        "mass": Estimate(1.5, 0.0, status="given"),
    }
    stds = given_stds(values, fit, Given(EXACT, ScaleReference("mass", 1.5), RotorInput.SPEED, {}))
    assert not any(stds.values())


@pytest.mark.parametrize(("rotors", "seen"), [(4, True), (6, False), (8, False)])
def test_unlike_rotors_of_six_and_more_may_shift_the_cg_and_do_nothing_else(rotors, seen):
    angles = (np.arange(rotors) + 0.5) * 2.0 * np.pi / rotors
    ring = tuple(Rotor(math.cos(a), math.sin(a), (-1) ** i) for i, a in enumerate(angles))
    frame = replace(EXACT, rotors=ring).with_uncertainty({"rotor_thrust": "3%"}, "here")
    values = {name: Estimate(0.01, 1e-4) for name in ("cg_x", "cg_y")}
    given = Given(frame, ScaleReference("mass", 1.5), RotorInput.SPEED, {})
    stds = given_stds(values, Fit(None, MOTION, 30.0), given)
    # By thrusts (1 + e_i) of the mean the center of thrust moves by sum e_i r_i / n.
    expected = 0.0 if seen else 0.03 / math.sqrt(2.0 * rotors)
    assert list(stds.values()) == pytest.approx([expected] * 2, abs=1e-12)
