"""The one chain from records to estimates: samples, estimator, parameters, events.

Live sessions, replays, log analyses and tests all feed this class with blocks of records, a few
frames or minutes of a log. Its state depends on the records and their order alone, so the analysis
of a recording ends with the numbers that the live session ended with.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError, one_line
from gcs_sysid.estimation.changes.change_detection import ChangeTuning
from gcs_sysid.estimation.changes.tracking import TRACKING, Segment, Tracker
from gcs_sysid.estimation.fit.priors import Prior
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.parameters.given_errors import CAUSES, Given, given_effects, given_stds
from gcs_sysid.estimation.parameters.physical_parameters import (
    parameter_covariance,
    rotor_values,
    timing_values,
)
from gcs_sysid.estimation.parameters.scale import AbsoluteScale, relative_prior, resolve_scale
from gcs_sysid.estimation.record.tuning import EstimatorTuning, tuning_for
from gcs_sysid.estimation.rows.rotor_signals import cutoff_of, low_pass_delay
from gcs_sysid.judgement.evidence import Evidence, Received
from gcs_sysid.judgement.judge import Stage, judge, judged
from gcs_sysid.judgement.status import of_rotors
from gcs_sysid.model.airframe import Airframe, Known, ScaleKind, ScaleReference
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import AXES, REGISTRY, THETA
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results import summary
from gcs_sysid.results.history import History, HistoryRecorder
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_data import Scale
from gcs_sysid.results.snapshot import Event
from gcs_sysid.signals.columns import IntakeEvent, RecordBlock
from gcs_sysid.signals.redundant_commands import SLOW_COMMANDS
from gcs_sysid.signals.rotor_readings import RotorLines
from gcs_sysid.signals.rotor_source_selector import RotorSourceSelector
from gcs_sysid.signals.rotor_units import (
    RADIANS,
    RotorSource,
    UnitDoubt,
    gyro_cutoff,
    loop_cutoff,
    pole_count,
)
from gcs_sysid.signals.sampling import SampleBlock, Sampler
from gcs_sysid.signals.time_base import TimeBase
from gcs_sysid.significance import FALSE_ALARM_RATE, normal_limit

if TYPE_CHECKING:
    from gcs_sysid.estimation.offline.offline import OfflineFit
    from gcs_sysid.session.origin import Origin


@dataclass(frozen=True)
class ChainOptions:
    """What a user may set.

    Attributes:
        tuning: of the estimator with rotor speeds; with commands it has its own.
        changes: of the change detector; None: changes in flight are not looked for.
        history_interval: s between refits for the estimate's history; None: only at the end.
        tick: s of vehicle time between blocks; the estimate does not depend on it.
        start: s after the first record; earlier records are not used.
        end: s after the first record; later ones are not used.
        offline: whether the final estimate is the offline one.
        progress: called with the offline estimator's current step and the share of it that is done.
        reserve: whether the memory of a long flight is taken at once, so that a session does not
            find it wanting; a log takes what it needs.
        parameters: of the autopilot, as far as they are known beforehand.
    """

    tuning: EstimatorTuning = field(default_factory=EstimatorTuning)
    changes: ChangeTuning | None = field(default_factory=ChangeTuning)
    history_interval: float | None = None
    tick: float = 0.1
    start: float = 0.0
    end: float = float("inf")
    offline: bool = False
    progress: Callable[[str, float], None] | None = None
    reserve: bool = False
    parameters: Mapping[str, float] = field(default_factory=dict)


_MOST_NOTES = 300


class ChainEvents:
    """Keeps the latest events; times are s, session time.

    Attributes:
        of_rotors: rotor streams that died, came again or were replaced, as in a result.
        of_origin: what link or log said between records, as in a result.
    """

    def __init__(self) -> None:
        self.of_rotors: deque[dict[str, Any]] = deque(maxlen=_MOST_NOTES)
        self.of_origin: deque[dict[str, Any]] = deque(maxlen=1000)
        self._notes: deque[Event] = deque(maxlen=_MOST_NOTES)
        self._usable = True
        self._spiked = self._stood_still = False

    @property
    def notes(self) -> tuple[Event, ...]:
        """The event log, the latest last."""
        return tuple(self._notes)

    def note(self, t: float, text: str) -> None:
        """Add a line to the event log."""
        self._notes.append(Event(t, one_line(text)))

    def note_rotors(self, t: float, text: str) -> None:
        """Add what happened to the rotors' input."""
        self.note(t, text)
        self.of_rotors.append({"t": t, "kind": "rotor_input", "text": text})

    def note_origin(self, t: float, event: IntakeEvent) -> None:
        """Add what link or log said, which has its line already."""
        self.of_origin.append({"t": t, "kind": event.kind, "text": event.text})

    def note_imu(self, t: float, base: TimeBase) -> None:
        """Add when the IMU becomes too slow for the grid, and when it no longer is; when the first
        gyro spike was replaced, and when rotor speeds first stood still.

        How many there were is in the result.
        """
        if base.is_usable != self._usable:
            self._usable = base.is_usable
            consequence = "the estimate continues" if self._usable else "too slow for the estimate"
            rate = f"at {1.0 / base.imu_interval:.0f} Hz" if base.imu_interval else "again"
            self.note(t, f"IMU data {rate}: {consequence}")
        if base.faults.spikes and not self._spiked:
            self._spiked = True
            self.note(t, "gyro spikes: replaced by interpolation")
        if base.still_speeds and not self._stood_still:
            self._stood_still = True
            self.note(t, "rotor speeds frozen under new timestamps: not used")


