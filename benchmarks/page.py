"""What the live page costs, beside the same session without a screen.

    python -m benchmarks.page

Runs `gcs-sysid live` with `--headless`, then with `--web` and viewers that follow it as a browser
does: the stream of snapshots, and each second the plot of a parameter. The emulator flies at the
pace of the clock. Measured is the processor time of the session's process, all threads, per
second: what runs beside it on the machine does not count. Linux alone.
"""

import http.client
import json
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from urllib.parse import urlsplit

from benchmarks.screen import cpu_seconds, start_emulator
from testbed.study import arguments, free_port

SETTLE = 15.0
"""s after take-off before anything is measured: imports, and the first estimates."""


class Viewer(threading.Thread):
    """Follows a page, as `live.js` does."""

    def __init__(self, address: str) -> None:
        super().__init__(daemon=True)
        parts = urlsplit(address)
        assert parts.port is not None
        self._port = parts.port
        self._cookie = f"gcs-sysid-{parts.port}={parts.query.partition('=')[2]}"
        self.snapshots = 0
        self.bytes = 0

    def _open(self, path: str) -> http.client.HTTPResponse:
        link = http.client.HTTPConnection("127.0.0.1", self._port, timeout=60)
        link.request("GET", path, headers={"Cookie": self._cookie})
        return link.getresponse()

    def run(self) -> None:
        """Follow until the session ends."""
        drawn = 0.0
        try:
            for line in self._open("/live"):
                self.bytes += len(line)
                self.snapshots += line.startswith(b'data: {"session"')
                if time.monotonic() - drawn > 1.0:
                    drawn = time.monotonic()
                    self.bytes += len(self._open("/live/history?name=Ixx").read())
        except OSError:  # the session has ended
            pass


def fly(seconds: float, viewers: int | None, seed: int) -> dict[str, float]:
    """One flight; viewers None: headless."""
    port = free_port()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "results.jsonl"
        url, link = f"udpin:127.0.0.1:{port}", f"udpout:127.0.0.1:{port}"
        live = [sys.executable, "-m", "gcs_sysid", "live", url, "--airframe", "paper"]
        live += ["--json", str(out), "--record", str(Path(folder) / "flight.tlog")]
        live += ["--headless"] if viewers is None else ["--web", "0"]
        session = subprocess.Popen(live, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        assert session.stderr is not None
        first = session.stderr.readline().decode()
        threading.Thread(target=session.stderr.read, daemon=True).start()
        found = re.search(r"http\S+", first)
        watching = [Viewer(found[0]) for _ in range(viewers or 0)] if found else []
        for viewer in watching:
            viewer.start()
        emulator = start_emulator(link, seconds + 60.0, seed)
        try:
            time.sleep(SETTLE)
            cpu, began = cpu_seconds(session.pid), time.monotonic()
            known = [(viewer.snapshots, viewer.bytes) for viewer in watching]
            time.sleep(seconds)
            lasted = time.monotonic() - began
            cpu = cpu_seconds(session.pid) - cpu
            told = [
                (viewer.snapshots - before[0], viewer.bytes - before[1])
                for viewer, before in zip(watching, known, strict=True)
            ]
            session.terminate()
            session.wait(60.0)
        finally:
            emulator.kill()
            emulator.wait()
            if session.poll() is None:
                session.kill()
        telemetry = json.loads(out.read_text().splitlines()[-1])["telemetry"]
    return {
        "cpu": cpu / lasted,
        "lost": telemetry["lost"],
        "imu_rate": telemetry["messages"]["HIGHRES_IMU"]["rate"],
        "snapshots": min((count / lasted for count, _ in told), default=0.0),
        "bytes": max((count / lasted for _, count in told), default=0.0),
    }


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--seconds", type=float, default=40.0, help="measured, each run")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--viewers", type=int, nargs="+", default=[1, 4])
    options = parser.parse_args()
    print(f"load average before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    print("session         processor   more   lost   IMU Hz   snapshots/s   kB/s a viewer")
    base = None
    for viewers in (None, *options.viewers):
        found = fly(options.seconds, viewers, options.seed)
        base = found["cpu"] if base is None else base
        name = "headless" if viewers is None else f"{viewers} viewer{'s' * (viewers > 1)}"
        print(
            f"{name:<14} {100.0 * found['cpu']:8.1f} % {100.0 * (found['cpu'] - base):6.1f} "
            f"{found['lost']:6.0f} {found['imu_rate']:8.1f} {found['snapshots']:13.1f} "
            f"{1e-3 * found['bytes']:15.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
