"""What is known now, and what would be known after a maneuver.

Both are given as a `Fit`, so that expected intervals pass through the very rules that intervals of
a flight do: scale, Student's factor for few batches, and the factor of one who looks all the time.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from gcs_sysid.arrays import Array
from gcs_sysid.coach.information import Craft, Noise, PriorVehicle
from gcs_sysid.estimation.fit.priors import COORDINATE_MEAN, COORDINATES, N_UNKNOWNS, Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.translation import TranslationFit
from gcs_sysid.estimation.noise.uncertainty import bartlett
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.online.thrust_estimator import MIN_MOMENTUM_SECONDS
from gcs_sysid.estimation.rows.actuator_dynamics import Coordinate
from gcs_sysid.intervals import Z95
from gcs_sysid.judgement.status import RULES
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.parameters import GRAVITY, REGISTRY

_OF_AXIS = tuple(
    [i for i, name in enumerate(rb.THETA) if axis in REGISTRY[name].axes] for axis in range(3)
)
"""Of theta: parameters that an axis' equation determines."""
_THRUST_SHARE = 1.2e-3
"""Relative standard deviation of k_T / m after MIN_MOMENTUM_SECONDS of flight: measured on flights
of the emulator; it falls with the square root of time."""
_FREEDOMS = np.concatenate([np.arange(1.0, 20.0, 0.25), np.geomspace(20.0, 1e4, 40)])
_FACTORS = stdtrit(_FREEDOMS, 0.975) / Z95
"""Falling: Student's factor at each number of degrees of freedom."""


@dataclass(frozen=True)
class PredictedInformation:
    """Information on a vehicle at one instant of its flight, or before it.

    Attributes:
        fit: of the flight; without a rotation while that has no information.
        craft: the best guess: the fit, as far as it is one, else what is assumed.
        noise: that maneuvers are flown in.
        information: (N_UNKNOWNS, N_UNKNOWNS) about theta and coordinates, of the flight and of
            what is assumed.
        freedom: (N_UNKNOWNS,) degrees of freedom of each one's standard deviation.
        coordinates: (3,) rotor delay, motor lag, thrust curve.
        free: (N_UNKNOWNS,) which unknowns are not given.
        kappa: thrust over mass, as far as it is known.
    """

    fit: Fit
    craft: Craft
    noise: Noise
    information: Array
    freedom: Array
    coordinates: Array
    free: Array
    kappa: float

    def after(self, added: Array | None = None, seconds: float = 0.0, full: float = 0.0) -> Fit:
        """What is expected to be known after a maneuver; of now without one.

        Args:
            added: (N_UNKNOWNS, N_UNKNOWNS) information of a second at full swing.
            seconds: from its start to its end.
            full: as many at full swing have as much information.
        """
        n = rb.N_THETA
        covariance, freedom = self._spread(added, full)
        widening = np.interp(freedom, _FREEDOMS, _FACTORS)
        covariance *= np.outer(widening, widening)
        rotation = RotationFit(
            theta=self.craft.theta,
            covariance=covariance[:n, :n],
            residual_covariance=np.eye(3),
            r_squared=np.ones(3),
            rows=1,
            converged=True,
            coordinates=self.coordinates,
            full_covariance=covariance,
        )
        flown = self.fit.seconds + seconds
        return Fit(
            rotation,
            self._translation(flown),
            flown,
            rigid_body_test=self.fit.rigid_body_test,
            running=True,
        )

    def then(self, added: Array, seconds: float, full: float) -> "PredictedInformation":
        """What is known once a maneuver has been flown as expected; arguments as of `after`."""
        after = self.after(added, seconds, full)
        fit = Fit(
            after.rotation,
            self.fit.translation,
            after.seconds,
            rigid_body_test=self.fit.rigid_body_test,
        )
        _, freedom = self._spread(added, full)
        return replace(self, fit=fit, information=self.information + full * added, freedom=freedom)

    def _spread(self, added: Array | None, full: float) -> tuple[Array, Array]:
        """(N_UNKNOWNS, N_UNKNOWNS) covariance without Student's factor, and its freedom."""
        free = self.free
        gained = np.zeros((N_UNKNOWNS, N_UNKNOWNS)) if added is None else full * added
        total = (self.information + gained)[np.ix_(free, free)]
        scale = np.sqrt(np.diag(total))
        inverse = np.linalg.inv(total / np.outer(scale, scale)) / np.outer(scale, scale)
        covariance = np.zeros_like(self.information)
        covariance[np.ix_(free, free)] = inverse
        # Satterthwaite again: of what is old, and of the maneuver's batches of a second.
        fresh = np.diag(covariance @ gained @ covariance)
        old = np.maximum(np.diag(covariance) - fresh, 0.0)
        spread = old**2 / self.freedom + fresh**2 / _even_freedom(full)
        freedom = (old + fresh) ** 2 / np.maximum(spread, 1e-300)
        return covariance, np.where(spread > 0.0, freedom, _FREEDOMS[-1])

    def _translation(self, seconds: float) -> TranslationFit:
        before, began = self.fit.translation, self.fit.seconds
        if before is None or (before.source == "accelerometer" and began < MIN_MOMENTUM_SECONDS):
            # Velocity takes over soon; before, there is the accelerometer and its bias.
            share = _THRUST_SHARE * np.sqrt(MIN_MOMENTUM_SECONDS / max(seconds, 1e-3))
            share = share if seconds > MIN_MOMENTUM_SECONDS else 0.02
            return TranslationFit(self.kappa, share * self.kappa, np.nan, np.nan, "momentum")
        later = np.sqrt(began / max(seconds, began)) if before.source == "momentum" else 1.0
        return replace(
            before, kappa_std=before.kappa_std * later, delta_std=before.delta_std * later
        )


