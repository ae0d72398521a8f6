"""What a flight leaves behind for the fits: moments of rows, in bounded memory."""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from copy import copy
from itertools import pairwise

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.fit.deviations import DeviationChoice
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.whitened_fit import fit_whitened
from gcs_sysid.estimation.fit.whitener_choice import explained_by
from gcs_sysid.estimation.noise.whitening import bank_for
from gcs_sysid.estimation.record import article_estimator as article
from gcs_sysid.estimation.record.command_record import CommandRecord
from gcs_sysid.estimation.record.input_noise import CommandNoise, SpeedNoise
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.estimation.record.whitened_record import WhitenedRecord
from gcs_sysid.estimation.record.window_record import WindowRecord
from gcs_sysid.estimation.rows.actuator_dynamics import (
    LAGS_OF,
    ActuatorDynamics,
    Coordinate,
    LagOf,
    LagPlace,
)
from gcs_sysid.estimation.rows.motor_linearization import MeanThrust
from gcs_sysid.estimation.rows.regression import LeakySums, NormalEquations, RowMaker
from gcs_sysid.estimation.rows.rotor_signals import RotorPath
from gcs_sysid.estimation.rows.thrust_drift import ThrustDrift
from gcs_sysid.signals.one_step import step_for
from gcs_sysid.signals.records import Samples
from gcs_sysid.signals.redundant_commands import SLOW_COMMANDS
from gcs_sysid.signals.smoothers import (
    DifferentiatorSmoother,
    Smoother,
    WindowSmoother,
    noise_gains,
)

_JUDGED, _JUDGED_AGAIN = 6.0, 2.0
"""s of flight after which it is first asked whether the gyro is filtered; growth until the next."""
_LATE_GYRO = 0.003
"""s, by which a filtered gyro lags behind rotor speeds, at least: a second-order low-pass of 75 Hz.
Without one, speeds are as late as the gyro or later."""
_BY_WINDOW, _BY_STEPS = 0.95, 0.6
"""Shares of the motion of an axis that the window explains where a low-pass is behind it, at least,
and rows of one step, at most. What a low-pass does shows within a step, and the window passes
little above 5 Hz. Disturbances show in the window too."""
_SLOW_CURVE = 0.025
"""Thrust curve from slow commands, one standard deviation: what they miss bends it, by 0.04 to 0.05
on flights of another simulator at 50 Hz, whose intervals were 0.025."""
_PIECE_TIME = 0.1
"""s of samples that are taken at once."""
_NOTED_TIME = 2.0
"""s between notes of the inputs' noise, by which batches are judged: the same however blocks are
cut."""
_BATCHES, _FEWER_BATCHES = 512, 256
"""RegressionRows of commands are wide, and their batches large: fewer are kept apart."""


