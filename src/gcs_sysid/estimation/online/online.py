"""The online estimator: samples in, relative estimates out, in bounded memory and time.

A running flight is followed by quick fits: a step from an earlier fit of the same record, its
warm start, with the moments of that instant. The warm start is renewed whenever a batch of
moments has begun, about once a second; now and then a full fit chooses whiteners and delay again.
Quick fits of one warm start are independent of one another, so that a block with many of them is
one call.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.checks.model_tests import RigidBodyTest
from gcs_sysid.estimation.checks.validation import Validation
from gcs_sysid.estimation.fit.priors import Prior
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.translation import TranslationFit
from gcs_sysid.estimation.online.fit import Fit, Instant
from gcs_sysid.estimation.online.rotation_estimator import LeftOut, RotationEstimator
from gcs_sysid.estimation.online.thrust_estimator import ThrustEstimator
from gcs_sysid.estimation.record.record import FlightRecord
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.signals.records import Samples

_SETTLE_GROWTH = 1.5
_WELL_KNOWN = 10.0
"""s of flight from which the search for a warm start starts from the one before."""

PriorSource = Callable[[Fit], Prior | None]
"""Prior knowledge, given k_T / m as far as it is known."""


@dataclass(frozen=True)
class _SeriesStart:
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


class OnlineEstimator:
    """Recursive estimator on samples of one uniform step.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        tuning: settings.
    """

    def __init__(
        self,
        geometry: Array,
        dt: float,
        tuning: EstimatorTuning,
    ) -> None:
        self.dt = dt
        self.prior: Prior | None = None
        """What else is known about the rotation; may be set at any time."""
        self.prior_source: PriorSource | None = None
        """Renews the prior with each warm start and full fit, by what the flight alone shows."""
        self._alone: RotationFit | None = None
        self.record = FlightRecord(geometry, dt, tuning)
        """All that is remembered of the flight."""
        self.thrust = ThrustEstimator(self.record, tuning.imu_place)
        self.rotation = RotationEstimator(self.record, self.thrust, geometry)
        """Fits to it, as `thrust`."""
        self._settle_interval = tuning.settle_interval
        self._warm_starts: dict[str, _SeriesStart] = {}
        self._rigid_body_test: RigidBodyTest | None = None
        self._validation: Validation | None = None
        """The latest of a running flight."""
        self._other_layout: str | None = None
        """Likewise."""
        self._rigid_body_test_at = 0.0

    @property
    def seconds(self) -> float:
        """Flight time used by the rotational estimate."""
        return self.record.seconds

    @property
    def is_calm(self) -> bool:
        """Whether no steady wind blows."""
        return self.thrust.is_calm(self.prior)

    def restart(self) -> None:
        """A gap: what comes next does not join on to what came before."""
        self.record.restart()

    def update(self, samples: Samples) -> None:
        """Take a block of samples; the outcome does not depend on how they are grouped."""
        for _ in self.record.add_samples(samples):
            pass

    def follow(self, samples: Samples, stops: Sequence[int]) -> list[Fit]:
        """Take a block of samples, with quick fits on the way.

        Args:
            samples: n of them.
            stops: rising, 0 to n: a fit after so many of them.

        Returns:
            A fit for each stop, as `update` and `fit` would give them one by one.
        """
        return self._follow(self.record.add_samples(samples, stops), "")

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
        self.record.flush()
        with self.record.settled():
            return self._full_fit()

    def fit_thrust(self) -> Fit:
        """Thrust over mass, with lag and thrust curve of a rough fit, by the data alone."""
        self._renew_prior(afresh=True, running=True)
        rot = self.rotation.fit(None, self.prior, rough=True)
        return Fit(rot, self.thrust.quick(rot, self.prior)[1], self.seconds, running=True)

    def _full_fit(self) -> Fit:
        self._renew_prior(afresh=True)
        rot = self.rotation.fit(None, self.prior)
        validation = self.rotation.validate(self.prior, rot)
        rigid_body_test = self._rigid_body_test_of(rot)
        if rigid_body_test is not None and rigid_body_test.contradicted:
            # Inertia in roll and pitch is left to determine.
            rot = self.rotation.fit(None, self.prior, rigid=False)
        trans, accelerometer = self.fit_translation(rot)
        return Fit(
            rot,
            trans,
            self.seconds,
            validation,
            accelerometer,
            rigid_body_test,
            moments=self.rotation.moments(rot),
        )

    def fit_translation(
        self, at: RotationFit | None = None
    ) -> tuple[TranslationFit | None, TranslationFit | None]:
        """Thrust and drag over mass from the better source, and from the accelerometer.

        Args:
            at: gives the coordinates of the basis; None: its middle.
        """
        return self.thrust.fit(at, self.prior)

    def with_thrust_by(self, rotors: RotationFit | None, fit: Fit) -> Fit:
        """A fit with thrust over mass by the rotors of another one: how they lag, and are unlike.

        Args:
            rotors: of them; None: the fit as it is.
            fit: of the whole record.
        """
        if rotors is None:
            return fit
        thrust, accelerometer = self.fit_translation(rotors)
        return replace(fit, translation=thrust, accelerometer=accelerometer)

    def forget_last(self, seconds: float) -> None:
        """Leave out at least the last `seconds` of the record (whole batches)."""
        self.record.forget_last(seconds)
        self._warm_starts.clear()

    def _follow(self, stops: Iterable[None], series: str) -> list[Fit]:
        """Quick fits at stops of what is coming in."""
        fits: list[Fit] = []
        waiting: list[Instant] = []
        for _ in stops:
            if self.record.was_renewed():
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
            waiting.append(self.rotation.instant(warm_start.rotation, warm_start.left_out))
            if self._is_outdated(warm_start):
                fits += self._followed(warm_start, waiting)
                waiting = []
                fits[-1] = self._renewed(series, warm_start, fits[-1])
        if waiting:
            fits += self._followed(self._warm_starts[series], waiting)
        return fits

    def _is_outdated(self, warm_start: _SeriesStart) -> bool:
        return (
            warm_start.thrust is None
            or warm_start.batches != self.record.batches
            or self._is_rigid_body_test_due()
        )

    def _followed(self, warm_start: _SeriesStart, instants: Sequence[Instant]) -> list[Fit]:
        """Quick fits at several instants, from one warm start."""
        if not instants:
            return []
        rotations = self.rotation.follow(instants, warm_start.rotation, self.prior)
        thrusts: Sequence[TranslationFit | None] = [None] * len(instants)
        if warm_start.thrust is not None:
            thrusts = self.thrust.follow(instants, rotations, warm_start.thrust)
        return [
            Fit(
                rot,
                self.thrust.with_slope(thrust, rot, self.prior, i),
                i.seconds,
                self._validation,
                rigid_body_test=self._rigid_body_test,
                other_layout=self._other_layout,
                running=True,
                moments=i.at(rot, self.record),
            )
            for rot, thrust, i in zip(rotations, thrusts, instants, strict=True)
        ]

    def _renewed(self, series: str, warm_start: _SeriesStart, fit: Fit) -> Fit:
        """A quick fit of now with all that is renewed now and then; the next ones go on from it."""
        record, rot = self.record, fit.rotation
        assert rot is not None
        thrust, trans = self.thrust.quick(rot, self.prior)
        followed = rot if warm_start.batches != record.batches else warm_start.rotation
        self._warm_starts[series] = replace(
            warm_start, rotation=followed, thrust=thrust, batches=record.batches
        )
        self._renew_prior(running=True)
        record.use_place(rot.lag_place)
        return replace(fit, translation=trans, rigid_body_test=self._latest_rigid_body_test(rot))

    def _settle(self, series: str, before: _SeriesStart | None) -> Fit:
        """A fit that chooses whiteners and delay, as a warm start for those to come."""
        self._renew_prior(afresh=True, running=True)
        known = before if self.seconds > _WELL_KNOWN else None
        rot = self.rotation.fit(None if known is None else known.rotation, self.prior)
        thrust, trans = self.thrust.quick(rot, self.prior)
        if rot is not None and self.record.article is None:
            settle = max(self.seconds + self._settle_interval, _SETTLE_GROWTH * self.seconds)
            self._warm_starts[series] = _SeriesStart(
                rot, thrust, self.record.batches, settle, self.rotation.left_out
            )
        if self.record.article is None and not series:
            self._validation = self.rotation.validate(self.prior, rot)
            self._other_layout = self.rotation.other_layout()
        return Fit(
            rot,
            trans,
            self.seconds,
            self._validation,
            rigid_body_test=self._latest_rigid_body_test(rot),
            other_layout=self._other_layout,
            running=True,
            moments=self.rotation.moments(rot),
        )

    def _renew_prior(self, *, afresh: bool = False, running: bool = False) -> None:
        """Renew it, `afresh` by another fit to the flight alone."""
        if self.prior_source is None:
            return
        if afresh:
            self._alone = self.rotation.fit(None, None)
        thrust = self.fit_translation()[0]
        self.prior = self.prior_source(Fit(self._alone, thrust, self.seconds, running=running))

    def _is_rigid_body_test_due(self) -> bool:
        return self.rotation.can_test_rigid_body and self.seconds >= self._rigid_body_test_at

    def _latest_rigid_body_test(self, fit: RotationFit | None) -> RigidBodyTest | None:
        due = self._is_rigid_body_test_due()
        return self._rigid_body_test_of(fit) if due else self._rigid_body_test

    def _rigid_body_test_of(self, fit: RotationFit | None) -> RigidBodyTest | None:
        """Whether the body is rigid; None while undecided."""
        if fit is None or not self.rotation.can_test_rigid_body:
            return None
        self._rigid_body_test_at = _SETTLE_GROWTH * self.seconds
        self._rigid_body_test = self.rotation.test_rigid_body(fit)
        return self._rigid_body_test
