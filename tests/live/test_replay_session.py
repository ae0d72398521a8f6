"""A replay paced by a clock that the test moves; at the end it has the numbers of the analysis."""

import math

import numpy as np
import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.live.replay_session import Recorded, ReplaySession, survey
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.results.snapshot import LinkState
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import read_frame
from gcs_sysid.telemetry.tlog import TlogReader
from gcs_sysid.telemetry.tlog_writer import TlogWriter
from testbed.recordings import airframe_of

pytestmark = pytest.mark.slow


def write(path, frames):
    """A .tlog of (time in us, frame)."""
    with TlogWriter(path) as writer:
        for time_us, frame in frames:
            writer.write(time_us, [frame])


class Stage:
    """A replay without its thread, and a clock that moves only as far as the replay waits."""

    def __init__(self, path, airframe=None, speed=1.0, **options):
        self.now = 100.0
        airframe = airframe or load_airframe("paper")
        recorded = path if isinstance(path, Recorded) else survey(path, airframe)
        self.session = ReplaySession(recorded, speed, 2.0, clock=lambda: self.now, **options)
        self.published = []

    @property
    def snapshot(self):
        return self.session.latest()

    @property
    def playback(self):
        return self.snapshot.playback

    def step(self):
        wait = self.session.step()
        if not self.published or self.published[-1] is not self.snapshot:
            self.published.append(self.snapshot)
        return wait

    def play(self, seconds):
        """Let so much time go by."""
        until = self.now + seconds
        while self.now < until:
            self.now += min(self.step(), until - self.now)
        self.step()

    def settle(self):
        """Until nothing is due at this instant."""
        while self.step() == 0.0:
            pass
        self.now += 0.25
        self.step()

    def run_to_end(self):
        self.session.change_speed(2)
        while not (self.snapshot and self.playback.ended):
            self.step()
            self.now += 0.01


@pytest.fixture(scope="module")
def flight(fly):
    """All axes at 50 Hz for 18 s, with ground before and after."""
    return fly("--mission", "all-axes", "--rate", "50", "--duration", "18", "--seed", "5")


@pytest.fixture(scope="module")
def recorded(flight):
    return survey(flight.tlog, load_airframe("paper"))


@pytest.fixture(scope="module")
def analyzed(flight):
    return analyze_log(flight.tlog, load_airframe("paper"))


def near(result, expected, share=1e-6):
    """The same but for rounding."""
    assert result.verdict == expected.verdict
    assert len(result.segments) == len(expected.segments)
    for name, estimate in expected.parameters.items():
        found = result.parameters[name]
        assert found.status == estimate.status, name
        if estimate.value is not None:
            assert abs(found.value - estimate.value) <= share * (estimate.std or 0.0), name


def own(stage):
    """What the replay's own chain says, where its snapshots show the analysis."""
    return stage.session._playback.chain.result()


MORE_LOGS = [
    *("px4-sih-default.tlog", "px4-sih-default.ulg", "px4-esc-cg.tlog", "ardupilot-sitl.tlog"),
    *("ardupilot-sitl.bin", "public/real-quad-mavlink1.tlog", "public/real-quad-copter33.bin"),
]
LOGS = [
    "public/px4-sitl.ulg",
    *(pytest.param(name, marks=pytest.mark.thorough) for name in MORE_LOGS),
]


@pytest.mark.parametrize("log", LOGS)
def test_at_full_speed_it_ends_with_exactly_the_numbers_of_the_analysis(shared_logs, log):
    path = shared_logs / log
    airframe = airframe_of(path) if "public" not in log else load_airframe("ardupilot-quad-x")
    airframe = airframe.with_anchor("mass", 1.5)
    stage = Stage(path, airframe, math.inf)
    while not (stage.snapshot and stage.playback.ended):
        stage.step()
    result = analyze_log(path, airframe)
    assert stage.snapshot.result.dumps() == result.dumps()
    near(own(stage), result)
    assert stage.playback.position == pytest.approx(stage.playback.duration, abs=0.01)


def test_the_thread_ends_with_the_numbers_of_the_analysis(recorded, analyzed):
    told = []
    session = ReplaySession(recorded, math.inf, 2.0, stay=False, on_result=told.append)
    session.start()
    assert session.join(60.0)
    assert session.problem is None
    assert session.final.dumps() == analyzed.dumps()
    assert session.latest().result is session.final
    assert session.latest().link.state is LinkState.ENDED
    # A result a second of the flight, however fast the log is read.
    assert recorded.duration - 3.0 < len(told) <= recorded.duration


def same_course(stage, other):
    """Up to where the shorter one ends: they may stand a part of the log from each other."""
    a, b = stage.snapshot.history, other.snapshot.history
    n = min(len(a.t), len(b.t))
    assert n > 6
    assert abs(len(a.t) - len(b.t)) <= 1
    assert a.t[:n] == pytest.approx(b.t[:n], abs=1e-9)
    for name in ("Ixx", "k_T"):
        assert a.value[name][:n] == pytest.approx(b.value[name][:n], rel=1e-6, nan_ok=True)


