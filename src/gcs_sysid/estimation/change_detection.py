"""Change detection in flight: sequential tests on what a reference fit leaves unexplained.

Four residuals a sample, each the outcome of one measured quantity minus what the fit in force
says of it, without a window that would add lag:

    thrust:            f_z + kappa sum Omega^2                     (m/s^2)
    roll, pitch, yaw:  increment of the gyro / dt - Q(theta) x     (rad/s^2, x by the trapezoid)

Two-sided CUSUM tests run on two scales. The fast one looks at every sample's jump from a short
baseline (bias, trim and gusts are in both) with a large allowance: a mass step or payload shows
within three samples, a spike of one or two does not. The slow one looks at means over a quarter
of a second, freed of the slowly tracked mean: smaller steps. Both divide by the scatter that
just such values had in the flight so far, so that gusts and coloured noise raise the level, not
the alarm rate.

Mean and level move at frame borders only, and from whole frames: how samples are grouped into
blocks changes nothing.
"""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.change_kinds import Cause, Evidence, find_cause
from gcs_sysid.estimation.online import Fit
from gcs_sysid.estimation.rotation import RotationFit
from gcs_sysid.estimation.sequential_tests import Baseline, Cusum, Level
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.samples import Samples

Channel = Literal["thrust", "roll", "pitch", "yaw"]
CHANNELS: tuple[Channel, ...] = get_args(Channel)

