"""Effect of an unmodeled moment on the estimate of a vehicle under feedback.

    python -m benchmarks.truth.closed_loop --flights 12
    python -m benchmarks.truth.closed_loop --cells doublets:ou1 gentle:wind --smoothers window
    python -m benchmarks.truth.closed_loop --smoothers whitened offline

A regression of acceleration on a torque that answers a disturbance attributes some of it to
inertia. Each cell flies the same
vehicle under one kind of excitation and one kind of disturbance, hands the samples to
`OnlineEstimator` as a flight's are, and prints bias, rms and coverage of the 95 % intervals, and
how many moments of inertia would be `identified` by their intervals and the share that rotors
explain. `offline` is the prediction-error estimate.

The flights are those of `testbed.rate_loop`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.estimation.changes.tracking import Tracker
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.offline.offline import fit_offline
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.judgement.status import RULES
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.records import Samples
from gcs_sysid.significance import Z95
from testbed.rate_loop import DISTURBANCES, EXCITATIONS, Vehicle, fly
from testbed.study import arguments

CELLS = (
    "doublets:none", "gentle:none", "aggressive:none", "aggressive:ou1", "doublets:ou1",
    "aggressive:wind", "aggressive:ou7", "doublets:ou3.5", "gentle:wind",
)  # fmt: skip


@dataclass(frozen=True)
class Judged:
    """Estimates of one cell by one estimator.

    Attributes:
        error: (flights, N_THETA) relative to the truth where that is not zero.
        std: (flights, N_THETA) stated, in the same unit.
        r_squared: mean of roll and pitch over the flights.
        disturbance: nats a second, mean of roll and pitch.
        claimed: (flights, 2) whether Ixx and Iyy are `identified`, by interval and share explained.
    """

    error: Array
    std: Array
    r_squared: float
    disturbance: float
    claimed: Mask

    def line(self, *names: str) -> str:
        """Bias, rms and coverage in % of some parameters taken together."""
        columns = [rb.THETA.index(name) for name in names]
        error, std = self.error[:, columns], self.std[:, columns]
        inside = np.abs(error) <= Z95 * std
        return (
            f"{100 * error.mean():7.2f} {100 * np.sqrt((error**2).mean()):7.2f}"
            f" {100 * inside.mean():5.0f} {100 * Z95 * np.median(std):6.2f}"
        )

    def claims(self) -> str:
        """% of Ixx and Iyy that are `identified`, and of these intervals that hold."""
        held = np.abs(self.error[:, :2]) <= Z95 * self.std[:, :2]
        some = f"{100 * held[self.claimed].mean():4.0f}" if self.claimed.any() else "   -"
        return f"{100 * self.claimed.mean():5.0f} {some}"


def _claimed(fit: RotationFit) -> list[bool]:
    least, _ = RULES.explained(whitened=bool(fit.whiteners))
    known = fit.std[:2] < RULES.identified_below * np.abs(fit.theta[:2])
    return list(known & (fit.r_squared[:2] >= least))


def online(flight: Samples, vehicle: Vehicle, dt: float, tuning: EstimatorTuning) -> RotationFit:
    """The online estimate of a flight."""
    estimator = OnlineEstimator(vehicle.geometry, dt, tuning)
    estimator.update(flight)
    fit = estimator.fit().rotation
    assert fit is not None
    return fit


def offline(flight: Samples, vehicle: Vehicle, dt: float) -> RotationFit:
    """The offline estimate of a flight; the online one where there is none."""
    tracker = Tracker(vehicle.geometry, dt, EstimatorTuning(), keep=True)
    tracker.update(dt * np.arange(len(flight.gyro)), flight)
    first = tracker.fit()
    found = fit_offline(tracker, first)
    fit = first.rotation if isinstance(found, str) else found.fit.rotation
    assert fit is not None
    return fit


def estimators(dt: float) -> dict[str, Callable[[Samples, Vehicle], RotationFit]]:
    """What a row of the table may be, by its name."""
    return {
        "window": lambda s, v: online(s, v, dt, EstimatorTuning(smoother="window")),
        "td": lambda s, v: online(s, v, dt, EstimatorTuning(smoother="td")),
        "whitened": lambda s, v: online(s, v, dt, EstimatorTuning()),
        "offline": lambda s, v: offline(s, v, dt),
    }


def judge(
    samples: Sequence[Samples],
    vehicle: Vehicle,
    estimate: Callable[[Samples, Vehicle], RotationFit],
) -> Judged:
    """Estimate every flight of a cell by itself."""
    truth = vehicle.theta
    size = np.where(truth == 0.0, 1.0, np.abs(truth))
    fits = [estimate(flight, vehicle) for flight in samples]
    return Judged(
        np.stack([(fit.theta - truth) / size for fit in fits]),
        np.stack([fit.std / size for fit in fits]),
        float(np.mean([fit.r_squared[:2] for fit in fits])),
        float(np.mean([fit.disturbance[:2] for fit in fits])),
        np.array([_claimed(fit) for fit in fits]),
    )


def main() -> None:
    """Print the table."""
    parser = arguments(__doc__)
    parser.add_argument("--flights", type=int, default=12)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--rate", type=float, default=500.0, help="Hz: 500 or 250")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cells", nargs="+", default=CELLS, metavar="EXCITATION:DISTURBANCE")
    names = [*estimators(0.002)]
    parser.add_argument("--smoothers", nargs="+", choices=names, default=["window", "whitened"])
    options = parser.parse_args()
    vehicle, dt = Vehicle(), 1.0 / options.rate
    head = "bias %    rms  cov  +-95"
    print(
        f"{'':34s}  R2      g | identified, hold %  |  Ixx, Iyy: {head}  |  Izz: {head}  |"
        f"  k_M/k_T: {head}"
    )
    for number, cell in enumerate(options.cells):
        excitation, disturbance = cell.split(":")
        flights = fly(
            vehicle,
            EXCITATIONS[excitation],
            DISTURBANCES[disturbance],
            flights=options.flights,
            seconds=options.seconds,
            rate=options.rate,
            seed=options.seed + 1000 * number,
        )
        for smoother in options.smoothers:
            found = judge(flights, vehicle, estimators(dt)[smoother])
            parts = ("Ixx", "Iyy"), ("Izz",), ("moment_ratio",)
            columns = " | ".join(found.line(*names) for names in parts)
            print(
                f"{cell:20s} {smoother:12s} {found.r_squared:6.3f} {found.disturbance:6.1f}"
                f" |  {found.claims()}        | {columns}",
                flush=True,
            )


if __name__ == "__main__":
    main()
