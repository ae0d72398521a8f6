"""Rows of commands through motors, and their derivatives, against motors written out."""

import itertools

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.rows.actuator_dynamics import LAGS_OF, ROTOR_COLUMNS, Coordinate
from gcs_sysid.estimation.rows.motor_linearization import LocalDynamics, MotorRows
from gcs_sysid.model import rigid_body as rb

DT, HOVER = 0.004, 0.4
GEOMETRY = np.array([[0.2, -0.2, 0.2, -0.2], [0.2, -0.2, -0.2, 0.2], [1.0, 1.0, -1.0, -1.0]])
AT = np.array([0.004, 0.03, 0.4, 0.3, 0.5])


def flown(n=900, seed=1):
    """Commands, gyro and rates of a lively flight."""
    rng = np.random.default_rng(seed)
    slow = lfilter(np.ones(8), 1.0, np.cumsum(rng.normal(size=(n, 7)), axis=0), axis=0)
    slow -= np.linspace(0.0, 1.0, n)[:, None] * slow[-1]
    slow /= slow.std(axis=0)
    return HOVER + 0.08 * slow[:, :4], slow[:, 4:], slow[:, 4:]


def rows_at(at, of, samples=None, near=None):
    """Rows [x, y] at a point; `near`: linearized about another one."""
    basis = LocalDynamics(at if near is None else near, of, DT)
    rows = MotorRows(GEOMETRY, DT, basis, HOVER).update(*(samples or flown()))
    rows = rows[np.isfinite(rows).all(axis=1)]
    return rows @ basis.map_at(at).T


def share_of(u, at, of):
    """(n, rotors) of full thrust, sample by sample with steps a quarter as long."""
    _, tau, c, e, p = at

    def drive(u):
        share = (1.0 - c) * u + c * u * u
        return {"speed": np.sqrt(share), "command": u, "thrust": share}[of]

    x, fine, hover, out = drive(u[0]), 4, drive(np.array(HOVER)), [drive(u[0])]
    for before, after in itertools.pairwise(u):
        for k in range(fine):
            v = drive(before + (k + 0.5) / fine * (after - before))
            now = tau * np.where(v > x, np.exp(-e / 2.0), np.exp(e / 2.0)) * (hover / x) ** p
            x = v + (x - v) * np.exp(-DT / fine / now)
        out.append(x)
    x = np.array(out)
    return {"speed": x * x, "command": (1.0 - c) * x + c * x * x, "thrust": x}[of]


@pytest.mark.parametrize("of", LAGS_OF)
def test_rows_hold_the_thrust_of_motors_with_a_lag(of):
    u = flown()[0]
    at = np.array([0.0, *AT[1:]])
    found = rows_at(at, of)[:, 2]
    thrust = share_of(u, at, of).sum(axis=1)
    # A row is the mean over three steps of 4 ms, by Simpson's rule for lines good enough here.
    mean = np.convolve(thrust, np.array([0.5, 1.0, 1.0, 0.5]) / 3.0, "valid")
    change = mean[::3] - HOVER
    best = min(
        np.abs(found - mean[k::3][: len(found)]).max()
        for k in range(len(mean) - 3 * len(found) + 3)
    )
    assert best < 2e-3 * np.abs(change).max()


@pytest.mark.parametrize("of", LAGS_OF)
@pytest.mark.parametrize(
    ("which", "by"),
    [
        (Coordinate.DELAY, 0.002),
        (Coordinate.LAG, 1e-3),
        (Coordinate.CURVE, 0.03),
        (Coordinate.ASYMMETRY, 0.03),
        (Coordinate.EXPONENT, 0.06),
    ],
)
def test_rows_near_a_point_are_those_of_the_motors_there(of, which, by):
    other = AT.copy()
    other[which] += by
    true, linear, unmoved = rows_at(other, of), rows_at(other, of, near=AT), rows_at(AT, of)
    n = min(len(true), len(linear), len(unmoved))
    columns = [*ROTOR_COLUMNS, rb.SIGNALS.index("qH"), rb.SIGNALS.index("pH")]
    true, linear, unmoved = (rows[-n:, columns] for rows in (true, linear, unmoved))
    moved = (true - unmoved).std(axis=0)
    # Thrust that lags and the command itself leave some columns alone.
    some = moved > 1e-6 * true.std(axis=0)
    assert some.any()
    assert ((linear - true).std(axis=0)[some] < 0.15 * moved[some]).all()


