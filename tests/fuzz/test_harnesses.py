"""Every harness on its seeds, on the inputs kept, and on what hypothesis draws near them."""

from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.reliability.fuzz import main
from gcs_sysid.telemetry.frames import FrameScanner
from gcs_sysid.telemetry.mapped_table import read_table
from testbed.fuzz import blackbox_harnesses, definition_harnesses, link_harnesses
from testbed.fuzz.drive import Driver
from testbed.fuzz.harness import Harness
from testbed.fuzz.harnesses import HARNESSES

BY_NAME = [pytest.param(harness, id=harness.name) for harness in HARNESSES]


@pytest.mark.parametrize("harness", BY_NAME)
def test_seeds_and_inputs_kept_hold(harness):
    for data in (b"", *harness.seeds(), *harness.kept()):
        harness.check(data)


@pytest.mark.slow
@pytest.mark.parametrize("harness", BY_NAME)
def test_what_is_drawn_holds(harness):
    @settings(
        max_examples=15, derandomize=True, deadline=None, database=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )  # fmt: skip
    @given(st.data())
    def holds(data):
        seed = data.draw(st.sampled_from(harness.seeds()))
        at = data.draw(st.integers(0, len(seed)))
        stop = data.draw(st.integers(at, min(at + 20, len(seed))))
        piece = data.draw(st.binary(max_size=12) | st.sampled_from([*harness.tokens, b""]))
        harness.check(seed[:at] + piece + seed[stop:])
        harness.check(piece)

    holds()


def test_the_tables_to_begin_with_are_read(tmp_path):
    mapping, table = tmp_path / "map.toml", tmp_path / "log.csv"
    for seed in definition_harnesses.table_seeds():
        mapping.write_bytes(seed.partition(b"\n%\n")[0])
        table.write_bytes(seed.partition(b"\n%\n")[2])
        assert {"imu", "rotor_speed"} <= {t.stream for t in read_table(table, mapping).tracks}


def test_a_scanner_that_loses_a_frame_or_makes_one_up_is_found_out(monkeypatch):
    (stream, *_) = link_harnesses.stream_seeds()
    feed = FrameScanner.feed
    monkeypatch.setattr(FrameScanner, "feed", lambda self, chunk: feed(self, chunk)[:-1])
    with pytest.raises(AssertionError, match="reference"):
        link_harnesses.check_frames(stream)


def test_what_a_harness_finds_is_kept_once(tmp_path):
    def check(data):
        assert data != b"bad"

    driver = Driver(Harness("mine", "", check, list, 1.0), 100, 1e9, tmp_path)
    for data in (b"good", b"bad", b"bad"):
        driver.take(data)
    driver.tell()
    (kept,) = (path for path in tmp_path.glob("mine-*") if path.suffix == "")
    assert kept.read_bytes() == b"bad"
    text = (tmp_path / "mine.json").read_text()
    assert '"inputs": 3' in text
    assert "AssertionError" in text


def test_blackbox_bodies_that_are_misread_are_found_out(monkeypatch):
    data = b"".join(blackbox_harnesses.bbl_body_seeds())
    blackbox_harnesses.check_bbl_bodies(data)
    read = blackbox_harnesses.read_frames
    monkeypatch.setattr(
        blackbox_harnesses, "read_frames", lambda *of: replace(read(*of), damaged=-1)
    )
    with pytest.raises(AssertionError, match="damaged frames"):
        blackbox_harnesses.check_bbl_bodies(data)


@pytest.mark.slow
def test_a_run_prints_a_table(tmp_path, capsys):
    argv = ["url", "--inputs", "300", "--least", "1", "--findings", str(tmp_path / "f")]
    assert main([*argv, "--engine", "random"]) == 0
    out = capsys.readouterr().out
    assert "names of links" in out
    assert "300 inputs, 0 findings" in out
