"""What a new user meets: the welcome, the doctor, the airframe wizard, completion."""

import contextlib
import json
import os
import re
import socket
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from gcs_sysid.cli import commands
from gcs_sysid.cli.commands import build_parser
from gcs_sysid.cli.program import run, with_command
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.setup_help import listening
from gcs_sysid.setup_help.airframe_file import LAYOUTS, layout_rotors
from gcs_sysid.setup_help.checks import Sign
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.urls import parse_url

GOLDEN = Path(__file__).parent / "golden" / "welcome.txt"


def test_alone_it_shows_what_it_can_do_and_where_to_begin(capsys):
    assert run([]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    lines = out.splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80
    for command in commands.COMMANDS:
        shown = rf"  {command.name} +{re.escape(command.summary)}"
        assert any(re.fullmatch(shown, line) for line in lines)
    # The commands are the parser's; the rest is kept here.
    told = re.sub(r"(?s)(\nCommands .*?\n).*", r"\1...\n", out)
    told = re.sub(r"gcs-sysid \d[\w.]*", "gcs-sysid VERSION", told)
    if os.environ.get("UPDATE_GOLDEN"):
        GOLDEN.write_text(told, encoding="utf-8")
    assert told == GOLDEN.read_text(encoding="utf-8")


def test_the_commands_to_begin_with_are_understood(capsys):
    run([])
    shown = re.findall(r"^  gcs-sysid (.+)$", capsys.readouterr().out, re.MULTILINE)
    assert [line.split()[0] for line in shown] == ["flight.bin", "live"]
    for line in shown:
        build_parser().parse_args(with_command(line.split()))


@pytest.mark.parametrize(
    ("words", "command"),
    [
        (["flight.bin"], "check"),
        (["--mass", "1.5", "b.ulg"], "check"),
        ([str(GOLDEN)], "check"),
        (["flight.tlgo"], "check"),
        (["udpin:0.0.0.0:14550"], "udpin:0.0.0.0:14550"),
        (["analyse", "a.ulg"], "analyze"),
        (["foo"], "foo"),
    ],
)
def test_a_log_alone_is_checked(words, command):
    assert with_command(words)[0] == command


def test_what_is_no_log_or_misspelt_says_what_to_type(tmp_path, capsys):
    (tmp_path / "flight.bin").write_bytes(b"x")
    (tmp_path / "h.json").write_text('{"schema": "gcs-sysid-health/1"}')
    (tmp_path / "l.ulg").write_bytes(b"ULog\xff\xfe")
    for words, told in (
        (["fligth.bin"], "did you mean flight.bin?"),
        (["nowhere/flight.bin"], "there is no folder"),
        (["h.json"], "is JSON"),
        (["."], "gcs-sysid batch"),
        (["tune", "l.ulg"], "gcs-sysid analyze"),
        (["tune", "h.json"], "gcs-sysid analyze LOG"),
    ):
        path = str(tmp_path / words[-1])
        assert run([*words[:-1], path]) == 2
        assert told in capsys.readouterr().err


# --- airframe


@pytest.mark.slow
@pytest.mark.parametrize("layout", LAYOUTS)
def test_an_airframe_by_options_alone(layout, tmp_path, capsys):
    path = tmp_path / "mine.toml"
    argv = ["--layout", layout, "--arm", "0.25", "--mass", "1.5", "--output", str(path)]
    assert run(["airframe", "new", *argv]) == 0
    out, err = capsys.readouterr()
    assert out == ""
    assert f"written: {path}" in err
    airframe = load_airframe(str(path))
    assert airframe.name == "mine"
    assert airframe.anchor() == ("mass", 1.5)
    told = [(r.x, r.y, r.spin) for r in layout_rotors(layout, 0.25)]
    for got, expected in zip(airframe.rotors, told, strict=True):
        assert (got.x, got.y, got.spin) == pytest.approx(expected, abs=1e-6)
    # Never twice.
    before = path.read_bytes()
    assert run(["airframe", "new", *argv]) == 2
    assert path.read_bytes() == before
    # What was written is in order.
    capsys.readouterr()
    assert run(["airframe", "check", str(path), "--json"]) == 0
    checked = json.loads(capsys.readouterr().out)
    assert {finding["sign"] for finding in checked["findings"]} == {"ok"}
    assert checked["rotors"] == airframe.as_json()["rotors"]


def test_an_airframe_with_all_options_to_standard_output(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rotors = ["ccw:0.2,0.25", "ccw:-0.2,-0.25", "cw:0.2,-0.25", "cw:-0.2,0.25"]
    argv = [word for text in rotors for word in ("--rotor", text)]
    argv += ["--spin", "cw,cw,ccw,ccw", "--k-t", "2e-5", "--imu=-0.02,0,-0.03", "--name", "odd"]
    argv += ["--prior", "k_M=6e-6+-1e-7", "--output", "-"]
    assert run(["airframe", "new", *argv]) == 0
    out, err = capsys.readouterr()
    assert "every spin the other way" in err
    assert list(tmp_path.iterdir()) == []
    path = tmp_path / "odd.toml"
    path.write_text(out, encoding="utf-8")
    airframe = load_airframe(str(path))
    assert [(r.x, r.y, r.spin) for r in airframe.rotors][:2] == [(0.2, 0.25, -1), (-0.2, -0.25, -1)]
    assert (airframe.name, airframe.anchor()) == ("odd", ("k_T", 2e-5))
    assert airframe.imu_position == (-0.02, 0.0, -0.03)
    assert airframe.priors == {"k_M": (6e-6, 1e-7)}


def test_a_file_to_standard_output_is_utf8_everywhere():
    argv = ["airframe", "new", "--layout", "px4-quad-x", "--arm", "0.2", "--name", "Möwe →"]
    done = subprocess.run(
        [sys.executable, "-m", "gcs_sysid", *argv, "--output", "-"],
        capture_output=True,
        env={**os.environ, "PYTHONIOENCODING": "cp1252"},
        timeout=60,
    )
    assert done.returncode == 0
    assert tomllib.loads(done.stdout.decode("utf-8"))["name"] == "Möwe →"


def test_check_draws_and_says_what_looks_wrong(tmp_path, capsys):
    text = "".join(
        f'[[rotor]]\nx = {x}\ny = {y}\nspin = "{spin}"\n'
        for x, y, spin in ((0.2, 0.2, "ccw"), (0.2, -0.2, "cw"), (-0.2, -0.2, "ccw"),
                           (-0.2, 0.2, "cw"))
    )  # fmt: skip
    path = tmp_path / "quad.toml"
    path.write_text(f"mass = 900\n{text}", encoding="utf-8")
    assert run(["airframe", "check", str(path)]) == 0
    out = capsys.readouterr().out
    assert "front\n2" in out
    said = " ".join(out.split())
    assert "numbered differently" in said
    assert "not grams" in said
    path.write_text(f'k_T = 1e-5\nrotor_input = "command"\n{text}', encoding="utf-8")
    assert run(["airframe", "check", str(path)]) == 1
    assert "give the mass" in capsys.readouterr().out


def everything_from(terminal):
    seen = b""
    with contextlib.suppress(OSError):  # Linux says so that the other end has gone
        while more := os.read(terminal, 4096):
            seen += more
    os.close(terminal)
    return seen


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminals there")
@pytest.mark.parametrize("answer", ["", "n"])
def test_the_wizard_asks_on_a_terminal_and_confirms(answer, tmp_path):
    ours, theirs = os.openpty()
    typed = ["1", "0.25", "", "", "1.5", "", "", "mine", "", answer]
    os.write(ours, "".join(f"{line}\n" for line in typed).encode())
    wizard = subprocess.Popen(
        [sys.executable, "-m", "gcs_sysid", "airframe", "new"],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        cwd=tmp_path,
        env={**os.environ, "PYTHONUTF8": "1"},
    )
    os.close(theirs)
    seen = everything_from(ours).decode()
    assert wizard.wait(60) == 0, seen
    assert "3↻" in seen
    path = tmp_path / "mine.toml"
    assert path.exists() is (answer == "")
    assert seen.endswith("nothing is written\r\n") is (answer == "n")
    if answer == "":
        assert load_airframe(str(path)).anchor() == ("mass", 1.5)


# --- doctor


@pytest.fixture
def ports(monkeypatch, tmp_path):
    """The usual ports are two of our own, one of them in use."""
    monkeypatch.chdir(tmp_path)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            free = probe.getsockname()[1]
        numbers = taken.getsockname()[1], free
        urls = [parse_url(f"udpin:127.0.0.1:{port}") for port in numbers]
        monkeypatch.setattr(listening, "usual_urls", lambda: urls)
        yield numbers


def test_the_doctor_as_json(ports, capsys):
    taken, free = ports
    status = run(["doctor", "--json", "--duration", "0.1"])
    out, err = capsys.readouterr()
    assert err == ""
    findings = {finding["topic"]: finding for finding in json.loads(out)["findings"]}
    assert {"Python", "packages", "terminal", "recordings", "vehicle"} <= findings.keys()
    assert all(f.keys() == {"topic", "sign", "text", "advice"} for f in findings.values())
    assert all(f["sign"] in list(Sign) for f in findings.values())
    assert findings[f"UDP {taken}"]["sign"] == "warning"
    assert findings[f"UDP {free}"]["sign"] == "ok"
    assert findings["vehicle"]["sign"] == "warning"
    assert status == (1 if any(f["sign"] == "problem" for f in findings.values()) else 0)
    for silent in ((), (f"udpin:127.0.0.1:{taken}",), (f"udpin:203.0.113.9:{free}",),
                   (f"udpin:127.0.0.1:{free}",)):  # fmt: skip
        assert run(["doctor", "--duration", "0.1", *silent]) == len(silent)
        assert "\nready" not in capsys.readouterr().out


def test_the_doctor_hears_a_vehicle_and_is_not_heard(ports, capsys, monkeypatch):
    _, free = ports
    packer = mavlink.MAVLink(None, srcSystem=3, srcComponent=1)
    beat = mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 0, 3
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        open_ears = listening.open_ears

        def speak(*given):
            opened = open_ears(*given)
            vehicle.sendto(bytes(beat.pack(packer)), ("127.0.0.1", free))
            return opened

        monkeypatch.setattr(listening, "open_ears", speak)
        run(["doctor", "--duration", "0.2"])
        vehicle.setblocking(False)
        with pytest.raises(BlockingIOError):
            vehicle.recv(1)
    out = capsys.readouterr().out
    assert f"ArduPilot quadrotor 3:1 on udpin:127.0.0.1:{free}" in out
    assert f"-> gcs-sysid live udpin:127.0.0.1:{free} --airframe auto --arm M" in out
    assert "\nready" in out
    assert re.search(r"^(✓|\+) ok +Python: ", out, re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize("module", ["numpy", "serial"])
def test_the_doctor_starts_without_the_packages_that_it_looks_for(module, tmp_path):
    code = (
        f"import sys\nsys.modules[{module!r}] = None\nfrom gcs_sysid.__main__ import main\n"
        "sys.exit(main(['doctor', '--duration', '0.1']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, timeout=60
    )
    assert (done.returncode, done.stderr) == (1, "")
    assert "links: cannot be checked" in done.stdout