MIN_R_SQUARED = 0.8
MAX_INERTIA_SHARE = 0.1
"""An axis is watched when the fit explains this share of its motion and knows its inertia so."""
MAX_KAPPA_SHARE = 0.05
"""Thrust is watched when k_T / m is known to this."""


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
        after: s of residuals after a detection from which its cause is told.
        max_delay: s, largest delay of the rotor stream that can be made up for.
    """

    frame: float = 0.25
    warm_up: float = 3.0
    memory: float = 5.0
    baseline: tuple[float, int] = (0.08, 16)
    fast: tuple[float, float, float] = (4.0, 9.0, 11.0)
    slow: tuple[float, float, float] = (3.0, 8.0, 10.0)
    least_share: float = 0.005
    after: float = 0.4
    max_delay: float = 0.1


@dataclass(frozen=True)
class Change:
    """A detected change. Times are s of samples fed, see `ChangeDetector.seconds`.

    Attributes:
        detected: time of the newest sample that the detection rests on.
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
    """

    def __init__(self, geometry: Array, dt: float, tuning: ChangeTuning | None = None) -> None:
        self.dt = dt
        self.tuning = tuning = tuning or ChangeTuning()
        self.cause: Cause | None = None
        """Of the last detection, as soon as enough has been seen after it."""
        self._geometry = geometry
        self._arm = float(np.mean(np.hypot(geometry[0], geometry[1])))
        self._rotors = geometry.shape[1]
        self._history = int(np.ceil(tuning.max_delay / dt)) + 3
        self._width = 7 + self._rotors
        self._frame = max(round(tuning.frame / dt), 4)
        self._frames_needed = max(round(tuning.warm_up / tuning.frame), 2)
        self._fast = Cusum(4, *tuning.fast)
        self._slow = Cusum(4, *tuning.slow)
        self._count = 0
        self._table = np.full((self._history, self._width), np.nan)
        self._base = -self._history  # index of the table's first row
        self._next = 0  # index of the next sample to form a residual of
        self._shift = 0.0
        self._set_matrix(np.full((4, _N_X), np.nan))
        self._forget()

    @property
    def seconds(self) -> float:
        """Time of the newest sample fed; the first was at 0."""
        return (self._count - 1) * self.dt

    @property
    def armed(self) -> bool:
        """Whether a reference is in force and no detection is pending."""
        return bool(np.isfinite(self._matrix).any()) and self._evidence is None

    @property
    def deciding(self) -> bool:
        """Whether something was detected and its cause is still being told."""
        return self._evidence is not None

    def restart(self) -> None:
        """A gap: the next sample does not join on to the last one."""
        self._table[:] = np.nan
        self._fast.clear()
        self._slow.clear()

    def disarm(self) -> None:
        """Forget the reference and what was learnt with it."""
        self._set_matrix(np.full((4, _N_X), np.nan))
        self._forget()

    def arm(self, fit: Fit) -> bool:
        """Put a fit in force, as far as it is good enough; levels learnt so far are kept.

        Returns:
            Whether anything is watched now. While the cause of a detection is being told, the
            old reference stays.
        """
        if self._evidence is not None:
            return self.armed
        matrix = np.full((4, _N_X), np.nan)
        trans, rot = fit.translation, fit.rotation
        if trans is not None and 0.0 < trans.kappa_std < MAX_KAPPA_SHARE * trans.kappa:
            matrix[0] = 0.0
            matrix[0, _SUM] = -trans.kappa
        if rot is not None:
            watch = _axes_known(rot)
            Q = np.column_stack([rb.forward_matrix(rot.theta), np.zeros(3)])
            matrix[1:] = np.where(watch[:, None], Q, np.nan)
            if watch.any() and abs(rot.delay) < self.tuning.max_delay:
                # To a quarter of a sample: a finer shift gains nothing, a whole one adds no lag.
                self._shift = round(4.0 * rot.delay / self.dt) / 4.0
        # A channel that was watched already stays so, with the reference it had.
        keep = np.isnan(matrix).any(axis=1)
        matrix[keep] = self._matrix[keep]
        new = np.asarray(np.isnan(self._matrix).any(axis=1))
        moved = np.where(new[:, None], 0.0, self._matrix - np.where(keep[:, None], 0.0, matrix))
        moved[keep] = 0.0
        # What the new reference explains otherwise on average is no jump of the vehicle.
        self._levels.mean[:4] += moved @ self._mean_x
        self._baseline.last += moved @ self._mean_x
        self._e += self._x @ moved.T
        self._levels.forget(np.tile(new, 2))
        self._baseline.last[new] = np.nan
        self._level_of_means.forget(new)
        self._set_matrix(matrix)
        return self.armed

    def update(self, samples: Samples) -> list[Change]:
        """Take a block of samples; at most one change comes of an armed spell.

        After a detection the detector falls silent, tells the cause `after` seconds later, and
        waits for `arm` (a fresh estimator's fit).
        """
        rows = np.column_stack(
            [samples.gyro, samples.rates, samples.force[:, 2], samples.speeds],
        )
        self._count += len(rows)
        self._table = np.concatenate([self._table, rows])
        found: list[Change] = []
        late = max(int(np.ceil(self._shift)), 0)
        stop = max(self._count - late, self._next)
        if np.isfinite(self._matrix).any():
            y, x, squares = self._rows(self._next, stop)
            found = self._test(y - x @ np.nan_to_num(self._matrix).T, x, squares)
            # A late rotor stream makes the detection wait for it; the onset is the IMU's time.
            found = [replace(c, detected=c.detected + late * self.dt) for c in found]
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
        self._baseline = Baseline(4, max(seconds / self.dt, samples))
        self._mean_x = np.zeros(_N_X)
        self._filled = 0
        self._both = np.full((self._frame, 8), np.nan)
        self._e, self._jumps = self._both[:, :4], self._both[:, 4:]
        self._x = np.zeros((self._frame, _N_X))
        self._evidence: Evidence | None = None
        self._floors = np.zeros(8)
        self._floor = self._floors[:4]
        self._fast.clear()
        self._slow.clear()

    def _rows(self, start: int, stop: int) -> tuple[Array, Array, Array]:
        """Outputs (n, 4), inputs (n, _N_X) and squared rotor speeds (n, rotors)."""
        n = stop - start
        at = start - 1 - self._base
        imu = self._table[at : at + n + 1]
        whole = int(np.floor(self._shift))
        part = self._shift - whole
        rotor = self._table[at + whole : at + whole + n + 1, 7:]
        if part:
            later = self._table[at + whole + 1 : at + whole + n + 2, 7:]
            rotor = (1.0 - part) * rotor + part * later
        signals, H = rb.rotor_signals(self._geometry, rotor)
        rates = imu[:, 3:6]
        columns = np.column_stack(
            [signals, rb.rate_products(rates), rates, rates[:, 1] * H, rates[:, 0] * H]
        )
        x = np.empty((n, _N_X))
        x[:, : rb.N_SIGNALS - 1] = 0.5 * (columns[1:] + columns[:-1])
        x[:, rb.N_SIGNALS - 1] = np.diff(H) / self.dt
        x[:, _SUM] = signals[1:, 2]
        y = np.column_stack([imu[1:, 6], np.diff(imu[:, :3], axis=0) / self.dt])
        # Held: a channel with anything missing. Zero inputs keep the product defined.
        gone = ~np.isfinite(x).all(axis=1)
        y[gone] = np.nan
        x[gone] = 0.0
        return y, x, rotor[1:] ** 2

    def _test(self, e: Array, x: Array, squares: Array) -> list[Change]:
        e[:, np.isnan(self._matrix).any(axis=1)] = np.nan
        done = 0
        while done < len(e):
            if self._evidence is not None:
                self._gather(e[done:], x[done:], squares[done:])
                return []
            n = min(self._frame - self._filled, len(e) - done)
            part = e[done : done + n]
            change = self._test_samples(part)
            if change is None:
                here = slice(self._filled, self._filled + n)
                self._e[here], self._x[here] = part, x[done : done + n]
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
                self._start_gathering()
                self._gather(e[done:], x[done:], squares[done:])
                return [change]
        return []

    def _tested(self, level: Level) -> Mask:
        return np.asarray(level.frames >= self._frames_needed)

    def _test_samples(self, e: Array) -> Change | None:
        stds, levels = self._levels.std(self._floors), self._levels
        limit = np.where(levels.frames[:4] > 0, self.tuning.fast[1] * stds[:4], np.inf)
        mean = levels.mean[:4]
        jumps = e - self._baseline.update(e, mean - limit, mean + limit)
        self._jumps[self._filled : self._filled + len(e)] = jumps
        ready = self._tested(levels)[4:]
        if not ready.any():
            return None
        std = stds[4:]
        z = np.where(ready, jumps / np.where(ready, std, 1.0), np.nan)
        alarm = self._fast.update(z, self._next)
        if alarm is None:
            return None
        row, c, began = alarm
        first = began - self._next
        # It may have begun in samples taken before; then those of this frame alone count.
        begin = max(self._filled + first, 0)
        sigmas = float(np.nanmedian(self._jumps[begin : self._filled + row + 1, c]) / std[c])
        return Change(
            detected=(self._next + row) * self.dt,
            onset=began * self.dt,
            channel=CHANNELS[c],
            size=sigmas * float(std[c]),
            sigmas=sigmas,
            scale="fast",
        )

    def _close_frame(self) -> Change | None:
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
        self._move_floor()
        # A frame's mean of white noise is this much quieter; colour keeps it louder.
        floor = 0.5 * self._floor
        std = self._level_of_means.std(floor)
        ready = self._tested(self._level_of_means)
        z = np.where(ready, mean / np.where(ready, std, 1.0), np.nan)
        alarm = self._slow.update(z[None], self._next)
        if alarm is not None:
            _, c, began = alarm
            return Change(
                detected=(self._next - 1) * self.dt,
                onset=(began - self._frame) * self.dt,
                channel=CHANNELS[c],
                size=float(mean[c]),
                sigmas=float(z[c]),
                scale="slow",
            )
        # While a deviation builds up in a sum, it is not learnt: it alarms, or decays.
        learn = ~self._slow.rising
        # The mean of the means is zero by the tracking: only their scatter is learnt.
        usable = learn & (self._levels.frames[:4] >= 2)
        self._level_of_means.update(np.where(usable, mean, np.nan)[None], floor)
        self._level_of_means.mean[:] = 0.0
        if not learn.all():
            self._e[:, ~learn] = np.nan
        self._levels.update(self._both, self._floors)
        self._levels.mean[4:] = 0.0
        return None

    def _move_floor(self) -> None:
        """The mean inputs, and the levels that nothing real stays below."""
        present = self._x[:, _SUM] > 0.0
        count = np.count_nonzero(present)
        if 2 * count > self._frame:
            gain = 1.0 if not self._mean_x.any() else self.tuning.frame / self.tuning.memory
            x = self._x if count == self._frame else self._x[present]
            self._mean_x += gain * (x.sum(axis=0) / count - self._mean_x)
        self._floors = self._mean_x[_SUM] * self._least
        self._floor = self._floors[:4]

    def _set_matrix(self, matrix: Array) -> None:
        self._matrix = matrix
        known = np.abs(np.nan_to_num(matrix))
        least = [known[0, _SUM], 0.2 * self._arm * known[1, 0], 0.2 * self._arm * known[2, 1],
                 0.2 * known[3, 3]]  # fmt: skip
        self._least = self.tuning.least_share * np.array(2 * least)

    def _start_gathering(self) -> None:
        self.cause = None
        self._fast.clear()
        self._slow.clear()
        std = self._levels.std(self._floors)[4:]
        std[~self._tested(self._levels)[4:]] = np.inf
        self._evidence = Evidence(
            self._geometry, self._matrix[1:, : rb.N_SIGNALS], -float(self._matrix[0, _SUM]), std
        )

    def _gather(self, e: Array, x: Array, squares: Array) -> None:
        assert self._evidence is not None
        wanted = round(self.tuning.after / self.dt) - len(self._evidence)
        part = slice(0, wanted)
        self._evidence.add(e[part] - self._levels.mean[:4], x[part, : rb.N_SIGNALS], squares[part])
        if len(self._evidence) >= round(self.tuning.after / self.dt):
            self.cause = find_cause(self._evidence)
            self.disarm()


def _axes_known(rot: RotationFit) -> Mask:
    """(3,) the axes on which a fit is good enough to be held against the flight."""
    sharp = rot.std[:3] < MAX_INERTIA_SHARE * rot.theta[:3]
    return np.asarray(sharp & (rot.r_squared > MIN_R_SQUARED))


_SUM = rb.N_SIGNALS
"""Column of the instantaneous sum of squared speeds, after the forward form's inputs."""
_N_X = rb.N_SIGNALS + 1
