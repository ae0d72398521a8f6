"""Completion scripts, run by the shells that are here."""

import shutil
import subprocess

import pytest

from gcs_sysid.cli.commands import SHELLS, build_parser
from gcs_sysid.cli.completion_command import _actions, script
from gcs_sysid.model.airframe import builtin_names


@pytest.fixture(scope="module")
def scripts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scripts")
    for name in SHELLS:
        (folder / name).write_text(script(name), encoding="utf-8")
    return folder


def shell(name):
    return pytest.mark.skipif(shutil.which(name) is None, reason=f"no {name} here")


def run(*argv, folder):
    done = subprocess.run(argv, capture_output=True, text=True, timeout=60, cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


CASES = [
    (("gcs-sysid", "a"), {"analyze", "airframe"}),
    (("gcs-sysid", "--v"), {"--version"}),
    (("gcs-sysid", "airframe", ""), {"new", "check"}),
    (("gcs-sysid", "airframe", "new", "--la"), {"--layout"}),
    (("gcs-sysid", "live", "COM3", "--airframe", "px4-q"), {"px4-quad-x"}),
    (("gcs-sysid", "live", "COM3", "--airframe", "my"), {"my-quad.toml"}),
    (("gcs-sysid", "live", "COM3", "--li"), {"--listen-only"}),
    (("gcs-sysid", "export", "r.json", "--to", "u"), {"urdf"}),
    (("gcs-sysid", "analyze", "my"), {"my-quad.toml"}),
    (("gcs-sysid", "completion", ""), set(SHELLS)),
]


@shell("bash")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        *CASES,
        (("gcs-sysid", "demo", "--noise", "=", "pa"), {"paper"}),
        (("gcs-sysid", "demo", "--noise", "="), {"mems", "none", "paper", "white"}),
        (("gcs-sysid", "live", "--record", "demo", "udp"), set()),
    ],
)
def test_bash(scripts, words, expected, tmp_path):
    (tmp_path / "my-quad.toml").touch()
    typed = " ".join(f"'{word}'" for word in words)
    out = run(
        *("bash", "--norc", "--noprofile", "-c"),
        f'source "{scripts}/bash"; COMP_WORDS=({typed}); COMP_CWORD={len(words) - 1}; _gcs_sysid; '
        'printf "%s\\n" "${COMPREPLY[@]}"; complete -p gcs-sysid >/dev/null',
        folder=tmp_path,
    )
    assert set(out.split()) == expected


@shell("fish")
@pytest.mark.parametrize(("words", "expected"), CASES)
def test_fish(scripts, words, expected, tmp_path):
    (tmp_path / "my-quad.toml").touch()
    command = f'source "{scripts}/fish"; complete -C "{" ".join(words)}"'
    out = run("fish", "--no-config", "-c", command, folder=tmp_path)
    assert expected <= {line.split("\t")[0] for line in out.splitlines()}


@shell("zsh")
def test_zsh_understands_its_script(scripts, tmp_path):
    run("zsh", "-f", "-n", str(scripts / "zsh"), folder=tmp_path)
    run("zsh", "-f", "-c", f'compdef() {{ :; }}; eval "$(<{scripts}/zsh)"', folder=tmp_path)


@pytest.mark.parametrize("name", SHELLS)
def test_every_option_and_airframe_is_in_the_script(scripts, name):
    text = (scripts / name).read_text(encoding="utf-8")
    for action in _actions(build_parser()):
        for flag in action.option_strings:
            assert (flag if name != "fish" else flag.lstrip("-")) in text
    assert all(airframe in text for airframe in builtin_names())
