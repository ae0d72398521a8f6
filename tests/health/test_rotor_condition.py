"""A weak rotor, a moved CG, thinner air: named where the loads tell them apart."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.health.health_file import condition_text
from gcs_sysid.health.hover import Windows
from gcs_sysid.health.rotor_condition import Load, compare_loads, watch_rotors
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.rotor_input import RotorInput

LAYOUTS = ("px4-quad-x", "px4-hexa-x", "px4-octo-x")
NOISE = 0.001


def trim(airframe, cg, strength, total=1.0):
    """(rotors,) speeds squared of a hover: the least change that balances force and moments."""
    x, y, spin = airframe.geometry
    B = np.vstack([np.ones(len(x)), x - cg[0], y - cg[1], spin])
    # Torque goes with speed, thrust with strength: the mixer asks within the span of B's rows.
    effect = np.vstack([B[:3] * strength, spin * strength])
    wanted = np.array([total, 0.0, 0.0, 0.0])
    return B.T @ np.linalg.solve(effect @ B.T, wanted)


def load(values, rng=None):
    if rng is not None:
        values = values * (1.0 + NOISE * rng.standard_normal(len(values)))
    return Load(RotorInput.SPEED, np.asarray(values), NOISE**2 * np.eye(len(values)), 10.0)


@pytest.mark.parametrize("loss", [0.05, 0.9])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_weak_rotor_is_named(layout, loss):
    airframe = load_airframe(layout)
    n = len(airframe.rotors)
    rng = np.random.default_rng(3)
    for rotor in range(n):
        strength = 1.0 + 0.03 * rng.standard_normal(n)
        cg = tuple(0.02 * rng.standard_normal(2))
        before = load(trim(airframe, cg, strength), rng)
        weak = strength * np.where(np.arange(n) == rotor, 1.0 - loss, 1.0)
        now = load(trim(airframe, cg, weak), rng)
        found = compare_loads(before, now, airframe, cg, unchanged=False)
        assert (found.verdict, found.rotor) == ("rotor", rotor)
        low, high = found.loss.ci95
        assert low < loss < high
        assert found.efficiency[rotor].value < 0.99


@pytest.mark.parametrize("layout", LAYOUTS)
def test_no_rotor_is_named_where_nothing_changed_or_the_load_did(layout):
    airframe = load_airframe(layout)
    rng = np.random.default_rng(4)
    strength = 1.0 + 0.03 * rng.standard_normal(len(airframe.rotors))
    before = load(trim(airframe, (0.01, 0.0), strength), rng)
    same = load(trim(airframe, (0.01, 0.0), strength), rng)
    assert (
        compare_loads(before, same, airframe, (0.01, 0.0), unchanged=False).verdict == "unchanged"
    )
    # Thinner air takes all rotors alike.
    thin = load(1.02 * trim(airframe, (0.01, 0.0), strength), rng)
    assert compare_loads(before, thin, airframe, (0.01, 0.0), unchanged=False).verdict == "all"
    moved = load(trim(airframe, (0.035, 0.0), strength), rng)
    found = compare_loads(before, moved, airframe, (0.01, 0.0), unchanged=False)
    assert found.verdict == "cg"
    assert found.moved[0] == pytest.approx(0.025, rel=0.1)


@pytest.mark.parametrize(("loss", "verdict"), [(0.025, "unclear"), (0.04, "rotor")])
def test_less_than_three_percent_is_no_weak_rotor(loss, verdict):
    """What gusts make of sound rotors reaches 2.4 %."""
    airframe = load_airframe("px4-octo-x")
    strength = np.ones(8)
    before = load(trim(airframe, (0.0, 0.0), strength))
    strength[5] -= loss
    found = compare_loads(
        before, load(trim(airframe, (0.0, 0.0), strength)), airframe, (0.0, 0.0), unchanged=True
    )
    assert (found.verdict, found.suspect) == (verdict, None)


@pytest.mark.parametrize("change", [0.9, 1.1])
def test_what_all_rotors_share_leaves_no_number_open(change):
    """The air became denser: no rotor is weaker, and the JSON holds finite numbers all the same."""
    airframe = load_airframe("px4-quad-x")
    before = trim(airframe, (0.0, 0.0), np.ones(4))
    now = load(change * before)
    found = compare_loads(load(before), now, airframe, (0.0, 0.0), unchanged=False)
    assert found.verdict == "all"
    assert np.isfinite(found.margin)
    json.dumps(found.as_json(), allow_nan=False)


def test_loads_that_gusts_may_have_changed_name_nobody():
    """The force in the rotors' plane shows gusts that the loads' own scatter does not."""
    airframe = load_airframe("px4-quad-x")
    before = load(trim(airframe, (0.0, 0.0), np.ones(4)))
    now = load(trim(airframe, (0.0, 0.0), np.array([0.95, 1.0, 1.0, 1.0])))
    verdicts = {}
    for gusts in (0.0, 0.08, 0.6):
        blown = replace(now, gusts=gusts)
        found = compare_loads(before, blown, airframe, (0.0, 0.0), unchanged=True)
        verdicts[gusts] = found.verdict
    assert verdicts == {0.0: "rotor", 0.08: "rotor", 0.6: "unchanged"}
    assert Load.of_json(json.loads(json.dumps(blown.as_json()))).gusts == 0.6
    older = {key: value for key, value in blown.as_json().items() if key != "gusts"}
    assert Load.of_json(older).gusts == 0.0


def test_a_propeller_without_its_torque_is_not_told_from_a_cg_on_four_rotors():
    """Its yaw balance hides it: that must be said, and no rotor named."""
    airframe = load_airframe("px4-quad-x")
    x, y, spin = airframe.geometry
    strength = np.array([0.85, 1.0, 1.0, 1.0])
    effect = np.vstack([np.ones(4) * strength, x * strength, y * strength, spin])
    weak = np.linalg.solve(effect, [1.0, 0.0, 0.0, 0.0])
    found = compare_loads(load(np.full(4, 0.25)), load(weak), airframe, (0.0, 0.0), unchanged=False)
    assert found.rotor is None
    assert found.verdict in ("unclear", "cg")


def test_a_load_is_read_back_from_its_file():
    one = load(np.array([0.2, 0.3, 0.25, 0.25]))
    again = Load.of_json(json.loads(json.dumps(one.as_json())))
    assert again.value == pytest.approx(one.value)
    assert again.covariance == pytest.approx(one.covariance)
    for wrong in ({"value": [0.2, -1.0]}, {"covariance": [[1.0]]}, {"seconds": "x"}):
        with pytest.raises((KeyError, TypeError, ValueError)):
            Load.of_json({**one.as_json(), **wrong})


def gusty(values, moments, airframe, rng=None, force=None):
    """A load whose total, roll, pitch and yaw are off by standard deviations `moments`."""
    x, y, spin = airframe.geometry
    effect = np.vstack([np.ones(len(x)), x / airframe.arm, y / airframe.arm, spin])
    asked = effect.T @ np.linalg.inv(effect @ effect.T) * len(x)
    covariance = asked @ np.diag(np.square(moments)) @ asked.T + 1e-10 * np.eye(len(x))
    off = 0.0 if rng is None else rng.multivariate_normal(np.zeros(len(x)), covariance)
    return Load(RotorInput.SPEED, values * np.exp(off), covariance, 10.0, None, force)


GUSTS = (0.003, 0.0005, 0.0005, 0.008)
"""Of hover in the emulator's turbulence: yaw varies by more than a weak rotor of eight makes."""


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_rotor_is_named_in_gusts_where_nothing_was_moved(layout):
    airframe = load_airframe(layout)
    n = len(airframe.rotors)
    rng = np.random.default_rng(5)
    for rotor in range(n):
        strength = 1.0 + 0.03 * rng.standard_normal(n)
        weak = strength * np.where(np.arange(n) == rotor, 0.95, 1.0)
        before = gusty(trim(airframe, (0.0, 0.0), strength), GUSTS, airframe, rng)
        now = gusty(trim(airframe, (0.0, 0.0), weak), GUSTS, airframe, rng)
        found = compare_loads(before, now, airframe, (0.0, 0.0), unchanged=True)
        assert (found.verdict, found.rotor) == ("rotor", rotor)
        # Where something may have been moved, no rotor is called weak, but the one is told.
        unsure = compare_loads(before, now, airframe, (0.0, 0.0), unchanged=False)
        assert unsure.verdict in ("unclear", "unchanged") or unsure.rotor == rotor
        if unsure.verdict == "unclear":
            assert unsure.rotor is None
            assert unsure.suspect in (None, rotor)
            words = condition_text(unsure)
            assert "cannot separate" in words
            assert unsure.suspect is None or f"rotor {rotor + 1} is weak" in words


