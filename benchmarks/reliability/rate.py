"""A fast link for minutes on one core: nothing lost, nothing late, no more memory.

    python -m benchmarks.reliability.rate [--minutes 10] [--core 1]

The emulator flies in advance, at 1 kHz HIGHRES_IMU, 500 Hz ESC_STATUS, 100 Hz ATTITUDE and
ACTUATOR_OUTPUT_STATUS, 50 Hz LOCAL_POSITION_NED and the usual rest, and writes a recording. That
is played in real time over UDP (`sim_bridge --play`) to `gcs-sysid live --headless`, which records
as it always does and runs on one core.

Lost is what was sent and is not in the tool's count, by numbers sent and by sequence numbers. The
times are those of `testbed.watched`: from the system's stamp on a datagram's arrival
until all that was handed over with it is processed, and the estimate renewed where that is due
(each 0.5 s of the vehicle's clock); the latter are told apart too. The grid stays 0.04 s behind the
newest stamp by design; that is no delay of the processor, and not counted.
"""

import os
import sys
import tempfile
from pathlib import Path

from testbed.fast_link import Run, Tool, growth, parser_of, play, rows_of_times, table
from testbed.ground_cycles import FAST, emulate, flights_in

GROWN_MB = 5.0


def main() -> None:
    """Fly, play, print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="default: 10")
    parser.add_argument("--flight", type=Path, help="play this recording instead")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        flight = options.flight
        if flight is None:
            flight = folder / "flight.tlog"
            print("flying in advance", file=sys.stderr)
            emulate(flight, rates=FAST, flights=flights_in(60.0 * options.minutes))
        before = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
        words = ["--rate", "1000", "--record", str(folder / "own.tlog")]
        tool = Tool(folder, options.core, *words, alone=options.alone)
        print("playing", file=sys.stderr)
        sent = play(flight, tool.port, None if options.core == 0 else 0, alone=options.alone)
        run = tool.end()
        recorded = (folder / "own.tlog").stat().st_size
    print(table(rows_of(run, sent)))
    print(f"recorded {1e-6 * recorded:.1f} MB; load of the machine before: {before:.1f}")


def rows_of(run: Run, sent: int) -> list[tuple[str, str, str]]:
    """The table's."""
    told, times = run.result["telemetry"], run.times
    size, grown = growth(times["memory"])
    return [
        ("length of the flight", f"{told['duration']:.0f} s", ""),
        ("messages sent", f"{sent}", ""),
        ("not received, by their number", f"{sent - told['received']}", "0"),
        ("lost, by their sequence numbers", f"{told['lost']}", "0"),
        ("dropped by the system", f"{told['receiver']['kernel_drops']}", "0"),
        ("share of one core", f"{100 * times['processor']:.0f} %", ""),
        ("  of that, the receiver", f"{100 * times['receiver']:.0f} %", ""),
        ("data that waited at most", f"{told['receiver']['longest_wait']:.2f} s", ""),
        *rows_of_times(times),
        ("memory in the last minute", f"{size:.1f} MB", ""),
        ("growth since minute 2", f"{grown:.2f} MB", f"< {GROWN_MB:.0f} MB"),
    ]


if __name__ == "__main__":
    main()
