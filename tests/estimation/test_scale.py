"""What sets the scale: each anchor, its errors, and priors beside it."""

import math

import numpy as np
import pytest

from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Unknown
from gcs_sysid.estimation.fit.translation import TranslationFit
from gcs_sysid.estimation.parameters.scale import AbsoluteScale, relative_prior, resolve_scale
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import ScaleReference

KAPPA, SHARE = 2e-4, 0.03
FLIGHT = TranslationFit(KAPPA, SHARE * KAPPA, 0.1, 0.01, "momentum")
MASS, THRUST = 1.5, 3e-4
"""kg, and k_T = kappa m."""


def together(*shares):
    return pytest.approx(math.hypot(*shares))


def test_a_mass_gives_thrust_and_its_errors_add_up():
    scale = resolve_scale(ScaleReference("mass", MASS, 0.04 * MASS), FLIGHT, {})
    assert scale == AbsoluteScale(
        MASS, pytest.approx(0.04), pytest.approx(THRUST), together(0.04, SHARE)
    )


@pytest.mark.parametrize("kind", ["k_T", "T_max"])
def test_a_thrust_gives_the_mass_and_its_errors_add_up(kind):
    scale = resolve_scale(ScaleReference(kind, THRUST, 0.04 * THRUST), FLIGHT, {})
    assert scale == AbsoluteScale(
        pytest.approx(MASS), together(0.04, SHARE), THRUST, pytest.approx(0.04)
    )


@pytest.mark.parametrize(
    "flight",
    [
        None,
        TranslationFit(-KAPPA, SHARE * KAPPA, 0.1, 0.01, "momentum"),
        TranslationFit(0.0, SHARE * KAPPA, 0.1, 0.01, "momentum"),
        TranslationFit(KAPPA, KAPPA, 0.1, 0.01, "momentum"),
        TranslationFit(KAPPA, math.nan, 0.1, 0.01, "momentum"),
    ],
)
def test_a_flight_that_does_not_tell_leaves_what_was_given(flight):
    assert resolve_scale(ScaleReference("mass", MASS), flight, {}) == AbsoluteScale(
        MASS, 0.0, None, math.inf
    )
    assert resolve_scale(ScaleReference("k_T", THRUST), flight, {}) == AbsoluteScale(
        None, math.inf, THRUST, 0.0
    )
    # A prior on what the flight leaves open takes its place.
    known = {"k_T": (2.0, 0.5), "mass": (4.0, 0.2)}
    assert resolve_scale(ScaleReference("mass", MASS), flight, known) == AbsoluteScale(
        MASS, 0.0, 2.0, 0.25
    )
    assert resolve_scale(ScaleReference("k_T", THRUST), flight, known) == AbsoluteScale(
        4.0, pytest.approx(0.05), THRUST, 0.0
    )
    added = ScaleReference("added_mass", 0.3, loaded=(0.5 * KAPPA, 0.01 * KAPPA))
    assert resolve_scale(added, flight, {}).mass is None


@pytest.mark.parametrize(("kind", "known"), [("mass", "k_T"), ("k_T", "mass")])
def test_measured_and_known_are_weighed_by_their_variances(kind, known):
    value = MASS if kind == "mass" else THRUST
    measured = value * KAPPA if kind == "mass" else value / KAPPA
    # Known a third as well, and a tenth off: a tenth of the weight, so a hundredth off.
    prior = {known: (1.1 * measured, 3.0 * SHARE * measured)}
    scale = resolve_scale(ScaleReference(kind, value), FLIGHT, prior)
    found, share = (
        (scale.thrust, scale.thrust_share) if kind == "mass" else (scale.mass, scale.mass_share)
    )
    assert found == pytest.approx(1.01 * measured)
    assert share == pytest.approx(SHARE * math.sqrt(0.9) / 1.01)


