"""A weak rotor, a moved CG, thinner air: named where the loads tell them apart."""

import json

import numpy as np
import pytest

from gcs_sysid.health.rotor_condition import Load, compare_loads
from gcs_sysid.model.airframe import load_airframe

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
    return Load("speed", np.asarray(values), NOISE**2 * np.eye(len(values)), 10.0)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_rotor_five_percent_weak_is_named(layout):
    airframe = load_airframe(layout)
    n = len(airframe.rotors)
    rng = np.random.default_rng(3)
    for rotor in range(n):
        strength = 1.0 + 0.03 * rng.standard_normal(n)
        cg = tuple(0.02 * rng.standard_normal(2))
        before = load(trim(airframe, cg, strength), rng)
        weak = strength * np.where(np.arange(n) == rotor, 0.95, 1.0)
        found = compare_loads(
            before, load(trim(airframe, cg, weak), rng), airframe, cg, unchanged=False
        )
        assert (found.verdict, found.rotor) == ("rotor", rotor)
        low, high = found.loss.ci95
        assert low < 0.05 < high
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
