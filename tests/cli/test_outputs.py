"""Every output option where nothing can be written, nobody reads, or the terminal is poor.

What cannot be delivered is one line and a status; what can be is delivered all the same.
"""

import argparse
import contextlib
import io
import json
import os
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from gcs_sysid.cli.commands import build_parser
from gcs_sysid.cli.program import run
from sim_bridge.cli import make_parser

pytestmark = [
    pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full here")
]

READ = {"truth", "signing_key", "airframe", "baseline"}
"""Options with a FILE that is read."""
READ_BY_EMULATOR = {"airframe", "gains", "signing_key", "log"}
FLIGHT = ("--airframe", "paper", "--headless", "--speed", "max", "--duration", "12")


class Case(NamedTuple):
    """A command with one of its output options.

    Attributes:
        argv: the command; `{flight}`, `{a}`, `{b}`, `{logs}`, `{fleet}` and `{out}` are filled in.
        suffix: of the output; empty: a folder; None: there is none.
        prints: what standard output shows besides, where the option names a file.
        dash: whether `-` is standard output.
        seconds: whether it takes that long.
        program: module that is run.
    """

    argv: tuple[str, ...]
    suffix: str | None
    prints: str = ""
    dash: bool = True
    seconds: bool = True
    program: str = "gcs_sysid"


EMULATED = ("--airframe", "paper", "--speed", "max", "--duration", "2", "--force")
ON_LOG = ("{flight}", "--airframe", "paper")
TUNED = ("{a}", "--set", "motor_lag=0.03", "--set", "rotor_speed_max=230", "--draws", "3")
CASES = {
    ("analyze", "json"): Case(("analyze", *ON_LOG, "--json", "{out}"), ".json", "Ixx"),
    ("analyze", "report"): Case(
        ("analyze", *ON_LOG, "--report", "{out}"), ".html", "Ixx", dash=False
    ),
    ("replay", "json"): Case(
        ("replay", *ON_LOG, "--headless", "--speed", "max", "--json", "{out}"), ".jsonl", "Ixx"
    ),
    ("demo", "json"): Case(("demo", *FLIGHT, "--json", "{out}"), ".jsonl", "Ixx"),
    ("demo", "record"): Case(("demo", *FLIGHT, "--record", "{out}"), ".tlog", "Ixx", dash=False),
    ("inspect", "json"): Case(("inspect", "{flight}", "--json", "{out}"), ".json", "HIGHRES_IMU"),
    ("check", "json"): Case(("check", *ON_LOG, "--json", "{out}"), ".json", "CG"),
    ("health", "json"): Case(("health", *ON_LOG, "--json", "{out}"), ".json", "CG"),
    ("health", "params"): Case(
        ("health", *ON_LOG, "--params", "{out}"), ".param", "CG", dash=False
    ),
    ("params", "json"): Case(("params", *ON_LOG, "--json", "{out}"), ".json", "nothing is sent"),
    ("params", "output"): Case(
        ("params", *ON_LOG, "-o", "{out}"), ".param", "nothing is sent", dash=False
    ),
    ("health", "picture"): Case(
        ("health", *ON_LOG, "--picture", "{out}"), ".svg", "CG", dash=False
    ),
    ("plan", "json"): Case(("plan", "--airframe", "paper", "--json", "{out}"), ".json", "Ixx"),
    ("plan", "svg"): Case(("plan", "--airframe", "paper", "--svg", "{out}"), ".svg", "Ixx"),
    ("compare", "json"): Case(
        ("compare", "{a}", "{b}", "--json", "{out}"), ".json", "Ixx", seconds=False
    ),
    ("export", "output"): Case(
        ("export", "--to", "urdf", "{a}", "-o", "{out}"), ".urdf"
    ),
    ("export", "signals"): Case(
        ("export", *ON_LOG, "--signals", "{out}"), ".csv", dash=False
    ),
    ("twin", "json"): Case(("twin", "{a}", "{flight}", "--json", "{out}"), ".json", "ahead"),
    ("twin", "picture"): Case(
        ("twin", "{a}", "{flight}", "--picture", "{out}"), ".svg", "ahead", dash=False
    ),
    ("tune", "json"): Case(("tune", *TUNED, "--json", "{out}"), ".json", "MC_ROLLRATE_P"),
    ("tune", "output"): Case(
        ("tune", *TUNED, "--to", "px4-params", "-o", "{out}"), ".params", "MC_ROLLRATE_P"
    ),
    ("tune", "bode"): Case(("tune", *TUNED, "--bode", "{out}"), ".svg", "MC_ROLLRATE_P"),
    ("airframe new", "output"): Case(
        ("airframe", "new", "--layout", "px4-quad-x", "--arm", "0.2", "-o", "{out}"),
        ".toml",
    ),
    ("batch", "output"): Case(("batch", "{logs}", "--airframe", "paper", "-o", "{out}"), "",
        dash=False),
    ("trend", "output"): Case(("trend", "{fleet}", "-o", "{out}"), ".html", dash=False),
    ("sim-bridge", "tlog"): Case(
        (*EMULATED, "--tlog", "{out}"), ".tlog", dash=False, program="sim_bridge"
    ),
    ("sim-bridge", "truth"): Case(
        (*EMULATED, "--truth", "{out}"), ".json", dash=False, program="sim_bridge"
    ),
}  # fmt: skip
PRINTING = {
    ("", "prints"): Case((), None, "doctor", dash=False, seconds=False),
    ("airframe check", "prints"): Case(("airframe", "check", "paper"), None, "rotors", dash=False),
    ("completion", "prints"): Case(("completion", "bash"), None, "gcs-sysid", dash=False),
    ("doctor", "prints"): Case(("doctor", "--duration", "0.1"), None, "packages", dash=False),
}
"""Commands that write nothing else."""
SERVING = {"web"}
"""Commands that print an address; their pages are tested in a browser."""
LIVE = {("live", "json"), ("live", "record"), ("fetch", "output")}
"""Those that need a vehicle: the same code as of `demo`, and tests/telemetry/test_remote_logs."""


