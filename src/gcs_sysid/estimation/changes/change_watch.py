"""From samples to what changed: alarms, and the decision on each, up to six seconds later.

With commands it takes up to 20 s until lag and thrust curve are known well enough for a reference,
and with any input 3 s more until the noise of its residuals is. Those first seconds are looked at
afterwards, on thrust alone: with kappa such that residuals before the step have no mean, and with
lag and thrust curve as far as the fit by then knows them. No single curve explains that two levels
of command carry the same weight. Where a step of all the stretch is likeliest is found on means
over 0.15 s; it is then judged as any alarm (`change_hypotheses`), among the noise that the whole
stretch shows beside the step.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.changes.change_detection import ChangeDetector, ChangeTuning, Detection
from gcs_sysid.estimation.changes.change_hypotheses import Classification, judge, likeliest_step
from gcs_sysid.estimation.changes.change_reference import N_X, TOTAL, Actuator, Reference
from gcs_sysid.estimation.changes.change_window import TUNING, AlarmWindow, Frames, ResidualHistory
from gcs_sysid.estimation.fit.priors import COORDINATE_MEAN, COORDINATE_STD
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.estimation.rows.actuator_dynamics import Coordinate, LagOf
from gcs_sysid.signals.records import Samples

_REMEMBERED = TUNING.before + TUNING.ages[-1] + 1.0
"""s of samples that are kept to look at alarms."""
_BLURRED = 0.1
"""s after a change's onset that are left out where the onset is known to no more."""
_EARLY, _EARLY_GROWTH, _EARLY_END = 8.0, 1.45, 40.0
"""s of flight at which its unwatched beginning is first looked at, growth until it is again, and
from when on it is not: by then every flight with input on all axes has a reference."""


@dataclass
class Alarm:
    """Something that may be a change. Times are session times in s.

    Attributes:
        change: as detected.
        onset: estimated.
        detected: of the newest sample used.
        reference: in force then.
        looks: how often it was looked at.
    """

    change: Detection
    onset: float
    detected: float
    reference: Reference
    looks: int = 0

    def step_of(self, found: Classification) -> tuple[float, float]:
        """When the vehicle changed, and from when on samples are of the vehicle it is now."""
        if found.settled is not None:
            return found.onset, found.settled
        if self.change.scale == "fast" and abs(found.onset - self.onset) <= TUNING.frame:
            return self.onset, self.detected
        return found.onset, found.onset + _BLURRED


