"""What the online estimator makes of its fits: the thrust curve's part, the rigid body's test."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.estimation.rows.actuator_dynamics import N_COORDINATES, Coordinate
from gcs_sysid.estimation.rows.rotor_signals import cutoff_of
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.rotor_input import RotorInput

DT = 0.005
CURVES = EstimatorTuning(rotor_input=RotorInput.COMMAND, delays=(0.0,), curves=(-0.2, 1.2))
"""Commands whose thrust curve alone is unknown; motors are measured here, and have no lag."""


def on_commands(flight, *, velocity=True):
    """The flight with commands in proportion to thrust, c = 0, and a little noise."""
    noise = 0.002 * np.random.default_rng(5).standard_normal(flight.gyro.shape)
    gyro = flight.gyro + noise
    w = (flight.speeds / (1.2 * flight.speeds.max())) ** 2
    v = flight.velocity if velocity else np.full_like(flight.velocity, np.nan)
    return replace(flight, gyro=gyro, rates=gyro, speeds=w, velocity=v)


def estimator_of(truth, samples, tuning):
    estimator = OnlineEstimator(truth.geometry, DT, tuning)
    estimator.update(samples)
    return estimator


@pytest.mark.parametrize("source", ["momentum", "accelerometer"])
def test_how_thrust_over_mass_goes_with_the_thrust_curve_is_told(truth, flight, source):
    samples = on_commands(flight, velocity=source == "momentum").part(slice(0, 3000))
    free = estimator_of(truth, samples, CURVES)
    found = free.fit().translation
    assert found.source == source
    # What motors with other curves differ by.
    rotation = free.fit().rotation
    moved = 0.05 * np.eye(N_COORDINATES)[Coordinate.CURVE]
    others = [replace(rotation, coordinates=rotation.coordinates + c * moved) for c in (-1, 1)]
    kappas = [free.fit_translation(other)[0].kappa for other in others]
    expected = (kappas[1] - kappas[0]) / 0.1
    # Gravity over the mean share of thrust, to first order: within 5 % here.
    assert found.curve_slope == pytest.approx(expected, rel=0.05)
    assert abs(found.curve_slope) > 0.1 * found.kappa
    quick = free.fit(quick=True)
    assert quick.translation.curve_slope == pytest.approx(expected, rel=0.05)


def test_a_given_thrust_curve_moves_nothing(truth, flight):
    samples = on_commands(flight).part(slice(0, 2000))
    given = estimator_of(truth, samples, replace(CURVES, curves=(0.0,)))
    assert given.fit().translation.curve_slope == 0.0


def noisy(samples):
    noise = 0.01 * np.random.default_rng(3).standard_normal(samples.gyro.shape)
    return replace(samples, gyro=samples.gyro + noise, rates=samples.rates + noise)


@pytest.mark.slow
def test_inertia_is_right_though_there_is_no_gyroscopic_torque(truth, untwisted_flight):
    fit = estimator_of(truth, noisy(untwisted_flight), EstimatorTuning()).fit()
    assert fit.rigid_body_test.contradicted
    # Rows of one step tell the share to 0.15: at most 1.4 of that off in five seeds. Held to that
    # torque, a fit may explain nothing of yaw, whose share then says nothing.
    share, std = fit.rigid_body_test.share[:2], fit.rigid_body_test.std[:2]
    assert np.all(std < 0.2)
    assert np.all(np.abs(share) < 3.0 * std)
    # Held to that torque, the fit would bend Izz by 44 %, with an interval of 2 %. Without it the
    # rotors' own torques, on all axes, tell it to 0.2 %.
    off = np.abs(fit.rotation.theta - truth.theta)
    assert np.all(off < 4.0 * fit.rotation.std)
    assert np.all(off[:3] < 0.01 * truth.theta[:3])


def test_a_rigid_body_is_held_against_nothing(truth, flight):
    fit = estimator_of(truth, noisy(flight), EstimatorTuning()).fit()
    assert not fit.rigid_body_test.contradicted
    assert fit.rotation.std[2] < 0.05 * truth.theta[2]
    assert abs(fit.rotation.theta - truth.theta)[2] < 3.0 * fit.rotation.std[2]


@pytest.mark.parametrize("cutoff", [None, 25.0])
def test_a_low_pass_that_nobody_told_of_is_no_other_vehicle(truth, flight, cutoff):
    samples = noisy(flight)
    if cutoff is not None:
        b, a = butter(2, 2.0 * DT * cutoff)
        gyro = lfilter(b, a, samples.gyro, axis=0)
        samples = replace(samples, gyro=gyro, rates=gyro)
    estimator = estimator_of(truth, samples.part(slice(0, 3600)), EstimatorTuning())
    fit = estimator.fit().rotation
    assert estimator.rotation.other_layout() is None
    # Rows of one step hold the filter's own motion: the window takes it for a delay.
    assert fit.of_steps == (cutoff is None)
    assert estimator.record.low_passed == (cutoff is not None)
    if cutoff is not None:
        assert cutoff_of(-fit.delay) == pytest.approx(cutoff, rel=0.1)
    assert np.all(fit.r_squared > 0.9)
    assert np.all(np.abs(fit.theta - truth.theta)[:3] < 0.01 * truth.theta[:3])


def test_jumps_of_torque_between_sparse_speeds_widen_delay_and_damping(truth, flight):
    part = noisy(flight).part(slice(0, 1600))
    kicks = np.where(np.arange(1600) // 40 % 2, 1.02, 1.0)[:, None] ** [1, 0, 0, 0]
    for speeds, wider in ((part.speeds, False), (part.speeds * kicks, True)):
        samples, quick, full = replace(part, speeds=speeds), [], []
        for interval in (0.004, 0.02):
            tuning = EstimatorTuning(speed_interval=interval)
            full.append(estimator_of(truth, samples, tuning).fit().rotation)
            estimator = OnlineEstimator(truth.geometry, DT, tuning)
            quick.append(estimator.follow(samples, [1400, 1500])[-1].rotation)
        for usual, sparse in (full, quick):
            np.testing.assert_array_equal(sparse.theta, usual.theta)
            assert (sparse.delay_std > usual.delay_std) == wider
            assert (sparse.std[rb.DAMPING] > usual.std[rb.DAMPING]) == wider
