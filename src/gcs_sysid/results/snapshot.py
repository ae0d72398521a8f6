"""Immutable pictures of a running session, for screens and headless output.

The history of the estimates, how they moved over the flight, is kept in bounded memory.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.arrays import Array
from gcs_sysid.judgement.status import NOTHING
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import PARAMETERS
from gcs_sysid.results.result import Result

MAX_POINTS = 4096


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
class History:
    """How the estimates moved over time: one row an instant.

    Attributes:
        t: (n,) seconds since the start of the session, vehicle clock.
        value: name -> (n,) values, NaN where there was none.
        std: name -> (n,) standard deviations.
    """

    t: NDArray[np.float64]
    value: dict[str, NDArray[np.float64]]
    std: dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Acceleration:
    """Angular acceleration of the last seconds, as measured and as predicted.

    Attributes:
        t: (n,) seconds since the start of the session, vehicle clock.
        measured: (n, 3) about roll, pitch and yaw, rad/s^2.
        predicted: (n, 3) the same, each row by the estimate there was before it.
    """

    t: NDArray[np.float64]
    measured: NDArray[np.float64]
    predicted: NDArray[np.float64]

    @property
    def r_squared(self) -> NDArray[np.float64]:
        """(3,) share of the measured power that was predicted; NaN where nothing moved."""
        power = np.sum(self.measured**2, axis=0)
        error = np.sum((self.measured - self.predicted) ** 2, axis=0)
        share = 1.0 - np.divide(error, power, out=np.full(3, np.nan), where=power > 0.0)
        return np.asarray(share, dtype=np.float64)


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
        gains = [{"name": g.name, "now": g.now, "expected": g.expected} for g in self.gains]
        return {
            "manoeuvre": self.manoeuvre,
            "text": self.text,
            "seconds": self.seconds,
            "progress": self.progress,
            "gains": gains,
            "enough": self.enough,
        }


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


class HistoryRecorder:
    """Keeps at most `MAX_POINTS` instants: when full, every second one goes.

    What is given out are views, not copies: an instant is written once, and in the place of one
    that was given out never.
    """

    def __init__(self) -> None:
        self._t, self._numbers = _room()
        self._count = 0
        self._every = 1
        self._skipped = 0

    def append(self, t: float, values: Mapping[str, Estimate]) -> None:
        """Add an instant."""
        self._skipped += 1
        if self._skipped < self._every:
            return
        self._skipped = 0
        if self._count == MAX_POINTS:
            times, numbers = self._t, self._numbers
            self._t, self._numbers = _room()
            self._count = MAX_POINTS // 2
            self._t[: self._count] = times[::2]
            self._numbers[:, :, : self._count] = numbers[:, :, ::2]
            self._every *= 2
        self._t[self._count] = t
        for i, name in enumerate(PARAMETERS):
            value = values.get(name, NOTHING)
            self._numbers[0, i, self._count] = np.nan if value.value is None else value.value
            self._numbers[1, i, self._count] = np.nan if value.std is None else value.std
        self._count += 1

    def clear(self) -> None:
        """Forget everything."""
        self._t, self._numbers = _room()
        self._count = self._skipped = 0
        self._every = 1

    def history(self) -> History:
        """The instants so far; what is given out does not change any more."""
        t, numbers = self._t[: self._count], self._numbers[:, :, : self._count]
        t.flags.writeable = numbers.flags.writeable = False
        values, stds = numbers
        return History(
            t,
            dict(zip(PARAMETERS, values, strict=True)),
            dict(zip(PARAMETERS, stds, strict=True)),
        )


def _room() -> tuple[Array, Array]:
    """(m,) times and (2, parameters, m) values and standard deviations, none of them known."""
    return np.empty(MAX_POINTS), np.full((2, len(PARAMETERS), MAX_POINTS), np.nan)
