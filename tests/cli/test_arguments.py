"""Command lines that cannot be used: one line on standard error, exit status 2, no traceback."""

import argparse
import subprocess
import sys
from importlib import resources
from pathlib import Path

import pytest

from gcs_sysid.argument_types import GIVEN, vehicle_address
from gcs_sysid.cli.airframe_choice import airframe_of
from gcs_sysid.cli.commands import build_parser
from gcs_sysid.cli.program import run

ERROR = "gcs-sysid: error: "


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A folder with things that are not what they should be; the tests run in it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.tlog").write_bytes(b"")
    (tmp_path / "text.tlog").write_text("this is no recording\n" * 20)
    (tmp_path / "flight.ulg").write_bytes(b"ULog\x01\x12\x35")
    (tmp_path / "flight.bin").write_bytes(b"\xa3\x95\x80")
    (tmp_path / "folder.tlog").mkdir()
    (tmp_path / "wrong-key.toml").write_text("color = 3\n")
    (tmp_path / "broken.toml").write_text("mass = = 3\n")
    for kind, scale in (("speed", "T_max = 5.0"), ("command", "k_T = 2e-5")):
        table = f'{scale}\nrotor_input = "{kind}"\n'
        rotors = resources.files("gcs_sysid.model") / "airframes" / "px4-quad-x.toml"
        text = rotors.read_text(encoding="utf-8").replace('rotor_input = "auto"\n', table)
        (tmp_path / f"{kind}s.toml").write_text(text)
    (tmp_path / "truth.json").write_text("[1, 2]")
    (tmp_path / "broken.json").write_text("{")
    (tmp_path / "taken.tlog").write_bytes(b"x")
    return tmp_path


PAPER = ("--airframe", "paper")
NOWHERE = "udpin:127.0.0.1:1"
SAMPLE = str(Path(__file__).parents[2] / "logs" / "sample.tlog")

