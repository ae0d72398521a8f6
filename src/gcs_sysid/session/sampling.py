"""From records to aligned samples: time base, complementary filter, flight detection."""

from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, Mask, complete_rows, runs
from gcs_sysid.estimation.regression import Samples
from gcs_sysid.filters.complementary import ComplementaryFilter
from gcs_sysid.model import attitude
from gcs_sysid.records import Record, Stream
from gcs_sysid.session.flight import FlightDetector
from gcs_sysid.session.timebase import Block, TimeBase

_STEP_BACK = 1.0
"""s; records further back than this are not late: the clock was set back."""


@dataclass(frozen=True)
class SampleBlock:
    """Consecutive samples on the grid.

    Attributes:
        t: (n,) s since the session's first record, vehicle clock; goes on over a reboot.
        samples: n of them.
        flying: (n,) whether the vehicle flies.
        dt: s, the grid's step.
        fresh: whether nothing before joins on to this block.
    """

    t: Array
    samples: Samples
    flying: Mask
    dt: float
    fresh: bool


class Sampler:
    """Aligns records, filters the attitude, takes the gyro's bias off, marks flight.

    Args:
        rotors: how many the airframe has.
        tick: s of vehicle time between blocks.
        start: s after the first record; earlier records are not used.
        end: s after the first record; later ones are not used.
    """

    def __init__(
        self, rotors: int, tick: float = 0.1, start: float = 0.0, end: float = np.inf
    ) -> None:
        self.time_base = TimeBase(tick)
        self.attitude: tuple[float, float, float] | None = None
        """Roll, pitch, yaw in rad of the newest sample that has them."""
        self.rates: tuple[float, float, float] | None = None
        self.rotor_speeds: tuple[float, ...] = ()
        self.flying = False
        self.t = 0.0
        """Time of the newest sample, s since the first record."""
        self.seen: set[Stream] = set()
        """Streams that came between start and end."""
        self._rotors = rotors
        self._start, self._end = start, end
        self._flight = FlightDetector()
        self._filter: ComplementaryFilter | None = None
        self._first: float | None = None
        self._began = self._newest = 0.0

    @property
    def recorded(self) -> float | None:
        """Seconds of vehicle clock from the first record to the newest; None without any."""
        return None if self._first is None else self._newest - self._began

    def push(self, record: Record) -> SampleBlock | None:
        """Take one record; the next block when there is one."""
        if record.stream is Stream.PARAMETER:
            return None
        if self._first is None:
            self._first = self._began = self._newest = record.t
        if record.t < self._newest - _STEP_BACK:
            # The vehicle's clock was set back (a reboot); start and end go on counting.
            self._began += record.t - self._newest
            self._newest = record.t
        self._newest = max(self._newest, record.t)
        if not self._start <= max(record.t - self._began, 0.0) <= self._end:
            return None
        self.seen.add(record.stream)
        block = self.time_base.push(record)
        return None if block is None else self._samples(block)

    def finish(self) -> SampleBlock | None:
        """What is still held back."""
        block = self.time_base.finish()
        return None if block is None else self._samples(block)

    def _samples(self, block: Block) -> SampleBlock:
        assert self._first is not None
        if block.fresh and block.t[0] - self._first < self.t:
            # The vehicle's clock stepped back (a reboot); the session's time goes on.
            self._first = float(block.t[0]) - self.t
        n, dt = len(block.t), self.time_base.dt
        t = block.t - self._first
        imu = _stream(block, Stream.IMU, n, 6)
        gyro, force = imu[:, :3], imu[:, 3:]
        reference = _stream(block, Stream.ATTITUDE, n, 4)
        reference = reference / np.linalg.norm(reference, axis=1, keepdims=True)
        if self._filter is None or self._filter.dt != dt:
            bias = self._filter.bias if self._filter else np.zeros(3)
            self._filter = ComplementaryFilter(dt)
            self._filter.bias = bias
        elif block.fresh:
            self._filter.restart()
        filtered, bias = self._attitude(self._filter, gyro, reference)
        speeds = self._speeds(block, n)
        velocity = _stream(block, Stream.VELOCITY, n, 6)
        flying = self._flight.update(
            t,
            _stream(block, Stream.IN_AIR, n, 1)[:, 0],
            _stream(block, Stream.ARMED, n, 1)[:, 0],
            speeds,
            velocity[:, 3:],
        )
        self.time_base.flown += dt * int(np.count_nonzero(flying))
        gyro = np.where(flying[:, None], gyro, np.nan)
        samples = Samples(
            gyro=gyro,
            rates=gyro - bias,
            speeds=speeds,
            attitude=filtered,
            force=force,
            velocity=velocity[:, :3],
        )
        self.t = float(t[-1])
        self.flying = bool(flying[-1])
        self._show(samples)
        return SampleBlock(t, samples, flying, dt, block.fresh)

    def _attitude(
        self, flt: ComplementaryFilter, gyro: Array, reference: Array
    ) -> tuple[Array, Array]:
        """Attitude and gyro bias, filtered over the runs in which both sources are there."""
        out = np.full_like(reference, np.nan)
        bias = np.empty_like(gyro)
        there = complete_rows(gyro) & complete_rows(reference)
        for run, both in runs(there):
            if both:
                out[run] = flt.update(gyro[run], reference[run])
                bias[run] = flt.biases
            else:
                flt.restart()
                bias[run] = flt.bias
        return out, bias

    def _speeds(self, block: Block, n: int) -> Array:
        speeds = np.full((n, self._rotors), np.nan)
        for (stream, _, offset), values in block.values.items():
            if stream is Stream.ROTOR_SPEED and offset < self._rotors:
                width = min(values.shape[1], self._rotors - offset)
                speeds[:, offset : offset + width] = values[:, :width]
        return speeds

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
    values = block.values.get((stream, "", 0))
    return np.full((n, width), np.nan) if values is None else values
