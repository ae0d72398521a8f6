"""The one chain from records to estimates: time base, complementary filter, regression, fit.

Live sessions, replays, log analyses and tests all feed this class, record by record. Its state
depends on the records and their order alone, so the analysis of a recording ends with the
numbers that the live session ended with.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.online import Fit, OnlineEstimator, Tuning
from gcs_sysid.estimation.parameters import (
    WEAK_BELOW_R2,
    Value,
    physical_parameters,
    rotor_delay,
    verdict,
)
from gcs_sysid.estimation.regression import Samples, complete_rows, runs
from gcs_sysid.filters.complementary import ComplementaryFilter
from gcs_sysid.model import attitude
from gcs_sysid.model.airframe import ANCHORS, Airframe, AnchorName
from gcs_sysid.model.parameters import PARAMETERS, TIMING
from gcs_sysid.records import Record, Stream
from gcs_sysid.session.course import CourseRecorder
from gcs_sysid.session.result import Estimate, Result, Scale
from gcs_sysid.session.snapshot import Course, Event
from gcs_sysid.session.timebase import Block, TimeBase

_MAX_EVENTS = 300
_MIN_SECONDS = 3.0
"""Flight time in s below which nothing is claimed."""
_STEP_BACK = 1.0
"""s; records further back than this are not late: the clock was set back."""


@dataclass(frozen=True)
class ChainOptions:
    """What a user may set.

    Attributes:
        tuning: of the estimator.
        course_interval: s between refits for the estimate's course; None: only at the end.
        tick: s of vehicle time between blocks; the estimate does not depend on it.
        start: s after the first record; earlier records are not used.
        end: s after the first record; later ones are not used.
    """

    tuning: Tuning = field(default_factory=Tuning)
    course_interval: float | None = 0.5
    tick: float = 0.1
    start: float = 0.0
    end: float = float("inf")


class Chain:
    """Feeds records through to estimates.

    Args:
        airframe: with the anchor that sets the scale.
        options: settings.

    Raises:
        ValueError: the airframe has no anchor.
    """

    def __init__(self, airframe: Airframe, options: ChainOptions | None = None) -> None:
        anchor = airframe.anchor()
        if anchor is None:
            raise ValueError("the airframe has no scale anchor (mass, k_T or T_max)")
        self.airframe = airframe
        self.anchor: tuple[AnchorName, float] = anchor
        self.options = options = options or ChainOptions()
        self.attitude: tuple[float, float, float] | None = None
        self.rates: tuple[float, float, float] | None = None
        self.rotor_speeds: tuple[float, ...] = ()
        self.flying = False
        self.t = 0.0
        """Seconds of the vehicle's clock since the first record."""
        self._time_base = TimeBase(options.tick)
        self._estimator: OnlineEstimator | None = None
        self._filter: ComplementaryFilter | None = None
        self._first: float | None = None
        self._began = self._newest = 0.0
        self._events: deque[Event] = deque(maxlen=_MAX_EVENTS)
        self._seen: set[Stream] = set()
        self._next_refit = -np.inf
        self._fit = Fit(None, None, 0.0)
        self._course = CourseRecorder()
        self._course_step = options.course_interval

    def feed(self, record: Record) -> bool:
        """Take one record. Returns whether the estimate was renewed."""
        if self._first is None:
            self._first = self._began = self._newest = record.t
        if record.t < self._newest - _STEP_BACK:
            # The vehicle's clock was set back (a reboot); start and end go on counting.
            self._began += record.t - self._newest
            self._newest = record.t
        self._newest = max(self._newest, record.t)
        if not self.options.start <= max(record.t - self._began, 0.0) <= self.options.end:
            return False
        self._seen.add(record.stream)
        block = self._time_base.push(record)
        return block is not None and self._take(block)

    def finish(self) -> Result:
        """Use what is still held back and give the final result."""
        block = self._time_base.finish()
        if block is not None:
            self._take(block)
        return self.refit()

    def reset(self) -> None:
        """Forget the estimate; go on with the next samples."""
        self._estimator = None
        self._fit = Fit(None, None, 0.0)
        self._course.clear()
        self.note("estimate reset")

    def note(self, text: str) -> None:
        """Add a line to the event log."""
        self._events.append(Event(self.t, text))

    def refit(self) -> Result:
        """Fit now and give the result."""
        if self._estimator is not None:
            self._fit = self._estimator.fit()
        return self.result()

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
        values = self._parameters()
        word, reasons = verdict(values)
        first = self._data_reasons()
        if self._fit.rotation is None:
            word, reasons = "refused", first or reasons
        else:
            reasons = (*first, *reasons)
        kind, known = self.anchor
        return Result(
            verdict=word,  # type: ignore[arg-type]
            reasons=reasons if word != "identified" else (),
            source="",
            vehicle={},
            scale=Scale(kind, known, ANCHORS[kind]),
            rotor_input="speed",
            parameters={
                name: Estimate(v.value, v.std, PARAMETERS[name].unit, v.status)
                for name, v in values.items()
            },
            timing={
                "rotor_delay": self._rotor_delay(),
            },
            events=(),
            validation=self._validation(),
            telemetry=self._telemetry(),
        )

    def _rotor_delay(self) -> Estimate:
        value = rotor_delay(self._fit.rotation)
        return Estimate(value.value, value.std, TIMING["rotor_delay"].unit, value.status)

    def _parameters(self) -> dict[str, Value]:
        fit = self._fit
        rot = fit.rotation if fit.seconds >= _MIN_SECONDS else None
        return physical_parameters(self.anchor, rot, fit.translation, self.airframe.arm)

    def _validation(self) -> dict[str, Any]:
        found = self._fit.validation
        if found is None:
            return {}
        axes = ("roll", "pitch", "yaw")
        return {
            "fitted_share": found.fitted_share,
            "r_squared": dict(zip(axes, found.r_squared.tolist(), strict=True)),
            "theil": dict(zip(axes, found.theil.tolist(), strict=True)),
            "whiteness": dict(zip(axes, _known(found.whiteness), strict=True)),
            "whiteness_p": dict(zip(axes, _known(found.whiteness_p), strict=True)),
        }

    def _telemetry(self) -> dict[str, Any]:
        base = self._time_base
        return {
            "grid_rate": 1.0 / base.dt if base.dt else None,
            "used_seconds": self._fit.seconds,
            "late": base.late,
            "repeated": base.repeated,
            "restarts": base.restarts,
        }

    def _data_reasons(self) -> tuple[str, ...]:
        """What is missing, the first cause alone: the rest follows from it."""
        if not self._seen:
            if self._first is None:
                return ("no telemetry that can be used",)
            seconds = self._newest - self._began
            return (f"nothing between --start and --end: the record lasts {seconds:.1f} s",)
        if Stream.IMU not in self._seen:
            return ("no IMU data (HIGHRES_IMU): the autopilot must be asked for it",)
        if Stream.ROTOR_SPEED not in self._seen:
            return ("no rotor speeds (ESC_STATUS): the ESCs must send rpm telemetry",)
        if Stream.ATTITUDE not in self._seen:
            return ("no attitude (ATTITUDE or ATTITUDE_QUATERNION)",)
        if self._fit.rotation is None:
            return ("too little flight in which all the needed data came together",)
        if self._fit.rotation.r_squared.min() < WEAK_BELOW_R2:
            share = 100.0 * self._fit.rotation.r_squared.min()
            return (
                f"the rotors explain only {share:.0f} % of the motion on one axis: "
                "fly it harder than the wind does, and check the motor order",
            )
        return ()

    def _take(self, block: Block) -> bool:
        assert self._first is not None
        samples = self._samples(block)
        if self._estimator is None or self._estimator.dt != self._time_base.dt:
            if self._estimator is not None:
                old, new = 1.0 / self._estimator.dt, 1.0 / self._time_base.dt
                self.note(f"IMU rate changed from {old:.0f} to {new:.0f} Hz: estimate starts anew")
            self._estimator = OnlineEstimator(
                self.airframe.geometry, self._time_base.dt, self.options.tuning
            )
        elif block.fresh:
            self._estimator.restart()
        self._estimator.update(samples)
        if block.fresh and block.t[0] - self._first < self.t:
            # The vehicle's clock stepped back (a reboot); the session's time goes on.
            self._first = float(block.t[0]) - self.t
        self.t = float(block.t[-1]) - self._first
        self._show(samples)
        if self._course_step is None or self.t < self._next_refit - 1e-6:
            return False
        # On average at the interval asked for, although blocks end a little early or late.
        behind = self.t - self._next_refit > self._course_step
        self._next_refit = (self.t if behind else self._next_refit) + self._course_step
        self._fit = self._estimator.fit(quick=True)
        self._course.append(self.t, self._parameters())
        return True

    def _samples(self, block: Block) -> Samples:
        n = len(block.t)
        imu = _stream(block, Stream.IMU, n, 6)
        gyro, force = imu[:, :3], imu[:, 3:]
        reference = _stream(block, Stream.ATTITUDE, n, 4)
        reference = reference / np.linalg.norm(reference, axis=1, keepdims=True)
        if self._filter is None or self._filter.dt != self._time_base.dt:
            bias = self._filter.bias if self._filter else np.zeros(3)
            self._filter = ComplementaryFilter(self._time_base.dt)
            self._filter.bias = bias
        elif block.fresh:
            self._filter.restart()
        filtered, bias = self._attitude(gyro, reference)
        speeds = self._speeds(block, n)
        flying = self._in_flight(block, speeds, n)
        self.flying = bool(flying[-1])
        gyro = np.where(flying[:, None], gyro, np.nan)
        return Samples(
            gyro=gyro,
            rates=gyro - bias,
            speeds=speeds,
            attitude=filtered,
            force=force,
            velocity=_stream(block, Stream.VELOCITY, n, 6)[:, :3],
        )

    def _attitude(self, gyro: Array, reference: Array) -> tuple[Array, Array]:
        """Attitude and gyro bias, filtered over the runs in which both sources are there."""
        assert self._filter is not None
        out = np.full_like(reference, np.nan)
        bias = np.empty_like(gyro)
        there = complete_rows(gyro) & complete_rows(reference)
        for run, both in runs(there):
            if both:
                out[run] = self._filter.update(gyro[run], reference[run])
                bias[run] = self._filter.biases
            else:
                self._filter.restart()
                bias[run] = self._filter.bias
        return out, bias

    def _speeds(self, block: Block, n: int) -> Array:
        rotors = len(self.airframe.rotors)
        speeds = np.full((n, rotors), np.nan)
        for (stream, offset), values in block.values.items():
            if stream is Stream.ROTOR_SPEED and offset < rotors:
                width = min(values.shape[1], rotors - offset)
                speeds[:, offset : offset + width] = values[:, :width]
        return speeds

    def _in_flight(self, block: Block, speeds: Array, n: int) -> Mask:
        in_air = block.values.get((Stream.IN_AIR, 0))
        if in_air is not None:
            return in_air[:, 0] > 0.5
        armed = block.values.get((Stream.ARMED, 0))
        turning: Mask = np.asarray((speeds > 0.0).all(axis=1))
        return turning if armed is None else turning & (armed[:, 0] > 0.5)

    def _show(self, samples: Samples) -> None:
        if np.isfinite(samples.attitude[-1]).all():
            roll, pitch, yaw = attitude.to_euler(samples.attitude[-1])
            self.attitude = (float(roll), float(pitch), float(yaw))
        if np.isfinite(samples.rates[-1]).all():
            p, q, r = samples.rates[-1]
            self.rates = (float(p), float(q), float(r))
        if np.isfinite(samples.speeds[-1]).all():
            self.rotor_speeds = tuple(float(v) for v in samples.speeds[-1])


def _stream(block: Block, stream: Stream, n: int, width: int) -> Array:
    values = block.values.get((stream, 0))
    return np.full((n, width), np.nan) if values is None else values


def _known(values: Array) -> list[float | None]:
    return [v if np.isfinite(v) else None for v in values.tolist()]
