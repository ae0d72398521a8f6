"""The estimator over a flight in which the vehicle may change.

An online estimator runs; a change detector monitors the residuals of its fits. An alarm is examined
for up to six seconds (`change_hypotheses`) while the estimate continues. A disturbance is only
reported. When the vehicle changed, samples since the onset are removed from the record, the record
before closes as a segment, and a fresh estimator starts. The rotors are still the same, so it
starts with their parameters: torque over thrust, damping, rotor inertia, delay, and how the
accelerometer reads against gravity. Inertia and CG start from what they were, but loosely. All is
relative to k_T, which stays. What is undecided at the end is left out: the result is that of the
flight before.

A landing ends a flight. The next is estimated separately until it is decided whether the vehicle is
the same (`flight_comparison`): if so, the estimate continues with both; else a segment
has ended.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.arrays import Array, Mask, runs
from gcs_sysid.estimation.changes.change_detection import ChangeTuning, Channel
from gcs_sysid.estimation.changes.change_hypotheses import Cause, Classification
from gcs_sysid.estimation.changes.change_watch import Alarm, ChangeWatch
from gcs_sysid.estimation.changes.flight_comparison import Trial
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Prior
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.online.online import OnlineEstimator, PriorSource
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.estimation.rows.actuator_dynamics import Coordinate
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.records import Samples


@dataclass(frozen=True)
class TrackingTuning:
    """Settings of what is decided between the detector and the estimator.

    Attributes:
        look_every: s between decisions.
        most_at_once: samples.
        held_back: s, more than samples wait in the estimator.
        blurred: s after a change's onset that may still be before it.
        contaminated: s before a change's onset that are forgotten too: windows reach over it.
        inertia_moves: how far a change may take inertia, share of it, one standard deviation.
        cg_moves: the same of the CG, share of the arm.
        stay: s without flight that separate two flights: two on the ground and one of takeoff. Less
            is a hop, or a state reported wrongly.
        away: s of silence in which the vehicle may have landed and been changed.
        touchdown: s before a reported landing that are left out: autopilots report it late. What
            was decided in them was contact.
        same: s within which a disturbance is reported once.
        most_segments: kept. Who changes more often is no vehicle; changes are looked for no more
            then.
        most_passing: events kept that ended no segment, the latest: a day of gusts may bring many.
    """

    look_every: float = 0.1
    most_at_once: int = 4096
    held_back: float = 0.3
    blurred: float = 0.1
    contaminated: float = 0.3
    inertia_moves: float = 0.25
    cg_moves: float = 0.2
    stay: float = 3.0
    away: float = 10.0
    touchdown: float = 1.0
    same: float = 10.0
    most_segments: int = 100
    most_passing: int = 200


TRACKING = TrackingTuning()


@dataclass(frozen=True)
class Segment:
    """A stretch of flight with one set of parameters, ended by a change.

    Attributes:
        start: s, session time.
        end: s, the change's onset.
        fit: of all of it.
        mass_ratio: mass since over mass in it, as the jump of thrust shows, with its standard
            deviation; None after a landing.
    """

    start: float
    end: float
    fit: Fit
    mass_ratio: tuple[float, float] | None = None


@dataclass(frozen=True)
class TrackingEvent:
    """A change, or what looked like one. Times are session times in s.

    Attributes:
        onset: estimated time of the change.
        detected: time of the newest sample behind the alarm.
        channel: of the alarm; None where two flights differ: then the onset is the landing between.
        cause: by the residuals; None when they show none.
        segment: index of the segment that it ended; None where the estimate goes on (a passing
            disturbance) or stops (a failing rotor).
        decided: time at which it was classified; None between flights, and where the end came
            before: then the estimate is that of the flight until the onset.
    """

    onset: float
    detected: float
    channel: Channel | None
    cause: Cause | None
    segment: int | None
    decided: float | None = None


@dataclass(frozen=True)
class HistoryPoint:
    """Of a history: a quick fit, and the number of segments that had ended before it."""

    fit: Fit
    segment: int


class Tracker:
    """Follows a vehicle through its changes.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        tuning: of the estimator.
        changes: of the detector; None: changes are not looked for.
        prior: what is known before the flight.
        keep: whether to keep the samples of the segment in force, for the offline estimator.
    """

    def __init__(
        self,
        geometry: Array,
        dt: float,
        tuning: EstimatorTuning,
        changes: ChangeTuning | None = None,
        prior: PriorSource | None = None,
        *,
        keep: bool = False,
    ) -> None:
        self.dt = dt
        self.segments: list[Segment] = []
        """Those that have ended."""
        self.events: list[TrackingEvent] = []
        self.forgotten = 0
        """Events that are kept no more."""
        self.stopped = False
        """Whether a failing rotor ended what one set of parameters can describe."""
        self.kept: list[Samples] = []
        """Samples of the segment in force, if they are kept."""
        self.start: float | None = None
        """s, session time, at which the segment in force began."""
        self.geometry = geometry
        self._tuning = tuning
        self._keep = keep
        self._estimator = OnlineEstimator(geometry, dt, tuning)
        self._reserves = False
        self._estimator.prior_source = prior
        self._count = 0
        self._frame = max(round(TRACKING.look_every / dt), 1)
        self._changes = changes
        self._watch = self._new_watch()
        self._trial: Trial | None = None
        self._landed: float | None = None
        self._before: tuple[TrackingEvent, float, OnlineEstimator, list[Samples]] | None = None
        """The latest change, the segment's start, and what was estimated and kept until then."""
        self._rebooted = False
        self._newest = -np.inf

    @property
    def tuning(self) -> EstimatorTuning:
        """Of the estimators."""
        return self._tuning

    @property
    def estimator(self) -> OnlineEstimator:
        """The one in force."""
        return self._estimator

    @property
    def voltage(self) -> float | None:
        """V, battery voltage that thrust at full command refers to; None: speeds, or not
        reported.
        """
        drift = self._estimator.record.drift
        return None if drift is None else drift.voltage

    def restart(self, *, rebooted: bool = False) -> None:
        """A gap: what comes next does not join on to what came before.

        Args:
            rebooted: whether the vehicle's clock was set back: it may have been changed meanwhile.
        """
        self._rebooted |= rebooted
        if self._trial is not None:
            self._trial.restart()
        self._break()

    def _new_watch(self) -> ChangeWatch | None:
        if self._changes is None:
            return None
        return ChangeWatch(self.geometry, self.dt, self._changes, self._tuning)

    def _break(self) -> None:
        self._estimator.restart()
        if self._watch is not None:
            self._watch.restart()
        if self._keep and self.kept:
            self.kept.append(self.kept[-1].gap)

    def update(
        self,
        t: Array,
        samples: Samples,
        flying: Mask | None = None,
        stops: Sequence[int] = (),
    ) -> list[HistoryPoint]:
        """Take a block of samples; how they are grouped is one.

        Args:
            t: (n,) s, session times.
            samples: n of them.
            flying: (n,) whether the vehicle flies; those on the ground are not looked at.
            stops: rising, 0 to n: a quick fit after so many of them.

        Returns:
            A point of the history for each stop.
        """
        points: list[HistoryPoint] = []
        for run, aloft in runs(np.ones(len(t), dtype=bool) if flying is None else flying):
            # A stop between two runs is the end of the first.
            here = [stop - run.start for stop in stops[len(points) :] if stop <= run.stop]
            if aloft:
                points += self._fly(t[run], samples.part(run), here)
            else:
                self._stand(t[run])
                points += self._idle(len(here))
        return points

    def finish(self) -> None:
        """Decide what is undecided, as the data have ended."""
        self._end_trial()
        self._leave_undecided()

    def _stand(self, t: Array) -> None:
        """Take the (n,) times of samples on the ground."""
        if self.start is None:
            return
        if self._landed is None:
            self._landed = float(t[0])
            if self._trial is None:
                self._touch_down()
            else:
                self._trial.drop_last(TRACKING.touchdown)
                self._trial.restart()
        if t[-1] - self._landed >= TRACKING.stay:
            self._end_trial()

    def _touch_down(self) -> None:
        """Leave out how the flight ended, and what looked like a change there."""
        self._leave_undecided()
        if self._before is not None:
            self._take_back(*self._before)
        self._break()
        if self._watch is not None:
            self._watch.land()
        if self.stopped:
            return
        self._forget_last(TRACKING.touchdown)
        if self.kept:
            self.kept.append(self.kept[-1].gap)

    def _take_back(
        self, event: TrackingEvent, start: float, estimator: OnlineEstimator, kept: list[Samples]
    ) -> None:
        """Go on from before a change that landing followed at once: it was contact."""
        self._before = None
        if event.decided is None or self._newest - event.decided >= TRACKING.touchdown:
            return
        self.start, self._estimator, self.kept, self.stopped = start, estimator, kept, False
        self.events.remove(event)
        self.forgotten += 1
        if event.segment is not None:
            self.segments.pop()
        cause = Cause("passing", disturbance="contact")
        self._add(replace(event, cause=cause, segment=None, decided=None))

    def _forget_last(self, seconds: float) -> None:
        """Leave out the last seconds, of the record and of the samples kept."""
        # A multiple of the rows' time, give or take rounding, is no more than that.
        self._estimator.forget_last((round(seconds / self.dt) - 0.01) * self.dt)
        left = round(seconds / self.dt)
        while left > 0 and self.kept:
            last = self.kept.pop()
            if len(last.gyro) > left:
                self.kept.append(last.part(slice(0, -left)))
            left -= len(last.gyro)

    def _fly(self, t: Array, samples: Samples, stops: Sequence[int]) -> list[HistoryPoint]:
        """Take samples of flight."""
        if self.start is None:
            self.start = float(t[0])
        landed, self._landed = self._landed, None
        stay = TRACKING.stay
        if landed is None:
            landed, stay = self._newest, TRACKING.away
        away = t[0] - landed >= stay or self._rebooted
        self._rebooted = False
        if away and np.isfinite(landed):
            self._end_trial()
            self._trial = Trial(landed, float(t[0]), self.dt)
        self._newest = float(t[-1])
        if self._trial is None:
            return self._follow(t, samples, stops)
        room = self._trial.room
        points = self._idle(sum(stop <= room for stop in stops))
        self._trial.add_samples(t[:room], samples.part(slice(0, room)))
        if len(t) >= room:
            self._end_trial()
        if len(t) > room:
            later = [stop - room for stop in stops[len(points) :]]
            points += self._follow(t[room:], samples.part(slice(room, None)), later)
        return points

    def _idle(self, count: int) -> list[HistoryPoint]:
        """Fits at stops while nothing is estimated."""
        if not count:
            return []
        fit = self.fit(quick=True)
        return [HistoryPoint(fit, len(self.segments))] * count

    def _end_trial(self) -> None:
        """Decide whether the vehicle is the same, and continue with the trial's samples."""
        trial, self._trial = self._trial, None
        if trial is None:
            return
        assert self.start is not None
        before = self.fit()
        arm = float(np.mean(np.hypot(self.geometry[0], self.geometry[1])))
        room = len(self.segments) < TRACKING.most_segments
        # Of what was known only the rotors are left, and with them the scale.
        known = _of_rotors(before)
        if room and trial.is_another(before, self._fresh(known, before, landed=True), arm):
            self._add(TrackingEvent(trial.landed, trial.end, None, None, len(self.segments)))
            self.segments.append(Segment(self.start, trial.landed, before))
            fresh = self._fresh(known, before, landed=True)
            self._go_on_with(fresh, [])
            self.start = trial.start
            self._restart_detection()
        self.stopped = False
        for part in trial.parts:
            if part is None:
                self._break()
            else:
                self._follow(*part, ())

    def _follow(self, t: Array, samples: Samples, stops: Sequence[int]) -> list[HistoryPoint]:
        """Learn from samples of the vehicle that is being followed."""
        points: list[HistoryPoint] = []
        done = 0
        while done < len(t) and not self.stopped:
            # Decisions fall after a fixed number of samples.
            stop = min(done + self._quiet_samples(), len(t))
            if self._watch is not None:
                stop = done + self._watch.watch(t[done:stop], samples.part(slice(done, stop)))
            part = samples.part(slice(done, stop))
            if self._keep:
                self.kept.append(part)
            here = [s - done for s in stops[len(points) :] if s <= stop]
            fits = self._estimator.follow(part, here)
            points += [HistoryPoint(fit, len(self.segments)) for fit in fits]
            self._count += stop - done
            done = stop
            if self._count % self._frame == 0:
                self._look(float(t[stop - 1]))
        return points + self._idle(len(stops) - len(points))

    def _quiet_samples(self) -> int:
        """Samples in which nothing is decided, if there is no alarm."""
        frame = self._frame - self._count % self._frame
        if self._watch is None:
            return TRACKING.most_at_once
        if self._watch.busy:
            return frame
        quiet = self._watch.arm_at - self._estimator.seconds - TRACKING.held_back
        return frame + self._frame * max(int(quiet / (self._frame * self.dt)) - 1, 0)

    def _look(self, now: float) -> None:
        """Decide what there is to decide; give the watch a better reference."""
        watch = self._watch
        if watch is None:
            return
        for alarm, found in watch.decided(now):
            if found.verdict == "changed":
                self._change(alarm, found, now)
                return
            self._pass(alarm, found, now)
        if self._estimator.seconds >= watch.arm_at:
            estimator, commands = self._estimator, self._estimator.record.commands
            # Neither a filtered gyro nor motors that are not known yet show a step of torque.
            unknown = commands is not None and commands.white is None
            moments = self._tuning.gyro_cutoff is None and not unknown
            fit = self.fit(quick=True, series="watch") if moments else estimator.fit_thrust()
            watch.arm(fit, estimator.seconds, moments=moments)
            early = watch.early(fit)
            if early is not None:
                self._change(*early, now)

    def _leave_undecided(self) -> None:
        """What may be a change and is no longer to be decided is left out."""
        left = None if self._watch is None or self.stopped else self._watch.undecided()
        if left is not None:
            alarm, found = left
            self._forget_last(self._newest - found.onset + TRACKING.contaminated)
            self._add(TrackingEvent(found.onset, alarm.detected, alarm.channel, found.cause, None))

    def fit(self, *, quick: bool = False, series: str = "") -> Fit:
        """The fit in force; see `OnlineEstimator.fit`."""
        return self._estimator.fit(quick=quick, series=series)

    def _pass(self, alarm: Alarm, found: Classification, now: float) -> None:
        """It was a disturbance: the vehicle is what it was."""
        if found.cause.disturbance == "contact":
            # What holds the vehicle down is not part of it.
            self._forget_last(now - found.onset + TRACKING.contaminated)
            self._break()
        event = TrackingEvent(
            found.onset, alarm.detected, alarm.channel, found.cause, None, decided=now
        )
        last = self.events[-1] if self.events else None
        if last is None or not _goes_on(last, event):
            self._add(event)

    def _change(self, alarm: Alarm, found: Classification, now: float) -> None:
        """The vehicle is another one since; go on accordingly."""
        assert self.start is not None
        assert self._watch is not None
        onset = found.onset
        since = found.settled or onset + TRACKING.blurred
        event = TrackingEvent(onset, alarm.detected, alarm.channel, found.cause, None, decided=now)
        self._forget_last(now - onset + TRACKING.contaminated)
        before = self.fit()
        fails = found.cause.kind == "rotor_failure"
        event = replace(event, segment=None if fails else len(self.segments))
        self._before = event, self.start, self._estimator, self.kept
        if fails:
            self.stopped = True
            self._add(event)
            return
        ratio = found.cause.mass_ratio, found.cause.mass_std
        self.segments.append(Segment(self.start, onset, before, ratio))
        fresh = self._fresh(_after_change(before, self.geometry), before, landed=False)
        kept = self._watch.since(since)
        self.start = since
        fresh.update(kept)
        self._go_on_with(fresh, [kept] if self._keep else [])
        self._restart_detection()
        self._add(event)

    def _fresh(self, known: Prior | None, before: Fit, *, landed: bool) -> OnlineEstimator:
        """An estimator of what may be another vehicle with the same rotors and sensors."""
        fresh = OnlineEstimator(self.geometry, self.dt, self._tuning)
        fresh.prior = known
        fresh.thrust.know_sensors(before.translation, before.accelerometer)
        own, old = fresh.record, self._estimator.record
        if own.drift is not None and old.drift is not None:
            own.drift.go_on_from(old.drift, landed=landed)
        if own.commands is not None and old.commands is not None:
            own.commands.go_on_from(old.commands)
        return fresh

    def _restart_detection(self) -> None:
        """Another vehicle: residuals of the last one do not apply."""
        if len(self.segments) >= TRACKING.most_segments:
            self._changes = None
        self._watch = self._new_watch()

    def reserve(self) -> None:
        """Have all memory now that a long flight will need, and again after each change."""
        self._reserves = True
        self._estimator.record.reserve()

    def _go_on_with(self, estimator: OnlineEstimator, kept: list[Samples]) -> None:
        """Another vehicle from now on: the last one is in its segment."""
        self._estimator, self.kept = estimator, kept
        if self._reserves:
            self.reserve()

    def _add(self, event: TrackingEvent) -> None:
        self.events.append(event)
        passing = [i for i, known in enumerate(self.events) if known.segment is None]
        if len(passing) > TRACKING.most_passing:
            del self.events[passing[0]]
            self.forgotten += 1


