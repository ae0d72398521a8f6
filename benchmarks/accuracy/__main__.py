"""Run the studies and write docs/accuracy.md.

Outcomes are kept as JSON under build/accuracy, one file a case; with --only, the page is written
from what is kept of the others.
"""

import os
import sys
import time
from typing import Any

from benchmarks.accuracy.cases import CASES, Case
from benchmarks.accuracy.sections import page, whole_path
from testbed.study import PROJECT, WORKERS, Kept, arguments, in_processes, say

KEPT = Kept(PROJECT / "build" / "accuracy", 3)
PAGE = PROJECT / "docs" / "accuracy.md"


def study(case: Case, count: int, workers: int) -> dict[str, Any]:
    """Run a case over seeds 1 to count, or whole groups of what it takes together."""
    say(f"{case.name}: preparing")
    began = time.monotonic()
    before = processor_seconds()
    case.prepare()
    prepared = processor_seconds() - before
    firsts = range(1, (1 if case.once else count) + 1, case.together)
    outcomes = in_processes(case.run, firsts, workers, case.name)
    spent = processor_seconds() - before - prepared
    return {
        "seeds": len(firsts) * case.together,
        "seconds": round(time.monotonic() - began, 1),
        "prepared": round(prepared, 1),
        "each": round(spent / len(firsts), 2),
        "workers": workers,
        "outcomes": outcomes,
    }


def processor_seconds() -> float:
    """Of this process and of its children that have ended (of these, not on Windows)."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def kept() -> dict[str, Any]:
    """Outcomes of the cases that were run, now or earlier, in their order."""
    found = KEPT.all()
    return {case.name: found[case.name] for case in CASES if case.name in found}


def main() -> None:
    """Run what is asked for."""
    parser = arguments(__doc__)
    parser.add_argument("--seeds", type=int, help="for every case; default: each case's own")
    names = [case.name for case in CASES]
    parser.add_argument("--only", choices=names, action="append", help="may be repeated")
    parser.add_argument("--workers", type=int, default=WORKERS)
    parser.add_argument("--page", action="store_true", help="write the page from what is kept")
    options = parser.parse_args()
    for case in CASES:
        if options.page or (options.only and case.name not in options.only):
            continue
        done = study(case, options.seeds or case.seeds, options.workers)
        KEPT.write(case.name, done)
        print(
            f"{case.name}: {done['seeds']} seeds in {done['seconds']:.0f} s (processor: "
            f"{done['prepared']:.1f} s to prepare, {done['each']:.2f} s a run)",
            file=sys.stderr,
        )
    if options.only == ["end-to-end"]:
        print("\n".join(whole_path(kept())))
        return
    PAGE.write_text(page(kept()), encoding="utf-8", newline="\n")
    print(PAGE.relative_to(PROJECT), file=sys.stderr)


if __name__ == "__main__":
    main()
