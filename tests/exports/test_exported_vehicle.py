"""What is known of a vehicle, where from, and what is refused rather than invented."""

import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from gcs_sysid.cli.commands import EXPORT_TARGETS
from gcs_sysid.errors import InputError
from gcs_sysid.exports import FORMATS
from gcs_sysid.exports.exported_vehicle import MissingError, assemble
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.estimate import Estimate

from .known import FULL_SPEED, LAG, TURN, VALUES, Equations, estimate, without

EVERYTHING = {"rotor_speed_max": FULL_SPEED, "motor_lag": LAG}


def test_names_on_the_command_line_are_the_targets():
    assert tuple(FORMATS) == EXPORT_TARGETS


def test_axes_forward_left_up(vehicle):
    truth = Equations()
    assert vehicle.inertia == pytest.approx(truth.J)
    assert vehicle.inertia_flu == pytest.approx(TURN @ truth.J @ TURN)
    assert vehicle.inertia_flu[0, 1] == -VALUES["Ixy"]
    assert vehicle.inertia_flu[0, 2] == -VALUES["Ixz"]
    assert vehicle.inertia_flu[1, 2] == VALUES["Iyz"]
    assert vehicle.cg_flu.tolist() == [VALUES["cg_x"], -VALUES["cg_y"], 0.0]
    assert vehicle.rotors_flu == pytest.approx(truth.rotors @ TURN)


def test_two_of_three_tell_the_third(result):
    full = VALUES["k_T"] * FULL_SPEED**2
    assert assemble(result, given={"rotor_speed_max": FULL_SPEED})["T_max"] == pytest.approx(full)
    found = assemble(result, given={"T_max": full})
    assert found["rotor_speed_max"] == pytest.approx(FULL_SPEED)
    assert "from T_max and k_T" in found.known["rotor_speed_max"].origin
    with pytest.raises(InputError, match="T_max"):
        assemble(result, given={"T_max": 2.0 * full, "rotor_speed_max": FULL_SPEED})


def test_what_is_given_comes_first_and_moves_what_hangs_on_it(result):
    vehicle = assemble(result, given={"k_M": 7e-6})
    assert vehicle["k_M"] == 7e-6
    assert vehicle["moment_ratio"] == pytest.approx(7e-6 / VALUES["k_T"])
    vehicle = assemble(result, given={"moment_ratio": 0.02})
    assert vehicle["k_M"] == pytest.approx(0.02 * VALUES["k_T"])


def test_an_airframes_priors_stand_in_but_do_not_overrule(result):
    airframe = load_airframe("px4-quad-x").with_arm(0.3)
    airframe = airframe.with_prior("Ixy", 1e-3, 1e-4).with_prior("Ixx", 1.0, 1e-4)
    vehicle = assemble(without(result, "Ixy"), airframe)
    assert vehicle["Ixy"] == 1e-3
    assert vehicle.known["Ixy"].origin == "airframe px4-quad-x"
    assert vehicle["Ixx"] == VALUES["Ixx"]


def test_unobservable_values_are_not_used(result):
    lost = estimate("Izz", 0.05, share=0.6, status="unobservable")
    result = replace(result, parameters=result.parameters | {"Izz": lost})
    for target in FORMATS.values():
        with pytest.raises(MissingError, match="Izz"):
            target.write(assemble(result, given=EVERYTHING))


def test_weak_values_are_used_and_named(result):
    rough = estimate("Izz", VALUES["Izz"], share=0.1, status="weak")
    result = replace(result, parameters=result.parameters | {"Izz": rough})
    vehicle = assemble(result, given=EVERYTHING)
    for target in FORMATS.values():
        # A line of a comment, or of the list that stands for one in JSON.
        assert re.search(r'Note: weak: Izz(",)?\n', target.write(vehicle))
        assert "weak: Izz" in target.notes(vehicle)


@pytest.mark.parametrize("target", FORMATS)
def test_a_result_without_a_scale_is_refused(result, target):
    names = [name for name in VALUES if name not in ("cg_x", "cg_y", "moment_ratio")]
    relative = replace(without(result, *names), scale=None)
    with pytest.raises(MissingError, match=r"no scale.*--mass KG"):
        FORMATS[target].write(assemble(relative, given=EVERYTHING))


@pytest.mark.parametrize("target", FORMATS)
def test_an_inertia_that_no_body_has_is_refused(result, target):
    vehicle = assemble(result, given={**EVERYTHING, "Izz": 0.05})
    with pytest.raises(MissingError, match="no rigid body"):
        FORMATS[target].write(vehicle)


def test_what_cannot_be_below_zero_is_zero(result):
    below = Estimate(-1e-4, 2e-4, "N m s", "identified")
    result = replace(result, parameters=result.parameters | {"rotational_damping": below})
    vehicle = assemble(result)
    assert vehicle["rotational_damping"] == 0.0
    assert vehicle.known["rotational_damping"].value == -1e-4


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [("mass", 0.0, "positive"), ("motor_lag", -1.0, "negative"), ("Ixq", 1.0, "known are mass")],
)
def test_values_that_make_no_sense(result, name, value, says):
    with pytest.raises(InputError, match=says):
        assemble(result, given={name: value})


def test_rotors_must_be_known_and_the_same(result):
    bare = replace(result, airframe={})
    with pytest.raises(InputError, match="--airframe"):
        assemble(bare)
    other = load_airframe("px4-quad-x").with_arm(0.3)
    assert assemble(bare, other).rotors == other.rotors
    with pytest.raises(InputError, match="not at the positions of the result"):
        assemble(result, other.with_arm(0.31))
    with pytest.raises(InputError, match=r"4 rotors.* has 6"):
        assemble(result, load_airframe("px4-hexa-x"))


@pytest.mark.parametrize("target", FORMATS)
def test_a_file_says_where_it_comes_from(vehicle, target):
    text = FORMATS[target].write(vehicle)
    assert "Flight: logs/a flight.tlog" in text
    assert "Verdict: identified" in text
    assert "Scale: mass = 1.5 kg" in text
    for name in VALUES:
        assert re.search(rf"^.? +{name} = ", text, re.MULTILINE), name
    assert "Ixx = 0.0165 +- 3.2e-05 kg m^2 (identified)" in text
    assert f"rotor_speed_max = {FULL_SPEED:g} rad/s (by hand)" in text
    assert "Unknown: thrust_curve" in text


@pytest.mark.parametrize("target", FORMATS)
def test_names_cannot_break_a_file(result, target):
    hostile = replace(
        result, source='a--b-->\n</sdf>"""\nimport os\r\n1\t1\tSIH_MASS\t9.0\t9', reasons=("-->",)
    )
    vehicle = assemble(hostile, given=EVERYTHING, name='3 "<&>\n')
    text = FORMATS[target].write(vehicle)
    if text.startswith("#"):
        plain = FORMATS[target].write(assemble(result, given=EVERYTHING, name="x"))
        code = [line for line in text.splitlines() if not line.startswith("#")]
        expected = [line for line in plain.splitlines() if not line.startswith("#")]
        # A section of TOML has the vehicle's name, made harmless.
        assert [line.replace("[_3______]", "[x]") for line in code] == expected
    elif text.startswith("{"):
        assert "3____" in json.loads(text)["_comment"][0]
    else:
        ElementTree.fromstring(text)
        assert "3____" in text
