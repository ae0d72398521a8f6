"""Kills a recording session at random moments, and reads what is left of each recording.

    python -m benchmarks.reliability.kills [--kills N] [--seed N] [--longest S]

The emulator flies once. Its flight is sent in real time to headless sessions, `gcs-sysid live` as a
user runs it, with the times noted; so it is known what each of them was sent. Each is killed with
SIGKILL at a moment drawn at random after it has said that it listens: the process of the session,
by turns with that of its receiver. Once both have ended, the recording is read: whole records, in
order, and nothing missing that was sent more than a second before.
"""

import contextlib
import math
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gcs_sysid.errors import InputError
from gcs_sysid.telemetry.frames import Validity
from gcs_sysid.telemetry.tlog import TlogReader
from sim_bridge.playback import moments
from testbed.study import arguments, flown, free_port, say

ALLOWED = 1.0
"""s that may be missing before a kill."""
OUTLIVES = 5.0
"""s that the receiver may take to end, or the session that has lost it."""
_PATIENCE = 120.0
"""s that either may take at most."""


@dataclass(frozen=True)
class Kill:
    """What is left of one session.

    Attributes:
        after: s from the word that it listens to the kill.
        sent: frames that it was sent in that time.
        recorded: of those, how many are in the recording.
        missing: s before the kill at which the first one was sent that is missing; 0: none is.
        readable: whether it can be read, with nothing in it but what was sent.
        victim: "session" or "receiver".
        outlived: s for which the other one went on.
    """

    after: float
    sent: int
    recorded: int
    missing: float
    readable: bool
    victim: str = "session"
    outlived: float = 0.0

    @property
    def good(self) -> bool:
        """Whether it kept what was promised."""
        return self.readable and self.missing <= ALLOWED and self.outlived <= OUTLIVES


class Player(threading.Thread):
    """Sends a flight to a port in real time, and notes when.

    Attributes:
        sent: (time, frame) so far, s of `time.monotonic`.
    """

    def __init__(self, flight: Path, port: int) -> None:
        super().__init__(daemon=True)
        self.sent: list[tuple[float, bytes]] = []
        self.ended = threading.Event()
        self._flight, self._address = flight, ("127.0.0.1", port)

    def run(self) -> None:
        """Send until it is ended."""
        began = time.monotonic()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            for t, frames in moments(TlogReader(self._flight)):
                if self.ended.wait(max(began + t - time.monotonic(), 0.0)):
                    return
                with contextlib.suppress(ConnectionError):  # a session that was killed
                    link.sendto(b"".join(frames), self._address)
                now = time.monotonic()
                self.sent += [(now, raw) for raw in frames]


def judge(
    after: float,
    killed: float,
    sent: Sequence[tuple[float, bytes]],
    recorded: Iterable[bytes],
    *,
    readable: bool,
) -> Kill:
    """Hold what was recorded against what was sent.

    Args:
        after: as of `Kill`.
        killed: s of the same clock as in `sent`.
        sent: (time, frame) of all that the session was sent.
        recorded: the frames of its recording.
        readable: as of `Kill`.
    """
    there = set(recorded)
    lost = [t for t, raw in sent if raw not in there]
    missing = killed - min(lost) if lost else 0.0
    return Kill(after, len(sent), len(sent) - len(lost), missing, readable)


def children(pid: int) -> list[int]:
    """Processes that a process has started, and that have not ended; Linux alone."""
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(child) for each in tasks for child in each.read_text().split()]


def wait_for_end(pid: int) -> float:
    """Wait until a process has ended; s that took."""
    began = time.monotonic()
    while time.monotonic() - began < _PATIENCE:
        try:
            if Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z":
                break
        except OSError:
            break
        time.sleep(0.01)
    return time.monotonic() - began


