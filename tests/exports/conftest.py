"""The vehicle of `known` as a result, and as it is exported."""

import pytest

from gcs_sysid.exports.exported_vehicle import assemble

from . import known


@pytest.fixture
def result():
    """As identified with rotor speeds."""
    return known.speed_result()


@pytest.fixture
def vehicle(result):
    """With what a flight with rotor speeds does not tell said beside it."""
    return assemble(result, given={"rotor_speed_max": known.FULL_SPEED, "motor_lag": known.LAG})
