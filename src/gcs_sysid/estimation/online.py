"""The online estimator: samples in, relative estimates out, in bounded memory and time.

A running flight is followed by quick fits: a step from an earlier fit of the same record, its
warm start, with the moments of that instant. The warm start is renewed whenever a batch of
moments has begun, about once a second; now and then a full fit chooses leak and delay again. Quick
fits of one warm start are independent of one another, so that a block with many of them is one
call.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation import rotation, translation
from gcs_sysid.estimation.actuator_dynamics import CURVE, LagPlace
from gcs_sysid.estimation.axis_damping import with_axis_damping
from gcs_sysid.estimation.disturbance import RULES, curve_doubt
from gcs_sysid.estimation.input_noise import is_sparse, with_sparse_readings
from gcs_sysid.estimation.lag_hypotheses import fit_lag_places, with_lag_doubt
from gcs_sysid.estimation.motor_linearization import MeanThrust
from gcs_sysid.estimation.priors import Prior
from gcs_sysid.estimation.record import FlightRecord
from gcs_sysid.estimation.rigid_body_test import PRODUCTS, RigidBodyTest, judge_rigid_body
from gcs_sysid.estimation.rotation import RotationFit
from gcs_sysid.estimation.search import COORDINATE_STD
from gcs_sysid.estimation.thrust_drift import ThrustDrift
from gcs_sysid.estimation.translation import TranslationFit
from gcs_sysid.estimation.tuning import Tuning
from gcs_sysid.estimation.validation import Validation, validate
from gcs_sysid.estimation.whitened_estimator import LEAST_OWN, Followed, LeftOut, WhitenedEstimator
from gcs_sysid.estimation.whitened_moments import OfflineBank
from gcs_sysid.model import rigid_body
from gcs_sysid.model.rigid_body import CG_X, CG_Y
from gcs_sysid.signals.samples import Samples

_SETTLE_GROWTH = 1.5
_MIN_BATCHES = 10
"""Batches from which their scatter gives a standard deviation."""
_WELL_KNOWN = 10.0
"""s of flight from which the search for a warm start starts from the one before."""
MIN_MOMENTUM_SECONDS = 5.0
"""Flight time from which momentum balance beats the accelerometer's bias."""

PriorSource = Callable[[TranslationFit | None], Prior | None]
"""Prior knowledge, given k_T / m as far as it is known."""


class FitMoments(NamedTuple):
    """Sums of products of rows [x, y] at a fit's coordinates.

    Attributes:
        rows: (3, WIDTH, WIDTH) of each axis' rows, without the inputs' known noise.
        window: (WIDTH, WIDTH) of the rows of the symmetric window.
        number: of these; 0: not known.
    """

    rows: Array
    window: Array
    number: int = 0

    @property
    def rates(self) -> Array | None:
        """(3,) rms of roll, pitch and yaw rate, rad/s, slower than some 5 Hz; None: not known."""
        if not self.number:
            return None
        return rigid_body.rms_rates(self.window, self.number)


@dataclass(frozen=True)
class Fit:
    """What the estimator knows at one instant, relative to k_T."""

    rotation: rotation.RotationFit | None
    translation: TranslationFit | None
    seconds: float
    """Flight time used."""
    validation: Validation | None = None
    """Of full fits; of running ones the latest, if any."""
    accelerometer: TranslationFit | None = None
    """The second source of k_T / m, whichever `translation` is; of full fits, for certain."""
    rigid_body_test: RigidBodyTest | None = None
    """Whether it moves like a rigid body; None while undecided."""
    other_layout: str | None = None
    """What is wrong with the airframe's layout, where another explains the motion far better."""
    running: bool = False
    """Whether it is one of many looks at a running flight, see `uncertainty.watched_factor`."""
    moments: FitMoments | None = None
    """Moments that determine where the IMU and the rotors are, see `given_errors`."""
    aligned_by: RotationFit | None = None
    """The fit that the moments are of, where `rotation` is another estimator's."""