def test_gusts_alone_name_nobody():
    rng = np.random.default_rng(6)
    for layout in LAYOUTS:
        airframe = load_airframe(layout)
        even = trim(airframe, (0.0, 0.0), np.ones(len(airframe.rotors)))
        for _ in range(60):
            pair = (gusty(even, GUSTS, airframe, rng) for _ in range(2))
            assert compare_loads(*pair, airframe, (0.0, 0.0), unchanged=True).verdict != "rotor"


def test_what_wind_does_is_no_weak_rotor():
    """Drag above the CG moves the center of thrust; the accelerometer feels the wind."""
    airframe = load_airframe("px4-quad-x")
    even = trim(airframe, (0.0, 0.0), np.ones(4))
    calm = gusty(even, GUSTS, airframe, force=(0.0, 0.0))
    x, y, _ = airframe.geometry
    blown = even * (1.0 + 0.02 * (x + y) / airframe.arm)

    def judged(force):
        now = gusty(blown, GUSTS, airframe, force=(force, force))
        return compare_loads(calm, now, airframe, (0.0, 0.0), unchanged=True).verdict

    assert judged(0.0) == "rotor"
    # A breeze between two flights of a day does as much.
    assert judged(-0.25) == "unchanged"
    assert judged(-0.8) == "unchanged"


