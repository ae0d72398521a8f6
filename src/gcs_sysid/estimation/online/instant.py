"""The moments of a record at one instant, kept so that fits to them may come later."""

from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.online.fit import FitMoments
from gcs_sysid.estimation.record.record import FlightRecord
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics
from gcs_sysid.estimation.rows.motor_linearization import MeanThrust


@dataclass(frozen=True)
class Instant:
    """The moments at one instant.

    Attributes:
        moments: (width, width) of rows of the window, with the leak that is followed; or
            (3, width, width) as each axis' whitener has them, shocks left out.
        rows: in them.
        basis: of their elements.
        noise: in the moments of one row.
        window: (width', width') of rows of the window, with that leak.
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
        # Leaky sums of rates are no rates.
        count = self.window_rows if record.memories[fit.leak] == 0.0 else 0
        if self.moments.ndim == 3:
            without = self.basis.moments_at(self.moments - self.rows * self.noise, at)
            # The window has a range of its own.
            within = np.clip(at, own.low, own.high)
            return FitMoments(without, own.moments_at(self.window, within), count)
        window = own.moments_at(self.window, at)
        without = window - self.rows * own.noise_at(self.noise, at)
        return FitMoments(np.broadcast_to(without, (3, *without.shape)), window, count)
