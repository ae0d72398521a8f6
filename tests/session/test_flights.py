"""Emulated flights through telemetry and chain: how good the numbers are, and the verdicts."""

import shutil

import numpy as np
import pytest

from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.parameters import CORE_OF
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import Chain, ChainOptions
from gcs_sysid.signals.records import Record, Stream
from tests.feeding import feed

AS_THE_ARTICLE = ("--noise", "paper", "--sigma", "0.02", "--rate", "20")


@pytest.fixture(scope="module")
def airframe():
    return load_airframe("paper")


def errors(result, truth):
    """Relative errors of the core parameters that are not given."""
    return {
        n: abs(result.parameters[n].value / truth[n] - 1.0)
        for n in CORE_OF["speed"]
        if result.parameters[n].status != "given"
    }


@pytest.mark.slow
def test_the_articles_flight_is_identified(paper_flight, paper_result):
    truth = paper_flight.truth
    assert paper_result.verdict == "identified"
    (reason,) = paper_result.reasons  # an IMU without vibrations
    assert reason.startswith("rotor speeds are taken as sent")
    # Measured for this seed: largest error 1.0 %, CG 2 um.
    assert max(errors(paper_result, truth).values()) < 0.05
    for name in ("cg_x", "cg_y"):
        assert abs(paper_result.parameters[name].value - truth[name]) < 0.5e-3
    assert paper_result.vehicle == {"sysid": 1, "compid": 1, "autopilot": "px4"}
    assert paper_result.source == str(paper_flight.tlog)


@pytest.mark.slow
def test_hover_does_not_tell_izz_and_k_m(fly, airframe):
    flight = fly("--mission", "hover", *AS_THE_ARTICLE, "--duration", "16", "--seed", "1")
    result = analyze_log(flight.tlog, airframe)
    for name in ("Izz", "k_M"):
        assert result.parameters[name].status in ("weak", "unobservable")
    assert result.verdict in ("partial", "refused")
    # It is told what to fly, and of nothing that follows from not having flown it.
    assert result.reasons[0].startswith("hardly any rotation in roll, pitch, yaw")
    for word in ("explain only", "held-out", "one scale", "motor order"):
        assert not any(word in reason for reason in result.reasons), word
    # while thrust and CG are seen
    assert result.parameters["k_T"].value == pytest.approx(flight.truth["k_T"], rel=0.01)
    assert result.parameters["cg_x"].value == pytest.approx(flight.truth["cg_x"], abs=1e-3)


@pytest.mark.slow
def test_another_vehicle_may_be_asked_for(paper_flight, airframe):
    other = analyze_log(paper_flight.tlog, airframe, wanted=(7, None))
    assert other.verdict == "refused"
    assert other.vehicle == {}
    assert "autopilot received; found: PX4 quadrotor 1:1" in other.reasons[0]


