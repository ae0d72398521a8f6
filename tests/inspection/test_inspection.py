"""What an inspection finds: facts of streams, flights, clocks and rotors, and what they mean."""

import functools
import json
import math

import numpy as np
import pytest

from gcs_sysid.cli.inspect_command import report
from gcs_sysid.inspection.inspector import Inspector, inspect_link, inspect_log
from gcs_sysid.inspection.stream_watch import CHUNK, MotionWatch, StreamWatch, assumed_airframe
from gcs_sysid.judgement.status import level_of
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.link import Link, ReceivedBytes
from gcs_sysid.telemetry.tlog import TlogReader
from gcs_sysid.telemetry.urls import parse_url
from gcs_sysid.telemetry.vehicles import MavlinkSystem
from testbed.recordings import block_of

FLIGHT = ("--mission", "all-axes", "--rate", "100", "--duration", "12", "--seed", "3")


@pytest.fixture(scope="module")
def recording(fly):
    """Flies the emulator with some options, once with each; the recording's path."""
    return functools.cache(lambda *options: fly(*FLIGHT, *options).tlog)


@pytest.fixture(scope="module")
def inspect(recording):
    """Inspects such a recording."""
    return lambda *options: inspect_log(recording(*options))


def texts(found, *levels):
    return " | ".join(o.reason for o in found.objections if not levels or level_of(o) in levels)


def watched(t, values=None):
    """A watch that has seen samples in flight."""
    watch = StreamWatch()
    watch.begin(flying=True, boot=0)
    t = np.array(t)
    values = np.arange(float(len(t)))[:, None] if values is None else np.array(values)
    while len(t):
        taken = watch.add(t, values)
        t, values = t[taken:], values[taken:]
        if watch.full:
            watch.cut_chunk()
    watch.cut_chunk()
    return watch


# Streams.


@pytest.mark.parametrize("count", [300, CHUNK + 10])
def test_a_regular_stream_has_a_rate_and_nothing_else(count):
    tally = watched(np.arange(count) * 0.004).flight
    assert tally.rate == pytest.approx(250.0)
    counts = tally.counts
    assert (counts.received, counts.gaps, counts.missing, tally.repeats) == (count, 0, 0, 0)


def test_skipped_samples_are_missing_and_a_pause_is_a_gap():
    t = np.arange(1000) * 0.004
    t[500:] += 0.3
    t = np.delete(t, [100, 101, 700])
    tally = watched(t).flight
    counts = tally.counts
    assert (counts.missing, counts.gaps) == (3 + 75, 1)
    assert counts.longest_gap == counts.latest_gaps[0][1] == pytest.approx(0.304)
    # The rate counts what came, and not the pause.
    assert tally.rate == pytest.approx(250.0 * 997 / 1000, rel=1e-3)


