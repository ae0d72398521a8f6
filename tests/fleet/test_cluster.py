"""A batch on a real Dask scheduler with a worker on this machine."""

import contextlib
import os
import subprocess
import sys

import pytest

pytest.importorskip("pyarrow", reason="needs the extra fleet")

from gcs_sysid.fleet.batch import read_table
from gcs_sysid.fleet.jobs import reason

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def distributed():
    """Dask, which takes a second to load."""
    return pytest.importorskip("distributed", reason="needs the extra cluster")


@pytest.fixture(scope="module")
def cluster(distributed, tmp_path_factory):
    """The address of a scheduler, its process and that of a worker, and what starts another."""
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

    def add_worker():
        processes.append(start("dask_worker", "--nthreads", "1", "--no-nanny"))
        with distributed.Client(scheduler_file=str(file), timeout=60) as client:
            client.wait_for_workers(len(processes) - 1, timeout=60)
            return client.scheduler.address

    try:
        yield add_worker(), processes, add_worker
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait(30)


@pytest.fixture
def scheduler(cluster):
    return cluster[0]


def test_a_batch_over_a_cluster(batch, logs, scheduler, tmp_path):
    logs, out = logs / "two", tmp_path / "out"
    status, err = batch(logs, "-o", out, "--airframe", "paper", "--scheduler", scheduler)
    assert status == 0
    assert "2 of 2 logs: 1 identified, 1 failed" in err
    local = tmp_path / "local"
    batch(logs, "-o", local, "--airframe", "paper")
    assert read_table(out / "fleet.parquet") == read_table(local / "fleet.parquet")
    status, err = batch(logs, "-o", out, "--airframe", "paper", "--scheduler", scheduler)
    assert (status, "(2 done before)" in err) == (0, True)


def test_a_log_that_kills_workers_is_told_as_on_one_machine(distributed):
    assert "died" in reason(distributed.scheduler.KilledWorker("task", None, 3))


def test_no_scheduler_is_a_line(batch, logs, distributed, tmp_path, monkeypatch):
    patient = distributed.Client
    monkeypatch.setattr(
        distributed, "Client", lambda address, **how: patient(address, **{**how, "timeout": 0.2})
    )
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
    assert 'pip install "gcs-sysid[cluster]"' in err


@pytest.mark.thorough
def test_a_worker_that_is_killed_and_a_scheduler_that_dies(logs, cluster, tmp_path):
    """Last in the file, as the cluster is then gone."""
    address, processes, add_worker = cluster
    scheduler, victim = processes
    add_worker()
    command = [sys.executable, "-m", "gcs_sysid", "batch", str(logs), "--airframe", "paper"]
    command += ["--scheduler", address, "-o"]

    def batch(out, to_kill):
        pipe = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        with subprocess.Popen([*command, str(out)], text=True, **pipe) as process:
            while process.poll() is None and not list(out.glob("results/*.json")):
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(0.02)
            to_kill.kill()
            _, err = process.communicate(timeout=240)
        assert "Traceback" not in err
        return process.returncode, err

    status, err = batch(tmp_path / "out", victim)
    assert status == 0
    assert "5 of 5 logs: 4 identified, 1 failed" in err
    assert len(read_table(tmp_path / "out" / "fleet.parquet")) == 5
    status, err = batch(tmp_path / "other", scheduler)
    assert (status, err.count("error: ")) == (2, 1)
    assert err.endswith("the Dask scheduler is gone; run the same command again for the rest\n")
