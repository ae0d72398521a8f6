"""Flights that the coach leads, against the article's three modes.

    python -m benchmarks.coach [--seeds 20] [--processes 2] [--airframe NAME]

The flights are those of `testbed.led_flights`.
"""

from functools import partial

import numpy as np

from gcs_sysid.coach.manoeuvre_library import Limits
from testbed.led_flights import AGREES, TARGET, WANTED, article, coached, modes
from testbed.study import WORKERS, arguments, in_processes


def agreement(title: str, ratios: list[float]) -> str:
    """How expected intervals and those reached agree, in a line."""
    all_ = np.array(ratios)
    agree = np.mean((all_ <= AGREES) & (all_ >= 1.0 / AGREES))
    low, middle, high = np.quantile(all_, (0.05, 0.5, 0.95), method="nearest")
    return (
        f"  {title:28s} {len(all_):5d}   {middle:.2f}   {low:.2f} to {high:.2f}   "
        f"{100.0 * agree:.0f} % within a factor of {AGREES}"
    )


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--processes", type=int, default=WORKERS)
    parser.add_argument("--airframe", default="paper")
    parser.add_argument("--max-tilt", type=float, default=20.0, help="degrees")
    parser.add_argument("--max-rate", type=float, default=150.0, help="degrees a second")
    options = parser.parse_args()
    seeds = range(options.seeds)
    limits = Limits(np.radians(options.max_tilt), np.radians(options.max_rate))
    article(options.airframe)  # flown before the work is divided
    lead = partial(coached, airframe=options.airframe, limits=limits)
    led = in_processes(lead, seeds, options.processes)
    others = in_processes(partial(modes, airframe=options.airframe), seeds, options.processes)
    print(f"time until every interval is within {100 * TARGET:g} % of the value, s")
    print("seed  coach  modes  manoeuvres  largest error then, %")
    for seed, (mine, other) in enumerate(zip(led, others, strict=True)):
        error = max(mine.errors.values(), default=np.nan)
        print(
            f"{seed:4d}  {mine.reached:5.0f}  {other.reached:5.0f}  {len(mine.said):10d}  "
            f"{error:.2f}"
        )
    mine_t, other_t = (float(np.median([f.reached for f in g])) for g in (led, others))
    print(
        f"median: {mine_t:.0f} s against {other_t:.0f} s: {100 * mine_t / other_t:.0f} %, wanted "
        f"at most {100 * WANTED:.0f} %"
    )
    print("interval reached over expected  count  median  5 to 95 %")
    for title, pick in (("gains told", "told"), ("every interval", "outcomes")):
        # Of the first manoeuvre nothing is expected: the vehicle is not known.
        parts = [part for flight in led for part in getattr(flight, pick)[1:]]
        print(agreement(title, [ratio for part in parts for ratio in part]))
    print("the first flight:")
    for line in led[0].said:
        print(f"  {line}")


if __name__ == "__main__":
    main()
