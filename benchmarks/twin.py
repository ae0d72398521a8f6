"""Does the twin's band hold, and is the covariance right?

    python -m benchmarks.twin flights [--count N] [--scenario NAME]
    python -m benchmarks.twin logs PATH...
    python -m benchmarks.twin covariance [--first N] [--count N] [--still] [--drawn]
        [--keep FILE]

`flights` flies vehicles drawn at random (0.25 to 15 kg, four to eight rotors, MEMS at 250 Hz) on
the emulator, fits the first 60 % of each flight and flies the rest with the fit; `logs` does so
with recorded flights. Both print, for each stretch of 1 s, the share of errors inside the 95 % band
and R2 of the body rates, beside the model without drag, damping, rotor inertia and differences
between rotors (basic), and a guess of constant rates. `covariance` holds the normalized
estimation error squared of the parameter vector, e' P^-1 e, against chi-square, over short
flights that identify all; with `--drawn` the given values (arms, rotor places, mass, the IMU's
rotation) err as their standard deviations say, else they are exact.
"""

import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2, kstest

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.results.parameter_samples import covariance_of
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import ChainOptions
from gcs_sysid.significance import Z95
from gcs_sysid.twin.held_out_flight import TwinFlight, fly_held_out
from gcs_sysid.twin.prediction_errors import QUANTITIES
from sim_bridge.doublets import LEAD, PART, DoubletMission
from sim_bridge.missions import Reference
from sim_bridge.physics import IDEAL, Physics
from sim_bridge.simulation import Simulation
from testbed.emulated import record, write
from testbed.recordings import airframe_for, logs_in
from testbed.scenarios import SCENARIOS, Scenario
from testbed.study import arguments, gone_on_with
from testbed.vehicles import draw

SECONDS = 50.0
"""Of each emulated flight, at most."""
JUDGED = ("Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz", "cg_x", "cg_y", "k_T", "k_M")
"""What the normalized error is made of: `moment_ratio` follows from two of them, and what is cut at
zero is not normal."""
_AHEAD = 1.0


def row(name: str, twin: TwinFlight) -> str:
    """A flight's figures a second ahead."""
    each = twin.accuracy.get(_AHEAD)
    if each is None:
        return f"{name:<26} no stretch of {_AHEAD:g} s"
    inside = "  ".join(
        f"{100.0 * each[q].inside:5.1f}" if q in each else "    -" for q in QUANTITIES
    )
    rates = each["rates"]
    return (
        f"{name:<26}{twin.result.verdict:<11}{rates.count:5}   {inside}{rates.r_squared:9.3f}"
        f"{rates.rms:9.4f}{rates.band / Z95:9.4f}{rates.basic:9.3f}{rates.guess:9.3f}"
    )


HEAD = (
    f"{'flight':<26}{'fit':<11}{'of 1 s':>5}   rates   att.   vel.       R2    error predicted"
    "    basic    guess (rates, rad/s)"
)


def pooled(twins: Iterable[TwinFlight]) -> list[str]:
    """Shares inside the band over all flights, by length and quantity."""
    twins = list(twins)
    lines = []
    for q in QUANTITIES:
        cells = []
        for seconds in (0.1, 0.3, 1.0, 3.0):
            told = [
                (a.inside, a.count)
                for twin in twins
                if (a := twin.accuracy.get(seconds, {}).get(q)) is not None and a.count
            ]
            if told:
                share, count = np.array(told).T
                cells.append(f"{seconds:g} s {100.0 * np.average(share, weights=count):5.1f} %")
        lines.append(f"inside the band, {q}: " + ", ".join(cells))
    found = [t.accuracy[_AHEAD]["rates"].r_squared for t in twins if _AHEAD in t.accuracy]
    if found:
        lines.append(
            f"R2 of the rates 1 s ahead: least {min(found):.3f}, median {np.median(found):.3f}"
        )
    return lines


def emulated(count: int, scenario: Scenario) -> Iterator[tuple[str, Path, Airframe]]:
    """Name, log and airframe of drawn vehicles, each there until the next one is flown."""
    for number in range(count):
        with tempfile.TemporaryDirectory() as folder:
            flown = record(scenario, number, Path(folder), SECONDS)
            yield flown.vehicle[:25], flown.log, flown.airframe


def show(flights: Iterable[tuple[str, Path, Airframe]]) -> None:
    """The twin of each log whose own first part is fitted, and all together."""
    print(HEAD)
    twins = []
    for name, log, airframe in flights:
        try:
            twins.append(fly_held_out(analyze_log(log, airframe), log, airframe))
        except InputError as error:
            print(f"{name}: {str(error).replace(str(log), log.name)}")
            continue
        print(row(name, twins[-1]), flush=True)
    print("\n".join(pooled(twins)))


def normalized_error(error: Array, covariance: Array) -> float:
    """E' P^-1 e, scaled first: units differ by many powers of ten."""
    std = np.sqrt(np.diag(covariance))
    e = error / std
    return float(e @ np.linalg.solve(covariance / np.outer(std, std), e))


LIGHT_AIR = Physics(ou_force=(0.03, 0.5))
"""m/s^2 rms, s: air that rises and falls a little, as indoors. Intervals of k_T, and of all that is
scaled by it, allow for it: thrust is weighed against gravity, and nothing tells air from thrust."""


class ShortDoublets:
    """The same doublets in 21 s: 3 s of hover and the first 3.6 s of each part.

    Args:
        whole: two doublets of roll or pitch, or one of yaw, end in that time.
    """

    hover, part = 3.0, 3.6
    name, duration, turbulence = "short doublets", 21.0, 0.0

    def __init__(self, whole: DoubletMission) -> None:
        self._whole = whole

    def reference(self, t: float) -> Reference:
        """Set-points t seconds after the start."""
        turn, at = divmod(max(t - self.hover, 0.0), self.part)
        return self._whole.reference(LEAD + PART * turn + at if t >= self.hover else 0.0)


