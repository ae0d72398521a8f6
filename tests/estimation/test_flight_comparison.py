"""Whether two flights were flown by one vehicle."""

from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.estimation.changes.flight_comparison import is_another
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.translation import TranslationFit
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.model import rigid_body as rb

THETA = rb.theta_of(
    {
        "Ixx": 3.6e-3,
        "Iyy": 2.9e-3,
        "Izz": 5.6e-3,
        "Ixy": 1e-4,
        "Iyz": 2.6e-4,
        "Ixz": -1.5e-4,
        "moment_ratio": 0.0134,
        "rotational_damping": 2.7e-3,
    }
)


def on_commands(kappa, curve_std, hover=0.5, curve=0.3):
    """A fit on commands, whose T_max / m rests on a thrust curve known to `curve_std`.

    Args:
        kappa: T_max / m.
        curve_std: one standard deviation.
        hover: command.
        curve: that was found.
    """
    full = np.zeros((N_UNKNOWNS, N_UNKNOWNS))
    full[: rb.N_THETA, : rb.N_THETA] = 1e6 * np.eye(rb.N_THETA)
    full[Unknown.CURVE, Unknown.CURVE] = curve_std**2
    rotation = RotationFit(
        THETA, full[: rb.N_THETA, : rb.N_THETA], np.eye(3), np.full(3, 0.99), 1000, True,
        full_covariance=full,
    )  # fmt: skip
    # 1 / kappa goes with the share of full thrust (1 - c) u + c u^2.
    slope = kappa * (1.0 - hover) / (1.0 - curve * (1.0 - hover))
    thrust = TranslationFit(kappa, 0.006, 0.2, 0.001, "momentum")
    return Fit(rotation, replace(thrust, curve_slope=slope), 20.0)


@pytest.mark.parametrize("curve_std", [0.02, 0.5])
@pytest.mark.parametrize(("heavier", "another"), [(1.0, False), (1.02, False), (1.1, True)])
def test_the_curves_error_is_the_same_in_both_flights(heavier, another, curve_std):
    before, now = on_commands(4.3, curve_std), on_commands(4.3 / heavier, curve_std)
    assert is_another(before, now, 0.28) is another


@pytest.mark.parametrize(("curve_std", "another"), [(0.05, True), (0.5, False)])
def test_another_place_on_an_uncertain_curve_is_doubt(curve_std, another):
    before, now = on_commands(4.3, curve_std, hover=0.3), on_commands(3.9, curve_std, hover=0.6)
    assert is_another(before, now, 0.28) is another


@pytest.mark.parametrize(("battery", "another"), [(0.0, True), (0.05, False)])
def test_a_battery_that_nobody_measures_may_be_the_difference(battery, another):
    before, now = on_commands(4.3, 0.05), on_commands(3.9, 0.05)
    assert is_another(before, now, 0.28, battery) is another


ARM, KAPPA = 0.25, 2.0
SIZE = np.append(
    np.array([3.6, 2.9, 5.6, *np.sqrt([3.6 * 2.9, 2.9 * 5.6, 3.6 * 5.6])]) * 1e-3,
    [ARM, ARM, 0.0134, 0.0, 0.0],
)
"""What an error of theta is measured by: an inertia by moments, a CG by the arm."""
COMPARED = range(rb.DAMPING)


def turning(known=(), share=0.02, moved=0.0, sign=1.0):
    """A fit that knows some of theta to a share of its size; the rest is anything."""
    std = np.full(rb.N_THETA, 1e6)
    theta = THETA * np.where(np.arange(rb.N_THETA) == rb.MOMENT_RATIO, sign, 1.0)
    for i in known:
        std[i] = share * SIZE[i]
        theta[i] += moved * SIZE[i]
    return RotationFit(theta, np.diag(std**2), np.eye(3), np.full(3, 0.99), 1000, True)


def lifting(kappa=KAPPA, share=0.02, source="momentum"):
    return TranslationFit(kappa, share * KAPPA, 0.2, 0.001, source)


# One unknown, each known to 2 %, and 1 % of the model's own: 3 % together. Once in a hundred
# times a flight of the same vehicle is 2.58 of these off.
@pytest.mark.parametrize(("moved", "another"), [(0.0755, False), (0.0785, True)])
@pytest.mark.parametrize("index", COMPARED)
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_each_parameter_tells_once_its_difference_is_beyond_chance(
    index, direction, moved, another
):
    before, now = (Fit(turning([index], moved=m), None, 20.0) for m in (0.0, direction * moved))
    assert is_another(before, now, ARM) is another


