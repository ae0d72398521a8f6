"""What an inspection judges a flight by, in one place."""

from dataclasses import dataclass, field

from gcs_sysid.estimation.online.thrust_estimator import MIN_MOMENTUM_SECONDS
from gcs_sysid.signals.records import NEEDED_RATE


@dataclass(frozen=True)
class Thresholds:
    """Of a flight that can be identified from.

    Attributes:
        imu_rate: Hz, of the IMU and of measured rotor speeds.
        command_rate: Hz. Commands sampled slower than the autopilot's loop are aliased.
        attitude_rate: Hz.
        nearly: share of a nominal rate that does; autopilots send a little slower than asked.
        short: s of flight, below which little is obtainable.
        too_short: s of flight, below which nothing can: what the estimator needs for the scale.
        acceleration: rad/s^2 rms of each axis, five times what a hover in light wind shows.
        garbage: bytes; a few are usual where a recording began or ended.
        vehicles_named: other vehicles that are named; a hostile sender can make up hundreds.
        explained: share of roll or pitch acceleration that rotors explain over tenths of a second,
            below which nothing is identified: 0.48 to 0.99 in logs that can be, 0.001 and 0.14 in
            two that `analyze` refuses (`benchmarks.health_logs`).
        explained_well: the same with products of inertia and a CG off the center allowed for,
            below which inertia comes out rough: `analyze` identified Ixx, Iyy and the CG in all 18
            recordings and all 16 calm emulated flights with 0.91 to 0.998, and in none of the
            recordings with 0.52 to 0.88.
        hover_imu: Hz of the IMU from which averages over hover are obtainable.
        hover_rotors: the same of speeds or commands.
        slow_gyro_filter: Hz; a filter below it delays the gyro by more than 5 ms.
    """

    imu_rate: float = NEEDED_RATE
    command_rate: float = 100.0
    attitude_rate: float = 5.0
    nearly: float = 0.9
    short: float = 15.0
    too_short: float = MIN_MOMENTUM_SECONDS
    acceleration: dict[str, float] = field(
        default_factory=lambda: {"roll": 1.0, "pitch": 1.0, "yaw": 0.25}
    )
    garbage: int = 1000
    vehicles_named: int = 8
    explained: float = 0.2
    explained_well: float = 0.89
    hover_imu: float = 5.0
    hover_rotors: float = 2.0
    slow_gyro_filter: float = 40.0


THRESHOLDS = Thresholds()
