"""From relative fits to physical parameters, statuses and verdict."""

from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.translation import TranslationFit
from gcs_sysid.estimation.parameters.physical_parameters import (
    ERRORS,
    physical_parameters,
    rotor_values,
    timing_values,
)
from gcs_sysid.estimation.parameters.scale import relative_prior, resolve_scale
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import Cant, ScaleReference
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import CORE_OF, PARAMETERS
from gcs_sysid.model.rotor_input import RotorInput

CORE = CORE_OF[RotorInput.SPEED]

MASS, K_T, ARM = 1.5, 2.05e-4, 0.35
TRUE = {
    "mass": MASS, "Ixx": 0.0165, "Iyy": 0.0167, "Izz": 0.0294,
    "Ixy": 0.00135, "Iyz": 0.00254, "Ixz": -0.00166,
    "cg_x": 0.1, "cg_y": 0.05, "k_T": K_T, "k_M": 6.14e-6,
    "moment_ratio": 6.14e-6 / K_T, "rotational_damping": 0.004, "rotor_inertia": 6e-5,
    "linear_drag": 0.25,
}  # fmt: skip
ALL = dict.fromkeys((n for n, p in PARAMETERS.items() if p.in_result("speed")), 0.0) | TRUE
THETA = rb.theta_of(TRUE, K_T)
COVARIANCE = np.diag((0.003 * THETA) ** 2)
ROTATION = RotationFit(THETA, COVARIANCE, np.eye(3), np.full(3, 0.99), 1000, True)
KAPPA, DELTA = K_T / MASS, TRUE["linear_drag"] / MASS
TRANSLATION = TranslationFit(KAPPA, 0.002 * KAPPA, DELTA, 0.01 * DELTA, "momentum")


def spread(share, **r2):
    return replace(ROTATION, covariance=np.diag((share * THETA) ** 2), **r2)


@pytest.mark.parametrize("anchor", [("mass", MASS), ("k_T", K_T)])
def test_either_true_anchor_gives_the_truth(anchor):
    values = physical_parameters(ScaleReference(*anchor), ROTATION, TRANSLATION, ARM)
    assert set(values) == {n for n, p in PARAMETERS.items() if p.in_result("speed")}
    assert {n: v.value for n, v in values.items()} == pytest.approx(ALL, rel=1e-12)
    assert values[anchor[0]].std == 0.0
    assert {v.status for v in values.values()} == {None}


def test_what_canted_rotors_add_is_no_drag_torque():
    cant = Cant(0.012, 0.012 / ARM**2)
    theta = THETA.copy()
    theta[rb.MOMENT_RATIO] += cant.adds
    theta /= 1.0 - TRUE["moment_ratio"] * cant.lean
    anchor = ScaleReference("mass", MASS)
    values = physical_parameters(
        anchor, replace(ROTATION, theta=theta), TRANSLATION, ARM, cant=cant
    )
    assert {n: v.value for n, v in values.items()} == pytest.approx(ALL, rel=1e-12)
    scale = resolve_scale(anchor, TRANSLATION, {})
    each = rotor_values(replace(ROTATION, theta=theta), scale, 4, cant)
    assert [r["k_M"].value for r in each] == pytest.approx([TRUE["k_M"]] * 4, rel=1e-12)
    prior = {"k_M": (TRUE["k_M"], 1e-8)}
    assert relative_prior(prior, scale, cant).mean[rb.MOMENT_RATIO] == pytest.approx(
        theta[rb.MOMENT_RATIO]
    )


@pytest.mark.parametrize(("kind", "known"), [("mass", MASS), ("k_T", K_T)])
def test_a_wrong_anchor_scales_all_masses_and_moments_alike(kind, known):
    right = physical_parameters(ScaleReference(kind, known), ROTATION, TRANSLATION, ARM)
    wrong = physical_parameters(ScaleReference(kind, 3.0 * known), ROTATION, TRANSLATION, ARM)
    lengths = {"cg_x", "cg_y", "moment_ratio"}
    for name, value in right.items():
        factor = 1.0 if name in lengths else 3.0
        assert wrong[name].value == pytest.approx(factor * value.value, rel=1e-12)
        assert wrong[name].std == pytest.approx(factor * value.std, rel=1e-12)


