"""Airframe files: what is read, and the one line for each thing that is wrong."""

import dataclasses
import math
from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import (
    ANCHORS,
    builtin_names,
    is_evenly_canted,
    load_airframe,
    parse_airframe,
    read_airframe_table,
)

ROTORS = "".join(
    f'[[rotor]]\nx = {x}\ny = {y}\nspin = "{spin}"\n'
    for x, y, spin in ((0.2, 0.3, "ccw"), (-0.2, -0.3, "CCW"), (0.2, -0.3, "cw"), (-0.2, 0.3, "cw"))
)


@pytest.fixture
def write(tmp_path):
    """Writes an airframe file; gives its path."""

    def write(text):
        path = tmp_path / "quad.toml"
        path.write_text(text)
        return str(path)

    return write


@pytest.mark.parametrize("name", builtin_names())
def test_builtin_airframes_load(name):
    airframe = load_airframe(name)
    x, y, spin = airframe.geometry
    assert airframe.name == name
    assert len(airframe.rotors) >= 4
    # Symmetric about the center, with as many rotors turning either way.
    np.testing.assert_allclose([x.sum(), y.sum(), spin.sum()], 0.0, atol=1e-12)
    assert airframe.arm == pytest.approx(np.hypot(x, y).mean())


def test_paper_airframe_is_table_1():
    airframe = load_airframe("paper")
    assert airframe.anchor() == ("mass", 1.5)
    # Rows of MODEL.md's table by PX4 motor number: front right, rear left, front left, rear right.
    expected = [(0.25, 0.25, 1), (-0.25, -0.25, 1), (0.25, -0.25, -1), (-0.25, 0.25, -1)]
    assert [(r.x, r.y, r.spin) for r in airframe.rotors] == expected


def test_a_full_file_is_read(write):
    path = write(
        'name = "mine"\nmass = 2\nrotor_input = "command"\n'
        "[command]\nmin = 0\nmax = 1\nthrust_curve = 0.3\n" + ROTORS
    )
    airframe = load_airframe(path)
    assert airframe.name == "mine"
    assert airframe.rotor_input == "command"
    assert dataclasses.astuple(airframe.command) == (0.0, 1.0, 0.3, True)
    assert airframe.anchor() == ("mass", 2.0)
    assert airframe.rotors[1] == (airframe.rotors[0].__class__(-0.2, -0.3, 1))


def test_defaults_of_a_minimal_file(write):
    airframe = load_airframe(write(ROTORS))
    assert airframe.name == "quad"
    assert airframe.rotor_input == "auto"
    assert dataclasses.astuple(airframe.command) == (1000.0, 2000.0, None, False)
    assert airframe.anchor() is None


def test_the_imus_place_counts_from_the_cg_where_a_prior_tells_that(write):
    text = ROTORS + "[imu]\nposition = [0.05, -0.02, -0.03]\n"
    assert load_airframe(write(ROTORS)).imu_arm is None
    assert load_airframe(write(text)).imu_arm == (0.05, -0.02, -0.03)
    airframe = load_airframe(write(text + "[prior]\ncg_x = [0.01, 0.002]\n"))
    assert airframe.imu_arm == pytest.approx((0.04, -0.02, -0.03))


@pytest.mark.parametrize("wrong", ["1.0", "[0.1, 0.2]", '[0.1, "a", 0.2]', "[0.0, 200.0, 0.0]"])
def test_a_place_of_the_imu_that_is_none_is_refused(write, wrong):
    with pytest.raises(InputError, match=r"\[imu\] position"):
        load_airframe(write(f"{ROTORS}[imu]\nposition = {wrong}\n"))


def test_the_emulators_table_is_dropped_unread(write):
    truth = "[simulation]\nIxx = 'no number'\nwhatever = [1, 2]\n"
    with_it, without = load_airframe(write(ROTORS + truth)), load_airframe(write(ROTORS))
    assert with_it == without
    table, where = read_airframe_table(write(ROTORS + truth))
    assert "simulation" in table
    assert parse_airframe(table, where) == without


