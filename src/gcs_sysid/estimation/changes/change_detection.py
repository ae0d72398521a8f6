"""Alarms in flight: sequential tests on what a reference fit leaves unexplained.

Two-sided CUSUM tests run on the four residuals of a reference (`change_reference`), on two scales.
The fast one looks at every sample's jump from a short baseline (bias, trim and gusts are in both)
with a large allowance: a mass step or payload shows within three samples, a spike of one or two
does not. The slow one looks at means over a quarter of a second, less the slowly tracked mean, and
detects smaller steps. Both divide by the scatter that just such values had in the flight so far, so
that gusts and colored noise raise the level, not the alarm rate.

An alarm is not yet a change: `change_hypotheses` classifies it.

Mean and level move at frame borders only, and from whole frames: how samples are grouped into
blocks changes nothing.
"""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.changes.change_reference import (
    MAX_DELAY,
    N_X,
    TABLE,
    TOTAL,
    Reference,
    Rotors,
    body_velocity,
    form_rows,
    reference_of,
)
from gcs_sysid.estimation.changes.sequential_tests import CLIPPED, Cusum, Level, RecentMean
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.signals.records import Samples

Channel = Literal["thrust", "roll", "pitch", "yaw"]
CHANNELS: tuple[Channel, ...] = get_args(Channel)


@dataclass(frozen=True)
class ChangeTuning:
    """Settings of the tests; allowance, clip and threshold are in noise levels.

    Attributes:
        frame: s, length of the means of the slow test; level and mean move once a frame.
        warm_up: s of residuals before a channel is tested.
        memory: s over which mean and level are tracked.
        baseline: s, and samples at least, of the baseline from which the fast test sees jumps.
        fast: allowance, clip and threshold sample by sample.
        slow: the same on frame means.
        least_share: floor of the noise level, as a share of the hover's thrust or of the
            torque that all of it would make at a rotor's arm.
        silence: s after an alarm without another; then levels are those of these seconds.
    """

    frame: float = 0.25
    warm_up: float = 3.0
    memory: float = 5.0
    baseline: tuple[float, int] = (0.08, 16)
    fast: tuple[float, float, float] = (4.0, 9.0, 11.0)
    slow: tuple[float, float, float] = (3.0, 8.0, 10.0)
    least_share: float = 0.005
    silence: float = 0.4


@dataclass(frozen=True)
class Detection:
    """A detected change. Times are s of samples fed, see `ChangeDetector.seconds`.

    Attributes:
        detected: time of the newest sample used by the detection.
        onset: estimated time of the change.
        channel: where it showed first.
        size: mean jump of the residual since the onset, m/s^2 or rad/s^2.
        sigmas: the same in noise levels.
        scale: which test saw it.
    """

    detected: float
    onset: float
    channel: Channel
    size: float
    sigmas: float
    scale: Literal["fast", "slow"]