HISTORY_INTERVAL = 0.5
"""s between the instants of the estimates' history in reports and notebooks."""

Cutoffs = tuple[float | None, float | None]
"""Hz, low-pass of the gyro as it is sent, and as the rate loop has it; None: there is none."""


class Chain:
    """Feeds records through to estimates.

    Args:
        airframe: with the anchor that sets the scale.
        options: settings.
        anchor: sets the scale instead of the airframe's.
        origin: the link or log behind the records; None: they have neither, as arrays of a caller.

    Raises:
        ValueError: there is no anchor.
    """

    def __init__(
        self,
        airframe: Airframe,
        options: ChainOptions | None = None,
        anchor: ScaleReference | None = None,
        origin: "Origin | None" = None,
    ) -> None:
        own = airframe.anchor()
        if anchor is None and own is not None:
            anchor = ScaleReference(*own, given=airframe.uncertainty.scale_share(*own))
        if anchor is None:
            raise ValueError("the airframe has no scale reference (mass, k_T or T_max)")
        self.airframe = airframe
        self.origin = origin
        self.options = options = options or ChainOptions()
        selected = airframe
        if options.tuning.method != "forward":
            # The article knows rotor speeds alone.
            selected = replace(airframe, rotor_input=RotorInput.SPEED)
        rotor_selector = RotorSourceSelector(selected, anchor)
        rotor_selector.parameters |= options.parameters
        self.sampler = Sampler(
            rotor_selector,
            len(airframe.rotors),
            options.tick,
            options.start,
            options.end,
            airframe.imu_arm,
        )
        self.offline: OfflineFit | str | None = None
        """The offline estimate where it was asked for, or why there is none."""
        self.observers: list[Callable[[SampleBlock], None]] = []
        """Are shown every block of samples before the estimator takes it."""
        self.rotors: RotorSource | None = None
        """The stream in use."""
        self.cutoffs: Cutoffs = (None, None)
        """Hz, gyro low-passes that the estimate allows for."""
        self.anchors = [anchor]
        """The scale of each segment, and that in force."""
        self.tracker: Tracker | None = None
        """None before the first sample in flight."""
        self.flown = 0.0
        """S in the air, as far as it has turned out to be."""
        self.fit = Fit(None, None, 0.0)
        """The latest."""
        self.contradicted: dict[str, Estimate] = {}
        """Parameters as the flight alone has them, whose priors it contradicts."""
        self.rotor_lines = RotorLines(airframe.geometry[2])
        """Of measured speeds."""
        self.renewals = 0
        """How often it was renewed."""
        self.log = ChainEvents()
        """What happened so far."""
        self._history = HistoryRecorder()
        self._events_reported = 0
        self.input_lost = ""
        """Why the rotors' input was given up, while there is no other."""
        self._history_number = 0.0
        self._interval = options.history_interval

    def take(self, block: RecordBlock) -> bool:
        """Take records that follow each other; how they are cut into blocks changes no number.

        Returns:
            Whether the estimate was renewed.
        """
        before = self.renewals
        for part in block.windows():
            for _, event in part.events:
                self._take_event(event)
            self.learn_parameters(part)
            for samples in self.sampler.feed_tracks(part.tracks):
                self.learn(samples)
        return self.renewals > before

    def learn_parameters(self, block: RecordBlock) -> None:
        """Take the autopilot's parameters alone."""
        for _, parameter in block.parameters:
            self.rotor_selector.learn(parameter.source, parameter.values[0])

    def finish(self) -> Result:
        """Use what is still held back and give the final result."""
        for block in self.sampler.finish():
            self.learn(block)
        if self.tracker is not None:
            self.tracker.finish()
            self._report_events(self.tracker, self.t)
        self._fit_now()
        if self.options.offline:
            self.offline = self._fit_offline()
            if not isinstance(self.offline, str):
                self.fit = self.offline.fit
        return self.result()

    def copy(self) -> "Chain":
        """One in the same state, that goes its own way; origin and observers are the same."""
        shared = (self.origin, *self.observers)
        return deepcopy(self, {id(thing): thing for thing in shared})

    def _take_event(self, event: IntakeEvent) -> None:
        """Take what a link or log says between its records."""
        if event.kind == "reset":
            self.reset()
        else:
            self.note(event.text)
        if event.kind != "vehicle":
            self.log.note_origin(self.t, event)
        elif self.origin is not None and self.origin.autopilot is not None:
            self.rotor_selector.autopilot = self.origin.autopilot

    def _fit_offline(self) -> "OfflineFit | str":
        """The offline estimate, or why there is none."""
        if self.tracker is None:
            return "no estimate from this flight"
        # Splines take a while to load, and few ask for them.
        from gcs_sysid.estimation.offline.offline import fit_offline

        return fit_offline(self.tracker, self.fit, self.options.progress)

    def reset(self) -> None:
        """Forget the estimate; go on with the next samples."""
        # However records were taken, what came before is forgotten, and nothing else.
        for block in self.sampler.catch_up():
            self.learn(block)
        self._forget_estimate()
        self.anchors = self.anchors[:1]
        self._events_reported = 0
        self.note("estimate reset")

    def check_anchor(self, kind: ScaleKind) -> None:
        """Check that this sets the scale with the rotor input in use.

        Raises:
            InputError: it does not.
        """
        used = self.airframe.wanted_input if self.rotors is None else self.rotors.kind
        if used is not None and not used.fits(kind):
            raise InputError(f"{kind} cannot set the scale with {used}s as the rotors' input")

    def set_anchor(self, anchor: ScaleReference) -> None:
        """Change the scale reference, from the start on; the estimate's history restarts.

        Raises:
            InputError: see `check_anchor`.
        """
        self.check_anchor(anchor.kind)
        self.rotor_selector.anchor = anchor
        self.anchors = [anchor]
        for segment in () if self.tracker is None else self.tracker.segments:
            self._go_on_after(segment)
        self._history = HistoryRecorder()
        scale = summary.scale_of(anchor)
        self.note(f"scale: {scale.anchor} = {scale.value:.6g} {scale.unit}")

    def renew_every(self, interval: float | None) -> None:
        """Renew the estimate this often from now on, s; None: only where it changes, or ends.

        The fits do not depend on it.
        """
        self._interval = interval

    def note(self, text: str) -> None:
        """Add a line to the event log."""
        self.log.note(self.t, text)

    def refit(self) -> Result:
        """Fit now and give the result."""
        self._fit_now()
        return self.result()

    def _fit_now(self) -> None:
        if self.tracker is not None:
            fit = self.tracker.fit()
            # Only for a result: it costs more than the fit.
            self.fit = replace(fit, other_layout=self.tracker.estimator.rotation.other_layout())

    def result(self) -> Result:
        """The latest fit as a result."""
        result = Findings(self).result()
        if self.origin is None:
            return result
        return self.origin.complete(result, self.airframe, self.log.of_origin)

    @property
    def t(self) -> float:
        """Seconds of the vehicle's clock since the first record."""
        return self.sampler.t

    @property
    def until_tick(self) -> float:
        """Seconds of the vehicle's clock until records change what anybody sees."""
        return self.sampler.time_base.until_tick

    @property
    def rotor_selector(self) -> RotorSourceSelector:
        """Of the rotor stream."""
        return self.sampler.rotor_selector

    @property
    def rotor_input(self) -> RotorInput:
        """What the estimate rests on."""
        if self.rotors is not None:
            return self.rotors.kind
        return self.airframe.wanted_input or RotorInput.SPEED

    @property
    def outdated(self) -> bool:
        """Whether parameters came too late: what they say is not what the estimate rests on."""
        if self.tracker is None:
            return False
        return self.rotor_selector.outdated or self.cutoffs != self._known_cutoffs()

    @property
    def estimator(self) -> OnlineEstimator | None:
        """The one in force; None before the first sample in flight."""
        return None if self.tracker is None else self.tracker.estimator

    @property
    def anchor(self) -> ScaleReference:
        """The scale in force."""
        return self.anchors[-1]

    @property
    def used_seconds(self) -> float:
        """Flight time used by the latest estimate."""
        return self.fit.seconds

    @property
    def events(self) -> tuple[Event, ...]:
        """Event log, the latest last."""
        return self.log.notes

    @property
    def history(self) -> History:
        """How the estimates moved so far."""
        return self._history.history()

    def values(self, fit: Fit, anchor: ScaleReference | None = None) -> dict[str, Estimate]:
        """Physical parameters of a fit, by what this flight shows alone.

        `anchor` sets the scale; None: the one in force.
        """
        return judged(self.evidence(fit, anchor or self.anchor), Stage.FLIGHT)

    def evidence(self, fit: Fit, anchor: ScaleReference) -> Evidence:
        """What a fit to this flight is judged by, with the parameters at this scale.

        The article's estimator is for study, and its validation does not count.
        """
        return Evidence(
            self._values_of(fit, anchor, self.known_beforehand(anchor)),
            fit,
            self.airframe,
            self.rotor_input,
            self.anchors[0].kind,
            checked=self.options.tuning.method == "forward" and self.tracker is not None,
            interval=0.0 if self.tracker is None else self.tracker.dt,
            filtered=self.cutoffs[0] is not None,
            gyro=self.sampler.gyro_check.result(),
            turning=self.rotor_lines.factor,
            spins=self.rotor_lines.unlike_spins,
            saturated=self.sampler.time_base.saturation.found(),
            frozen=self.sampler.time_base.frozen_share,
            disordered=self.sampler.time_base.disordered_share,
            contradicted=self.contradicted,
        )

    def _values_of(
        self, fit: Fit, anchor: ScaleReference, known: Mapping[str, Known]
    ) -> dict[str, Estimate]:
        arm, late = self.airframe.arm, low_pass_delay(self.cutoffs[0])
        return summary.values_of(
            fit, anchor, arm, known, self.rotor_input, late, self.airframe.canted
        )

    def known_beforehand(self, anchor: ScaleReference) -> Mapping[str, tuple[float, float]]:
        """Priors that hold with a scale; one on the mass is of the vehicle as it took off."""
        known = {} if anchor.origin else summary.priors_for(self.airframe.priors, self.rotor_input)
        return {name: value for name, value in known.items() if name not in self.contradicted}

    def learn(self, block: SampleBlock) -> None:
        """Learn from the next block of samples."""
        if block.rotors is not None and block.rotors is not self.rotors:
            self._use(block.rotors, block.newest_at)
        elif block.rotors is None and self.rotors is not None and not self.input_lost:
            self._report_loss(self.rotors.name, block.newest_at)
        for observer in self.observers:
            observer(block)
        left = self.sampler.flight_detector.first_left
        began = None if self.tracker is None else self.tracker.start
        if began is not None and began < left:
            self.log.note(block.newest_at, "it has stood so far: the estimate restarts")
            self._forget_estimate()
            self.flown = 0.0
        block = block.since(int(np.searchsorted(block.t, left)))
        self.flown += block.dt * int(np.count_nonzero(block.flying))
        if self.rotors is None or not len(block.t):
            return
        tracker = self.tracker
        if tracker is None or tracker.dt != block.dt:
            if not np.isfinite(block.samples.gyro).any():
                return  # nothing flies: no reason to give up what is known
            if tracker is not None and tracker.start is not None:
                old, new = 1.0 / tracker.dt, 1.0 / block.dt
                text = f"IMU rate changed from {old:.0f} to {new:.0f} Hz: estimate restarts"
                self.log.note(block.newest_at, text)
            tracker = self.tracker = self._new_tracker(self.rotors, block.dt)
            if self.options.reserve:
                tracker.reserve()
            # Rows are counted from the first sample in flight, however blocks fall.
            block = block.since(int(np.isfinite(block.samples.gyro).all(axis=1).argmax()))
        elif block.fresh:
            tracker.restart(rebooted=block.rebooted)
        now = max(block.newest_at, float(block.t[-1]))
        self.log.note_imu(now, self.sampler.time_base)
        stops = self._stops(block.t)
        if not self.rotor_input.motors:
            imu = np.hstack([block.samples.gyro, block.samples.force])
            self.rotor_lines.update(block.dt, imu, block.samples.speeds, fresh=block.fresh)
        points = tracker.update(block.t, block.samples, block.flying, stops)
        self._report_events(tracker, now)
        for stop, point in zip(stops, points, strict=True):
            self.fit = point.fit
            values = self.values(point.fit, self.anchors[point.segment])
            self._history.append(float(block.t[stop - 1]), values)
        if len(self.anchors) > len(tracker.segments) + 1:  # a change was taken back
            del self.anchors[len(tracker.segments) + 1 :]
            self.fit = tracker.fit(quick=True)
        self.renewals += len(points)

    def _stops(self, t: Array) -> list[int]:
        """After how many samples at (n,) times the estimate is renewed."""
        if self._interval is None:
            return []
        # Times are rounded; a sample that is early by so little is on time.
        number = np.floor(t / self._interval + 1e-3)
        renewed = np.diff(number, prepend=self._history_number) > 0.0
        self._history_number = max(float(number[-1]), self._history_number)
        return [int(i) + 1 for i in np.flatnonzero(renewed)]

    def _new_tracker(self, rotors: RotorSource, dt: float) -> Tracker:
        self.anchors = self.anchors[:1]
        self._events_reported = 0
        own, changes = self.options.tuning, self.options.changes
        self.cutoffs = gyro, loop = self._known_cutoffs()
        sigma = self.airframe.uncertainty
        if rotors.kind.motors:
            curve = self.airframe.command.thrust_curve
            usual = tuning_for(rotors.kind, dt)
            tuning = replace(
                usual,
                loop_cutoff=loop,
                smoother=own.smoother,
                bandwidth=own.bandwidth,
                curves=usual.curves if curve is None else (curve,),
            )
        else:
            tuning = replace(own, speed_interval=rotors.interval)
        tuning = replace(
            tuning,
            gyro_cutoff=gyro,
            rotor_place=sigma.rotor_position.of(self.airframe.arm),
            imu_place=sigma.imu_position.amount,
            imu_turn=math.radians(sigma.imu_rotation.amount),
        )
        return Tracker(
            self.airframe.geometry,
            dt,
            tuning,
            changes if own.method == "forward" else None,
            self._prior if self.airframe.priors else None,
            keep=self.options.offline,
        )

    def _known_cutoffs(self) -> Cutoffs:
        """By the parameters that have come, as far as they matter to the rotors' input in use."""
        given, selector = self.airframe.gyro_filter, self.rotor_selector
        known = selector.autopilot, selector.parameters
        loop = loop_cutoff(*known) if self.rotor_input.motors else None
        return gyro_cutoff(given, *known), loop

    def _prior(self, alone: Fit) -> Prior | None:
        """Of those that the flight alone does not contradict."""
        anchor = self.anchors[0]
        self.contradicted = self._contradicted(alone, anchor)
        known = self.known_beforehand(anchor)
        scale = resolve_scale(anchor, alone.translation, known)
        return relative_prior(known, scale, self.airframe.canted)

    def _contradicted(self, alone: Fit, anchor: ScaleReference) -> dict[str, Estimate]:
        known = summary.priors_for(self.airframe.priors, self.rotor_input)
        # What the rotors hardly explain, as in a hover, is confidently wrong: no contradiction.
        evidence = replace(self.evidence(alone, anchor), checked=False)
        plain = replace(evidence, estimates=self._values_of(alone, anchor, {}))
        values = judged(plain, Stage.FLIGHT)
        given = given_stds(values, alone, Given(self.airframe, anchor, self.rotor_input, {}))
        limit = normal_limit(FALSE_ALARM_RATE / max(len(known), 1))
        out = {}
        for name, (value, std) in known.items():
            found = values.get(name)
            if found is None or found.status != "identified" or found.std is None:
                continue
            assert found.value is not None
            own = math.hypot(found.std, given.get(name, 0.0))
            if abs(found.value - value) > limit * math.hypot(own, std):
                out[name] = replace(found, std=own)
        return out

    def _forget_estimate(self) -> None:
        self.tracker, self.contradicted = None, {}
        self.rotor_lines = RotorLines(self.airframe.geometry[2])
        self.fit = Fit(None, None, 0.0)
        self._history = HistoryRecorder()

    def _use(self, rotors: RotorSource, t: float) -> None:
        """Take the rotors' input from this stream from now on."""
        before, lost = self.rotors, self.input_lost
        self.rotors, self.input_lost = rotors, ""
        text = f"rotors from {rotors.name}, {rotors.why}"
        if before is None:
            self.log.note(t, text)
        elif lost and rotors.reads_as(before):
            self.log.note_rotors(t, f"{rotors.name} is usable again: the estimate continues")
            return
        else:
            self.log.note_rotors(t, f"{text}: estimate restarts")
        self._forget_estimate()

    def _report_loss(self, name: str, t: float) -> None:
        """Say that the rotors' input is not sound any more, and nothing else is."""
        self.input_lost = f"{name} {self.rotor_selector.refused.get(name, 'stopped')}"
        text = f"{self.input_lost}, and no other input is usable: the estimate"
        if self.rotor_selector.never_moved:
            self.log.note_rotors(t, f"{text} so far, of the same reading, is discarded")
            self._forget_estimate()
        else:
            self.log.note_rotors(t, f"{text} is that of earlier data")

    def _report_events(self, tracker: Tracker, t: float) -> None:
        reported, self._events_reported = (
            self._events_reported,
            tracker.forgotten + len(tracker.events),
        )
        for event in tracker.events[max(reported - tracker.forgotten, 0) :]:
            self.log.note(t, summary.note_of(event, self.rotor_input))
            if event.segment is not None:
                del self.anchors[event.segment + 1 :]
                self._go_on_after(tracker.segments[event.segment])
                self.fit = tracker.fit(quick=True)
                if len(tracker.segments) == TRACKING.most_segments:
                    self.log.note(
                        t, f"{TRACKING.most_segments} changes: no further ones are detected"
                    )

    def _go_on_after(self, segment: Segment) -> None:
        """Find the anchor of what follows a segment."""
        anchor = self.anchors[-1]
        before = self.values(segment.fit, anchor)
        self.anchors.append(summary.next_anchor(anchor, before, segment.end, segment.mass_ratio))


