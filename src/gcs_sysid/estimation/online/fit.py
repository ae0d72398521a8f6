"""What the estimator knows at one instant, and the moments that it rests on."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.checks.model_tests import RigidBodyTest
from gcs_sysid.estimation.checks.validation import Validation
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.translation import TranslationFit
from gcs_sysid.estimation.record.record import FlightRecord
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics
from gcs_sysid.estimation.rows.motor_linearization import MeanThrust
from gcs_sysid.model import rigid_body


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

    rotation: RotationFit | None
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
    """Moments that it rests on."""


@dataclass(frozen=True)
class Instant:
    """The moments at one instant.

    Attributes:
        moments: (3, width, width) as each axis' whitener has them, shocks left out.
        rows: in them.
        basis: of their elements.
        noise: in the moments of one row.
        window: (width', width') of rows of the window, with the first leak.
        window_rows: in them.
        momentum: (3, thrusts + 3, thrusts + 3).
        momentum_rows: in them.
        seconds: flight time.
        mean_thrust: by commands; None without motors for them.
    """

    moments: Array
    rows: int
    basis: ActuatorDynamics
    noise: Array
    window: Array
    window_rows: int
    momentum: Array
    momentum_rows: int
    seconds: float
    mean_thrust: MeanThrust | None

    def at(self, fit: RotationFit, record: FlightRecord) -> FitMoments:
        """What a fit rests on, at its coordinates.

        Args:
            fit: of this record.
            record: that these moments are of.
        """
        own, at = record.basis, fit.coordinates
        without = self.basis.moments_at(self.moments - self.rows * self.noise, at)
        # Leaky sums of rates are no rates.
        count = self.window_rows if record.memories[0] == 0.0 else 0
        # The window has a range of its own.
        within = np.clip(at, own.low, own.high)
        return FitMoments(without, own.moments_at(self.window, within), count)
