"""The one chain from records to estimates: samples, estimator, parameters.

Live sessions, replays, log analyses and tests all feed this class, record by record. Its state
depends on the records and their order alone, so the analysis of a recording ends with the
numbers that the live session ended with.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.columns import RecordBlock
from gcs_sysid.errors import InputError
from gcs_sysid.estimation.anchors import Anchor, AnchorKind, relative_prior, resolve_scale
from gcs_sysid.estimation.changes import ChangeTuning
from gcs_sysid.estimation.command_noise import SLOW_COMMANDS
from gcs_sysid.estimation.online import Fit, OnlineEstimator
from gcs_sysid.estimation.parameters import (
    WEAK_BELOW_R2,
    Value,
    motor_lag,
    rotor_delay,
    verdict,
    with_clock_error,
)
from gcs_sysid.estimation.priors import Prior
from gcs_sysid.estimation.rotors import RotorInput
from gcs_sysid.estimation.tracking import MOST_SEGMENTS, Segment, Tracker
from gcs_sysid.estimation.translation import TranslationFit
from gcs_sysid.estimation.tuning import COMMANDS, Tuning
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.parameters import TIMING
from gcs_sysid.plain import one_line
from gcs_sysid.records import Record, Stream
from gcs_sysid.session import summary
from gcs_sysid.session.course import CourseRecorder
from gcs_sysid.session.result import Estimate, Result
from gcs_sysid.session.rotor_input import RotorChooser
from gcs_sysid.session.rotor_units import RotorSource, gyro_cutoff, loop_cutoff
from gcs_sysid.session.sampling import SampleBlock, Sampler
from gcs_sysid.session.snapshot import Course, Event

if TYPE_CHECKING:
    from gcs_sysid.estimation.offline import OfflineFit

_MAX_EVENTS = 300
WINDOW = 8192
"""IMU samples that are best taken at once."""
_LEAST_WINDOW = 64
"""Fewer are fed one by one as fast."""


@dataclass(frozen=True)
class ChainOptions:
    """What a user may set.

    Attributes:
        tuning: of the estimator with rotor speeds; with commands it has its own.
        changes: of the change detector; None: changes in flight are not looked for.
        course_interval: s between refits for the estimate's course; None: only at the end.
        tick: s of vehicle time between blocks; the estimate does not depend on it.
        start: s after the first record; earlier records are not used.
        end: s after the first record; later ones are not used.
        offline: whether the final estimate is the maximum-likelihood one.
        parameters: of the autopilot, as far as they are known beforehand.
    """

    tuning: Tuning = field(default_factory=Tuning)
    changes: ChangeTuning | None = field(default_factory=ChangeTuning)
    course_interval: float | None = 0.5
    tick: float = 0.1
    start: float = 0.0
    end: float = float("inf")
    offline: bool = False
    parameters: Mapping[str, float] = field(default_factory=dict)


_ENOUGH_TO_ANSWER = 10.0
"""s of flight in which roll and pitch are seen to answer the rotors, if they do at all."""
_Cutoffs = tuple[float | None, float | None]
"""Hz, low-pass of the gyro as it is sent, and as the rate loop has it; None: there is none."""


class Chain:
    """Feeds records through to estimates.

    Args:
        airframe: with the anchor that sets the scale.
        options: settings.
        anchor: sets the scale instead of the airframe's.

    Raises:
        ValueError: there is no anchor.
    """

    def __init__(
        self,
        airframe: Airframe,
        options: ChainOptions | None = None,
        anchor: Anchor | None = None,
    ) -> None:
        own = airframe.anchor()
        if anchor is None and own is not None:
            anchor = Anchor(*own)
        if anchor is None:
            raise ValueError("the airframe has no scale anchor (mass, k_T or T_max)")
        self.airframe = airframe
        self.observers: list[Callable[[SampleBlock], None]] = []
        """Are shown every block of samples before the estimator takes it."""
        self.options = options = options or ChainOptions()
        if options.tuning.method != "forward":
            # The article knows rotor speeds alone.
            airframe = replace(airframe, rotor_input="speed")
        chooser = RotorChooser(airframe, anchor)
        chooser.parameters |= options.parameters
        self.sampler = Sampler(
            chooser,
            len(airframe.rotors),
            options.tick,
            options.start,
            options.end,
            airframe.imu_arm,
        )
        self.clock_error = 0.0
        """Share by which the vehicle's clock may be wrong, as the owner tells; of results alone."""
        self._rotors: RotorSource | None = None
        self._rotors_lost = False
        self._input_events: deque[dict[str, Any]] = deque(maxlen=_MAX_EVENTS)
        self._cutoffs: _Cutoffs = (None, None)
        self._anchors = [anchor]
        self._tracker: Tracker | None = None
        self._told = 0
        self._usable = True
        self._spiked = self._stood_still = False
        self._events: deque[Event] = deque(maxlen=_MAX_EVENTS)
        self._course_number = 0.0
        self._fit = Fit(None, None, 0.0)
        self._offline: OfflineFit | None = None
        self._course = CourseRecorder()
        self._course_step = options.course_interval

    def feed(self, record: Record) -> bool:
        """Take one record. Returns whether the estimate was renewed."""
        renewed = False
        for block in self.sampler.push(record):
            renewed = self._take(block) or renewed
        return renewed

    def take(self, window: RecordBlock) -> None:
        """Take records that follow each other, as `feed` would one by one, but for rounding.

        Where nothing happens, the window is aligned, filtered and learnt from as arrays; where
        something does, its records are fed one by one.
        """
        if window.ends_with_imu and self._take_at_once(window):
            return
        if window.imu_samples >= 4 * _LEAST_WINDOW:
            # What happens, happens in one part of it.
            for part in window.windows(window.imu_samples // 4):
                self.take(part)
            return
        for _, record in window.records():
            self.feed(record)

    def _take_at_once(self, window: RecordBlock) -> bool:
        known = self.sampler.copy()
        blocks = self.sampler.take(window.tracks)
        if blocks is None:
            self.sampler = known
            return False
        for block in blocks:
            self._take(block)
        return True

    def finish(self) -> Result:
        """Use what is still held back and give the final result."""
        for block in self.sampler.finish():
            self._take(block)
        if self._tracker is not None:
            self._tracker.finish()
            self._tell_events(self._tracker)
        result = self.refit()
        speeds = self.rotor_input == "speed"
        if self.options.offline and self._tracker is not None and speeds:
            # Splines and likelihoods take a while to load, and few ask for them.
            from gcs_sysid.estimation.offline import fit_offline

            self._offline = fit_offline(self._tracker, self._fit)
            if self._offline is not None:
                self._fit = self._offline.fit
            result = self.result()
        return result

    def reset(self) -> None:
        """Forget the estimate; go on with the next samples."""
        # However records were taken, what came before is forgotten, and nothing else.
        for block in self.sampler.catch_up():
            self._take(block)
        self._tracker = None
        self._anchors = self._anchors[:1]
        self._told = 0
        self._fit = Fit(None, None, 0.0)
        self._course.clear()
        self.note("estimate reset")

    def check_anchor(self, kind: AnchorKind) -> None:
        """Make sure that such a fact sets the scale with the rotors' input in use.

        Raises:
            InputError: it does not.
        """
        used = self.airframe.rotor_input if self._rotors is None else self._rotors.kind
        if (used, kind) in (("speed", "T_max"), ("command", "k_T")):
            raise InputError(f"{kind} sets no scale with {used}s as the rotors' input")

    def set_anchor(self, anchor: Anchor) -> None:
        """Let another fact set the scale, from the start on; the estimate's course begins anew.

        Raises:
            InputError: see `check_anchor`.
        """
        self.check_anchor(anchor.kind)
        self.chooser.anchor = anchor
        self._anchors = [anchor]
        for segment in () if self._tracker is None else self._tracker.segments:
            self._go_on_after(segment)
        self._course.clear()
        scale = summary.scale_of(anchor)
        self.note(f"scale: {scale.anchor} = {scale.value:.6g} {scale.unit}")

    def note(self, text: str) -> None:
        """Add a line to the event log."""
        self._events.append(Event(self.t, one_line(text)))

    def refit(self) -> Result:
        """Fit now and give the result."""
        if self._tracker is not None:
            self._fit = self._tracker.fit()
        return self.result()

    @property
    def t(self) -> float:
        """Seconds of the vehicle's clock since the first record."""
        return self.sampler.t

    @property
    def chooser(self) -> RotorChooser:
        """Of the rotor stream."""
        return self.sampler.chooser

    @property
    def rotor_input(self) -> RotorInput:
        """What the estimate rests on."""
        if self._rotors is not None:
            return self._rotors.kind
        return "command" if self.airframe.rotor_input == "command" else "speed"

    @property
    def outdated(self) -> bool:
        """Whether parameters came too late: what they say is not what the estimate rests on."""
        if self._tracker is None:
            return False
        return self.chooser.outdated or self._cutoffs != self._cutoffs_now()

    @property
    def fit(self) -> Fit:
        """The latest fit."""
        return self._fit

    @property
    def estimator(self) -> OnlineEstimator | None:
        """The one in force; None before the first sample in flight."""
        return None if self._tracker is None else self._tracker.estimator

    def values(self, fit: Fit) -> dict[str, Value]:
        """Physical parameters of any fit, by the rules of this flight's own."""
        return self._values(fit, self.anchor)

    @property
    def anchor(self) -> Anchor:
        """The scale in force."""
        return self._anchors[-1]

    @property
    def gyro_cutoff(self) -> float | None:
        """Hz, low-pass of the autopilot on its gyro that the estimate reckons with."""
        return self._cutoffs[0]

    @property
    def used_seconds(self) -> float:
        """Flight time that the latest estimate rests on."""
        return self._fit.seconds

    @property
    def events(self) -> tuple[Event, ...]:
        """Event log, the latest last."""
        return tuple(self._events)

    @property
    def course(self) -> Course:
        """How the estimates moved so far."""
        return self._course.course()

    def result(self) -> Result:
        """The latest fit as a result."""
        values = self._values(self._fit, self.anchor)
        word, reasons = verdict(values, self.rotor_input, self._fit.coupling)
        first = self._data_reasons()
        if self._fit.rotation is None:
            word, reasons = "refused", first or reasons
        else:
            reasons = (*first, *reasons)
        past = self._past_values()
        return Result(
            verdict=word,  # type: ignore[arg-type]
            reasons=reasons if word != "identified" else (),
            source="",
            vehicle={},
            scale=summary.scale_of(self.anchor),
            rotor_input=self.rotor_input,
            parameters=summary.estimates_of(
                with_clock_error(values, self.clock_error), self._fit, self.anchor, self._bounds()
            ),
            estimator="online" if self._offline is None else "offline",
            timing=self._timing(),
            events=(*self._input_events, *self._changes([*past, values])),
            segments=self._segments(past),
            validation=summary.validation_of(self._fit),
            priors={
                name: {"value": value, "std": std}
                for name, (value, std) in self.airframe.priors.items()
            },
            telemetry=self._telemetry(),
            airframe=self.airframe.as_json(),
        )

    def _values(self, fit: Fit, anchor: Anchor) -> dict[str, Value]:
        # A prior on the mass is of the vehicle as it took off.
        known = {} if anchor.origin else summary.priors_for(self.airframe.priors, self.rotor_input)
        return summary.values_of(fit, anchor, self.airframe.arm, known, self.rotor_input)

    def _timing(self) -> dict[str, Estimate]:
        timing = {"rotor_delay": rotor_delay(self._fit.rotation)}
        if self.rotor_input == "command":
            timing["motor_lag"] = motor_lag(self._fit.rotation)
        timing = with_clock_error(timing, self.clock_error)
        return {
            name: Estimate(value.value, value.std, TIMING[name].unit, value.status)
            for name, value in timing.items()
        }

    def _past_values(self) -> list[dict[str, Value]]:
        if self._tracker is None:
            return []
        return [
            self._values(segment.fit, anchor)
            for segment, anchor in zip(self._tracker.segments, self._anchors, strict=False)
        ]

    def _bounds(self) -> dict[str, Value] | None:
        if self._offline is None:
            return None
        bounds = self._values(self._offline.bounding_fit, self.anchor)
        # The likelihood is that of the rotation.
        return {n: v for n, v in bounds.items() if n not in ("mass", "k_T", "T_max", "linear_drag")}

    def _changes(self, values: list[dict[str, Value]]) -> tuple[dict[str, Any], ...]:
        if self._tracker is None:
            return ()
        out = []
        before = 0
        for event in self._tracker.events:
            after = None
            if event.segment is not None:
                before, after = event.segment, values[event.segment + 1]
            out.append(summary.event_of(event, values[before], after))
            if event.segment is not None:
                before = event.segment + 1
        return tuple(out)

    def _segments(self, past: list[dict[str, Value]]) -> tuple[dict[str, Any], ...]:
        if self._tracker is None:
            return ()
        return tuple(
            {
                "start": segment.start,
                "end": segment.end,
                "scale": summary.scale_of(anchor).as_json(),
                "parameters": {
                    name: estimate.as_json()
                    for name, estimate in summary.estimates_of(
                        with_clock_error(values, self.clock_error), segment.fit, anchor
                    ).items()
                },
                "validation": summary.validation_of(segment.fit),
            }
            for segment, anchor, values in zip(
                self._tracker.segments, self._anchors, past, strict=False
            )
        )

    def _telemetry(self) -> dict[str, Any]:
        base = self.sampler.time_base
        return {
            "grid_rate": 1.0 / base.dt if base.dt else None,
            "used_seconds": self._fit.seconds,
            "late": base.late,
            "repeated": base.repeated,
            "restarts": base.restarts,
            "imu_outliers": asdict(base.faults),
            "rotor_outliers": base.wild_speeds,
            "rotor_still": base.still_speeds,
            "rotor_input": self._input_telemetry(),
        }

    @property
    def _twin(self) -> str | None:
        """The other stream of commands that is used."""
        return self.chooser.twin if self.sampler.time_base.dt >= SLOW_COMMANDS else None

    def _input_telemetry(self) -> dict[str, Any]:
        """Which rotor stream is used, how it is read, and why not the others."""
        source = self._rotors
        if source is None:
            return {"source": None, "refused": dict(self.chooser.refused)}
        out: dict[str, Any] = {
            "source": source.name,
            "why": source.why,
            "refused": dict(source.refused or {}),
            "with": self._twin,
            "repeats": self.chooser.repeats[source.name].as_dict(),
            "gyro_filter": None if self._tracker is None else self._cutoffs[0],
            "loop_filter": None if self._tracker is None else self._cutoffs[1],
        }
        if source.range is not None:
            out["range"] = [source.range.low, source.range.high]
            out["range_from"] = source.range.origin
        return out

    def _data_reasons(self) -> tuple[str, ...]:
        """What is missing, the first cause alone: the rest follows from it."""
        seen = self.sampler.seen
        if not seen:
            seconds = self.sampler.recorded
            if seconds is None:
                return ("no telemetry that can be used",)
            return (f"nothing between --start and --end: the record lasts {seconds:.1f} s",)
        if Stream.IMU not in seen:
            return ("no IMU data (HIGHRES_IMU): the autopilot must be asked for it",)
        if not seen & {Stream.ROTOR_SPEED, Stream.ROTOR_COMMAND}:
            return (
                "no rotor speeds (ESC_STATUS, ESC_TELEMETRY) and no actuator outputs "
                "(ACTUATOR_OUTPUT_STATUS, SERVO_OUTPUT_RAW): the autopilot must be asked for them",
            )
        if self._rotors is None and self.chooser.judged:
            return self._input_reasons()
        if self.outdated:
            return (
                "the autopilot's parameters came too late to be used for filters and ranges: "
                "analyse the recording",
            )
        if Stream.ATTITUDE not in seen:
            return ("no attitude (ATTITUDE or ATTITUDE_QUATERNION)",)
        if self._fit.rotation is None:
            if self._fit.seconds > _ENOUGH_TO_ANSWER:
                return (
                    "the vehicle does not turn as these rotors would turn it: check the motor "
                    "order and rotor positions in the airframe file, and fly roll and pitch",
                )
            return ("too little flight in which all the needed data came together",)
        if self._fit.rotation.r_squared.min() < WEAK_BELOW_R2:
            share = max(100.0 * self._fit.rotation.r_squared.min(), 0.0)
            return (
                f"the rotors explain only {share:.0f} % of the motion on one axis: "
                "fly it harder than the wind does, and check the motor order",
            )
        return ()

    def _input_reasons(self) -> tuple[str, ...]:
        """Why no rotor stream can be used."""
        if not self.chooser.refused:
            return ("no rotor speeds and no commands came while it flew",)
        reasons = tuple(f"{name} {why}" for name, why in self.chooser.refused.items())
        kind = self._anchors[0].kind
        if kind == "k_T":
            return (*reasons, "without rotor speeds k_T sets no scale: give --mass or --t-max")
        if kind == "T_max":
            return (*reasons, "without commands T_max sets no scale: give --mass or --k-t")
        return reasons

    def _take(self, block: SampleBlock) -> bool:
        if block.rotors is not None and block.rotors is not self._rotors:
            self._use(block.rotors)
        elif block.rotors is None and self._rotors is not None and not self._rotors_lost:
            self._tell_loss(self._rotors.name)
        for observer in self.observers:
            observer(block)
        if self._rotors is None:
            return False
        tracker = self._tracker
        if tracker is None or tracker.dt != block.dt:
            if not np.isfinite(block.samples.gyro).any():
                return False  # nothing flies: no reason to give up what is known
            if tracker is not None and tracker.start is not None:
                old, new = 1.0 / tracker.dt, 1.0 / block.dt
                self.note(f"IMU rate changed from {old:.0f} to {new:.0f} Hz: estimate starts anew")
            tracker = self._tracker = self._new_tracker(block.dt)
            # Rows are counted from the first sample in flight, however blocks fall.
            block = block.since(int(np.isfinite(block.samples.gyro).all(axis=1).argmax()))
        elif block.fresh:
            tracker.restart()
        self._tell_rate()
        self._tell_outliers()
        stops = self._stops(block.t)
        points = tracker.update(block.t, block.samples, block.flying, stops)
        self._tell_events(tracker)
        for stop, point in zip(stops, points, strict=True):
            self._fit = point.fit
            values = self._values(point.fit, self._anchors[point.segment])
            self._course.append(float(block.t[stop - 1]), values)
        return bool(points)

    def _stops(self, t: Array) -> list[int]:
        """After how many samples at (n,) times the estimate is renewed."""
        if self._course_step is None:
            return []
        # Times are rounded; a sample that is early by so little is on time.
        number = np.floor(t / self._course_step + 1e-3)
        renewed = np.diff(number, prepend=self._course_number) > 0.0
        self._course_number = max(float(number[-1]), self._course_number)
        return [int(i) + 1 for i in np.flatnonzero(renewed)]

    def _tell_outliers(self) -> None:
        """Say when the first gyro spike was replaced, and when rotor speeds first stood still.

        How many there were is in the result.
        """
        base = self.sampler.time_base
        if base.faults.spikes and not self._spiked:
            self._spiked = True
            self.note("spikes on the gyro: replaced by what their neighbours say")
        if base.still_speeds and not self._stood_still:
            self._stood_still = True
            self.note("rotor speeds stood still, old ones under new stamps: left out")

    def _tell_rate(self) -> None:
        """Say when the IMU becomes too slow for the grid, and when it no longer is."""
        base = self.sampler.time_base
        if base.is_usable == self._usable:
            return
        self._usable = base.is_usable
        told = "the estimate goes on" if self._usable else "too slow for the estimate to go on with"
        rate = f"at {1.0 / base.imu_interval:.0f} Hz" if base.imu_interval else "anew"
        self.note(f"the IMU comes {rate}: {told}")

    def _use(self, rotors: RotorSource) -> None:
        """Take the rotors' input from this stream from now on."""
        before, lost = self._rotors, self._rotors_lost
        self._rotors, self._rotors_lost = rotors, False
        text = f"rotors from {rotors.name}, {rotors.why}"
        if before is None:
            self.note(text)
        elif lost and rotors.reads_as(before):
            self._tell_input(f"{rotors.name} is sound again: the estimate goes on")
            return
        else:
            self._tell_input(f"{text}: estimate starts anew")
        self._tracker = None
        self._fit = Fit(None, None, 0.0)
        self._course.clear()

    def _tell_loss(self, name: str) -> None:
        """Say that the rotors' input is not sound any more, and nothing else is."""
        self._rotors_lost = True
        why = self.chooser.refused.get(name, "comes no more")
        self._tell_input(
            f"{name} {why}, and no other input is sound: the estimate rests on what came before"
        )

    def _tell_input(self, text: str) -> None:
        self.note(text)
        self._input_events.append({"t": self.t, "kind": "rotor_input", "text": text})

    def _cutoffs_now(self) -> _Cutoffs:
        given, chooser = self.airframe.gyro_filter, self.chooser
        known = chooser.autopilot, chooser.parameters
        loop = loop_cutoff(*known) if self.rotor_input == "command" else None
        return gyro_cutoff(given, *known), loop

    def _new_tracker(self, dt: float) -> Tracker:
        assert self._rotors is not None
        self._anchors = self._anchors[:1]
        self._told = 0
        own, changes = self.options.tuning, self.options.changes
        self._cutoffs = gyro, loop = self._cutoffs_now()
        tuning = replace(own, gyro_cutoff=gyro)
        if self._rotors.kind == "command":
            curve = self.airframe.command.thrust_curve
            tuning = replace(
                COMMANDS,
                gyro_cutoff=gyro,
                loop_cutoff=loop,
                command_streams=1 if self._twin is None else 2,
                smoother=own.smoother,
                bandwidth=own.bandwidth,
                curves=COMMANDS.curves if curve is None else (curve,),
            )
        if self._rotors.kind == "command" or gyro is not None:
            # Thrust at a command goes with the battery's voltage, and the detector compares
            # speeds with a gyro that is not filtered.
            changes = None
        return Tracker(
            self.airframe.geometry,
            dt,
            tuning,
            changes if own.method == "forward" else None,
            self._prior if self.airframe.priors else None,
            keep=self.options.offline,
        )

    def _tell_events(self, tracker: Tracker) -> None:
        told, self._told = self._told, tracker.forgotten + len(tracker.events)
        for event in tracker.events[max(told - tracker.forgotten, 0) :]:
            self.note(summary.note_of(event))
            if event.segment is not None:
                self._go_on_after(tracker.segments[event.segment])
                self._fit = tracker.fit(quick=True)
                if len(tracker.segments) == MOST_SEGMENTS:
                    self.note(f"{MOST_SEGMENTS} changes: more are not looked for")

    def _go_on_after(self, segment: Segment) -> None:
        """Find the anchor of what follows a segment."""
        before = self._values(segment.fit, self.anchor)
        self._anchors.append(summary.next_anchor(self.anchor, before, segment.end))

    def _prior(self, translation: TranslationFit | None) -> Prior | None:
        known = summary.priors_for(self.airframe.priors, self.rotor_input)
        return relative_prior(known, resolve_scale(self._anchors[0], translation, known))