class ChangeWatch:
    """Watches one vehicle; a changed one needs another.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        changes: settings of the detector.
        tuning: of the estimator whose fits are the reference.
    """

    def __init__(
        self, geometry: Array, dt: float, changes: ChangeTuning, tuning: EstimatorTuning
    ) -> None:
        self._dt, self._changes, self._tuning = dt, changes, tuning
        self._geometry = geometry
        self._detector = ChangeDetector(
            geometry,
            dt,
            changes,
            motors=tuning.rotor_input.motors,
            moments=tuning.gyro_cutoff is None,
        )
        self._alarms: list[Alarm] = []
        self._recent: deque[tuple[Array, Samples]] = deque()
        self._frames = Frames()
        self._early_at = _EARLY
        self._watched: float | None = None
        """s, session time from which the detector tests thrust; None: not yet."""
        self.arm_at = 0.0
        """s of flight from which a better reference is wanted."""

    @property
    def busy(self) -> bool:
        """Whether alarms are still to be decided on."""
        return bool(self._alarms)

    def restart(self) -> None:
        """A gap: what comes next does not join on to what came before."""
        self._detector.restart()
        if self._recent and np.isfinite(self._recent[-1][1].gyro).any():
            t, samples = self._recent[-1]
            self._recent.append((t[-1:] + self._dt, gap(samples)))

    def land(self) -> None:
        """Flight has ended; levels of the next one are others."""
        self._alarms = []
        self._recent.clear()
        self._detector.disarm()
        self.arm_at = 0.0
        self._early_at, self._watched = _EARLY, None

    def watch(self, t: Array, samples: Samples, *, tentative: bool = False) -> bool:
        """Take n samples at (n,) session times.

        Args:
            t: s.
            samples: n of them.
            tentative: take none if there is an alarm in them.

        Returns:
            Whether they were taken.
        """
        known = deepcopy(self._detector) if tentative else self._detector
        found = self._detector.update(samples)
        if found and tentative:
            self._detector = known
            return False
        self._frames.add(self._detector.frames)
        self._detector.frames = []
        most = len(t) if self._is_early else round(_REMEMBERED / self._dt)
        # Longer blocks come without an alarm: their end is enough.
        self._recent.append((t[-most:], samples.part(slice(-most, None))))
        while not self._is_early and self._recent[0][0][-1] < t[-1] - _REMEMBERED:
            self._recent.popleft()
        for change in found:
            self._suspect(change, float(t[-1]))
        return True

    def _suspect(self, change: Detection, now: float) -> None:
        """Record an alarm; it is classified later."""
        start = now - self._detector.seconds
        onset, detected = start + change.onset, start + change.detected
        if any(abs(onset - alarm.onset) < TUNING.search for alarm in self._alarms):
            return
        self._alarms.append(Alarm(change, onset, detected, self._detector.reference))
        del self._alarms[:-8]  # those looked at together

    def arm(self, fit: Fit, seconds: float) -> None:
        """Watch with a better reference, of so many s of flight."""
        every, growth = self._tuning.reference_every, self._tuning.reference_growth
        self.arm_at = max(seconds + every, growth * seconds)
        self._detector.arm(fit)
        if self._watched is None and self._detector.reference.watched[0] and self._recent:
            self._watched = float(self._recent[-1][0][-1]) + self._changes.warm_up

    @property
    def _is_early(self) -> bool:
        """Whether the beginning of the flight is still to be looked at."""
        return self._early_at < _EARLY_END

    def early(self, fit: Fit) -> tuple[Alarm, Classification] | None:
        """A change before the detector could see it, looked for now and then in the beginning.

        Args:
            fit: of the flight so far.
        """
        if not self._is_early or not self._recent or self._alarms:
            return None
        start, now = float(self._recent[0][0][0]), float(self._recent[-1][0][-1])
        if now - start < self._early_at:
            return None
        self._early_at = _EARLY_GROWTH * (now - start)
        motors = self._tuning.rotor_input.motors
        actuator = actuator_of(fit.rotation, self._tuning.curves) if motors else None
        t, samples = self._remembered()
        until = now if self._watched is None else self._watched
        found = early_change(t, samples, self._dt, self._geometry, actuator, until)
        if found is None or found[1].verdict != "changed":
            return None
        change, judgement = found
        change = replace(
            change,
            onset=change.onset + start,
            detected=change.detected + start,
        )
        return Alarm(change, change.onset, change.detected, self._detector.reference), judgement

    def decided(self, now: float) -> Iterator[tuple[Alarm, Classification]]:
        """The alarms on which it is decided by now."""
        for alarm in list(self._alarms):
            if now - alarm.onset >= TUNING.ages[alarm.looks] - 0.5 * self._dt:
                found = self._judged(alarm, alarm.looks, now)
                alarm.looks += 1
                if found.verdict != "undecided":
                    self._alarms.remove(alarm)
                    yield alarm, found

    def undecided(self) -> tuple[Alarm, Classification] | None:
        """The first alarm that may have been a change of mass, when nothing more will come."""
        alarms, self._alarms = self._alarms, []
        if self._recent:
            now = float(self._recent[-1][0][-1])
            for alarm in alarms:
                found = self._judged(alarm, len(TUNING.ages) - 1, now, decide=False)
                if found.doubtful:
                    return alarm, found
        return None

    def since(self, time: float) -> list[Samples]:
        """The samples after a session time."""
        time += 0.5 * self._dt  # of a sample at that very time, rounding must not decide
        return [part.part(t > time) for t, part in self._recent if t[-1] > time]

    def _remembered(self) -> tuple[Array, Samples]:
        parts = self._recent
        return np.concatenate([t for t, _ in parts]), _joined([samples for _, samples in parts])

    def _judged(
        self, alarm: Alarm, look: int, now: float, *, decide: bool = True
    ) -> Classification:
        history = self._frames.before(now - alarm.onset, self._changes.frame, alarm.reference)
        t, samples = self._remembered()
        first = alarm.onset - TUNING.before - 2.0 * TUNING.frame - 0.5 * self._dt
        start = int(np.searchsorted(t, first))
        return judge(
            t[start:],
            samples.part(slice(start, None)),
            self._dt,
            alarm.reference,
            history,
            alarm.onset,
            look,
            force=alarm.change.channel == "thrust",
            decide=decide,
        )