@dataclass(frozen=True)
class Findings:
    """Where a chain stands."""

    chain: Chain

    def result(self) -> Result:
        """All of it."""
        chain = self.chain
        fit, anchor, offline = chain.fit, chain.anchor, chain.offline
        evidence = self._evidence(fit, anchor)
        found = judge(evidence)
        estimates = self._in_units(summary.complete(found.estimates, fit, anchor, self._bounds()))
        parameters, timing = (
            {name: e for name, e in estimates.items() if REGISTRY[name].section == section}
            for section in ("parameters", "timing")
        )
        past = [chain.values(segment.fit, scale) for segment, scale in self._past]
        return Result(
            verdict=found.verdict,
            reasons=found.reasons,
            objections=found.objections,
            source="",
            vehicle={},
            scale=self._scale_shown(anchor),
            rotor_input=chain.rotor_input,
            parameters=parameters,
            estimator="online" if isinstance(offline, str | None) else "offline",
            method="" if isinstance(offline, str | None) else "prediction error",
            timing=timing,
            events=(*chain.log.of_rotors, *self._changes([*past, chain.values(fit, anchor)])),
            segments=self._segments(),
            validation=summary.validation_of(fit),
            priors={
                name: {"value": value, "std": std}
                for name, (value, std) in chain.airframe.priors.items()
            },
            assumptions=tuple(self._assumptions()),
            telemetry=self._telemetry(),
            airframe=chain.airframe.as_json(),
            disturbance=self._disturbance(),
            rotors=self._rotors(),
            covariance=self._covariance(parameters, timing),
        )

    def _evidence(self, fit: Fit, anchor: ScaleReference) -> Evidence:
        """What is judged of a flight as a whole."""
        chain, sampler, selector = self.chain, self.chain.sampler, self.chain.rotor_selector
        segment = self._segment_evidence(fit, anchor)
        timing = timing_values(fit.rotation, chain.rotor_input)
        note = ""
        if isinstance(chain.offline, str):
            note = f"this is the online estimate: {chain.offline}"
        evidence = replace(
            segment,
            estimates={**segment.estimates, **timing},
            received=Received(
                frozenset(sampler.seen),
                sampler.recorded,
                dict(selector.refused),
                selector.judged,
                chain.rotors is not None,
                chain.input_lost or sampler.stands,
                "" if chain.rotors is None else chain.rotors.doubt,
                chain.outdated,
                chain.flown,
            ),
            note=note,
            apart=self._apart(),
        )
        return evidence if chain.origin is None else chain.origin.known_to(evidence)

    def _apart(self) -> dict[str, float]:
        """By how much offline and online differ beyond chance, relative to the value."""
        offline, rotation = self.chain.offline, self.chain.fit.rotation
        if isinstance(offline, str | None) or rotation is None:
            return {}
        shares = np.abs(offline.apart) / np.maximum(np.abs(rotation.theta), 1e-300)
        return {name: share for name, share in zip(THETA, shares.tolist(), strict=True) if share}

    def _segment_evidence(self, fit: Fit, anchor: ScaleReference) -> Evidence:
        """What is judged of a stretch of flight."""
        chain, source = self.chain, self.chain.rotors
        evidence = chain.evidence(fit, anchor)
        return replace(
            evidence,
            given=given_stds(evidence.estimates, fit, self._given(anchor)),
            assumed=self._unit_doubt.assumed,
            as_sent=self._unit_doubt.as_sent,
            unlike=None if source is None else source.unlike,
            stale="" if source is None else chain.rotor_selector.stale.get(source.name, ""),
            reread=source is not None and source.scale == RADIANS,
            clock=None if chain.origin is None else chain.origin.clock_doubt,
            confirmed=chain.origin is not None and chain.origin.confirms(chain.airframe),
        )

    @property
    def _unit_doubt(self) -> UnitDoubt:
        """Of the rotors' stream."""
        chain, source = self.chain, self.chain.rotors
        seen = chain.rotor_lines.factor is not None
        return UnitDoubt() if source is None else chain.rotor_selector.doubt(source, seen=seen)

    @property
    def _scale(self) -> AbsoluteScale:
        fit, anchor = self.chain.fit, self.chain.anchor
        return resolve_scale(anchor, fit.translation, self.chain.known_beforehand(anchor))

    def _disturbance(self) -> dict[str, float]:
        rotation = self.chain.fit.rotation
        if rotation is None or not np.isfinite(rotation.disturbance).all():
            return {}
        return dict(zip(AXES, rotation.disturbance.tolist(), strict=True))

    def _rotors(self) -> tuple[dict[str, Estimate], ...]:
        """Each rotor's coefficients; with commands there are none."""
        if self.chain.rotor_input.motors:
            return ()
        rotors, cant = len(self.chain.airframe.rotors), self.chain.airframe.canted
        each = of_rotors(rotor_values(self.chain.fit.rotation, self._scale, rotors, cant))
        return tuple(map(self._in_units, each))

    def _in_units(self, estimates: Mapping[str, Estimate]) -> dict[str, Estimate]:
        """Estimates that say what they are per."""
        return summary.in_units(estimates, self.chain.airframe.own_units)

    def _covariance(
        self, parameters: dict[str, Estimate], timing: dict[str, Estimate]
    ) -> dict[str, Any]:
        rotation = self.chain.fit.rotation
        if rotation is None:
            return {}
        values = {
            name: (e.value, e.std)
            for name, e in (parameters | timing).items()
            if e.value is not None and e.std is not None
        }
        given = given_effects(parameters, self.chain.fit, self._given(self.chain.anchor))
        names, matrix, effects = parameter_covariance(rotation, self._scale, values, given)
        if not np.isfinite(matrix).all():
            return {}
        return {
            "names": list(names),
            "matrix": matrix.tolist(),
            "causes": list(CAUSES),
            "given": effects.tolist(),
        }

    def _given(self, anchor: ScaleReference) -> Given:
        known = self.chain.known_beforehand(anchor)
        return Given(self.chain.airframe, anchor, self.chain.rotor_input, known)

    @property
    def _past(self) -> list[tuple[Segment, ScaleReference]]:
        """Segments before this one, and their scales."""
        segments = [] if self.chain.tracker is None else self.chain.tracker.segments
        return [*zip(segments, self.chain.anchors, strict=False)]

    def _scale_shown(self, anchor: ScaleReference) -> Scale | None:
        return None if self.chain.airframe.own_units else summary.scale_of(anchor)

    def _bounds(self) -> dict[str, Estimate]:
        if isinstance(self.chain.offline, str | None):
            return {}
        bounds = self.chain.values(self.chain.offline.bounding_fit, self.chain.anchor)
        # The likelihood is that of the rotation.
        return {n: v for n, v in bounds.items() if REGISTRY[n].fit in ("rotation", "actuator")}

    def _changes(self, values: list[dict[str, Estimate]]) -> tuple[dict[str, Any], ...]:
        out = []
        before = 0
        for event in () if self.chain.tracker is None else self.chain.tracker.events:
            after = None
            if event.segment is not None:
                before, after = event.segment, values[event.segment + 1]
            out.append(summary.event_of(event, values[before], after))
            if event.segment is not None:
                before = event.segment + 1
        return tuple(out)

    def _segments(self) -> tuple[dict[str, Any], ...]:
        return tuple(
            {
                "start": segment.start,
                "end": segment.end,
                "scale": scale.as_json() if (scale := self._scale_shown(anchor)) else None,
                "parameters": {
                    name: estimate.as_json()
                    for name, estimate in self._in_units(
                        summary.complete(
                            judged(self._segment_evidence(segment.fit, anchor)), segment.fit, anchor
                        )
                    ).items()
                },
                "validation": summary.validation_of(segment.fit),
            }
            for segment, anchor in self._past
        )

    def _assumptions(self) -> Iterator[dict[str, Any]]:
        """What neither the log nor the user gives."""
        source, airframe = self.chain.rotors, self.chain.airframe
        if source is not None and (words := self._unit_doubt.assumed):
            if (span := source.range) is not None:
                what = f"range of {source.name}"
                yield {"what": what, "value": [span.low, span.high], "source": words}
            elif divided := pole_count(source.name, self.chain.rotor_selector.parameters):
                yield {"what": divided[0], "value": divided[1], "source": words}
        if not (airframe.arm_known or airframe.own_units):
            yield {"what": "arm", "value": airframe.arm, "source": f"layout {airframe.name}"}

    def _telemetry(self) -> dict[str, Any]:
        base = self.chain.sampler.time_base
        return {
            "grid_rate": 1.0 / base.dt if base.dt else None,
            "used_seconds": self.chain.fit.seconds,
            "late": base.late,
            "repeated": base.repeated,
            "restarts": base.restarts,
            "imu_outliers": asdict(base.faults),
            "rotor_outliers": base.wild_speeds,
            "rotor_still": base.still_speeds,
            "rotor_input": self._input_telemetry(),
            "imu_rotation": self._found("turns", math.degrees(1.0)),
            "rotor_offsets": self._found("places", 1.0),
            "thrust_voltage": self.chain.tracker.voltage if self.chain.tracker else None,
        }

    def _found(self, kind: Literal["turns", "places"], unit: float) -> dict[str, Any] | None:
        """How IMU or rotors lie otherwise than given; None where that is given as exact or not
        identifiable.
        """
        rotation = self.chain.fit.rotation
        if rotation is None or not (ways := getattr(rotation.deviating, kind)).any():
            return None
        flat = unit * ways.reshape(len(ways), -1)
        variance = np.einsum("ki,kl,li->i", flat, rotation.deviations_covariance, flat)
        value, std = rotation.deviations @ flat, np.sqrt(np.maximum(variance, 0.0))
        shape = ways.shape[1:]
        return {"value": value.reshape(shape).tolist(), "std": std.reshape(shape).tolist()}

    def _gyro_filter_found(self) -> float | None:
        """Hz of the undeclared low-pass that the gyro's delay is that of; None: none was found."""
        tracker, fit = self.chain.tracker, self.chain.fit.rotation
        if (
            tracker is None
            or fit is None
            or not tracker.estimator.record.low_passed
            or not fit.delay < 0.0
        ):
            return None
        return cutoff_of(-float(fit.delay))

    @property
    def _twin(self) -> str | None:
        """The other stream of commands that is used."""
        return (
            self.chain.sampler.rotor_selector.twin
            if self.chain.sampler.time_base.dt >= SLOW_COMMANDS
            else None
        )

    def _input_telemetry(self) -> dict[str, Any]:
        """Which rotor stream is used, how it is read, and why not the others."""
        source = self.chain.rotors
        if source is None:
            return {"source": None, "refused": dict(self.chain.sampler.rotor_selector.refused)}
        out: dict[str, Any] = {
            "source": source.name,
            "why": source.why,
            "refused": dict(source.refused or {}),
            "with": self._twin,
            "repeats": self.chain.sampler.rotor_selector.repeats[source.name].as_dict(),
            "gyro_filter": None if self.chain.tracker is None else self.chain.cutoffs[0],
            "gyro_filter_found": self._gyro_filter_found(),
            "loop_filter": None if self.chain.tracker is None else self.chain.cutoffs[1],
        }
        if source.range is not None:
            out["range"] = [source.range.low, source.range.high]
            out["range_from"] = source.range.origin
        return out
