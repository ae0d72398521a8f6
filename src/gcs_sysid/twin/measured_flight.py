"""What a log holds of flight, as the twin takes it: measured motion and the rotors' inputs."""

import math
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.arrays import Array, Mask, complete_rows, runs
from gcs_sysid.errors import InputError
from gcs_sysid.estimation.checks.validation import Validation
from gcs_sysid.estimation.rows.rotor_signals import butterworth, steady_state
from gcs_sysid.model import attitude as quaternions
from gcs_sysid.model.flight_model import FlightModel, MotionState
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.history import History
from gcs_sysid.results.snapshot import Event
from gcs_sysid.session.chain import Chain
from gcs_sysid.signals.recursions import lfilter
from gcs_sysid.signals.rotor_units import RotorSource
from gcs_sysid.signals.sampling import SampleBlock

_NO_HISTORY = History(np.empty(0), {}, {})


@dataclass(frozen=True)
class MeasuredFlight:
    """Measured flight on a uniform grid; NaN where something is missing or it does not fly.

    Attributes:
        t: (n,) s since the first record.
        rates: (n, 3) without bias, rad/s.
        attitude: (n, 4) body to world.
        velocity: (n, 3) m/s; NaN throughout where the log has none.
        rotors: (n, rotors) speeds in rad/s or commands, at the time at which they act: without
            their delay, behind the low-pass that the gyro went through.
        dt: s.
        rotor_input: what `rotors` holds.
        settling: s before a stretch that it needs of the rotors.
    """

    t: Array
    rates: Array
    attitude: Array
    velocity: Array
    rotors: Array
    dt: float
    rotor_input: RotorInput
    settling: float = 0.0

    @property
    def has_velocity(self) -> bool:
        """Whether any velocity was measured."""
        return bool(np.isfinite(self.velocity).all(axis=1).any())

    def _there(self, since: float, until: float) -> Mask:
        """(n,) where all is there between two times, s; the velocity may be missing."""
        there = complete_rows(np.hstack([self.rates, self.attitude, self.rotors]))
        return there & (self.t >= since) & (self.t <= until)

    def runs(self, since: float = -np.inf, until: float = np.inf) -> list[slice]:
        """Stretches without a gap between two times, s; the velocity may be missing."""
        return [part for part, ok in runs(self._there(since, until)) if ok]

    def flown(self, since: float = 0.0) -> Array:
        """(k,) times at which all is there."""
        return self.t[self._there(since, np.inf)]

    def of_body(self, turn: Array) -> "MeasuredFlight":
        """The motion of the body, whose IMU is turned by (3,) rad."""
        back = quaternions.from_rotation_vector(turn)
        return replace(
            self,
            rates=quaternions.rotate(back, self.rates),
            attitude=quaternions.multiply(self.attitude, quaternions.conjugate(back)),
        )

    def one_step(self, model: FlightModel, part: slice) -> Array:
        """(n, 3) sums of what one step of the model leaves of the rates of a gapless part, rad/s.

        Increments over any time are what the model, fed with the measured motion, does not say.
        """
        rates, q, velocity, rotors = (
            values[part] for values in (self.rates, self.attitude, self.velocity, self.rotors)
        )
        v = np.where(np.isfinite(velocity), velocity, 0.0)
        start = MotionState(rates[:-1], q[:-1], v[:-1])
        if self.rotor_input.motors:
            start = replace(start, rotors=model.lagged(self.t[part], rotors)[:-1])
        pairs = np.stack([rotors[:-1], rotors[1:]], axis=1)
        flown = model.simulate([0.0, self.dt], pairs, start)
        left = rates[1:] - flown.rates[:, 1]
        return np.concatenate([np.zeros((1, 3)), np.cumsum(left, axis=0)])


