"""A day in the field by the command line: two flights over a link, a payload taken on between."""

import json
import socket
import subprocess
import sys

import pytest

QUAD = ("--airframe", "px4-quad-x", "--arm", "0.25", "--mass", "1.0")
TAKEN_ON = 84.0
"""s, on the ground after the first flight; the autopilot is restarted a second earlier."""


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
    session = subprocess.Popen(
        [*live, "--headless", "--no-record", "--json", "-"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path,
    )  # fmt: skip
    assert session.stderr.readline().startswith("listening on")
    subprocess.run([sys.executable, "-m", "sim_bridge", *play], check=True, capture_output=True)
    out, err = session.communicate(timeout=600)
    assert session.returncode == 0, err
    last = json.loads(out.splitlines()[-1])
    result = last.get("result", last)
    changes = [e for e in result["events"] if e["kind"] in ("mass_change", "payload", "change")]
    assert [e["kind"] for e in changes] == ["mass_change"]
    assert changes[0]["t"] < TAKEN_ON
    assert len(result["segments"]) == 1
    for name in ("mass", "Ixx", "Iyy", "T_max"):
        low, high = result["parameters"][name]["ci95"]
        assert low < flight.truth[name] < high, name
    assert result["parameters"]["mass"]["value"] == pytest.approx(1.2, rel=0.03)
    assert result["telemetry"]["thrust_voltage"] == pytest.approx(16.3, abs=0.1)
    assert "mass change" in err
