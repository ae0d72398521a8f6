"""Pictures of rotors: what stands where."""

import pytest

from gcs_sysid.setup_help.airframe_file import (
    ASCII,
    LAYOUTS,
    UNICODE,
    draw,
    layout_rotors,
    legend,
    reversed_spins,
)

QUAD_PLUS = """\
              ^ front
            3 cw
              .
              .
              .
              .
              .
2 ccw . . . . + . . . . 1 ccw
              .
              .
              .
              .
              .
            4 cw"""


def test_a_quad_plus_in_ascii():
    drawn = draw(layout_rotors("px4-quad-plus", 0.25), ASCII)
    assert drawn == QUAD_PLUS
    assert drawn.isascii()
    assert legend(ASCII).isascii()


@pytest.mark.parametrize("name", LAYOUTS)
@pytest.mark.parametrize("pen", [UNICODE, ASCII], ids=["unicode", "ascii"])
def test_every_motor_is_in_the_picture_where_it_is_on_the_vehicle(name, pen):
    rotors = layout_rotors(name, 0.3)
    lines = draw(rotors, pen).splitlines()
    assert len(lines) <= 15
    assert max(map(len, lines)) <= 50
    row = next(i for i, line in enumerate(lines) if pen.center in line)
    column = lines[row].index(pen.center)
    assert lines[0].index(pen.front) == column
    for number, rotor in enumerate(rotors, 1):
        label = f"{number}{pen.ccw if rotor.spin > 0 else pen.cw}"
        (at,) = [(i, line.index(label)) for i, line in enumerate(lines) if label in line]
        assert (row - at[0]) * rotor.x >= 0
        assert (rotor.x > 0.01) == (at[0] < row)
        if abs(rotor.y) > 0.01:
            assert (rotor.y > 0) == (at[1] + len(label) / 2 > column)


def test_coaxial_rotors_stand_one_under_the_other():
    rotors = layout_rotors("px4-quad-x", 0.2)
    drawn = draw(rotors + reversed_spins(rotors), UNICODE)
    assert all(f"{number}" in drawn for number in range(1, 9))
    upper, lower = (line for line in drawn.splitlines() if "1↺" in line or "5↻" in line)
    assert upper.index("1↺") == lower.index("5↻")
