"""Frames in, estimates out: the telemetry intake and the chain, tied together.

Live sessions and log analyses are two ways to drive this one class, which is why they end with
the same numbers.

Frames of a link wait, unread, until the vehicle's clock has passed a tick of the chain.

Before that they change nothing that anybody sees, and reading a few at a time costs as much as
reading all of a tenth of a second at once. How long they wait changes no number.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.scale_reference import ScaleReference
from gcs_sysid.results.result import Estimate, Result
from gcs_sysid.session.chain import WINDOW, Chain, ChainOptions
from gcs_sysid.session.clock_check import clock_doubt
from gcs_sysid.session.reported_layout import ReportedLayout, differences, notes, reported_layout
from gcs_sysid.signals.columns import IntakeEvent, RecordBlock
from gcs_sysid.telemetry.frame_block import FrameBlock
from gcs_sysid.telemetry.frames import Frame
from gcs_sysid.telemetry.imu_loss import loss_reason
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.logs import Log, Telemetry
from gcs_sysid.telemetry.message_table import INERTIAL, MESSAGES, STAMP_FIELDS, Stamp
from gcs_sysid.telemetry.messages import MESSAGE_IDS, picker
from gcs_sysid.telemetry.outgoing import OWN_SYSTEM

_MOST_WAITING = 1024
"""Frames that wait: those of a tenth of a second on the fastest link."""
_LONGEST_WAIT = 0.2
"""s of the receiving computer's clock that they wait where the vehicle's gives no time."""
_AWAITED = frozenset(MESSAGE_IDS[name] for name in ("HEARTBEAT", "PARAM_VALUE", "MESSAGE_INTERVAL"))
"""Messages that are waited for: heartbeats and replies to requests."""
_ROUNDING = 2e-6
"""s, of stamps and ticks."""
_Sender = tuple[int, int, int]
_STAMPS = {
    MESSAGE_IDS[message.name]: (
        picker(message.name, STAMP_FIELDS[message.stamp]),
        1e-3 if message.stamp is Stamp.MS32 else 1e-6,
    )
    for message in MESSAGES
    if message.name in INERTIAL
}
_MAX_EVENTS = 1000
_SENSIBLE = (946_684_800.0, 4_102_444_800.0)
"""Unix times of the years 2000 and 2100: a record cannot be from outside."""


class FrameGathering:
    """Frames that wait."""

    def __init__(self) -> None:
        self._frames: list[Frame] = []
        self._walls: list[float] = []
        # (sender, message) -> s, its stamp when the waiting began, and its latest.
        self._from: dict[_Sender, float] = {}
        self._latest: dict[_Sender, float] = {}
        self._left = 0.0

    def add(self, frames: Iterable[Frame], wall: float | None) -> bool:
        """Add frames; whether it is time to read them.

        Args:
            frames: in the order received.
            wall: when they came, s since 1970; None: not known.
        """
        before = len(self._frames)
        self._frames += frames
        self._walls += [wall or 0.0] * (len(self._frames) - before)
        due = len(self._frames) >= _MOST_WAITING
        if wall is not None and self._frames:
            due |= not 0.0 <= wall - self._walls[0] < _LONGEST_WAIT
        awaited = [self._is_awaited(frame) for frame in self._frames[before:]]
        return due or any(awaited)

    def _is_awaited(self, frame: Frame) -> bool:
        """Whether a frame ends the waiting: by its time, or by what it is."""
        stamp = _STAMPS.get(frame.message_id)
        if stamp is None:
            return frame.message_id in _AWAITED or frame.system == OWN_SYSTEM
        pick, unit = stamp
        sender = frame.system, frame.component, frame.message_id
        self._latest[sender] = t = unit * pick(frame.payload)[0]
        return not 0.0 <= t - self._from.setdefault(sender, t) < self._left - _ROUNDING

    def take(self) -> FrameBlock:
        """The frames, which wait no more."""
        block = FrameBlock.of(self._frames, np.array(self._walls))
        self._frames, self._walls = [], []
        return block

    def wait(self, seconds: float) -> None:
        """Have frames wait for so many seconds of the vehicle's clock from now on."""
        self._from, self._latest, self._left = self._latest, {}, seconds