def test_it_keeps_the_pace_of_the_vehicles_clock_and_ends_with_the_analysis(recorded, analyzed):
    """Pauses take nothing of it, and a seek goes there by all that lies between."""
    stage = Stage(recorded)
    stage.play(5.0)
    assert stage.session.toggle_pause() == "Replay paused."
    stage.play(100.0)
    assert stage.playback.paused
    assert stage.playback.position <= 5.0
    assert stage.session.toggle_pause() == "Replay resumed."
    stage.play(5.0)
    assert not stage.playback.paused
    assert 9.7 < stage.playback.position <= 10.0
    assert stage.snapshot.t == pytest.approx(stage.playback.position, abs=0.4)
    stage.session.change_speed(1)
    stage.play(0.7)
    assert 15.0 < stage.playback.position <= 17.0  # pictures are 2 s apart
    positions = [snapshot.playback.position for snapshot in stage.published if snapshot]
    assert positions == sorted(positions)
    # Five pictures a second, no more.
    assert 40 <= len(set(positions)) <= 62
    assert stage.snapshot.link.state is LinkState.REPLAY

    other = Stage(recorded)
    assert other.session.seek(15.0) == f"To 15 s of {other.session._duration:.0f} s."
    other.settle()
    assert 14.5 < other.playback.position <= 15.2
    same_course(stage, other)
    assert other.playback.seeking is None
    assert np.isfinite(other.snapshot.acceleration.predicted).all()
    other.play(1.0)
    assert 15.5 < other.playback.position <= 16.2

    stage.play(2.0)
    assert stage.playback.ended
    assert stage.snapshot.result.dumps() == analyzed.dumps()
    near(own(stage), analyzed)
    goes_back_to_what_was_kept(stage.session._playback)


def goes_back_to_what_was_kept(playback):
    kept = [state.position for state in playback._checkpoints]
    assert kept
    assert all(b - a >= 10.0 for a, b in zip([0.0, *kept], kept, strict=False))
    playback.go_back(kept[-1] + 2.0)
    assert playback.log_segments.position == pytest.approx(kept[-1])
    assert playback.chain.t == pytest.approx(kept[-1], abs=0.4)
    playback.go_back(kept[0] - 1.0)
    assert playback.log_segments.position == playback.chain.t == 0.0


@pytest.mark.thorough
def test_a_seek_back_forgets_what_came_later(recorded, analyzed):
    stage, other = Stage(recorded), Stage(recorded)
    stage.run_to_end()
    stage.session.change_speed(-2)
    stage.session.toggle_pause()  # from the beginning
    stage.settle()
    assert stage.playback.position < 0.5
    assert not stage.playback.ended
    stage.session.seek(16.0)
    stage.settle()
    other.session.seek(16.0)
    other.settle()
    same_course(stage, other)
    assert stage.snapshot.used_seconds == pytest.approx(other.snapshot.used_seconds)
    assert [e.text for e in stage.snapshot.events] == [e.text for e in other.snapshot.events]
    stage.run_to_end()
    assert stage.snapshot.result.dumps() == analyzed.dumps()
    near(own(stage), analyzed)


@pytest.mark.thorough
def test_steps_follow_each_other_before_the_first_has_arrived(recorded):
    stage = Stage(recorded)
    stage.session.toggle_pause()
    for _ in range(3):
        stage.session.skip(5.0)
    stage.settle()
    assert 14.5 < stage.playback.position <= 15.2
    assert stage.playback.paused
    stage.session.skip(-5.0)
    stage.settle()
    assert 9.5 < stage.playback.position <= 10.2
    stage.session.skip(-100.0)
    stage.settle()
    assert stage.playback.position < 0.5
    stage.session.skip(1e4)
    stage.settle()
    assert stage.playback.ended


@pytest.mark.thorough
def test_it_goes_on_over_a_reboot(fly):
    flight = fly(
        *("--mission", "all-axes", "--rate", "50", "--duration", "20", "--seed", "5"),
        *("--trap", "reboot=8"),
    )
    stage = Stage(flight.tlog)
    stage.play(13.0)
    assert 12.0 < stage.playback.position <= 13.0
    assert any(
        "reboot" in event["text"] for event in stage.snapshot.result.events if "text" in event
    )
    stage.run_to_end()
    near(own(stage), analyze_log(flight.tlog, load_airframe("paper")))


def test_a_long_silence_is_skipped(flight, tmp_path):
    """The frames of 6 s are missing; who watches is not kept waiting."""
    path = tmp_path / "silent.tlog"
    frames = list(TlogReader(flight.tlog))
    times = [1e-6 * (time_us - frames[0][0]) for time_us, _ in frames]
    write(path, [f for f, t in zip(frames, times, strict=True) if t < 1.0 or 7.0 < t < 9.0])
    stage = Stage(path)
    stage.play(2.0)
    assert stage.playback.position > 7.0
    assert any("skipped" in event.text for event in stage.snapshot.events)


def test_what_is_no_log_is_refused(tmp_path):
    path = tmp_path / "none.tlog"
    path.write_text("not a log")
    with pytest.raises(InputError, match=r"not a \.tlog"):
        survey(path, load_airframe("paper"))


def test_one_that_is_left_has_the_numbers_up_to_there(recorded, analyzed):
    session = ReplaySession(recorded)
    session.start()
    session.seek(20.0)
    session.stop()
    assert session.problem is None
    assert session.final.dumps() != analyzed.dumps()
    session.stop()


@pytest.mark.thorough
def test_parameters_that_came_late_hold_from_the_start(fly, tmp_path):
    """Fetched after the flight, as many ground stations do: the analysis goes over it again."""
    flight = fly(
        *("--mission", "all-axes", "--rate", "20", "--duration", "12", "--seed", "5"),
        *("--autopilot", "ardupilot"),
    )
    frames = list(TlogReader(flight.tlog))
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    answer = mavlink.MAVLink_param_value_message(b"INS_GYRO_FILTER", 40.0, 9, 1, 0).pack(sender)
    path = tmp_path / "late.tlog"
    write(path, [*frames, (frames[-1][0], read_frame(answer))])
    result = analyze_log(path, load_airframe("paper"))
    stage = Stage(path)
    stage.play(6.0)
    assert stage.session._playback.chain.gyro_cutoff == 40.0
    stage.run_to_end()
    assert stage.snapshot.result.dumps() == result.dumps()
    near(own(stage), result)
