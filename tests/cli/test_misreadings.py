"""What misled new users, each as they met it on the command line (table in docs/result.md)."""

from pathlib import Path

import pytest

from gcs_sysid.cli.program import run

SAMPLE = str(Path(__file__).parents[2] / "logs" / "sample.tlog")


def rows_of(text: str) -> dict[str, list[str]]:
    """Parameter -> the other words of its row."""
    lines = [line.split() for line in text.splitlines() if line and not line.startswith("- ")]
    return {words[0]: words[1:] for words in lines}


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--airframe", "px4-quad-x", "--mass", "1.5"], "give --arm M"),
        (["--airframe", "paper", "--mass", "1500"], "mass is in kg, arm in m"),
    ],
)
def test_a_guessed_arm_and_grams_are_partial_and_say_why(capsys, options, reason):
    assert run(["analyse", SAMPLE, *options]) == 0
    out = capsys.readouterr().out
    assert out.startswith("partial: ")
    assert reason in out
    assert rows_of(out)["Ixx"][-1] == "weak"


def test_zero_has_a_limit_and_no_percentage(capsys):
    assert run(["analyze", SAMPLE, "--airframe", "paper"]) == 0
    rows = rows_of(capsys.readouterr().out)
    assert rows["rotational_damping"][:2] == ["~0", "(<"]
    assert rows["rotor_inertia"][-1] == "zero"
    assert not any(float(r[2]) > 100.0 for r in rows.values() if r[-1] == "identified")


@pytest.mark.parametrize(
    ("argv", "near"),
    [
        (["analize", SAMPLE], "did you mean analyze?"),
        (["analyze", SAMPLE, "--masss", "1"], "did you mean --mass?"),
        (["export", "r.json", "--to", "px4sih", "-o", "x"], "did you mean px4-sih?"),
    ],
)
def test_misspelt_words_are_answered_with_the_nearest(capsys, argv, near):
    assert run(argv) == 2
    error = capsys.readouterr().err
    assert near in error
    assert error.count("\n") == 1
