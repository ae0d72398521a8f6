"""Damping of each axis, coefficients of each rotor, and the covariance of parameters."""

from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.estimation.fit.deviations import DeviationChoice
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.parameters.physical_parameters import (
    axis_dampings,
    mean_damping,
    parameter_covariance,
    rotor_coefficients,
)
from gcs_sysid.estimation.parameters.scale import AbsoluteScale
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import load_airframe
from tests.known_theta import theta_from

GEOMETRY = load_airframe("paper").geometry
THETA = theta_from(80.0, 82.0, 140.0, 5.0, 8.0, -6.0, 0.1, 0.05, 0.03, 20.0, 0.3)
K_T = 2e-4


def a_fit(seed=1):
    """A fit with all deviations and a covariance that nothing makes diagonal."""
    random = np.random.default_rng(seed)
    every = DeviationChoice(GEOMETRY).every(np.append(THETA, [0.0, 0.0, 1.0]))
    m = len(every.std)
    root = 1e-2 * random.standard_normal((N_UNKNOWNS + m, N_UNKNOWNS + m))
    covariance = root @ root.T
    return RotationFit(
        THETA,
        covariance[: rb.N_THETA, : rb.N_THETA],
        np.eye(3),
        np.ones(3),
        1000,
        True,
        full_covariance=covariance[:N_UNKNOWNS, :N_UNKNOWNS],
        deviations=1e-2 * random.standard_normal(m),
        extended_covariance=covariance,
        deviating=every,
    )


def test_values_and_deviations_are_those_of_drawn_unknowns():
    """Against a Monte Carlo over the fit's covariance."""
    fit = a_fit()
    random = np.random.default_rng(2)
    mean = np.concatenate([fit.unknowns, fit.deviations])
    drawn = random.multivariate_normal(mean, fit.extended_covariance, 40_000)
    phi = drawn[:, N_UNKNOWNS:]
    damping = drawn[:, [rb.DAMPING]] + phi @ fit.deviating.dampings
    values, stds = axis_dampings(fit)
    np.testing.assert_allclose(values, damping.mean(axis=0), atol=4e-2 * stds.max())
    np.testing.assert_allclose(stds, damping.std(axis=0), rtol=0.03)
    value, std = mean_damping(fit)
    assert value == pytest.approx(values[:2].mean())
    assert std == pytest.approx(damping[:, :2].mean(axis=1).std(), rel=0.03)
    k_T, k_T_std, ratio, ratio_std = rotor_coefficients(fit, 4)
    assert k_T.mean() == pytest.approx(1.0)
    assert ratio.mean() == pytest.approx(THETA[rb.MOMENT_RATIO])
    np.testing.assert_allclose(k_T_std, (phi @ fit.deviating.thrusts).std(axis=0), rtol=0.03)
    ratios = drawn[:, [rb.MOMENT_RATIO]] + phi @ fit.deviating.ratios
    np.testing.assert_allclose(ratio_std, ratios.std(axis=0), rtol=0.03)


def test_stds_include_what_the_thrust_curve_does_to_thrust():
    """Against a Monte Carlo in which T_max follows the curve: ln T_max = bend c."""
    fit, bend = a_fit(), 0.8
    random = np.random.default_rng(3)
    mean = np.concatenate([fit.unknowns, fit.deviations])
    curve = Unknown.CURVE
    drawn = random.multivariate_normal(mean, fit.extended_covariance, 40_000)
    damping = drawn[:, [rb.DAMPING]] + drawn[:, N_UNKNOWNS:] @ fit.deviating.dampings
    thrust = 1.0 + bend * (drawn[:, [curve]] - mean[curve])
    values, stds = axis_dampings(fit, bend)
    np.testing.assert_allclose(values, axis_dampings(fit)[0])
    np.testing.assert_allclose(stds, (damping * thrust).std(axis=0), rtol=0.03)
    assert (stds > 1.02 * axis_dampings(fit)[1]).any()