class FlightRecord:
    """Samples in; moments out.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        tuning: settings.

    Attributes:
        dt: s between samples.
        basis: of the rotors' part of the rows.
        rotation: (leaks, width, width) moments of the rotation.
        momentum: (3, thrusts + 3, ...) of the momentum balance.
        accelerometer: (thrusts + 5, ...) of its z axis.
        article: the article's estimator, where requested.
        commands: maker of whitened rows of commands; None where not requested.
        input_noise: of the rotors' stream.
        half_width: s, of the window.
        choice: of deviations from the model.
    """

    def __init__(
        self,
        geometry: Array,
        dt: float,
        tuning: EstimatorTuning,
    ) -> None:
        smoother: Smoother
        half_width = tuning.half_width
        if tuning.smoother == "td":
            smoother = DifferentiatorSmoother(dt, tuning.bandwidth)
        else:
            half = max(tuning.min_half_samples, round(tuning.half_width / dt))
            half_width = half * dt
            smoother = WindowSmoother(dt, half, tuning.delays)
        self.dt = dt
        self._smoother = smoother
        self.half_width = half_width
        commands = tuning.rotor_input.motors
        self.input_noise = (
            CommandNoise(geometry, dt, tuning.loop_cutoff)
            if commands
            else SpeedNoise(geometry, dt, tuning.speed_interval)
        )
        # Beside whitened rows those of the window only judge.
        self.memories = (0.0,) if tuning.whitens(dt) and not commands else tuning.leaks
        # Samples are taken in pieces of one size, however they come: whole rows, at little cost.
        self._piece = piece = smoother.step * max(round(_PIECE_TIME / (smoother.step * dt)), 1)
        self._held: Samples | None = None
        """Samples that wait for a whole piece."""
        self._noted_every = piece * max(round(_NOTED_TIME / (piece * dt)), 1)
        self._since_noted = 0
        self._note: Array | None = None
        self.basis = basis = ActuatorDynamics(
            smoother.delays,
            tuning.lags,
            tuning.curves,
            motors=commands,
            half_width=half_width,
            dt=dt,
            coupled=True,
        )
        path = RotorPath(geometry, dt, basis, tuning.gyro_cutoff)
        self._of_speeds: WhitenedRecord | None = None
        self.commands: CommandRecord | None = None
        self.choice = DeviationChoice(
            geometry, commands=commands, place=tuning.rotor_place, turn=tuning.imu_turn
        )
        steps = None
        if tuning.whitens(dt) and commands:
            given = tuning.curves[0] if len(tuning.curves) == 1 else None
            self.commands = CommandRecord(
                geometry, dt, tuning.batch_time, self.choice, given, tuning.gyro_cutoff
            )
        elif tuning.whitens(dt):
            step = step_for(dt)
            elements = ActuatorDynamics(step.delays, half_width=None, dt=dt)
            steps = step, elements
            self._of_speeds = WhitenedRecord(
                elements,
                step,
                bank_for(step.time),
                dt,
                tuning.batch_time,
            )
        self.low_passed = False
        """Whether the gyro comes through an undeclared low-pass."""
        self._judge_at = _JUDGED
        self._slow_curve = _SLOW_CURVE if commands and dt >= SLOW_COMMANDS else 0.0
        self.drift = ThrustDrift(dt) if commands else None
        """Of thrust at a given command; speeds need none."""
        self._rows = RowMaker(path, basis, smoother, steps, self.drift)
        self.row_time = smoother.step * dt
        per_batch = max(round(tuning.batch_time / self.row_time), 1)
        self._leaks = LeakySums(self.row_time, self.memories)
        kept = _FEWER_BATCHES if commands else _BATCHES
        bank = (len(self.memories), basis.width, basis.width)
        self.rotation = NormalEquations(bank, per_batch, kept)
        gains = np.array([noise_gains(smoother, dt, memory)[1] for memory in self.memories])
        self.window = WindowRecord(
            basis, self.rotation, self.memories, dt, self.row_time, per_batch, gains
        )
        self.article = (
            None
            if tuning.method == "forward"
            else article.ArticleEstimator(geometry, dt, tuning.method)
        )
        width = basis.thrusts + 3
        self.momentum = NormalEquations((3, width, width), per_batch, kept)
        self.accelerometer = NormalEquations((width + 2, width + 2), per_batch, kept)

    def reserve(self) -> None:
        """Have all memory now that a long flight will need; many records live but shortly."""
        for moments in (self.rotation, self.momentum, self.accelerometer):
            moments.reserve()
        if self._of_speeds is not None:
            self._of_speeds.reserve()

    def restart(self) -> None:
        """A gap: what comes next does not join on to what came before."""
        self.flush()
        self._rows.restart()
        self.input_noise.restart()
        self._leaks.restart()
        for record in (self._of_speeds, self.commands):
            if record is not None:
                record.restart()
        if self.article:
            self.article.restart()

    def add_samples(self, samples: Samples, stops: Sequence[int] = ()) -> Iterator[None]:
        """Take a block of samples; the outcome does not depend on how they are grouped.

        Args:
            samples: n of them.
            stops: rising, 0 to n.

        Yields:
            After each stop, when so many of the samples have been taken; but for less than a
            piece, 0.1 s, which is held back.
        """
        known = [] if self._held is None else [self._held]
        joined, before = Samples.joined([*known, samples]), sum(len(part.gyro) for part in known)
        ends = [(before + stop) // self._piece * self._piece for stop in stops]
        whole = len(joined.gyro) // self._piece * self._piece
        self._held = joined.part(slice(whole, None))
        if whole:
            yield from self._add_pieces(joined.part(slice(whole)), ends)
        else:
            yield from (None for _ in stops)

    def flush(self) -> None:
        """Take the samples held back as an incomplete piece."""
        rest, self._held = self._held, None
        if rest is not None and len(rest.gyro):
            for _ in self._add_pieces(rest, ()):
                pass

    def _add_pieces(self, samples: Samples, ends: Sequence[int]) -> Iterator[None]:
        """Make rows of all samples at once; add them up from each end to the next."""
        n, every = len(samples.gyro), self._noted_every
        noted = self._of_speeds is not None or self.commands is not None
        notes = range(every - self._since_noted, n + 1, every) if noted else ()
        edges = sorted([0, *ends, *notes, n])
        counts = [self._rows.count_after(end) for end in edges]
        steps = [self._rows.steps_after(end) for end in edges]
        made = self._rows.update(samples)
        if self.drift is not None:
            self.basis.curve_doubt = float(np.hypot(self.drift.curve_doubt, self._slow_curve))
            if self.commands is not None:
                self.commands.doubt_curve(self.drift.curve_doubt)
        summed = self._leaks.update(made.rotation)[:, 0]
        summed_before = np.append(0, np.cumsum(_whole(made.rotation)))
        parts = zip(pairwise(edges), pairwise(counts), pairwise(steps), strict=True)
        ends_left = list(ends)
        for part, rows, few in parts:
            piece = slice(*part)
            if part[0] < part[1]:
                self.input_noise.update(samples.speeds[piece], samples.apart[piece, 0])
                if self.article:
                    self.article.update(samples.part(piece))
                if self.commands is not None and made.drift is not None:
                    self.commands.add_samples(
                        made.inputs[piece],
                        samples.gyro[piece],
                        samples.rates[piece],
                        made.drift.part(piece),
                    )
            if rows[0] < rows[1]:
                self.rotation.add(summed[:, slice(*summed_before[[*rows]])])
                self.momentum.add(_complete(made.momentum, *rows))
                self.accelerometer.add(_complete(made.accelerometer, *rows))
            if self._of_speeds is not None and not self.low_passed and few[0] < few[1]:
                self._of_speeds.add(made.one_step[slice(*few)], self._noted_noise)
            self._since_noted += part[1] - part[0]
            if self._since_noted >= every:
                self._since_noted = 0
                if self._of_speeds is not None:
                    self._note = self.signals_noise
                    if self.seconds >= self._judge_at:
                        self._judge_gyro(self._of_speeds)
                elif self.commands is not None and self.commands.is_due():
                    self._tune(self.commands)
            if ends_left and part[1] == ends_left[0]:
                del ends_left[0]
                yield

    @property
    def whitened(self) -> WhitenedRecord | WindowRecord:
        """Moments of whitened rows; of the window's, where there are none, or none yet."""
        white = self._of_speeds if self.commands is None else self.commands.white
        return self.window if self.low_passed or white is None else white

    def _judge_gyro(self, white: WhitenedRecord) -> None:
        """Leave rows of one step where only a filtered gyro explains what they leave."""
        if self.low_passed:
            return
        self._judge_at = _JUDGED_AGAIN * self.seconds
        found = fit_whitened(self.window.moments(self._window_noise()), self.basis, scatter=False)
        if found is None or found.rotation.coordinates[Coordinate.DELAY] > -_LATE_GYRO:
            return
        window = found.rotation
        well = window.r_squared >= _BY_WINDOW
        if not well[:2].all():
            return
        by_steps = explained_by(white.moments(self._noted_noise()), white.basis)
        if by_steps is None or (by_steps[well] < _BY_STEPS).any():
            self.low_passed = white.narrowed = True

    def was_renewed(self) -> bool:
        """Whether what whitened rows are made of has changed since this was last asked."""
        source = self._of_speeds if self.commands is None else self.commands
        if source is None:
            return False
        was, source.narrowed = source.narrowed, False
        return was

    def settled(self) -> AbstractContextManager[None]:
        """With whitened rows of commands about the motor parameters identified so far."""
        noise = self.input_noise
        if self.commands is None or not isinstance(noise, CommandNoise):
            return nullcontext()
        return self.commands.settled(noise.level[0])

    def places(self, first: LagOf = LAGS_OF[0]) -> list[LagPlace]:
        """What may lag behind the commands, the likeliest first."""
        noise = self.input_noise
        assert isinstance(noise, CommandNoise)
        order = (first, *(of for of in LAGS_OF if of != first))
        return [LagPlace(of, *noise.level) for of in order]

    def use_place(self, place: LagPlace | None) -> None:
        """Let maps of the basis be those of what lags by a fit; None: as long as there is none."""
        if self.basis.bends:
            self.basis.lag_place = place or self.places()[0]

    def _tune(self, commands: CommandRecord) -> None:
        noise = self.input_noise
        assert isinstance(noise, CommandNoise)
        commands.tune(noise.level[0])

    def window_fit(self, place: LagPlace) -> RotationFit | None:
        """The fit to rows of the symmetric window, where commands have those of one step too.

        Args:
            place: what lags.
        """
        basis = copy(self.basis)
        basis.lag_place = place
        data = self.window.moments(self._window_noise())
        found = fit_whitened(data, basis, doubt=self.input_noise.doubt)
        return None if found is None else found.rotation

    @property
    def seconds(self) -> float:
        """Flight time that the moments of the rotation are of."""
        return self.rotation.rows * self.row_time

    @property
    def batches(self) -> tuple[int, int]:
        """How many batches of rotation and momentum have begun."""
        return len(self.rotation.batches), len(self.momentum.batches)

    @property
    def mean_thrust(self) -> MeanThrust | None:
        """By commands; None without motors for them."""
        return None if self.commands is None else self.commands.mean_thrust

    def _window_noise(self, some: Sequence[int] | None = None) -> Array:
        """(leaks, width, width) what known noise of the inputs adds to a row of the window."""
        memories = self.memories if some is None else [self.memories[i] for i in some]
        return np.stack(
            [self.input_noise.row_moments(self.basis, self._smoother, m) for m in memories]
        )

    def whitened_noise(self, some: Sequence[int] | None = None) -> Array:
        """(bank, width, width) what known noise of the inputs adds to a whitened row.

        Args:
            some: whiteners; None: all of the bank.
        """
        white = self.whitened
        if isinstance(white, WindowRecord):
            return self._window_noise(some)
        if self.commands is not None:
            # Commands that are whitened are too fast to miss anything.
            silence = white.silence
            return silence if some is None else silence[list(some)]
        return white.noise(self.signals_noise, some)

    def _noted_noise(self) -> Array:
        """(bank, width, width) of a whitened row, as known when it was last noted."""
        assert self._of_speeds is not None
        if self._note is None:
            self._note = self.signals_noise
        return self._of_speeds.noise(self._note)

    @property
    def signals_noise(self) -> Array:
        """(5, 5) covariance of roll, pitch, thrust, yaw and H in a sample, of known noise."""
        noise = self.input_noise
        return noise.of_signals if isinstance(noise, SpeedNoise) else np.zeros((5, 5))

    def forget_last(self, seconds: float) -> None:
        """Leave out at least the last `seconds` of the record (whole batches)."""
        self.flush()
        rows = int(np.ceil(seconds / self.row_time))
        for moments in (self.rotation, self.momentum, self.accelerometer):
            moments.drop_last(rows)
        for record in (self._of_speeds, self.commands):
            if record is not None:
                record.forget_last(seconds)


def _whole(rows: Array) -> Mask:
    """(n,) which of (..., n, width) rows are complete."""
    return np.isfinite(rows.sum(axis=-1)).all(axis=tuple(range(rows.ndim - 2)))


def _complete(rows: Array, start: int, stop: int) -> Array:
    """The complete ones of some of (..., n, width) rows."""
    some = rows[..., start:stop, :]
    return some[..., _whole(some), :]
