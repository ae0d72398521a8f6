"""The pieces of the studies of fast links, floods, long days and soaks."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.reliability import busy, day, soak
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.tlog import read_tlog
from testbed import fast_link
from testbed.ground_cycles import emulate
from testbed.repeated import frames_of
from testbed.watched import Times


def taken(sizes, batches):
    """Times of datagrams of such sizes, that came at 10, 20, ... ms.

    Args:
        batches: bytes, ms when they were learnt from, and whether that renewed the estimate.
    """
    times = Times()
    for number, size in enumerate(sizes):
        times.arrive(10_000_000 * (number + 1), size)
    for size, ms, renewed in batches:
        times.take(size, 1_000_000 * ms, renewed=renewed)
    return times.as_dict()


def test_each_datagram_counts_until_what_came_with_it_is_learnt_from():
    told = taken([3, 4, 1], [(7, 100, False), (1, 500, True)])
    assert told["taken_ms"][0] == 90.0  # of 90, 80 and 470
    assert told["taken_ms"][-1] == 470.0
    assert (told["renewals"], told["renewed_ms"][0]) == (1, 470.0)
    # What was never handed over is told.
    told = taken([3, 4, 1], [(7, 100, False)])
    assert (told["datagrams"], told["not_taken"], told["renewed_ms"]) == (2, 1, [])


def test_a_recording_is_held_against_what_was_sent():
    sent = [b"a", b"b", b"b", b"c"]
    assert busy.compare(sent, sent) == (4, 0, 0, True)
    assert busy.compare(sent, [b"a", b"b", b"c"]) == (4, 1, 0, True)
    assert busy.compare(sent, [b"a", b"c", b"b", b"b"]) == (4, 0, 0, False)
    assert busy.compare(sent, [*sent, b"d"]) == (4, 0, 1, True)


def test_a_leak_is_growth():
    memory = [(float(t), 100_000_000 + 20_000 * t) for t in range(600)]
    assert fast_link.growth(memory)[1] == pytest.approx(8.4, abs=0.1)


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
    return [record for part in blocks for _, record in intake.block(part).records()]


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


def test_growth_of_memory_and_handles_is_told():
    first = soak.Round((), 60.0, 5.0, "identified", 1.0, 150.0, 7, ())
    assert soak.against(first, first) == []
    assert len(soak.against(first, replace(first, memory=200.0, handles=9))) == 2
    rounds = [replace(first, memory=float(n)) for n in range(30)]
    assert [soak.reference(rounds[:n]).memory for n in (1, 2, 9, 10, 30)] == [0, 1, 1, 9, 9]


def test_a_played_recording_gives_all_its_bytes_and_ends(recording):
    link = soak.Played(recording)
    data = b""
    while not link.ended:
        data += b"".join(chunk.data for chunk in link.receive(0.0))
    assert data == b"".join(frame.raw for _, frame in read_tlog(recording))
