"""Rotors or ground: who carries the vehicle."""

import numpy as np
import pytest

from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.signals.flight_detection import GroundTest

G = 9.81
T = np.arange(0.0, 30.0, 0.02)


def stood(effort, force, rate=0.02, *, commands=False, noise=0.1, block=10**6, test=None):
    """Where the ground is found to carry it, from the mean of what thrust grows with."""
    rng = np.random.default_rng(4)
    force = np.abs(force + noise * rng.normal(size=len(T)))
    rates = np.full((len(T), 3), rate)
    empty = np.full(len(T), np.nan)
    thrust = np.column_stack([empty, effort] if commands else [effort, empty])
    test = GroundTest() if test is None else test
    parts = [slice(i, i + block) for i in range(0, len(T), block)]
    every = (T, force, rates, thrust, np.sqrt(effort)[:, None])
    return np.concatenate([test.update(*(values[k] for values in every)) for k in parts]) < 0.0


def maneuvers(share=0.05):
    """Relative thrust of a pilot who holds height, with white jitter of the mixer."""
    rng = np.random.default_rng(5)
    return 1.0 + share * np.sin(3.0 * T) + 0.2 * share * rng.normal(size=len(T))


def test_a_bench_run_is_carried_by_the_bench():
    steps, test = 1e5 * (2.0 + np.sin(0.8 * T)), GroundTest()
    assert stood(steps, G + 0.0 * T, test=test)[T > 3.0].all()
    assert [start for start, _ in test.stood] == [-np.inf]


def test_what_flew_stood_from_its_last_sign_of_flight_on():
    thrust, test = np.where(T < 20.0, maneuvers(0.1), 0.3 + 0.1 * np.sin(3.0 * T)), GroundTest()
    assert stood(4e5 * thrust, np.where(T < 20.0, G * thrust, G), test=test)[-1]
    [(start, end)] = test.stood
    assert 19.5 < start < 21.5
    assert start < end < 23.0


@pytest.mark.parametrize("commands", [False, True])
def test_what_hovers_is_carried_by_its_rotors(commands):
    thrust = maneuvers()
    effort = np.sqrt(thrust) if commands else 4e5 * thrust
    assert not stood(effort, G * thrust, commands=commands).any()
    # So it is where motors lag.
    thrust = maneuvers(0.1)
    late = np.convolve(thrust, np.full(8, 0.125))[: len(T)]
    late[:8] = 1.0
    assert not stood(thrust, G * late).any()


def test_constant_thrust_and_missing_streams_say_nothing():
    for noise in (0.0, 0.1, 1.0):
        assert not stood(np.full(len(T), 4e5), G + 0.0 * T, noise=noise).any()
    empty = np.full((len(T), 2), np.nan)
    assert not GroundTest().update(T, empty[:, 0], np.full((len(T), 3), np.nan), empty, empty).any()


def test_a_take_off_is_seen_within_two_seconds():
    """Spooled up on its feet for five seconds, then it climbs and hovers."""
    ground = T < 10.0
    effort = np.where(T < 5.0, 0.1, np.where(ground, 0.1 + 0.16 * (T - 5.0), 1.0)) * 4e5
    climb = 1.15 * maneuvers(0.1)
    effort = np.where(ground, effort, 4e5 * climb)
    found = stood(effort, np.where(ground, G, G * climb))
    assert found[(T > 7.0) & ground].all()
    assert not found[T > 12.0].any()


@pytest.mark.parametrize(("force", "rate"), [(2.0, 0.1), (25.0, 0.1), (G, 3.0)])
def test_what_falls_climbs_or_turns_stands_on_nothing(force, rate):
    steps = 1e5 * (2.0 + np.sin(0.8 * T))
    assert not stood(steps, force + 0.0 * T, rate).any()


@pytest.mark.parametrize(("answers", "stands"), [(0.1, True), (2.0, False), (0.0, False)])
def test_what_does_not_turn_as_its_rotors_differ_stands_at_constant_thrust(answers, stands):
    """But where noise of their readings alone makes them differ."""
    geometry, rng = load_airframe("px4-quad-x").geometry, np.random.default_rng(1)
    sway = np.outer(np.sin(4.0 * T), np.sign(geometry[1]))
    speeds = 1.0 + 0.05 * (sway if answers else rng.standard_normal(sway.shape))
    rates = np.outer(answers * G * 0.1 * np.cos(4.0 * T) / 4.0, [1.0, 0.0, 0.0])
    thrust = np.column_stack([np.full(len(T), 4e5), np.full(len(T), np.nan)])
    found = GroundTest(geometry).update(T, G + 0.0 * T, rates, thrust, speeds) < 0.0
    assert found[T > 3.0].all() if stands else not found.any()
