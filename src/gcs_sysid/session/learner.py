"""From blocks of samples to fits: selects the estimator and reports its events.

The fits depend only on the blocks, and on what was known when each came.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.evidence import Evidence, evidence_of
from gcs_sysid.estimation.given_errors import aligned, alignment_of
from gcs_sysid.estimation.online import Fit
from gcs_sysid.estimation.priors import Prior
from gcs_sysid.estimation.rotor_signals import RotorInput, low_pass_delay
from gcs_sysid.estimation.scale import relative_prior, resolve_scale
from gcs_sysid.estimation.status import Value
from gcs_sysid.estimation.tracking import MOST_SEGMENTS, Segment, Tracker
from gcs_sysid.estimation.translation import TranslationFit
from gcs_sysid.estimation.tuning import COMMANDS, tuning_for_commands
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.model.scale_reference import ScaleReference
from gcs_sysid.results import summary
from gcs_sysid.results.history import HistoryRecorder
from gcs_sysid.results.snapshot import Event
from gcs_sysid.sanitize import one_line
from gcs_sysid.session.chain_options import ChainOptions
from gcs_sysid.signals.rotor_units import RotorSource
from gcs_sysid.signals.sampling import SampleBlock

_MAX_EVENTS = 300

Cutoffs = tuple[float | None, float | None]
"""Hz, low-pass of the gyro as it is sent, and as the rate loop has it; None: there is none."""


class Known(NamedTuple):
    """What else was known when samples came.

    Attributes:
        imu_interval: s.
        is_usable: whether the IMU is fast enough for the grid.
        has_spikes: whether any on the gyro was replaced.
        stood_still: whether rotor speeds ever did.
        cutoffs: of speeds, and of commands, by the parameters that had come.
        refused: rotor streams, and why each is not sound.
    """

    imu_interval: float
    is_usable: bool
    has_spikes: bool
    stood_still: bool
    cutoffs: Cutoffs
    refused: Mapping[str, str]


class Learner:
    """Learns from blocks of samples.

    Args:
        airframe: of the vehicle.
        anchor: sets the scale.
        options: settings.
    """

    def __init__(self, airframe: Airframe, anchor: ScaleReference, options: ChainOptions) -> None:
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
        self.fit = Fit(None, None, 0.0)
        """The latest."""
        self.renewals = 0
        """How often it was renewed."""
        self.history = HistoryRecorder()
        self.events: deque[Event] = deque(maxlen=_MAX_EVENTS)
        self._airframe = airframe
        self._options = options
        self.input_events: deque[dict[str, Any]] = deque(maxlen=_MAX_EVENTS)
        """Of rotor streams that died, came again or were replaced, as in a result."""
        self._rotors_lost = False
        self._events_reported = 0
        self._usable = True
        self._spiked = self._stood_still = False
        self._history_number = 0.0
        self._interval = options.history_interval

    def renew_every(self, interval: float | None) -> None:
        """Renew the estimate this often from now on, s; None: only where it changes, or ends."""
        self._interval = interval

    @property
    def rotor_input(self) -> RotorInput:
        """What the estimate rests on."""
        if self.rotors is not None:
            return self.rotors.kind
        return "command" if self._airframe.rotor_input == "command" else "speed"

    def note(self, t: float, text: str) -> None:
        """Add a line to the event log."""
        self.events.append(Event(t, one_line(text)))

    def values(self, fit: Fit, anchor: ScaleReference) -> dict[str, Value]:
        """Physical parameters of a fit, by the rules of this flight."""
        arm, known = self._airframe.arm, self.known_beforehand(anchor)
        late = low_pass_delay(self.cutoffs[0])
        aligned_fit = aligned(fit, alignment_of(fit, self._airframe))
        values = summary.values_of(
            aligned_fit, anchor, arm, known, self.rotor_input, late, self._airframe.cant
        )
        evidence = self.evidence(fit)
        return {name: evidence.cap(value, REGISTRY[name]) for name, value in values.items()}

    def known_beforehand(self, anchor: ScaleReference) -> Mapping[str, tuple[float, float]]:
        """Priors that hold with a scale; one on the mass is of the vehicle as it took off."""
        return {} if anchor.origin else summary.priors_for(self._airframe.priors, self.rotor_input)

    def evidence(self, fit: Fit) -> Evidence:
        """Objections to a fit; none to the article's, which are for study."""
        if self._options.tuning.method != "forward" or self.tracker is None:
            return Evidence()
        filtered = self.cutoffs[0] is not None
        rotors = len(self._airframe.rotors)
        return evidence_of(fit, self.rotor_input, self.tracker.dt, filtered=filtered, rotors=rotors)

    def reset(self) -> None:
        """Forget the estimate; go on with the next samples."""
        self.tracker = None
        self.anchors = self.anchors[:1]
        self._events_reported = 0
        self.fit = Fit(None, None, 0.0)
        self.history.clear()

    def set_anchor(self, anchor: ScaleReference) -> None:
        """Change the scale reference, from the start on; the history restarts."""
        self.anchors = [anchor]
        for segment in () if self.tracker is None else self.tracker.segments:
            self._go_on_after(segment)
        self.history.clear()

    def finish(self, t: float) -> None:
        """Decide what is undecided, because nothing more will come."""
        if self.tracker is not None:
            self.tracker.finish()
            self._report_events(self.tracker, t)

    def learn(self, block: SampleBlock, known: Known) -> None:
        """Learn from the next block."""
        if block.rotors is not None and block.rotors is not self.rotors:
            self._use(block.rotors, block.newest_at)
        elif block.rotors is None and self.rotors is not None and not self._rotors_lost:
            self._report_loss(self.rotors.name, known, block.newest_at)
        for observer in self.observers:
            observer(block)
        if self.rotors is None:
            return
        tracker = self.tracker
        if tracker is None or tracker.dt != block.dt:
            if not np.isfinite(block.samples.gyro).any():
                return  # nothing flies: no reason to give up what is known
            if tracker is not None and tracker.start is not None:
                old, new = 1.0 / tracker.dt, 1.0 / block.dt
                text = f"IMU rate changed from {old:.0f} to {new:.0f} Hz: estimate restarts"
                self.note(block.newest_at, text)
            tracker = self.tracker = self._new_tracker(block.dt, known)
            if self._options.reserve:
                tracker.reserve()
            # Rows are counted from the first sample in flight, however blocks fall.
            block = block.since(int(np.isfinite(block.samples.gyro).all(axis=1).argmax()))
        elif block.fresh:
            tracker.restart()
        now = max(block.newest_at, float(block.t[-1]))
        self._report_rate(known, now)
        self._report_outliers(known, now)
        stops = self._stops(block.t)
        points = tracker.update(block.t, block.samples, block.flying, stops)
        self._report_events(tracker, now)
        for stop, point in zip(stops, points, strict=True):
            self.fit = point.fit
            values = self.values(point.fit, self.anchors[point.segment])
            self.history.append(float(block.t[stop - 1]), values)
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

    def _report_outliers(self, known: Known, t: float) -> None:
        """Say when the first gyro spike was replaced, and when rotor speeds first stood still.

        How many there were is in the result.
        """
        if known.has_spikes and not self._spiked:
            self._spiked = True
            self.note(t, "gyro spikes: replaced by interpolation")
        if known.stood_still and not self._stood_still:
            self._stood_still = True
            self.note(t, "rotor speeds frozen under new timestamps: not used")

    def _report_rate(self, known: Known, t: float) -> None:
        """Say when the IMU becomes too slow for the grid, and when it no longer is."""
        if known.is_usable == self._usable:
            return
        self._usable = known.is_usable
        consequence = "the estimate continues" if self._usable else "too slow for the estimate"
        rate = f"at {1.0 / known.imu_interval:.0f} Hz" if known.imu_interval else "again"
        self.note(t, f"IMU data {rate}: {consequence}")

    def _use(self, rotors: RotorSource, t: float) -> None:
        """Take the rotors' input from this stream from now on."""
        before, lost = self.rotors, self._rotors_lost
        self.rotors, self._rotors_lost = rotors, False
        text = f"rotors from {rotors.name}, {rotors.why}"
        if before is None:
            self.note(t, text)
        elif lost and rotors.reads_as(before):
            self._report_input(t, f"{rotors.name} is usable again: the estimate continues")
            return
        else:
            self._report_input(t, f"{text}: estimate restarts")
        self.tracker = None
        self.fit = Fit(None, None, 0.0)
        self.history.clear()

    def _report_loss(self, name: str, known: Known, t: float) -> None:
        """Say that the rotors' input is not sound any more, and nothing else is."""
        self._rotors_lost = True
        why = known.refused.get(name, "stopped")
        self._report_input(
            t,
            f"{name} {why}, and no other input is usable: the estimate is that of earlier data",
        )

    def _report_input(self, t: float, text: str) -> None:
        self.note(t, text)
        self.input_events.append({"t": t, "kind": "rotor_input", "text": text})

    def used_of(self, cutoffs: Cutoffs) -> Cutoffs:
        """Those that matter to the rotors' input in use."""
        gyro, loop = cutoffs
        return gyro, loop if self.rotor_input == "command" else None

    def _new_tracker(self, dt: float, known: Known) -> Tracker:
        assert self.rotors is not None
        self.anchors = self.anchors[:1]
        self._events_reported = 0
        own, changes = self._options.tuning, self._options.changes
        self.cutoffs = gyro, loop = self.used_of(known.cutoffs)
        tuning = replace(own, gyro_cutoff=gyro, speed_interval=self.rotors.interval)
        if self.rotors.kind == "command":
            curve = self._airframe.command.thrust_curve
            tuning = replace(
                tuning_for_commands(dt),
                gyro_cutoff=gyro,
                loop_cutoff=loop,
                smoother=own.smoother,
                bandwidth=own.bandwidth,
                curves=COMMANDS.curves if curve is None else (curve,),
            )
        return Tracker(
            self._airframe.geometry,
            dt,
            tuning,
            changes if own.method == "forward" else None,
            self._prior if self._airframe.priors else None,
            keep=self._options.offline,
        )

    def _report_events(self, tracker: Tracker, t: float) -> None:
        reported, self._events_reported = (
            self._events_reported,
            tracker.forgotten + len(tracker.events),
        )
        for event in tracker.events[max(reported - tracker.forgotten, 0) :]:
            self.note(t, summary.note_of(event, self.rotor_input))
            if event.segment is not None:
                self._go_on_after(tracker.segments[event.segment])
                self.fit = tracker.fit(quick=True)
                if len(tracker.segments) == MOST_SEGMENTS:
                    self.note(t, f"{MOST_SEGMENTS} changes: no further ones are detected")

    def _go_on_after(self, segment: Segment) -> None:
        """Find the anchor of what follows a segment."""
        anchor = self.anchors[-1]
        before = self.values(segment.fit, anchor)
        self.anchors.append(summary.next_anchor(anchor, before, segment.end))

    def _prior(self, translation: TranslationFit | None) -> Prior | None:
        known = summary.priors_for(self._airframe.priors, self.rotor_input)
        scale = resolve_scale(self.anchors[0], translation, known)
        return relative_prior(known, scale, self._airframe.cant)