def predicted_information(
    fit: Fit, prior_vehicle: PriorVehicle, noise: Noise, free_coordinates: tuple[int, ...] = (0,)
) -> PredictedInformation:
    """What is known, from a fit and what is assumed.

    Args:
        fit: so far; `Fit(None, None, 0.0)` before a flight.
        prior_vehicle: of the airframe.
        noise: that maneuvers are flown in.
        free_coordinates: of `estimation.rows.actuator_dynamics`, those that are estimated.
    """
    kappa = prior_vehicle.kappa
    if fit.translation is not None and fit.translation.kappa > 0.0:
        kappa = fit.translation.kappa
        prior_vehicle = prior_vehicle.at(kappa)
    free = np.array([*range(rb.N_THETA), *(rb.N_THETA + i for i in free_coordinates)])
    mean = np.concatenate([prior_vehicle.craft.theta, COORDINATE_MEAN])
    margin = np.diag(1.0 / prior_vehicle.std**2)
    information, freedom = margin.copy(), np.full(N_UNKNOWNS, _FREEDOMS[-1])
    unknowns = mean.copy()
    rotation = fit.rotation
    if rotation is not None:
        added, freedom = _information_of(rotation, prior_vehicle, free)
        information += added
        found = added @ rotation.unknowns + margin @ mean
        d = np.sqrt(np.diag(information))
        unknowns = np.linalg.solve(information / np.outer(d, d), found / d) / d
    theta = unknowns[: rb.N_THETA]
    if not (rb.is_physical(theta) and theta[rb.MOMENT_RATIO] > 0.0):
        theta = prior_vehicle.craft.theta
    coordinates = unknowns[COORDINATES].copy()
    coordinates[Coordinate.LAG] = max(coordinates[Coordinate.LAG], 0.0)
    craft = replace(
        prior_vehicle.craft,
        theta=theta,
        thrust=GRAVITY / kappa,
        curve=float(coordinates[Coordinate.CURVE]),
    )
    return PredictedInformation(fit, craft, noise, information, freedom, coordinates, free, kappa)


def _information_of(
    rotation: RotationFit, prior_vehicle: PriorVehicle, free: Array
) -> tuple[Array, Array]:
    """(N_UNKNOWNS, N_UNKNOWNS) information and (N_UNKNOWNS,) freedom of a flight."""
    freedom = np.full(N_UNKNOWNS, _FREEDOMS[-1])
    widening = np.ones(N_UNKNOWNS)
    if rotation.warm_start is not None:
        # Deviations from the model are fitted between theta and the coordinates.
        deviating = slice(rb.N_THETA, rb.N_THETA + len(rotation.deviations))
        own = np.delete(rotation.warm_start.widening, deviating)
        if len(own) == len(free):
            widening[free] = own
        else:
            # Whitened rows of commands have asymmetry and exponent of the lag besides.
            every = np.arange(N_UNKNOWNS)
            curve = Unknown.CURVE
            widening[every if curve in free else np.delete(every, curve)] = own
        freedom[free] = np.interp(widening[free], _FACTORS[::-1], _FREEDOMS[::-1])
    covariance = rotation.full_covariance / np.outer(widening, widening)
    for axis, of_axis in enumerate(_OF_AXIS):
        if rotation.r_squared[axis] < RULES.explained(whitened=bool(rotation.whiteners))[1]:
            # Where gusts turn the vehicle more than its rotors do, the scatter is deceptive.
            covariance[of_axis, of_axis] += (10.0 * prior_vehicle.std[of_axis]) ** 2
    information = np.zeros_like(covariance)
    there = free[np.diag(covariance)[free] > 0.0]
    part = covariance[np.ix_(there, there)]
    d = np.sqrt(np.diag(part))
    scaled = part / np.outer(d, d) + 1e-12 * np.eye(len(d))
    information[np.ix_(there, there)] = np.linalg.inv(scaled) / np.outer(d, d)
    return information, freedom


def _even_freedom(seconds: float) -> float:
    """Degrees of freedom of so many batches of one second, with equal information."""
    count = max(round(seconds), 1)
    weights = bartlett(count)
    shared = sum(w * w * (count - lag) for lag, w in enumerate(weights, 1))
    return float(count * count / (count + 2.0 * shared))