def test_the_scales_uncertainty_is_carried():
    by_mass = physical_parameters(ScaleReference("mass", MASS), ROTATION, TRANSLATION, ARM)
    by_k_T = physical_parameters(ScaleReference("k_T", K_T), ROTATION, TRANSLATION, ARM)
    assert by_mass["k_T"].std == pytest.approx(0.002 * K_T)
    assert by_k_T["mass"].std == pytest.approx(0.002 * MASS)
    # With the mass as the anchor, inertia hangs on k_T, which is estimated; else it does not.
    ixx = TRUE["Ixx"]
    fitted = np.hypot(0.003, ERRORS.steps)
    assert by_mass["Ixx"].std == pytest.approx(ixx * np.hypot(fitted, 0.002))
    assert by_k_T["Ixx"].std == pytest.approx(ixx * fitted)
    # Lengths need no scale.
    assert by_mass["cg_x"].std == by_k_T["cg_x"].std
    # Rotors each off by a constant rounding error d of standard deviation 1 rpm / sqrt(12) shift it
    # by sum x_i 2 Omega d_i / sum Omega^2.
    squares = 9.80665 / TRANSLATION.kappa
    d = 2.0 * np.pi / 60.0 / np.sqrt(12.0)
    shift = np.sqrt(4 * 0.5) * ARM * 2.0 * np.sqrt(squares / 4) * d / squares
    floor = ERRORS.rounded * shift
    assert by_mass["cg_x"].std == pytest.approx(np.hypot(0.003 * TRUE["cg_x"], floor))


def test_without_rotation_or_translation():
    nothing = physical_parameters(ScaleReference("mass", MASS), None, None, ARM)
    assert nothing.pop("mass") == Estimate(MASS, 0.0, "kg")
    assert {(v.value, v.std) for v in nothing.values()} == {(None, None)}
    lengths = physical_parameters(ScaleReference("mass", MASS), ROTATION, None, ARM)
    assert lengths["cg_x"].value == pytest.approx(0.1)
    assert lengths["Ixx"].value is None
    thrust = physical_parameters(ScaleReference("mass", MASS), None, TRANSLATION, ARM)
    assert thrust["k_T"].value == pytest.approx(K_T)
    assert thrust["Ixx"].value is None


@pytest.mark.parametrize("kappa", [-KAPPA, 0.0, np.nan])
def test_a_thrust_that_makes_no_sense_gives_no_scale(kappa):
    bad = TranslationFit(kappa, 1e-6, DELTA, 0.1, "momentum")
    values = physical_parameters(ScaleReference("mass", MASS), ROTATION, bad, ARM)
    assert values["k_T"].value is values["Ixx"].value is None


def test_accelerometer_gives_no_drag():
    source = TranslationFit(KAPPA, 0.002 * KAPPA, np.nan, np.nan, "accelerometer")
    values = physical_parameters(ScaleReference("mass", MASS), ROTATION, source, ARM)
    assert values["linear_drag"].value is None


@pytest.mark.parametrize("rotor_input", [RotorInput.SPEED, RotorInput.COMMAND])
@pytest.mark.parametrize("told", ["gyro's low-pass", "rotors ahead of the IMU"])
def test_drag_is_doubted_where_the_attitude_is_late(told, rotor_input):
    tau, quickness, sharp = 0.011, 7.0, spread(0.003)
    source = replace(TRANSLATION, quickness=quickness)
    lateness = tau
    if told == "rotors ahead of the IMU":
        lateness, sharp = 0.0, replace(sharp, coordinates=np.array([-tau, 0.0, 0.0, 0.0, 0.0]))
    values = physical_parameters(
        ScaleReference("mass", MASS), sharp, source, ARM, rotor_input=rotor_input, lateness=lateness
    )
    std = MASS * np.hypot(TRANSLATION.delta_std, tau * quickness)
    assert values["linear_drag"].std == pytest.approx(std)
    on_time = physical_parameters(ScaleReference("mass", MASS), ROTATION, source, ARM)
    assert on_time["linear_drag"].std == pytest.approx(MASS * TRANSLATION.delta_std)


