"""The receiver's process, which writes down when each datagram arrived; see `watched`.

python -m testbed.stamped_receiver ARRIVALS
"""

import socket
import struct
import sys
from pathlib import Path

from gcs_sysid.live import receiver_main
from gcs_sysid.telemetry.link import ReceivedBytes, UdpLink

ARRIVAL = struct.Struct("<qI")
"""Of a datagram: us since 1970 of its arrival, and its bytes."""


def main() -> int:
    """Receive, as the tool does."""
    path = Path(sys.argv[1])
    read, run = UdpLink._read, receiver_main.ReceiverMain.run
    arrivals = path.open("wb")

    def stamped(link: UdpLink, from_socket: socket.socket) -> ReceivedBytes:
        chunk = read(link, from_socket)
        arrivals.write(ARRIVAL.pack(chunk.time_us or 0, len(chunk.data)))
        return chunk

    def to_the_end(receiver: receiver_main.ReceiverMain) -> None:
        run(receiver)
        arrivals.close()

    UdpLink._read = stamped  # type: ignore[method-assign]
    receiver_main.ReceiverMain.run = to_the_end  # type: ignore[method-assign]
    return receiver_main.main()


if __name__ == "__main__":
    sys.exit(main())
