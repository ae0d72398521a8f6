"""Immutable pictures of a running session, for screens and headless output."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any

from gcs_sysid.results.history import Acceleration, History
from gcs_sysid.results.result import Result


class LinkState(StrEnum):
    """What the link is doing, in words a pilot reads."""

    WAITING = "waiting"
    """Open, but no vehicle received yet."""
    CONNECTED = "connected"
    REPLAY = "replay"
    """No link: a recorded flight is played."""
    LOST = "lost"
    """A vehicle received before is silent now."""
    ENDED = "ended"
    """The stream ended (log read, emulator done, connection closed)."""


@dataclass(frozen=True)
class FoundVehicle:
    """A vehicle that one could choose."""

    address: tuple[int, int]
    """System and component."""
    name: str
    """Such as "PX4 quadrotor 1:1"."""
    chosen: bool = False


@dataclass(frozen=True)
class LinkStatus:
    """Health of the link to the vehicle."""

    state: LinkState
    url: str
    vehicle: str = ""
    """Such as "PX4 quadrotor 1:1"."""
    rates: dict[str, float] = field(default_factory=dict)
    """Messages a second of vehicle time over the last seconds, by message name."""
    asked: dict[str, float] = field(default_factory=dict)
    """Rates asked for by SET_MESSAGE_INTERVAL, by message name."""
    received: int = 0
    """Valid frames so far."""
    rejected: int = 0
    """Frames or bytes that failed their checksum or made no frame."""
    unknown: int = 0
    """Frames of message types that the dialect does not hold."""
    lost_percent: float = 0.0
    lost: int = 0
    """Messages of the vehicle that did not come."""
    gaps: int = 0
    """Pauses in the IMU's stream so far."""
    last_gap: float | None = None
    """s, how long the latest of them was."""
    clock_ppm: float | None = None
    """Parts per million by which the vehicle's clock is fast; None until it is known."""
    vehicles: tuple[FoundVehicle, ...] = ()
    """All that one could choose, in the order found."""
    recording: str = ""
    """Path of the recording, empty when none is made."""
    bytes_per_second: float = 0.0
    waiting: float = 0.0
    """s of data that are recorded and wait to be processed."""
    too_slow: bool = False
    """Whether so much waits that advice and renewed estimates wait too."""
    dropped: int = 0
    """Datagrams that the system dropped, not read in time."""


@dataclass(frozen=True)
class Event:
    """Something worth a line in the event log."""

    t: float
    """Seconds since the start of the session, vehicle clock."""
    text: str


@dataclass(frozen=True)
class Gain:
    """What flying an advised maneuver does to one parameter.

    Attributes:
        name: of the parameter.
        now: half its 95 % interval now, as a share of its value; None: not known at all.
        expected: the same after the maneuver.
    """

    name: str
    now: float | None
    expected: float


@dataclass(frozen=True)
class Advice:
    """What to fly next, in a pilot's words; never more than words.

    Attributes:
        manoeuvre: name in the library, empty when there is nothing left to fly.
        text: one sentence that says what to fly, how hard, how long and what for.
        seconds: how long the maneuver takes.
        progress: 0 to 1, how much of it was flown since it was advised.
        gains: the parameters that it is for, the widest first.
        enough: every interval meets the target.
        axes: the motion in a few words for each axis, such as "roll ±20° 1 Hz".
    """

    manoeuvre: str
    text: str
    seconds: float = 0.0
    progress: float = 0.0
    gains: tuple[Gain, ...] = ()
    enough: bool = False
    axes: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """For the lines of `--json`; shares as in `Gain`."""
        return {name: value for name, value in asdict(self).items() if name != "axes"}


def speed_text(speed: float) -> str:
    """A replay's speed in words: `10x`, `max`."""
    return "max" if math.isinf(speed) else f"{speed:g}x"


@dataclass(frozen=True)
class Playback:
    """Where the replay of a recorded flight stands."""

    position: float
    """s of the vehicle's clock since the first record."""
    duration: float
    """s from the first record to the last."""
    speed: float
    """Seconds of the flight in one second; infinite: as fast as it can."""
    paused: bool = False
    seeking: float | None = None
    """s, where it is on its way to; None: nowhere."""
    ended: bool = False


@dataclass(frozen=True)
class Snapshot:
    """One instant of a running session. Nothing in it changes afterwards."""

    t: float
    """Seconds since the first record, vehicle clock."""
    used_seconds: float
    """Seconds of flight used by the estimate."""
    flying: bool
    result: Result
    history: History
    link: LinkStatus
    attitude: tuple[float, float, float] | None = None
    """Roll, pitch, yaw in rad, from the complementary filter."""
    rates: tuple[float, float, float] | None = None
    """Body rates p, q, r in rad/s."""
    rotor_speeds: tuple[float, ...] = ()
    """rad/s, or commands of 0 to 1 where those are the input; motor order."""
    acceleration: Acceleration | None = None
    """Of the last seconds; None while nothing can be predicted."""
    target: float = 0.02
    """Half the 95 % interval, as a share of its value, that every parameter is to reach."""
    events: tuple[Event, ...] = ()
    """The latest last; at most a few hundred are kept."""
    advice: Advice | None = None
    """What to fly next; None while it is unknown or not asked for."""
    playback: Playback | None = None
    """Of a replay."""
    health: Mapping[str, Any] | None = None
    """A health file's content, by the last minutes of hover; None before the first look."""