def test_repeats_under_fresh_stamps_are_counted_also_from_chunk_to_chunk():
    count = CHUNK + 101
    values = [(float(i // 2), 7.0) for i in range(count)]
    tally = watched(np.arange(count) * 0.004, values).flight
    assert tally.repeats == count // 2
    assert tally.repeats_percent == pytest.approx(50.0, abs=0.1)


# Motion.


def test_motion_is_found_under_noise_larger_than_itself():
    rng = np.random.default_rng(1)
    t = np.arange(60 * 250) * 0.004
    amplitude, w = 0.4, 2.0 * math.pi * 0.8
    gyro = amplitude * np.sin(w * t)[:, None] * [1.0, 0.5, 0.0] + [0.3, 0.0, -0.2]
    gyro += rng.normal(0.0, 0.3, gyro.shape)
    watch = MotionWatch()
    for start in range(0, len(t), 1000):
        rows = slice(start, start + 1000)
        watch.add_rates(t[rows], gyro[rows])
    roll, pitch, yaw = watch.motion()
    rms = amplitude / math.sqrt(2.0)
    assert roll.rate_rms == pytest.approx(rms, rel=0.03)
    assert roll.acceleration_rms == pytest.approx(rms * w, rel=0.05)
    assert pitch.acceleration_rms == pytest.approx(0.5 * rms * w, rel=0.1)
    # Without the split of even and odd samples this would be 0.85 rad/s^2.
    assert yaw.acceleration_rms < 0.25
    assert yaw.rate_rms < 0.05


# Rotor input: what the chain decides.

DECISIONS = {
    "sound": (),
    "all zero": ("--trap", "rpm-zero"),
    "one dead": ("--trap", "rpm-dead=2"),
    "commands sold as speeds": ("--trap", "rpm-command"),
    "rad/s": ("--trap", "rpm-rad"),
    "few readings": ("--trap", "rpm-repeats=0.95"),
    "commands alone": ("--rotor-input", "command"),
    "ArduPilot": ("--autopilot", "ardupilot"),
}
HERE_ALONE = "commands alone"
"""As far as the analysis is concerned, other tests show the others too."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        pytest.param(options, id=name, marks=[pytest.mark.thorough] * (name != HERE_ALONE))
        for name, options in DECISIONS.items()
    ],
)
def test_inspect_and_analyze_use_the_same_rotor_input(recording, options):
    path = recording(*options)
    airframe = load_airframe("paper")
    analyzed = analyze_log(path, airframe).telemetry["rotor_input"]
    found = inspect_log(path, airframe=airframe).rotor_input
    assert found.judged
    assert found.chosen.message == analyzed["source"]
    assert (list(found.range) if found.range else None) == analyzed.get("range")
    for name, why in analyzed["refused"].items():
        assert f"{name} {why}" in found.reasons


@pytest.mark.slow
def test_without_an_airframe_the_vehicles_type_tells_how_many_rotors(fly):
    flight = (*FLIGHT, "--autopilot", "ardupilot", "--airframe", "ardupilot-hexa-x")
    path = fly(*flight).tlog
    found = inspect_log(path)
    assert (found.rotors, found.rotors_assumed) == (6, False)
    assert len(found.rotor_input.chosen.rotors) == 6
    eight = inspect_log(path, airframe=assumed_airframe(8))
    assert eight.rotor_input.chosen is None
    assert any("lacks rotor 7 of 8" in reason for reason in eight.rotor_input.reasons)


def flown(*speeds, vehicle_type, source="ESC_STATUS", parameters=()):
    """Inspects 12 s of flight with these rotor speeds, varied a little."""
    intake = Intake()
    intake.selector.chosen = MavlinkSystem(1, 1, vehicle_type, 12)
    intake.parameters.update(parameters)
    inspector = Inspector(intake)
    records = []
    stream = Stream.ROTOR_SPEED if source == "ESC_STATUS" else Stream.ROTOR_COMMAND
    for i in range(1200):
        t = 1.0 + 0.01 * i
        if i % 50 == 0:
            records.append(Record(Stream.IN_AIR, t, (1.0,)))
        records.append(Record(Stream.IMU, t, (0.001 * math.sin(i),) + (0.0,) * 4 + (-9.8,)))
        values = tuple(v + v / 50.0 * math.sin(i * (k + 1)) for k, v in enumerate(speeds))
        records.append(Record(stream, t, values, 0, source))
    inspector.add_records(block_of(records))
    return inspector.finish("made", "tlog")


def test_a_type_that_tells_no_number_is_said():
    found = flown(500.0, 500.0, 500.0, 500.0, vehicle_type=0)
    assert (found.rotors, found.rotors_assumed) == (4, True)
    assert found.rotor_input.chosen.message == "ESC_STATUS"
    assert "does not define the number of rotors: 4 assumed" in texts(found, "note")


def test_a_dead_rotor_is_refused_as_by_analyze():
    found = flown(500.0, 500.0, 0.0, 500.0, vehicle_type=2)
    assert not found.rotors_assumed
    assert found.rotor_input.chosen is None
    assert "rotor 3 reads 0 while the others move" in texts(found, "blocks")


def test_a_motor_whose_output_is_not_sent_is_not_said_to_read_nothing():
    """As of MAVLink 1, which has eight outputs."""
    outputs = {f"PWM_MAIN_FUNC{output}": 101.0 + i for i, output in enumerate((1, 2, 3, 9))}
    found = flown(*[500.0] * 8, vehicle_type=2, source="SERVO_OUTPUT_RAW", parameters=outputs)
    row = next(line for line in report(found, 80).splitlines() if line.startswith("  4 "))
    assert row.split() == ["4", "-", "-", "-", "not", "sent"]


# Whole recordings of the emulator.


@pytest.mark.slow
def test_a_sound_flight(inspect):
    found = inspect("--duration", "16")
    assert found.verdict == "yes"
    assert found.objections == ()
    assert found.kind == "tlog"
    assert found.flight_told_by == "autopilot"
    assert found.in_air == pytest.approx(16.0, abs=0.1)
    assert found.stream(Stream.IMU).rate == pytest.approx(100.0)
    assert found.rotor_input.chosen.message == "ESC_STATUS"
    assert len(found.rotor_input.chosen.rotors) == 4
    assert found.motion["roll"].acceleration_rms > 3.0
    json.dumps(found.as_json(), allow_nan=False)


TRAPS = {
    "skips=0.2": "missing by their timestamps",
    "forwarded": "other vehicles on the link: PX4 quadrotor 2:1",
    "never-sent=HIGHRES_IMU": "no IMU data",
}


@pytest.mark.slow
@pytest.mark.parametrize(("trap", "told"), TRAPS.items(), ids=TRAPS.keys())
def test_traps_are_told(inspect, trap, told):
    assert told in texts(inspect("--trap", trap))


@pytest.mark.slow
@pytest.mark.parametrize(("trap", "wraps"), [("wrap-us=8", 1), ("disorder", 0)])
def test_wraps_of_short_stamps_are_counted_and_leave_no_gap(inspect, trap, wraps):
    found = inspect("--trap", trap)
    assert found.clock.wraps == wraps
    assert found.clock.reboots == 0
    assert all(stream.gaps == 0 for stream in found.streams)


@pytest.mark.slow
def test_a_reboot_parts_the_flights_and_time_goes_on(inspect):
    found = inspect("--trap", "reboot=8")
    assert found.clock.reboots == 1
    assert "restarted" in texts(found)
    (_, first_end), (second_start, second_end) = found.flights
    assert first_end == pytest.approx(8.0, abs=0.5)
    assert first_end <= second_start < second_end <= found.duration + 1e-9
    assert found.stream(Stream.IMU).gaps == 0


def test_several_flights_and_the_ground_between():
    inspector = Inspector(Intake())
    records = []
    for i in range(6000):
        t = 0.01 * i
        if i % 50 == 0:
            records.append(Record(Stream.IN_AIR, t, (float(500 <= i % 3000 < 2500),)))
        if not 3000 <= i < 3300:  # a gap on the ground is none in flight
            records.append(Record(Stream.IMU, t, (0.0,) * 5 + (-9.8,)))
    inspector.add_records(block_of(records))
    found = inspector.finish("made", "tlog")
    assert found.flights == (
        pytest.approx((5.0, 25.0), abs=0.02),
        pytest.approx((35.0, 55.0), abs=0.02),
    )
    assert found.stream(Stream.IMU).gaps == 0
    assert found.stream(Stream.IMU).samples == pytest.approx(3800, abs=3)


@pytest.mark.slow
def test_hover_is_named_axis_by_axis(fly):
    found = inspect_log(fly("--mission", "hover", "--rate", "100", "--duration", "12").tlog)
    assert found.verdict == "partly"
    assert "too little roll, pitch and yaw motion to identify Ixx, Iyy, Izz" in texts(
        found, "limits"
    )


@pytest.mark.slow
def test_commands_alone_will_do_but_not_slow_ones(fly):
    flight = ("--mission", "all-axes", "--duration", "16", "--rotor-input", "command")
    found = inspect_log(fly(*flight, "--rate", "100").tlog)
    assert found.verdict == "yes"
    assert "commands: no usable measured speeds" in texts(found, "note")
    slow = inspect_log(fly(*flight, "--rate", "50").tlog)
    assert slow.verdict == "partly"
    assert "commands at 50 Hz leave out" in texts(slow, "limits")


@pytest.mark.slow
def test_a_narrow_link_is_refused_with_what_to_do(fly):
    found = inspect_log(fly("--mission", "all-axes", "--rate", "4", "--duration", "12").tlog)
    assert found.verdict == "no"
    assert "HIGHRES_IMU comes at 4.0 Hz" in texts(found, "blocks")
    assert any("faster" in o.how or "fast link" in o.how for o in found.objections)


# Flight without a word of the autopilot.


def armed_and_turning(start=0.0):
    """Records of 40 s, of which 25 s are flown; some of the speeds are of three rotors alone."""
    records = []
    for i in range(4000):
        t = start + 0.01 * i
        if i % 100 == 0:
            records.append(Record(Stream.ARMED, t, (float(500 <= i < 3000),)))
        records.append(Record(Stream.IMU, t, (0.1 * math.sin(i), 0.0, 0.0, 0.0, 0.0, -9.8)))
        speed = 500.0 + i % 7 if 500 <= i < 3000 else 0.0
        speeds = (speed,) * (4 - (i % 5 == 4))
        records.append(Record(Stream.ROTOR_SPEED, t, speeds, 0, "ESC_STATUS"))
    return records


def test_how_records_are_cut_into_blocks_changes_nothing():
    records = [*armed_and_turning(), *armed_and_turning(2.0)]

    def found(step):
        inspector = Inspector(Intake())
        for first in range(0, len(records), step):
            inspector.add_records(block_of(records[first : first + step]))
        return inspector.finish("made", "tlog")

    whole = found(len(records))
    assert whole.clock.reboots == 1
    assert whole.flights
    assert found(113) == whole


def test_an_imu_that_misreads_is_named_as_by_analyze():
    """The gyro reads half of what the attitude turns, and its roll axis stands at a limit."""
    intake = Intake()
    intake.selector.chosen = MavlinkSystem(1, 1, 2, 12)
    inspector = Inspector(intake)
    records = []
    for i in range(6000):
        t = 0.01 * i
        angle, rate = 0.4 * math.sin(3.0 * t), 1.2 * math.cos(3.0 * t)
        records.append(Record(Stream.IN_AIR, t, (1.0,)))
        records.append(Record(Stream.ATTITUDE, t, (math.cos(angle / 2), math.sin(angle / 2), 0, 0)))
        gyro = (0.5 * rate, 0.0, 0.0)
        records.append(
            Record(Stream.IMU, t, (*gyro, 0.0, 0.0, max(-9.8 - 5.0 * math.sin(7 * t), -13)))
        )
    inspector.add_records(block_of(records))
    found = texts(inspector.finish("made", "tlog"), "limits")
    assert "gyro's roll axis reads 0.50 of what the attitude turns" in found
    assert "the accelerometer stands at its limit of 13.0" in found


# Links.


class ScriptedLink(Link):
    """Plays a recording, 50 ms of it with each call; its clock is the recording's."""

    datagrams = True

    def __init__(self, path=None):
        super().__init__(parse_url("udpin:127.0.0.1:14550"))
        self.frames = [] if path is None else [(us * 1e-6, f.raw) for us, f in TlogReader(path)]
        self.now = self.frames[0][0] if self.frames else 0.0
        self.sent = []
        self.closed = False

    def receive(self, timeout):
        self.now += timeout
        due = 0
        while due < len(self.frames) and self.frames[due][0] <= self.now:
            due += 1
        chunks = [ReceivedBytes(raw, ("127.0.0.1", 5)) for _, raw in self.frames[:due]]
        del self.frames[:due]
        return chunks

    def send(self, data):
        self.sent.append(data)

    def close(self):
        self.closed = True


def listen(link, **options):
    return inspect_link(link, 5.0, rate=100.0, clock=lambda: link.now, **options)


def test_a_link_is_listened_to_for_the_time_asked(recording):
    link = ScriptedLink(recording())
    began = link.now
    found = listen(link, listen_only=True)
    assert link.now - began == pytest.approx(5.0, abs=0.2)
    assert link.closed
    assert link.sent == []
    assert found.kind == "link"
    assert found.verdict == "yes"
    assert found.stream(Stream.IMU).samples == pytest.approx(500, abs=10)


@pytest.mark.slow
def test_a_link_on_the_ground_says_what_it_cannot_see(recording):
    link = ScriptedLink(recording("--trap", "ground=8"))
    found = listen(link, listen_only=True)
    assert found.verdict == "no"
    assert "not in the air while listening" in texts(found, "blocks")
    assert not found.rotor_input.judged
    assert "rotor" not in texts(found)


def test_it_ends_early_when_told_to(recording):
    link = ScriptedLink(recording())
    began = link.now
    listen(link, stop=lambda: link.now > began + 1.0)
    assert link.now - began == pytest.approx(1.1, abs=0.1)
    assert link.closed