@dataclass(frozen=True)
class _WarmStart:
    """Starting point of a series of quick fits.

    Attributes:
        rotation: fit that is followed.
        thrust: fit of the momentum balance that is followed; None while it is too early for one.
        batches: that had begun then.
        settle: s, flight time of the next full fit.
        left_out: shocks in the rows that were whitened; None where none are.
    """

    rotation: RotationFit
    thrust: TranslationFit | None
    batches: tuple[int, int]
    settle: float
    left_out: LeftOut | None


@dataclass(frozen=True)
class _Instant:
    """The moments at one instant.

    Attributes:
        rotation: (width, width) with the leak that is followed.
        rows: in them.
        noise: of one row, see `rotation.fit_rotation`.
        whitened: the same of rows that were whitened; None where none are.
        momentum: (3, thrusts + 3, thrusts + 3).
        momentum_rows: in them.
        seconds: flight time.
        mean_thrust: by commands; None without motors for them.
    """

    rotation: Array
    rows: int
    noise: Array
    whitened: Followed | None
    momentum: Array
    momentum_rows: int
    seconds: float
    mean_thrust: MeanThrust | None


class OnlineEstimator:
    """Recursive estimator on samples of one uniform step.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        tuning: settings.
        offline: as of `FlightRecord`.
    """

    def __init__(
        self,
        geometry: Array,
        dt: float,
        tuning: Tuning,
        offline: OfflineBank | None = None,
    ) -> None:
        self.dt = dt
        self.prior: Prior | None = None
        """What else is known about the rotation; may be set at any time."""
        self.prior_source: PriorSource | None = None
        """Renews the prior with each warm start and full fit."""
        self.accelerometer_gain: translation.Gain | None = None
        """How the accelerometer reads against gravity, from an earlier segment."""
        self._record = FlightRecord(geometry, dt, tuning, offline)
        self._basis = self._record.basis
        self._speed_interval = tuning.speed_interval
        self._whitening = WhitenedEstimator(self._record, geometry)
        self._arms = geometry[:2]
        self._left_out: LeftOut | None = None
        self._settle_interval = tuning.settle_interval
        self._warm_starts: dict[str, _WarmStart] = {}
        self._rigid_body_test: RigidBodyTest | None = None
        self._validation: Validation | None = None
        """The latest of a running flight."""
        self._rigid_body_test_at = 0.0

    @property
    def _whitened(self) -> WhitenedEstimator | None:
        """None where there are no whitened rows, or none yet."""
        return None if self._record.whitened is None else self._whitening

    @property
    def seconds(self) -> float:
        """Flight time used by the rotational estimate."""
        return self._record.seconds

    @property
    def drift(self) -> ThrustDrift | None:
        """Of thrust at a given command; None: rotor speeds need none."""
        return self._record.drift

    @property
    def low_passed(self) -> bool:
        """Whether the gyro was found to come through an undeclared low-pass."""
        return self._record.low_passed

    @property
    def speed_std(self) -> Array:
        """(rotors,) rad/s, noise of the rotor speeds (or of commands, 1)."""
        return self._record.speed_std

    @property
    def bound(self) -> Array:
        """(N_THETA,) Cramer-Rao standard deviations of the latest full fit to whitened rows."""
        assert self._whitened is not None
        return self._whitened.bound

    @property
    def free(self) -> tuple[int, ...]:
        """The coordinates that are estimated, see `estimation.actuator_dynamics`."""
        return self._basis.free

    def gyro_density(self, fit: RotationFit, theta: Array) -> Array:
        """(3, 3) two-sided density of gyro noise, rad^2/s, that leaves a fit's residual.

        Noise of the rotors' inputs apart, as far as that is known.

        Args:
            fit: of this record.
            theta: (N_THETA,) what the rotors' noise acts with.
        """
        if self._whitened is not None and fit.whiteners:
            return self._whitened.gyro_density(fit, theta)
        record, n = self._record, rigid_body.N_SIGNALS
        Q = rigid_body.forward_matrix(theta)
        own = np.diag(fit.residual_covariance)
        noise = self._basis.noise_at(record.noise(fit.leak), fit.coordinates)
        rotors = np.diag(Q @ noise[:n, :n] @ Q.T)
        left = np.maximum(own - rotors, LEAST_OWN * own)
        density: Array = np.diag(left) * (self.dt / record.noise_gains()[fit.leak])
        return density

    def reserve(self) -> None:
        """Have all memory now that a long flight will need; many estimators live but shortly."""
        return self._record.reserve()

    def restart(self) -> None:
        """A gap: what comes next does not join on to what came before."""
        self._record.restart()

    def update(self, samples: Samples) -> None:
        """Take a block of samples; the outcome does not depend on how they are grouped."""
        for _ in self._record.take(samples):
            pass

    def follow(self, samples: Samples, stops: Sequence[int], series: str = "") -> list[Fit]:
        """Take a block of samples, with quick fits on the way.

        Args:
            samples: n of them.
            stops: rising, 0 to n: a fit after so many of them.
            series: see `fit`.

        Returns:
            A fit for each stop, as `update` and `fit` would give them one by one.
        """
        return self._follow(self._record.take(samples, stops), series)

    def fit(self, *, quick: bool = False, series: str = "") -> Fit:
        """The estimate from everything so far.

        Args:
            quick: go on from the last quick estimate, for a running flight; of
                the latest samples, up to 0.1 s may be left out. Otherwise the outcome is a
                function of the data alone.
            series: name of the series of quick estimates to go on with. One that decides
                something must not depend on how often others look.
        """
        if quick:
            return self._follow((None,), series)[0]
        self._record.flush()
        with self._record.settled():
            return self._full_fit()

    def _full_fit(self) -> Fit:
        self._renew_prior()
        rot = self._fit_rotation()
        trans, accelerometer = self.fit_translation(rot)
        validation = self._validate()
        rigid_body_test = self._rigid_body_test_of(rot)
        if rigid_body_test is not None and rigid_body_test.contradicted:
            # Inertia in roll and pitch is left to determine.
            rot = self._fit_without_products()
        return Fit(
            rot,
            trans,
            self.seconds,
            validation,
            accelerometer,
            rigid_body_test,
            moments=self._moments(rot),
        )

    def other_layout(self, fit: RotationFit | None) -> str | None:
        """What is wrong with the airframe's layout, if another explains the motion far better."""
        return None if self._whitened is None else self._whitened.other_layout(fit)

    def fit_translation(
        self, at: RotationFit | None = None
    ) -> tuple[TranslationFit | None, TranslationFit | None]:
        """Thrust and drag over mass from the better source, and from the accelerometer.

        Args:
            at: gives the coordinates of the basis; None: its middle.
        """
        where = self._coordinates(at)
        momentum = self._fit_momentum(where)
        accelerometer = self._fit_accelerometer(where)
        return self._with_slope(momentum or accelerometer, at), accelerometer

    def with_thrust_by(self, rotors: RotationFit | None, fit: Fit) -> Fit:
        """A fit with thrust over mass by the actuator dynamics of another one.

        Args:
            rotors: of them; None: the fit as it is.
            fit: of the whole record.
        """
        if rotors is None or CURVE not in self._basis.free:
            return fit
        thrust, accelerometer = self.fit_translation(rotors)
        return replace(fit, translation=thrust, accelerometer=accelerometer)

    def forget_last(self, seconds: float) -> None:
        """Leave out at least the last `seconds` of the record (whole batches)."""
        self._record.forget_last(seconds)
        self._warm_starts.clear()

    def _follow(self, stops: Iterable[None], series: str) -> list[Fit]:
        """Quick fits at stops of what is coming in."""
        fits: list[Fit] = []
        waiting: list[_Instant] = []
        for _ in stops:
            if self._record.was_renewed():
                if waiting:
                    fits += self._followed(self._warm_starts[series], waiting)
                    waiting = []
                self._warm_starts.clear()
            warm_start = self._warm_starts.get(series)
            if warm_start is None or self.seconds >= warm_start.settle:
                if warm_start is not None:
                    fits += self._followed(warm_start, waiting)
                waiting = []
                fits.append(self._settle(series, warm_start))
                continue
            waiting.append(self._instant(warm_start))
            if self._is_outdated(warm_start):
                fits += self._followed(warm_start, waiting)
                waiting = []
                fits[-1] = self._renewed(series, warm_start, fits[-1])
        if waiting:
            fits += self._followed(self._warm_starts[series], waiting)
        return fits

    def _instant(self, warm_start: _WarmStart) -> _Instant:
        record, leak = self._record, warm_start.rotation.leak
        whitened = None
        if self._whitened is not None:
            assert warm_start.left_out is not None
            whitened = self._whitened.instant(warm_start.rotation, warm_start.left_out)
        return _Instant(
            record.rotation.total[leak].copy(),
            record.rotation.rows,
            record.noise(leak),
            whitened,
            record.momentum.total.copy(),
            record.momentum.rows,
            self.seconds,
            self._mean_thrust(),
        )

    def _is_outdated(self, warm_start: _WarmStart) -> bool:
        return (
            warm_start.thrust is None
            or warm_start.batches != self._record.batches
            or self._is_rigid_body_test_due()
        )

    def _followed(self, warm_start: _WarmStart, instants: Sequence[_Instant]) -> list[Fit]:
        """Quick fits at several instants, from one warm start."""
        if not instants:
            return []
        rotations = self._follow_rotation(warm_start, instants)
        thrusts: Sequence[TranslationFit | None] = [None] * len(instants)
        if warm_start.thrust is not None:
            weights = [self._basis.thrust_weights(fit.coordinates) for fit in rotations]
            pairs = zip(weights, instants, strict=True)
            thrusts = translation.follow_momentum(
                np.stack([_mixed(w, i.momentum) for w, i in pairs]),
                np.array([i.momentum_rows for i in instants]),
                warm_start.thrust,
            )
        return [
            Fit(
                rot,
                self._with_slope(thrust, rot, i),
                i.seconds,
                self._validation,
                rigid_body_test=self._rigid_body_test,
                running=True,
                moments=self._moments_at(rot, i),
            )
            for rot, thrust, i in zip(rotations, thrusts, instants, strict=True)
        ]

    def _follow_rotation(
        self, warm_start: _WarmStart, instants: Sequence[_Instant]
    ) -> list[RotationFit]:
        moments = [i.whitened for i in instants if i.whitened is not None]
        if moments:
            fits = self._whitening.follow(moments, warm_start.rotation, self.prior)
            return self._doubted(fits, warm_start.rotation, instants)
        place = warm_start.rotation.lag_place
        self._use_place(place)
        fits = rotation.follow_rotation(
            np.stack([i.rotation for i in instants]),
            np.array([i.rows for i in instants]),
            self._basis,
            np.stack([i.noise for i in instants]),
            warm_start.rotation,
            self.prior,
        )
        return self._doubted(fits, warm_start.rotation, instants)

    def _doubted(
        self, fits: list[RotationFit], start: RotationFit, instants: Sequence[_Instant]
    ) -> list[RotationFit]:
        """Fits with what lags taken over from an earlier one."""
        place = start.lag_place
        if place is None:
            return [self._read(fit, instant) for fit, instant in zip(fits, instants, strict=True)]
        commands = self._record.commands
        doubted = [
            with_lag_doubt(
                fit,
                place,
                start.lag_doubt + (0.0 if commands is None else commands.distance_doubt(fit)),
            )
            for fit in fits
        ]
        return [self._read(fit, instant) for fit, instant in zip(doubted, instants, strict=True)]

    def _read(self, fit: RotationFit, instant: _Instant | None = None) -> RotationFit:
        """A fit with what its rows leave out; at an instant, or now.

        Speeds miss what happens between readings. The window has one damping for three axes.
        """
        sparse = is_sparse(self._speed_interval) and fit.lag_place is None
        by_window = self._basis.commands and not fit.whiteners
        if not (sparse or by_window):
            return fit
        found = self._moments(fit) if instant is None else self._moments_at(fit, instant)
        if found is None:
            return fit
        if sparse:
            fit = with_sparse_readings(fit, self._speed_interval, found.window)
        return with_axis_damping(fit, found.rows[0]) if by_window else fit

    def _use_place(self, place: LagPlace | None) -> None:
        """Let maps of the basis be those of what lags by a fit; None: as long as there is none."""
        if self._basis.bends:
            self._basis.lag_place = place or self._places(None)[0]

    def _places(self, start: RotationFit | None) -> list[LagPlace]:
        """What may lag behind the commands, that of an earlier fit first."""
        known = None if start is None else start.lag_place
        return self._record.places() if known is None else self._record.places(known.of)

    def _renewed(self, series: str, warm_start: _WarmStart, fit: Fit) -> Fit:
        """A quick fit of now with all that is renewed now and then; the next ones go on from it."""
        record, rot = self._record, fit.rotation
        assert rot is not None
        where = self._coordinates(rot)
        thrust = self._fit_momentum(where)
        trans = thrust or self._fit_accelerometer(where)
        followed = rot if warm_start.batches != record.batches else warm_start.rotation
        self._warm_starts[series] = replace(
            warm_start, rotation=followed, thrust=thrust, batches=record.batches
        )
        self._renew_prior()
        self._use_place(rot.lag_place)
        rigid_body_test = (
            self._rigid_body_test_of(rot)
            if self._is_rigid_body_test_due()
            else self._rigid_body_test
        )
        return replace(
            fit, translation=self._with_slope(trans, rot), rigid_body_test=rigid_body_test
        )

    def _settle(self, series: str, before: _WarmStart | None) -> Fit:
        """A fit that chooses leak and delay, as a warm start for those to come."""
        self._renew_prior()
        known = before if self.seconds > _WELL_KNOWN else None
        rot = self._fit_rotation(None if known is None else known.rotation)
        where = self._coordinates(rot)
        thrust = self._fit_momentum(where)
        trans = thrust or self._fit_accelerometer(where)
        if rot is not None and self._record.article is None:
            settle = max(self.seconds + self._settle_interval, _SETTLE_GROWTH * self.seconds)
            self._warm_starts[series] = _WarmStart(
                rot, thrust, self._record.batches, settle, self._left_out
            )
        rigid_body_test = (
            self._rigid_body_test_of(rot)
            if self._is_rigid_body_test_due()
            else self._rigid_body_test
        )
        trans = self._with_slope(trans, rot)
        if self._whitened is not None and not series:
            self._validation = self._validate()
        return Fit(
            rot,
            trans,
            self.seconds,
            self._validation,
            rigid_body_test=rigid_body_test,
            running=True,
            moments=self._moments(rot),
        )

    def _moments(self, fit: RotationFit | None) -> FitMoments | None:
        """Moments of the whole record, at a fit of it."""
        if fit is None or self._record.article is not None:
            return None
        warm_start = _WarmStart(fit, None, self._record.batches, 0.0, self._left_out)
        return self._moments_at(fit, self._instant(warm_start))

    def _moments_at(self, fit: RotationFit, instant: _Instant) -> FitMoments:
        basis, at = self._record.basis, fit.coordinates
        # Leaky sums of rates are no rates.
        count = instant.rows if self._record.memories[fit.leak] == 0.0 else 0
        if instant.whitened is not None:
            white = instant.whitened
            without = white.moments - white.rows * white.noise
            # Whitened rows have a range of their own.
            within = np.clip(at, basis.low, basis.high)
            return FitMoments(
                white.basis.moments_at(without, at),
                basis.moments_at(instant.rotation, within),
                count,
            )
        window = basis.moments_at(instant.rotation, at)
        without = window - instant.rows * basis.noise_at(instant.noise, at)
        return FitMoments(np.broadcast_to(without, (3, *without.shape)), window, count)

    def _is_calm(self) -> bool:
        """Whether it is known that no steady wind blows; without velocity nothing is."""
        momentum = self._fit_momentum(self._coordinates(None))
        return momentum is not None and momentum.wind < translation.CALM

    def _renew_prior(self) -> None:
        if self.prior_source is not None:
            self.prior = self.prior_source(self.fit_translation()[0])

    def _fit_rotation(self, start: RotationFit | None = None) -> RotationFit | None:
        fit = self._fitted_rotation(start)
        return None if fit is None else self._read(fit)

    def _fitted_rotation(self, start: RotationFit | None) -> RotationFit | None:
        record = self._record
        if record.article:
            return record.article.fit()
        if self._whitened is not None:
            found = self._whitened.fit(start, self.prior, calm=self._is_calm())
            if found is None:
                return None
            fitted, self._left_out = found
            return self._with_motor_doubt(fitted)
        moments = record.rotation
        data = moments.batches, moments.counts, self._basis, self._noise()
        if self._basis.bends:
            return self._fit_lag_places(start)
        if start is not None:
            fit = rotation.fit_rotation(*data, start, self.prior, record.noise_doubt)
            if fit is not None and fit.converged:
                return fit
        return rotation.fit_rotation(*data, prior=self.prior, doubt=record.noise_doubt)

    def _with_motor_doubt(self, fit: RotationFit) -> RotationFit:
        """A fit to whitened rows; of commands, with what is not known of the motors."""
        record = self._record
        if record.commands is None:
            return fit
        assert self._whitened is not None
        place = record.places(self._whitened.basis.lag_place.of)[0]
        commands = record.commands
        off = commands.doubt + curve_doubt(fit) + commands.distance_doubt(fit)
        mean = commands.mean_thrust
        if mean is not None and fit.disturbance.max() > RULES.detected:
            # Each rotor's mean thrust may be off by what asymmetry adds to it.
            share, _ = mean.rectified(fit.coordinates)
            for place_of, arms in ((CG_X, self._arms[0]), (CG_Y, self._arms[1])):
                off[place_of, place_of] += share**2 * float((arms**2).mean()) / len(arms)
        return with_lag_doubt(fit, place, off)

    def _fit_lag_places(self, start: RotationFit | None) -> RotationFit | None:
        """Of commands, with what lags as a hypothesis."""
        record = self._record
        moments, places = record.rotation, self._places(start)
        data = moments.batches, moments.counts, self._basis, self._noise()
        independent = record.seconds / record.half_width
        others = self.prior, record.noise_doubt
        if start is not None:
            fit = fit_lag_places(*data, places, independent, start, *others)
            if fit is not None and fit.converged:
                return fit
        return fit_lag_places(*data, places, independent, None, *others, start)

    def _fit_momentum(self, where: Array) -> TranslationFit | None:
        """Of the momentum balance, at (3,) coordinates; None while it is too early."""
        record, weights = self._record, self._basis.thrust_weights(where)
        if record.momentum_seconds <= MIN_MOMENTUM_SECONDS:
            return None
        batches, total = (
            _mixed(weights, m) for m in (record.momentum.batches, record.momentum.total)
        )
        return translation.fit_momentum(batches, record.momentum.counts, total)

    def _fit_accelerometer(self, where: Array) -> TranslationFit | None:
        """Of the accelerometer's z axis, at (3,) coordinates."""
        moments = self._record.accelerometer
        mixed = _mixed(self._basis.thrust_weights(where), moments.batches)
        return translation.fit_accelerometer(mixed, moments.counts, self.accelerometer_gain)

    def _coordinates(self, fit: RotationFit | None) -> Array:
        """(3,) of a fit, or the basis' middle with the thrust curve that is known beforehand."""
        self._use_place(None if fit is None else fit.lag_place)
        where: Array = self._basis.nodes[self._basis.middle] if fit is None else fit.coordinates
        if fit is None and self.prior is not None and CURVE in self._basis.free:
            curve, _ = self.prior.thrust_curve
            where = where.copy()
            if np.isfinite(curve):
                where[CURVE] = np.clip(curve, self._basis.low[CURVE], self._basis.high[CURVE])
        return where

    def _with_slope(
        self,
        fit: TranslationFit | None,
        at: RotationFit | None,
        instant: _Instant | None = None,
    ) -> TranslationFit | None:
        """The fit with how kappa changes with the thrust curve, where that is unknown.

        It is gravity over the mean share of thrust.

        Args:
            fit: of thrust over mass.
            at: what else is known.
            instant: that the fit is of; None: now.
        """
        if fit is None or (at is None and CURVE not in self._basis.free):
            return fit
        if self._whitened is not None and at is not None:
            fit = self._whitened.judged_thrust(fit, at)
            mean = instant.mean_thrust if instant is not None else self._mean_thrust()
            if mean is not None:
                # Thrust of the rows that kappa is of has one time constant.
                share, slope = mean.rectified(at.coordinates)
                motors = slice(rigid_body.N_THETA, rigid_body.N_THETA + len(slope))
                variance = float(slope @ at.full_covariance[motors, motors] @ slope)
                if at.disturbance.max() > RULES.detected:
                    # Asymmetry is then what disturbs, too.
                    variance += share * share
                spread = float(np.hypot(fit.kappa_std, fit.kappa * variance**0.5)) / (1.0 + share)
                fit = replace(fit, kappa=fit.kappa / (1.0 + share), kappa_std=spread)
        if CURVE not in self._basis.free:
            return fit
        where = self._coordinates(at)
        total = self._record.momentum.total if instant is None else instant.momentum
        if fit.source == "accelerometer":
            total = self._record.accelerometer.total
        step = 0.05 * np.eye(len(where))[CURVE]
        less, more = (
            float(mixed[..., 2, 0].ravel()[-1])  # of the vertical axis
            for c in (where - step, where + step)
            for mixed in (_mixed(self._basis.thrust_weights(c), total),)
        )
        change = -fit.kappa * (more - less) / (0.5 * (more + less)) / (2.0 * step[CURVE])
        if at is None:
            # Of the curve nothing is known yet but what was known, or what it ordinarily is.
            known = np.inf if self.prior is None else self.prior.thrust_curve[1]
            curve_std = min(known, float(COORDINATE_STD[CURVE]))
            return replace(fit, kappa_std=float(np.hypot(fit.kappa_std, change * curve_std)))
        return replace(fit, curve_slope=float(change))

    def _mean_thrust(self) -> MeanThrust | None:
        commands = self._record.commands
        return None if commands is None else commands.mean_thrust

    def _is_rigid_body_test_due(self) -> bool:
        record = self._record
        return (
            record.article is None
            and len(record.rotation.batches) >= _MIN_BATCHES
            and self.seconds >= self._rigid_body_test_at
        )

    def _rigid_body_test_of(self, fit: RotationFit | None) -> RigidBodyTest | None:
        """Whether the body is rigid; None while undecided."""
        moments = self._record.rotation
        if fit is None or self._record.article or len(moments.batches) < _MIN_BATCHES:
            return None
        self._rigid_body_test_at = _SETTLE_GROWTH * self.seconds
        if self._whitened is not None:
            self._rigid_body_test = self._whitened.test_rigid_body(fit)
            return self._rigid_body_test
        P = self._basis.map_at(fit.coordinates)
        self._rigid_body_test = judge_rigid_body(moments.batches[:, fit.leak], P, fit.Q)
        return self._rigid_body_test

    def _validate(self) -> Validation | None:
        record = self._record
        if record.article is not None:
            return None
        if self._whitened is not None:
            return self._whitened.validate(self.prior)
        return validate(
            record.rotation.batches,
            record.rotation.counts,
            self._basis,
            self._noise(),
            record.noise_gains(),
            self.prior,
        )

    def _fit_without_products(self) -> RotationFit | None:
        fit = self._fitted_without_products()
        return None if fit is None else self._read(fit)

    def _fitted_without_products(self) -> RotationFit | None:
        if self._whitened is not None:
            found = self._whitened.fit(prior=self.prior, rigid=False)
            return None if found is None else self._with_motor_doubt(found[0])
        fit = rotation.fit_rotation(
            self._without_products(),
            self._record.rotation.counts,
            self._basis,
            self._noise(),
            prior=self.prior,
            doubt=self._record.noise_doubt,
        )
        if fit is None or not self._basis.bends:
            return fit
        return replace(fit, lag_place=self._basis.lag_place)

    def _without_products(self) -> Array:
        """The moments as if products of rates were zero: of a body without gyroscopic torque."""
        moments: Array = self._record.rotation.batches.copy()
        places = self._basis.body_places(PRODUCTS)
        moments[..., places, :] = 0.0
        moments[..., :, places] = 0.0
        return moments

    def _noise(self) -> Array:
        return np.stack([self._record.noise(i) for i in range(len(self._record.memories))])


def _mixed(weights: Array, moments: Array) -> Array:
    """(..., WIDTH, WIDTH) of rows whose thrusts are mixed by their (thrusts,) weights."""
    if len(weights) == 1:
        return moments
    mixer = np.zeros((translation.WIDTH, moments.shape[-1]))
    mixer[0, :-3] = weights
    mixer[1:, -3:] = np.eye(3)
    mixed: Array = mixer @ moments @ mixer.T
    return mixed
