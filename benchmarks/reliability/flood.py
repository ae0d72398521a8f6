"""Garbage beside the vehicle on the same port: what is used of the vehicle's stream.

    python -m benchmarks.reliability.flood [--seconds 30] [--flood 50000]

A flight with everything that PX4 sends at 250 Hz is played to `gcs-sysid live --headless` in real
time, and another program sends datagrams of random bytes to the same port, from several ports of
its own: a third of them begin like frames, a tenth are frames whose checksum is wrong. The rate
that it reached is printed, not the one that was asked for.

Lost is what was sent by the vehicle and is not in the tool's count; it is compared with what the
vehicle sent while the flood lasted.
"""

import argparse
import json
import os
import random
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from testbed.fast_link import Run, Tool, parser_of, play, table
from testbed.ground_cycles import emulate
from testbed.watched import take_core

USED = 0.99
BEFORE, AFTER = 4.0, 2.0
"""s of the vehicle alone."""
PORTS = 8
_SLICE = 0.001
"""s between handfuls of the flood."""
_KINDS = 2048


def garbage(seed: int, count: int = _KINDS) -> list[bytes]:
    """Datagrams that hold no frame, though many begin like one."""
    draw = random.Random(seed)
    out = []
    for _ in range(count):
        data = bytearray(draw.randbytes(draw.randint(1, 280)))
        kind = draw.random()
        if kind < 0.3:
            data[0] = draw.choice((0xFD, 0xFE))
        elif kind < 0.4:  # HIGHRES_IMU of the vehicle, all but the checksum
            head = (0xFD, 62, 0, 0, draw.randrange(256), 1, 1, 105, 0, 0)
            data = bytearray((*head, *draw.randbytes(64)))
        out.append(bytes(data))
    return out


def flood(port: int, rate: float, seconds: float) -> int:
    """Send garbage at a rate a second; how many datagrams were sent."""
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(PORTS)]
    content = garbage(1)
    began, sent = time.monotonic(), 0
    for each in sockets:
        each.connect(("127.0.0.1", port))
    while (passed := time.monotonic() - began) < seconds:
        for _ in range(int(rate * passed) - sent):
            try:
                sockets[sent % PORTS].send(content[sent % _KINDS])
            except ConnectionError:  # the answer "nobody listens there" to an earlier one
                continue
            finally:
                sent += 1
        time.sleep(_SLICE)
    for each in sockets:
        each.close()
    return sent


def _flood_from_outside(port: int, rate: float, seconds: float, *, alone: bool) -> int:
    """The whole of the other program: begins when the vehicle has flown a while."""
    take_core(0, alone=alone)
    time.sleep(BEFORE)
    return flood(port, rate, seconds)


def main() -> None:
    """Play, flood, print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=float, default=30.0, help="of flood (default: 30)")
    parser.add_argument(
        "--flood", type=float, default=50_000.0, help="datagrams/s (default: 50000)"
    )
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.port is not None:
        sent = _flood_from_outside(
            options.port, options.flood, options.seconds, alone=options.alone
        )
        print(json.dumps(sent))
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        flight = folder / "flight.tlog"
        length = emulate(flight, rate=250.0, ground=1.0, seconds=BEFORE + options.seconds + AFTER)
        load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
        tool = Tool(folder, options.core, "--no-record", alone=options.alone)
        own = ["--port", str(tool.port), "--flood", str(options.flood)]
        own += ["--seconds", str(options.seconds), *(["--alone"] if options.alone else [])]
        flooder = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.reliability.flood", *own], stdout=subprocess.PIPE
        )
        sent = play(flight, tool.port, None if options.core == 0 else 0, alone=options.alone)
        garbage_sent = int(flooder.communicate()[0])
        run = tool.end()
    print(table(rows_of(run, sent, length, garbage_sent / options.seconds, options.seconds)))
    print(f"load of the machine before: {load:.1f}")


def rows_of(
    run: Run, sent: int, length: float, rate: float, seconds: float
) -> list[tuple[str, str, str]]:
    """The table's."""
    told = run.result["telemetry"]
    missing = sent - told["received"]
    share = 1.0 - missing / (sent * seconds / length)
    return [
        ("garbage a second, as sent", f"{rate:.0f}", ""),
        ("messages of the vehicle sent", f"{sent}", ""),
        ("not received", f"{missing}", ""),
        ("used of what it sent in the flood", f"{100 * share:.3f} %", f">= {100 * USED:.0f} %"),
        ("garbage that was read", f"{1e-6 * told['garbage_bytes']:.1f} MB", ""),
        ("with a wrong checksum", f"{told['bad_crc']}", ""),
        ("share of one core", f"{100 * run.times['processor']:.0f} %", ""),
        ("verdict", str(run.result["verdict"]), ""),
    ]


if __name__ == "__main__":
    main()