def test_without_deviations_all_rotors_and_axes_are_alike():
    fit = a_fit()
    alike = RotationFit(THETA, fit.covariance, np.eye(3), np.ones(3), 1000, True)
    values, stds = axis_dampings(alike)
    assert set(values) == {THETA[rb.DAMPING]}
    assert stds == pytest.approx(np.full(3, alike.std[rb.DAMPING]))
    k_T, k_T_std, ratio, _ = rotor_coefficients(alike, 6)
    assert (k_T == 1.0).all()
    assert not k_T_std.any()
    assert set(ratio) == {THETA[rb.MOMENT_RATIO]}


def test_covariance_keeps_deviations_and_common_causes():
    fit = a_fit()
    scale = AbsoluteScale(1.5, 0.0, K_T, 0.02)
    names = ("mass", "Ixx", "Izz", "cg_x", "k_T", "moment_ratio")
    size = {"mass": (1.5, 0.0), "k_T": (K_T, 0.02 * K_T), "cg_x": (0.1, float(fit.std[rb.CG_X]))}
    for name in ("Ixx", "Izz", "moment_ratio"):
        at = rb.THETA.index(name)
        by_thrust = name != "moment_ratio"
        unit = K_T if by_thrust else 1.0
        own = unit * fit.std[at]
        value = unit * THETA[at]
        size[name] = value, float(np.hypot(own, 0.02 * value)) if by_thrust else float(own)
    found, covariance, _ = parameter_covariance(fit, scale, {n: size[n] for n in names}, {})
    assert list(found) == [n for n in names if n != "mass"]  # exact: nothing hangs together with it
    stds = np.array([size[n][1] for n in found])
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), stds)
    assert np.linalg.eigvalsh(covariance / np.outer(stds, stds)).min() > 0.0
    at = {name: i for i, name in enumerate(found)}
    # Thrust's error moves both moments of inertia.
    shared = 0.02**2 * size["Ixx"][0] * size["Izz"][0] + K_T**2 * fit.covariance[0, 2]
    assert covariance[at["Ixx"], at["Izz"]] == pytest.approx(shared)
    assert covariance[at["k_T"], at["Ixx"]] == pytest.approx(0.02**2 * K_T * size["Ixx"][0])
    assert covariance[at["k_T"], at["cg_x"]] == 0.0
    # What widens a parameter keeps the correlation of its part of the fit.
    wider = {n: size[n] for n in names} | {"Ixx": (size["Ixx"][0], 10.0 * size["Ixx"][1])}
    _, wide, _ = parameter_covariance(fit, scale, wider, {})
    value, std = size["Ixx"]
    widening = np.sqrt((10.0 * std) ** 2 - (0.02 * value) ** 2) / (K_T * fit.std[0])
    by_thrust = 0.02**2 * value * size["Izz"][0]
    expected = by_thrust + widening * K_T**2 * fit.covariance[0, 2]
    assert wide[at["Ixx"], at["Izz"]] == pytest.approx(expected)
    assert np.linalg.eigvalsh(wide / np.outer(stds, stds)).min() > 0.0
    # An error of what is given moves all that rests on it, and nothing else.
    given = {"k_T": np.array([0.01 * K_T, 0.0]), "Ixx": np.array([0.01, 0.005]) * size["Ixx"][0],
             "cg_x": np.array([0.0, 0.005 * size["cg_x"][0]])}  # fmt: skip
    exact = replace(scale, thrust_share=0.0)
    _, together, effects = parameter_covariance(fit, exact, {n: size[n] for n in names}, given)
    assert together[at["cg_x"], at["k_T"]] == 0.0
    assert together[at["k_T"], at["Ixx"]] == pytest.approx(1e-4 * K_T * size["Ixx"][0])
    assert effects[at["k_T"]].tolist() == given["k_T"].tolist()
    assert not effects[at["Izz"]].any()
