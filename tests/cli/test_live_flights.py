"""A day in the field by the command line: two flights over a link, a payload taken on between."""

import json
import re
import signal
import socket
import subprocess
import sys
import threading

import pytest

QUAD = ("--airframe", "px4-quad-x", "--arm", "0.25", "--mass", "1.0")
TAKEN_ON = 84.0
"""s, on the ground after the first flight; the autopilot is restarted a second earlier."""
ENOUGH, LONGEST = 140.0, 600.0
"""s of the session, well into the second flight; and after which it has hung."""


@pytest.mark.thorough
def test_a_payload_between_two_flights_on_commands(fly, tmp_path):
    """The battery sags all the while, and stock PX4 sends commands: T_max stays, the mass grows."""
    flight = fly(
        "--airframe", "px4-quad-x", "--mission", "doublets", "--rotor-input", "command",
        "--rate", "100", "--trap", "ground=8", "--trap", "flights=2", "--trap", "reboot=83",
        "--physics", "battery=0.1:160", "--mass-step", f"{TAKEN_ON:g}:1.2",
    )  # fmt: skip
    with socket.create_server(("127.0.0.1", 0)) as free:
        url = f"127.0.0.1:{free.getsockname()[1]}"
    play = ("--play", str(flight.tlog), "--speed", "max", "--connect", f"tcp:{url}")
    live = [sys.executable, "-m", "gcs_sysid", "live", f"tcpin:{url}", *QUAD, "--listen-only"]
    lines, said = tmp_path / "live.jsonl", []
    session = subprocess.Popen(
        [*live, "--headless", "--no-record", "--json", str(lines)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path,
    )  # fmt: skip
    assert session.stderr.readline().startswith("listening on")
    hung = threading.Timer(LONGEST, session.kill)
    hung.start()
    try:
        player = [sys.executable, "-m", "sim_bridge", *play]
        subprocess.run(player, check=True, capture_output=True)
        for line in session.stderr:
            said.append(line)
            time = re.match(r" *([\d.]+) s ", line)
            if time and float(time[1]) > ENOUGH:
                break
        session.send_signal(signal.SIGINT)
        out, err = session.communicate()
    finally:
        hung.cancel()
        session.kill()
    assert session.returncode == 0, err
    result = json.loads(lines.read_text().splitlines()[-1])
    changes = [e for e in result["events"] if e["kind"] in ("mass_change", "payload", "change")]
    assert [e["kind"] for e in changes] == ["mass_change"]
    assert changes[0]["t"] < TAKEN_ON
    assert len(result["segments"]) == 1
    for name in ("mass", "Ixx", "Iyy", "T_max"):
        low, high = result["parameters"][name]["ci95"]
        assert low < flight.truth[name] < high, name
    assert result["parameters"]["mass"]["value"] == pytest.approx(1.2, rel=0.03)
    assert result["telemetry"]["thrust_voltage"] == pytest.approx(16.3, abs=0.1)
    assert any("the vehicle differs since the landing" in line for line in said)
    assert "mass change: mass 1.000 -> 1.1" in out
