"""Completion scripts, run by the shells that are here."""

import argparse
import shutil
import subprocess

import pytest

from gcs_sysid.cli.completion_command import _airframes
from gcs_sysid.cli.program import build_parser
from gcs_sysid.model.airframe import builtin_names
from gcs_sysid.setup_help.shell_completion import commands_of, script

ROOT = commands_of(build_parser(), _airframes())


def shell(name):
    return pytest.mark.skipif(shutil.which(name) is None, reason=f"no {name} here")


def run(*argv):
    done = subprocess.run(argv, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


CASES = [
    (("gcs-sysid", "a"), {"analyze", "airframe"}),
    (("gcs-sysid", "--v"), {"--version"}),
    (("gcs-sysid", "airframe", ""), {"new", "check"}),
    (("gcs-sysid", "airframe", "new", "--la"), {"--layout"}),
    (("gcs-sysid", "live", "COM3", "--airframe", "px4-q"), {"px4-quad-x"}),
    (("gcs-sysid", "live", "COM3", "--li"), {"--listen-only"}),
    (("gcs-sysid", "export", "r.json", "--to", "u"), {"urdf"}),
    (("gcs-sysid", "completion", ""), {"bash", "zsh", "fish"}),
]


@shell("bash")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        *CASES,
        (("gcs-sysid", "demo", "--noise", "=", "pa"), {"paper"}),
        (("gcs-sysid", "analyze", "my"), set()),  # readline completes the file
        (("gcs-sysid", "live", "--record", "demo", ""), set()),
    ],
)
def test_bash(words, expected, tmp_path):
    source = tmp_path / "completion"
    source.write_text(script("bash", "gcs-sysid", ROOT), encoding="utf-8")
    typed = " ".join(f"'{word}'" for word in words)
    out = run(
        *("bash", "--norc", "--noprofile", "-c"),
        f'source "{source}"; COMP_WORDS=({typed}); COMP_CWORD={len(words) - 1}; _gcs_sysid; '
        'printf "%s\\n" "${COMPREPLY[@]}"; complete -p gcs-sysid >/dev/null',
    )
    assert set(out.split()) == expected


@shell("fish")
@pytest.mark.parametrize(("words", "expected"), CASES)
def test_fish(words, expected, tmp_path):
    source = tmp_path / "completion"
    source.write_text(script("fish", "gcs-sysid", ROOT), encoding="utf-8")
    out = run("fish", "--no-config", "-c", f'source "{source}"; complete -C "{" ".join(words)}"')
    assert expected <= {line.split("\t")[0] for line in out.splitlines()}


@shell("zsh")
def test_zsh_understands_its_script(tmp_path):
    source = tmp_path / "completion"
    source.write_text(script("zsh", "gcs-sysid", ROOT), encoding="utf-8")
    run("zsh", "-f", "-n", str(source))


@pytest.mark.parametrize("name", ["bash", "zsh", "fish"])
def test_every_command_and_option_is_in_the_script(name):
    text = script(name, "gcs-sysid", ROOT)
    for command in ROOT.walk():
        assert all(word in text for word in command.words)
        for option in command.options:
            for flag in option.flags:
                assert (flag if name != "fish" else flag.lstrip("-")) in text


def test_help_with_signs_of_the_shell_is_quoted():
    parser = argparse.ArgumentParser()
    below = parser.add_subparsers().add_parser("do", help="what's `this`")
    below.add_argument("--odd", metavar="X", help="it's [50 %%] of \\ $(all): `x` %(default)s")
    root = commands_of(parser, [])
    assert r"it'\''s \[50 %\] of \\ $(all)\: `x`" in script("zsh", "p", root)
    assert r"it\'s [50 %] of \\ $(all): `x`" in script("fish", "p", root)
    for name in ("bash", "fish"):
        if shutil.which(name):
            subprocess.run([name, "-n", "-c", script(name, "p", root)], check=True, timeout=60)


def test_airframes_are_the_built_in_ones():
    assert _airframes() == builtin_names()
