"""What follows from the kind of rotor stream."""

import json

import numpy as np
import pytest

from gcs_sysid.model.parameters import CORE_OF, REGISTRY
from gcs_sysid.model.rotor_input import RotorInput


@pytest.mark.parametrize("kind", RotorInput)
def test_a_kind_is_its_word_in_files(kind):
    assert json.dumps(kind) == f'"{kind.value}"'
    assert RotorInput(json.loads(json.dumps(kind))) is kind


@pytest.mark.parametrize("kind", RotorInput)
def test_its_coefficients_are_parameters_that_a_complete_result_has(kind):
    assert {kind.thrust, kind.torque} <= set(CORE_OF[kind])
    assert [n for n, p in REGISTRY.items() if p.group == "thrust" and p.in_result(kind)] == [
        kind.thrust
    ]


def test_a_thrust_sets_the_scale_of_its_own_kind_and_a_mass_that_of_any():
    assert [RotorInput.scaled_by(name) for name in ("k_T", "T_max", "mass", None)] == [
        RotorInput.SPEED, RotorInput.COMMAND, None, None,
    ]  # fmt: skip
    assert all(kind.fits("mass") for kind in RotorInput)
    assert not RotorInput.SPEED.fits("T_max")


@pytest.mark.parametrize("kind", RotorInput)
@pytest.mark.parametrize("curve", [0.0, 0.5, 1.0])
def test_a_load_is_that_of_the_value_with_it(kind, curve):
    value = np.array([0.1, 0.5, 0.9])
    load = kind.load(value, np.array(curve))
    np.testing.assert_allclose(kind.at_load(load, np.array(curve)), value)