def test_an_added_mass_by_monte_carlo():
    """Errors of both flights and of the mass added, to first order."""
    loaded = KAPPA * MASS / (MASS + 0.5)
    stds = 0.002 * KAPPA, 0.003 * loaded, 0.004 * 0.5
    flight = TranslationFit(KAPPA, stds[0], 0.1, 0.01, "momentum")
    anchor = ScaleReference("added_mass", 0.5, stds[2], loaded=(loaded, stds[1]))
    scale = resolve_scale(anchor, flight, {})
    assert scale.mass == pytest.approx(MASS)
    assert scale.thrust == pytest.approx(THRUST)
    rng = np.random.default_rng(1)
    one, two, added = (
        mean + std * rng.standard_normal(20_000)
        for mean, std in zip((KAPPA, loaded, 0.5), stds, strict=True)
    )
    mass = added * two / (one - two)
    # 20 000 runs tell a deviation to half a percent; the second order is a thousandth.
    assert scale.mass_share == pytest.approx(np.std(mass) / MASS, rel=0.025)
    assert scale.thrust_share == pytest.approx(np.std(mass * one) / THRUST, rel=0.025)


def test_an_added_mass_that_made_nothing_heavier_tells_nothing():
    nothing = AbsoluteScale(None, math.inf, None, math.inf)
    for loaded in (None, (KAPPA, 1e-6), (1.1 * KAPPA, 1e-6)):
        anchor = ScaleReference("added_mass", 0.3, loaded=loaded)
        assert resolve_scale(anchor, FLIGHT, {}) == nothing


def test_priors_are_put_relative_to_thrust():
    scale = AbsoluteScale(MASS, 0.01, 2.0, 0.03)
    known = {"Izz": (0.04, 0.0016), "cg_x": (0.1, 0.002), "rotor_delay": (0.01, 0.003)}
    prior = relative_prior(known, scale)
    std = np.zeros(N_UNKNOWNS)
    at = {"Izz": rb.THETA.index("Izz"), "cg_x": rb.CG_X, "rotor_delay": Unknown.DELAY}
    # An inertia over k_T, with the error of k_T: 4 and 3 %. Lengths and times need no scale.
    for name, (value, deviation) in {
        "Izz": (0.02, 0.05 * 0.02),
        "cg_x": (0.1, 0.002),
        "rotor_delay": (0.01, 0.003),
    }.items():
        assert prior.mean[at[name]] == pytest.approx(value)
        std[at[name]] = deviation
    np.testing.assert_allclose(
        prior.information, np.diag([s**-2.0 if s else 0.0 for s in std]), rtol=1e-9
    )


def test_two_priors_on_one_unknown_add_up():
    scale = AbsoluteScale(MASS, 0.0, 2.0, 0.0)
    # 0.03 to 0.001 twice, once as a torque coefficient; and 0.04, with the same weight.
    prior = relative_prior({"k_M": (0.06, 0.002), "moment_ratio": (0.04, 0.001)}, scale)
    assert prior.mean[rb.MOMENT_RATIO] == pytest.approx(0.035)
    assert prior.information[rb.MOMENT_RATIO, rb.MOMENT_RATIO] == pytest.approx(2e6)


def test_without_a_scale_lengths_alone_are_known():
    nothing = AbsoluteScale(None, math.inf, None, math.inf)
    assert relative_prior({"Izz": (0.04, 0.001), "k_M": (0.06, 0.01)}, nothing) is None
    for name, index in (
        ("cg_y", rb.CG_Y),
        ("moment_ratio", rb.MOMENT_RATIO),
        ("rotor_delay", Unknown.DELAY),
    ):
        prior = relative_prior({"Izz": (0.04, 0.001), name: (0.2, 0.5)}, nothing)
        np.testing.assert_array_equal(np.flatnonzero(prior.known), [index])
        assert prior.mean[index] == 0.2
    assert (
        relative_prior({"mass": (1.5, 0.1), "k_T": (1e-4, 1e-5)}, AbsoluteScale(1, 0, 1, 0)) is None
    )
    assert relative_prior({}, AbsoluteScale(1, 0, 1, 0)) is None
