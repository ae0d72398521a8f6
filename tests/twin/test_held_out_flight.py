"""The twin on recorded flights: held-out parts, bands, table, picture, and what it refuses."""

import json
import math
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import gcs_sysid
from gcs_sysid.cli.program import run
from gcs_sysid.errors import InputError
from gcs_sysid.model import attitude
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.report import evidence_sections
from gcs_sysid.results.words import TEXT_WIDTH
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.twin.held_out_flight import (
    airframe_of_result,
    fly_held_out,
    fly_own_flight,
    is_same_flight,
)
from gcs_sysid.twin.measured_flight import FlightRecorder, MeasuredFlight
from gcs_sysid.twin.prediction_errors import Twin, basic_model
from gcs_sysid.twin.twin_flight import twin_table

SAMPLE = Path(__file__).resolve().parents[2] / "logs" / "sample.tlog"


@pytest.fixture(scope="module")
def result():
    return gcs_sysid.analyze(SAMPLE, "paper")


@pytest.fixture(scope="module")
def twin(result):
    return gcs_sysid.fly_twin(result, SAMPLE)


@pytest.mark.slow
def test_a_result_of_the_same_log_is_fitted_again_to_the_first_part(twin, result):
    assert twin.same_flight
    ((start, end),) = twin.judged
    # 60 % of the flight, as in the validation.
    assert (start - 0.0) / end == pytest.approx(0.6, abs=0.03)
    assert "refitted" in twin.held_out
    assert twin.result.telemetry["used_seconds"] < result.telemetry["used_seconds"] * 0.65
    assert twin.result.parameters["Izz"].value != result.parameters["Izz"].value


@pytest.mark.slow
def test_the_model_flies_like_the_vehicle(twin):
    rates = twin.accuracy[1.0]["rates"]
    assert rates.r_squared > 0.98
    assert rates.rms < 0.1 * rates.guess
    assert rates.count == pytest.approx((twin.judged[0][1] - twin.judged[0][0]) / 1.0, abs=2)
    for each in twin.accuracy.values():
        for accuracy in each.values():
            assert 0.85 <= accuracy.inside <= 1.0
            assert accuracy.band > accuracy.band_parameters > 0.0


def test_errors_grow_from_the_measured_state(twin):
    growth = twin.growth
    assert growth.t[-1] == pytest.approx(3.0)
    for name in ("attitude", "velocity"):
        assert growth.rms[name][2] < 0.2 * growth.rms[name][-1]
        assert growth.rms[name][-1] == pytest.approx(twin.accuracy[3.0][name].rms)
    # A guess is as good as the model at first, and worse afterwards.
    assert growth.guess["attitude"][-1] > 5.0 * growth.rms["attitude"][-1]


def test_the_body_is_seen_through_a_turned_imu():
    """An IMU turned by a quarter about yaw reads roll as pitch; the body rolls."""
    read = np.array([[0.0, -0.3, 0.1]])
    level = np.array([[1.0, 0.0, 0.0, 0.0]])
    record = MeasuredFlight(np.zeros(1), read, level, read, read, 0.004, RotorInput.SPEED)
    body = record.of_body(np.array([0.0, 0.0, 0.5 * math.pi]))
    assert body.rates == pytest.approx(np.array([[0.3, 0.0, 0.1]]))
    forward = attitude.rotate(body.attitude, np.array([[1.0, 0.0, 0.0]]))
    assert forward == pytest.approx(np.array([[0.0, -1.0, 0.0]]))


@pytest.mark.thorough
def test_a_wrong_model_leaves_the_band(result):
    """The band is of what the result claims: a vehicle with another inertia flies out of it."""
    elsewhere = replace(result, source="another.tlog", validation={})
    right = fly_held_out(_scaled(elsewhere, 1.0 + 1e-6), SAMPLE)
    wrong = fly_held_out(_scaled(elsewhere, 1.25), SAMPLE)
    assert not right.same_flight
    assert "another flight" in right.held_out
    assert right.accuracy[1.0]["rates"].inside > 0.9
    # Its noise is told by its own errors in the other half, so the band widens, and is no alibi.
    assert wrong.accuracy[1.0]["rates"].rms > 3.0 * right.accuracy[1.0]["rates"].rms
    assert wrong.accuracy[1.0]["rates"].band > 3.0 * right.accuracy[1.0]["rates"].band
    assert wrong.accuracy[1.0]["rates"].band_parameters < 0.5 * wrong.accuracy[1.0]["rates"].rms


