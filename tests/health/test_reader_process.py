"""`analyze` of a long log, which another process reads: the same answers however that one ends."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from gcs_sysid.cli.program import run
from gcs_sysid.health import assessment, reader_process, whole_analysis
from gcs_sysid.health.assessment import HoverRecords
from gcs_sysid.session import analysis
from gcs_sysid.telemetry import tlog

pytestmark = pytest.mark.slow

LONGEST = 60.0
SMALL = 2**16
"""Bytes of a window, so that a log has several."""
_SMALL_WINDOWS = f"from gcs_sysid.telemetry import tlog; tlog.WINDOW = {SMALL};"
_MAIN = "from gcs_sysid.health import reader_main; reader_main.main()"
_KILLED = """
from gcs_sysid.telemetry import log_relay
import os, signal
put, left = object_pipe.ObjectSender.put, [{parts}]
def counted(self, what):
    if not left[0]:
        self.wait(0)
        os.kill(os.getpid(), {how})
    left[0] -= 1
    put(self, what)
object_pipe.ObjectSender.put = counted
"""
"""A process that ends itself after so many parts."""


@pytest.fixture
def beside(monkeypatch):
    """Has every log read by another process, which does what is told before its own."""

    def beside(*before):
        monkeypatch.setattr(whole_analysis, "_LONG_LOG", 0)
        monkeypatch.setattr(whole_analysis, "_processors", lambda: 2)
        code = "\n".join([_SMALL_WINDOWS, *before, _MAIN])
        monkeypatch.setattr(reader_process, "COMMAND", [sys.executable, "-P", "-c", code])

    monkeypatch.setattr(tlog, "WINDOW", SMALL)
    return beside


def analyzed(log, out, *options):
    status = run(["analyze", str(log), "--airframe", "paper", "--json", str(out), *options])
    return status, out.read_bytes() if out.exists() else None


def forbid_reading_here(monkeypatch):
    monkeypatch.setattr(analysis, "open_log", None)
    monkeypatch.setattr("gcs_sysid.telemetry.log_relay.open_log", None)
    monkeypatch.setattr(HoverRecords, "health", None)


def test_the_answer_is_that_of_one_process(flight, tmp_path, monkeypatch, beside, capfd):
    alone = analyzed(flight.tlog, tmp_path / "alone.json")
    said = capfd.readouterr()
    assert alone[0] == 0
    assert b'"seconds_of_hover"' in alone[1]
    beside()
    forbid_reading_here(monkeypatch)
    assert analyzed(flight.tlog, tmp_path / "beside.json") == alone
    assert capfd.readouterr() == said


@pytest.mark.parametrize("name", ["public/real-quad-copter33.bin", "public/px4-sitl.ulg"])
def test_likewise_of_an_onboard_log(shared_logs, name, tmp_path, monkeypatch, beside, capfd):
    alone = analyzed(shared_logs / name, tmp_path / "alone.json", "--mass", "1.5")
    said = capfd.readouterr()
    beside()
    forbid_reading_here(monkeypatch)
    assert analyzed(shared_logs / name, tmp_path / "b.json", "--mass", "1.5") == alone
    assert capfd.readouterr() == said


@pytest.mark.parametrize("how", ["signal.SIGTERM", "0) or os._exit(1"], ids=["killed", "defect"])
@pytest.mark.parametrize("parts", [0, 1, 4])
def test_what_a_process_that_ended_left_is_done_here(flight, parts, how, tmp_path, beside, capfd):
    alone = analyzed(flight.tlog, tmp_path / "alone.json")
    said = capfd.readouterr()
    beside(_KILLED.format(parts=parts, how=how))
    assert analyzed(flight.tlog, tmp_path / "ended.json") == alone
    assert capfd.readouterr() == said


def test_hover_that_it_did_not_assess_is_assessed_here(flight, tmp_path, beside, capfd):
    alone = analyzed(flight.tlog, tmp_path / "alone.json")
    said = capfd.readouterr()
    beside("from gcs_sysid.health.assessment import HoverRecords; HoverRecords.health = None")
    assert analyzed(flight.tlog, tmp_path / "ended.json") == alone
    assert capfd.readouterr() == said


def test_of_a_log_of_many_hours_the_rest_waits_to_be_taken(
    flight, tmp_path, monkeypatch, beside, capfd
):
    short = replace(assessment.TUNING, most_samples=500)
    with monkeypatch.context() as here:
        here.setattr(assessment, "TUNING", short)
        alone = analyzed(flight.tlog, tmp_path / "alone.json")
    said = capfd.readouterr()
    assert b"first 500 IMU samples" in alone[1]
    waited = tmp_path / "waited"
    beside(
        "from dataclasses import replace",
        "from gcs_sysid.health import assessment, reader_main",
        "assessment.TUNING = replace(assessment.TUNING, most_samples=500)",
        "class Sender(reader_main.ObjectSender):",
        "    def wait(self, most):",
        f"        open({str(waited)!r}, 'a').write(f'{{most}} ')",
        "        super().wait(most)",
        "        assert len(self._waiting) <= most",
        "reader_main.ObjectSender = Sender",
    )
    forbid_reading_here(monkeypatch)
    assert analyzed(flight.tlog, tmp_path / "beside.json") == alone
    assert capfd.readouterr() == said
    assert set(waited.read_text().split()) == {"4"}


def test_parameters_fetched_after_the_flight_have_it_read_again(
    flight, tmp_path, monkeypatch, beside, capfd
):
    readings = []
    monkeypatch.setattr(
        "gcs_sysid.session.chain.Chain.outdated", property(lambda self: len(readings) < 2)
    )
    begin = analysis.take_log
    monkeypatch.setattr(
        analysis,
        "take_log",
        lambda chain, log, *others: readings.append(type(log)) or begin(chain, log, *others),
    )
    alone = analyzed(flight.tlog, tmp_path / "alone.json")
    said = capfd.readouterr()
    beside()
    first = readings[:]
    readings.clear()
    assert analyzed(flight.tlog, tmp_path / "beside.json") == alone
    assert capfd.readouterr() == said
    assert [kind.__name__ for kind in (*first, *readings)] == [
        "TlogLog",
        "TlogLog",
        "RelayedLog",
        "TlogLog",
    ]


def test_a_log_that_cannot_be_read_is_one_line(tmp_path, monkeypatch, beside, capfd):
    bad = tmp_path / "bad.tlog"
    bad.write_bytes(bytes(1000))
    alone = analyzed(bad, tmp_path / "alone.json")
    said = capfd.readouterr()
    assert alone == (2, None)
    assert said.err.count("\n") == 1
    beside()
    forbid_reading_here(monkeypatch)
    assert analyzed(bad, tmp_path / "beside.json") == alone
    assert capfd.readouterr() == said


def test_a_file_that_fails_midway_is_one_line(flight, tmp_path, beside, monkeypatch, capfd):
    beside(
        "from gcs_sysid.telemetry import tlog",
        "from gcs_sysid.telemetry.tlog import Scanner",
        "scan, left = Scanner.scan, [3]",
        "def failing(self, *args, **more):",
        "    left[0] -= 1",
        "    if left[0] < 0: raise OSError(5, 'Input/output error')",
        "    return scan(self, *args, **more)",
        "Scanner.scan = failing",
    )
    forbid_reading_here(monkeypatch)
    assert analyzed(flight.tlog, tmp_path / "out.json") == (2, None)
    said = capfd.readouterr()
    line = f"gcs-sysid: error: cannot read {flight.tlog}: Input/output error"
    assert said.err.splitlines()[-1] == line
    assert "Traceback" not in said.err


def test_where_no_process_can_be_started_one_does_it(flight, tmp_path, beside, monkeypatch, capfd):
    alone = analyzed(flight.tlog, tmp_path / "alone.json")
    said = capfd.readouterr()
    beside()
    monkeypatch.setattr(reader_process, "COMMAND", [str(tmp_path / "nothing")])
    assert analyzed(flight.tlog, tmp_path / "beside.json") == alone
    assert capfd.readouterr() == said


_ANALYSIS = """
import signal
import sys
from gcs_sysid.health import whole_analysis
from gcs_sysid.cli.program import run
from gcs_sysid.health import reader_process
from gcs_sysid.telemetry import log_relay