def commands(parser, name=()):
    """All that can be run, by name."""
    parts = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    if not all(part.required for part in parts) or not parts:
        yield " ".join(name)
    for part in parts:
        for word, under in part.choices.items():
            yield from commands(under, (*name, word))


def output_options(parser, name=(), read=READ):
    """(command, option) of all that name a file or folder to be written."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for word, part in action.choices.items():
                yield from output_options(part, (*name, word), read)
        elif (
            action.option_strings
            and action.dest not in read
            and str(action.metavar).startswith(("FILE", "DIR"))
        ):
            yield " ".join(name), action.dest


def test_every_output_option_is_in_the_sweep():
    emulator = output_options(make_parser(), ("sim-bridge",), READ_BY_EMULATOR)
    assert {*output_options(build_parser()), *emulator} == set(CASES) | LIVE


def test_every_command_is_in_the_sweep():
    known = {name for name, _ in {*CASES, *LIVE, *PRINTING}} - {"sim-bridge"}
    assert set(commands(build_parser())) == known | SERVING


@pytest.fixture(scope="session")
def places(fly, tmp_path_factory):
    folder = tmp_path_factory.mktemp("outputs")
    flight = folder / "flight.tlog"
    mission = ("--mission", "all-axes", "--noise", "paper", "--sigma", "0.002", "--rate", "20")
    shutil.copy(fly(*mission, "--duration", "16", "--seed", "1").tlog, flight)
    (folder / "logs").mkdir()
    shutil.copy(flight, folder / "logs")
    found = {"flight": flight, "logs": folder / "logs", "fleet": folder / "fleet"}
    found |= {name: folder / f"{name}.json" for name in "ab"}
    assert run(["analyze", str(flight), "--airframe", "paper", "--json", str(found["a"])]) == 0
    shutil.copy(found["a"], found["b"])
    return found


def filled_in(case, places, out):
    """Words of a command; the batch that one of them reads is run when it is first needed."""
    if "{fleet}" in case.argv and not places["fleet"].exists():
        batch = ["batch", str(places["logs"]), "--airframe", "paper", "-o", str(places["fleet"])]
        with contextlib.redirect_stderr(io.StringIO()):
            assert run(batch) == 0
    return [word.format(out=out, **places) for word in case.argv]


@pytest.fixture
def call(places, tmp_path):
    """Runs a case with its output at a place; (status, standard output, standard error)."""

    def call(case, out, environment=None, **streams):
        words = filled_in(case, places, out)
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **streams}
        done = subprocess.run(
            [sys.executable, "-m", case.program, *words],
            stdin=subprocess.DEVNULL, cwd=tmp_path, timeout=240, check=False,
            env={**os.environ, **(environment or {})}, **streams,
        )  # fmt: skip
        said = [(stream or b"").decode("utf-8", "replace") for stream in (done.stdout, done.stderr)]
        assert "Traceback" not in said[1]
        assert "internal error" not in said[1]
        assert "Exception ignored" not in said[1]
        return done.returncode, *said

    return call


def check_refusal(status, err):
    assert status not in (0, 120)
    assert status > 0
    assert err.count("error: ") == 1, err
    (line,) = (line for line in err.splitlines() if "error: " in line)
    assert len(line) < 400


def check_written(case, path):
    if case.suffix is None:
        return
    if not case.suffix:
        assert (path / "fleet.parquet").stat().st_size > 1000
        return
    data = path.read_bytes()
    assert len(data) > 100
    if case.suffix == ".json":
        json.loads(data)
    elif case.suffix == ".jsonl":
        assert [json.loads(line) for line in data.splitlines()][-1]["verdict"]


def thorough(which, but=()):
    """Cases as parameters; those that take seconds, but for some, are in `make test-all` alone."""
    return [
        pytest.param(
            case, id=" ".join(name).strip(),
            marks=[pytest.mark.thorough] if case.seconds and name not in but else [],
        )
        for name, case in {**CASES, **PRINTING}.items()
        if which(case)
    ]  # fmt: skip


QUICKEST = {("export", "signals"), ("sim-bridge", "tlog")}
"""A file that is put together, and one that grows."""


def writes(case):
    return case.suffix is not None


def limited():
    import resource

    resource.setrlimit(resource.RLIMIT_FSIZE, (64, 64))  # what semaphores take


@pytest.mark.slow
@pytest.mark.parametrize("case", thorough(writes, QUICKEST))
def test_a_full_disk_takes_a_file_and_not_the_numbers(call, tmp_path, case):
    if case.dash or case.suffix == ".tlog":
        status, out, err = call(case, "/dev/full")
    else:  # no file grows
        path = tmp_path / f"out{case.suffix}"
        # Python 3.11 would leave bytecode cut short, for all processes to come.
        status, out, err = call(case, path, {"PYTHONDONTWRITEBYTECODE": "1"}, preexec_fn=limited)
    check_refusal(status, err)
    if case.suffix != ".tlog":  # which is refused before the flight
        assert case.prints in out


@pytest.mark.slow
@pytest.mark.parametrize("case", thorough(writes))
@pytest.mark.parametrize("place", ["gone", "read-only"])
def test_a_folder_that_is_gone_or_read_only_is_a_line(call, tmp_path, case, place):
    folder = tmp_path / "gone"
    if place == "read-only":
        # Nobody makes files in /proc; the superuser writes wherever a mode forbids it.
        folder = Path("/proc/self/task") if os.path.exists("/proc/self/task") else Path("/")
    if not case.suffix and place == "gone":
        folder = tmp_path / "flat" / "x"
        (tmp_path / "flat").write_text("a file, no folder")
    path = folder / f"out{case.suffix}"
    status, _, err = call(case, path)
    # The recorder makes the folder.
    if case.suffix == ".tlog" and place == "gone" and case.program == "gcs_sysid":
        assert status == 0
        check_written(case, path)
    else:
        check_refusal(status, err)


@pytest.mark.parametrize(
    "command",
    [
        "analyze F --airframe paper --json F", "check F --json F", "compare F G --json F",
        "health F --json F", "inspect F --json F", "params F -o F", "tune F --json F",
        "export F --to urdf -o F", "tune G F --json F", "twin G F --json F",
    ],
)  # fmt: skip
def test_a_file_that_is_read_is_never_replaced(tmp_path, capsys, command):
    file = tmp_path / "flight.tlog"
    file.write_bytes(b"a flight")
    words = [str(file) if word == "F" else word for word in command.split()]
    assert run([*words, "--force"]) == 2
    assert "flight.tlog is also an input" in capsys.readouterr().err
    assert file.read_bytes() == b"a flight"


@pytest.mark.slow
@pytest.mark.parametrize("case", thorough(lambda case: True))
def test_standard_output_on_a_full_disk_costs_no_file(call, tmp_path, case):
    path = tmp_path / f"out{case.suffix}"
    with open("/dev/full", "w") as full:
        status, _, err = call(case, path, stdout=full)
    check_written(case, path)
    if case.prints:
        check_refusal(status, err)
        assert "standard output: cannot write: No space left on device" in err


@pytest.mark.slow
@pytest.mark.parametrize("case", thorough(lambda case: case.dash))
def test_output_to_a_full_standard_output_is_a_line(call, case):
    with open("/dev/full", "w") as full:
        status, _, err = call(case, "-", stdout=full)
    check_refusal(status, err)


def closed_pipe():
    reading, writing = os.pipe()
    os.close(reading)
    return writing


@pytest.mark.slow
@pytest.mark.parametrize("case", thorough(lambda case: True))
def test_a_reader_that_has_gone_costs_no_file(call, tmp_path, case):
    path = tmp_path / f"out{case.suffix}"
    with open(closed_pipe(), "wb") as pipe:
        status, _, err = call(case, path, stdout=pipe)
    assert status == 0
    assert "error" not in err
    check_written(case, path)


@pytest.mark.slow
@pytest.mark.parametrize("case", thorough(lambda case: case.dash))
def test_output_to_a_reader_that_has_gone_is_silent(call, case):
    with open(closed_pipe(), "wb") as pipe:
        status, _, err = call(case, "-", stdout=pipe)
    assert status == 0
    assert "error" not in err


POOR = {
    "LANG=C": {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    "TERM=dumb": {"TERM": "dumb"},
}


@pytest.mark.slow
@pytest.mark.parametrize("case", thorough(lambda case: True))
@pytest.mark.parametrize("poor", POOR)
def test_poor_terminals_cost_nothing(call, tmp_path, case, poor):
    path = tmp_path / f"out{case.suffix}"
    status, out, err = call(case, path, POOR[poor])
    assert status == 0, err
    assert case.prints in out
    check_written(case, path)


@pytest.mark.slow
@pytest.mark.parametrize("case", thorough(lambda case: True))
def test_a_terminal_one_column_wide_costs_nothing(call, tmp_path, case):
    import fcntl
    import pty
    import termios
    import threading

    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 1, 1, 0, 0))
    pieces = []

    def drain():
        with contextlib.suppress(OSError):
            while piece := os.read(ours, 65536):
                pieces.append(piece)

    thread = threading.Thread(target=drain)
    thread.start()
    path = tmp_path / f"out{case.suffix}"
    try:
        status, _, err = call(case, path, {"COLUMNS": "1"}, stdout=theirs)
    finally:
        os.close(theirs)
        thread.join()
        os.close(ours)
    assert status == 0, err
    assert "".join(case.prints.split()) in "".join(b"".join(pieces).decode().split())
    check_written(case, path)


@pytest.mark.slow
@pytest.mark.parametrize("case", thorough(lambda case: True))
def test_closed_streams_cost_nothing(places, tmp_path, case):
    path = tmp_path / f"out{case.suffix}"
    words = filled_in(case, places, path)
    shell = ["/bin/sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh"]
    done = subprocess.run(
        [*shell, sys.executable, "-m", case.program, *words], cwd=tmp_path, timeout=240, check=False
    )
    assert done.returncode == 0
    check_written(case, path)
