"""From samples to what changed: alarms, and the decision on each, up to six seconds later.

With commands it takes up to 20 s until lag and thrust curve are known well enough for a reference,
and with any input 3 s more until the noise of its residuals is. Those first seconds are looked at
afterwards, on thrust alone: with kappa such that residuals before the step have no mean, and with
lag and thrust curve as far as the fit by then knows them. No single curve explains that two levels
of command carry the same weight. Where a step of all the stretch is likeliest is found on means
over 0.15 s; it is then judged as any alarm (`change_hypotheses`), among the noise that the whole
stretch shows beside the step.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.changes.change_detection import ChangeTuning, Channel, FrameTest
from gcs_sysid.estimation.changes.change_hypotheses import Classification, StepTrial, judge
from gcs_sysid.estimation.changes.change_reference import (
    N_X,
    TOTAL,
    Actuator,
    Reference,
    actuator_of,
    body_velocity,
    reference_of,
)
from gcs_sysid.estimation.changes.change_window import (
    TUNING,
    AlarmWindow,
    Frames,
    ResidualHistory,
    means,
    unexplained,
)
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.signals.records import Samples

_REMEMBERED = TUNING.before + TUNING.ages[-1] + 1.0
"""s of samples that are kept to look at alarms."""
_SETTLED = 1.0
"""s of flight before a frame from which its lagged commands are computed."""
_EARLY, _EARLY_GROWTH, _EARLY_END = 8.0, 1.45, 40.0
"""s of flight at which its unwatched beginning is first looked at, growth until it is again, and
from when on it is not: by then every flight with input on all axes has a reference."""


@dataclass
class Alarm:
    """Something that may be a change. Times are session times in s.

    Attributes:
        channel: where it showed first.
        onset: estimated.
        detected: of the newest sample used.
        reference: in force then.
        looks: how often it was looked at.
    """

    channel: Channel
    onset: float
    detected: float
    reference: Reference
    looks: int = 0


class ChangeWatch:
    """Watches one vehicle; a changed one needs another.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        changes: settings of the test.
        tuning: of the estimator whose fits are the reference.
    """

    def __init__(
        self, geometry: Array, dt: float, changes: ChangeTuning, tuning: EstimatorTuning
    ) -> None:
        self._dt, self._changes, self._tuning = dt, changes, tuning
        self._geometry = geometry
        self._part = max(round(changes.part / dt), 1)  # samples
        self._frame = changes.parts * self._part * dt  # s
        self._frames = Frames()
        self.land()

    @property
    def busy(self) -> bool:
        """Whether alarms are still to be decided on."""
        return bool(self.alarms)

    def land(self) -> None:
        """Flight has ended; levels of the next one are others."""
        self.alarms: list[Alarm] = []
        """To be decided on."""
        self.arm_at = 0.0
        """s of flight from which a better reference is wanted."""
        self._test = FrameTest(self._geometry, self._changes)
        self._t: Array = np.empty(0)
        self._samples: Samples | None = None
        """The latest samples, at these times; in the beginning all of them."""
        self._framed = 1  # of these; the first has no row
        self._last: Array = np.full(2, np.nan)
        """Of thrust's residual, medians over the last parts of a frame."""
        self._early_at = _EARLY
        self._watched: float | None = None
        """s, session time from which thrust is tested; None: not yet."""

    def restart(self) -> None:
        """A gap: what comes next does not join on to what came before."""
        self._test.clear()
        self._last = np.full(2, np.nan)
        if self._samples is not None and np.isfinite(self._samples.gyro[-1]).any():
            self._t = np.append(self._t, self._t[-1] + self._dt)
            self._samples = Samples.joined([self._samples, self._samples.gap])

    def watch(self, t: Array, samples: Samples) -> int:
        """Take samples until one completes a frame with an alarm; how many were taken.

        Args:
            t: (n,) s, session times.
            samples: n of them.
        """
        known = [] if self._samples is None else [self._samples]
        self._t, self._samples = np.append(self._t, t), Samples.joined([*known, samples])
        left = len(self._t) - self._test_frames(len(self._t) - len(t))
        if left:
            self._t, self._samples = self._t[:-left], self._samples.part(slice(-left))
        if not self._is_early:
            drop = max(min(len(self._t) - round(_REMEMBERED / self._dt), self._framed - 1), 0)
            self._t, self._samples = self._t[drop:], self._samples.part(slice(drop, None))
            self._framed -= drop
        return len(t) - left

    def _test_frames(self, least: int) -> int:
        """Test frames that are complete, up to an alarm; how many samples that needs, at least."""
        assert self._samples is not None
        reference, n = self._test.reference, len(self._t)
        parts, part = self._changes.parts, self._part
        size = parts * part
        late = max(int(np.ceil(reference.shift)), 0)
        begins = range(self._framed, n - late - size + 1, size)
        if not reference.watched.any():
            self._framed = n
        elif begins:
            first = max(self._framed - round(_SETTLED / self._dt), 0)
            near = self._samples.part(slice(first, None))
            y, x, _ = reference.rows(near, self._dt)
            rows = np.column_stack([y, x, body_velocity(near)[1:]])[self._framed - first - 1 :]
            rows = rows[: len(begins) * size]
            thrust = rows[:, 0] + reference.kappa * rows[:, 4 + TOTAL]
            levels = np.append(self._last, np.median(thrust.reshape(-1, part), axis=1))
            jumps = (levels[2:] - levels[:-2]).reshape(-1, parts)
            frames = means(rows.reshape(len(begins), size, -1), 0.5)
            for k, (begin, row) in enumerate(zip(begins, frames, strict=True)):
                began, self._framed = float(self._t[begin]), begin + size
                self._frames.add(began, row)
                self._last = levels[(k + 1) * parts : (k + 1) * parts + 2]
                alarm = self._test.update(row[:4], row[4 : 4 + N_X], jumps[k], began)
                if alarm is not None:
                    n = max(self._framed + late, least + 1)
                    self._suspect(*alarm, n)
                    break
        return n

    def _suspect(self, channel: Channel, onset: float, n: int) -> None:
        """Record an alarm after n samples; it is classified later."""
        assert self._samples is not None
        reference = self._test.reference
        if reference.watched[0]:
            seen = slice(int(np.searchsorted(self._t, onset - _SHARP - _SETTLED)), n)
            onset = _sharp(self._t[seen], self._samples.part(seen), self._dt, reference, onset)
        if any(abs(onset - alarm.onset) < TUNING.search for alarm in self.alarms):
            return
        self.alarms.append(Alarm(channel, onset, float(self._t[n - 1]), reference))
        del self.alarms[:-8]  # those looked at together

    def arm(self, fit: Fit, seconds: float, *, moments: bool) -> None:
        """Watch with a better reference, of so many s of flight; thrust alone, or moments too."""
        every, growth = self._tuning.reference_every, self._tuning.reference_growth
        self.arm_at = max(seconds + every, growth * seconds)
        known = self._geometry, self._dt, self._actuator(fit)
        self._test.arm(reference_of(fit, *known, moments=moments))
        self._last = np.full(2, np.nan)
        if self._watched is None and self._test.reference.watched[0] and len(self._t):
            self._watched = float(self._t[-1]) + self._changes.warm_up

    @property
    def _is_early(self) -> bool:
        """Whether the beginning of the flight is still to be looked at."""
        return self._early_at < _EARLY_END

    def early(self, fit: Fit) -> tuple[Alarm, Classification] | None:
        """A change before frames were tested, looked for now and then in the beginning.

        Args:
            fit: of the flight so far.
        """
        if not self._is_early or self._samples is None or self.alarms:
            return None
        start, now = float(self._t[0]), float(self._t[-1])
        if now - start < self._early_at:
            return None
        self._early_at = _EARLY_GROWTH * (now - start)
        until = now if self._watched is None else self._watched
        known = self._dt, self._geometry, self._actuator(fit), until
        found = early_change(self._t, self._samples, *known)
        return None if found is None or found[1].verdict != "changed" else found

    def _actuator(self, fit: Fit) -> Actuator | None:
        motors = self._tuning.rotor_input.motors
        return actuator_of(fit.rotation, self._tuning.curves) if motors else None

    def decided(self, now: float) -> Iterator[tuple[Alarm, Classification]]:
        """The alarms on which it is decided by now."""
        for alarm in list(self.alarms):
            if now - alarm.onset >= TUNING.ages[alarm.looks] - 0.5 * self._dt:
                found = self._judged(alarm, alarm.looks)
                alarm.looks += 1
                if found.verdict != "undecided":
                    self.alarms.remove(alarm)
                    yield alarm, found

    def undecided(self) -> tuple[Alarm, Classification] | None:
        """The first alarm that may have been a change of mass, when nothing more will come."""
        alarms, self.alarms = self.alarms, []
        for alarm in alarms:
            found = self._judged(alarm, len(TUNING.ages) - 1, decide=False)
            if found.doubtful:
                return alarm, found
        return None

    def since(self, time: float) -> Samples:
        """The samples after a session time."""
        assert self._samples is not None
        # Of a sample at that very time, rounding must not decide.
        return self._samples.part(self._t > time + 0.5 * self._dt)

    def _judged(self, alarm: Alarm, look: int, *, decide: bool = True) -> Classification:
        assert self._samples is not None
        history = self._frames.before(alarm.onset, self._frame, alarm.reference)
        first = alarm.onset - TUNING.before - 2.0 * TUNING.frame - 0.5 * self._dt
        near = slice(int(np.searchsorted(self._t, first)), None)
        return judge(
            self._t[near],
            self._samples.part(near),
            self._dt,
            alarm.reference,
            history,
            alarm.onset,
            look,
            force=alarm.channel == "thrust",
            decide=decide,
        )