class Pipeline:
    """From the frames of a link or log to results.

    Args:
        airframe: with a scale anchor.
        source: what the result names as its source.
        wanted: system and perhaps component to listen to; None: the first autopilot received.
        options: of the chain.
        anchor: sets the scale instead of the airframe's.
    """

    def __init__(
        self,
        airframe: Airframe,
        source: str,
        wanted: tuple[int, int | None] | None = None,
        options: ChainOptions | None = None,
        anchor: ScaleReference | None = None,
    ) -> None:
        self.source = source
        self.intake = Intake(wanted)
        self._telemetry: Telemetry = self.intake
        self._wanted = wanted
        self.chain = Chain(airframe, options, anchor)
        self._events: deque[dict[str, Any]] = deque(maxlen=_MAX_EVENTS)
        self._recorded: datetime | None = None
        self._waiting = FrameGathering()
        self._contradicted: tuple[str, ...] = ()
        self.on_records: Callable[[RecordBlock], None] | None = None
        """Called with each block of a log or link as it is read, before the chain takes it."""

    @property
    def vehicle_layout(self) -> ReportedLayout | None:
        """The layout that the vehicle reports by its parameters, as far as received."""
        vehicle = self._telemetry.vehicle
        return None if vehicle is None else reported_layout(vehicle.key, self._telemetry.parameters)

    @property
    def airframe_problems(self) -> tuple[str, ...]:
        """What the airframe says otherwise than the vehicle; empty where they agree."""
        reported = self.vehicle_layout
        return () if reported is None else differences(self.chain.airframe, reported)

    def check_airframe(self) -> tuple[str, ...]:
        """`airframe_problems`, entered in the event log as soon as there are any."""
        found = self.airframe_problems
        if found != self._contradicted:
            self._contradicted = found
            for line in found:
                self.chain.note(line)
        return found

    def take(self, frames: Iterable[Frame] | FrameBlock, wall: float | None = None) -> bool:
        """Take frames in the order received. Returns whether the estimate was renewed.

        They may wait for others, see `FrameGathering`; `result` and `finish` have all of them.

        Args:
            frames: as they came.
            wall: when they came, s, as it is recorded; None: not known.
        """
        before = self.chain.renewals
        if isinstance(frames, FrameBlock):
            self._read_waiting()
            self._read(frames)
        elif self._waiting.add(frames, wall):
            self._read_waiting()
        return self.chain.renewals > before

    def _read_waiting(self) -> None:
        frames = self._waiting.take()
        if len(frames):
            self._read(frames)
            self._waiting.wait(self.chain.sampler.time_base.until_tick)

    def _read(self, frames: FrameBlock) -> None:
        block = self.intake.block(frames)
        if self.on_records is not None:
            self.on_records(block)
        for part in block.windows():
            self.take_window(part)

    def take_log(self, log: Log, progress: Callable[[float], None] | None = None) -> None:
        """Take a whole recording, instead of frames.

        Args:
            log: not yet read, opened for the vehicle wanted.
            progress: called with the share of the log done, 0 to 1, now and then.
        """
        done = 0.0
        for window in self.windows(log):
            if progress and log.share_read > done:
                done = log.share_read
                progress(done)
            self.take_window(window)
        if progress:
            progress(1.0)

    def windows(self, log: Log, samples: int = WINDOW) -> Iterator[RecordBlock]:
        """As `take_log`, window by window, for callers that set their own pace.

        Args:
            log: as of `take_log`; its telemetry is in results from now on.
            samples: of the IMU in a window.
        """
        self._telemetry = log
        for block in log.blocks():
            if self.on_records is not None:
                self.on_records(block)
            yield from block.windows(samples)
        if log.recorded is not None and _SENSIBLE[0] <= log.recorded < _SENSIBLE[1]:
            self._recorded = datetime.fromtimestamp(log.recorded, UTC)

    def take_window(self, window: RecordBlock) -> None:
        """Take one of `windows`, or a part of it."""
        for _, event in window.events:
            self._take_event(event)
        self.chain.take(window)

    def copy(self) -> "Pipeline":
        """One in the same state, that goes its own way; log and observers are the same."""
        shared = (self._telemetry, *self.chain.observers)
        return deepcopy(self, {id(thing): thing for thing in shared})

    def _take_event(self, event: IntakeEvent) -> None:
        if event.kind == "reset":
            self.chain.reset()
        else:
            self.chain.note(event.text)
        vehicle = self._telemetry.vehicle
        if event.kind == "vehicle" and vehicle is not None:
            self.chain.rotor_selector.autopilot = vehicle.key
        if event.kind != "vehicle":
            self._events.append({"t": self.chain.t, "kind": event.kind, "text": event.text})

    def result(self) -> Result:
        """The latest estimate."""
        self._read_waiting()
        return self._complete(self._with_doubt(self.chain.result))

    def finish(self) -> Result:
        """The final estimate, from all that was taken."""
        self._read_waiting()
        return self._complete(self._with_doubt(self.chain.finish))

    def _with_doubt(self, estimate: Callable[[], Result]) -> Result:
        """The chain's result, with what it may be wrong by where the clock may be."""
        doubt = clock_doubt(self._telemetry.drift, self._telemetry.parameters)
        self.chain.clock_error = 0.0 if doubt is None else abs(doubt.share)
        result = estimate()
        if doubt is None or result.verdict == "refused":
            return result
        return replace(
            result,
            verdict="partial",
            reasons=(doubt.reason, *result.reasons),
            telemetry={**result.telemetry, "clock_doubt": doubt.share},
        )

    def drop(self) -> None:
        """Forget who observes: they hold what they look at."""
        self.on_records = None
        self.chain.observers.clear()

    def _complete(self, result: Result) -> Result:
        vehicle = self._telemetry.vehicle
        reasons = result.reasons
        if vehicle is None:
            others = ", ".join(map(str, self._telemetry.systems))
            heard = f"; found: {others}" if others else ""
            which = " the requested" if self._wanted else " any"
            reasons = (f"no heartbeat of{which} autopilot received{heard}",)
        elif result.verdict != "identified":
            reasons = (*reasons, *self._telemetry.problems)
        telemetry = {**self._telemetry.as_dict(), **result.telemetry}
        reported = self.vehicle_layout
        if reported is not None:
            wrong = differences(self.chain.airframe, reported)
            remarks = notes(self.chain.airframe, reported)
            telemetry["layout"] = {
                **reported.as_json(),
                "differences": [*wrong],
                "notes": [*remarks],
            }
            if wrong:
                # All fits assumed other rotor positions.
                result, reasons = _without_numbers(result), (*wrong, *reasons)
        loss, serious = loss_reason(telemetry)
        if loss and result.verdict != "refused":
            reasons = (*reasons, loss)
            if serious and result.verdict == "identified":
                result = replace(result, verdict="partial")
        if self._recorded is not None:
            telemetry["recorded"] = f"{self._recorded:%Y-%m-%d %H:%M} UTC"
        return replace(
            result,
            source=self.source,
            reasons=reasons,
            vehicle=vehicle.as_dict() if vehicle else {},
            events=tuple(sorted([*self._events, *result.events], key=lambda event: event["t"])),
            telemetry=telemetry,
        )


def _without_numbers(result: Result) -> Result:
    """The same, refused: of what is not given nothing is known."""
    parameters = {
        name: e if e.status == "given" else Estimate(None, None, e.unit, "unobservable")
        for name, e in result.parameters.items()
    }
    return replace(result, verdict="refused", parameters=parameters)
