"""The pieces of the studies of fast links, floods, long days and soaks."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.reliability import day, soak
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.telemetry.intake import Intake
from testbed.ground_cycles import emulate
from testbed.recordings import in_sequence
from testbed.repeated import frames_of


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("flight") / "flight.tlog"
    assert emulate(path, rate=20.0, ground=0.5, seconds=3.0) == 3.0
    return path


@pytest.fixture
def flight(recording):
    return frames_of(recording)


def sent(replayer, flight, times, intake):
    blocks = [part for _ in range(times) for part in replayer.send(flight, 0.0, 2.0)]
    return [record for part in blocks for record in in_sequence(intake.block(part))]


def test_what_is_sent_again_goes_on_over_the_wraps(flight):
    replayer = day.Replayer(1, (1 << 32) * 1e-3 - 3.013)
    intake = Intake()
    records = sent(replayer, flight, 4, intake)
    t = [record.t for record in records if record.stream == "imu"]
    assert np.allclose(np.diff(t), 0.05, atol=2e-6)
    assert replayer.wraps["ms"] == 1
    assert intake.monitor.lost == 0
    assert intake.decoder.clock.reboots == 0
    # Before the first stamp there is no time.
    assert intake.as_dict()["dropped"].keys() <= {"no time"}


def test_a_wrong_number_counts_unless_it_is_said(result):
    truth = {"Ixx": 0.01}
    sure = replace(result, parameters={"Ixx": Estimate(0.011, 1e-4, "kg m^2", "ok")})
    assert soak.wrong_numbers(sure, truth) == (
        pytest.approx(10.0),
        ["Ixx is wrong by 10.0 % and says 2.0 %"],
    )
    unsure = replace(result, parameters={"Ixx": Estimate(0.011, 1e-3, "kg m^2", "ok")})
    assert soak.wrong_numbers(unsure, truth)[1] == []
    assert soak.wrong_numbers(replace(sure, verdict="refused"), truth)[1] == []


@pytest.fixture
def result():
    from gcs_sysid.model.airframe import load_airframe
    from gcs_sysid.session.chain import Chain

    return replace(Chain(load_airframe("paper")).result(), verdict="identified")