def kill_one(number: int, after: float, flight: Path, folder: Path) -> Kill:
    """Start a session, kill it so many s after it listens, and read its recording."""
    port, path = free_port(), folder / f"{number}.tlog"
    victim = "receiver" if number % 2 else "session"
    command = [sys.executable, "-m", "gcs_sysid", "live", f"udpin:127.0.0.1:{port}", "--headless"]
    player = Player(flight, port)
    with subprocess.Popen(
        [*command, "--airframe", "paper", "--record", str(path)],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        assert process.stderr is not None
        process.stderr.readline()  # it listens
        (receiver,) = children(process.pid)
        pair = (process.pid, receiver)
        player.start()
        time.sleep(after)
        killed_pid, other = pair if victim == "session" else pair[::-1]
        os.kill(killed_pid, signal.SIGKILL)
        killed = time.monotonic()
        sent = [entry for entry in list(player.sent) if entry[0] <= killed]
        outlived = wait_for_end(other)
        player.ended.set()
        process.kill()
        process.communicate()
    try:
        reader = TlogReader(path)
        frames = [frame for _, frame in reader]
    except InputError:
        # Killed before anything could be written: nothing is there to be read.
        empty = not path.exists() or not path.stat().st_size
        found = judge(after, killed, sent, (), readable=empty)
        return replace(found, victim=victim, outlived=outlived)
    sound = all(frame.valid is Validity.OK for frame in frames) and not reader.counts.garbage_bytes
    found = judge(after, killed, sent, (frame.raw for frame in frames), readable=sound)
    return replace(found, victim=victim, outlived=outlived)


def table(kills: Sequence[Kill]) -> str:
    """The figures."""
    rows = [
        ("kills", f"{len(kills)}"),
        ("readable recordings", f"{sum(kill.readable for kill in kills)}"),
        ("missing at most the last second", f"{sum(kill.missing <= ALLOWED for kill in kills)}"),
        ("frames sent", f"{sum(kill.sent for kill in kills)}"),
        ("frames recorded", f"{sum(kill.recorded for kill in kills)}"),
    ]
    for victim in ("session", "receiver"):
        of = [kill for kill in kills if kill.victim == victim]
        if not of:
            continue
        missing = sorted(kill.missing for kill in of)
        rows += [
            (f"{victim} killed", f"{len(of)}"),
            ("  missing before the kill, median", f"{missing[len(missing) // 2]:.2f} s"),
            ("  95th percentile", f"{missing[math.ceil(0.95 * len(missing)) - 1]:.2f} s"),
            ("  longest", f"{missing[-1]:.2f} s"),
            ("  the other ended after, at most", f"{max(kill.outlived for kill in of):.2f} s"),
        ]
    return "\n".join(f"{name:<34} {value:>10}" for name, value in rows)


def run(kills: int, seed: int, longest: float) -> list[Kill]:
    """Kill so many sessions."""
    rng = random.Random(seed)
    done: list[Kill] = []
    with tempfile.TemporaryDirectory(prefix="gcs-sysid-") as name:
        folder = Path(name)
        words = ("--airframe", "paper", "--mission", "hover", "--seed", str(seed))
        flight, _ = flown((*words, "--duration", str(longest + OUTLIVES)), folder)
        for number in range(kills):
            done.append(kill_one(number, rng.uniform(0.0, longest), flight, folder))
            say(f"{len(done)} of {kills}", always=len(done) % 20 == 0)
    say("")
    return done


def main(argv: Sequence[str] | None = None) -> int:
    """Kill and report; 1 when a recording did not keep what was promised."""
    parser = arguments(__doc__)
    parser.add_argument("--kills", type=int, default=100, metavar="N", help="default: 100")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="default: 1")
    parser.add_argument(
        "--longest", type=float, default=6.0, metavar="S", help="latest moment, default: 6 s"
    )
    options = parser.parse_args(argv)
    kills = run(options.kills, options.seed, options.longest)
    print(table(kills))
    return 0 if all(kill.good for kill in kills) else 1


if __name__ == "__main__":
    sys.exit(main())