def as_given(airframe: Airframe, random: np.random.Generator) -> Airframe:
    """The airframe as a user has it, whose errors are drawn from what `[uncertainty]` says.

    Scale of all arms, each rotor's place and mass; the IMU's rotation is the emulator's. Where the
    IMU is matters to those alone that have no velocity.
    """
    sigma = airframe.uncertainty
    assert airframe.mass is not None
    scale = 1.0 + sigma.arm.of(1.0) * random.standard_normal()
    single = sigma.rotor_position.of(airframe.arm)
    rotors = tuple(
        replace(
            r,
            x=scale * r.x + single * random.standard_normal(),
            y=scale * r.y + single * random.standard_normal(),
        )
        for r in airframe.rotors
    )
    mass = airframe.mass * (1.0 + sigma.mass.of(1.0) * random.standard_normal())
    return replace(airframe, rotors=rotors, mass=mass)


def covariance(wanted: range, most: int, keep: Path | None, air: Physics, *, exact: bool) -> None:
    """Normalized error squared of the parameter vector over emulated flights, by their numbers."""
    done = gone_on_with(keep, "flight", wanted, partial(_errors_of, air=air, exact=exact), most)
    where = f"{'still' if air is IDEAL else 'light'} air, what is given " + (
        "exact" if exact else "drawn"
    )
    _show_errors(done, where)


def _errors_of(number: int, air: Physics, *, exact: bool) -> dict[str, Any]:
    """Of one flight: errors over their standard deviations, and the normalized error squared."""
    drawn, random = draw(number), np.random.default_rng([number, 0x617E])
    airframe = drawn.airframe
    turn = np.radians(airframe.uncertainty.imu_rotation.amount) * random.standard_normal(3)
    if exact:
        sure = dict.fromkeys(vars(airframe.uncertainty), 0.0)
        airframe = airframe.with_uncertainty(sure, "exact")
    else:
        airframe, air = as_given(airframe, random), replace(air, imu_rotation=tuple(turn))
    mission = ShortDoublets(drawn.mission("doublets", 2.0, 1.5))
    flight = Simulation(
        drawn.vehicle, mission, np.random.SeedSequence([number, 1]), 0.0, physics=air
    )
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "flight.tlog"
        write(flight, log, number, 250.0)
        result = analyze_log(log, airframe, options=ChainOptions())
    truth = flight.vehicle.truth()
    names, matrix = covariance_of(result)
    at = [names.index(name) for name in JUDGED]
    error = np.array([(result.parameters[n].value or 0.0) - float(truth[n]) for n in JUDGED])
    P = matrix[np.ix_(at, at)]
    std = np.sqrt(np.diag(P))
    return {
        "flight": number,
        "verdict": result.verdict,
        "single": (error / std).tolist(),
        "squared": normalized_error(error, P),
    }


def _show_errors(found: list[dict[str, Any]], where: str) -> None:
    # What is unobservable, or read in another unit, claims nothing.
    judged = [one for one in found if one["verdict"] == "identified"]
    if not judged:
        print(f"none of {len(found)} flights is identified")
        return
    single, squared = (np.array([one[key] for one in judged]) for key in ("single", "squared"))
    freedom = len(JUDGED)
    p = kstest(squared, chi2(freedom).cdf).pvalue
    print(
        f"{len(judged)} identified of {len(found)} emulated flights of "
        f"{ShortDoublets.duration:g} s in {where}; {freedom} parameters: {', '.join(JUDGED)}"
    )
    print(
        f"normalized error squared: mean {squared.mean():.2f} (chi-square {freedom}), median "
        f"{np.median(squared):.2f} ({chi2(freedom).median():.2f}), 95th percentile "
        f"{np.percentile(squared, 95):.2f} ({chi2(freedom).ppf(0.95):.2f})"
    )
    print(f"Kolmogorov-Smirnov p = {p:.3g}; standard deviations are off by a factor of "
          f"{np.sqrt(np.median(squared) / chi2(freedom).median()):.2f}")  # fmt: skip
    print("rms error over standard deviation, each by itself: " + ", ".join(
        f"{name} {value:.2f}"
        for name, value in zip(JUDGED, np.sqrt((single**2).mean(axis=0)), strict=True)
    ))  # fmt: skip


def main() -> int:
    """Run what is named."""
    parser = arguments(__doc__)
    parser.add_argument("what", choices=("flights", "logs", "covariance"))
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument(
        "--first", type=int, default=0, help="covariance: number of the first flight"
    )
    parser.add_argument("--still", action="store_true", help="covariance: without any air")
    parser.add_argument("--drawn", action="store_true", help="covariance: givens err, too")
    parser.add_argument("--most", type=int, default=1000, help="flights flown in this run")
    parser.add_argument("--keep", type=Path, help="file of what is done, to go on from")
    parser.add_argument("--scenario", choices=[s.name for s in SCENARIOS], default="a")
    options = parser.parse_args()
    if options.what == "logs":
        if not options.paths:
            parser.error("logs: name files or folders")
        show((log.name, log, airframe_for(log)) for log in logs_in(options.paths))
    elif options.what == "flights":
        scenario = next(s for s in SCENARIOS if s.name == options.scenario)
        print(f"{options.count} emulated vehicles, {scenario.says}")
        show(emulated(options.count, scenario))
    else:
        air = IDEAL if options.still else LIGHT_AIR
        wanted = range(options.first, options.first + options.count)
        covariance(wanted, options.most, options.keep, air, exact=not options.drawn)
    return 0


if __name__ == "__main__":
    sys.exit(main())