def test_commands_name_their_own_parameters():
    anchor = ScaleReference("mass", MASS)
    for translation in (TRANSLATION, None):
        values = physical_parameters(
            anchor, ROTATION, translation, ARM, rotor_input=RotorInput.COMMAND
        )
        assert not {"k_T", "k_M"} & values.keys()
        assert {"T_max", "thrust_curve", "moment_ratio"} <= values.keys()
        assert values["rotor_inertia"].value is None
    assert physical_parameters(anchor, ROTATION, TRANSLATION, ARM, rotor_input=RotorInput.COMMAND)[
        "T_max"
    ].value == pytest.approx(K_T)


def test_a_motors_form_is_doubted_the_more_the_slower_it_is():
    """However well commands fit, a lag of the speed is not one of the command."""
    known = np.diag(np.append((1e-5 * THETA) ** 2, [1e-10, 1e-10, 1e-8, 0.0, 0.0]))
    sure = replace(TRANSLATION, kappa_std=1e-5 * KAPPA)
    stds = []
    for lag in (0.01, 0.03, 0.06):
        at = np.array([0.0, lag, 0.5, 0.0, 0.0])
        fit = replace(spread(1e-5), full_covariance=known, coordinates=at)
        found = physical_parameters(
            ScaleReference("mass", MASS), fit, sure, ARM, rotor_input=RotorInput.COMMAND
        )
        stds.append([found[name].std for name in ("thrust_curve", "T_max", "cg_x")])
        assert timing_values(fit, RotorInput.COMMAND)["motor_lag"].std == pytest.approx(
            0.02 * lag, rel=0.02
        )
    quick, usual, slow = np.array(stds)
    np.testing.assert_allclose(usual, quick)
    np.testing.assert_allclose(slow, 2.0 * usual, rtol=0.01)
    assert usual[0] == pytest.approx(0.0015, rel=0.01)


def cg_std(wind):
    fits = ROTATION, replace(TRANSLATION, wind=wind)
    found = physical_parameters(ScaleReference("mass", MASS), *fits, ARM, seconds=60.0)
    return found["cg_x"].std, found["moment_ratio"].std


def test_wind_seems_to_move_the_cg():
    still, calm, windy = (cg_std(wind) for wind in (0.0, 0.08, 0.1 + 0.981))
    # A tenth of the weight pushes at rotors that are 0.15 arms above the CG.
    shift = 0.15 * ARM * 0.981 / 9.80665
    assert windy[0] == pytest.approx(np.hypot(still[0], shift), rel=1e-3)
    assert calm[0] == pytest.approx(still[0], rel=1e-3)
    assert windy[1] == calm[1] == still[1]


def test_a_gyros_bias_seems_to_move_the_cg():
    # Tilt by what the complementary filter has yet to find looks like a push of g b / k_p on each
    # axis; damping of that rate looks like a moment of the weight.
    bias, wind = 0.005, np.sqrt(2.0) * 9.80665 * 0.005 / 0.7
    shift = TRUE["rotational_damping"] * bias / (MASS * 9.80665)
    sure = replace(ROTATION, covariance=1e-12 * COVARIANCE)
    rounding = physical_parameters(ScaleReference("mass", MASS), sure, TRANSLATION, ARM)["cg_x"].std
    for source in ("momentum", "accelerometer"):
        translation = replace(TRANSLATION, wind=wind, source=source)
        found = physical_parameters(
            ScaleReference("mass", MASS), sure, translation, ARM, seconds=23.05
        )
        # Without a velocity it is the mean of 0.01 rad/s / (1 + (0.7 t)^2) over 23.05 s.
        mean = 0.01 * np.arctan(0.7 * 23.05) / (0.7 * 23.05)
        known = bias if source == "momentum" else mean
        moved = np.sqrt(found["cg_x"].std ** 2 - rounding**2)
        assert moved == pytest.approx(shift * known / bias, rel=0.01)
