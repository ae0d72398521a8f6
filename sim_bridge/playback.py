"""Sends a recorded flight again: its frames as they are, at the pace at which they came."""

import time
from collections.abc import Iterable, Iterator

from gcs_sysid.telemetry.frames import Frame
from sim_bridge.links import Link
from sim_bridge.server import Pacing

MOST_PAUSE = 60.0
"""s. Longer pauses in a recording are shortened to this: nothing flew, or a stamp is wrong."""
_ANSWER = 0.05
"""s between checks of a listening link for a first datagram."""


def play(recording: Iterable[tuple[int, Frame]], link: Link, pace: Pacing) -> int:
    """Send all frames of a recording, of any sender, broken and unknown ones too.

    Args:
        recording: time in us and frame, as `TlogReader` gives them.
        link: to send on; what comes back is read and ignored.
        pace: as recorded, faster, or by what the other side takes.

    Returns:
        How many frames there were.

    Raises:
        LinkError: the link broke.
    """
    count = 0
    for flown, frames in moments(recording):
        pace.wait(flown)
        link.receive()
        link.send(frames, 0)
        count += len(frames)
    return count


def moments(recording: Iterable[tuple[int, Frame]]) -> Iterator[tuple[float, list[bytes]]]:
    """Frames recorded at one time, with the s since the first; time never goes back."""
    flown, last = 0.0, -1
    frames: list[bytes] = []
    for time_us, frame in recording:
        if time_us != last:
            if frames:
                yield flown, frames
                flown += min(max(1e-6 * (time_us - last), 0.0), MOST_PAUSE)
            frames, last = [], time_us
        frames.append(frame.raw)
    if frames:
        yield flown, frames


def wait_for_somebody(link: Link) -> None:
    """Wait until a link has a peer: on udpin, until something was received."""
    while not link.connected:
        link.receive()
        time.sleep(_ANSWER)
