"""Frames of one vehicle -> records as columns: what `decode` does, for many frames at once.

A vehicle's clock runs on, its sensors keep their numbers and its autopilot its name: as long as
that is so, all messages of a type can be read together. `BlockDecoder.take` reads up to the
first message of which it is not so (a reboot, an outage, a wrapped stamp, the first of its
kind), and leaves that one to `decode`, whose rules alone count. Both give the same records.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gcs_sysid.arrays import Array, Mask, complete_rows
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry import rotor_messages as rotors
from gcs_sysid.telemetry.clock import JUMP_AHEAD, JUMP_BACK, UNIX_FROM, WRAP_MS, WRAP_US, may_wrap
from gcs_sysid.telemetry.decode import MILLI_G, Preference, RecordDecoder
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frame_block import FrameBlock
from gcs_sysid.telemetry.message_arrays import message_arrays
from gcs_sysid.telemetry.track_collector import TrackCollector

_ESC_TELEMETRY = tuple(rotors.ESC_TELEMETRY)
_READ = (
    "HIGHRES_IMU", "SCALED_IMU", "RAW_IMU", "ATTITUDE", "ATTITUDE_QUATERNION", "ESC_STATUS", "RPM",
    "ACTUATOR_OUTPUT_STATUS", "SERVO_OUTPUT_RAW", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT",
    *_ESC_TELEMETRY,
)  # fmt: skip
_US64 = ("HIGHRES_IMU", "RAW_IMU", "ESC_STATUS", "ACTUATOR_OUTPUT_STATUS")
_MS32 = (
    "SCALED_IMU", "ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT",
)  # fmt: skip
_ARDUPILOT = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA


@dataclass(frozen=True)
class ClockTimes:
    """The vehicle's clock over a block of frames.

    Attributes:
        order: (m,) rising numbers of the frames that tell the time.
        now: (m + 1,) s, the clock before the first of them, and after each.
    """

    order: Array
    now: Array

    def after(self, order: Array) -> Array:
        """(n,) s, the clock after the frames with these numbers."""
        now: Array = self.now[np.searchsorted(self.order, order, side="right")]
        return now


class Taken(NamedTuple):
    """How far `BlockDecoder.take` came."""

    frames: int
    """How many were read."""
    moments: ClockTimes
    """The clock over them."""
    imu_times: Array
    """(n,) s, of the IMU's samples as they came."""


