"""`analyze --report` on the command line."""

import json
import os
import subprocess
import sys

import pytest

from gcs_sysid.cli.program import run
from gcs_sysid.telemetry.tlog import TlogReader
from gcs_sysid.telemetry.tlog_writer import TlogWriter

PAPER = ("--airframe", "paper")
HIGHRES_IMU = 105


@pytest.mark.slow
def test_the_result_is_the_same_with_and_without(report, paper_flight, tmp_path, capsys):
    path = tmp_path / "result.json"
    truth = ("--truth", str(paper_flight.truth_file))
    assert run(["analyze", str(paper_flight.tlog), *PAPER, *truth, "--json", str(path)]) == 0
    without = json.loads(path.read_text())
    # Blocks of samples end elsewhere, which rounds otherwise; a search ends within 3e-4 standard
    # deviations, and a p-value of whiteness goes with it.
    assert numbers_of(without) == pytest.approx(numbers_of(report.result), rel=1e-4, abs=1e-15)
    assert words_of(without) == words_of(report.result)


def leaves(value):
    """The numbers and words of a JSON value, in order."""
    if isinstance(value, dict):
        return [leaf for key in sorted(value) for leaf in (key, *leaves(value[key]))]
    return [leaf for v in value for leaf in leaves(v)] if isinstance(value, list) else [value]


def numbers_of(value):
    return [leaf for leaf in leaves(value) if isinstance(leaf, float)]


def words_of(value):
    return [leaf for leaf in leaves(value) if not isinstance(leaf, float)]


def test_a_refused_recording_is_reported_with_its_reasons(paper_flight, tmp_path, capsys):
    log, page = tmp_path / "no-imu.tlog", tmp_path / "no-imu.html"
    with TlogWriter(log) as writer:
        for time_us, frame in TlogReader(paper_flight.tlog):
            if frame.message_id != HIGHRES_IMU:
                writer.write(time_us, [frame])
    assert run(["analyze", str(log), *PAPER, "--report", str(page)]) == 1
    text = page.read_text(encoding="utf-8")
    assert "Not identified" in text
    assert "no IMU data" in text


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.tlog").write_bytes(b"")
    (tmp_path / "b.tlog").write_bytes(b"")
    (tmp_path / "taken.html").write_text("mine")
    (tmp_path / "folder").mkdir()
    return tmp_path


@pytest.mark.parametrize(
    ("argv", "told"),
    [
        (["a.tlog", "--report", "taken.html"], "--force"),
        (["a.tlog", "--report", "no/such.html"], "no/such.html"),
        (["a.tlog", "--report", "folder", "--force"], "folder"),
        (["a.tlog", "b.tlog", "--report", "r.html"], "one LOG"),
        (["a.tlog", "--report", "-"], "needs a file name"),
        (["a.tlog", "--report", "a.tlog", "--force"], "another file"),
        (["a.tlog", "--json", "r.html", "--report", "r.html"], "another file"),
        (["a.tlog", "--report", "r.html"], "a.tlog"),  # cannot be read
    ],
)
def test_wrong_usage_is_one_line_and_changes_nothing(folder, capsys, argv, told):
    before = sorted(os.listdir(folder))
    assert run(["analyze", *argv, *PAPER]) == 2
    error = capsys.readouterr().err
    assert error.startswith("gcs-sysid: error: ")
    assert error.count("\n") == 1
    assert told in error
    assert (folder / "taken.html").read_text() == "mine"
    assert sorted(os.listdir(folder)) == before


@pytest.mark.thorough
def test_names_of_logs_may_be_anything(paper_flight, tmp_path, capsys):
    log = tmp_path / '<img src=x onerror=alert(1)> & "it\'s".tlog'
    try:
        log.write_bytes(paper_flight.tlog.read_bytes())
    except OSError:
        pytest.skip("no such names here")
    page = tmp_path / "page.html"
    page.write_text("old")
    assert run(["analyze", str(log), *PAPER, "--report", str(page), "--force"]) == 0
    html = page.read_text(encoding="utf-8")
    assert "<img" not in html
    assert "&lt;img src=x onerror=alert(1)&gt; &amp; &quot;it&#x27;s&quot;.tlog" in html


@pytest.mark.slow
def test_the_report_needs_neither_screen_nor_mavlink():
    code = (
        "import sys, gcs_sysid.report.page, gcs_sysid.report.data, gcs_sysid.files\n"
        "print(sorted(m for m in ('textual', 'pymavlink', 'serial') if m in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
