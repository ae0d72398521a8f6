"""Is it still right?

python -m benchmarks.accept                  equal, then judge
python -m benchmarks.accept --short          some rows of each kind, as CI runs them
python -m benchmarks.accept equal            only whether a digit moved
python -m benchmarks.accept judge --only truth early
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.accept import cost, emulated, equal, judge, recorded, trees
from testbed import study
from testbed.judge import BY_OFFLINE
from testbed.recordings import KEPT

REFERENCE = "d232f3d4"
"""The commit whose results count as right; a change that is to move digits names its own here."""

STUDIES = (*emulated.STUDIES, *recorded.STUDIES, *cost.STUDIES)


def run_equal(options: argparse.Namespace) -> bool:
    """Compare with what is stored; whether it is the same."""
    began = time.monotonic()
    which = [c for c in equal.cases(options.short) if _asked(c.name, options.only)]
    if not which:
        sys.exit(f"no case has {' or '.join(options.only)} in its name")
    if options.store:
        results = (
            equal.results_at(options.against, which, options.workers)
            if options.against
            else equal.results_of(study.PROJECT, which, options.workers, {})
        )
        equal.store(options.store, results)
        print(f"equal: {len(results)} results written to {options.store}")
        return True
    reference = options.against or REFERENCE
    if options.stored:
        stored = json.loads(options.stored.read_text(encoding="utf-8"))
        which = [case for case in which if case.name in stored]
    else:
        stored = equal.results_at(reference, which, options.workers)
    now = equal.results_of(study.PROJECT, which, options.workers, {})
    lines, different = equal.compare(stored, now, options.lines)
    print(*lines, sep="\n" if lines else "", end="\n" if lines else "")
    against = options.stored or reference
    took = time.monotonic() - began
    print(f"equal: {different} of {len(which)} results differ from {against} ({took:.0f} s)")
    return not different


def run_judge(options: argparse.Namespace) -> bool:
    """Measure, and print every figure beside the stored one; whether none is worse."""
    began = time.monotonic()
    studies = [s for s in STUDIES if not options.only or s.name in options.only]
    if not studies:
        sys.exit(f"no study is called {' or '.join(options.only)}")
    if options.offline:
        os.environ[BY_OFFLINE] = "1"
    outcomes = judge.measure(studies, options.workers, is_short=options.short)
    judge.kept_outcomes(KEPT / f"outcomes{'-short' if options.short else ''}.json", outcomes)
    stored = judge.load()
    judged = judge.judge(studies, outcomes, stored[options.short])
    print(*judged.table(), sep="\n")
    if options.details:
        for each in studies:
            if each.details is not None:
                print("", *each.details(outcomes[each.name]), sep="\n")
    worse = sum(row.verdict == "worse" for row in judged.rows)
    took = time.monotonic() - began
    print(
        f"judge: {worse} of {len(judged.rows)} figures worse, {len(judged.defects)} defects "
        f"({took:.0f} s)"
    )
    if options.write:
        written = {row.now.name: row.now for row in judged.rows}
        kept = [dict(figures) for figures in stored]
        kept[options.short] |= written
        judge.store(kept[0], kept[1], options.write)
    return judged.is_right


def _asked(name: str, only: Sequence[str]) -> bool:
    return not only or any(word in name for word in only)


def make_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = study.arguments(__doc__)
    parser.add_argument("mode", nargs="?", choices=("equal", "judge"), help="default: both")
    parser.add_argument("--short", action="store_true", help="at most 4 minutes on two cores")
    parser.add_argument("--only", nargs="+", default=[], metavar="WORD", help="in the name")
    parser.add_argument("--workers", type=int, default=study.WORKERS, metavar="N")
    parser.add_argument("--against", metavar="COMMIT", help=f"equal: default {REFERENCE}")
    parser.add_argument("--stored", type=Path, metavar="FILE", help="equal: what --store wrote")
    parser.add_argument("--store", type=Path, metavar="FILE", help="equal: write, do not compare")
    parser.add_argument("--lines", type=int, default=12, metavar="N", help="equal: of each case")
    parser.add_argument("--details", action="store_true", help="judge: tables of the studies too")
    parser.add_argument("--offline", action="store_true", help="judge: by that where there is one")
    parser.add_argument("--write", metavar="COMMIT", help="judge: store the figures, as of COMMIT")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run what is asked for; 1 where anything is not as good as stored."""
    options = make_parser().parse_args(argv)
    right = True
    try:
        if options.mode != "judge":
            right &= run_equal(options)
    except trees.NoHistoryError as error:
        print(f"equal: not compared: {error}")
    if options.mode != "equal":
        right &= run_judge(options)
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
