"""Spoken call-outs about a session, because a pilot's eyes are on the vehicle.

The system's speech program says them, or the bell rings; the page has a speech synthesis of its
own.
"""

import contextlib
import shutil
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

from gcs_sysid.results.snapshot import Snapshot
from gcs_sysid.screen.snapshot_view import call_outs

Mode = Literal["off", "voice", "bell"]

PROGRAMS: Mapping[str, tuple[str, ...]] = {
    "spd-say": ("--wait", "--language", "en", "--application-name", "gcs-sysid"),
    "espeak-ng": ("-v", "en"),
    "espeak": ("-v", "en"),
    "say": (),
}
"""Speech programs in order of preference, and what they are called with; the text comes last."""
_CANCEL = {"spd-say": ("--cancel",)}
"""Of a daemon, which talks on when its client is gone."""
INSTALL = "install speech-dispatcher or espeak-ng"
_GAPS = {"link": 0.0, "coach": 0.0, "time": 0.0, "verdict": 15.0}
"""Least s from one call-out to the next of a kind, in order of urgency."""
_URGENT = ("link", "coach")
"""Kinds that cut short what is being said, and ring the bell."""


class Speaker:
    """The system's speech program, one text at a time and never waited for.

    Args:
        find: where a program is, None: nowhere.
    """

    def __init__(self, find: Callable[[str], str | None] = shutil.which) -> None:
        found = {name: find(name) for name in PROGRAMS}
        self._paths = {name: path for name, path in found.items() if path is not None}
        self._running: subprocess.Popen[bytes] | None = None
        self._text = ""

    @property
    def program(self) -> str:
        """Name of the program in use, empty without one."""
        return next(iter(self._paths), "")

    @property
    def busy(self) -> bool:
        """Whether something is being said. A program that fails is given up for the next one."""
        if self._running is None:
            return False
        status = self._running.poll()
        if status is None:
            return True
        self._running = None
        if status > 0:
            self._paths.pop(self.program)
            self.say(self._text)
        return self._running is not None

    def say(self, text: str) -> None:
        """Begin to say something; what is being said is cut short."""
        self.stop()
        self._text = text
        while self.program:
            command = [self._paths[self.program], *PROGRAMS[self.program], text.lstrip("- ")]
            try:
                self._running = _start(command)
            except OSError:
                self._paths.pop(self.program)
            else:
                return

    def stop(self) -> None:
        """Be silent."""
        running, self._running = self._running, None
        if running is None or running.poll() is not None:
            return
        running.kill()
        running.wait()
        if self.program in _CANCEL:
            with contextlib.suppress(OSError, subprocess.TimeoutExpired):
                _start([self._paths[self.program], *_CANCEL[self.program]]).wait(1.0)


def _start(command: Sequence[str]) -> "subprocess.Popen[bytes]":
    silent = subprocess.DEVNULL
    # In a session of its own: Ctrl-C is not for it.
    return subprocess.Popen(
        command, stdin=silent, stdout=silent, stderr=silent, start_new_session=True
    )


class Announcer:
    """Watches snapshots and calls out what is new, as often as a listener bears.

    Args:
        speaker: says it.
        mode: how to begin: with the voice, the bell, or silent.
        ring: rings the bell.
        now: seconds that only grow.
    """

    def __init__(
        self,
        speaker: Speaker | None = None,
        mode: Mode = "off",
        ring: Callable[[], object] = lambda: None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.speaker = Speaker() if speaker is None else speaker
        self.ring = ring
        self._now = now
        self._mode: Mode = mode
        self._seen: Snapshot | None = None
        self._called: dict[str, str] = {}
        self._pending: dict[str, str] = {}
        self._last = dict.fromkeys(_GAPS, -1e9)

    @property
    def mode(self) -> Mode:
        """How it calls out; the bell where no speech program is left."""
        return "bell" if self._mode == "voice" and not self.speaker.program else self._mode

    def next_mode(self) -> str:
        """Off, voice, bell, and off again; says which it is."""
        order: list[Mode] = ["off", "voice", "bell"] if self.speaker.program else ["off", "bell"]
        self._mode = order[(order.index(self.mode) + 1) % len(order)]
        self.speaker.stop()
        self._called.clear()
        self._pending.clear()
        return self.describe()

    def describe(self) -> str:
        """The mode in words."""
        if self.mode == "voice":
            return f"Call-outs: voice ({self.speaker.program})."
        if self.mode == "bell":
            missing = "" if self.speaker.program else f"; no speech program: {INSTALL}"
            return f"Call-outs: bell{missing}."
        return "Call-outs: off."

    def see(self, snapshot: Snapshot | None) -> None:
        """Call out what is new in a snapshot, and what had to wait; returns at once."""
        if self._mode == "off" or snapshot is None:
            return
        if snapshot is not self._seen:
            self._seen = snapshot
            self._note(call_outs(snapshot))
        if self.mode == "voice" and not self.speaker.busy:
            self._say_next()

    def _note(self, found: Mapping[str, str]) -> None:
        new = {kind for kind, text in found.items() if text != self._called.get(kind, "")}
        self._called.update(found)
        for kind in new:
            self._pending.pop(kind, None)
            if found[kind]:
                self._pending[kind] = found[kind]
        if any(kind in self._pending for kind in new.intersection(_URGENT)):
            self.speaker.stop()  # an order that holds no more
            if self.mode == "bell":
                self.ring()
        if self.mode == "bell":
            self._pending.clear()

    def _say_next(self) -> None:
        now = self._now()
        for kind, gap in _GAPS.items():
            if kind in self._pending and now - self._last[kind] >= gap:
                self._last[kind] = now
                self.speaker.say(self._pending.pop(kind))
                return

    def close(self) -> None:
        """Be silent for good."""
        self._mode = "off"
        self.speaker.stop()
