"""Thrust that falls with the battery, told from the accelerometer."""

import numpy as np
import pytest

from gcs_sysid.estimation.rows.thrust_drift import ThrustDrift, hindsight
from gcs_sysid.model.parameters import GRAVITY

DT, SECONDS = 0.01, 60.0
T = DT * np.arange(round(SECONDS / DT))


def hover(drift, curve, mass=None, noise=0.0):
    """(n, 4) commands and (n,) specific force of a vehicle that bobs and rolls in hover.

    Args:
        drift: (n,) share of full thrust that is lost.
        curve: of thrust.
        mass: (n,) over the first one; None: it stays.
        noise: m/s^2, of the accelerometer.
    """
    force = GRAVITY * (1.0 + 0.05 * np.sin(1.7 * T))
    share = 0.4 * force / GRAVITY / (1.0 - drift) * (1.0 if mass is None else mass)
    shares = share[:, None] * (1.0 + 0.1 * np.sin(2.3 * T)[:, None] * np.array([1, -1, 1, -1]))
    linear = 1.0 - curve
    commands = 2.0 * shares / (linear + np.sqrt(linear**2 + 4.0 * curve * shares))
    random = np.random.default_rng(1)
    return commands, -force + noise * random.normal(size=len(T))


def whole(commands, force, block=6000):
    drift = ThrustDrift(DT)
    return np.concatenate(
        [
            drift.update(commands[i : i + block], force[i : i + block]).factors
            for i in range(0, len(force), block)
        ]
    )


@pytest.mark.parametrize("curve", [0.0, 0.4, 1.0])
def test_commands_make_thrust_as_at_the_start(curve):
    commands, force = hover(0.1 * T / SECONDS, curve, noise=0.1)
    # The command of a share of 0.4, then of 0.4 / 0.9.
    first, last = (
        2.0 * share / (1.0 - curve + np.sqrt((1.0 - curve) ** 2 + 4.0 * curve * share))
        for share in (0.4, 0.4 / 0.9)
    )
    assert whole(commands, force)[-1] == pytest.approx(first / last, rel=0.004)


@pytest.mark.parametrize(
    ("drift", "mass", "noise"),
    [
        (np.zeros_like(T), None, 0.0),
        (np.zeros_like(T), None, 3.0),
        (-0.05 * T / SECONDS, None, 0.1),  # no battery gains
        (np.zeros_like(T), np.where(T < 30.0, 1.0, 1.2), 0.1),
        (np.zeros_like(T), np.where(T < 30.0, 1.0, 0.8), 0.1),
    ],
    ids=["steady", "rough accelerometer", "rising thrust", "payload taken", "payload dropped"],
)
def test_nothing_else_is_a_drift(drift, mass, noise):
    np.testing.assert_array_equal(whole(*hover(drift, 0.5, mass, noise)), 1.0)


def test_without_an_accelerometer_commands_are_as_they_are():
    commands, force = hover(0.1 * T / SECONDS, 0.5)
    np.testing.assert_array_equal(whole(commands, np.full_like(force, np.nan)), 1.0)


def test_a_battery_that_sags_makes_the_curve_doubtful():
    steady, sagging = ThrustDrift(DT), ThrustDrift(DT)
    steady.update(*hover(np.zeros_like(T), 0.5))
    sagging.update(*hover(0.1 * T / SECONDS, 0.5))
    assert steady.curve_doubt == 0.0
    assert sagging.curve_doubt == pytest.approx(0.05)


# --- with the battery's voltage


def told(voltage, drift=None, curve=1.0, effect=1.0, block=6000, **others):
    """Factors and the filter, of a battery with a voltage, on which commands depend by `effect`."""
    if drift is None:
        # exp(-D) on commands is the square of it on thrust, where the curve is a parabola.
        drift = 1.0 - (voltage / voltage[0]) ** (2.0 * effect)
    commands, force = hover(drift, curve, **others)
    follower = ThrustDrift(DT)
    factors = [
        follower.update(*(x[i : i + block] for x in (commands, force, voltage))).factors
        for i in range(0, len(force), block)
    ]
    return np.concatenate(factors), follower