class BlockDecoder(RecordDecoder):
    """A `RecordDecoder` that also takes columns."""

    def take(self, frames: FrameBlock, mine: Mask, out: TrackCollector) -> Taken:
        """Read the messages that come often, as far as nothing unusual happens.

        HEARTBEAT, EXTENDED_SYS_STATE, PARAM_VALUE and SYSTEM_TIME are not read; the caller
        decodes them one by one, with `clock.now` set to what `ClockTimes` says.

        Args:
            frames: the next frames.
            mine: (n,) bool, which are the vehicle's, with right checksums.
            out: takes the records.

        Returns:
            How far it came; nowhere while no stamp was heard.
        """
        now = self.clock.now
        if now is None:
            return Taken(0, ClockTimes(np.empty(0, int), np.array([np.nan])), np.empty(0))
        messages = message_arrays(frames, _READ, mine)
        self._choose_sensors(messages)
        stop = self._first_surprise(frames, mine, messages)
        stamps, moments, stop = self._stamps(messages, now, stop)
        for name, rows in messages.items():
            count = int(np.searchsorted(rows["_frame"], stop))
            messages[name] = rows[:count]
            if name in stamps:
                stamps[name] = stamps[name][:count]
        messages = {name: rows for name, rows in messages.items() if len(rows)}
        with np.errstate(invalid="ignore"):  # what is sent may be any kind of NaN
            imu_times = self._read_block(messages, stamps, moments, out)
        return Taken(stop - frames.number, moments, imu_times)

    def _choose_sensors(self, messages: dict[str, Array]) -> None:
        """Leave out what `decode` does not read either."""
        if "HIGHRES_IMU" in messages and self._imu_id is not None:
            imu = messages["HIGHRES_IMU"]
            messages["HIGHRES_IMU"] = _kept(imu, imu["id"] == self._imu_id)
        if "RAW_IMU" in messages:
            raw = messages["RAW_IMU"]
            messages["RAW_IMU"] = _kept(raw, (raw["id"] == 0) & (self._autopilot == _ARDUPILOT))
        if "ESC_STATUS" in messages:
            speeds = messages["ESC_STATUS"]
            messages["ESC_STATUS"] = _kept(speeds, speeds["index"] < rotors.MOST_ROTORS)
        if "SERVO_OUTPUT_RAW" in messages:
            servos = messages["SERVO_OUTPUT_RAW"]
            messages["SERVO_OUTPUT_RAW"] = _kept(servos, servos["port"] == 0)

    def _first_surprise(self, frames: FrameBlock, mine: Mask, messages: dict[str, Array]) -> int:
        """Number of the first frame that changes how others are read; else the end's."""
        orders = [frames.number + len(frames)]
        if "HIGHRES_IMU" in messages and self._imu_id is None:
            orders.append(int(messages["HIGHRES_IMU"]["_frame"][0]))
        rare = message_arrays(frames, ("HEARTBEAT", "SYSTEM_TIME"), mine)
        if "HEARTBEAT" in rare:
            beats = rare["HEARTBEAT"]
            other = beats["autopilot"] != (-1 if self._autopilot is None else self._autopilot)
            orders += beats["_frame"][other][:1].tolist()
        if "SYSTEM_TIME" in rare and self.clock.unix_minus_boot is None:
            times = rare["SYSTEM_TIME"]
            tells = (times["time_unix_usec"] * 1e-6 > UNIX_FROM) & (times["time_boot_ms"] > 0)
            orders += times["_frame"][tells][:1].tolist()
        return min(orders)

    def _stamps(
        self, messages: dict[str, Array], now: float, stop: int
    ) -> tuple[dict[str, Array], ClockTimes, int]:
        """Times of the messages that drive the clock, NaN where `decode` gives none.

        Returns:
            Message name -> times, the clock, and the first frame at which it does not run on.
        """
        stamps: dict[str, Array] = {}
        stamped = [name for name in (*_US64, *_MS32) if name in messages]
        for name in stamped:
            rows = messages[name]
            if name in _MS32:
                t = rows["time_boot_ms"] * 1e-3
                unwrapped = t + WRAP_MS * np.maximum(np.rint((now - t) / WRAP_MS), 0.0)
                stamps[name] = np.where(t > 0.0, unwrapped, np.nan)
            else:
                t = rows["time_usec"] * 1e-6
                behind = self.clock.unix_minus_boot
                since_boot = t - (np.nan if behind is None else behind)
                stamps[name] = np.where(t > UNIX_FROM, since_boot, np.where(t > 0.0, t, np.nan))
                if name == "RAW_IMU" and may_wrap(now):
                    stamps[name][rows["time_usec"] < 2**32] = np.nan  # for the time being
        none = np.empty(0)
        order = np.concatenate([none.astype(int), *(messages[name]["_frame"] for name in stamped)])
        t = np.concatenate([none, *(stamps[name] for name in stamped)])
        rows = np.flatnonzero(np.isfinite(t) & (order < stop))
        rows = rows[np.argsort(order[rows])]
        order, t = order[rows], t[rows]
        running = np.maximum.accumulate(np.append(now, t))
        before = running[:-1]
        runs_on = (t >= before - JUMP_BACK) & (t <= before + JUMP_AHEAD)
        if not runs_on.all():
            first = int(np.argmin(runs_on))
            stop = int(order[first])
            order, running = order[:first], running[: first + 1]
        moments = ClockTimes(order, running)
        if "RAW_IMU" in stamps:
            stop = self._follow_raw_imu(messages["RAW_IMU"], stamps["RAW_IMU"], moments, stop)
            count = int(np.searchsorted(order, stop))
            moments = ClockTimes(order[:count], running[: count + 1])
        return stamps, moments, stop

    def _follow_raw_imu(self, rows: Array, stamps: Array, moments: ClockTimes, stop: int) -> int:
        """Set times as `VehicleClock.stamp_us64_or_32` does; returns where that begins."""
        wraps = (rows["time_usec"] > 0) & (rows["time_usec"] < 2**32)
        if may_wrap(float(moments.now[0])):
            stamps[wraps] = _following(
                rows["time_usec"][wraps], moments.after(rows["_frame"][wraps])
            )
            return stop
        before = moments.now[np.searchsorted(moments.order, rows["_frame"])]
        first: list[int] = rows["_frame"][wraps & may_wrap(before)][:1].tolist()
        return min([stop, *first])

    def _read_block(
        self,
        messages: dict[str, Array],
        stamps: dict[str, Array],
        moments: ClockTimes,
        out: TrackCollector,
    ) -> Array:
        """Returns the times of the IMU's samples, as they came."""
        if len(moments.order):
            self.clock.run_on(float(moments.now[-1]))
        imu_times = self._read_imus(messages, stamps, out)
        self._read_attitudes(messages, stamps, out)
        self._read_velocities(messages, stamps, out)
        self._read_esc_statuses(messages, stamps, out)
        self._read_output_statuses(messages, stamps, out)
        outputs_before = self._outputs_last
        order, t = self._read_servo_outputs(messages, moments, out)
        for name in ("RPM", *_ESC_TELEMETRY):
            if name in messages:
                rows = messages[name]
                last = np.append(outputs_before, t)[np.searchsorted(order, rows["_frame"])]
                time = np.maximum(moments.after(rows["_frame"]), last)
                self._read_unstamped_rotors(name, rows, time, out)
        return imu_times

    def _give(
        self,
        out: TrackCollector,
        stream: Stream,
        order: Array,
        t: Array,
        values: Array,
        offset: int = 0,
        source: str = "",
    ) -> Mask:
        """Pass on what has a time and is finite, as `_record` does; which that are."""
        timed = np.isfinite(t)
        finite = complete_rows(values)
        if stream is Stream.IMU:
            lame = timed & ~complete_rows(values[:, 3:])
            self._drop("accelerometer not finite", lame)
            values[lame, 3:] = np.nan
            finite = complete_rows(values[:, :3])
        sound = timed & finite
        self._drop("no time", ~timed)
        self._drop("not finite", timed & ~finite)
        order, t, values = (_kept(part, sound) for part in (order, t, values))
        out.add(stream, order, t, values, offset, source)
        return sound

    def _drop(self, reason: str, rows: Mask) -> None:
        count = int(np.count_nonzero(rows))
        if count:
            self.dropped[reason] += count

    def _read_imus(
        self, messages: dict[str, Array], stamps: dict[str, Array], out: TrackCollector
    ) -> Array:
        axes = ("xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc")
        names = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU")
        allowed = _allowed(self._imu, names, messages, stamps)
        orders, times = [np.empty(0, int)], [np.empty(0)]
        for name in names:
            if name not in messages:
                continue
            rows, t = (_kept(part[name], allowed[name]) for part in (messages, stamps))
            values = _columns(rows, *axes)
            if name != "HIGHRES_IMU":
                values *= [1e-3, 1e-3, 1e-3, MILLI_G, MILLI_G, MILLI_G]
            sound = self._give(out, Stream.IMU, rows["_frame"], t, values)
            orders.append(rows["_frame"][sound])
            times.append(t[sound])
        came: Array = np.concatenate(times)[np.argsort(np.concatenate(orders))]
        return came

    def _read_attitudes(
        self, messages: dict[str, Array], stamps: dict[str, Array], out: TrackCollector
    ) -> None:
        names = ("ATTITUDE", "ATTITUDE_QUATERNION")
        if "ATTITUDE" in messages:
            angles = _columns(messages["ATTITUDE"], "roll", "pitch", "yaw")
            finite = complete_rows(angles)
            self._drop("not finite", ~finite)
            angles = angles[finite]
            messages["ATTITUDE"] = messages["ATTITUDE"][finite]
            stamps["ATTITUDE"] = stamps["ATTITUDE"][finite]
        allowed = _allowed(self._attitude, names, messages, stamps)
        parts = []
        for name in names:
            if name in messages:
                rows = messages[name][allowed[name]]
                euler = name == "ATTITUDE"
                q = _from_euler(angles) if euler else _columns(rows, "q1", "q2", "q3", "q4")
                parts.append((rows["_frame"], stamps[name][allowed[name]], q))
        if not parts:
            return
        order, t, q = (np.concatenate(column) for column in zip(*parts, strict=True))
        w, x, y, z = q.T
        norm = np.sqrt(w * w + x * x + y * y + z * z)
        sound: Mask = (norm > 0.9) & (norm < 1.1)
        self._drop("not finite", ~sound)
        rows = np.flatnonzero(sound)
        rows = rows[np.argsort(order[rows])]
        order, t, q = order[rows], t[rows], q[rows] / norm[rows, None]
        timed = np.isfinite(t)
        q[timed] = self._continue_signs(q[timed])
        self._give(out, Stream.ATTITUDE, order, t, q)

    def _continue_signs(self, q: Array) -> Array:
        """Signs such that each quaternion is close to the one before it."""
        chain = np.vstack([self._q_last, q])
        flips = np.einsum("ij,ij->i", chain[1:], chain[:-1]) < 0.0
        q = np.where(np.cumsum(flips)[:, None] % 2, -q, q)
        if len(q):
            w, x, y, z = q[-1].tolist()
            self._q_last = (w, x, y, z)
        return q

    def _read_velocities(
        self, messages: dict[str, Array], stamps: dict[str, Array], out: TrackCollector
    ) -> None:
        names = ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT")
        allowed = _allowed(self._velocity, names, messages, stamps)
        for name in names:
            if name not in messages:
                continue
            rows, t = (_kept(part[name], allowed[name]) for part in (messages, stamps))
            if name == "LOCAL_POSITION_NED":
                values = _columns(rows, "vx", "vy", "vz", "x", "y", "z")
            else:
                values = np.zeros((len(rows), 6))
                values[:, :3] = 0.01 * _columns(rows, "vx", "vy", "vz")
                values[:, 5] = -1e-3 * rows["relative_alt"]
            self._give(out, Stream.VELOCITY, rows["_frame"], t, values)

    def _read_esc_statuses(
        self, messages: dict[str, Array], stamps: dict[str, Array], out: TrackCollector
    ) -> None:
        name = "ESC_STATUS"
        if name not in messages:
            return
        rows, t = messages[name], stamps[name]
        speeds = np.abs(rows["rpm"].astype(float)) * rotors.RPM
        for first in np.unique(rows["index"]).tolist():
            some = rows["index"] == first
            order = rows["_frame"][some]
            self._give(out, Stream.ROTOR_SPEED, order, t[some], speeds[some], first, name)

    def _read_output_statuses(
        self, messages: dict[str, Array], stamps: dict[str, Array], out: TrackCollector
    ) -> None:
        name = "ACTUATOR_OUTPUT_STATUS"
        if name not in messages:
            return
        rows = messages[name]
        values, width = rotors.actuator_outputs_block(rows)
        self._give_by_width(out, name, rows["_frame"], stamps[name], values, width)

    def _read_servo_outputs(
        self, messages: dict[str, Array], moments: ClockTimes, out: TrackCollector
    ) -> tuple[Array, Array]:
        """Returns the numbers of the frames that have a time, and their times."""
        name = "SERVO_OUTPUT_RAW"
        if name not in messages:
            return np.empty(0, int), np.empty(0)
        rows = messages[name]
        now = moments.after(rows["_frame"])
        t = _following(rows["time_usec"], now)
        values, width = rotors.servo_outputs_block(rows)
        self._give_by_width(out, name, rows["_frame"], t, values, width)
        timed = np.isfinite(t)
        if timed.any():
            self._outputs_last = float(t[timed][-1])
        return rows["_frame"][timed], t[timed]

    def _give_by_width(
        self,
        out: TrackCollector,
        name: str,
        order: Array,
        t: Array,
        values: Array,
        width: Array,
    ) -> None:
        for size in np.unique(width).tolist():
            some = width == size
            self._give(
                out, Stream.ROTOR_COMMAND, order[some], t[some], values[some, :size], 0, name
            )

    def _read_unstamped_rotors(self, name: str, rows: Array, t: Array, out: TrackCollector) -> None:
        order = rows["_frame"]
        if name != "RPM":
            speeds = rows["rpm"] * rotors.RPM
            first = rotors.ESC_TELEMETRY[name]
            self._give(out, Stream.ROTOR_SPEED, order, t, speeds, first, name)
            return
        rpm = _columns(rows, "rpm1", "rpm2")
        there = ~(rpm[:, 0] < 0.0)
        second = rpm[:, 1] >= 0.0
        for some, size in ((there & second, 2), (there & ~second, 1)):
            speeds = rpm[some, :size] * rotors.RPM
            self._give(out, Stream.ROTOR_SPEED, order[some], t[some], speeds, 0, name)


