"""The table of the sweep of outputs, and how batches that were killed are judged."""

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from benchmarks.reliability import outputs
from benchmarks.reliability.batch_kills import left_over


def report(name, outcome="passed", when="call"):
    node = f"tests/cli/test_outputs.py::{name}"
    passed = outcome == "passed"
    return SimpleNamespace(nodeid=node, when=when, outcome=outcome, passed=passed)


def test_each_test_is_a_cell_and_what_failed_is_named():
    cells = outputs.Cells()
    full = "test_a_full_disk_takes_a_file_and_not_the_numbers"
    for told in (
        report(f"{full}[tune json]"),
        report(f"{full}[tune json]", when="setup"),
        report("test_a_folder_that_is_gone_or_read_only_is_a_line[read-only-tune json]"),
        report("test_poor_terminals_cost_nothing[LANG=C-tune json]", "failed"),
        report(f"{full}[twin json]", "failed", "setup"),
        report("test_every_command_is_in_the_sweep"),
        report("test_every_output_option_is_in_the_sweep", "failed"),
    ):
        cells.pytest_runtest_logreport(told)
    assert cells.rows == {
        "tune json": {"disk full": "ok", "read-only": "ok", "LANG=C": "FAILED"},
        "twin json": {"disk full": "FAILED"},
    }
    assert [other.rpartition("::")[2] for other in cells.other] == [
        "test_every_output_option_is_in_the_sweep"
    ]


@pytest.mark.skipif(os.name != "posix", reason="process groups")
def test_processes_that_are_left_are_seen(monkeypatch):
    with subprocess.Popen(
        [sys.executable, "-c", "input()"], stdin=subprocess.PIPE, start_new_session=True
    ) as process:
        monkeypatch.setattr("benchmarks.reliability.batch_kills._PATIENCE", 0.1)
        assert left_over(process.pid)
        process.communicate(b"\n")
    assert not left_over(process.pid)
