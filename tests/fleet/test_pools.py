"""Processes that die, and processes that are left alone."""

import multiprocessing
import operator
import os
import subprocess
import sys
from concurrent.futures import BrokenExecutor
from dataclasses import replace

import pytest

from gcs_sysid.fleet.jobs import Job, LocalPool, Task, complete, reason
from gcs_sysid.model.airframe import load_airframe


class Deadly:
    """Ends the process that unpickles it, as the kernel does when memory runs out."""

    def __reduce__(self):
        return os._exit, (9,)


def tasks(*deadly, count=8):
    job = Job("log", load_airframe("paper"))
    for n in range(count):
        task = Task(job, str(n), "", 0)
        yield replace(task, job=Deadly()) if n in deadly else task


@pytest.fixture
def pool():
    pool = LocalPool(2, operator.attrgetter("path"))
    yield pool
    pool.close()
    assert multiprocessing.active_children() == []


@pytest.mark.slow
def test_every_task_is_done_once(pool):
    done = list(complete(pool, tasks(), lambda: False))
    assert sorted(result for _, result in done) == list("01234567")
    assert all(task.path == result for task, result in done)


@pytest.mark.thorough
def test_who_kills_the_process_twice_was_to_blame(pool):
    done = {task.path: result for task, result in complete(pool, tasks(2, 6), lambda: False)}
    assert len(done) == 8
    for path, result in done.items():
        if path in "26":
            assert isinstance(result, BrokenExecutor)
            assert "died" in reason(result)
        else:
            assert result == path


def test_an_error_is_told_in_a_line():
    assert (
        reason(ValueError("one\ntwo")) == "internal error (ValueError: one two); please report it"
    )
    assert reason(MemoryError()) == "not enough memory for it"


ORPHANS = """
import sys, time
from gcs_sysid.fleet.jobs import Task
from gcs_sysid.fleet.jobs import LocalPool
if __name__ == "__main__":
    pool = LocalPool(2, time.sleep)
    pool.submit(1000)
    print(*pool._executor._processes, flush=True)
    sys.stdin.read()
"""


@pytest.mark.slow
def test_processes_end_with_the_one_that_was_killed(tmp_path):
    script = tmp_path / "orphans.py"
    script.write_text(ORPHANS)
    pipe = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([sys.executable, str(script)], text=True, **pipe) as parent:
        assert len(parent.stdout.readline().split()) == 2
        parent.kill()
        # They hold its standard output: it ends when the last of them has.
        assert parent.communicate(timeout=60)[0] == ""