CASES = {
    "missing log": (["analyze", "missing.tlog", *PAPER], "missing.tlog"),
    "empty log": (["analyze", "empty.tlog", *PAPER], "empty.tlog"),
    "no log": (["analyze", "text.tlog", *PAPER], "text.tlog"),
    "folder for a log": (["analyze", "folder.tlog", *PAPER], "folder.tlog"),
    "neither log nor airframe": (["analyze", "missing.tlog"], "missing.tlog"),
    "no such airframe": (["analyze", "a.tlog", "--airframe", "nonesuch"], "'nonesuch'"),
    "missing airframe file": (["analyze", "a.tlog", "--airframe", "no.toml"], "no.toml"),
    "wrong key": (["analyze", "a.tlog", "--airframe", "wrong-key.toml"], "'color'"),
    "broken airframe": (["analyze", "a.tlog", "--airframe", "broken.toml"], "broken.toml"),
    "arm without its deviation": (["analyze", "a.tlog", *PAPER, "--arm", "0.2+-"], "'0.2+-'"),
    "arm below any": (["analyze", SAMPLE, *PAPER, "--arm", "1e-320"], "--arm must lie between"),
    "100 kB of arm": (["analyze", "a.tlog", *PAPER, "--arm", "1" * 100_000], "--arm"),
    "escape in an option": (["analyze", "a.tlog", "--\x1b[31m"], "unrecognized"),
    "one prior twice": (
        ["analyze", "a.tlog", *PAPER, "--prior", "Ixx=1+-.1", "--prior", "Ixx=2+-.1"],
        "--prior: Ixx is given twice",
    ),
    "JSON into nothing": (["analyze", SAMPLE, *PAPER, "--json", ""], "--json: must not be empty"),
    "no name of a log": (["analyze", "", *PAPER], "LOG: must not be empty"),
    "negative baud rate": (["doctor", "--baud", "-1"], "--baud"),
    "mass known to 60 %": (["analyze", "a.tlog", *PAPER, "--mass", "1.5+-60%"], "'60%'"),
    "mass hardly known": (["analyze", "a.tlog", *PAPER, "--mass", "1.5±1"], "more than half"),
    "no scale": (["live", "udp:0", "--airframe", "px4-quad-x"], "--mass"),
    "T_max for speeds": (["analyze", "a.tlog", "--airframe", "speeds.toml"], "T_max"),
    "k_T for commands": (["analyze", "a.tlog", "--airframe", "commands.toml"], "k_T"),
    "end before start": (["analyze", "a.tlog", *PAPER, "--start", "9", "--end", "5"], "--end"),
    "missing truth": (["analyze", "a.tlog", *PAPER, "--truth", "no.json"], "no.json"),
    "truth is a list": (["analyze", "a.tlog", *PAPER, "--truth", "truth.json"], "truth.json"),
    "broken truth": (["analyze", "a.tlog", *PAPER, "--truth", "broken.json"], "broken.json"),
    "bad link": (["live", "nonsense", *PAPER], "'nonsense'"),
    "bad port": (["live", "udpin:0.0.0.0:99999", *PAPER], "99999"),
    "no port": (["live", "udpin:0.0.0.0", *PAPER], "udpin:0.0.0.0"),
    "log for a link": (["live", "flight.tlog", *PAPER], "analyze"),
    "no such device": (["live", "/dev/nonesuch", *PAPER], "/dev/nonesuch"),
    "nobody listens": (["live", "tcp:127.0.0.1:1", *PAPER], "refused"),
    "address elsewhere": (["live", "udpin:192.0.2.1:14550", *PAPER], "192.0.2.1"),
    "broken baseline": (["demo", "--baseline", "broken.json"], "broken.json"),
    "record twice told": (
        ["live", NOWHERE, *PAPER, "--record", "a.tlog", "--no-record"],
        "--no-record",
    ),
    "missing key": (["live", NOWHERE, *PAPER, "--signing-key", "no.key"], "no.key"),
    "empty key": (["live", NOWHERE, *PAPER, "--signing-key", "empty.tlog"], "no signing key"),
    "bad baud": (["live", "/dev/ttyUSB0", *PAPER, "--baud", "0"], "baud"),
    "unknown command": (["fly"], "fly"),
    "unknown option": (["analyze", "a.tlog", "--frobnicate"], "--frobnicate"),
    "no log named": (["analyze"], "LOG"),
    "mass is no number": (["analyze", "a.tlog", *PAPER, "--mass", "heavy"], "'heavy'"),
    "mass is zero": (["analyze", "a.tlog", *PAPER, "--mass", "0"], "0.001"),
    "two scales": (["analyze", "a.tlog", *PAPER, "--mass", "1", "--k-t", "1"], "not allowed"),
    "method": (["analyze", "a.tlog", *PAPER, "--method", "magic"], "'magic'"),
    "vehicle": (["analyze", "a.tlog", *PAPER, "--vehicle", "256"], "'256'"),
    "rate": (["live", NOWHERE, *PAPER, "--rate", "1e9"], "2000"),
    "duration": (["live", NOWHERE, *PAPER, "--duration", "0"], "--duration"),
    "plan without scale": (["plan", "--airframe", "px4-quad-x"], "--mass"),
    "plan by k_T for commands": (
        ["plan", "--airframe", "px4-sih", "--k-t", "1e-5", "--rotor-input", "command"],
        "k_T",
    ),
    "target is no number": (["plan", *PAPER, "--target", "fine"], "'fine'"),
    "tilt": (["plan", *PAPER, "--max-tilt", "80"], "45"),
    "turning": (["live", NOWHERE, *PAPER, "--max-rate", "nan"], "--max-rate"),
    "plan over a file": (["plan", *PAPER, "--json", "truth.json"], "--force"),
    "plan into a folder": (["plan", *PAPER, "--svg", "folder.tlog", "--force"], "folder.tlog"),
    "demo speed": (["demo", "--speed", "3"], "--speed"),
    "replay of nothing": (["replay", "missing.tlog", *PAPER], "missing.tlog"),
    "web without a host": (["live", NOWHERE, *PAPER, "--web", ":8000"], "HOST"),
    "web takes no link": (["live", *PAPER, "--web", NOWHERE], "HOST"),
    "web and headless": (["replay", "a.tlog", *PAPER, "--web", "--headless"], "--headless"),
    "airframe alone": (["airframe"], "ACTION"),
    "no such layout": (["airframe", "new", "--layout", "x"], "'x'"),
    "nowhere to ask": (["airframe", "new", "--arm", "0.2"], "no terminal"),
    "airframe over a file": (
        ["airframe", "new", "--layout", "px4-quad-x", "--arm", "1", "-o", "truth.json"],
        "--force overwrites it",
    ),
    "own layout of one": (["airframe", "new", "--rotor", "cw:0,1", "-o", "x.toml"], "four"),
    "check of nothing": (["airframe", "check", "no.toml"], "no.toml"),
    "doctor of nonsense": (["doctor", "nonsense"], "'nonsense'"),
    "doctor would have to speak": (["doctor", "udpout:1.2.3.4:1"], "answers only to messages"),
    "no such shell": (["completion", "tcsh"], "'tcsh'"),
}


