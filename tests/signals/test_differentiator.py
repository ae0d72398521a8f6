"""Tracking differentiators against analysis, and the article's misprint."""

import numpy as np
import pytest
from scipy.signal import lsim

from gcs_sysid.signals.smoothers import LinearDifferentiator, nonlinear_differentiator
from testbed.article import central_difference


@pytest.mark.parametrize(("R", "b"), [(10.0, 2.0), (40.0, 2.0), (10.0, 0.6), (25.0, 4.0)])
@pytest.mark.parametrize("hertz", [0.3, 1.0, 3.0])
def test_linear_one_has_the_analytic_frequency_response(R, b, hertz):
    dt = 0.001
    w = 2 * np.pi * hertz
    t = np.arange(round(20.0 / dt)) * dt
    v = np.column_stack([np.cos(w * t), np.sin(w * t)])
    z1, z2 = LinearDifferentiator(dt, R, b).update(v)
    H = R**2 / ((1j * w) ** 2 + R * b * 1j * w + R**2)
    turning = np.exp(1j * w * t[-5000:])
    # A sine drawn straight between samples is too small by (w dt)^2 / 12.
    bar = 1e-9 + (w * dt) ** 2 / 6
    assert np.abs(z1[-5000:] @ [1, 1j] - H * turning).max() < bar * abs(H)
    assert np.abs(z2[-5000:] @ [1, 1j] - 1j * w * H * turning).max() < bar * abs(w * H)


@pytest.mark.parametrize(("dt", "R", "b"), [(0.05, 10.0, 2.0), (0.004, 10.0, 2.0), (0.02, 60, 0.5)])
def test_linear_one_is_exact_for_straight_pieces(dt, R, b):
    rng = np.random.default_rng(1)
    v = rng.normal(size=(300, 1)) + 5.0
    system = ([[0.0, 1.0], [-R * R, -R * b]], [[0.0], [R * R]], np.eye(2), np.zeros((2, 1)))
    _, expected, _ = lsim(system, v, np.arange(300) * dt, X0=[v[0, 0], 0.0])
    z1, z2 = LinearDifferentiator(dt, R, b).update(v)
    # Both are exact: rounding over 300 steps.
    np.testing.assert_allclose(z1, expected[:, :1], rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(z2, expected[:, 1:], rtol=0.0, atol=1e-10 * R)


@pytest.mark.parametrize("b", [0.8, 2.0**0.5, 2.0, 3.0])
def test_settling_is_long_enough(b):
    filter_ = LinearDifferentiator(0.01, 10.0, b)
    filter_.update(np.zeros((1, 1)))
    z1, _ = filter_.update(np.ones((1000, 1)))
    assert np.abs(z1[filter_.settling :] - 1.0).max() < 1e-4
    # And not much longer: halfway it still moves.
    assert np.abs(z1[filter_.settling // 2 :] - 1.0).max() > 1e-3


@pytest.mark.slow
def test_nonlinear_one_with_exponent_one_is_the_linear_one():
    t = np.arange(200)[:, None] * 0.05
    v = np.sin(np.pi * t) + 0.5 * np.sin(10.7 * t + 1.0)
    exact = LinearDifferentiator(0.05, 10.0, 2.0).update(v)
    errors = []
    for substeps in (25, 50, 100):
        z = nonlinear_differentiator(v, 0.05, R=10.0, a=1.0, b=2.0, substeps=substeps)
        errors.append([np.abs(z[k] - exact[k]).max() for k in (0, 1)])
    # Semi-implicit Euler is of first order: half the step, half the error (measured 0.50).
    np.testing.assert_allclose(np.divide(errors[1:], errors[:-1]), 0.5, atol=0.02)
    assert errors[-1][0] < 4e-3
    assert errors[-1][1] < 2e-2


@pytest.mark.slow
def test_printed_form_does_not_differentiate_at_the_articles_rate():
    t = np.arange(0.0, 20.0, 0.05)[:, None]
    v = np.sin(np.pi * t) + 0.5 * np.sin(10.7 * t + 1.0)
    v_dot = np.pi * np.cos(np.pi * t) + 5.35 * np.cos(10.7 * t + 1.0)

    def error(z2):
        return np.std((z2 - v_dot)[100:]) / np.std(v_dot)

    # No better than to say that the derivative is zero, give or take; finer substeps do not help.
    for substeps in (5, 50):
        _, printed = nonlinear_differentiator(v, 0.05, form="printed", substeps=substeps)
        assert error(printed) > 0.8
    _, usual = nonlinear_differentiator(v, 0.05, R=200.0, substeps=100)
    assert error(usual) < 0.3
    assert error(central_difference(v, 0.05)) < 0.1


def test_where_it_diverges_it_stays_finite():
    v = np.random.default_rng(4).normal(size=(400, 2)) * 1e3
    z1, z2 = nonlinear_differentiator(v, 0.5, form="usual", substeps=1)
    assert np.isfinite(z1).all()
    assert np.isfinite(z2).all()
