"""What the estimator knows at one instant, and the moments that it rests on."""

from dataclasses import dataclass
from typing import NamedTuple

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.checks.model_tests import RigidBodyTest
from gcs_sysid.estimation.checks.validation import Validation
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.translation import TranslationFit
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
    """Moments that determine where the IMU and the rotors are, see `given_errors`."""
    aligned_by: RotationFit | None = None
    """The fit that the moments are of, where `rotation` is another estimator's."""