class Shown(reader_process.ReaderProcess):
    def __init__(self, *task):
        super().__init__(*task)
        print(self._process.pid, flush=True)

if __name__ == "__main__":
    # A shell has what it starts in the background ignore this one.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    whole_analysis._LONG_LOG = 0
    whole_analysis._processors = lambda: 2
    reader_process.ReaderProcess = Shown
    hang = "import time; from gcs_sysid.health import reader_main; "
    hang += "reader_main.open_log = lambda *_: time.sleep(1000); reader_main.main()"
    if sys.argv[2] == "hangs":
        reader_process.COMMAND = [sys.executable, "-P", "-c", hang]
    else:  # and nothing is read here
        log_relay.open_log = whole_analysis.health_of_log = None
    sys.exit(run(["analyze", sys.argv[1], "--airframe", "paper"]))
"""


def is_running(pid):
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    return False


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs Linux's /proc")
@pytest.mark.parametrize(("how", "status"), [("SIGINT", 130), ("SIGTERM", -15), ("SIGKILL", -9)])
def test_the_other_process_ends_with_an_analysis_that_is_ended(flight, how, status):
    words = [sys.executable, "-c", _ANALYSIS, str(flight.tlog), "hangs"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(words, start_new_session=True, **pipes) as process:
        pid = int(process.stdout.readline())
        assert is_running(pid)
        os.killpg(process.pid, getattr(signal, how))  # as a terminal does
        _, said = process.communicate(timeout=LONGEST)
        assert process.returncode == status
        assert "Traceback" not in said
        deadline = time.monotonic() + LONGEST
        while is_running(pid):
            assert time.monotonic() < deadline
            threading.Event().wait(0.01)


def test_nothing_is_left_open(flight):
    words = [sys.executable, "-c", _ANALYSIS, str(flight.tlog), "reads"]
    strict = {**os.environ, "PYTHONWARNINGS": "error", "PYTHONDEVMODE": "1"}
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=strict)
    assert done.returncode == 0
    assert done.stderr == ""
