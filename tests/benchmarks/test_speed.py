"""The comparison of readers: its log, its figures, its words where one is missing."""

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import speed, speed_log
from gcs_sysid.telemetry.logs import open_log

PROJECT = Path(speed_log.__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """About two flights."""
    return speed_log.long_log(tmp_path_factory.mktemp("speed") / "long.tlog", 9_500_000)


@pytest.mark.slow
def test_the_long_log_is_one_flight_after_the_other_without_a_fault(log):
    assert 9_400_000 < log.stat().st_size <= 9_500_000
    recording = open_log(log)
    tracks = [track for block in recording.blocks() for track in block.tracks]
    told = recording.as_dict()
    assert (told["bad_crc"], told["garbage_bytes"], told["unknown"], told["lost"]) == (0, 0, 0, 0)
    assert (told["reboots"], told["imu_gaps"]["count"]) == (0, 0)
    assert told["duration"] > 125.0
    assert {track.stream for track in tracks} >= {"imu", "attitude", "rotor_speed", "velocity"}
    assert recording.drift_ppm == pytest.approx(0.0, abs=1.0)


@pytest.mark.slow
def test_the_table_compares_and_says_what_is_left_out(log, tmp_path):
    (tmp_path / "speed-1000000.tlog").write_bytes(log.read_bytes()[:1_000_000])
    command = [sys.executable, "-m", "benchmarks.speed", "--size", "1", "--repeats", "1"]
    command += ["--cache", str(tmp_path), "--folder", str(tmp_path / "none")]
    done = subprocess.run(
        [*command, "--only", "file", "decoder", "windows", "pymavlink"],
        check=True, capture_output=True, text=True, cwd=PROJECT,
    )  # fmt: skip
    lines = {line[:24].strip(): line.split() for line in done.stdout.splitlines()}
    found = {lines[title][-6] for title in ("this decoder, whole", "this decoder, windows")}
    assert found == {lines["pymavlink"][-6]}
    assert float(lines["pymavlink"][-4]) == 1.0
    assert float(lines["this decoder, whole"][-4]) > 3.0


def test_a_reader_that_is_missing_is_left_out_with_a_word(tmp_path, monkeypatch):
    path = tmp_path / "some.tlog"
    path.write_bytes(bytes(1000))
    monkeypatch.setitem(
        speed.READERS, "mavpose", speed.READERS["mavpose"]._replace(title="someone's")
    )
    lines = speed.table(path, {"mavpose": "ModuleNotFoundError: No module named 'mavpose'"})
    assert lines[-1].startswith("someone's")
    assert lines[-1].endswith("left out: ModuleNotFoundError: No module named 'mavpose'")


def test_the_bars_are_told_beside_what_was_measured(tmp_path):
    path = tmp_path / "some.tlog"
    path.write_bytes(bytes(2_000_000))
    measured = {
        "decoder": speed.Measured(0.5, 90e6, 10),
        "pymavlink": speed.Measured(20.0, 80e6, 10),
        "fasttlogparser": "does not build",
    }
    lines = [line.split() for line in speed.verdicts(path, measured)]
    assert [(line[-4], line[-1]) for line in lines] == [("40.0", "15"), ("90", "127")]
