"""A batch on a real Dask scheduler with two workers on this machine."""

import os
import subprocess
import sys

import pytest

pytest.importorskip("pyarrow", reason="needs the extra fleet")
pytest.importorskip("distributed", reason="needs the extra cluster")

import distributed

from gcs_sysid.fleet.batch_table import read_table
from gcs_sysid.fleet.pools import reason

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    """The address of a scheduler with two workers, each a process of its own."""
    folder = tmp_path_factory.mktemp("dask")
    file = folder / "scheduler.json"
    program = [sys.executable, "-m", "distributed.cli."]
    options = {"cwd": folder, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    local = ["--scheduler-file", str(file), "--host", "127.0.0.1"]

    def start(name, *words):
        command = [*program[:2], program[2] + name, *local, "--no-dashboard", *words]
        return subprocess.Popen(command, env=environment, **options)

    processes = [start("dask_scheduler", "--port", "0")]
    processes += [start("dask_worker", "--nthreads", "1", "--no-nanny") for _ in range(2)]
    try:
        with distributed.Client(scheduler_file=str(file), timeout=60) as client:
            client.wait_for_workers(2, timeout=60)
            address = client.scheduler.address
        yield address
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait(30)


def test_a_batch_over_two_workers(batch, logs, scheduler, tmp_path):
    out = tmp_path / "out"
    status, err = batch(logs, "-o", out, "--airframe", "paper", "--scheduler", scheduler)
    assert status == 0
    assert "5 of 5 logs: 4 identified, 1 failed" in err
    local = tmp_path / "local"
    batch(logs, "-o", local, "--airframe", "paper", "--workers", "1")
    assert read_table(out / "fleet.parquet") == read_table(local / "fleet.parquet")
    status, err = batch(logs, "-o", out, "--airframe", "paper", "--scheduler", scheduler)
    assert (status, "(5 done before)" in err) == (0, True)


def test_a_log_that_kills_workers_is_told_as_on_one_machine():
    assert "died" in reason(distributed.scheduler.KilledWorker("task", None, 3))


def test_no_scheduler_is_a_line(batch, logs, tmp_path, monkeypatch):
    for address in ("tcp://127.0.0.1:9", "nonsense://here"):
        status, err = batch(
            logs, "-o", tmp_path / "out", "--airframe", "paper", "--scheduler", address
        )
        assert status == 2
        assert err.endswith(f"gcs-sysid: error: {address}: no Dask scheduler answers there\n")
    monkeypatch.setitem(sys.modules, "distributed", None)
    status, err = batch(
        logs, "-o", tmp_path / "out", "--airframe", "paper", "--scheduler", "tcp://x"
    )
    assert (status, err.count("\n")) == (2, 1)
    assert "pip install distributed pyarrow" in err