SAGGING = 16.0 * (1.0 - 0.05 * T / SECONDS)


@pytest.mark.parametrize("effect", [0.0, 1.0, 1.5])
def test_thrust_is_that_at_the_voltage_of_the_beginning(effect):
    factors, follower = told(SAGGING, effect=effect, noise=0.1)
    assert follower.voltage == pytest.approx(SAGGING[round(2.5 / DT)], rel=1e-3)
    expected = (SAGGING[-1] / follower.voltage) ** effect
    assert factors[-1] == pytest.approx(expected, rel=0.005)


def test_hindsight_corrects_what_was_flown_before_the_drift_stood_out():
    commands, force = hover(1.0 - (SAGGING / SAGGING[0]) ** 2, 1.0, noise=0.1)
    drift = ThrustDrift(DT).update(commands, force, SAGGING)
    in_proportion = (SAGGING[-1] / SAGGING[0]) ** (T / SECONDS)
    early = slice(round(5.0 / DT), round(10.0 / DT))
    assert (drift.factors[early] == 1.0).all()  # not believed yet
    again = drift.factors * hindsight(drift, drift.applied[-1], drift.fallen[-1])
    # V_0 is that of the first seconds: the same factor all along.
    assert np.ptp(again / in_proportion) < 0.004 < np.ptp(drift.factors / in_proportion)


def test_a_fresh_battery_is_no_lighter_vehicle():
    """Landed at 13.6 V, off again at 16.4 V: thrust stays that of the first flight's voltage."""
    empty = 16.0 * (1.0 - 0.15 * T / SECONDS)
    _, first = told(empty, noise=0.1)
    fresh = 16.4 * (1.0 - 0.02 * T / SECONDS)
    later = ThrustDrift(DT)
    later.go_on_from(first, landed=True)
    found = later.update(*hover(1.0 - (fresh / empty[0]) ** 2, 1.0, noise=0.1), fresh).factors
    assert later.voltage == first.voltage
    after = round(5.0 / DT)
    assert found[after] == pytest.approx(fresh[after] / first.voltage, rel=0.02)
    # What is left of the doubt is no payload.
    assert later.thrust_doubt < 0.04


def test_an_effect_that_no_battery_has_is_doubt():
    """Commands fell with the voltage: what did that may hide a battery in the next flight."""
    follower = ThrustDrift(DT)
    follower.update(*hover(1.0 - (SAGGING / SAGGING[0]) ** -2, 1.0, noise=0.1), SAGGING)
    steady = ThrustDrift(DT)
    steady.update(*hover(np.zeros_like(T), 1.0, noise=0.1), SAGGING)
    assert steady.thrust_doubt < 0.02 < 0.04 < follower.thrust_doubt


def test_a_voltage_that_says_nothing_changes_nothing():
    commands, force = hover(0.1 * T / SECONDS, 0.5, noise=0.1)
    for nothing in (np.full(len(T), np.nan), np.zeros(len(T))):
        follower = ThrustDrift(DT)
        np.testing.assert_array_equal(
            follower.update(commands, force, nothing).factors,
            ThrustDrift(DT).update(commands, force).factors,
        )
        assert follower.voltage is None


def test_what_no_voltage_tells_between_flights_is_doubt():
    steady = ThrustDrift(DT)
    steady.update(*hover(0.1 * T / SECONDS, 0.5))
    later = ThrustDrift(DT)
    later.go_on_from(steady, landed=True)
    assert later.drift == 0.0
    assert 0.05 < later.thrust_doubt < 0.2


def test_a_mass_taken_on_is_weighed_by_the_thrust_that_is_left():
    commands, force = hover(0.1 * T / SECONDS, 0.5)
    follower = ThrustDrift(DT)
    follower.update(commands, force)
    later = ThrustDrift(DT)
    later.go_on_from(follower, landed=False)
    heavier = later.update(1.08 * commands[-1000:], force[-1000:]).factors
    assert heavier[0] == pytest.approx(np.exp(-follower.drift), rel=1e-6)
    assert heavier[-1] == pytest.approx(heavier[0], rel=0.02)