class FlightRecorder:
    """An observer of `analyze_log` that keeps the samples, and of the estimate what figures need.

    Samples beyond 64 MB are in a temporary file, until it is closed.

    Args:
        longest: s of flight that `record` gives at most: what is left of memory is others'.

    Attributes:
        dt: s between samples; None: nothing flew with rotors.
        history: of the estimates.
        validation: of the last fit.
        notes: what the analysis noted on the way.
    """

    def __init__(self, longest: float = math.inf) -> None:
        self.dt: float | None = None
        self.history = _NO_HISTORY
        self.validation: Validation | None = None
        self.notes: tuple[Event, ...] = ()
        self._longest = longest
        self._file = tempfile.SpooledTemporaryFile(max_size=64 << 20)  # noqa: SIM115
        self._width = 0
        self._flights: list[tuple[int, int]] = []
        self._source: RotorSource | None = None
        self._cutoff: float | None = None
        self._delay = 0.0
        self._rotor_input = RotorInput.SPEED

    def begin(self) -> None:
        """A reading of the log begins; one before it does not count."""
        self._file.seek(0)
        self._file.truncate()
        self.dt, self._source, self._flights = None, None, []
        self.history, self.validation, self.notes = _NO_HISTORY, None, ()

    def take(self, block: SampleBlock) -> None:
        """The next block of samples."""
        s = block.samples
        # While nothing flies the estimate keeps what it has.
        flies = block.rotors is not None and bool(np.isfinite(s.gyro).any())
        if flies and (block.dt != self.dt or block.rotors is not self._source):
            self.dt, self._source, self._flights = block.dt, block.rotors, []
        signals = s.gyro, s.rates, s.force, s.attitude, s.velocity, block.flying, s.setpoint
        rows = np.column_stack([block.t, *signals, s.speeds]).astype(float)
        self._width = rows.shape[1]
        if block.fresh:
            self._file.write(np.full(self._width, np.nan).tobytes())
        begin = self._file.tell()
        self._file.write(rows.tobytes())
        if flies and self._flights and self._flights[-1][1] == begin:
            begin = self._flights.pop()[0]
        if flies:
            self._flights.append((begin, self._file.tell()))

    def end(self, chain: Chain) -> None:
        """All is read, and the estimate final."""
        self.history, self.validation = chain.history, chain.fit.validation
        self.notes = chain.events
        self._cutoff, self._rotor_input = chain.cutoffs[0], chain.rotor_input
        fit = chain.fit.rotation
        self._delay = 0.0 if fit is None else fit.delay

    def close(self) -> None:
        """Drop the samples."""
        self._file.close()

    def rows(self, *, whole: bool = False) -> Iterator[Array]:
        """What was taken, in pieces.

        Args:
            whole: all of it; else only from where step and rotors' stream are those of the end.

        Yields:
            (n, 21 + rotors) in SI: time, gyro, rates without bias, specific force, attitude,
            velocity, whether it flies, rate set-points, rotors. A row without any number is a gap.
        """
        self._file.seek(0 if whole or not self._flights else self._flights[0][0])
        while data := self._file.read(8 * self._width * 8192):
            yield np.frombuffer(data).reshape(-1, self._width)

    def record(self, motor_lag: float, where: str) -> MeasuredFlight:
        """What was flown.

        `motor_lag` is s, with commands.

        Raises:
            InputError: nothing flies in the log, or it has no rotor speeds or commands.
        """
        if self.dt is None:
            raise InputError(
                f"{where}: no flight with rotor speeds or commands in it: see gcs-sysid inspect"
            )
        pieces: list[Array] = []
        room = int(min(self._longest / self.dt, sys.maxsize))
        for begin, end in self._flights:
            if pieces and room > 0:
                gap = np.full((1, self._width), np.nan)
                gap[0, 0] = pieces[-1][-1, 0] + self.dt
                pieces.append(gap)
                room -= 1
            self._file.seek(begin)
            rows = np.frombuffer(self._file.read(min(end - begin, 8 * self._width * room)))
            if len(rows):
                pieces.append(rows.reshape(-1, self._width))
                room -= len(pieces[-1])
        x = np.concatenate(pieces)
        t = x[:, 0]
        rotors = _acting(t, x[:, 21:], self.dt, self._delay, self._cutoff)
        # A motor's past is forgotten after five time constants, that of the gyro's low-pass after
        # one and a half periods of its cutoff.
        settling = 5.0 * motor_lag if self._rotor_input.motors else 0.0
        if self._cutoff is not None:
            settling += 1.5 / self._cutoff
        return MeasuredFlight(
            t, x[:, 4:7], x[:, 10:14], x[:, 14:17], rotors, self.dt, self._rotor_input, settling
        )


def _acting(t: Array, rotors: Array, dt: float, delay: float, cutoff: float | None) -> Array:
    """(n, rotors) of rotors whose stamps are late by `delay`, behind the gyro's low-pass."""
    out = np.full_like(rotors, np.nan)
    for part, there in runs(complete_rows(rotors)):
        if not there:
            continue
        now = t[part]
        stacked = np.stack(
            [np.interp(now + delay, now, column, np.nan, np.nan) for column in rotors[part].T], 1
        )
        out[part] = stacked
        inside = complete_rows(stacked)
        if cutoff is not None and cutoff < 0.45 / dt and inside.any():
            b, a = butterworth(cutoff * dt)
            state = steady_state(b, a, stacked[inside][0])
            out[part][inside], _ = lfilter(b, a, stacked[inside], state)
    return out
