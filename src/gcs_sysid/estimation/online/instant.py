"""The moments of a record at one instant, kept so that fits to them may come later."""

from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.online.fit import FitMoments
from gcs_sysid.estimation.online.whitened_estimator import WhitenedInstant
from gcs_sysid.estimation.record.record import FlightRecord
from gcs_sysid.estimation.rows.motor_linearization import MeanThrust


@dataclass(frozen=True)
class Instant:
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
    whitened: WhitenedInstant | None
    momentum: Array
    momentum_rows: int
    seconds: float
    mean_thrust: MeanThrust | None

    @classmethod
    def of(cls, record: FlightRecord, leak: int, whitened: WhitenedInstant | None) -> "Instant":
        """Those of now.

        Args:
            record: of the flight.
            leak: that is followed.
            whitened: moments of its whitened rows, if there are any.
        """
        return cls(
            record.rotation.total[leak].copy(),
            record.rotation.rows,
            record.noise(leak),
            whitened,
            record.momentum.total.copy(),
            record.momentum.rows,
            record.seconds,
            record.mean_thrust,
        )

    def at(self, fit: RotationFit, record: FlightRecord) -> FitMoments:
        """What a fit rests on, at its coordinates.

        Args:
            fit: of this record.
            record: that these moments are of.
        """
        basis, at = record.basis, fit.coordinates
        # Leaky sums of rates are no rates.
        count = self.rows if record.memories[fit.leak] == 0.0 else 0
        if self.whitened is not None:
            white = self.whitened
            without = white.moments - white.rows * white.noise
            # Whitened rows have a range of their own.
            within = np.clip(at, basis.low, basis.high)
            return FitMoments(
                white.basis.moments_at(without, at),
                basis.moments_at(self.rotation, within),
                count,
            )
        window = basis.moments_at(self.rotation, at)
        without = window - self.rows * basis.noise_at(self.noise, at)
        return FitMoments(np.broadcast_to(without, (3, *without.shape)), window, count)
