"""The command line: what it refuses, and how."""

import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest

from gcs_sysid import __version__
from sim_bridge.choices import Kind
from sim_bridge.cli import main, make_parser
from sim_bridge.line_faults import KINDS as FAULTS
from sim_bridge.line_faults import LineFaults
from sim_bridge.physics import KINDS as EFFECTS
from sim_bridge.physics import Physics
from sim_bridge.sensor_faults import KINDS, SensorFaults


def run(options: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    try:
        status = main(options.split())
    except SystemExit as exit_:
        status = int(exit_.code or 0)
    out, err = capsys.readouterr()
    return status, out, err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--mission nosuch.json", "nosuch.json: cannot read the plan"),
        ("--airframe nope", "no airframe 'nope'"),
        ("--airframe nope.toml", "cannot read the airframe file"),
        ("--rate 0", "--rate: must be positive"),
        ("--rate 1001", "at most 1000 Hz"),
        ("--speed fast", "--speed: must be a number"),
        ("--speed -1", "--speed: must lie between 0.001 and 1e+06 times real time"),
        ("--duration nan", "--duration: must be a number"),
        ("--seed -1", "--seed: must be a whole number"),
        ("--mass-step 3", "write T:FACTOR"),
        ("--mass-step 3:0", "must lie between 0.01 and 100 times the mass"),
        ("--arm 0", "--arm: must be positive"),
        ("--connect udpout:14550", "HOST:PORT is missing or wrong"),
        ("--connect http://x:1", "cannot understand --connect"),
        ("--connect /dev/ttyNOSUCH", "cannot open serial port"),
        ("--connect udpin:203.0.113.1:14550", "cannot listen on UDP"),
        ("--tlog /nosuch/f.tlog", "cannot write /nosuch/f.tlog"),
        ("--trap rpm-purple", "no trap 'rpm-purple'; there are rpm-zero,"),
        ("--trap rpm-zero=1", "rpm-zero takes no value"),
        ("--trap rpm-dead=0", "rpm-dead: must be a whole number 1..32"),
        ("--trap skips=1.5", "skips: must be a share from 0 to 1"),
        ("--trap rotor-late=2000", "rotor-late: must be 0 to 1000 ms"),
        ("--trap clock-drift=nan", "clock-drift: must be -100000 to 100000 ppm"),
        ("--trap reboot", "write reboot=S"),
        ("--trap reboot=1e308", "reboot: must be at most 1e+07 s"),
        ("--trap accelerometer-bias=1e308", "must lie between 0 and 1000 m/s^2"),
        (
            "--mission hover --rate 20 --mass-step 0.1:0.01 --tlog X",
            "the vehicle is out of control",
        ),
        ("--trap never-sent=NO_SUCH", "no message 'NO_SUCH'"),
        ("--trap imu-nan=5", "imu-nan: write FROM:S or FROM:S:EVERY"),
        ("--trap esc-silent=2", "esc-silent: write MOTOR:FROM"),
        ("--trap clock-jump", "write clock-jump=FROM:S"),
        ("--fault lossy", "no fault 'lossy'; there are loss,"),
        ("--fault loss=2", "loss: must be a share from 0 to 1"),
        ("--fault bursts=0.95", "bursts: a share to 0.9"),
        ("--fault stall=NO_SUCH:1:2", "stall: no message 'NO_SUCH'"),
        ("--fault silence=1:0", "silence: must be positive"),
        ("--fault flood=1e9", "flood: must be 0 to 200000 a second"),
        ("--fault loss --play X", "--play and --fault exclude each other"),
        ("--param INS_GYRO_FILTER", "write NAME=VALUE"),
        ("--param NO_SUCH=1", "px4 here has no 'NO_SUCH'"),
        ("--mavlink 3", "invalid choice: 3"),
        ("--signing-key /nosuch/key", "/nosuch/key: cannot read"),
        ("--signing-key K", "is no signing key"),
        ("--signing-key K --mavlink 1", "version 1 has no signatures"),
        ("--physics rotor-dragg=1", "no effect 'rotor-dragg'; there are rotor-drag"),
        ("--physics rotor-drag=-1", "rotor-drag: must lie between 0 and 20 1/s"),
        ("--physics damping=1:2", "write P:Q:R, got '1:2'"),
        ("--physics weakening=0:3:0.1", "must be a motor's number from 1"),
        ("--frobnicate", "unrecognized arguments"),
    ],
)
def test_bad_input_gets_one_line_and_status_2(
    options: str, words: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    key = tmp_path / "key"
    key.write_text("0123")
    words_given = {"X": str(tmp_path / "x.tlog"), "K": str(key)}
    status, out, err = run(" ".join(words_given.get(w, w) for w in options.split()), capsys)
    assert status == 2
    assert out == ""
    assert words in err
    assert err.startswith("sim-bridge: error: ")
    assert err.count("\n") == 1


def test_version_and_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--version", capsys) == (0, f"sim-bridge {__version__}\n", "")
    status, out, _ = run("--help", capsys)
    assert status == 0
    for action in make_parser()._actions:
        assert (action.option_strings or [action.metavar])[-1] in out
        assert action.help, f"{action.option_strings} has no help"


def test_a_flight_to_a_file_prints_nothing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "f.tlog"
    assert run(f"--tlog {path} --duration 0.5 --speed=max", capsys) == (0, "", "")
    assert path.stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.parametrize("end", ["over", pytest.param("closed", marks=pytest.mark.thorough)])
def test_it_ends_cleanly_whether_standard_input_closes_or_not(end: str, tmp_path: Path) -> None:
    seconds = {"over": "0.1", "closed": "600"}[end]
    words = [f"--tlog={tmp_path / 'f.tlog'}", f"--duration={seconds}", "--speed=1"]
    command = [sys.executable, "-m", "sim_bridge", *words, "--until-stdin-closes"]
    pipes = {"stdin": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **pipes) as program:  # type: ignore[call-overload]
        if end == "closed":
            program.stdin.close()
        assert program.wait(60.0) == 0
        assert program.stderr.read() == b""


def test_an_existing_file_is_replaced_by_force_alone(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "f.tlog"
    path.write_bytes(b"x" * 1_000_000)
    status, out, err = run(f"--tlog {path} --duration 0.1", capsys)
    assert (status, out, err) == (2, "", f"sim-bridge: error: {path} exists; --force replaces it\n")
    assert path.stat().st_size == 1_000_000
    assert run(f"--tlog {path} --duration 0.1 --force", capsys) == (0, "", "")
    assert path.stat().st_size < 100_000


@pytest.mark.parametrize(
    ("word", "kinds", "chosen"),
    [("traps", KINDS, SensorFaults), ("faults", FAULTS, LineFaults), ("effects", EFFECTS, Physics)],
)
def test_help_tells_of_every_trap_fault_and_effect(
    word: str, kinds: dict[str, Kind], chosen: type, capsys: pytest.CaptureFixture[str]
) -> None:
    _, out, _ = run("--help", capsys)
    lines = out[out.index(f"{word} (") :].split("\n\n")[0].splitlines()[1:]
    names = [line.split()[0].split("[")[0].split("=")[0] for line in lines]
    assert [name for name in names if name != "all"] == list(kinds)
    assert {field.name for field in fields(chosen)} == {name.replace("-", "_") for name in kinds}
