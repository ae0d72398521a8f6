"""MAVProxy takes the emulator for a vehicle. Skipped where MAVProxy is not installed."""

import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MAVPROXY = shutil.which("mavproxy.py", path=Path(sys.executable).parent) or shutil.which(
    "mavproxy.py"
)
PATIENCE = 60.0  # s until the test gives up


@pytest.mark.slow
@pytest.mark.skipif(MAVPROXY is None, reason="MAVProxy is not installed")
def test_mavproxy_sees_a_flying_px4_and_reads_its_parameters(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
    emulator = subprocess.Popen(
        [
            *(sys.executable, "-m", "sim_bridge", "--connect", f"udpout:127.0.0.1:{port}"),
            *("--rate", "50", "--duration", "600"),
        ],
        cwd=ROOT,
    )
    output = tmp_path / "out.txt"
    with output.open("w") as out:
        station = subprocess.Popen(
            [
                *(str(MAVPROXY), f"--master=udpin:127.0.0.1:{port}"),
                *("--daemon", "--non-interactive"),
                *(f"--state-basedir={tmp_path}", "--aircraft=emulated"),
            ],
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
            env={**os.environ, "HOME": str(tmp_path), "PYTHONUNBUFFERED": "1"},
        )
    wanted = ("Detected vehicle 1:1", "ARMED", "Mode OFFBOARD", "GPS lock", "Received")
    try:
        give_up = time.monotonic() + PATIENCE
        while time.monotonic() < give_up:
            text = output.read_text(errors="replace")
            if all(word in text for word in wanted):
                break
            assert station.poll() is None, text
            time.sleep(0.2)
    finally:
        for process in (station, emulator):
            process.terminate()
        for process in (station, emulator):
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
    text = output.read_text(errors="replace")
    missing = [word for word in wanted if word not in text]
    assert not missing, text
    parameters = next(tmp_path.rglob("mav.parm")).read_text()
    assert "SYS_AUTOSTART" in parameters
    assert "4001" in parameters