WRONG = {
    "unknown key": ("color = 3\n" + ROTORS, "'color'"),
    "misspelt anchor": ("k_t = 1e-4\n" + ROTORS, "'k_t'"),
    "unknown command key": (ROTORS + "[command]\ncurve = 1\n", "'curve'"),
    "unknown rotor key": (ROTORS + "z = 1\n", "'z'"),
    "mass is text": ("mass = 'heavy'\n" + ROTORS, "mass"),
    "mass is negative": ("mass = -1\n" + ROTORS, "mass"),
    "mass is zero": ("mass = 0.0\n" + ROTORS, "mass"),
    "mass is nan": ("mass = nan\n" + ROTORS, "mass"),
    "mass is a bool": ("mass = true\n" + ROTORS, "mass"),
    "mass is beyond floats": ("mass = 1" + "0" * 400 + "\n" + ROTORS, "mass"),
    "k_T is infinite": ("k_T = inf\n" + ROTORS, "k_T"),
    "T_max is text": ("T_max = '5'\n" + ROTORS, "T_max"),
    "two anchors": ("mass = 1\nk_T = 1e-4\n" + ROTORS, "mass and k_T"),
    "rotor_input": ("rotor_input = 'rpm'\n" + ROTORS, "rotor_input"),
    "poles": ("motor_poles = 13\n" + ROTORS, "motor_poles must be even"),
    "name is a number": ("name = 5\n" + ROTORS, "name"),
    "no rotors": ("mass = 1\n", "[[rotor]]"),
    "three rotors": (ROTORS.rsplit("[[rotor]]", 1)[0], "[[rotor]]"),
    "too many rotors": (ROTORS * 9, "36 rotors"),
    "rotor is a number": ("rotor = [1, 2, 3, 4]\n", "number 1"),
    "rotor is a table": ("[rotor]\nx = 1\n", "[[rotor]]"),
    "x missing": (ROTORS.replace("x = -0.2\n", "", 1), "number 2: x"),
    "spin missing": (ROTORS.replace('spin = "cw"\n', "", 1), "number 3: spin"),
    "x is text": (ROTORS.replace("x = 0.2", "x = 'a'", 1), "number 1: x"),
    "y is infinite": (ROTORS.replace("y = 0.3", "y = inf", 1), "number 1: y"),
    "y in mm": (ROTORS.replace("y = 0.3", "y = 300", 1), "number 1: x and y are in meters"),
    "spin is a number": (ROTORS.replace('"ccw"', "1", 1), "number 1: spin"),
    "all spins alike": (ROTORS.replace('"cw"', '"ccw"'), "spins"),
    "all on one line": (ROTORS.replace("y = -0.3", "y = 0").replace("y = 0.3", "y = 0"), "roll"),
    "all in one place": (
        ROTORS.replace("-0.", "0.").replace("x = 0.2", "x = 0").replace("y = 0.3", "y = 0"),
        "positions",
    ),
    "command is a number": ("command = 3\n" + ROTORS, "[command]"),
    "command range": (ROTORS + "[command]\nmin = 2000\nmax = 1000\n", "[command]: max"),
    "command min": (ROTORS + "[command]\nmin = 'low'\n", "[command] min"),
    "thrust_curve": (ROTORS + "[command]\nthrust_curve = 1.5\n", "thrust_curve"),
    "axis is a number": (ROTORS.replace('"ccw"', '"ccw"\naxis = 1', 1), "number 1: axis"),
    "axis points down": (ROTORS.replace('"ccw"', '"ccw"\naxis = [0, 0, 1]', 1), "number 1: axis"),
    "axis is zero": (ROTORS.replace('"ccw"', '"ccw"\naxis = [0, 0, 0]', 1), "number 1: axis"),
    "one rotor canted": (ROTORS.replace('"ccw"', '"ccw"\naxis = [0, 0.1, -1]', 1), "canted"),
    "not TOML": ("mass == 1\n" + ROTORS, "TOML"),
}


