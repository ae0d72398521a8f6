"""What the screen's keys write: exports and reports, into files that were not there."""

import argparse
import json
from pathlib import Path

import pytest

from gcs_sysid.cli.screens import export_result, report_session
from gcs_sysid.errors import InputError
from gcs_sysid.exports.exported_vehicle import MissingError
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.results.snapshot import FoundVehicle, LinkState, LinkStatus


@pytest.fixture
def result(paper_result):
    return paper_result


def test_an_export_never_takes_the_place_of_another(result, folder):
    said = [export_result("urdf", result) for _ in range(3)]
    assert [words.split(";")[0] for words in said] == [
        "Exported to paper.urdf",
        "Exported to paper-2.urdf",
        "Exported to paper-3.urdf",
    ]
    assert len({path.read_text(encoding="utf-8") for path in folder.iterdir()}) == 1
    assert "see its header" in said[0]


def test_what_the_flight_does_not_tell_is_refused_and_nothing_written(result, folder):
    with pytest.raises(MissingError, match="rotor_speed_max"):
        export_result("gazebo-sdf", result)
    assert list(folder.iterdir()) == []


class Recorded:
    """As much of a session as a report needs."""

    def __init__(self, recording: Path | None) -> None:
        self.recording = recording
        self.airframe = load_airframe("paper").with_anchor("mass", 1.6)

    def flushed_recording(self):
        return self.recording

    def latest(self):
        heard = (FoundVehicle((1, 1), "PX4 quadrotor 1:1", True),)
        status = LinkStatus(LinkState.CONNECTED, "udpin:x", vehicles=heard)
        return argparse.Namespace(link=status)


OPTIONS = argparse.Namespace(
    airframe="paper", arm=None, mass=None, k_t=None, t_max=None, prior=[("k_M", 6.1e-6, 1e-7)]
)


@pytest.mark.thorough
def test_a_report_is_of_the_recording_so_far_with_the_scale_in_force(paper_flight, folder):
    recording = folder / "flight.tlog"
    whole = paper_flight.tlog.read_bytes()
    recording.write_bytes(whole[: 4 * len(whole) // 5])  # it ends within a frame, as it grows
    (folder / "flight.html").write_text("one that is there", encoding="utf-8")
    said = report_session(Recorded(recording), {"mass": 1.5}, OPTIONS)
    assert said == f"Report written to {folder / 'flight-2.html'}"
    page = (folder / "flight-2.html").read_text(encoding="utf-8")
    assert "--mass 1.6 --prior k_M=6.1e-06+-1e-07 --vehicle 1:1 --report" in page
    assert "flight.tlog" in page
    assert (folder / "flight.html").read_text(encoding="utf-8") == "one that is there"
    assert len(list(folder.iterdir())) == 3


def test_without_a_recording_there_is_no_report(folder):
    with pytest.raises(InputError, match="o starts one"):
        report_session(Recorded(None), None, OPTIONS)


@pytest.mark.slow
def test_a_recording_that_tells_nothing_is_said_in_a_line(folder):
    (folder / "empty.tlog").write_bytes(b"")
    with pytest.raises(InputError, match="empty"):
        report_session(Recorded(folder / "empty.tlog"), None, OPTIONS)
    assert json.dumps([p.name for p in folder.iterdir()]) == '["empty.tlog"]'
