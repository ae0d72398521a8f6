"""Do flights of one vehicle agree, within their intervals?

    python -m benchmarks.truth.real_flights FOLDER [--offline]

Analyzes the CineRat's flights of 5 March (LOG00259 to LOG00281, .tlog) in a folder and prints Ixx
and Iyy of each with the half width of the 95 % interval, their scatter, chi-square against their
weighted mean, and how many intervals hold what throws without feedback gave (5.8, 7.4e-4 kg m^2).
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import ChainOptions
from gcs_sysid.significance import Z95
from testbed.recordings import OPEN_LOOP, airframe_for
from testbed.study import arguments

FLIGHTS = tuple(f"LOG00{number}.tlog" for number in (259, 264, 267, 269, 271, 277, 281))
NAMES = tuple(OPEN_LOOP)


def table(folder: Path, *, offline: bool) -> Iterator[str]:
    """Lines to print."""
    yield "flight     used s   Ixx 1e-4          Iyy 1e-4          status"
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in NAMES}
    options = ChainOptions(offline=offline)
    for log in filter(Path.exists, (folder / name for name in FLIGHTS)):
        result = analyze_log(log, airframe_for(log), options=options)
        cells = []
        for name, e in ((name, result.parameters[name]) for name in NAMES):
            if e.value is None or e.std is None or e.status == "unobservable":
                cells.append(f"{'-':>16}")
                continue
            found[name].append((e.value, e.std))
            cells.append(f"{1e4 * e.value:7.2f} +-{100.0 * Z95 * e.std / e.value:5.1f} %")
        statuses = ", ".join(result.parameters[name].status for name in NAMES)
        used = result.telemetry["used_seconds"]
        yield f"{log.stem:10s} {used:6.1f}   {'  '.join(cells)}  {statuses}"
    yield from (summary(key, np.array(pairs)) for key, pairs in found.items() if len(pairs) > 1)


def summary(name: str, pairs: Array) -> str:
    """How well the flights agree, from (n, 2) values and standard deviations."""
    values, stds = pairs.T
    weights = stds**-2.0
    mean = float((weights * values).sum() / weights.sum())
    distance = float((((values - mean) / stds) ** 2).sum())
    p = float(chi2.sf(distance, len(values) - 1))
    holds = int((np.abs(values - OPEN_LOOP[name]) <= Z95 * stds).sum())
    return (
        f"{name}: scatter {100.0 * values.std() / values.mean():.1f} %, weighted mean "
        f"{1e4 * mean:.2f}e-4, chi2 {distance:.1f} of {len(values) - 1} (p {p:.2f}), "
        f"{holds} of {len(values)} hold {1e4 * OPEN_LOOP[name]:.1f}e-4, median half width "
        f"{np.median(100.0 * Z95 * stds / values):.1f} %"
    )


def main(argv: list[str] | None = None) -> int:
    """Print the table."""
    parser = arguments(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--offline", action="store_true")
    options = parser.parse_args(argv)
    try:
        for line in table(options.folder, offline=options.offline):
            print(line, flush=True)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
