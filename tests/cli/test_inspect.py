"""`gcs-sysid inspect`: text, JSON and exit status.

The text is compared with `golden/`, its figures rounded to two digits. After a change that is
meant: `UPDATE_GOLDEN=1 pytest tests/cli/test_inspect.py`, then look at the difference.
"""

import json
import os
import re
import socket
from pathlib import Path

import pytest

from gcs_sysid.cli.airframe_choice import command_for
from gcs_sysid.cli.commands import build_parser
from gcs_sysid.cli.inspect_command import report
from gcs_sysid.inspection.inspector import inspect_log

GOLDEN = Path(__file__).parent / "golden"


@pytest.fixture(scope="module")
def flight(fly):
    options = ("--autopilot", "ardupilot", "--mission", "all-axes", "--rate", "100")
    return fly(*options, "--duration", "16", "--seed", "5", "--trap", "radio", "--trap", "ground=5")


def rounded(text):
    """Figures to two digits, in the width they had."""

    def two_digits(match):
        return f"{float(f'{float(match[0]):.1e}'):g}".rjust(len(match[0]))

    return re.sub(r"(?<![\w:.])\d+(?:\.\d+)?(?![\w:])", two_digits, text)


@pytest.mark.slow
@pytest.mark.parametrize("width", [80, 120])
def test_text(flight, width):
    found = inspect_log(flight.tlog)
    text = report(found, width).replace(str(flight.tlog), "flight.tlog")
    assert all(len(line) <= width for line in text.splitlines())
    path = GOLDEN / f"inspect-{width}.txt"
    if os.environ.get("UPDATE_GOLDEN"):
        path.write_text(rounded(text) + "\n", encoding="utf-8")
    assert rounded(text) + "\n" == path.read_text(encoding="utf-8")


def test_health_assumes_a_layout_where_there_is_one_to_try():
    parsed = build_parser().parse_args(["health", "a.bbl"])
    command = command_for("a.bbl", None, parsed, "betaflight-quad-x", command="health")
    assert command == "gcs-sysid health a.bbl --arm M --mass KG"


@pytest.mark.slow
def test_json_alone_on_standard_output(inspect, flight):
    for argv in ((flight.tlog, "--json"), ("--json", flight.tlog), (flight.tlog, "--json", "-")):
        status, out, err = inspect(*argv)
        assert status == 0
        assert err == ""
        found = json.loads(out, parse_constant=lambda word: pytest.fail(f"{word} in the JSON"))
        assert found["schema"] == "gcs-sysid-inspect/1"
        assert found["verdict"] in ("yes", "partly", "no")
        assert found["source"] == str(flight.tlog)
        assert {s["role"] for s in found["systems"]} == {"vehicle", "radio"}
        assert {s["stream"] for s in found["streams"]} >= {"imu", "attitude", "rotor_speed"}
        assert found["excitation"].keys() == {"roll", "pitch", "yaw"}
        assert found["rotor_input"]["sources"][0]["unit"] in ("rad/s", "autopilot's output")


def test_what_cannot_be_identified_from_is_still_an_answer(inspect, fly):
    slow = fly("--mission", "all-axes", "--rate", "4", "--duration", "8")
    status, out, _ = inspect(slow.tlog)
    assert status == 0
    assert "Can be identified from: NO" in out


def test_a_recording_that_was_not_ended_is_told(inspect, flight, tmp_path):
    path = tmp_path / "torn.tlog"
    path.write_bytes(flight.tlog.read_bytes()[:-5])
    _, out, _ = inspect(path)
    assert re.search(r"the last record is cut short: \d+ bytes \(the recording was not", out)


@pytest.mark.parametrize("name", ["missing.tlog", "nonesuch", "text.bin"])
def test_unreadable_gives_one_line(inspect, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("text.bin").write_text("no log\n" * 100, encoding="utf-8")
    status, out, err = inspect(name)
    assert status == 2
    assert out == ""
    assert err.count("\n") == 1
    assert name in err


@pytest.mark.slow
def test_an_airframe_or_a_number_of_rotors_may_be_named(inspect, flight):
    for options in (("--airframe", "paper", "--mass", "1.5"), ("--rotors", "4")):
        status, out, _ = inspect(flight.tlog, "--json", "-", *options)
        assert status == 0
        rotor_input = json.loads(out)["rotor_input"]
        assert (rotor_input["rotors"], rotor_input["message"]) == (4, "ESC_TELEMETRY")
    _, out, _ = inspect(flight.tlog, "--rotors", "6")
    assert "Can be identified from: NO" in out
    assert "lacks rotor 5 of 6" in out


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (("--rotors", "2"), "3 to 32"),
        (("--rotors", "4", "--airframe", "paper"), "exclude each other"),
        (("--mass", "1.5"), "need --airframe"),
        (("--airframe", "nonesuch"), "no airframe 'nonesuch'"),
    ],
)
def test_vehicles_that_make_no_sense_give_one_line(inspect, flight, options, why, capsys):
    try:
        status, _, err = inspect(flight.tlog, *options)
    except SystemExit as exit:  # of the parser
        status, err = exit.code, capsys.readouterr().err
    assert status == 2
    assert why in err
    assert err.count("\n") == 1


def test_a_silent_link_is_no_answer(inspect):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    status, out, _ = inspect(f"udpin:127.0.0.1:{port}", "--duration", "0.2", "--listen-only")
    assert status == 1
    assert "no MAVLink message received" in out


SHARED = {
    "px4-esc-cg.tlog": ("yes", "ESC_STATUS"),
    "px4-sih-default.ulg": ("yes", "actuator_motors"),
    "ardupilot-sitl.bin": ("yes", "ESC"),
    "public/real-quad-mavlink1.tlog": ("no", None),
    "public/px4-sitl.ulg": ("no", None),
    "public/real-quad-copter33.bin": ("no", "RCOU"),
}
QUICK = "public/px4-sitl.ulg"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        pytest.param(*item, marks=[pytest.mark.thorough] * (item[0] != QUICK), id=item[0])
        for item in SHARED.items()
    ],
)
def test_real_logs(inspect, name, expected, shared_logs):
    status, out, _ = inspect(shared_logs / name, "--json")
    assert status == 0
    found = json.loads(out)
    assert (found["verdict"], found["rotor_input"]["message"]) == expected
    assert found["in_air"] > 5.0
    if found["verdict"] != "yes":
        assert all(r["advice"] for r in found["reasons"] if r["level"] != "note")
