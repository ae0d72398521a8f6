"""Spoken call-outs about a session, because a pilot's eyes are on the vehicle.

Their texts are made here for the terminal and for the page, which has its own speech synthesis. In
the terminal the system's speech program says them, or the bell rings.
"""

import contextlib
import re
import shutil
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

from gcs_sysid.results.snapshot import Advice, LinkState, Snapshot
from gcs_sysid.screen.verdict_summary import headline, level_of, standing_of

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
LAST_SECONDS = 5
"""s left of a maneuver when that is said."""
_GAPS = {"link": 0.0, "coach": 0.0, "time": 0.0, "verdict": 15.0}
"""Least s from one call-out to the next of a kind, in order of urgency."""
_URGENT = ("link", "coach")
"""Kinds that cut short what is being said, and ring the bell."""
_SPOKEN = (
    (r"±\s*", "plus or minus "), (r"°", " degrees"), (r"\bHz\b", "hertz"), (r"\s*%", " percent"),
    (r"\bI([xyz])([xyz])\b", r"I \1 \2"), (r"_", " "), (r"(\d) m\b", r"\1 meters"),
)  # fmt: skip


def spoken(text: str) -> str:
    """A text as a speech program says it right: symbols and names of parameters as words."""
    for written, said in _SPOKEN:
        text = re.sub(written, said, text)
    return text


def call_outs(snapshot: Snapshot) -> dict[str, str]:
    """What could be said now: kind -> words, empty where there is nothing to say."""
    link = {
        LinkState.CONNECTED: "Link is up.",
        LinkState.LOST: "Link lost.",
        LinkState.ENDED: "Stream ended, numbers are final.",
    }
    standing = standing_of(snapshot)
    counted = (
        snapshot.used_seconds > 0.0
        and level_of(snapshot) != "waiting"
        and snapshot.link.state is not LinkState.LOST
    )
    return {
        "link": link.get(snapshot.link.state, ""),
        "coach": "" if snapshot.advice is None else spoken(_order(snapshot.advice)),
        "time": "" if snapshot.advice is None else _time_left(snapshot.advice),
        "verdict": f"{headline(snapshot).capitalize()}, {standing.reached} of {standing.total}."
        if counted
        else "",
    }


def _order(advice: Advice) -> str:
    if advice.enough:
        return "Enough. Every interval is within the target."
    if not advice.manoeuvre:
        return ""
    return f"Fly {', '.join(advice.axes) or advice.manoeuvre}, for {advice.seconds:.0f} seconds."


def _time_left(advice: Advice) -> str:
    left = seconds_left(advice)
    return f"{LAST_SECONDS} seconds left." if 0.0 < left <= LAST_SECONDS < advice.seconds else ""


def seconds_left(advice: Advice) -> float:
    """Seconds of the maneuver that are still to be flown."""
    return max(0.0, (1.0 - advice.progress) * advice.seconds)


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
            self._take(call_outs(snapshot))
        if self.mode == "voice" and not self.speaker.busy:
            self._say_next()

    def _take(self, found: Mapping[str, str]) -> None:
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
