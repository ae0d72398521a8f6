"""MAVLink 2 signing: the key, the time of what is signed, checks of what comes.

A signature is a link number, a time in units of 10 us since 2015, and the first 6 bytes of
SHA-256 over key, frame, link number and time. The time of a sender never goes back, which
distinguishes a repeated frame from a new one.

The key itself is never sent: SETUP_SIGNING cannot pass `outgoing.Gate`.
"""

import hashlib
import hmac
import os
import re
import time
from collections import Counter
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path

from gcs_sysid.errors import InputError
from gcs_sysid.files import MOST_BYTES_OF_TEXT, read_bytes, read_text
from gcs_sysid.telemetry.frames import SIGNATURE, Frame, Validity
from gcs_sysid.telemetry.messages import MESSAGE_IDS

KEY_SIZE = hashlib.sha256().digest_size
EPOCH = 1_420_070_400
"""s since 1970 of 2015-01-01, where the time of signatures begins."""
UNITS = 100_000
"""Of the time of signatures, a second."""
LARGEST_TIME = 2**48 - 1

_RADIO_STATUS = MESSAGE_IDS["RADIO_STATUS"]
_HEX = re.compile(rb"[0-9a-fA-F]{64}")


def read_key(path: Path | str) -> bytes:
    """Read a key file: 32 bytes, 64 hexadecimal digits, or a line with a passphrase.

    A passphrase becomes a key by SHA-256, as in QGroundControl, Mission Planner and MAVProxy.
    A file of 32 bytes is taken as the key itself, unless it is a line of text.

    Raises:
        InputError: the file cannot be read, or there is no key in it.
    """
    data = read_bytes(Path(path), "the signing key", MOST_BYTES_OF_TEXT)
    line = data.strip()
    if len(data) == KEY_SIZE and not (data.endswith(b"\n") and _is_text(line)):
        return data
    if _HEX.fullmatch(line):
        return bytes.fromhex(line.decode("ascii"))
    if not line or not _is_text(line):
        raise InputError(
            f"no signing key in {path}: it must hold 32 bytes, 64 hexadecimal digits "
            "or one line with a passphrase"
        )
    return hashlib.sha256(line).digest()


def _is_text(data: bytes) -> bool:
    try:
        return data.decode("utf-8").isprintable()
    except UnicodeDecodeError:
        return False


def _now() -> int:
    return max(0, int((time.time() - EPOCH) * UNITS))


class SigningClock:
    """The time of signatures on our side: it follows the wall clock and never goes back.

    The last time lies in a small file beside the key, because the wall clock of a computer in
    the field may be set back between two sessions. A vehicle would then refuse every frame.

    Args:
        state: that file; None keeps nothing.
        now: the wall clock, in units since 2015.

    Attributes:
        time: the latest, in units since 2015.
        problem: one line when the file cannot be written, else "".
    """

    RESERVED = 60 * UNITS
    """How far ahead of the last frame the state file is written, so that even a kill -9 cannot let
    the time go back."""
    OLDEST_START = 60 * UNITS
    """A sender not received before may be this far behind our own time, as the protocol says."""

    def __init__(self, state: Path | None = None, now: Callable[[], int] = _now) -> None:
        self.problem = ""
        self._state = state
        self._now = now
        self._reserved = 0
        kept = _read_state(state)
        self.time = max(now(), kept)
        self._received = max(0, kept - self.RESERVED)

    def next_time(self) -> int:
        """The time for one more frame, later than any before."""
        self.time = min(max(self.time + 1, self._now()), LARGEST_TIME)
        if self.time >= self._reserved:
            self._reserved = self.time + self.RESERVED
            self._write(self._reserved)
        return self.time

    def received(self, stamp: int) -> None:
        """Take the time of an accepted frame: never be behind it."""
        self._received = max(self._received, stamp)
        self.time = max(self.time, stamp)

    @property
    def oldest_start(self) -> int:
        """The earliest time accepted of a sender not received before."""
        return max(self._now(), self._received) - self.OLDEST_START

    def close(self) -> None:
        """Write the exact time where one was written ahead."""
        if self._reserved:
            self._write(self.time)

    def _write(self, stamp: int) -> None:
        if self._state is None:
            return
        part = self._state.with_name(self._state.name + ".part")
        try:
            part.write_text(f"{stamp}\n", encoding="ascii")
            os.replace(part, self._state)
        except OSError as error:
            self._state = None
            self.problem = (
                f"cannot keep the time of signatures ({error.strerror}): should this computer's "
                "clock be set back, the vehicle will refuse its requests"
            )


def _read_state(state: Path | None) -> int:
    """The time kept; 0 where there is none or the file is damaged."""
    try:
        text = read_text(state, "the time").strip() if state else ""
    except InputError:
        return 0
    return min(int(text), LARGEST_TIME) if text.isdecimal() and len(text) < 20 else 0


class Refusal(StrEnum):
    """Why a frame is not accepted."""

    UNSIGNED = "unsigned"
    WRONG_KEY = "wrong key"
    """The signature is not right: made with another key, or the frame was changed."""
    REPLAYED = "replayed"
    """The signature is right, its time is not later than one received before."""
    TOO_OLD = "too old"
    """The signature is right; the first time received of its sender is long past."""


class SignatureCheck:
    """Decides which frames are accepted once there is a key.

    Args:
        key: 32 bytes.
        clock: our own time, which follows that of frames accepted.

    Attributes:
        refused: reason -> number of frames.
        accepted: number of frames with a right signature.
    """

    def __init__(self, key: bytes, clock: SigningClock) -> None:
        self.refused: Counter[Refusal] = Counter()
        self.accepted = 0
        self._key = key
        self._clock = clock
        self._latest: dict[tuple[int, int, int], int] = {}

    def refusal_of(self, frame: Frame) -> Refusal | None:
        """Judge one frame; None when it is accepted.

        Damaged frames pass: they are rejected and counted elsewhere. RADIO_STATUS passes unsigned,
        because radios have no key.
        """
        if frame.valid is Validity.BAD_CRC:
            return None
        refusal = self._judge(frame)
        if refusal is not None:
            self.refused[refusal] += 1
        return refusal

    def _judge(self, frame: Frame) -> Refusal | None:
        if not frame.signed:
            return None if frame.message_id == _RADIO_STATUS else Refusal.UNSIGNED
        raw = frame.raw
        # The signature first: times of forged frames must leave no trace.
        digest = hashlib.sha256(self._key + raw[:-6]).digest()
        if not hmac.compare_digest(digest[:6], raw[-6:]):
            return Refusal.WRONG_KEY
        stream = (frame.system, frame.component, raw[-SIGNATURE])
        stamp = int.from_bytes(raw[-12:-6], "little")
        latest = self._latest.get(stream)
        if latest is None and stamp < self._clock.oldest_start:
            return Refusal.TOO_OLD
        if latest is not None and stamp <= latest:
            return Refusal.REPLAYED
        self._latest[stream] = stamp
        self._clock.received(stamp)
        self.accepted += 1
        return None
