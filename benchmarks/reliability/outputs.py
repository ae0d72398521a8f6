"""Every output option where nothing can be written, or nobody reads: a table.

python -m benchmarks.reliability.outputs

The cells are the tests of `tests/cli/test_outputs.py`, which takes commands and options from the
parsers: `ok`, `FAILED`, or nothing where a case has no such output.
"""

import contextlib
import io
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[2] / "tests" / "cli" / "test_outputs.py"
COLUMNS = {
    "test_a_full_disk_takes_a_file_and_not_the_numbers": "disk full",
    "test_standard_output_on_a_full_disk_costs_no_file": "stdout full",
    "test_output_to_a_full_standard_output_is_a_line": "'-' full",
    "read-only": "read-only",
    "gone": "no folder",
    "test_a_reader_that_has_gone_costs_no_file": "closed pipe",
    "test_output_to_a_reader_that_has_gone_is_silent": "'-' pipe",
    "test_a_terminal_one_column_wide_costs_nothing": "1 column",
    "test_closed_streams_cost_nothing": "no terminal",
    "LANG=C": "LANG=C",
    "TERM=dumb": "TERM=dumb",
}
"""Name of a test, or its parameter before the case -> heading."""


class Cells:
    """Collects the outcomes; a plugin of pytest."""

    def __init__(self) -> None:
        self.rows: dict[str, dict[str, str]] = {}
        self.other: list[str] = []
        self.done = 0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take one test's outcome, or that its preparation failed."""
        if report.when != "call" and report.passed:
            return
        test, _, case = report.nodeid.rpartition("::")[2].removesuffix("]").partition("[")
        place = next((p for p in COLUMNS if test == p or case.startswith(f"{p}-")), None)
        if place is None or not case:
            if not report.passed:
                self.other.append(report.nodeid)
            return
        case = case.removeprefix(f"{place}-")
        outcome = {"passed": "ok", "skipped": "skipped"}.get(report.outcome, "FAILED")
        self.rows.setdefault(case, {})[COLUMNS[place]] = outcome
        self.done += 1
        if sys.stderr.isatty():
            print(f"\r{self.done} ", end="", file=sys.stderr, flush=True)


def main() -> int:
    """Run the sweep and print a row for each option; 1 when a cell is not ok."""
    cells = Cells()
    argv = ["-q", "-m", "", "-n", "0", str(TESTS), *sys.argv[1:]]
    with contextlib.redirect_stdout(io.StringIO()) as said:
        status = pytest.main(argv, plugins=[cells])
    if status not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        print(said.getvalue(), file=sys.stderr)
    headings = list(dict.fromkeys(COLUMNS.values()))
    print("| command, option | " + " | ".join(headings) + " |")
    print("|---" * (1 + len(headings)) + "|")
    for case, row in sorted(cells.rows.items()):
        print(f"| {case} | " + " | ".join(row.get(heading, "") for heading in headings) + " |")
    failed = sum(cell != "ok" for row in cells.rows.values() for cell in row.values())
    print(f"\n{cells.done} cells, {failed} not ok")
    for other in cells.other:
        print(f"not ok: {other}")
    return 1 if failed or cells.other or not cells.rows else 0


if __name__ == "__main__":
    sys.exit(main())
