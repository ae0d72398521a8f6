"""The library, within the pilot's limits and the rotors' reach."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.coach.information import motion_of, within_reach
from gcs_sysid.coach.manoeuvre_library import Limits, library
from gcs_sysid.model import rigid_body as rb

LIMITS = (
    Limits(),
    Limits(math.radians(10.0), math.radians(60.0), 0.3),
    Limits(math.radians(45.0), math.radians(600.0), 5.0),
)


@pytest.mark.parametrize("limits", LIMITS)
def test_limits_are_kept(limits):
    found = library(limits)
    assert found
    for manoeuvre in found:
        t = np.linspace(0.0, 10.0, 5001)
        angles = manoeuvre.angles(t)
        rates = np.abs(np.gradient(angles[:, :3], t, axis=0)).max(axis=0)
        assert np.abs(angles[:, :2]).max() <= limits.tilt + 1e-9
        assert np.abs(angles[:, 3]).max() <= limits.height + 1e-9
        assert rates.max() <= limits.rate * (1.0 + 1e-3)


def test_nothing_is_left_where_hardly_anything_is_allowed():
    assert library(Limits(math.radians(5.0), math.radians(20.0), 0.1)) == ()


@pytest.mark.parametrize("manoeuvre", library(Limits()), ids=lambda m: f"{m.name} {m.pace:g}")
def test_motion_obeys_the_equations(manoeuvre, craft):
    """The rotors' part is what the rigid body needs for exactly this motion."""
    motion = motion_of(manoeuvre, craft)
    spectrum = np.fft.rfft(motion.rates, axis=0)
    harmonics = 2j * np.pi / motion.period * np.arange(len(spectrum))
    turning = np.fft.irfft(spectrum * harmonics[:, None], len(motion.rates), axis=0)
    predicted = motion.signals @ rb.forward_matrix(craft.theta).T
    np.testing.assert_allclose(predicted, turning, atol=1e-9 * max(np.abs(turning).max(), 1.0))


@pytest.mark.parametrize("manoeuvre", library(LIMITS[2]), ids=lambda m: f"{m.name} {m.pace:g}")
def test_rotors_keep_turning_and_have_thrust_left(manoeuvre, craft):
    found = within_reach(manoeuvre, craft)
    if found is None:
        shares = motion_of(manoeuvre, craft).shares / craft.mean_share
        assert shares.min() < 0.15 or shares.max() > 0.9 * craft.most
        return
    reached, motion = found
    shares = motion.shares / craft.mean_share
    assert shares.min() >= 0.15
    assert shares.max() <= 0.9 * craft.most
    assert reached.roll <= manoeuvre.roll + 0.01
    assert reached.yaw <= manoeuvre.yaw + 0.01


def test_yaw_within_reach_goes_with_the_rotors_torque(craft):
    (yaw,) = (m for m in library(LIMITS[2]) if m.name == "yaw" and m.pace == 0.7)
    strong = craft.theta.copy()
    strong[rb.MOMENT_RATIO] *= 3.0
    weak = within_reach(yaw, craft)
    better = within_reach(yaw, replace(craft, theta=strong))
    assert weak is not None
    assert better is not None
    assert better[0].yaw > 1.5 * weak[0].yaw