def test_small_differences_of_many_add_up():
    # Two of 2.3 deviations are no chance in 1 of 100 (chi-square of two: 9.21), one is.
    one, both = [0], [0, 1]
    for known, another in ((one, False), (both, True)):
        before, now = (Fit(turning(known, moved=m), None, 20.0) for m in (0.0, 0.069))
        assert is_another(before, now, ARM) is another
    before, now = (
        Fit(turning(one, moved=m), lifting(KAPPA * (1.0 + m)), 20.0) for m in (0.0, 0.069)
    )
    assert is_another(before, now, ARM)


def test_what_comes_out_next_to_nothing_is_not_compared():
    # Izz of a flight with hardly any yaw: 0.0016 +- 0.0007 for 0.0057.
    before, now = (Fit(turning([2], s, m), None, 20.0) for s, m in ((0.02, 0.0), (0.12, -0.7)))
    assert not is_another(before, now, ARM)


@pytest.mark.parametrize(("share", "another"), [(0.24, True), (0.26, False)])
@pytest.mark.parametrize("poor", ["before", "now"])
@pytest.mark.parametrize("what", ["rotation", "thrust"])
def test_what_is_known_to_no_quarter_of_its_size_says_nothing(what, poor, share, another):
    shares = (share, 0.02) if poor == "before" else (0.02, share)
    if what == "rotation":
        fits = [Fit(turning([0], s, m), None, 20.0) for s, m in zip(shares, (0.0, 0.9))]  # noqa: B905
    else:
        kappas = zip(shares, (KAPPA, 1.9 * KAPPA))  # noqa: B905
        fits = [Fit(None, lifting(kappa, s), 20.0) for s, kappa in kappas]
    assert is_another(*fits, ARM) is another


@pytest.mark.parametrize(
    ("lift", "inertia", "another"),
    [
        (0.95, 1.053, False),  # thrust is less: T_max / m falls, J / T_max rises
        (1.15, 0.87, False),
        (0.85, 1.0, True),  # a payload at the CG
        (1.15, 1.0, True),
        (1.0, 1.1, True),
    ],
)
def test_a_battery_leaves_inertia_over_mass_alone(lift, inertia, another):
    known = range(3)
    before = Fit(turning(known, 0.01), lifting(share=0.01), 20.0)
    rotation = turning(known, 0.01)
    rotation = replace(rotation, theta=rotation.theta * np.where(rb.RELATIVE, inertia, 1.0))
    now = Fit(rotation, lifting(KAPPA * lift, 0.01), 20.0)
    assert is_another(before, now, ARM, 0.07) is another


def test_damping_and_rotor_inertia_are_too_faint_to_tell():
    fits = []
    for factor in (1.0, 9.0):
        fit = turning()
        theta = fit.theta.copy()
        theta[rb.DAMPING :] = 0.01 * factor
        covariance = fit.covariance.copy()
        covariance[-2:, -2:] = 1e-12 * np.eye(2)
        fits.append(Fit(replace(fit, theta=theta, covariance=covariance), None, 20.0))
    assert not is_another(*fits, ARM)


def test_nothing_known_is_nothing_else():
    nothing = Fit(None, None, 0.0)
    known = Fit(turning(COMPARED), lifting(), 20.0)
    for fits in ((nothing, nothing), (nothing, known), (known, nothing)):
        assert not is_another(*fits, ARM)
    assert not is_another(Fit(turning(), None, 1.0), Fit(turning(), None, 1.0), ARM)


def test_thrust_from_two_sources_is_compared_by_the_accelerometers():
    own = lifting(source="accelerometer")
    before = Fit(None, lifting(2.0 * KAPPA), 20.0, accelerometer=own)
    now = Fit(None, own, 20.0, accelerometer=own)
    assert not is_another(before, now, ARM)
    assert is_another(before, replace(now, accelerometer=lifting(2.0 * KAPPA)), ARM)
    assert not is_another(before, replace(now, accelerometer=None), ARM)
    # One source in both: the accelerometers are not asked.
    same = replace(before, accelerometer=lifting(5.0 * KAPPA))
    assert not is_another(before, same, ARM)