def test_blocks_change_nothing_and_gaps_leave_out_what_they_touch():
    samples = flown()
    basis = LocalDynamics(AT, "speed", DT)
    at_once = MotorRows(GEOMETRY, DT, basis, HOVER).update(*samples)
    maker = MotorRows(GEOMETRY, DT, basis, HOVER)
    parts = [maker.update(*(s[k : k + 70] for s in samples)) for k in range(0, 900, 70)]
    # But for rounding of states, which are found a block at a time: five of them over a row's time.
    rounding = 5.0 * np.finfo(float).eps / (3 * DT)
    np.testing.assert_allclose(np.concatenate(parts), at_once, rtol=0.0, atol=rounding)
    assert maker.update(*(s[:0] for s in samples)).shape == (0, basis.width)
    unknown = np.isnan(at_once).any(axis=1).sum() * 3 * DT
    assert unknown > 6.0 * AT[Coordinate.LAG] * np.exp((AT[Coordinate.ASYMMETRY] + 0.05) / 2.0)
    u = samples[0].copy()
    u[500] = np.nan
    gone = np.isnan(MotorRows(GEOMETRY, DT, basis, HOVER).update(u, *samples[1:])).any(axis=1)
    assert gone.sum() * 3 * DT == pytest.approx(2.0 * unknown, rel=0.1)


def test_noise_raises_the_thrust_of_motors_that_speed_up_faster():
    """Mean thrust over that with one time constant, and to first order elsewhere."""
    samples = flown()
    u, *_ = samples
    even = np.array([AT[Coordinate.DELAY], AT[Coordinate.LAG], AT[Coordinate.CURVE], 0.0, 0.0])
    skip = round(0.3 / DT)
    told = {}
    for near in (AT, even):
        maker = MotorRows(GEOMETRY, DT, LocalDynamics(near, "speed", DT), HOVER)
        for part in (slice(0, 301), slice(301, None)):
            maker.update(*(signal[part] for signal in samples))
        told[tuple(near)] = maker.mean_thrust.rectified(AT)[0]
    mean = [share_of(u, at, "speed")[skip:].mean() for at in (AT, even)]
    assert told[tuple(AT)] == pytest.approx(mean[0] / mean[1] - 1.0, rel=0.05)
    assert told[tuple(even)] == pytest.approx(told[tuple(AT)], rel=0.3)
    assert told[tuple(AT)] > 1e-3


def test_rows_about_any_motors_are_of_the_same_samples():
    """Of other samples of the gyro they have other noise: costs differed by up to 190 nats."""
    commands, gyro, rates = flown()
    gyro = gyro + np.random.default_rng(3).normal(size=gyro.shape)

    def changes(delay, lag):
        basis = LocalDynamics(np.array([delay, lag, 0.4, 0.0, 0.0]), "speed", DT)
        maker = MotorRows(GEOMETRY, DT, basis, HOVER)
        rows = maker.update(commands, gyro, rates)
        return rows[np.isfinite(rows).all(axis=1)][:, -3:], maker.step.step

    every = [changes(delay, 0.03) for delay in (-0.03, -0.012, -0.004, 0.0, 0.02)]
    every.append(changes(0.0, 0.06))
    assert {step for _, step in every} == {3}
    wanted, _ = every[0]
    for found, _ in every[1:]:
        n = min(len(found), len(wanted))
        assert n > 100
        np.testing.assert_array_equal(found[:n], wanted[:n])
