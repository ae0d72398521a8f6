"""The record of a flight on commands: rows linearized about motor parameters identified in flight.

The actuator dynamics are known well enough for rows of one step only after a few seconds of flight,
so the first two minutes of samples are kept. As the flight continues, its rows are formed again
about the motor parameters found by then, whitened and summed (`whitened_record`). Once the motors
are known, rows are formed once and the samples are dropped. The samples alone decide when, not when
estimates are requested.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.deviations import DeviationChoice
from gcs_sysid.estimation.fit.lag_places import rivals_doubt
from gcs_sysid.estimation.fit.priors import COORDINATE_MEAN, COORDINATE_STD, N_UNKNOWNS, Unknown
from gcs_sysid.estimation.fit.problem import axis_power, residual_maker
from gcs_sysid.estimation.fit.rotation import RotationFit, along
from gcs_sysid.estimation.fit.whitened_fit import WhitenedFit, fit_whitened
from gcs_sysid.estimation.noise.whitening import bank_for_commands
from gcs_sysid.estimation.record.whitened_record import WhitenedRecord
from gcs_sysid.estimation.rows.actuator_dynamics import LAGS_OF, Coordinate, LagOf
from gcs_sysid.estimation.rows.motor_linearization import (
    STEP,
    LocalDynamics,
    MeanThrust,
    MotorRows,
    step_of,
)
from gcs_sysid.estimation.rows.rotor_signals import low_pass_for
from gcs_sysid.estimation.rows.thrust_drift import Drift, hindsight
from gcs_sysid.model import rigid_body as rb

TRUSTED = 4.0
"""Steps of the linearization that a round goes at most: farther off the rows are not what motors
there make. A curve of 0.85 went to 0.23 in one round, to where its residual only seemed less."""
_NO_RIVAL, _CLOSE = 0.2, 2.0
"""Nats a row by which a place of the lag must be less likely, and steps of the linearization within
which its motors must be, for its rows not to be made again: on recorded flights that brought at
most half as much."""
RIVAL = 20.0
"""Nats by which a place of the lag must be less likely to count no more: its weight is 2e-9."""


@dataclass(frozen=True)
class TunedRows:
    """Rows about one set of motors.

    Attributes:
        basis: the motors.
        maker: of the rows.
        white: their moments.
        fit: to these, when they were made.
        away: (N_UNKNOWNS,) remaining error where the motors moved away.
        samples: that they were made of at once; 0: some were forgotten since.
        places: of the lag that are still compared, this one among them.
    """

    basis: LocalDynamics
    maker: MotorRows
    white: WhitenedRecord
    fit: WhitenedFit
    away: Array
    samples: int
    places: tuple[LagOf, ...] = LAGS_OF

    @property
    def trusted(self) -> bool:
        """Whether the motors found are those that the rows are made about, nearly."""
        return self.is_within(TRUSTED)

    def is_within(self, steps: float) -> bool:
        """Whether the motors found are so many steps of the linearization away, at most."""
        return self._is_near(self.fit.rotation, steps)

    @property
    def stayed(self) -> bool:
        """Whether rows about the motors found would show these again.

        They hardly moved by the steps of the linearization; or, where the flight knows them less
        well than that, by their standard deviations together.
        """
        if self.is_within(STAYED):
            return True
        places = rb.N_THETA + np.array(self.basis.free)
        off = self.fit.rotation.unknowns[places] - self.basis.at[list(self.basis.free)]
        known = self.fit.rotation.full_covariance[np.ix_(places, places)]
        return self.trusted and float(off @ np.linalg.solve(known, off)) < STAYED**2

    @property
    def next_at(self) -> Array:
        """(N_COORDINATES,) motors about which rows are made next: those found, where these are not
        too far off.
        """
        far = TRUSTED * self.basis.moved
        return np.clip(self.fit.rotation.coordinates, self.basis.at - far, self.basis.at + far)

    def distance_doubt(self, fit: RotationFit) -> Array:
        """(N_UNKNOWNS, N_UNKNOWNS) covariance of what a later fit to the rows may be off by.

        The motors may be found, from more flight, far from those that the rows are made about. Then
        curve and lag are what they ordinarily are, and all unknowns go with them, until rows are
        made again.
        """
        doubt = np.zeros_like(fit.full_covariance)
        if self._is_near(fit, TRUSTED):
            return doubt
        for place in (Unknown.CURVE, Unknown.LAG):
            off = along(fit.full_covariance, place, COORDINATE_STD[place - rb.N_THETA])
            doubt += np.outer(off, off)
        return doubt

    def _is_near(self, fit: RotationFit, steps: float) -> bool:
        off = np.abs(fit.coordinates - self.basis.at)
        return bool((off <= steps * self.basis.moved).all())

    @property
    def is_believed(self) -> bool:
        """Whether they explain roll and pitch at all."""
        return float(self.fit.rotation.r_squared[:2].min()) >= _BELIEVED

    @property
    def shocks(self) -> Sequence[bool]:
        """Which short batches hold one, as far as rows about other motors need not judge them."""
        return self.white.judged if self.samples and self.trusted else ()

    def restart(self) -> None:
        """A gap: what comes next does not join on to what came before."""
        self.maker.restart()
        self.white.restart()

    def is_far_likelier_than(self, other: "TunedRows", *, tried: bool) -> bool:
        """Whether rows about its motors would not make another place of the lag a rival, nor change
        how far it is from one.

        Args:
            other: on its way to its motors.
            tried: whether its rows have been made again as often as those of one that is no rival.
        """
        worse = other.cost - self.cost
        if tried:
            return worse > RIVAL
        return other.is_within(_CLOSE) and worse > _NO_RIVAL * other.white.rows

    @cached_property
    def cost(self) -> float:
        """Nats of all samples, shocks included: what is left out differs from one to another.

        So does the number of rows, as slower motors take longer until their past is forgotten.
        """
        rows = self.samples / self.maker.step.step
        return 0.5 * rows * float(np.log(self._power.min(axis=0) / self.white.rows).sum())

    @property
    def _power(self) -> Array:
        """(bank, 3) of the innovations of all rows, times their number."""
        fit = self.fit.rotation
        TP = residual_maker(fit.Q) @ self.basis.map_at(fit.coordinates)
        return axis_power(TP, self.white.total[:, None])


FIRST, LAST = 6.0, 120.0
"""s of flight from which motors are looked for, and from which they are known."""
_SURE = 20.0
"""s of flight, from which what is ruled out as the place of the lag is not tried again."""
_GROWTH = 2.0
"""By how much a flight grows until they are looked for again."""
_CHECKED = 1.25
"""By how much it grows until it is seen whether they have moved too far for the rows. A search that
found a lag of 48 ms for one of 119 in 24 s showed Ixx 25 % off, `identified`, up to 48 s."""
_ROUNDS, _ROUNDS_OF_OTHERS = 16, 2
"""Times that rows are made again, at most, until the motors stay; and where something else lags and
is no rival. Curve, asymmetry and exponent make a bent valley: a curve of 0.84 for 0.31 came nearer
by 0.1 a round."""
STAYED = 0.3
"""Of the steps of the linearization; a smaller move leaves less than 1e-3 of a signal."""
_BELIEVED = 0.3
"""Share of roll and pitch that a window must explain before motors are looked for."""
_GRID = np.array([2e-4, 2e-4, 5e-3, 0.01, 0.02])
"""s, s, 1, 1, 1, to which motors are rounded: rounding of sums in another order then changes
nothing of the rows."""
_AT_ONCE = 1000
"""Samples made into rows at a time."""

_BETWEEN = 0.006
"""s between commands, above which what was commanded in between counts: rows of one step take each
for a straight line to the next."""
_JUMPS = 1.0 / 16.0
"""Of the time between these, by which all jumps of commands together may seem late, one standard
deviation: each falls anywhere between two, and a flight has some twenty. Damping is what such a
delay changes most: it was 20 to 30 % off at 100 Hz where jumps kept step with the samples."""

_SAMPLES_A_ROW = 3
"""Means of faster samples show all that rows do, and less of what shakes the gyro."""
_TIMING = np.array([Unknown.DELAY, Unknown.LAG])
_Samples = tuple[Array, Array, Array, Array, Array]
"""Commands, gyro and rates; D and w, as of `thrust_drift.Drift`."""


class CommandRecord:
    """Samples in; moments of whitened rows out, once there are motors to make them with.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        batch_time: s, of long batches.
        choice: of deviations, of which those given are unknowns.
        curve: thrust curve that is given; None: it is unknown.
        gyro_cutoff: Hz of the autopilot's second-order low-pass of its gyro; None: there is none.
    """

    def __init__(
        self,
        geometry: Array,
        dt: float,
        batch_time: float,
        choice: DeviationChoice | None = None,
        curve: float | None = None,
        gyro_cutoff: float | None = None,
    ) -> None:
        # Behind a linear lag the order does not matter, and the curve hardly bends so fast.
        self._low_pass = low_pass_for(gyro_cutoff, dt)
        self._together = max(round(STEP / (_SAMPLES_A_ROW * dt)), 1)
        self._rest: _Samples | None = None
        """Samples that wait for those they are averaged with."""
        self._dt = dt = self._together * dt
        self._geometry, self._batch_time, self._curve = geometry, batch_time, curve
        self._choice = choice
        self._kept: list[_Samples | None] | None = []
        """Samples, None where what follows does not join on; None altogether: kept no more."""
        self._samples = 0
        self._now: TunedRows | None = None
        self._first = self._next = self._check = FIRST
        self._curve_doubt = 0.0
        self.narrowed = False
        """Whether rows have been made again, as of `WhitenedRecord`."""
        self._settled: tuple[int, TunedRows, Array] | None = None
        self.doubt = np.zeros((N_UNKNOWNS, N_UNKNOWNS))
        """Error of an estimate from not knowing what lags."""

    @property
    def white(self) -> WhitenedRecord | None:
        """The moments; None as long as there are no motors to make rows with."""
        return None if self._now is None else self._now.white

    @property
    def mean_thrust(self) -> MeanThrust | None:
        """Of the samples so far; None as long as there are no motors."""
        return None if self._now is None else self._now.maker.mean_thrust

    def go_on_from(self, before: "CommandRecord") -> None:
        """Make rows about another record's motors until as much flight shows them again.

        Args:
            before: of the same rotors.
        """
        made = before._now
        if made is None:
            return
        at, of = before._start_from(made)
        basis = LocalDynamics(self._rounded(at), of, self._dt, curve=self._curve is None)
        rows = self._made(basis, made.maker.hover)
        self._now = TunedRows(basis, *rows, made.fit, made.away, 0, made.places)
        self.doubt = before.doubt.copy()
        self._first = max(min(before._samples * self._dt, LAST), before._first)
        self._next = self._check = self._first

    def doubt_curve(self, std: float) -> None:
        """One standard deviation of the thrust curve that no scatter shows."""
        self._curve_doubt = std
        if self._now is not None:
            self._now.basis.curve_doubt = std

    def is_due(self) -> bool:
        """Whether the motors are to be looked for now: it is time, or they are not the rows' any
        more. Asked after a number of samples, as it notes when it looked.
        """
        seconds = self._samples * self._dt
        if self._kept is None:
            return False
        if seconds >= self._next:
            return True
        if self._now is None or seconds < self._check:
            return False
        self._check = _CHECKED * seconds
        found = self._fitted(self._now.white, self._now.basis, self._now.fit.rotation)
        return found is not None and not replace(self._now, fit=found).trusted

    def distance_doubt(self, fit: RotationFit) -> Array:
        """(N_UNKNOWNS, N_UNKNOWNS) covariance of a fit's error where its motors are far from those
        that the rows are made about.
        """
        return np.zeros_like(self.doubt) if self._now is None else self._now.distance_doubt(fit)

    def add_samples(self, inputs: Array, gyro: Array, rates: Array, drift: Drift) -> None:
        """Take samples.

        Args:
            inputs: (n, rotors) commands, corrected for the drift.
            gyro: (n, 3) rad/s.
            rates: (n, 3) rad/s.
            drift: for which the commands were corrected.
        """
        if self._low_pass is not None:
            inputs = self._low_pass.update(inputs)
        parts = self._averaged((inputs, gyro, rates, drift.applied, drift.fallen))
        self._samples += len(parts[0])
        if self._kept is not None:
            self._kept.append(parts)
        if self._now is not None:
            _add(self._now.maker, self._now.white, *parts[:3])

    def _averaged(self, parts: _Samples) -> _Samples:
        """Means of so many samples each; copies."""
        if self._rest is not None:
            parts = _of_each(np.concatenate, zip(self._rest, parts, strict=True))
        n = self._together
        whole = len(parts[0]) // n * n
        self._rest = _of_each(lambda part: part[whole:].copy(), parts)
        return _of_each(lambda part: part[:whole].reshape(-1, n, *part.shape[1:]).mean(1), parts)

    def restart(self) -> None:
        """A gap: what comes next does not join on to what came before."""
        self._rest = None
        if self._low_pass is not None:
            self._low_pass.restart()
        if self._kept:
            self._kept.append(None)
        if self._now is not None:
            self._now.restart()

    def forget_last(self, seconds: float) -> None:
        """Leave out at least the last `seconds` of the record."""
        self._settled = self._rest = None
        if self._now is not None:
            self._now.white.forget_last(seconds)
            self._now.restart()
            # Whole batches are: what is left of them is in rows that the next look makes.
            self._now = replace(self._now, samples=0)
        if self._kept is None:
            return
        left = int(np.ceil(seconds / self._dt))
        while left > 0 and self._kept:
            last = self._kept.pop()
            if last is None:
                continue
            n = len(last[0])
            if n > left:
                self._kept.append(tuple(part[: n - left] for part in last))  # type: ignore[arg-type]
            self._samples -= min(n, left)
            left -= n
        self._kept.append(None)

    def tune(self, hover: float) -> None:
        """Look for the motors, and make rows about them from the beginning.

        Args:
            hover: mean command.
        """
        seconds = self._samples * self._dt
        self._next = min(max(_GROWTH * seconds, self._next), max(LAST, seconds + FIRST))
        self._check = _CHECKED * seconds
        start = (COORDINATE_MEAN, LAGS_OF[0]) if self._now is None else self._start_from(self._now)
        found = self._found(start, hover)
        if found is not None:
            self._now, self.doubt = found
            if not self._now.is_believed:
                self._now = None
            self.narrowed = True
        if seconds >= LAST:
            self._kept = None

    @contextmanager
    def settled(self, hover: float) -> Iterator[None]:
        """With rows about the best motor parameters so far; a function of the flight alone.

        Args:
            hover: mean command, where none have been looked for yet.
        """
        before, doubt = self._now, self.doubt
        known = before is not None and self._samples * self._dt < self._first
        if self._kept is not None and self._samples and not known:
            if self._settled is None or self._settled[0] != self._samples:
                start = (COORDINATE_MEAN, LAGS_OF[0])
                if before is not None:
                    start, hover = self._start_from(before), before.maker.hover
                found = self._found(start, hover)
                if before is None and found is not None and not found[0].is_believed:
                    found = None
                self._settled = (self._samples, *(found or (before, doubt)))
            _, self._now, self.doubt = self._settled
        try:
            yield
        finally:
            self._now, self.doubt = before, doubt

    def _found(self, start: tuple[Array, LagOf], hover: float) -> tuple[TunedRows, Array] | None:
        """Rows about the likeliest motors, and what is not known of these."""
        first = self._converged(*start, hover, self._now)
        if first is None:
            return None
        tried, at = [first], first.fit.rotation.coordinates
        places = LAGS_OF if self._now is None else self._now.places
        for other in places:
            if other != first.basis.lag_place.of:
                tuned = self._converged(at, other, hover, first, rival=True)
                if tuned is not None:
                    tried.append(tuned)
        # Far from the motors that rows are linearized about, their residuals carry no information.
        found = [tuned for tuned in tried if tuned.trusted] or tried[:1]
        cost = np.array([tuned.cost for tuned in found])
        best = int(np.argmin(cost))
        doubt = rivals_doubt([tuned.fit.rotation for tuned in found], cost.tolist())
        doubt += np.outer(found[best].away, found[best].away)
        if self._dt > _BETWEEN:
            known = found[best].fit.rotation.full_covariance
            late = np.linalg.solve(known[np.ix_(_TIMING, _TIMING)], [_JUMPS * self._dt, 0.0])
            off = known[:, _TIMING] @ late
            doubt += np.outer(off, off)
        # Delay and lag trade against each other within a sample: on three flights of PX4's
        # simulator the lag came out 3 to 5 ms short at 4 ms, the delay as much early.
        doubt[np.ix_(_TIMING, _TIMING)] += self._dt**2
        if self._samples * self._dt >= _SURE:
            # More of the flight makes places that are ruled out less likely still.
            no_rivals = {t.basis.lag_place.of for t in tried if t.cost > found[best].cost + RIVAL}
            places = tuple(of for of in places if of not in no_rivals)
        return replace(found[best], places=places), doubt

    def _converged(
        self,
        at: Array,
        of: LagOf,
        hover: float,
        alike: TunedRows | None,
        *,
        rival: bool = False,
    ) -> TunedRows | None:
        """Rows about the motors of one place of the lag; None while there is no fit.

        Args:
            at: motors to start from.
            of: what lags.
            hover: mean command.
            alike: rows about other motors.
            rival: whether this place is but compared with that of `alike`.
        """
        tuned, leading = None, alike if rival else None
        for round_ in range(_ROUNDS):
            basis = LocalDynamics(self._rounded(at), of, self._dt, curve=self._curve is None)
            maker, white = self._made(basis, hover, alike)
            start = alike.fit.rotation if alike is not None and alike.trusted else None
            found = self._fitted(white, basis, start)
            if found is None:
                return tuned
            before, away = tuned, np.zeros(N_UNKNOWNS)
            alike = tuned = TunedRows(basis, maker, white, found, away, self._samples)
            if tuned.stayed:
                break
            if before is not None:
                away = found.rotation.unknowns - before.fit.rotation.unknowns
                tuned = replace(tuned, away=away)
            tried = round_ + 1 >= _ROUNDS_OF_OTHERS
            if leading is not None and leading.is_far_likelier_than(tuned, tried=tried):
                break
            at = tuned.next_at
        return tuned

    def _start_from(self, tuned: TunedRows) -> tuple[Array, LagOf]:
        """Motors that rows show by now, and what lags; those of the rows, where they stayed."""
        found = self._fitted(tuned.white, tuned.basis, tuned.fit.rotation)
        of = tuned.basis.lag_place.of
        now = tuned if found is None else replace(tuned, fit=found)
        return (tuned.basis.at if now.stayed else now.next_at), of

    def _fitted(
        self, white: WhitenedRecord, basis: LocalDynamics, start: RotationFit | None = None
    ) -> WhitenedFit | None:
        """The motors; their standard deviations count for slow commands alone.

        Args:
            white: moments of rows.
            basis: that they are made about.
            start: what rows about other motors showed; None: from the data alone.
        """
        data = white.moments(white.silence)
        return fit_whitened(
            data, basis, start, choice=self._choice, scatter=self._dt > _BETWEEN, others=False
        )

    def _rounded(self, at: Array) -> Array:
        rounded: Array = np.rint(at / _GRID) * _GRID
        if self._curve is not None:
            rounded[Coordinate.CURVE] = self._curve
        return rounded

    def _made(
        self,
        basis: LocalDynamics,
        hover: float,
        alike: TunedRows | None = None,
    ) -> tuple[MotorRows, WhitenedRecord]:
        """All samples kept, as rows.

        Args:
            basis: the motors.
            hover: mean command.
            alike: rows about others: a shock in them is one, where these are not far off.
        """
        assert self._kept is not None
        basis.curve_doubt = self._curve_doubt
        step = step_of(self._dt)
        bank = bank_for_commands(step.time)
        maker = MotorRows(self._geometry, self._dt, basis, hover)
        judged = () if alike is None else alike.shocks
        white = WhitenedRecord(basis, step, bank, self._dt, self._batch_time, judged)
        # A stretch of which nothing could be used has no samples.
        latest = next((p for p in reversed(self._kept) if p is not None and len(p[3])), None)
        for joined, run in groupby(self._kept, lambda part: part is not None):
            if not joined:
                maker.restart()
                white.restart()
                continue
            if latest is None:
                continue
            some = [part for part in run if part is not None]
            inputs, gyro, rates, applied, fallen = map(np.concatenate, zip(*some, strict=True))
            factors = hindsight(Drift(applied, fallen), latest[3][-1], latest[4][-1])
            _add(maker, white, inputs * factors[:, None], gyro, rates)
        maker.restart()
        white.restart()
        return maker, white


def _of_each(make: Callable[[Any], Array], parts: Iterable[Any]) -> _Samples:
    inputs, gyro, rates, applied, fallen = (make(part) for part in parts)
    return inputs, gyro, rates, applied, fallen


def _add(maker: MotorRows, white: WhitenedRecord, *samples: Array) -> None:
    n = len(samples[0])
    for start in range(0, n, _AT_ONCE):
        some = (part[start : start + _AT_ONCE] for part in samples)
        white.add(maker.update(*some), lambda: white.silence)