def _after_change(before: Fit, geometry: Array) -> Prior | None:
    """Prior from a fit for the vehicle after its body changed.

    Rotor parameters are as before. Inertia and CG may have moved, by a quarter or so.
    """
    if before.rotation is None:
        return None
    size = rb.counterparts(
        before.rotation.theta, float(np.mean(np.hypot(geometry[0], geometry[1])))
    )
    spread, places = np.zeros(N_UNKNOWNS), [rb.CG_X, rb.CG_Y]
    spread[rb.ELEMENTS] = TRACKING.inertia_moves * size[rb.ELEMENTS]
    spread[places] = TRACKING.cg_moves * size[places]
    return _prior(before.rotation, before.rotation.full_covariance + np.diag(spread**2))


def _of_rotors(before: Fit) -> Prior | None:
    """Prior on delay, lag and thrust curve for other flights, from a fit on commands."""
    rotation = before.rotation
    if rotation is None or not rotation.coordinates_std[Coordinate.CURVE]:
        return None
    covariance = rotation.full_covariance.copy()
    covariance[: rb.N_THETA] = covariance[:, : rb.N_THETA] = 0.0
    return _prior(rotation, covariance)


def _prior(rotation: RotationFit, covariance: Array) -> Prior:
    """The unknowns of a fit as a prior; those without a variance are unknown."""
    known = np.flatnonzero(np.diag(covariance) > 0.0)
    covariance = covariance[np.ix_(known, known)]
    d = np.sqrt(np.diag(covariance))
    scaled = np.linalg.inv(covariance / np.outer(d, d) + 1e-9 * np.eye(len(d)))
    information = np.zeros((N_UNKNOWNS, N_UNKNOWNS))
    information[np.ix_(known, known)] = scaled / np.outer(d, d)
    return Prior(rotation.unknowns, information)


def _goes_on(last: TrackingEvent, event: TrackingEvent) -> bool:
    """Whether a disturbance is that of the event before."""
    if last.cause is None or event.cause is None or last.decided is None:
        return False
    # What moves thrust has many names in rough air, one after the other.
    own = {"contact", "moment"}
    name, before = event.cause.disturbance, last.cause.disturbance
    same = name == before or own.isdisjoint((name, before))
    return same and last.cause.kind == "passing" and event.onset - last.decided < TRACKING.same
