"""What an unmodeled moment leaves in an estimate: contrast between whiteners, floor and trim."""

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.fit.disturbance import RULES, BankTrial
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.noise.whitening import gauss_markov, leak
from gcs_sysid.model import rigid_body as rb
from tests.known_theta import theta_from

T = 0.004
BANK = (
    leak(T, 0.3),
    leak(T, 1.0),
    gauss_markov(T, 4.0),
    gauss_markov(T, 11.0),
    gauss_markov(T, 23.0),
)
THETA = theta_from(80.0, 90.0, 150.0, 2.0, 3.0, -2.0, 0.01, -0.005, 0.03, 0.0, 0.3)
STD = 0.01 * np.maximum(np.abs(THETA), 0.1)
NOISE = np.diag([4.0, 5.0, 6.0])
HOVER = 70_000.0


def fit_of(r_squared=(0.99, 0.99, 0.99), std=STD):
    return RotationFit(
        THETA, np.diag(std**2), NOISE, np.array(r_squared), 5000, converged=True
    )  # fmt: skip


def trial(pick=0, apart=0.0, stds=None, gain=0.0):
    """Whiteners that agree but for theta of the last one, `apart` of its standard deviations off.

    Args:
        pick: of all axes.
        apart: of the last whitener's theta.
        stds: of each whitener, over STD.
        gain: nats a second by which the pick is better than the others.
    """
    stds = np.ones(len(BANK)) if stds is None else np.array(stds)
    unknowns = np.tile(np.concatenate([THETA, [0.0, 0.0, 1.0, 0.0, 0.0]]), (len(BANK), 1))
    unknowns[-1, : rb.N_THETA] += apart * stds[-1] * STD
    variance = np.full((len(BANK), 3), np.exp(2.0 * gain * T))
    variance[pick] = 1.0
    variance[np.arange(len(BANK)) != pick] *= 1.0 + 1e-9
    information = np.stack([np.diag((s * STD) ** -2.0) for s in stds])
    return BankTrial(BANK, T, unknowns, variance, information)


def test_whiteners_that_agree_add_nothing():
    assert trial().unknowns.shape == (len(BANK), N_UNKNOWNS)
    assert trial().systematic(fit_of(), HOVER).shape == (0, rb.N_THETA)


@pytest.mark.parametrize("apart", [-50.0, 50.0])
def test_in_calm_air_whiteners_may_differ(apart):
    assert trial(0, apart).systematic(fit_of(), HOVER).shape == (0, rb.N_THETA)


def contrast(apart, stds=None, std=STD, pick=2):
    """(k, N_THETA) of disturbed air: all of the motion explained, no hover to hold a trim in."""
    errors = trial(pick, apart, stds, gain=5.0).systematic(fit_of((1.0, 1.0, 1.0), std), 0.0)
    return errors[errors.any(axis=1)]


# With one faster whitener far surer than the other, its distance alone counts.
ONE_SURE = [1.0, 1.0, 1.0, 1e3, 1.0]


@pytest.mark.parametrize("apart", [-0.95, 0.95])
def test_differences_by_chance_add_nothing(apart):
    assert len(contrast(apart, ONE_SURE)) == 0


@pytest.mark.parametrize("apart", [-5.0, 1.5, 5.0])
def test_what_is_beyond_chance_is_added(apart):
    (error,) = contrast(apart, ONE_SURE)
    expected = np.sign(apart) * np.sqrt(apart**2 - 1.0) * STD
    np.testing.assert_allclose(error, expected, rtol=1e-4)


def test_chance_is_larger_where_scatter_is():
    """Innovations that are not white scatter more than the whiteners' own curvature says."""
    assert len(contrast(2.9, ONE_SURE, std=3.0 * STD)) == 0


def test_whiteners_share_the_contrast_by_how_sure_they_are():
    (error,) = contrast(20.0)
    # Both faster ones equally sure: half of 20, less the surer one's chance.
    np.testing.assert_allclose(error, np.sqrt(100.0 - 1.0) * STD, rtol=1e-6)


@pytest.mark.parametrize("gain", [0.4, 0.9])
def test_a_little_better_is_no_disturbance(gain):
    whiteners = trial(2, gain=gain)
    np.testing.assert_allclose(whiteners.detected, gain, rtol=1e-4)
    assert len(whiteners.systematic(fit_of((0.7, 0.7, 0.7)), HOVER)) == 0


def test_floor_grows_with_the_share_that_is_not_explained():
    whiteners = trial(2, gain=5.0)
    errors = whiteners.systematic(fit_of((0.7, 0.9, 0.5)), HOVER)
    floors = [e for e in errors if not e[[rb.CG_X, rb.CG_Y]].any()]
    assert len(floors) == 3
    for axis, (floor, share) in enumerate(zip(floors, (0.3, 0.1, 0.5), strict=True)):
        moved = [axis] if axis < 2 else [axis, rb.MOMENT_RATIO, rb.ROTOR_INERTIA]
        expected = np.zeros(rb.N_THETA)
        expected[moved] = RULES.floor * share * THETA[moved]
        np.testing.assert_allclose(floor, expected)


def test_trim_is_the_moment_held_by_an_offset():
    errors = trial(2, gain=5.0).systematic(fit_of(), HOVER)
    trims = [e for e in errors if e[[rb.CG_X, rb.CG_Y]].any()]
    assert len(trims) == 2
    # An Ornstein-Uhlenbeck process simulated with the whitener's own figures.
    whitener = BANK[2]
    for axis, place, trim in ((0, rb.CG_Y, trims[0]), (1, rb.CG_X, trims[1])):
        r = whitener.gyro_share * NOISE[axis, axis]
        q = (2.0 * np.pi * 4.0 * T) ** 4 * r
        n, rng = 200_000, np.random.default_rng(axis)
        drive = np.sqrt(q) * rng.standard_normal(n)
        d = lfilter([1.0], [1.0, -whitener.a], drive)[5000:]
        # The moment that it is, over inertia's unit, against thrust in hover.
        assert trim[place] * HOVER / THETA[axis] == pytest.approx(d.std(), rel=0.1)
        assert np.count_nonzero(trim) == 1


def test_no_trim_without_hover_or_without_a_moment():
    assert len(trial(2, gain=5.0).systematic(fit_of(), 0.0)) == 3
    no_moment = trial(0, gain=5.0)
    assert np.all(no_moment.detected == 0.0)
    assert len(no_moment.systematic(fit_of((0.2, 0.2, 0.2)), HOVER)) == 0
