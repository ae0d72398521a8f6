"""Does an exported ensemble spread as the covariance says?

    python -m benchmarks.exported_ensemble [RESULT.json] [--count N]

writes N vehicles drawn from the covariance of a result by `gcs-sysid export --to mjcf --ensemble
N`, loads each with MuJoCo, and flies a step of the rotors' thrusts from rest. The spread of rates
and climb over the ensemble is compared with what the covariance gives to first order, G P G', with
the derivatives G of rigid-body motion, and chi-square shows how likely such a difference is.
Without a result that of `logs/sample.tlog` is taken.
"""

import sys
import tempfile
from pathlib import Path

from gcs_sysid.api import analyze
from gcs_sysid.results.result_file import read_result
from testbed.ensemble_spread import SECONDS, SHOWN, UNITS, spread_of
from testbed.study import arguments


def main() -> int:
    """Print the spread of rates and climb."""
    parser = arguments(__doc__)
    parser.add_argument("result", nargs="?", type=Path)
    parser.add_argument("--count", type=int, default=100)
    options = parser.parse_args()
    if options.result is None:
        # A weighed mass is known to half a percent.
        given = {"mass": "0.5%"}
        result = analyze("logs/sample.tlog", "paper", mass=1.5, uncertainty=given)
    else:
        result = read_result(options.result)
    with tempfile.TemporaryDirectory() as folder:
        spread = spread_of(result, options.count, Path(folder))
    print(f"{spread.count} vehicles, MuJoCo, {SECONDS:g} s after a step of the thrusts from rest")
    print(f"{'standard deviation of':<24}{'flown':>10}{'covariance':>12}{'ratio':>8}{'p':>7}")
    for name, unit, flown, expected, p in zip(
        SHOWN, UNITS, spread.flown, spread.expected, spread.p, strict=True
    ):
        print(
            f"{name + ', ' + unit:<24}{flown:10.3g}{expected:12.3g}{flown / expected:8.2f}{p:7.2f}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