_FRAME = 0.15
"""s, length of the means in which a step is looked for."""
_SHARP = 0.5
"""s around it in which its onset is found to a sample."""
LEAST_BEFORE = 10.0 * _FRAME
"""s of flight before a step that are needed: less is take-off."""
_WHOLE = replace(TUNING, frame=_FRAME, before=1e6)


def early_change(
    t: Array,
    samples: Samples,
    dt: float,
    geometry: Array,
    actuator: Actuator | None,
    until: float,
) -> tuple[Alarm, Classification] | None:
    """The likeliest step of thrust over mass in the beginning of a flight, judged.

    Args:
        t: (n,) s, session times from the beginning on, gaps marked by NaN samples.
        samples: n of them.
        dt: s between samples.
        geometry: (3, rotors) of the airframe.
        actuator: of commands; None with speeds.
        until: s, session time from which frames were tested.

    Returns:
        The step as an alarm; None where the stretch is too short, or the step in what was watched.
    """
    reference = _of_thrust(t, samples, dt, geometry, actuator, float(t[-1]))
    if reference is None:
        return None
    window = AlarmWindow(t, samples, dt, reference, float(t[-1]) + dt, _WHOLE)
    first, last = t[0] + LEAST_BEFORE, min(until, t[-1] - TUNING.ages[0])
    times = np.array([window.time_of(i) for i in range(len(window.e))])
    # With gaps the first mean may come this late: there is none before it to compare with.
    places = 1 + np.flatnonzero((times[1:] >= first) & (times[1:] <= last))
    if not len(places):
        return None
    nothing = ResidualHistory(np.full(4, np.nan), np.empty((0, 4)), window.step)
    at = StepTrial(window, reference, nothing, places.tolist()).at
    onset = _sharp(t, samples, dt, reference, window.time_of(at))
    seen = [k for k, age in enumerate(TUNING.ages) if t[-1] - onset >= age - 0.5 * dt]
    # Thrust over mass by the flight before, as of any other reference.
    before = _of_thrust(t, samples, dt, geometry, actuator, onset)
    if before is None or not seen or onset > until:
        return None
    look, history = seen[-1], _beside(window, before, at)
    near = slice(
        int(np.searchsorted(t, onset - TUNING.before - 2.0 * TUNING.frame)),
        int(np.searchsorted(t, onset + TUNING.ages[-1], side="right")),
    )
    found = judge(t[near], samples.part(near), dt, before, history, onset, look)
    if found.verdict == "changed":
        # A gust lasts for seconds, a change for all that was flown since.
        whole = judge(t, samples, dt, before, history, found.onset, look, tuning=_WHOLE)
        share_of_it, of_all = (1.0 - 1.0 / c.mass_ratio for c in (found.cause, whole.cause))
        stays = abs(of_all - share_of_it) < TUNING.agree * abs(share_of_it)
        if whole.verdict != "changed" or not stays:
            found = replace(found, verdict="disturbance")
    return Alarm("thrust", onset, float(t[-1]), before), found