def _joined(parts: Sequence[Samples]) -> Samples:
    """One block of many."""
    signals = zip(*(part.signals for part in parts), strict=True)
    return Samples(*(np.concatenate(signal) for signal in signals))


def gap(samples: Samples) -> Samples:
    """One missing sample."""
    return Samples(*(np.full_like(signal[:1], np.nan) for signal in samples.signals))


_FRAME = 0.15
"""s, length of the means in which a step is looked for."""
_SHARP = 0.5
"""s around it in which its onset is found to a sample."""
LEAST_BEFORE = 10.0 * _FRAME
"""s of flight before a step that are needed: less is take-off."""
_WHOLE = replace(TUNING, frame=_FRAME, before=1e6)


def actuator_of(fit: RotationFit | None, curves: tuple[float, ...]) -> Actuator:
    """Lag and thrust curve by a fit, as far as it knows them better than they ordinarily are.

    Args:
        fit: to commands; None while there is none.
        curves: least and greatest thrust curve; one value is given.
    """
    mean, std = COORDINATE_MEAN.copy(), COORDINATE_STD.copy()
    if len(curves) == 1:
        mean[Coordinate.CURVE], std[Coordinate.CURVE] = curves[0], 0.0
    lag_of: LagOf = "command"
    if fit is not None and not (fit.warm_start is not None and fit.warm_start.stuck):
        known = fit.coordinates_std < std
        mean = np.where(known, fit.coordinates, mean)
        std = np.where(known, fit.coordinates_std, std)
        lag_of = lag_of if fit.lag_place is None else fit.lag_place.of
    return Actuator(
        float(mean[Coordinate.LAG]),
        float(mean[Coordinate.CURVE]),
        lag_of,
        float(std[Coordinate.LAG]),
        float(std[Coordinate.CURVE]),
    )


def early_change(
    t: Array,
    samples: Samples,
    dt: float,
    geometry: Array,
    actuator: Actuator | None,
    until: float,
) -> tuple[Detection, Classification] | None:
    """The likeliest step of thrust over mass in the beginning of a flight, judged.

    Args:
        t: (n,) s, session times from the beginning on, gaps marked by NaN samples.
        samples: n of them.
        dt: s between samples.
        geometry: (3, rotors) of the airframe.
        actuator: of commands; None with speeds.
        until: s, session time from which a detector watched.

    Returns:
        The step as an alarm, with times in s since t[0]; None where the stretch is too short,
        or the step in what was watched.
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
    at, share, sigmas = likeliest_step(window, reference, nothing, places.tolist(), _WHOLE)
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
    size = share * float(np.mean(reference.kappa * window.x[at:, TOTAL]))
    change = Detection(float(t[-1] - t[0]), onset - float(t[0]), "thrust", size, sigmas, "slow")
    return change, found


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
    columns = columns / np.maximum(np.abs(columns).max(axis=0), 1e-12)
    fit = np.linalg.lstsq(columns, e, rcond=1e-6)[0]
    left, level = np.full((len(e), 4), np.nan), np.full(4, np.nan)
    left[:, 0], level[0] = e - columns @ fit, np.median(e[~later])
    left[max(at - 2, 0) : at + 2] = np.nan  # means across the step
    return ResidualHistory(level, left, window.step)