@pytest.mark.slow
def test_a_cut_and_damaged_recording_still_serves(paper_flight, paper_result, airframe, tmp_path):
    """As after a kill -9 and a bad sector: half a record at the end, rubbish in the middle."""
    path = tmp_path / "damaged.tlog"
    shutil.copy(paper_flight.tlog, path)
    data = bytearray(path.read_bytes())
    data[200_000:200_500] = b"\xfd" * 500
    path.write_bytes(data[:-7])
    shares = []
    result = analyze_log(path, airframe, wanted=(1, 1), progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert len(shares) > 1
    assert result.telemetry["garbage_bytes"] > 0
    assert result.verdict == "identified"
    whole = paper_result.parameters["Izz"]
    assert result.parameters["Izz"].value == pytest.approx(whole.value, abs=whole.std)


def test_a_flight_is_validated_in_its_result(paper_result):
    shares = paper_result.validation["r_squared"]
    assert set(shares) == {"roll", "pitch", "yaw"}
    assert min(shares.values()) > 0.98


def after_a_landing(records, stay=5.0, second=None):
    """The same flight once more, after a stay on the ground, with the records `second` makes."""
    first, last = records[0].t, records[-1].t
    moved = last + stay - first
    states = [
        Record(Stream.IN_AIR, last + 0.01, (0.0,)),
        Record(Stream.IN_AIR, last + stay, (1.0,)),
    ]
    # It stands: still, and far quieter than in flight.
    still = {Stream.IMU: (0.0, 0.0, 0.0, 0.0, 0.0, -9.8), Stream.ROTOR_SPEED: (0.0,) * 4}
    ground = [
        record._replace(t=record.t + last - first, values=still.get(record.stream, record.values))
        for record in records
        if 0.0 < record.t - first < stay and record.stream is not Stream.IN_AIR
    ]
    again = [
        record._replace(t=record.t + moved)
        for record in map(second or (lambda r: r), records)
        if record.stream is not Stream.IN_AIR or record.values[0] > 0.5
    ]
    return [*records, states[0], *ground, states[1], *again]


def follow(records, tick=0.1):
    chain = Chain(load_airframe("paper"), ChainOptions(tick=tick))
    feed(chain, records)
    return chain, chain.finish()


@pytest.fixture(scope="module")
def joined(paper_records):
    return follow(after_a_landing(paper_records))


@pytest.fixture(scope="module")
def changed(paper_records):
    return follow(after_a_landing(paper_records, second=heavier))


def heavier(record):
    """The same motion with a tenth more thrust: all of the vehicle is a tenth heavier."""
    if record.stream is not Stream.ROTOR_SPEED:
        return record
    return record._replace(values=tuple(np.sqrt(1.1) * v for v in record.values))


@pytest.mark.slow
def test_two_flights_of_one_vehicle_are_joined(joined, paper_result):
    chain, result = joined
    assert result.segments == ()
    assert not any(event["kind"] != "vehicle" for event in result.events)
    # All of both but their ends, the climb's second and the windows.
    used = paper_result.telemetry["used_seconds"]
    assert 2.0 * used - 8.0 < result.telemetry["used_seconds"] < 2.0 * used
    for name in ("Ixx", "Iyy", "k_T", "cg_x"):
        one, both = paper_result.parameters[name], result.parameters[name]
        assert both.value == pytest.approx(one.value, abs=one.std)
        assert both.std < 1.05 * one.std
    assert not any("differs" in event.text for event in chain.events)


@pytest.mark.slow
def test_another_vehicle_after_a_landing_is_a_segment(changed, paper_records, paper_result):
    chain, result = changed
    (segment,) = result.segments
    (event,) = result.events
    landed = paper_records[-1].t - paper_records[0].t
    assert event["t"] == segment["end"] == pytest.approx(landed, abs=0.1)
    assert event["channel"] == "landing"
    # Told from ten seconds of the second flight.
    assert 15.0 < event["detected"] - event["t"] < 18.0
    assert event["kind"] == "payload"
    before = segment["parameters"]
    for name in ("Ixx", "Izz", "mass"):
        whole = paper_result.parameters[name].value
        assert before[name]["value"] == pytest.approx(whole, rel=0.01)
        assert result.parameters[name].value == pytest.approx(1.1 * whole, rel=0.01)
    # The rotors are the same.
    assert result.scale.anchor == "k_T"
    assert result.parameters["mass"].status == "identified"
    assert "differs since the landing" in chain.events[-1].text


@pytest.mark.slow
def test_a_hop_is_no_landing(paper_records, paper_result):
    part = paper_records[: len(paper_records) // 3]
    _, result = follow(after_a_landing(part, stay=1.5, second=heavier))
    # One flight, as far as the autopilot tells: the change is the detector's to find.
    assert not any(event["channel"] == "landing" for event in result.events)


@pytest.mark.slow
def test_a_short_second_flight_is_decided_at_its_end(paper_records, paper_result):
    first = paper_records[0].t
    records = after_a_landing(paper_records)
    end = paper_records[-1].t - first + 5.0 + 6.0
    _, result = follow([r for r in records if r.t - first < end])
    assert result.segments == ()
    more = result.telemetry["used_seconds"] - paper_result.telemetry["used_seconds"]
    assert 1.0 < more < 6.0


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("step", [(), ("--mass-step", "62:1.1")])
def test_emulated_flights_with_a_stay_between(fly, airframe, step):
    """Two outings with take-off and landing; the second, if so, with a tenth more mass."""
    sensor_faults = ("--trap", "ground=6", "--trap", "flights=2")
    flight = fly("--mission", "all-axes", "--noise", "mems", "--rate", "50", *sensor_faults, *step)
    result = analyze_log(flight.tlog, airframe)
    assert len(result.segments) == (1 if step else 0)
    assert result.verdict == "identified"
    assert max(errors(result, flight.truth).values()) < 0.05
    # Ground and take-off are not in it: k_T would come out ten times less certain.
    k_T = result.parameters["k_T"]
    assert k_T.std < 0.002 * k_T.value
    assert result.parameters["mass"].value == pytest.approx(flight.truth["mass"], rel=0.005)
