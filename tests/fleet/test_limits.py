"""One log that takes for ever, or all memory, costs the others nothing."""

import contextlib
import subprocess
import sys

import numpy as np
import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.fleet.batch import read_table
from gcs_sysid.fleet.jobs import Job, LogLimits, Task, analyze_within
from gcs_sysid.model.airframe import load_airframe

ON_LINUX = pytest.mark.skipif(sys.platform != "linux", reason="memory is limited on Linux")


@pytest.fixture
def task(tmp_path):
    return Task(Job(tmp_path / "some.tlog", load_airframe("paper")), "", "", 0)


def spin(task):
    while True:
        pass


def spin_and_swallow(task):
    while True:
        with contextlib.suppress(Exception):  # as careless code does
            spin(task)


@pytest.mark.parametrize("work", [spin, spin_and_swallow])
def test_what_takes_too_long_is_given_up(task, work):
    with pytest.raises(InputError, match=r"some\.tlog: not done after 0\.2 s; --log-timeout"):
        analyze_within(LogLimits(seconds=0.2), task, work)
    assert analyze_within(LogLimits(), task, lambda task: {"done": True}) == {"done": True}


@ON_LINUX
def test_what_takes_too_much_memory_is_given_up_and_the_limit_lifted(task):
    import resource

    before = resource.getrlimit(resource.RLIMIT_AS)
    with pytest.raises(InputError, match="needs more than 50 MB of memory; --log-memory"):
        analyze_within(LogLimits(megabytes=50.0), task, lambda task: np.ones(20_000_000))
    assert resource.getrlimit(resource.RLIMIT_AS) == before
    assert len(analyze_within(LogLimits(), task, lambda task: np.ones(20_000_000))) == 20_000_000


def test_a_reader_that_has_run_out_of_memory_is_told_as_that(task):
    def read(task):
        try:
            raise MemoryError
        except MemoryError as error:
            raise InputError("too large") from error

    with pytest.raises(InputError, match="--log-memory"):
        analyze_within(LogLimits(), task, read)


ENDLESS = """
import re
from gcs_sysid.fleet import jobs
jobs._GRACE = 0.2
within = jobs.LogLimits(seconds=0.1)
jobs.analyze_within(within, TASK, lambda task: re.match("(a+)+b", "a" * 80))
"""


@pytest.mark.slow
def test_a_step_without_an_end_costs_the_process():
    """One that never lets go of the interpreter, so that no thread of Python's can end it."""
    script = ENDLESS.replace("TASK", "type('T', (), {'job': type('J', (), {'log': 'x'})})")
    done = subprocess.run([sys.executable, "-c", script], timeout=60, check=False)
    assert done.returncode != 0


@pytest.mark.slow
def test_logs_over_their_time_are_rows_and_are_tried_again(batch, flights, tmp_path):
    words = (flights[0], "-o", tmp_path / "out", "--airframe", "paper")
    status, said = batch(*words, "--log-timeout", "0.01")
    assert status == 2
    (row,) = read_table(tmp_path / "out" / "fleet.parquet")
    assert "not done after 0.01 s" in row["error"]
    assert row["verdict"] is None
    assert row["result"] is None
    assert "--log-timeout" in said
    assert batch(*words)[0] == 0
    (row,) = read_table(tmp_path / "out" / "fleet.parquet")
    assert row["verdict"] is not None
