"""What a change was: three standard deviations name it."""

import numpy as np
import pytest

from gcs_sysid.estimation.change_kinds import Evidence, describe, find_cause
from gcs_sysid.model import rigid_body as rb

GEOMETRY = np.array([[0.25, -0.25, 0.25, -0.25], [0.25, -0.25, -0.25, 0.25], [1, 1, -1, -1]])
THETA = np.array([80.0, 81.0, 143.0, 6.6, 12.4, -8.1, 0.0, 0.0, 0.03, 0.0, 0.0])
THRUST = rb.SIGNALS.index("thrust")
KAPPA, TOTAL, STD = 1.4e-4, 7e4, np.array([0.1, 0.5, 0.5, 0.5])
SAMPLES = 20
SHARE = np.sqrt(0.25 * SAMPLES)
"""Standard deviations of a mean over those of one sample, of which every fourth is independent."""


@pytest.mark.parametrize(("sigmas", "kind"), [(2.9, "change"), (3.1, "mass_change")])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_fits_that_differ_by_three_deviations_name_the_kind(sigmas, kind, direction):
    # 0.03 and 0.04 kg are 0.05 together; a tenth of the mass is more than its hundredth.
    after = 1.5 + direction * sigmas * 0.05
    event = describe({"mass": (1.5, 0.03)}, {"mass": (after, 0.04)})
    assert event["kind"] == kind
    assert event["parameters"]["mass"]["ci95"] == pytest.approx(
        [after - 1.5 - 1.95996 * 0.05, after - 1.5 + 1.95996 * 0.05], abs=1e-5
    )


@pytest.mark.parametrize(("share", "kind"), [(0.009, "change"), (0.011, "mass_change")])
def test_less_than_a_hundredth_is_no_change_however_sure(share, kind):
    event = describe({"mass": (1.5, 1e-6)}, {"mass": (1.5 * (1.0 + share), 1e-6)})
    assert event["kind"] == kind


def evidence(residual, axes=(0, 1, 2)):
    """Constant residuals, in noise levels of one sample, in hover."""
    Q = rb.forward_matrix(THETA)
    Q[[axis for axis in range(3) if axis not in axes]] = np.nan
    found = Evidence(GEOMETRY, Q, KAPPA, STD)
    x = np.zeros((SAMPLES, rb.N_SIGNALS))
    x[:, THRUST] = TOTAL
    found.add(np.tile(residual * STD, (SAMPLES, 1)), x, np.full((SAMPLES, 4), TOTAL / 4))
    return found


@pytest.mark.parametrize(("sigmas", "kind"), [(2.9, "change"), (3.1, "mass_change")])
def test_residuals_that_mean_three_deviations_name_a_mass(sigmas, kind):
    assert find_cause(evidence(np.array([sigmas / SHARE, 0, 0, 0]))).kind == kind


def test_thrust_alone_does_not_tell_a_mass_from_weak_rotors():
    found = evidence(np.array([5.0 / SHARE, 0, 0, 0]), axes=())
    assert find_cause(found).kind == "change"


def test_a_mass_is_told_by_the_thrust_it_lacks():
    # f_z + kappa T is larger by kappa T (1 - m / m') at the same thrust.
    share = 4.0 / SHARE * STD[0] / (KAPPA * TOTAL)
    found = find_cause(evidence(np.array([4.0 / SHARE, 0, 0, 0])))
    assert found.mass_ratio == pytest.approx(1.0 / (1.0 - share))
    assert found.explained == pytest.approx(1.0)
    assert found.cg_shift == pytest.approx((0.0, 0.0), abs=1e-6)


@pytest.mark.parametrize(("level", "passed"), [(0.9, True), (1.1, False)])
def test_what_is_within_the_noise_again_has_passed(level, passed):
    assert (find_cause(evidence(np.array([level, 0, 0, 0]))).kind == "passing") is passed


@pytest.mark.parametrize(("peak", "passed"), [(4.8, True), (5.0, False)])
def test_a_peak_that_was_too_large_has_not_passed(peak, passed):
    """Three times what noise alone would leave, over all four channels."""
    found = evidence(np.zeros(4))
    e = np.zeros((SAMPLES, 4))
    # Ten of eighty numbers at 4.9 levels: a mean square of three.
    e[: SAMPLES // 2, 3] = peak * STD[3]
    found._e = [e]
    assert (find_cause(found).kind == "passing") is passed


def test_a_lost_share_of_a_rotor_explains_all_four_residuals():
    found = evidence(np.zeros(4))
    loss, rotor = 0.2, 2
    x, y, spin = GEOMETRY[:, rotor]
    Q = rb.forward_matrix(THETA)
    thrust = TOTAL / 4
    e = np.append(KAPPA * thrust, -thrust * (Q[:, :4] @ [-y, x, 1.0, spin]))
    found._e = [np.tile(loss * e, (SAMPLES, 1))]
    cause = find_cause(found)
    assert (cause.kind, cause.rotor) == ("rotor_failure", rotor)
    assert cause.loss == pytest.approx(loss, rel=1e-6)
    assert cause.explained == pytest.approx(1.0)


def test_three_samples_tell_nothing():
    found = evidence(np.full(4, 5.0))
    e, x, squares = found.arrays()
    for count, told in ((3, False), (4, True)):
        few = Evidence(GEOMETRY, found.Q, KAPPA, STD)
        few.add(e[:count], x[:count], squares[:count])
        assert len(few) == count
        assert (find_cause(few) is not None) is told