def _columns(rows: Array, *names: str) -> Array:
    """(n, fields) float64 of scalar fields."""
    values = np.empty((len(rows), len(names)))
    for i, name in enumerate(names):
        values[:, i] = rows[name]
    return values


def _following(time_usec: Array, now: Array) -> Array:
    """Times of stamps that wrap, as `VehicleClock.stamp_us32`; NaN where it gives none."""
    t = time_usec * 1e-6
    t = t + WRAP_US * np.maximum(np.rint((now - t) / WRAP_US), 0.0)
    return np.where(np.abs(t - now) < JUMP_AHEAD, t, np.nan)


def _kept(rows: Array, mask: Mask) -> Array:
    """Rows of a mask, which most often is true throughout: then they are not copied."""
    kept: Array = rows if mask.all() else rows[mask]
    return kept


def _from_euler(angles: Array) -> Array:
    """(n, 4) as `model.attitude.from_euler`, to the last bit: NumPy's sines may differ there."""
    half = (0.5 * angles).T.tolist()
    (cr, sr), (cp, sp), (cy, sy) = (
        (np.array(list(map(math.cos, axis))), np.array(list(map(math.sin, axis)))) for axis in half
    )
    return np.column_stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def _allowed(
    preference: Preference,
    names: tuple[str, ...],
    messages: dict[str, Array],
    stamps: dict[str, Array],
) -> dict[str, Mask]:
    """Which messages to use of several that tell the same, named best first."""
    ranked = [
        (messages[name]["_frame"], stamps[name]) if name in messages else (np.empty(0),) * 2
        for name in names
    ]
    return dict(zip(names, preference.allows_all(ranked), strict=True))