@pytest.mark.slow
@pytest.mark.usefixtures("files")
@pytest.mark.parametrize(("argv", "names"), CASES.values(), ids=CASES.keys())
def test_wrong_usage_gives_one_line(argv, names, refused):
    error = refused(argv)
    assert error.startswith(ERROR)
    assert names in error


def test_recordings_are_never_overwritten(files, refused):
    # A free port, for what comes after the recording is opened.
    error = refused(["live", "udpin:127.0.0.1:45871", *PAPER, "--record", "taken.tlog"])
    assert error.startswith(ERROR + "taken.tlog exists already")
    assert (files / "taken.tlog").read_bytes() == b"x"


OTHERS = ("wrong key", "bad link", "no scale")


@pytest.mark.slow
@pytest.mark.parametrize(
    "case", ["missing log", *(pytest.param(c, marks=pytest.mark.thorough) for c in OTHERS)]
)
def test_the_program_itself(case, files):
    argv, names = CASES[case]
    done = subprocess.run(
        [sys.executable, "-m", "gcs_sysid", *argv], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith(ERROR)
    assert done.stderr.count("\n") == 1
    assert names in done.stderr


@pytest.mark.slow
def test_help_and_version_load_nothing_heavy():
    names = ("analyze", "replay", "inspect", "plan", "export", "compare", "batch", "trend")
    names += ("airframe new", "airframe check", "doctor", "completion")
    code = (
        "import sys\nfrom gcs_sysid.__main__ import main\n"
        "for argument in sys.argv[1:]:\n"
        "    assert not main(argument.split()), argument\n"
        "    heavy = {'numpy', 'scipy', 'textual', 'pymavlink'} & set(sys.modules)\n"
        "    assert not heavy, (argument, heavy)"
    )
    asked = ["--help", "--version", "completion bash", "", *(f"{name} --help" for name in names)]
    done = subprocess.run(
        [sys.executable, "-c", code, *asked], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("usage: gcs-sysid") == 1 + len(names)


@pytest.mark.slow
def test_commands_and_notebooks_load_neither_screen_nor_slow_parts_of_scipy():
    code = (
        "import gcs_sysid, importlib, sys\n"
        "import gcs_sysid.cli.analyze_command\n"
        "assert 'gcs_sysid.report' not in sys.modules\n"  # where none is asked for
        "from gcs_sysid.cli.commands import COMMANDS\n"
        "for command in COMMANDS:\n"
        "    importlib.import_module(f'gcs_sysid.cli.{command.name}_command')\n"
        "gcs_sysid.analyze, gcs_sysid.identify\n"
        "slow = {'textual', 'aiohttp', 'rich', 'scipy.stats', 'scipy.interpolate',"
        " 'scipy.optimize', 'pyarrow', 'distributed'}\n"
        "print(sorted(slow & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("[]\n", "")


def test_a_package_that_is_missing_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr("importlib.import_module", lambda name: __import__("no_such_package"))
    assert run(["doctor"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("gcs-sysid: error: the Python package no_such_package is not installed")
    assert said.count("\n") == 1


def without_help(parser):
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from without_help(command)
        elif not action.help:
            yield parser.prog, action.option_strings or action.dest


def test_every_option_of_every_command_has_help():
    assert list(without_help(build_parser())) == []


def test_the_default_airframe_is_that_of_the_command(capsys):
    for command, said in (
        ("live", "default auto"),
        ("analyze", "default auto"),
        ("demo", "default paper"),
        ("batch", "default: the nearest airframe.toml"),
        ("health", "default: by the vehicle's parameters or type"),
    ):
        assert run([command, "--help"]) == 0
        text = " ".join(capsys.readouterr().out.split())
        assert f"or .toml file ({said}" in text, command


@pytest.mark.parametrize(
    ("text", "address"), [("1", (1, None)), ("1:", (1, None)), ("255:0", (255, 0))]
)
def test_vehicle_address(text, address):
    assert vehicle_address(text) == address


@pytest.mark.parametrize("text", ["", "0", "256", "-1", "a", "1:256", "1:2:3", "1.5"])
def test_no_vehicle_address(text):
    with pytest.raises(argparse.ArgumentTypeError):
        vehicle_address(text)


@pytest.mark.skipif(sys.platform == "win32", reason="says it in other words")
@pytest.mark.parametrize(
    "argv",
    [
        ("inspect", "x" * 3000),
        ("analyze", *PAPER, "x" * 3000 + ".tlog"),
        ("analyze", *PAPER, "a.tlog", "--json", f"{'x' * 3000}/a.json"),
        ("export", "a.json", "--to", "urdf", "-o", "x" * 3000),
        ("batch", *PAPER, "-o", "out", "x" * 3000),
    ],
)
def test_what_the_system_cannot_look_up_is_no_defect_of_the_program(files, capsys, argv):
    assert run(argv) == 2
    said = capsys.readouterr().err
    assert said.startswith(ERROR)
    assert "internal" not in said
    assert "File name too long" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize("sign", ["±", "+-", "+/-", " ± "])
def test_what_is_given_may_have_a_standard_deviation(sign):
    parser = build_parser()
    words = ["analyze", "a.tlog", *PAPER, "--arm", f"0.3{sign}3%", "--mass", f"1.6{sign}0.01"]
    airframe = airframe_of(parser.parse_args(words))
    assert airframe.arm == pytest.approx(0.3)
    assert airframe.uncertainty.arm.of(0.3) == pytest.approx(0.009)
    assert airframe.uncertainty.scale_share("mass", 1.6) == pytest.approx(0.01 / 1.6)
    # Nothing said: as the file has it.
    plain = airframe_of(parser.parse_args(["analyze", "a.tlog", *PAPER, "--mass", "1.6"]))
    assert plain.uncertainty.scale_share("mass", 1.6) == 0.0


@pytest.mark.parametrize(
    ("name", "text", "value", "sigma"),
    [
        ("arm", "110mm", 0.11, None), ("arm", "11 cm", 0.11, None), ("arm", "0.11m", 0.11, None),
        ("arm", "110mm+-2", 0.11, "0.002"), ("arm", "0.11m+-2mm", 0.11, "0.002"),
        ("arm", "110mm+-1%", 0.11, "1%"), ("mass", "700g", 0.7, None),
        ("mass", "1.4kg+-10g", 1.4, "0.01"), ("mass", "1e-1", 0.1, None),
    ],
)  # fmt: skip
def test_lengths_and_masses_may_have_their_unit(name, text, value, sigma):
    given = GIVEN[name](text)
    assert (given, given.sigma) == (value, sigma)


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("arm", "5in", "inches are of propellers"), ("arm", '5"', "from the center to a motor"),
        ("arm", "2kg", "must be in m or cm or mm"), ("mass", "5mm", "must be in kg or g"),
        ("mass", "g", "must be a number"), ("k_T", "3mm", "must be a number"),
    ],
)  # fmt: skip
def test_a_unit_that_cannot_be_is_said(name, text, says):
    with pytest.raises(argparse.ArgumentTypeError, match=says):
        GIVEN[name](text)
