"""What an unmodeled moment asks of a whitener, and what it leaves in an estimate."""

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.fit.disturbance import BankTrial
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


def fit_of():
    return RotationFit(
        THETA, np.diag(STD**2), NOISE, np.full(3, 0.99), 5000, converged=True
    )  # fmt: skip


def trial(pick=0, gain=0.0, noise=0.0):
    """Whiteners of which one is better than the others on all axes.

    Args:
        pick: it.
        gain: nats a second by which it is.
        noise: (bank, 1) that is known, over the power of its innovations.
    """
    unknowns = np.tile(np.concatenate([THETA, [0.0, 0.0, 1.0, 0.0, 0.0]]), (len(BANK), 1))
    variance = np.full((len(BANK), 3), np.exp(2.0 * gain * T))
    variance[pick] = 1.0
    variance[np.arange(len(BANK)) != pick] *= 1.0 + 1e-9
    return BankTrial(BANK, T, unknowns, variance, variance - noise)


def test_in_calm_air_nothing_is_added():
    assert trial().unknowns.shape == (len(BANK), N_UNKNOWNS)
    assert trial().systematic(fit_of(), HOVER).shape == (0, rb.N_THETA)


@pytest.mark.parametrize("gain", [0.4, 0.9])
def test_a_little_better_is_no_disturbance(gain):
    whiteners = trial(2, gain)
    np.testing.assert_allclose(whiteners.detected, gain, rtol=1e-4)
    assert len(whiteners.systematic(fit_of(), HOVER)) == 0


def test_what_the_loop_answers_is_to_be_white():
    """Of what is known to be in no loop the fourth whitener has more, the first nearly all."""
    noise = np.array([0.9, 0.5, 0.1, 0.3, 0.1])[:, None]
    assert trial(2, 5.0, noise).pick == (3, 3, 2)
    assert trial(2, 0.5, noise).pick == (2, 2, 2)


def test_trim_is_the_moment_held_by_an_offset():
    trims = trial(2, 5.0).systematic(fit_of(), HOVER)
    assert len(trims) == 2
    # An Ornstein-Uhlenbeck process simulated with the whitener's own figures.
    whitener = BANK[2]
    for axis, place, trim in ((0, rb.CG_Y, trims[0]), (1, rb.CG_X, trims[1])):
        r = whitener.gyro_share * NOISE[axis, axis]
        q = (2.0 * np.pi * 4.0 * T) ** 4 * r
        n, rng = 200_000, np.random.default_rng(axis)
        drive = np.sqrt(q) * rng.standard_normal(n)
        d = lfilter([1.0], [1.0, *whitener.numerator], drive)[5000:]
        # The moment that it is, over inertia's unit, against thrust in hover.
        assert trim[place] * HOVER / THETA[axis] == pytest.approx(d.std(), rel=0.1)
        assert np.count_nonzero(trim) == 1


def test_no_trim_without_hover_or_without_a_moment():
    assert len(trial(2, 5.0).systematic(fit_of(), 0.0)) == 0
    no_moment = trial(0, 5.0)
    assert np.all(no_moment.detected == 0.0)
    assert len(no_moment.systematic(fit_of(), HOVER)) == 0