class ChangeDetector:
    """Watches flight against a reference fit.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        tuning: settings.
        motors: whether they lie between the rotors' input and thrust.
        moments: whether the angular channels can be watched: not where the gyro is filtered.
    """

    def __init__(
        self,
        geometry: Array,
        dt: float,
        tuning: ChangeTuning | None = None,
        *,
        motors: bool = False,
        moments: bool = True,
    ) -> None:
        self.dt = dt
        self.tuning = tuning = tuning or ChangeTuning()
        self.frames: list[Array] = []
        """Means over closed frames, as `Frames` makes them, until taken."""
        self._closed: list[tuple[Array, Array, Array]] = []
        """Frames whose means are still to be taken: of a block's all at once."""
        self._geometry = geometry
        self._motors, self._moments = motors, moments
        self._rotors = Rotors(dt, None)
        self._history = int(np.ceil(MAX_DELAY / dt)) + 3
        self._width = TABLE + geometry.shape[1] + 3
        self._frame = max(round(tuning.frame / dt), 4)
        self._frames_needed = max(round(tuning.warm_up / tuning.frame), 2)
        self._silence = round(tuning.silence / dt)
        self._fast = Cusum(4, *tuning.fast)
        self._slow = Cusum(4, *tuning.slow)
        self._count = 0
        self._table = np.full((self._history, self._width), np.nan)
        self._base = -self._history  # index of the table's first row
        self._next = 0  # index of the next sample to form a residual of
        self.reference = Reference(geometry, np.full((4, N_X), np.nan))
        """In force."""
        self._use(self.reference)
        self._forget()

    @property
    def seconds(self) -> float:
        """Time of the newest sample fed; the first was at 0."""
        return (self._count - 1) * self.dt

    # Views are made when needed: a copy of the detector would have them of no array of its own.
    @property
    def _e(self) -> Array:
        """(frame, 4) residuals of the frame that fills."""
        return self._both[:, :4]

    @property
    def _jumps(self) -> Array:
        """(frame, 4) their jumps."""
        return self._both[:, 4:]

    @property
    def _floor(self) -> Array:
        """(4,) least noise level of the residuals."""
        return self._floors[:4]

    @property
    def armed(self) -> bool:
        """Whether a reference is in force."""
        return bool(np.isfinite(self.reference.matrix).any())

    def restart(self) -> None:
        """A gap: the next sample does not join on to the last one."""
        self._table[:] = np.nan
        self._rotors.restart()
        self._fast.clear()
        self._slow.clear()

    def disarm(self) -> None:
        """Drop the reference and the levels found with it."""
        self._use(Reference(self._geometry, np.full((4, N_X), np.nan)))
        self._forget()

    def arm(self, fit: Fit) -> bool:
        """Use a fit as the reference where it is good enough; noise levels are kept.

        Returns:
            Whether anything is monitored now.
        """
        found = reference_of(
            fit, self._geometry, self.dt, motors=self._motors, moments=self._moments
        )
        before = self.reference
        matrix = found.matrix.copy()
        # A channel that was watched already stays so, with the reference it had.
        keep = ~found.watched
        matrix[keep] = before.matrix[keep]
        new = ~before.watched
        moved = np.where(new[:, None], 0.0, before.matrix - np.where(keep[:, None], 0.0, matrix))
        moved[keep] = 0.0
        # What the new reference explains otherwise on average is no jump of the vehicle.
        self._levels.mean[:4] += moved @ self._mean_x
        self._baseline.last += moved @ self._mean_x
        self._e[:] += self._x @ moved.T
        self._levels.forget(np.tile(new, 2))
        self._baseline.last[new] = np.nan
        self._level_of_means.forget(new)
        kept = replace(found, shift=before.shift, actuator=before.actuator)
        self._use(replace(kept if keep.all() else found, matrix=matrix))
        return self.armed

    def update(self, samples: Samples) -> list[Detection]:
        """Take a block of samples; the alarms in it."""
        speeds = self._rotors.update(samples.speeds)
        rows = np.column_stack(
            [samples.gyro, samples.rates, samples.force[:, 2], speeds, body_velocity(samples)]
        )
        self._count += len(rows)
        self._table = np.concatenate([self._table, rows])
        found: list[Detection] = []
        shift = self.reference.shift
        late = max(int(np.ceil(shift)), 0)
        stop = max(self._count - late, self._next)
        if self.armed:
            at, n = self._next - 1 - self._base, stop - self._next
            y, x, _ = form_rows(self._geometry, self._table[:, :-3], at, n, shift, self.dt)
            found = self._test(y, x, self._table[at + 1 : at + 1 + n, -3:])
            # A late rotor stream makes the detection wait for it; the onset is the IMU's time.
            found = [replace(c, detected=c.detected + late * self.dt) for c in found]
            self._take_means()
        self._next = stop
        drop = max(self._next - self._history - self._base, 0)
        self._table = self._table[drop:]
        self._base += drop
        return found

    def _forget(self) -> None:
        gain = self.tuning.frame / self.tuning.memory
        self._levels = Level(8, gain)
        """Of the residuals, then of their jumps."""
        self._level_of_means = Level(4, gain)
        seconds, samples = self.tuning.baseline
        self._baseline = RecentMean(4, max(seconds / self.dt, samples))
        self._mean_x = np.zeros(N_X)
        self._filled = 0
        self._both = np.full((self._frame, 8), np.nan)
        self._x = np.zeros((self._frame, N_X))
        self._y = np.full((self._frame, 4), np.nan)
        self._air = np.full((self._frame, 3), np.nan)
        self._silent: list[Array] = []
        self._left = 0  # samples of silence to come
        self._floors = np.zeros(8)
        self._fast.clear()
        self._slow.clear()

    def _test(self, y: Array, x: Array, air: Array) -> list[Detection]:
        e = y - x @ np.nan_to_num(self.reference.matrix).T
        e[:, ~self.reference.watched] = np.nan
        found = []
        done = 0
        while done < len(e):
            if self._left:
                n = min(self._left, len(e) - done)
                self._silent.append(e[done : done + n])
                self._left -= n
                self._next += n
                done += n
                if not self._left:
                    self._settle()
                continue
            calm = self._pass_calm(e[done:], y[done:], x[done:], air[done:])
            if calm:
                done += calm
                continue
            n = min(self._frame - self._filled, len(e) - done)
            part = e[done : done + n]
            change = self._test_samples(part)
            if change is None:
                here = slice(self._filled, self._filled + n)
                self._e[here], self._x[here] = part, x[done : done + n]
                self._y[here], self._air[here] = y[done : done + n], air[done : done + n]
                self._filled += n
                self._next += n
                done += n
                if self._filled == self._frame:
                    self._filled = 0
                    change = self._close_frame()
            else:
                n = round(change.detected / self.dt) - self._next + 1
                self._next += n
                done += n
            if change is not None:
                found.append(change)
                self._fast.clear()
                self._slow.clear()
                self._filled, self._left = 0, self._silence
        return found

    def _pass_calm(self, e: Array, y: Array, x: Array, air: Array) -> int:
        """Take whole frames in which nothing is clipped, missing or near an alarm.

        What `_test_samples` and `_close_frame` do, at once but for the levels, which follow each
        other. The first frame of another kind is theirs.

        Returns:
            Samples taken.
        """
        size, levels, means = self._frame, self._levels, self._level_of_means
        k = min(len(e) // size, 16)
        n = k * size
        e, x = e[:n], x[:n]
        if self._filled or not k or not (x[:, TOTAL] > 0.0).all() or not self._mean_x.any():
            return 0
        if not (self._tested(levels).all() and self._tested(means).all()):
            return 0
        if self._fast.rising.any() or self._slow.rising.any():
            return 0
        before = self._baseline.ahead(e)
        both = np.concatenate([e, e - before[:-1]], axis=1).reshape(k, size, 8)
        if not np.isfinite(both.sum()):
            return 0
        top, low = both.max(axis=1), both.min(axis=1)
        mean = both.mean(axis=1)
        square = np.einsum("knc,knc->kc", both, both) / size
        mean_x = x.reshape(k, size, -1).mean(axis=1)
        gain = self.tuning.frame / self.tuning.memory
        most, most_of_mean = min(CLIPPED, self.tuning.fast[0]), self.tuning.slow[0]
        for i in range(k):
            reach = most * levels.std(self._floors)
            if (top[i] - levels.mean > reach).any() or (levels.mean - low[i] > reach).any():
                break
            moved = self._mean_x + gain * (mean_x[i] - self._mean_x)
            floors = moved[TOTAL] * self._least
            away, floor = mean[i, :4] - levels.mean[:4], 0.5 * floors[:4]
            if (np.abs(away) > most_of_mean * means.std(floor)).any():
                break
            self._mean_x, self._floors = moved, floors
            means.move(away, away * away)
            means.mean[:] = 0.0
            levels.move(mean[i], square[i])
            levels.mean[4:] = 0.0
        else:
            i = k
        n = i * size
        self._baseline.last = before[n].copy()
        self._closed += [
            (y[at : at + size], x[at : at + size], air[at : at + size]) for at in range(0, n, size)
        ]
        self._next += n
        return n

    def _settle(self) -> None:
        """After an alarm: go on from what the residuals are now, with the scatter they had."""
        e = np.concatenate(self._silent)
        self._silent = []
        e = e[len(e) // 2 :]
        least = self.tuning.slow[0] * self._level_of_means.std(0.5 * self._floor)
        for c in range(4):
            there = e[np.isfinite(e[:, c]), c]
            if 2 * len(there) <= len(e):
                continue
            middle = float(np.median(there))
            if abs(middle - self._levels.mean[c]) > least[c]:
                self._levels.mean[c] = middle
            self._baseline.last[c] = middle

    def _tested(self, level: Level) -> Mask:
        return np.asarray(level.frames >= self._frames_needed)

    def _test_samples(self, e: Array) -> Detection | None:
        stds, levels = self._levels.std(self._floors), self._levels
        limit = self.tuning.fast[1] * stds[:4]
        limit[levels.frames[:4] == 0] = np.inf
        mean = levels.mean[:4]
        jumps = e - self._baseline.update(e, mean - limit, mean + limit)
        self._jumps[self._filled : self._filled + len(e)] = jumps
        ready = self._tested(levels)[4:]
        if not ready.any():
            return None
        std = stds[4:]
        z = (
            jumps / std
            if ready.all()
            else np.where(ready, jumps / np.where(ready, std, 1.0), np.nan)
        )
        alarm = self._fast.update(z, self._next)
        if alarm is None:
            return None
        row, c, began = alarm
        first = began - self._next
        # It may have begun in samples taken before; then those of this frame alone count.
        begin = max(self._filled + first, 0)
        sigmas = float(np.nanmedian(self._jumps[begin : self._filled + row + 1, c]) / std[c])
        return Detection(
            detected=(self._next + row) * self.dt,
            onset=began * self.dt,
            channel=CHANNELS[c],
            size=sigmas * float(std[c]),
            sigmas=sigmas,
            scale="fast",
        )

    def _close_frame(self) -> Detection | None:
        """Test the frame's mean, then let mean and levels move."""
        total = self._e.sum(axis=0)
        if np.isfinite(total.sum()):
            mean = total / self._frame - self._levels.mean[:4]
        else:
            there = np.isfinite(self._e)
            count = there.sum(axis=0)
            total = np.where(there, self._e, 0.0).sum(axis=0)
            enough = 2 * count > self._frame
            mean = np.where(enough, total / np.maximum(count, 1), np.nan)
            mean -= self._levels.mean[:4]
        self._closed.append((self._y.copy(), self._x.copy(), self._air.copy()))
        self._move_floor()
        # A frame's mean of white noise is this much quieter; color keeps it louder.
        floor = 0.5 * self._floor
        std = self._level_of_means.std(floor)
        ready = self._tested(self._level_of_means)
        z = np.where(ready, mean / np.where(ready, std, 1.0), np.nan)
        alarm = self._slow.update(z[None], self._next)
        if alarm is not None:
            _, c, began = alarm
            return Detection(
                detected=(self._next - 1) * self.dt,
                onset=(began - self._frame) * self.dt,
                channel=CHANNELS[c],
                size=float(mean[c]),
                sigmas=float(z[c]),
                scale="slow",
            )
        # While a deviation builds up in a sum, level and mean are frozen: it alarms, or decays.
        learn = ~self._slow.rising
        # The mean of the means is zero by the tracking: only their scatter is estimated.
        usable = learn & (self._levels.frames[:4] >= 2)
        self._level_of_means.update(np.where(usable, mean, np.nan)[None], floor)
        self._level_of_means.mean[:] = 0.0
        if not learn.all():
            self._e[:, ~learn] = np.nan
        self._levels.update(self._both, self._floors)
        self._levels.mean[4:] = 0.0
        return None

    def _take_means(self) -> None:
        """(4 + N_X + 3,) means of each closed frame; NaN where half of it is missing."""
        if not self._closed:
            return
        y, x, air = (np.stack(parts) for parts in zip(*self._closed, strict=True))
        self._closed = []
        rows = np.maximum(np.isfinite(y).any(axis=2).sum(axis=1), 1)
        self.frames += [
            *np.concatenate([_mean(y), x.sum(axis=1) / rows[:, None], _mean(air)], axis=1)
        ]

    def _move_floor(self) -> None:
        """The mean inputs, and the levels that nothing real stays below."""
        present = self._x[:, TOTAL] > 0.0
        count = np.count_nonzero(present)
        if 2 * count > self._frame:
            gain = 1.0 if not self._mean_x.any() else self.tuning.frame / self.tuning.memory
            x = self._x if count == self._frame else self._x[present]
            self._mean_x += gain * (x.sum(axis=0) / count - self._mean_x)
        self._floors = self._mean_x[TOTAL] * self._least

    def _use(self, reference: Reference) -> None:
        self.reference = reference
        self._rotors.actuator = reference.actuator
        self._least = self.tuning.least_share * np.tile(reference.floors(1.0), 2)


def _mean(values: Array) -> Array:
    """(frames, width) of (frames, n, width)."""
    there = np.isfinite(values)
    count = there.sum(axis=1)
    mean: Array = np.where(there, values, 0.0).sum(axis=1) / np.maximum(count, 1)
    mean[2 * count <= values.shape[1]] = np.nan
    return mean
