"""The vehicle's clock, from the stamps in its messages.

Three kinds of stamp come: 64-bit microseconds, 32-bit milliseconds (wrap after 49.7 days) and
32-bit microseconds (SERVO_OUTPUT_RAW: wrap after 71.6 minutes). All are put on one axis,
seconds since the vehicle's boot. The wall clock is not used: its drift from the vehicle's is
reported, and rejected where implausible for a clock (`judgement.received`).
"""

from dataclasses import dataclass
from enum import IntEnum, auto
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array

JUMP_BACK = 1.0
"""s. A stamp further back than this is a reboot, not reordering on the way."""
JUMP_AHEAD = 10.0
"""s. A stamp further ahead than this needs a second one that agrees: an outage of the link
looks the same as one corrupted or forged stamp."""
AGREE = 5.0
"""s. How near the second stamp must be to the first to confirm a jump."""
UNIX_FROM = 1e9
"""s. A larger stamp is Unix time: some senders give that in time_usec."""

WRAP_MS = 2**32 * 1e-3
WRAP_US = 2**32 * 1e-6
"""s between two wraps of 32-bit stamps in ms, and in us."""


def may_wrap(now: Any) -> Any:
    """Whether 32 bits of us may have wrapped when the clock says `now`, s."""
    return now > WRAP_US - JUMP_AHEAD


class Stamp(IntEnum):
    """Kind of time stamp of a message."""

    US64 = auto()
    """`time_usec`, since boot or 1970."""
    MS32 = auto()
    """`time_boot_ms`, which wraps after 49.7 days."""
    US64_OR_32 = auto()
    """`time_usec`, of which ArduPilot before 4.0 fills 32 bits."""
    US32 = auto()
    """`time_usec` in 32 bits: wraps too often to drive the vehicle's clock, and follows it."""
    NONE = auto()
    """Nothing: it is of the time of its neighbors, all that is due in one step being sent with
    the same time. ArduPilot sends SERVO_OUTPUT_RAW just before ESC_TELEMETRY and HIGHRES_IMU
    after it: the IMU's last stamp is a step old, that of a `US32` message is not."""


DRIVING = (Stamp.US64, Stamp.MS32, Stamp.US64_OR_32)
"""The stamps that drive the clock."""


