"""The questions, answered as a user would, slips included."""

import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import Rotor
from gcs_sysid.setup_help import wizard as say
from gcs_sysid.setup_help.airframe_file import ASCII, layout_rotors, reversed_spins
from gcs_sysid.setup_help.wizard import GivenAnswers, Wizard, given_answers


class Dialogue:
    """Types the answers given, and keeps what was said and asked."""

    def __init__(self, *typed):
        self._typed = list(typed)
        self.seen = ""

    def ask(self, question):
        if not self._typed:
            raise InputError("end of input")
        self.seen += question
        answer = self._typed.pop(0)
        self.seen += f"{answer}\n"
        return answer

    def say(self, text):
        assert all(len(line) <= 80 or "/" in line for line in text.splitlines()), text
        self.seen += f"{text}\n"

    @property
    def over(self):
        return not self._typed


def asked(*typed, given=None):
    dialogue = Dialogue(*typed)
    found, origin = Wizard(dialogue.ask, dialogue.say, ASCII).answers(given or GivenAnswers())
    assert dialogue.over
    return found, f"{dialogue.seen}{origin}"


REST = ("1", "1.5", "", "", "")
"""A mass, no IMU, no prior, no name."""


def test_a_usual_vehicle():
    found, seen = asked("px4-quad-x", "0.25", "", *REST)
    assert found.rotors == layout_rotors("px4-quad-x", 0.25)
    assert found.anchor() == ("mass", 1.5)
    assert (found.imu_position, found.priors, found.name) == (None, {}, "my-vehicle")
    assert "3 cw" in seen
    assert "motor  place" in seen


def test_slips_are_answered_at_once_with_a_word():
    found, seen = asked(
        *("99", "quad", "1"),  # layout
        *("0,25", "far", "-1", "25", "n", "0.25"),  # arm: 25 m is doubted
        *("ccw", "yes"),  # spins
        *("7", "1", "heavy", "1500", "", "1.5"),  # scale: grams are doubted
        *("0.1", "0 0 -0.03"),  # IMU
        *("k_M", "weight=1+-1", "Ixx=-1+-1", "k_M=6e-6+-1e-7", ""),  # priors
        "mine",
    )
    assert found.rotors == layout_rotors("px4-quad-x", 0.25)
    assert found.anchor() == ("mass", 1.5)
    assert found.imu_position == (0.0, 0.0, -0.03)
    assert found.priors == {"k_M": (6e-6, 1e-7)}
    assert found.name == "mine"
    for word in (
        *("from 1 to 14", "decimals with a point", "must be a number, got 'far'", "positive"),
        *("25 m is a long arm", "each ccw or cw"),
        *("from 1 to 4", "got 'heavy'", "not grams", "three lengths", "no prior on"),
        "Ixx must be positive",
    ):
        assert word in " ".join(seen.split()), word


def test_an_arm_of_two_numbers_is_forward_and_sideways_of_a_quad_x():
    found, _ = asked("2", "0.15 0.2", "", *REST)
    assert found.rotors == layout_rotors("ardupilot-quad-x", (0.15, 0.2))
    _, seen = asked("5", "0.15 0.2", "0.2", "", *REST)
    assert "one length in m" in seen


def test_spins():
    usual = layout_rotors("px4-quad-x", 0.25)
    found, seen = asked("1", "0.25", "reversed", *REST)
    assert found.rotors == reversed_spins(usual)
    assert seen.endswith("Spins as given.")
    assert seen.count("motor  place") == 2
    found, seen = asked("1", "0.25", "ccw ccw ccw ccw", "cw, cw, ccw, ccw", *REST)
    assert found.rotors == reversed_spins(usual)
    assert "roll, pitch, yaw and thrust independently" in " ".join(seen.split())


def test_own_positions():
    found, seen = asked(
        *("own", "0.2 0.2 ccw", "here", "", "-0.2,-0.2,ccw", "9 9 cw", "", "0.1 -0.2 cw"),
        *("back", "0.2 -0.2 cw", "cw -0.2 0.2", "", ""),
        *("4", "", "", ""),
    )
    assert found.rotors == tuple(
        Rotor(*r) for r in ((0.2, 0.2, 1), (-0.2, -0.2, 1), (0.2, -0.2, -1), (-0.2, 0.2, -1))
    )
    assert found.anchor() is None
    assert seen.endswith("Custom layout.")
    for word in ("got 'here'", "at least four motors", "12.7279 m is a long arm"):
        assert word in " ".join(seen.split()), word


def test_what_options_have_told_is_not_asked():
    given = GivenAnswers(
        layout="px4-hexa-x", arm=0.4, spin="usual", scale=("k_T", 1e-5), name="six"
    )
    found, seen = asked("", "", given=given)
    assert found.rotors == layout_rotors("px4-hexa-x", 0.4)
    assert (found.anchor(), found.name) == (("k_T", 1e-5), "six")
    assert "Which layout" not in seen


def test_a_new_file_is_one_that_is_not_there(tmp_path):
    (tmp_path / "a.toml").write_text("", encoding="utf-8")
    dialogue = Dialogue(str(tmp_path / "a"), str(tmp_path / "none" / "b"), str(tmp_path / "b"))
    path = Wizard(dialogue.ask, dialogue.say, ASCII).new_file("x.toml")
    assert path == tmp_path / "b.toml"
    seen = " ".join(dialogue.seen.split())
    assert "overwrites it; another name?" in seen
    assert "no such folder as" in seen


@pytest.mark.parametrize("typed", [(), ("1",), ("own", "0.2 0.2 cw"), ("1", "0.2", "", "1")])
def test_answers_that_end_too_early_end_the_wizard(typed):
    with pytest.raises(InputError, match="end of input"):
        asked(*typed)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (GivenAnswers(), "which layout"),
        (
            GivenAnswers(layout="px4-quad-x", arm=0.2, rotors=(Rotor(0, 0, 1),)),
            "leave out --layout",
        ),
        (GivenAnswers(layout="px4-hexa-x", arm=(0.1, 0.2)), "quad X only"),
        (GivenAnswers(layout="px4-quad-x", arm=0.2, spin="cw,cw"), "4 spins"),
    ],
)
def test_options_that_do_not_go_together(given, said):
    with pytest.raises(InputError, match=said):
        given_answers(given)


@pytest.mark.parametrize(
    ("parse", "text"),
    [
        (say.arm_lengths, "1e999"),
        (say.arm_lengths, "nan"),
        (say.arm_lengths, ""),
        (say.arm_lengths, "0.1 0.2 0.3"),
        (say.arm_lengths, "250"),
        (say.rotor, "0.1 0.2"),
        (say.rotor, "0.1 0.2 cw ccw"),
        (say.rotor, "200 0 cw"),
        (say.imu_position, "1 2"),
        (say.imu_position, "0 0 300"),
        (say.plain_name, " "),
        (say.plain_name, "a\x07"),
    ],
)
def test_answers_that_make_no_sense(parse, text):
    with pytest.raises(InputError):
        parse(text)
