"""Standard deviations of what is given, as files and options write them."""

import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import (
    UNCERTAIN,
    USUAL,
    Sigma,
    load_airframe,
    parse_airframe,
    parse_sigma,
)


def test_what_is_usual():
    assert USUAL.arm.of(0.25) == pytest.approx(0.0025)
    assert USUAL.scale_share("mass", 1.5) == pytest.approx(0.005)
    assert USUAL.scale_share("added_mass", 0.3) == pytest.approx(0.005)
    assert USUAL.imu_position == Sigma(0.02)
    assert USUAL.imu_rotation == Sigma(1.0)


@pytest.mark.parametrize(
    ("entry", "sigma"),
    [
        (0.003, Sigma(0.003)),
        (0, Sigma(0.0)),
        ("1%", Sigma(0.01, True)),
        (" 2 % ", Sigma(0.02, True)),
        ("0.003", Sigma(0.003)),
        ("1e-3", Sigma(0.001)),
    ],
)
def test_numbers_and_percentages(entry, sigma):
    assert parse_sigma(entry, "here") == sigma


def test_written_as_it_is_read():
    for sigma in (Sigma(0.003), Sigma(0.015, True)):
        assert parse_sigma(str(sigma), "here") == sigma


@pytest.mark.parametrize(
    "entry", [-1, True, None, "x", "-1%", "60%", [1], float("nan"), "%", 10**400]
)
def test_what_is_no_standard_deviation(entry):
    with pytest.raises(InputError, match="here: the standard deviation must be"):
        parse_sigma(entry, "here")


def table(**entries):
    rotors = [{"x": r.x, "y": r.y, "spin": "ccw" if r.spin > 0 else "cw"}
              for r in load_airframe("paper").rotors]  # fmt: skip
    return {"rotor": rotors, "mass": 1.5, "uncertainty": entries}


def test_a_file_says_how_well_it_knows():
    told = parse_airframe(table(arm=0.003, mass=0.01, imu_position=0.005, imu_rotation=2), "f")
    assert told.uncertainty.arm.of(told.arm) == 0.003
    assert told.uncertainty.scale_share("mass", 1.5) == pytest.approx(0.01 / 1.5)
    assert told.uncertainty.imu_position == Sigma(0.005)
    assert told.uncertainty.k_T == USUAL.k_T


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ({"weight": 1}, r"f: \[uncertainty\]: unknown key 'weight'; known are arm"),
        ({"imu_rotation": "1%"}, "imu_rotation must be at most 30 degrees"),
        ({"imu_position": 2.0}, "imu_position must be at most 1 m"),
    ],
)
def test_what_makes_no_sense_in_a_file(entries, said):
    with pytest.raises(InputError, match=said):
        parse_airframe(table(**entries), "f")


def test_what_is_hardly_known_sets_no_scale():
    for name in ("arm", "mass"):
        with pytest.raises(
            InputError, match=f"{name}: a standard deviation of 1 is more than half"
        ):
            parse_airframe(table(**{name: 1.0}), "f").check_scale_fits()


@pytest.mark.parametrize("name", ["paper", "px4-sih"])
def test_simulated_vehicles_are_exact(name):
    told = load_airframe(name).uncertainty
    assert all(getattr(told, key).amount == 0.0 for key in UNCERTAIN)
