"""The one chain from records to estimates: samples, estimator, parameters.

Live sessions, replays, log analyses and tests all feed this class, record by record. Its state
depends on the records and their order alone, so the analysis of a recording ends with the
numbers that the live session ended with.
"""

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from gcs_sysid.columns import RecordBlock
from gcs_sysid.errors import InputError
from gcs_sysid.estimation.anchors import Anchor, AnchorKind
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
from gcs_sysid.estimation.rotors import RotorInput
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.parameters import TIMING
from gcs_sysid.records import Record, Stream
from gcs_sysid.session import summary
from gcs_sysid.session.chain_options import ChainOptions
from gcs_sysid.session.learner import Cutoffs, Known, Learner
from gcs_sysid.session.result import Estimate, Result
from gcs_sysid.session.rotor_input import RotorChooser
from gcs_sysid.session.rotor_units import gyro_cutoff, loop_cutoff
from gcs_sysid.session.sampling import SampleBlock, Sampler
from gcs_sysid.session.snapshot import Course, Event
from gcs_sysid.steps import Pending

__all__ = ["WINDOW", "Chain", "ChainOptions"]

if TYPE_CHECKING:
    from gcs_sysid.estimation.offline import OfflineFit

WINDOW = 8192
"""IMU samples that are best taken at once."""
_LEAST_WINDOW = 64
"""Fewer are fed one by one as fast."""
_MOST_PENDING = 10
"""Blocks of samples, 1 s of them, that are not learnt from yet."""
_ENOUGH_TO_ANSWER = 10.0
"""s of flight in which roll and pitch are seen to answer the rotors, if they do at all."""


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
        self.pending = Pending(_MOST_PENDING)
        """What is still to be learnt from samples that were admitted."""
        self.options = options = options or ChainOptions()
        self._learner = Learner(airframe, anchor, options)
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
        self._offline: OfflineFit | None = None

    def feed(self, record: Record) -> bool:
        """Take one record. Returns whether the estimate was renewed."""
        before = self.renewals
        self.admit(record)
        self.pending.finish()
        return self.renewals > before

    def admit(self, record: Record) -> None:
        """Take one record as far as the grid; learning from its samples is left to `pending`.

        The outcome is the same, however much is left for later. Whatever else is asked of the
        chain, but for the time and how it stands, has all of it done first.
        """
        self._admit(self.sampler.push(record))

    def _admit(self, blocks: tuple[SampleBlock, ...]) -> None:
        if blocks:
            self.pending.add(self._learner.learn(blocks, self._known()))

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
        self._admit(blocks)
        self.pending.finish()
        return True

    def finish(self) -> Result:
        """Use what is still held back and give the final result."""
        self._admit(self.sampler.finish())
        self.pending.add(self._learner.finish(self.t))
        result = self.refit()
        speeds = self.rotor_input == "speed"
        if self.options.offline and self._learner.tracker is not None and speeds:
            # Splines and likelihoods take a while to load, and few ask for them.
            from gcs_sysid.estimation.offline import fit_offline

            self._offline = fit_offline(self._learner.tracker, self._learner.fit)
            if self._offline is not None:
                self._learner.fit = self._offline.fit
            result = self.result()
        return result

    def reset(self) -> None:
        """Forget the estimate; go on with the next samples."""
        # However records were taken, what came before is forgotten, and nothing else.
        self._admit(self.sampler.catch_up())
        self.pending.finish()
        self._learner.reset()
        self.note("estimate reset")

    def check_anchor(self, kind: AnchorKind) -> None:
        """Make sure that such a fact sets the scale with the rotors' input in use.

        Raises:
            InputError: it does not.
        """
        rotors = self._learner.rotors
        used = self.airframe.rotor_input if rotors is None else rotors.kind
        if (used, kind) in (("speed", "T_max"), ("command", "k_T")):
            raise InputError(f"{kind} sets no scale with {used}s as the rotors' input")

    def set_anchor(self, anchor: Anchor) -> None:
        """Let another fact set the scale, from the start on; the estimate's course begins anew.

        Raises:
            InputError: see `check_anchor`.
        """
        self.check_anchor(anchor.kind)
        self.pending.finish()
        self.chooser.anchor = anchor
        self._learner.set_anchor(anchor)
        scale = summary.scale_of(anchor)
        self.note(f"scale: {scale.anchor} = {scale.value:.6g} {scale.unit}")

    def note(self, text: str) -> None:
        """Add a line to the event log."""
        self._learner.note(self.t, text)

    def refit(self) -> Result:
        """Fit now and give the result."""
        self.pending.finish()
        if self._learner.tracker is not None:
            self._learner.fit = self._learner.tracker.fit()
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
        return self._learner.rotor_input

    @property
    def observers(self) -> list[Callable[[SampleBlock], None]]:
        """Are shown every block of samples before the estimator takes it."""
        return self._learner.observers

    @property
    def renewals(self) -> int:
        """How often the estimate was renewed."""
        return self._learner.renewals

    @property
    def outdated(self) -> bool:
        """Whether parameters came too late: what they say is not what the estimate rests on."""
        if self._learner.tracker is None:
            return False
        learner = self._learner
        return self.chooser.outdated or learner.cutoffs != learner.used_of(self._cutoffs())

    @property
    def fit(self) -> Fit:
        """The latest fit."""
        return self._learner.fit

    @property
    def estimator(self) -> OnlineEstimator | None:
        """The one in force; None before the first sample in flight."""
        return None if self._learner.tracker is None else self._learner.tracker.estimator

    def values(self, fit: Fit) -> dict[str, Value]:
        """Physical parameters of any fit, by the rules of this flight's own."""
        return self._learner.values(fit, self.anchor)

    @property
    def anchor(self) -> Anchor:
        """The scale in force."""
        return self._learner.anchors[-1]

    @property
    def gyro_cutoff(self) -> float | None:
        """Hz, low-pass of the autopilot on its gyro that the estimate reckons with."""
        return self._learner.cutoffs[0]

    @property
    def used_seconds(self) -> float:
        """Flight time that the latest estimate rests on."""
        return self._learner.fit.seconds

    @property
    def events(self) -> tuple[Event, ...]:
        """Event log, the latest last."""
        return tuple(self._learner.events)

    @property
    def course(self) -> Course:
        """How the estimates moved so far."""
        return self._learner.course.course()

    def result(self) -> Result:
        """The latest fit as a result."""
        self.pending.finish()
        values = self._learner.values(self._learner.fit, self.anchor)
        word, reasons = verdict(values, self.rotor_input, self._learner.fit.coupling)
        first = self._data_reasons()
        if self._learner.fit.rotation is None:
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
                with_clock_error(values, self.clock_error),
                self._learner.fit,
                self.anchor,
                self._bounds(),
            ),
            estimator="online" if self._offline is None else "offline",
            timing=self._timing(),
            events=(*self._learner.input_events, *self._changes([*past, values])),
            segments=self._segments(past),
            validation=summary.validation_of(self._learner.fit),
            priors={
                name: {"value": value, "std": std}
                for name, (value, std) in self.airframe.priors.items()
            },
            telemetry=self._telemetry(),
            airframe=self.airframe.as_json(),
        )

    def _timing(self) -> dict[str, Estimate]:
        timing = {"rotor_delay": rotor_delay(self._learner.fit.rotation)}
        if self.rotor_input == "command":
            timing["motor_lag"] = motor_lag(self._learner.fit.rotation)
        timing = with_clock_error(timing, self.clock_error)
        return {
            name: Estimate(value.value, value.std, TIMING[name].unit, value.status)
            for name, value in timing.items()
        }

    def _past_values(self) -> list[dict[str, Value]]:
        if self._learner.tracker is None:
            return []
        return [
            self._learner.values(segment.fit, anchor)
            for segment, anchor in zip(
                self._learner.tracker.segments, self._learner.anchors, strict=False
            )
        ]

    def _bounds(self) -> dict[str, Value] | None:
        if self._offline is None:
            return None
        bounds = self._learner.values(self._offline.bounding_fit, self.anchor)
        # The likelihood is that of the rotation.
        return {n: v for n, v in bounds.items() if n not in ("mass", "k_T", "T_max", "linear_drag")}

    def _changes(self, values: list[dict[str, Value]]) -> tuple[dict[str, Any], ...]:
        if self._learner.tracker is None:
            return ()
        out = []
        before = 0
        for event in self._learner.tracker.events:
            after = None
            if event.segment is not None:
                before, after = event.segment, values[event.segment + 1]
            out.append(summary.event_of(event, values[before], after))
            if event.segment is not None:
                before = event.segment + 1
        return tuple(out)

    def _segments(self, past: list[dict[str, Value]]) -> tuple[dict[str, Any], ...]:
        if self._learner.tracker is None:
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
                self._learner.tracker.segments, self._learner.anchors, past, strict=False
            )
        )

    def _telemetry(self) -> dict[str, Any]:
        base = self.sampler.time_base
        return {
            "grid_rate": 1.0 / base.dt if base.dt else None,
            "used_seconds": self._learner.fit.seconds,
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
        source = self._learner.rotors
        if source is None:
            return {"source": None, "refused": dict(self.chooser.refused)}
        out: dict[str, Any] = {
            "source": source.name,
            "why": source.why,
            "refused": dict(source.refused or {}),
            "with": self._twin,
            "repeats": self.chooser.repeats[source.name].as_dict(),
            "gyro_filter": None if self._learner.tracker is None else self._learner.cutoffs[0],
            "loop_filter": None if self._learner.tracker is None else self._learner.cutoffs[1],
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
        if self._learner.rotors is None and self.chooser.judged:
            return self._input_reasons()
        if self.outdated:
            return (
                "the autopilot's parameters came too late to be used for filters and ranges: "
                "analyse the recording",
            )
        if Stream.ATTITUDE not in seen:
            return ("no attitude (ATTITUDE or ATTITUDE_QUATERNION)",)
        if self._learner.fit.rotation is None:
            if self._learner.fit.seconds > _ENOUGH_TO_ANSWER:
                return (
                    "the vehicle does not turn as these rotors would turn it: check the motor "
                    "order and rotor positions in the airframe file, and fly roll and pitch",
                )
            return ("too little flight in which all the needed data came together",)
        if self._learner.fit.rotation.r_squared.min() < WEAK_BELOW_R2:
            share = max(100.0 * self._learner.fit.rotation.r_squared.min(), 0.0)
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
        kind = self._learner.anchors[0].kind
        if kind == "k_T":
            return (*reasons, "without rotor speeds k_T sets no scale: give --mass or --t-max")
        if kind == "T_max":
            return (*reasons, "without commands T_max sets no scale: give --mass or --k-t")
        return reasons

    def _known(self) -> Known:
        base = self.sampler.time_base
        return Known(
            self.t,
            base.imu_interval,
            base.is_usable,
            bool(base.faults.spikes),
            bool(base.still_speeds),
            self._cutoffs(),
            self.chooser.refused,
        )

    def _cutoffs(self) -> Cutoffs:
        """Of speeds, and of commands, by the parameters that have come."""
        given, chooser = self.airframe.gyro_filter, self.chooser
        known = chooser.autopilot, chooser.parameters
        return gyro_cutoff(given, *known), loop_cutoff(*known)
