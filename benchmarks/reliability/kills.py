"""Kills a recording session at random moments, and reads what is left of each recording.

    python -m benchmarks.reliability.kills [--kills N] [--seed N] [--at-once N] [--longest S]

The emulator flies once, in real time. What it sends is passed on to headless sessions, `gcs-sysid
live` as a user runs it, with the time noted; so it is known what each of them was sent. Each is
killed with SIGKILL at a moment drawn at random after it has said that it listens: the process of
the session, by turns with that of its receiver. Once both have ended, the recording is read: whole
records, in order, and nothing missing that was sent more than a second before.
"""

import math
import multiprocessing
import os
import random
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from gcs_sysid.__main__ import main as cli_main
from gcs_sysid.errors import InputError
from gcs_sysid.telemetry.frames import FrameScanner, Validity
from gcs_sysid.telemetry.tlog import read_tlog
from testbed.study import arguments, free_port, say

ALLOWED = 1.0
"""s that may be missing before a kill."""
OUTLIVES = 5.0
"""s that the receiver may take to end, or the session that has lost it."""
_KEPT = 60.0
"""s of what was sent that are remembered."""
_PATIENCE = 120.0
"""s that a session may take to say that it listens."""
# Processes of their own, but where the system can, with the program loaded once for all.
_METHODS = multiprocessing.get_all_start_methods()
_CONTEXT = multiprocessing.get_context("forkserver" if "forkserver" in _METHODS else "spawn")


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


class Relay:
    """Passes on what the emulator sends, and notes when."""

    def __init__(self) -> None:
        self._emulator, self._sessions = (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)
        )
        for end in (self._emulator, self._sessions):
            end.bind(("127.0.0.1", 0))
        self.port: int = self._emulator.getsockname()[1]
        self._lock = threading.Lock()
        self._ports: set[int] = set()
        self._sent: deque[tuple[float, bytes]] = deque()
        self._closing = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def add(self, port: int) -> None:
        """Pass on to this port too."""
        with self._lock:
            self._ports.add(port)

    def remove(self, port: int) -> None:
        """Pass on to it no more."""
        with self._lock:
            self._ports.discard(port)

    def sent(self, since: float, until: float) -> list[tuple[float, bytes]]:
        """(time, frame) of all that was sent between two times, s of `time.monotonic`."""
        with self._lock:
            datagrams = [entry for entry in self._sent if since <= entry[0] <= until]
        scanner = FrameScanner()
        return [(t, frame.raw) for t, data in datagrams for frame in scanner.scan(data)]

    def close(self) -> None:
        """End it."""
        self._closing = True
        self._thread.join()
        self._emulator.close()
        self._sessions.close()

    def _run(self) -> None:
        vehicle = None
        while not self._closing:
            ready, _, _ = select.select([self._emulator, self._sessions], [], [], 0.1)
            if self._emulator in ready:
                data, vehicle = self._emulator.recvfrom(65536)
                with self._lock:
                    now = time.monotonic()
                    for port in self._ports:
                        self._sessions.sendto(data, ("127.0.0.1", port))
                    self._sent.append((now, data))
                    while self._sent[0][0] < now - _KEPT:
                        self._sent.popleft()
            if self._sessions in ready:
                try:
                    request = self._sessions.recv(65536)
                except ConnectionError:  # a session that was killed
                    continue
                if vehicle is not None:
                    self._emulator.sendto(request, vehicle)


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


def session(words: list[str], said: str) -> None:
    """What each process does: `gcs-sysid` with these words, what it says going to a file."""
    sys.stdout = sys.stderr = open(said, "w", encoding="utf-8")  # noqa: SIM115 - until it is killed
    sys.exit(cli_main(words))


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


def kill_one(number: int, after: float, relay: Relay, folder: Path) -> Kill:
    """Start a session, kill it so many s after it listens, and read its recording."""
    port, path, said = free_port(), folder / f"{number}.tlog", folder / f"{number}.txt"
    victim = "receiver" if number % 2 else "session"
    words = ["live", f"udpin:127.0.0.1:{port}", "--airframe", "paper", "--headless"]
    process = _CONTEXT.Process(target=session, args=([*words, "--record", str(path)], str(said)))
    process.start()
    relay.add(port)
    try:
        deadline = time.monotonic() + _PATIENCE
        while not (said.exists() and said.stat().st_size):
            if time.monotonic() > deadline or not process.is_alive():
                raise RuntimeError(f"session {number} did not say that it listens")
            time.sleep(0.01)
        assert process.pid is not None
        (receiver,) = children(process.pid)
        pair = (process.pid, receiver)
        listens = time.monotonic()
        time.sleep(after)
        killed_pid, other = pair if victim == "session" else pair[::-1]
        os.kill(killed_pid, signal.SIGKILL)
        killed = time.monotonic()
        outlived = wait_for_end(other)
    finally:
        process.kill()
        process.join()
        relay.remove(port)
    sent = relay.sent(listens, killed)
    try:
        reader = read_tlog(path)
        frames = [frame for _, frame in reader]
    except InputError:
        # Killed before anything could be written: nothing is there to be read.
        empty = not path.exists() or not path.stat().st_size
        found = judge(after, killed, sent, (), readable=empty)
        return replace(found, victim=victim, outlived=outlived)
    sound = all(frame.valid is Validity.OK for frame in frames) and not reader.garbage_bytes
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


def run(kills: int, seed: int, at_once: int, longest: float) -> list[Kill]:
    """Kill so many sessions."""
    rng = random.Random(seed)
    moments = [rng.uniform(0.0, longest) for _ in range(kills)]
    done: list[Kill] = []
    _CONTEXT.set_forkserver_preload(
        ["gcs_sysid.cli.live_command", "gcs_sysid.estimation.offline.offline"]
    )
    relay = Relay()
    with tempfile.TemporaryDirectory(prefix="gcs-sysid-") as folder:
        emulator = subprocess.Popen(
            [
                *(sys.executable, "-P", "-m", "sim_bridge", "--until-stdin-closes"),
                *("--connect", f"udpout:127.0.0.1:{relay.port}", "--airframe", "paper"),
                *("--mission", "hover", "--duration", "86400", "--seed", str(seed)),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            with ThreadPoolExecutor(at_once) as pool:
                waiting = [
                    pool.submit(kill_one, number, after, relay, Path(folder))
                    for number, after in enumerate(moments)
                ]
                for future in waiting:
                    done.append(future.result())
                    say(f"{len(done)} of {kills}", always=len(done) % 20 == 0)
        finally:
            emulator.kill()
            emulator.communicate()
            relay.close()
    say("")
    return done


def main(argv: Sequence[str] | None = None) -> int:
    """Kill and report; 1 when a recording did not keep what was promised."""
    parser = arguments(__doc__)
    parser.add_argument("--kills", type=int, default=100, metavar="N", help="default: 100")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="default: 1")
    parser.add_argument("--at-once", type=int, default=2, metavar="N", help="default: 2")
    parser.add_argument(
        "--longest", type=float, default=6.0, metavar="S", help="latest moment, default: 6 s"
    )
    options = parser.parse_args(argv)
    kills = run(options.kills, options.seed, options.at_once, options.longest)
    print(table(kills))
    return 0 if all(kill.good for kill in kills) else 1


if __name__ == "__main__":
    sys.exit(main())