def _scaled(result, factor):
    parameters = dict(result.parameters)
    for name in ("Ixx", "Iyy", "Izz"):
        parameters[name] = replace(parameters[name], value=parameters[name].value * factor)
    return replace(result, parameters=parameters)


def test_the_table_fits_a_terminal(twin):
    lines = twin_table(twin).split("\n")
    assert max(map(len, lines)) <= TEXT_WIDTH
    row = next(line for line in lines if line.startswith("rates, deg/s") and " 1 s" in line)
    shown = float(row.split()[4])
    assert shown == pytest.approx(np.degrees(twin.accuracy[1.0]["rates"].rms), rel=0.01)
    assert repr(twin) == "\n".join(lines)


def test_the_picture_is_whole_and_escaped(twin):
    page = ET.fromstring(evidence_sections.twin_svg(replace(twin, source="<b>&.json")))
    namespace = "{http://www.w3.org/2000/svg}"
    assert len(page.findall(f"{namespace}polyline")) == 6
    assert len(page.findall(f"{namespace}circle")) == 3 * len(twin.accuracy)
    assert "<b>&.json" in "".join(page.itertext())


@pytest.mark.slow
def test_the_command_writes_what_the_function_gives(tmp_path, capsys, result, twin):
    result.write(tmp_path / "sample.json")
    out, picture = tmp_path / "twin.json", tmp_path / "twin.svg"
    files = ["--json", str(out), "--picture", str(picture)]
    assert run(["twin", str(tmp_path / "sample.json"), str(SAMPLE), *files]) == 0
    assert "held out: " in capsys.readouterr().out
    document = json.loads(out.read_text())
    assert document["schema"] == "gcs-sysid-twin/1"
    assert document["same_flight"] is True
    ahead = {h["seconds"]: h for h in document["horizons"]}
    assert ahead[1.0]["rates"]["rms"] == pytest.approx(twin.accuracy[1.0]["rates"].rms)
    assert picture.read_text() == evidence_sections.twin_svg(twin)
    # Nothing is lost: files that are there stay.
    assert run(["twin", str(tmp_path / "sample.json"), str(SAMPLE), *files]) == 2
    assert "exists" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        (["no.json", str(SAMPLE)], 2, "no.json"),
        ([str(SAMPLE), str(SAMPLE)], 2, "needs --airframe"),
        (["{result}", "no.tlog"], 2, "no.tlog"),
        (["{result}", str(SAMPLE), "--mass", "1.5"], 2, "need --airframe"),
        (["{result}", str(SAMPLE), "--airframe", "px4-hexa-x", "--mass", "2"], 2, "4 rotors"),
        (["{unable}", str(SAMPLE)], 1, "needs Izz"),
        (["{result}", str(SAMPLE), "--json", "/no/such/folder/x"], 2, "no such folder"),
    ],
)
def test_what_cannot_be_flown_is_one_line(tmp_path, capsys, result, arguments, status, says):
    result.write(tmp_path / "result.json")
    elsewhere = _scaled(replace(result, source="another.tlog", validation={}), 1.1)
    own = {n: e for n, e in elsewhere.parameters.items() if n != "Izz"}
    replace(elsewhere, parameters=own).write(tmp_path / "unable.json")
    names = {"result": tmp_path / "result.json", "unable": tmp_path / "unable.json"}
    assert run(["twin", *(word.format(**names) for word in arguments)]) == status
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("\n") == 1
    assert says in told.err


@pytest.mark.slow
def test_the_same_flight_is_known_by_any_name(tmp_path, result):
    """By its content, by its numbers whatever was given, and where it is gone by its name."""
    again = gcs_sysid.analyze(SAMPLE, "paper", mass=1.6)
    other = replace(again, source="link", validation={"r_squared": {"roll": 0.5}})
    copy = tmp_path / "copy.tlog"
    copy.write_bytes(SAMPLE.read_bytes())
    assert is_same_flight(replace(again, source="udpin:0.0.0.0:14550"), result, SAMPLE)
    assert is_same_flight(replace(other, source=str(copy)), result, SAMPLE)
    assert is_same_flight(replace(other, source="elsewhere/sample.ulg"), result, SAMPLE)
    assert not is_same_flight(other, result, SAMPLE)
    copy.write_bytes(SAMPLE.read_bytes() + b"x")
    assert not is_same_flight(replace(other, source=str(copy)), result, SAMPLE)