class VehicleClock:
    """Follows one vehicle's clock.

    Attributes:
        now: the latest time received, s; None before the first stamp.
        reboots: how often the clock was set back for good.
    """

    def __init__(self) -> None:
        self.now: float | None = None
        self.reboots = 0
        self.unix_minus_boot: float | None = None
        """s, how far Unix time is ahead of the time since boot; None until it is known."""
        self._suspect: float | None = None

    def stamp(self, kind: Stamp, raw: int) -> float | None:
        """Time of a stamp, s; None when it is not to be believed, or while its wraps are unknown.

        32 bits of us wrap too often to drive the clock, so they only follow it; from the first wrap
        on also where their field has 64, as in RAW_IMU of ArduPilot before 4.0.
        """
        now = self.now
        wrapped = kind is Stamp.US64_OR_32 and now is not None and may_wrap(now)
        if kind is Stamp.US32 or (wrapped and 0 < raw < 2**32):
            t = self._unwrap(raw * 1e-6, WRAP_US)
            return t if now is not None and abs(t - now) < JUMP_AHEAD else None
        if not raw:
            return None
        if kind is Stamp.MS32:
            return self._follow(self._unwrap(raw * 1e-3, WRAP_MS))
        t = raw * 1e-6
        if t > UNIX_FROM:
            if self.unix_minus_boot is None:
                return None
            t -= self.unix_minus_boot
        return self._follow(t)

    def gives_unix_time(self, time_unix_usec: int, time_boot_ms: int) -> bool:
        """Whether a SYSTEM_TIME relates Unix time to time since boot, and is new.

        That is kept once known: GPS corrects Unix time in flight, and the axis must not jump.
        """
        new = self.unix_minus_boot is None
        return new and time_unix_usec * 1e-6 > UNIX_FROM and time_boot_ms > 0

    def system_time(self, time_unix_usec: int, time_boot_ms: int) -> None:
        """Set the offset of Unix time from time since boot by SYSTEM_TIME."""
        if self.gives_unix_time(time_unix_usec, time_boot_ms):
            self.unix_minus_boot = time_unix_usec * 1e-6 - time_boot_ms * 1e-3

    def follow_stamps(self, kind: Array, raw: Array, *, may_go_back: bool) -> tuple[Array, Array]:
        """Follow stamps in the order in which they came, up to one that sets the clock back.

        Args:
            kind: (n,) of `DRIVING`.
            raw: (n,) whole numbers, the stamps.
            may_go_back: whether such a one is taken where it is the first; then it is taken alone.

        Returns:
            (m,) s, the times of those that were taken, NaN where they are not to be believed;
            (m,) s, the clock after each.
        """
        t, now = np.full(len(raw), np.nan), np.full(len(raw), np.nan)
        at, single = 0, 1
        while at < len(raw):
            done = self._run_on(kind[at:], raw[at:], t[at:], now[at:])
            at += done
            # Most often one stamp is unusual, but it may be all of them.
            single = 2 * single if done < single else 1
            for row in range(at, min(at + single, len(raw))):
                before = dict(vars(self))
                time = self.stamp(Stamp(kind[row]), int(raw[row]))
                reboots = self.reboots != before["reboots"]
                if reboots and (row or not may_go_back):
                    vars(self).update(before)
                    return t[:row], now[:row]
                t[row] = np.nan if time is None else time
                now[row] = np.nan if self.now is None else self.now
                at = row + 1
                if reboots:
                    return t[:1], now[:1]
        return t, now

    def _run_on(self, kind: Array, raw: Array, t: Array, now: Array) -> int:
        """Follow stamps as far as the clock simply runs on; (n,) as of `take`, `t` and `now` s.

        Returns:
            How many that were; only of these times are set.
        """
        if self.now is None or not len(raw):
            return 0
        ms = kind == Stamp.MS32
        times = raw * np.where(ms, 1e-3, 1e-6)
        unwrapped = times + WRAP_MS * np.maximum(np.rint((self.now - times) / WRAP_MS), 0.0)
        behind = np.nan if self.unix_minus_boot is None else self.unix_minus_boot
        times = np.where(ms, unwrapped, np.where(times > UNIX_FROM, times - behind, times))
        timed = np.isfinite(times) & (raw > 0)
        rows = np.flatnonzero(timed)
        some = times[rows]
        running = np.maximum.accumulate(np.concatenate([[self.now], some]))
        before = running[:-1]
        odd = (some < before - JUMP_BACK) | (some > before + JUMP_AHEAD)
        odd |= (kind[rows] == Stamp.US64_OR_32) & may_wrap(before) & (raw[rows] < 2**32)
        if odd.any():
            first = int(np.argmax(odd))
            end, rows, running = int(rows[first]), rows[:first], running[: first + 1]
        else:
            end = len(raw)
        t[rows] = times[rows]
        now[:end] = running[np.searchsorted(rows, np.arange(end), side="right")]
        if len(rows):
            self.now, self._suspect = float(running[-1]), None
        return end

    def _unwrap(self, t: float, wrap: float) -> float:
        """Put a wrapped stamp into the turn nearest to the clock."""
        if self.now is None:
            return t
        return t + wrap * max(0, round((self.now - t) / wrap))

    def _follow(self, t: float) -> float | None:
        now = self.now
        if now is None:
            self.now = t
            return t
        if now - JUMP_BACK <= t <= now + JUMP_AHEAD:
            if t > now:
                self.now = t
            self._suspect = None
            return t
        if self._suspect is None or abs(t - self._suspect) > AGREE:
            self._suspect = t
            return None
        self._suspect = None
        self.now = t
        if t < now:
            self.reboots += 1
            self.unix_minus_boot = None
        return t


@dataclass(frozen=True)
class ClockTimes:
    """The vehicle's clock over a block of frames.

    Attributes:
        order: (m,) rising numbers of the frames with stamps.
        now: (m + 1,) s, the clock before the first of them, and after each; NaN: not known yet.
    """

    order: Array
    now: Array

    def after(self, order: Array) -> Array:
        """(n,) s, the clock after the frames with these numbers."""
        return self.now[np.searchsorted(self.order, order, side="right")]