def _of_thrust(
    t: Array, samples: Samples, dt: float, geometry: Array, actuator: Actuator | None, until: float
) -> Reference | None:
    """A reference of thrust alone whose mean residual is zero until some time; None: no thrust."""
    matrix = np.full((4, N_X), np.nan)
    matrix[0] = 0.0
    y, x, _ = Reference(geometry, matrix, 0.0, actuator).rows(samples, dt)
    there = np.isfinite(y[:, 0]) & (x[:, TOTAL] > 0.0) & (t[1 : 1 + len(y)] < until)
    total = float(np.sum(x[there, TOTAL]))
    kappa = -float(np.sum(y[there, 0])) / total if total > 0.0 else 0.0
    matrix[0, TOTAL] = -kappa
    return Reference(geometry, matrix, 0.0, actuator) if kappa > 0.0 else None


def _sharp(t: Array, samples: Samples, dt: float, reference: Reference, onset: float) -> float:
    """The onset to a sample: where two means leave least of the residuals around it.

    A mean across the step would count as noise.
    """
    y, x, _ = reference.rows(samples, dt)
    times = t[1 : 1 + len(y)]
    e = y[:, 0] + reference.kappa * x[:, TOTAL]
    near = np.isfinite(e) & (np.abs(times - onset) < _SHARP)
    times, e = times[near], e[near]
    n = np.arange(1, len(e))
    if not len(n):
        return onset
    sums = np.cumsum(e)[:-1]
    gain = sums**2 / n + (e.sum() - sums) ** 2 / (len(e) - n)
    return float(times[1 + int(np.argmax(gain))])


def _beside(window: AlarmWindow, reference: Reference, at: int) -> ResidualHistory:
    """What thrust's residuals did beside a step: their level before, and how they wandered."""
    e = window.y[:, 0] + reference.kappa * window.x[:, TOTAL]
    later = np.arange(len(e)) >= at
    air = np.nan_to_num(window.air)
    # Not of thrust: where it carries a vehicle in gusts, all that these do is in proportion to it.
    columns = np.column_stack([~later, later, air[:, 2], np.sum(air[:, :2] ** 2, axis=1)])
    left, level = np.full((len(e), 4), np.nan), np.full(4, np.nan)
    left[:, 0], level[0] = unexplained(e, columns), np.median(e[~later])
    left[max(at - 2, 0) : at + 2] = np.nan  # means across the step
    return ResidualHistory(level, left, window.step)