def hover_of(airframe, strengths, rng):
    """Windows of hover, half a second apart, at the speeds that these strengths ask for."""
    n, rotors = len(strengths), len(airframe.rotors)
    speeds = np.array([trim(airframe, (0.0, 0.0), strength) for strength in strengths])
    speeds *= 1.0 + 0.002 * rng.standard_normal((n, rotors))
    nothing, commands = np.full(n, np.nan), np.full((n, rotors), np.nan)
    force = np.tile([0.0, 0.0, -9.81], (n, 1)) + 0.01 * rng.standard_normal((n, 3))
    turning = 0.01 * rng.standard_normal((n, 3))
    zeros = np.zeros((n, 3))
    return Windows(
        t=0.5 * np.arange(n), half=0.5, rates=zeros, turning=turning, products=zeros, force=force,
        lift=np.full(n, 9.81), sink=nothing, speed=nothing, speeds=speeds, commands=commands,
        squares=commands, jitter=np.full((n, rotors, 2), np.nan), lag=0.0,
        hovering=np.ones(n, bool),
    )  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_rotor_that_becomes_weak_in_flight_is_named_soon(layout):
    airframe = load_airframe(layout)
    rng = np.random.default_rng(7)
    even = 1.0 + 0.03 * rng.standard_normal(len(airframe.rotors))
    weak = even * np.where(np.arange(len(even)) == 1, 0.95, 1.0)
    flight = hover_of(airframe, [even] * 100 + [weak] * 60, rng)
    found, judged = watch_rotors(flight, flight.speeds, None, airframe, (0.0, 0.0))
    assert judged > 0
    assert (found.condition.verdict, found.condition.rotor) == ("rotor", 1)
    assert 50.0 < found.t <= 66.0
    sound = hover_of(airframe, [even] * 160, rng)
    found, judged = watch_rotors(sound, sound.speeds, None, airframe, (0.0, 0.0))
    assert found is None
    assert judged == 9
    short = hover_of(airframe, [even] * 70, rng)
    assert watch_rotors(short, short.speeds, None, airframe, (0.0, 0.0)) == (None, 0)


def test_a_calm_stretch_does_not_claim_more_than_the_flight_before_allows():
    airframe = load_airframe("px4-quad-x")
    rng = np.random.default_rng(5)
    usual = trim(airframe, (0.0, 0.0), np.ones(4))
    gusts = 0.02**2 * np.eye(4) / 30.0
    before = Load(RotorInput.SPEED, usual, gusts, 30.0)
    now = usual * (1.0 + 0.02 / np.sqrt(10.0) * rng.standard_normal(4))
    # By luck its own few gusts cancelled: taken at their word they would name a rotor.
    lucky = Load(RotorInput.SPEED, now, gusts * 1e-3, 10.0)
    found = compare_loads(before, lucky, airframe, (0.0, 0.0), unchanged=True)
    assert found.verdict == "unchanged"
    # A stretch that is far windier than before hides as much as its own noise says.
    weak = trim(airframe, (0.0, 0.0), np.array([0.95, 1.0, 1.0, 1.0]))
    calm = Load(RotorInput.SPEED, weak, gusts, 10.0)
    assert compare_loads(before, calm, airframe, (0.0, 0.0), unchanged=True).rotor == 0
    windy = Load(RotorInput.SPEED, weak, 1000.0 * gusts, 10.0)
    assert compare_loads(before, windy, airframe, (0.0, 0.0), unchanged=True).verdict == "unchanged"