@pytest.mark.parametrize(("text", "names"), WRONG.values(), ids=WRONG.keys())
def test_what_is_wrong_gives_one_line_with_file_and_key(write, text, names):
    path = write(text)
    with pytest.raises(InputError) as error:
        load_airframe(path)
    message = str(error.value)
    assert "\n" not in message
    assert path in message
    assert names in message


def canted(airframe, degrees):
    """About the arms, thrust helping the drag torque."""
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    sides = [r.spin * sine / np.hypot(r.x, r.y) for r in airframe.rotors]
    return tuple(
        replace(r, axis=(-s * r.y, s * r.x, -cosine))
        for r, s in zip(airframe.rotors, sides, strict=True)
    )


def test_canted_rotors_are_read_and_scale_with_the_arm(write):
    upright = load_airframe(write(ROTORS))
    assert upright.cant == 0.0
    axes = [[float(n) for n in r.axis] for r in canted(upright, 4.0)]
    parts = ROTORS.split("[[rotor]]")
    text = parts[0] + "".join(
        f"[[rotor]]\naxis = {axis}{part}" for axis, part in zip(axes, parts[1:], strict=True)
    )
    airframe = load_airframe(write(text))
    # r x F over the thrust along z: the arm times tan(4 degrees), whatever the spin.
    assert airframe.cant == pytest.approx(airframe.arm * np.tan(np.radians(4.0)))
    assert airframe.with_arm(2.0 * airframe.arm).cant == pytest.approx(2.0 * airframe.cant)
    table = {"name": "canted", "rotor": airframe.as_json()["rotors"]}
    assert parse_airframe(table, "its JSON").rotors == airframe.rotors


def test_rotors_canted_outward_add_no_yaw(write):
    airframe = load_airframe(write(ROTORS))
    outward = tuple(replace(r, axis=(0.1 * r.x, 0.1 * r.y, -1.0)) for r in airframe.rotors)
    assert is_evenly_canted(outward)
    assert replace(airframe, rotors=outward).cant == pytest.approx(0.0, abs=1e-12)


def test_a_name_that_is_none_lists_the_builtin_ones():
    with pytest.raises(InputError, match="no airframe 'nonesuch'") as error:
        load_airframe("nonesuch")
    assert all(name in str(error.value) for name in builtin_names())


def test_unreadable_files(tmp_path):
    with pytest.raises(InputError, match=r"missing\.toml: cannot read"):
        load_airframe(str(tmp_path / "missing.toml"))
    with pytest.raises(InputError, match="cannot read"):
        load_airframe(str(tmp_path))
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not UTF-8"):
        load_airframe(str(binary))


def test_a_key_of_ten_thousand_parts_is_refused_at_once(tmp_path):
    """For 40 kB of one tomllib needs 18 s."""
    path = tmp_path / "quad.toml"
    path.write_text("a." * 20_000 + "a = 1")
    with pytest.raises(
        InputError, match=r"quad\.toml: not an airframe file: a line with more than 1000 dots"
    ):
        load_airframe(str(path))


@pytest.mark.parametrize("name", ANCHORS)
def test_with_anchor_leaves_that_one_alone_in_force(name):
    airframe = load_airframe("paper").with_anchor(name, 3.0)
    assert airframe.anchor() == (name, 3.0)
    assert [getattr(airframe, other) for other in ANCHORS if other != name] == [None, None]


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_with_anchor_and_arm_want_positive_numbers(value):
    airframe = load_airframe("paper")
    with pytest.raises(InputError, match="mass must be a positive number"):
        airframe.with_anchor("mass", value)
    with pytest.raises(InputError, match="--arm must lie between"):
        airframe.with_arm(value)


def test_with_arm_scales_the_layout_and_keeps_the_rest():
    before = load_airframe("paper")
    after = before.with_arm(0.1)
    assert after.arm == pytest.approx(0.1, rel=1e-14)
    np.testing.assert_allclose(after.geometry[:2], before.geometry[:2] * 0.1 / before.arm)
    np.testing.assert_array_equal(after.geometry[2], before.geometry[2])
    assert dataclasses.replace(after, rotors=before.rotors) == before
