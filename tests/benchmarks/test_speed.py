"""The comparison of readers: its log, its figures, its words where one is missing."""

from pathlib import Path

from benchmarks import speed, speed_log

PROJECT = Path(speed_log.__file__).resolve().parents[1]


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