def test_the_airframe_is_that_of_the_result(result):
    airframe = airframe_of_result(result)
    assert (airframe.name, airframe.anchor()) == ("paper", ("mass", 1.5))
    named = replace(result, airframe=result.airframe | {"name": "mine"})
    assert airframe_of_result(named).geometry.tolist() == airframe.geometry.tolist()
    with pytest.raises(InputError, match="rotor positions"):
        airframe_of_result(replace(result, airframe={}))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("log", "least"), [("px4-sih-default.tlog", 0.9), ("px4-esc-cg.tlog", 0.9)]
)
def test_flights_of_px4s_simulator(shared_logs, log, least):
    airframe = gcs_sysid.load_airframe("px4-sih", mass=1.0)
    result = gcs_sysid.analyze(shared_logs / log, airframe)
    accuracy = gcs_sysid.fly_twin(result, shared_logs / log, airframe).accuracy[1.0]
    assert accuracy["rates"].r_squared >= least
    for each in accuracy.values():
        assert 0.85 <= each.inside <= 1.0


def test_the_basic_model_lacks_what_else_turns_a_vehicle(result, twin):
    shares = np.array([1.05, 0.98, 1.02, 0.95])
    told = result.model()
    model = replace(told, rotor_inertia=np.array(2e-5), thrust=told.thrust * shares)
    basic = basic_model(model)
    assert basic.rotor_inertia == 0.0
    assert basic.drag == 0.0
    assert not basic.damping.any()
    assert (basic.mass, basic.motor_lag) == (model.mass, model.motor_lag)
    assert np.ptp(basic.thrust) == 0.0
    assert basic.thrust.sum() == pytest.approx(model.thrust.sum())
    assert basic.inertia is model.inertia
    # The sample's vehicle has none of it but a little drag.
    for each in twin.accuracy.values():
        assert each["rates"].basic == pytest.approx(each["rates"].rms, rel=0.05)
    record = SimpleNamespace(rotor_input=RotorInput.SPEED)
    assert Twin(model, model, record)._basic.rotor_inertia == 0.0


def test_a_report_shows_what_the_command_prints(twin):
    data = SimpleNamespace(twin=twin.as_json(), twin_picture=evidence_sections.twin_svg(twin))
    page = str(evidence_sections.twin(data))
    ahead = twin.accuracy[1.0]["rates"]
    row = re.search(r"Rates, 1 s ahead.*?</tr>", page, re.DOTALL)[0]
    shown = re.findall(r"<td[^>]*>([^<]*)</td>", row)
    assert float(shown[0].split()[0]) == pytest.approx(math.degrees(ahead.rms), rel=0.01)
    assert float(shown[1].split()[0]) == pytest.approx(math.degrees(ahead.band), rel=0.01)
    assert shown[2] == f"{100.0 * ahead.inside:.0f} %"
    assert page.count("<svg") == 1
    assert "37 to 62 s" in page
    assert evidence_sections.twin(SimpleNamespace(twin={}, twin_picture="")) is None


@pytest.mark.slow
def test_a_recorder_keeps_no_more_than_it_is_asked_for(result):
    whole, half = FlightRecorder(), FlightRecorder(20.0)
    both = SimpleNamespace(
        begin=lambda: [each.begin() for each in (whole, half)],
        take=lambda block: [each.take(block) for each in (whole, half)],
        end=lambda chain: [each.end(chain) for each in (whole, half)],
    )
    analyze_log(SAMPLE, gcs_sysid.load_airframe("paper"), observers=[both])
    flown = whole.record(0.0, "log").flown()
    kept = half.record(0.0, "log").flown()
    # Refitted by the estimator of a result: where rotors and IMU are is unknown.
    roughly = {"imu_rotation": 1.0, "rotor_position": "0.2%"}
    airframe = gcs_sysid.load_airframe("paper", mass=1.5, uncertainty=roughly)
    refitted = fly_own_flight(result, half, SAMPLE, airframe).result
    assert refitted.telemetry["imu_rotation"]
    assert refitted.telemetry["rotor_offsets"]
    whole.close()
    half.close()
    assert flown[-1] - flown[0] > 50.0
    assert 19.0 < kept[-1] - kept[0] < 22.0
    assert np.array_equal(kept, flown[: len(kept)])
