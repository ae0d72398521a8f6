"""Emulated flights through telemetry and chain: what the issue says must be shown."""

import dataclasses
import shutil

import pytest

from gcs_sysid.estimation.parameters import CORE
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.pipeline import Pipeline
from gcs_sysid.telemetry.tlog import read_tlog

AS_THE_ARTICLE = ("--noise", "paper", "--sigma", "0.02", "--rate", "20")


@pytest.fixture(scope="module")
def airframe():
    return load_airframe("paper")


@pytest.fixture(scope="module")
def paper_result(paper_flight, airframe):
    return analyze_log(paper_flight.tlog, airframe)


def errors(result, truth):
    """Relative errors of the core parameters that are not given."""
    return {
        n: abs(result.parameters[n].value / truth[n] - 1.0)
        for n in CORE
        if result.parameters[n].status != "given"
    }


def test_the_articles_flight_is_identified(paper_flight, paper_result):
    truth = paper_flight.truth
    assert paper_result.verdict == "identified"
    assert paper_result.reasons == ()
    # The bars; measured for this seed: largest error 1.0 %, CG 2 um.
    assert max(errors(paper_result, truth).values()) < 0.05
    for name in ("cg_x", "cg_y"):
        assert abs(paper_result.parameters[name].value - truth[name]) < 0.5e-3
    assert paper_result.vehicle == {"sysid": 1, "compid": 1, "autopilot": "px4"}
    assert paper_result.source == str(paper_flight.tlog)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_other_seeds_of_it(fly, airframe, seed):
    flight = fly("--mission", "paper", *AS_THE_ARTICLE, "--seed", str(seed))
    result = analyze_log(flight.tlog, airframe)
    assert result.verdict == "identified"
    assert max(errors(result, flight.truth).values()) < 0.05


@pytest.mark.slow
def test_hover_does_not_tell_izz_and_k_m(fly, airframe):
    flight = fly("--mission", "hover", *AS_THE_ARTICLE, "--duration", "30", "--seed", "1")
    result = analyze_log(flight.tlog, airframe)
    for name in ("Izz", "k_M"):
        assert result.parameters[name].status in ("weak", "unobservable")
    assert result.verdict in ("partial", "refused")
    assert any("Izz and k_M" in reason for reason in result.reasons)
    # while thrust and CG are seen
    assert result.parameters["k_T"].value == pytest.approx(flight.truth["k_T"], rel=0.01)
    assert result.parameters["cg_x"].value == pytest.approx(flight.truth["cg_x"], abs=1e-3)


@pytest.mark.slow
def test_mems_noise_at_250_hz(fly, airframe):
    flight = fly("--mission", "paper", "--noise", "mems", "--rate", "250", "--seed", "1")
    result = analyze_log(flight.tlog, airframe)
    wrong = errors(result, flight.truth)
    assert result.verdict == "identified"
    assert max(wrong["Ixx"], wrong["Iyy"]) < 0.006
    assert max(wrong.values()) < 0.06


def test_size_of_portions_does_not_matter(paper_flight, paper_result, airframe):
    pipeline = Pipeline(airframe, str(paper_flight.tlog))
    for _, frame in read_tlog(paper_flight.tlog):
        pipeline.take([frame])
    result = pipeline.finish()
    assert result.as_json() == paper_result.as_json()


def test_progress_rises_to_one(paper_flight, airframe):
    shares = []
    analyze_log(paper_flight.tlog, airframe, progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert len(shares) > 1


def test_another_vehicle_may_be_asked_for(paper_flight, paper_result, airframe):
    same = analyze_log(paper_flight.tlog, airframe, wanted=(1, 1))
    assert same.parameters == paper_result.parameters
    other = analyze_log(paper_flight.tlog, airframe, wanted=(7, None))
    assert other.verdict == "refused"
    assert other.vehicle == {}
    assert "autopilot was heard; heard: PX4 quadrotor 1:1" in other.reasons[0]


def test_a_cut_and_damaged_recording_still_serves(paper_flight, paper_result, airframe, tmp_path):
    """As after a kill -9 and a bad sector: half a record at the end, rubbish in the middle."""
    path = tmp_path / "damaged.tlog"
    shutil.copy(paper_flight.tlog, path)
    data = bytearray(path.read_bytes())
    data[200_000:200_500] = b"\xfd" * 500
    path.write_bytes(data[:-7])
    result = analyze_log(path, airframe)
    assert result.telemetry["garbage_bytes"] > 0
    assert result.verdict == "identified"
    whole = paper_result.parameters["Izz"]
    assert result.parameters["Izz"].value == pytest.approx(whole.value, abs=whole.std)


def test_results_are_values(paper_result):
    with pytest.raises(dataclasses.FrozenInstanceError):
        paper_result.verdict = "refused"
    with pytest.raises(dataclasses.FrozenInstanceError):
        paper_result.parameters["Ixx"].value = 1.0


def test_a_flight_is_validated_in_its_result(paper_result):
    shares = paper_result.validation["r_squared"]
    assert set(shares) == {"roll", "pitch", "yaw"}
    assert min(shares.values()) > 0.98
