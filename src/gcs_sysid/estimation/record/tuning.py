"""Settings of the online estimator."""

from dataclasses import dataclass, replace
from typing import Literal

from gcs_sysid.estimation.record import article_estimator as article
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.signals.redundant_commands import SLOW_COMMANDS

_WHITENED = 0.008
"""s between samples, above which rows of one step were not found to be better. Commands are
whitened up to `SLOW_COMMANDS`: by the window motors were a tenth too fast at 100 Hz, and intervals
missed; `benchmarks.truth --only dslow` has those that hold now."""
_FAST_GYRO = 80.0
"""Hz, declared low-pass of the gyro from which commands are whitened all the same. Emulated flights
behind 80 Hz keep their intervals, behind 60 Hz Izz is no longer identified, behind 40 Hz Ixx was
8 % off; on a real flight behind 80 Hz the window saw 45 and 85 % of roll and pitch, whitened rows
98 %."""


@dataclass(frozen=True)
class EstimatorTuning:
    """Settings of the online estimator.

    Attributes:
        method: "forward", or one of the article's variants, for study
            (`estimation.record.article_estimator`).
        smoother: "whitened" (rows of one step through a bank of causal whiteners), "window"
            (symmetric), or "td" (linear tracking differentiator).
        half_width: s, half of the window, at high sample rates.
        min_half_samples: the window's half never has fewer samples than this.
        bandwidth: rad/s, R of the differentiator.
        leaks: s, memories of the leaky sums carried side by side; 0 for none.
        delays: s, nodes of rotor delay; one alone is taken as given.
        rotor_input: what the samples hold of the rotors.
        lags: s, nodes of motor lag, for commands; the first is none.
        curves: least and greatest thrust curve, for commands; one value is taken as given.
        gyro_cutoff: Hz, low-pass of the autopilot on its gyro; None: there is none.
        loop_cutoff: Hz, low-pass of the gyro on its way into the commands; None: there is none.
        speed_interval: s between readings of the rotor speeds; 0: they come with the samples.
        rotor_place: m, standard deviation of each rotor's x and y as given, by itself.
        imu_place: m, of each coordinate of the IMU.
        imu_turn: rad, of the IMU's rotation against the body about each axis.
        settle_interval: s, least time between full fits of a running history, which choose
            leak and delay; later they come when the record has grown by half.
        batch_time: s, length of a batch of moments.
        reference_every: s between new references of the change detector, at least.
        reference_growth: of the record between two of them, at least.
    """

    method: Literal["forward"] | article.Method = "forward"
    smoother: Literal["window", "td", "whitened"] = "whitened"
    half_width: float = 0.1
    min_half_samples: int = 4
    bandwidth: float = 10.0
    leaks: tuple[float, ...] = (0.0, 0.3, 1.0)
    delays: tuple[float, ...] = tuple(0.01 * k - 0.015 for k in range(8))
    rotor_input: RotorInput = RotorInput.SPEED
    lags: tuple[float, ...] = (0.0,)
    curves: tuple[float, ...] = (1.0,)
    gyro_cutoff: float | None = None
    loop_cutoff: float | None = None
    speed_interval: float = 0.0
    rotor_place: float = 0.0
    imu_place: float = 0.0
    imu_turn: float = 0.0
    settle_interval: float = 2.0
    batch_time: float = 1.0
    reference_every: float = 1.0
    reference_growth: float = 1.2

    def whitens(self, dt: float) -> bool:
        """Whether rows of samples that are `dt` s apart are whitened.

        Not those of a gyro behind a slow low-pass (with speeds: any), or of slow samples, or of
        commands whose lag is given: there the window is at least as good, and takes their place.
        """
        commands = self.rotor_input.motors
        return (
            self.smoother == "whitened"
            and self.method == "forward"
            and (not commands or len(self.lags) > 1)
            and (self.gyro_cutoff is None or (commands and self.gyro_cutoff >= _FAST_GYRO))
            and (dt < SLOW_COMMANDS if commands else dt <= _WHITENED)
        )


COMMANDS = EstimatorTuning(
    # Commands answer to the gyro's noise: a longer window lets less of that back in.
    half_width=0.2,
    rotor_input=RotorInput.COMMAND,
    leaks=(0.0, 0.3),
    delays=(-0.015, -0.00375, 0.0075, 0.01875, 0.03),
    lags=(0.0, 0.012, 0.025, 0.04, 0.06, 0.085, 0.13),
    curves=(-0.2, 1.2),
    reference_every=5.0,
    reference_growth=1.5,
)
"""EstimatorTuning for commands as the rotors' input."""


def tuning_for(rotor_input: RotorInput, dt: float) -> EstimatorTuning:
    """Settings for inputs that come every `dt` s.

    Aliased noise of slow commands has all frequencies, the motion is slow: a leak weighs most what
    is certain, and least the error of the aliased part.
    """
    if not rotor_input.motors:
        return EstimatorTuning()
    made = replace(COMMANDS, rotor_input=rotor_input)
    return made if dt < SLOW_COMMANDS else replace(made, leaks=(0.15,))
