"""A batch: a result a log, nothing done twice, nothing lost."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("pyarrow", reason="needs the extra fleet")

from gcs_sysid.cli.program import run
from gcs_sysid.fleet.batch import BatchRun, Store, read_table
from gcs_sysid.fleet.jobs import FAILURE, Job, LocalPool
from gcs_sysid.model.airframe import Airframe, load_airframe

PAPER = ("--airframe", "paper")


def documents(out):
    return {path.name: json.loads(path.read_text()) for path in (out / "results").iterdir()}


def times(out):
    return {path.name: path.stat().st_mtime_ns for path in (out / "results").iterdir()}


def rows(out):
    return {Path(row["path"]).name: row for row in read_table(out / "fleet.parquet")}


@pytest.mark.slow
def test_a_result_a_log_a_row_a_log_and_nothing_twice(batch, logs, tmp_path, capsys):
    out = tmp_path / "out"
    status, err = batch(logs, "-o", out, *PAPER, "--workers", "2")
    assert status == 0
    assert "5 of 5 logs: 4 identified, 1 failed" in err
    assert "broken.ulg is not a .tlog" in err
    made = documents(out)
    assert len(made) == 4  # the copy is its original
    names = sorted(name.rpartition("-")[0] for name in made)
    assert names == ["a", "a", "b", "broken"]
    assert [d["schema"] for d in made.values()].count(FAILURE) == 1
    table = read_table(out / "fleet.parquet")
    assert [Path(row["path"]).relative_to(logs).as_posix() for row in table] == [
        *("one/a.tlog", "one/b.tlog", "one/copy without a suffix"),
        *("two/a.tlog", "two/broken.ulg"),
    ]
    assert table[0]["sha256"] == table[2]["sha256"] != table[3]["sha256"]
    assert "not a .tlog" in table[4]["error"]
    for row in table[:4]:
        document = json.loads((out / row["result"]).read_text())
        assert row["Ixx"]["value"] == document["parameters"]["Ixx"]["value"]
        assert document["log"]["sha256"] == row["sha256"]

    # The result is that of `analyze`.
    log, alone = logs / "one" / "a.tlog", tmp_path / "one.json"
    run(["analyze", str(log), "--airframe", "paper", "--json", str(alone)])
    capsys.readouterr()
    first = json.loads((out / table[0]["result"]).read_text())
    assert first.pop("log")["bytes"] == log.stat().st_size
    assert {one["name"] for one in first.pop("hover")} >= {"CG forward", "k_T"}
    assert first["health"]["seconds_of_hover"] > 0.0
    assert first == json.loads(alone.read_text())

    before = times(out)
    (logs / "one" / "b.tlog").rename(logs / "one" / "renamed.tlog")
    status, err = batch(logs, "-o", out, *PAPER)
    assert status == 0
    assert "(5 done before)" in err
    assert times(out) == before
    assert rows(out)["renamed.tlog"]["result"].startswith("results/b-")


@pytest.mark.thorough
def test_damaged_results_are_made_again_and_other_settings_are_others(batch, flights, tmp_path):
    out = tmp_path / "out"
    batch(flights[0], "-o", out, *PAPER)
    (path,) = (out / "results").iterdir()
    whole = path.read_text()
    path.write_text(whole[:100])
    status, err = batch(flights[0], "-o", out, *PAPER)
    assert status == 0
    assert "done before" not in err
    assert path.read_text() == whole
    first = path.name
    batch(flights[0], "-o", out, *PAPER, "--mass", "3")
    both = documents(out)
    assert first in both
    assert len(both) == 2
    assert rows(out)[flights[0].name]["scale"]["value"] == 3.0
    before = times(out)
    batch(flights[0], "-o", out, *PAPER, "--mass", "3", "--force")
    redone = {name for name, time in times(out).items() if time != before[name]}
    assert redone == set(both) - {first}


@pytest.mark.slow
def test_every_log_takes_the_nearest_airframe_and_a_terminal_sees_how_far_it_is(
    batch, logs, airframe_file, tmp_path, monkeypatch
):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    (logs / "one" / "b.tlog").unlink()
    airframe_file(logs / "one" / "airframe.toml", "quad-1")
    airframe_file(logs / "airframe.toml", "others", mass=1.4)
    status, err = batch(logs, "-o", tmp_path / "out")
    assert status == 0
    lines = re.split(r"\r *\r", err)
    assert any(line.startswith("1 of 4 logs: 1 ") and line.endswith(" left") for line in lines)
    assert lines[-1].startswith("gcs-sysid: 4 of 4 logs: 3 identified, 1 failed")
    found = {
        Path(row["path"]).parent.name: (row["vehicle"], row["scale"]["value"])
        for row in read_table(tmp_path / "out" / "fleet.parquet")
        if row["verdict"]
    }
    assert found == {"one": ("quad-1 1:1", 1.5), "two": ("others 1:1", 1.4)}


def test_a_log_without_airframe_is_told_before_anything_is_done(batch, logs, tmp_path):
    status, err = batch(logs, "-o", tmp_path / "out")
    assert status == 2
    assert err.startswith(f"gcs-sysid: error: no airframe for {logs / 'one' / 'a.tlog'} (and for 4")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_log_without_airframe_has_its_own_layout(batch, fly, tmp_path):
    log = fly("--mission", "hover", "--autopilot", "ardupilot", "--airframe", "ardupilot-quad-x",
              "--duration", "12", "--seed", "2", "--rate", "20").tlog  # fmt: skip
    status, err = batch(log, "-o", tmp_path / "fleet", "--arm", "0.25", "--mass", "1.5")
    assert status == 0, err
    (made,) = read_table(tmp_path / "fleet" / "fleet.parquet")
    assert made["airframe"] == log.parent.name
    assert {one["name"] for one in made["hover"]} >= {"CG forward", "k_T"}
    status, err = batch(log, "-o", tmp_path / "other", "--airframe", "auto", "--mass", "1.5")
    assert status == 2
    assert "give --arm M" in err


def test_an_airframe_without_a_scale_is_named(batch, logs, tmp_path):
    shutil.copy(Path(__file__).parents[2] / "src/gcs_sysid/model/airframes/px4-quad-x.toml",
                logs / "airframe.toml")  # fmt: skip
    status, err = batch(logs, "-o", tmp_path / "out")
    assert status == 2
    assert f"{logs / 'airframe.toml'}: nothing sets the scale" in err


def test_a_folder_of_something_else_is_left_alone(batch, logs, tmp_path):
    thesis = tmp_path / "thesis.tex"
    thesis.write_text("chapter 1")
    status, err = batch(logs, "-o", tmp_path, *PAPER)
    assert status == 2
    assert "holds files that are not of a batch" in err
    assert not (tmp_path / "results").exists()


@pytest.mark.slow
def test_exit_statuses_of_logs_that_tell_nothing(batch, logs, fly, tmp_path):
    hover = fly("--mission", "hover", "--rate", "20", "--duration", "1").tlog
    broken = logs / "two" / "broken.ulg"
    assert batch(hover, broken, "-o", tmp_path / "refused", *PAPER)[0] == 1
    assert batch(broken, "-o", tmp_path / "broken", *PAPER)[0] == 2


@pytest.mark.skipif(sys.platform != "linux", reason="names are bytes on Linux alone")
def test_a_name_that_is_no_utf8_does_not_cost_the_table(batch, tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / os.fsdecode(b"bad\xff.tlog")).write_bytes(b"no log")
    status, err = batch(folder, "-o", tmp_path / "out", *PAPER)
    assert status == 2
    assert "1 failed" in err
    assert list(rows(tmp_path / "out")) == [r"bad\udcff.tlog"]


def test_no_logs_and_no_pyarrow_are_a_line(batch, logs, tmp_path, monkeypatch):
    (tmp_path / "empty").mkdir()
    status, err = batch(tmp_path / "empty", "-o", tmp_path / "out", *PAPER)
    assert (status, err.count("\n")) == (2, 1)
    assert "contains no .tlog, .ulg, .bin, .bbl or .mcap file" in err
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    status, err = batch(logs, "-o", tmp_path / "out", *PAPER)
    assert (status, err.count("\n")) == (2, 1)
    assert 'pip install "gcs-sysid[fleet]"' in err


class DeadlyAirframe(Airframe):
    """Ends the process that its job comes to."""

    def __reduce__(self):
        return os._exit, (9,)


@pytest.mark.thorough
def test_a_log_at_which_the_process_dies_is_a_row_and_is_tried_again(logs, tmp_path):
    paper = load_airframe("paper")
    deadly = DeadlyAirframe(**vars(paper))
    paths = [logs / "one" / "a.tlog", logs / "one" / "b.tlog", logs / "two" / "a.tlog"]

    def run_with(airframe):
        jobs = [Job(path, airframe if n == 1 else paper) for n, path in enumerate(paths)]
        pool = LocalPool(2)
        try:
            batch = BatchRun(jobs, Store(tmp_path / "out"), pool, lambda *_: None, lambda: False)
            return {Path(row["path"]): row for row in batch.run()}, batch.tally.kept
        finally:
            pool.close()

    found, kept = run_with(deadly)
    assert kept == 0
    assert [found[path]["verdict"] for path in paths] == ["identified", None, "identified"]
    assert "died" in found[paths[1]]["error"]
    assert found[paths[1]]["result"] is None
    found, kept = run_with(paper)
    assert kept == 2
    assert [found[path]["error"] for path in paths] == [None, None, None]


def start(logs, out):
    command = [sys.executable, "-m", "gcs_sysid", "batch", str(logs), "-o", str(out)]
    pipe = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([*command, "--airframe", "paper", "--workers", "1"], text=True, **pipe)


@pytest.fixture
def many(flights, tmp_path):
    """Three logs of different content: a flight, and so many of its last bytes less."""
    folder = tmp_path / "many"
    folder.mkdir()
    whole = flights[0].read_bytes()
    for n in range(3):
        (folder / f"{n:02d}.tlog").write_bytes(whole[: len(whole) - 400 * n])
    return folder


def wait_for_results(process, out, count):
    """Until so many results are there, while the batch runs."""
    while process.poll() is None:
        found = list((out / "results").glob("*.json")) if out.exists() else []
        if len(found) >= count:
            return
        try:
            process.wait(0.05)
        except subprocess.TimeoutExpired:
            continue
    pytest.fail(f"ended before it was stopped: {process.communicate()}")


@pytest.mark.slow
def test_killed_in_the_middle_and_started_again(batch, many, tmp_path):
    out = tmp_path / "out"
    with start(many, out) as process:
        wait_for_results(process, out, 1)
        process.kill()
        process.communicate(timeout=60)
    before = times(out)
    assert 1 <= len(before) < 3
    assert not (out / "fleet.parquet").exists()
    status, err = batch(many, "-o", out, *PAPER)
    assert status == 0
    whole = {name: time for name, time in before.items() if name.endswith(".json")}
    assert f"3 of 3 logs ({len(whole)} done before)" in err
    after = times(out)
    assert whole.items() <= after.items()
    table = read_table(out / "fleet.parquet")
    assert sorted(Path(row["path"]).name for row in table) == sorted(os.listdir(many))
    assert {Path(row["result"]).name for row in table} == {n for n in after if n.endswith(".json")}


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="sends a signal as a terminal does")
def test_interrupted_keeps_what_is_done(many, tmp_path):
    out = tmp_path / "out"
    with start(many, out) as process:
        wait_for_results(process, out, 1)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    done = read_table(out / "fleet.parquet")
    assert 1 <= len(done) < 3
    assert len(done) == len(times(out))
    assert f"interrupted; run the same command again for the other {3 - len(done)}" in err
    assert "Traceback" not in err