def following(time_usec: Array, now: Array) -> Array:
    """(n,) s of stamps in 32 bits, as `VehicleClock.stamp` has them; NaN where it gives none.

    Args:
        time_usec: (n,) us.
        now: (n,) s, the clock as each came.
    """
    t = time_usec * 1e-6
    t = t + WRAP_US * np.maximum(np.rint((now - t) / WRAP_US), 0.0)
    return np.where(np.abs(t - now) < JUMP_AHEAD, t, np.nan)


class ClockDrift:
    """How fast the vehicle's clock runs against the wall clock.

    Args:
        by_gps: whether that is the time of the vehicle's own GPS receiver.

    Needs no regular or exact times: the figure is the median over pairs of moments that lie
    half of the time received apart, so that late frames and wrong stamps do not matter.
    """

    STEP = 1.0
    """s of wall time between the moments kept, at first; doubled when they become too many."""
    MOST = 1024
    LEAST_SPAN = 20.0
    """s. Over less time, the jitter of the link is larger than the drift of a clock."""

    LEAST_MOMENTS = 11
    """Fewest for `bounds`."""
    UNEVEN = 8.0
    """Bound on the slope's error, in units of the offsets' scatter about a line over the time
    received. Jitter without memory makes slopes of up to 3 times that, a clock that is set 5 times,
    and delays that wander like a random walk 5 times in one flight of ten, 9 in one of a
    hundred."""

    def __init__(self, *, by_gps: bool = False) -> None:
        self.by_gps = by_gps
        self._moments: list[tuple[float, float]] = []
        self._step = self.STEP
        self._bounds: tuple[float, float] | None = None
        self._outdated = False

    def add_moment(self, vehicle: float, wall: float) -> None:
        """Note one moment on both clocks, s."""
        moments = self._moments
        if moments:
            last_vehicle, last_wall = moments[-1]
            if vehicle < last_vehicle - JUMP_BACK:  # a reboot
                moments.clear()
                self._step = self.STEP
            elif abs(wall - last_wall) < self._step:
                return
        moments.append((vehicle, wall))
        self._outdated = True
        if len(moments) > self.MOST:
            del moments[1::2]
            self._step *= 2.0

    def add_moments(self, vehicle: Array, wall: Array) -> None:
        """Note (n,) moments, s, over which the vehicle's clock did not go back."""
        at = 0
        while at < len(wall):
            self.add_moment(float(vehicle[at]), float(wall[at]))
            far = np.abs(wall[at + 1 :] - self._moments[-1][1]) >= self._step
            if not far.any():
                return
            at += 1 + int(np.argmax(far))

    @property
    def ppm(self) -> float | None:
        """Parts per million by which the vehicle's clock is fast; None until it is known."""
        moments = self._moments
        if not moments or moments[-1][1] - moments[0][1] < self.LEAST_SPAN:
            return None
        line = self._line(np.array(moments))
        return None if line is None else 1e6 * line[0]

    @property
    def bounds(self) -> tuple[float, float] | None:
        """Parts per million between which the drift surely lies; None until that is known.

        A clock that runs wrong does so evenly. Delays that come and go, a computer's clock that
        is set and a simulator that is held up bend the line, and so far its slope is not believed.
        """
        if self._outdated:
            self._bounds, self._outdated = self._find_bounds(), False
        return self._bounds

    def _find_bounds(self) -> tuple[float, float] | None:
        if len(self._moments) < self.LEAST_MOMENTS:
            return None
        moments = np.array(self._moments) - self._moments[0]
        line = self._line(moments)
        if line is None:
            return None
        slope, span = line
        left = moments[:, 0] - (1.0 + slope) * moments[:, 1]
        scatter = float(np.quantile(np.abs(left - np.median(left)), 0.9))
        off = self.UNEVEN * scatter / span
        return 1e6 * (slope - off), 1e6 * (slope + off)

    @staticmethod
    def _line(moments: Array) -> tuple[float, float] | None:
        """How fast the vehicle's clock gains, and over how many seconds that was seen."""
        half = len(moments) // 2
        vehicle, wall = (moments[half : 2 * half] - moments[:half]).T
        on = wall > 0.0
        if not on.any():
            return None
        gains = (vehicle[on] - wall[on]) / wall[on]
        return float(np.median(gains)), 2.0 * float(np.median(wall[on]))
