"""Frames of a link wait, unread, until the vehicle's clock has passed a tick of the chain.

Before that they change nothing that anybody sees, and reading a few at a time costs as much as
reading all of a tenth of a second at once. How long they wait changes no number.
"""

from collections.abc import Callable, Iterable

import numpy as np

from gcs_sysid.signals.columns import RecordBlock
from gcs_sysid.telemetry.frame_block import FrameBlock
from gcs_sysid.telemetry.frames import Frame
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.message_table import INERTIAL, MESSAGES, STAMP_FIELDS, Stamp
from gcs_sysid.telemetry.messages import MESSAGE_IDS, field_bytes
from gcs_sysid.telemetry.outgoing import OWN_SYSTEM

_AWAITED = frozenset(MESSAGE_IDS[name] for name in ("HEARTBEAT", "PARAM_VALUE", "MESSAGE_INTERVAL"))
"""Messages that are waited for: heartbeats and replies to requests."""
_Sender = tuple[int, int, int]
_STAMPS = {
    MESSAGE_IDS[message.name]: (
        field_bytes(message.name, STAMP_FIELDS[message.stamp]),
        1e-3 if message.stamp is Stamp.MS32 else 1e-6,
    )
    for message in MESSAGES
    if message.name in INERTIAL
}
"""Message -> where its stamp lies in the payload, all else of which is read later; its unit, s."""


class FrameGathering:
    """Frames that wait, and the records of those that have waited long enough.

    Args:
        intake: makes the records.
        until_tick: s of the vehicle's clock until records change what anybody sees; asked when
            frames come after those last read.
    """

    _MOST_WAITING = 1024
    """Frames that wait: those of a tenth of a second on the fastest link."""
    _LONGEST_WAIT = 0.2
    """s of the receiving computer's clock that they wait where the vehicle's gives no time."""
    _ROUNDING = 2e-6
    """s, of stamps and ticks."""

    def __init__(self, intake: Intake, until_tick: Callable[[], float]) -> None:
        self._intake = intake
        self._until_tick = until_tick
        self._frames: list[Frame] = []
        self._walls: list[float] = []
        # (sender, message) -> s, its stamp when the waiting began, and its latest.
        self._from: dict[_Sender, float] = {}
        self._latest: dict[_Sender, float] = {}
        self._wait: float | None = 0.0

    def gather(self, frames: Iterable[Frame], wall: float | None = None) -> RecordBlock:
        """Take frames in the order received.

        Args:
            frames: as they came.
            wall: when they came, s since 1970; None: not known.

        Returns:
            Records of all that waited, where it is time to read them; else none.
        """
        before = len(self._frames)
        self._frames += frames
        self._walls += [wall or 0.0] * (len(self._frames) - before)
        due = len(self._frames) >= self._MOST_WAITING
        if wall is not None and self._frames:
            due |= not 0.0 <= wall - self._walls[0] < self._LONGEST_WAIT
        if self._wait is None:
            self._wait = self._until_tick()
        awaited = [self._is_awaited(frame) for frame in self._frames[before:]]
        return self.rest() if due or any(awaited) else RecordBlock()

    def rest(self) -> RecordBlock:
        """Records of all that waited."""
        if not self._frames:
            return RecordBlock()
        frames = FrameBlock.of(self._frames, np.array(self._walls))
        self._frames, self._walls = [], []
        self._from, self._latest, self._wait = self._latest, {}, None
        return self._intake.block(frames)

    def _is_awaited(self, frame: Frame) -> bool:
        """Whether a frame ends the waiting: by its time, or by what it is."""
        stamp = _STAMPS.get(frame.message_id)
        if stamp is None:
            return frame.message_id in _AWAITED or frame.system == OWN_SYSTEM
        place, unit = stamp
        sender = frame.system, frame.component, frame.message_id
        # Zeros that are cut off at the end of a payload are the highest bytes.
        self._latest[sender] = t = unit * int.from_bytes(frame.payload[place], "little")
        wait = self._wait or 0.0
        return not 0.0 <= t - self._from.setdefault(sender, t) < wait - self._ROUNDING
