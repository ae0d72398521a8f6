"""Recorded flights thinned to 50 Hz: errors over many thinnings.

    python -m benchmarks.thinned FOLDER [--thinnings N]

thins every .tlog with a .truth.json to a fifth, each time at another phase and with another 5 % of
all messages lost, and prints mean, root-mean-square and largest error of each parameter, the mean
half width of its interval, and how many of them hold the truth. Products of inertia are in
1e-4 kg m^2, all else is in %.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.significance import Z95
from testbed.recordings import airframe_of, thinned, truth_of
from testbed.study import arguments

PRODUCTS = ("Ixy", "Iyz", "Ixz")
SHOWN = (
    "Ixx", "Iyy", "Izz", *PRODUCTS, "moment_ratio", "rotational_damping", "T_max", "motor_lag",
)  # fmt: skip


def main() -> None:
    """Thin and analyse a folder."""
    parser = arguments(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--thinnings", type=int, default=20, metavar="N")
    options = parser.parse_args()
    logs = [
        p for p in sorted(options.folder.glob("*.tlog")) if p.with_suffix(".truth.json").exists()
    ]
    if not logs:
        sys.exit(f"{options.folder}: no .tlog with a .truth.json beside it")
    for log in logs:
        truth = truth_of(log)
        airframe = airframe_of(log).with_anchor("mass", truth["mass"])
        errors: dict[str, list[tuple[float, float]]] = {}
        for seed in range(1, options.thinnings + 1):
            with tempfile.TemporaryDirectory() as folder:
                result = analyze_log(thinned(log, Path(folder) / log.name, seed), airframe)
            for name, found in {**result.parameters, **result.timing}.items():
                if name in SHOWN and name in truth and found.value and found.std:
                    share = 1e4 if name in PRODUCTS else 100.0 / truth[name]
                    told = share * (found.value - truth[name]), Z95 * share * found.std
                    errors.setdefault(name, []).append(told)
        print(f"{log.name}: rotors by {result.rotor_input}, {options.thinnings} thinnings")
        columns = "".join(f"{column:>8}" for column in ("mean", "rms", "worst", "+-95 %", "hold"))
        print(f"  {'':<20}{columns}")
        for name, pairs in errors.items():
            error, half = np.array(pairs).T
            rms, hold = np.sqrt(np.mean(error**2)), np.mean(np.abs(error) <= half)
            row = f"{error.mean():8.2f}{rms:8.2f}{np.abs(error).max():8.2f}{half.mean():8.2f}"
            print(f"  {name:<20}{row}{100 * hold:7.0f} %", flush=True)


if __name__ == "__main__":
    main()
