"""Cost and latency of the live screen while a vehicle sends at 250 Hz.

    python -m benchmarks.screen

Runs `gcs-sysid live` as it is, in a pseudo-terminal, with the emulator flying at the pace of the
clock; presses a key at seeded moments and waits for the answer to be drawn. Linux alone.

Wall time is meaningful only on an otherwise idle machine. "Computed" is the processor time of all
the program's threads from the key to its answer: what the wait comes to where nothing else runs,
whatever runs here.
"""

import fcntl
import json
import os
import pty
import select
import struct
import subprocess
import sys
import tempfile
import termios
import time
from pathlib import Path

import numpy as np

from testbed.study import arguments, free_port

SETTLE = 8.0
"""s after the start before anything is measured: imports, take-off, the first estimates."""
PATIENCE = 5.0
"""s that an answer may take."""
PAUSE = (0.15, 0.35)
"""s between an answer and the next key."""


def cpu_seconds(pid: int) -> float:
    """Processor time of a process's threads that live."""
    threads = Path(f"/proc/{pid}/task").iterdir()
    return 1e-9 * sum(int((task / "schedstat").read_text().split()[0]) for task in threads)


class Terminal:
    """A program in a pseudo-terminal of a given size."""

    def __init__(self, command: list[str], columns: int, rows: int) -> None:
        self.master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        environment = {**os.environ, "TERM": "xterm-256color", "COLORTERM": "truecolor"}
        self.process = subprocess.Popen(
            command, stdin=slave, stdout=slave, stderr=slave, env=environment, close_fds=True
        )
        os.close(slave)
        self.drawn = 0

    def read(self, seconds: float, until: bytes | None = None) -> bool:
        """Take what is drawn, for so long or until a text is among it; whether it was."""
        end, seen = time.monotonic() + seconds, b""
        while (left := end - time.monotonic()) > 0.0:
            if not select.select([self.master], [], [], left)[0]:
                break
            try:
                new = os.read(self.master, 1 << 16)
            except OSError:  # the program has ended
                return False
            self.drawn += len(new)
            seen = seen[-4096:] + new
            if until is not None and until in seen:
                return True
        return False

    def press(self, key: str) -> None:
        """Send a key."""
        os.write(self.master, key.encode())


def start_emulator(link: str, duration: float, seed: int) -> subprocess.Popen[bytes]:
    """A flight of so many seconds, sent to a link."""
    flight = ["--airframe", "paper", "--mission", "all-axes", "--noise", "mems"]
    flight += ["--rate", "250", "--seed", str(seed), "--duration", str(duration)]
    return subprocess.Popen(
        [sys.executable, "-m", "sim_bridge", *flight, "--connect", link],
        stdout=subprocess.DEVNULL,
    )


def fly(size: tuple[int, int], seconds: float, seed: int) -> dict[str, float]:
    """One flight before the screen; the figures."""
    rng = np.random.default_rng(seed)
    port = free_port()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "results.jsonl"
        url, link = f"udpin:127.0.0.1:{port}", f"udpout:127.0.0.1:{port}"
        live = [sys.executable, "-m", "gcs_sysid", "live", url, "--airframe", "paper"]
        live += ["--json", str(out), "--record", str(Path(folder) / "flight.tlog")]
        terminal = Terminal(live, *size)
        terminal.read(20.0, b"Listening on")
        emulator = start_emulator(link, seconds + 60.0, seed)
        try:
            terminal.read(30.0, b"flying")
            terminal.read(SETTLE)
            pid = terminal.process.pid
            began, cpu = time.monotonic(), cpu_seconds(pid)
            drawn = terminal.drawn
            waits, busy = [], []
            while time.monotonic() - began < seconds:
                terminal.read(float(rng.uniform(*PAUSE)))
                pressed, before = time.monotonic(), cpu_seconds(pid)
                terminal.press("m")
                # The answer, or the event that follows it, whichever is drawn first.
                answered = terminal.read(PATIENCE, b"mark %d" % (len(waits) + 1))
                waits.append(time.monotonic() - pressed if answered else float("inf"))
                busy.append(cpu_seconds(pid) - before)
            lasted = time.monotonic() - began
            cpu = cpu_seconds(pid) - cpu
            drawn = terminal.drawn - drawn
            terminal.press("q")
            terminal.read(20.0, b"recorded to")
            terminal.process.wait(20.0)
        finally:
            emulator.kill()
            emulator.wait()
            if terminal.process.poll() is None:
                terminal.process.kill()
        telemetry = json.loads(out.read_text().splitlines()[-1])["telemetry"]
    imu = telemetry["messages"]["HIGHRES_IMU"]
    return {
        "cpu": cpu / lasted,
        "lost": telemetry["lost"],
        "received": telemetry["received"],
        "imu_rate": imu["rate"],
        "keys": len(waits),
        "drawn": drawn / lasted,
        **{f"p{q}": 1e3 * float(np.quantile(waits, q / 100.0)) for q in (50, 90, 99)},
        "busy": 1e3 * float(np.quantile(busy, 0.99)),
    }


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--seconds", type=float, default=40.0, help="measured, each size")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sizes", nargs="+", default=["80x24", "120x40", "200x50"])
    options = parser.parse_args()
    print(f"load average before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    print("terminal   processor   lost of received   IMU Hz   kB/s drawn   key answered, ms")
    print(
        "                                                              50 %   90 %   99 %"
        "  computed, 99 %  keys"
    )
    for text in options.sizes:
        columns, _, rows = text.partition("x")
        found = fly((int(columns), int(rows)), options.seconds, options.seed)
        print(
            f"{text:<10} {100.0 * found['cpu']:7.1f} %   {found['lost']:4.0f} of "
            f"{found['received']:<9.0f} {found['imu_rate']:7.1f} {1e-3 * found['drawn']:10.1f}"
            f" {found['p50']:9.0f} {found['p90']:6.0f} {found['p99']:6.0f}"
            f" {found['busy']:15.0f} {found['keys']:5.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
