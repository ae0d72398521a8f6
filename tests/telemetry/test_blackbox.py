"""Logs of Betaflight, INAV and Indiflight give the records that a link would have given."""

import math
import operator
import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.files import split_session
from gcs_sysid.fleet.batch import find_logs
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.attitude import to_euler
from gcs_sysid.session.reported_layout import differences, notes, place_words, reported_layout
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.blackbox import flight_sessions, read_blackbox
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.logs import open_log
from testbed import blackbox_log as bbl
from testbed.blackbox_log import BlackboxWriter, Field
from testbed.recordings import records_of

SETTINGS = {
    "Firmware type": "Betaflight", "gyro_scale": bbl.float_bits(1.0), "acc_1G": 2048,
    "motorOutput": "48,2047", "minthrottle": 1070, "maxthrottle": 2000, "motor_poles": 12,
    "blackbox_high_resolution": 0, "Log start datetime": "2026-03-05T16:30:49.820+00:00",
}  # fmt: skip
G = 9.80665


def array(name, count):
    names = [name] if count == 1 else [f"{name}[{i}]" for i in range(count)]
    return [Field(name, 1, 0, 0, bbl.PREVIOUS) for name in names]


def log_of(columns, frames=50, settings=SETTINGS, slow=()):
    """A session at 1 kHz; columns: name -> (count, function of the frame number)."""
    fields = [*bbl.CLOCK, *(f for name, (n, _) in columns.items() for f in array(name, n))]
    writer = BlackboxWriter(fields, {"S": bbl.SLOW}, settings, interval=16)
    for loop in range(frames):
        row = [loop, 5_000_000 + 1000 * loop]
        for count, value in columns.values():
            row += list(value(loop)) if count > 1 else [value(loop)]
        (writer.inter if loop % 16 else writer.intra)(row)
        for at, flags in slow:
            if at == loop:
                writer.other("S", [flags, 0, 0, 1, 1])
    return writer


def of(recording, stream):
    (track,) = (track for track in recording.tracks if track.stream is stream)
    return track


@pytest.fixture
def read(tmp_path):
    def read(writer, session=None):
        path = tmp_path / "log.bbl"
        path.write_bytes(writer if isinstance(writer, bytes) else writer.data + bbl.END)
        return read_blackbox(path, session)

    return read


def test_betaflight(read):
    half = round(32767 * math.sin(0.25))
    recording = read(
        log_of(
            {
                "gyroADC": (3, lambda k: (k, 10, -20)),
                "accSmooth": (3, lambda k: (0, 1024, 2048)),
                "imuQuaternion": (3, lambda k: (0, half, 0)),
                "motor": (4, lambda k: (48, 500, 1000, 2047)),
                "eRPM": (4, lambda k: (100, 200, 300, 600)),
                "setpoint": (4, lambda k: (90, 180, -90, 500)),
                "vbatLatest": (1, lambda k: 1650),
            },
            slow=[(5, 1), (30, 0)],
        )
    )
    imu = of(recording, Stream.IMU)
    assert imu.t[:2].tolist() == pytest.approx([5.0, 5.001])
    assert imu.values[7] == pytest.approx(
        [*np.radians([7.0, -10.0, 20.0]), 0.0, -0.5 * G, -G], rel=1e-6
    )
    assert of(recording, Stream.ROTOR_COMMAND).values[0].tolist() == [48, 500, 1000, 2047]
    # 100 x 100 electrical revolutions a minute, six to one of a motor with twelve poles
    assert of(recording, Stream.ROTOR_SPEED).values[0] == pytest.approx(
        [10_000 / 6 * 2 * math.pi / 60 * n for n in (1, 2, 3, 6)]
    )
    # About the left axis it is nose down, which about the right axis is negative.
    angles = to_euler(of(recording, Stream.ATTITUDE).values[3])
    assert angles == pytest.approx([0.0, -0.5, 0.0], abs=1e-4)
    armed = of(recording, Stream.ARMED)
    assert armed.values[:, 0].tolist() == [1.0, 0.0]
    assert armed.t.tolist() == pytest.approx([5.005, 5.030])
    assert of(recording, Stream.RATE_SETPOINT).values[0] == pytest.approx(
        np.radians([90.0, -180.0, 90.0])
    )
    assert recording.extras["battery voltage"][1][0] == pytest.approx([16.5])
    told = {name: value for _, name, value in recording.parameters}
    assert (told["motorOutput[1]"], told["motor_poles"]) == (2047, 12)
    assert recording.counts["I frames"] == 4


@pytest.mark.parametrize(
    ("battery", "volts"),
    [({"vbatref": 166, "vbatscale": 110}, 16.5), ({"vbatref": 1840, "vbatscale": 110}, 1.4626)],
)
def test_high_resolution_counts_in_tenths_and_old_voltages_in_their_units(read, battery, volts):
    settings = SETTINGS | {"blackbox_high_resolution": 1} | battery
    fields = {"gyroADC": (3, lambda k: (k, 0, 0)), "vbatLatest": (1, lambda k: 165)}
    recording = read(log_of(fields, settings=settings))
    assert recording.extras["battery voltage"][1][0] == pytest.approx([volts], rel=1e-4)
    assert of(recording, Stream.IMU).values[10, 0] == pytest.approx(math.radians(1.0))


@pytest.mark.parametrize(
    ("settings", "unit"),
    [
        ({"gyro_scale": "0x3f800000"}, math.radians(1.0)),
        ({"gyro.scale": "3d79db23"}, math.radians(0.061)),  # 1/16.4 deg/s, Cleanflight
        ({"gyro.scale": "0x3092aa51", "Firmware type": "Baseflight"}, 1.0671e-3),  # rad/us
        ({"gyro_scale": "rubbish"}, math.radians(1.0)),
    ],
)
def test_scales_of_the_gyro(read, settings, unit):
    recording = read(log_of({"gyroADC": (3, lambda k: (k, 0, 0))}, settings=settings))
    assert of(recording, Stream.IMU).values[1, 0] == pytest.approx(unit, rel=2e-3)


@pytest.mark.parametrize("lacks", ["gyro_scale", "acc_1G"])
def test_a_line_of_the_header_that_lacks_is_named(read, lacks):
    fields = {"gyroADC": (3, lambda k: (k, 0, 0)), "accSmooth": (3, lambda k: (0, 0, 2048))}
    assert read(log_of(fields)).problems == ()
    settings = {name: value for name, value in SETTINGS.items() if name != lacks}
    (problem,) = read(log_of(fields, settings=settings)).problems
    assert f"has no {lacks}" in problem


def test_a_gyro_without_accelerometer_is_of_use(read):
    recording = read(log_of({"gyroADC": (3, lambda k: (1, 2, 3))}, settings={}))
    imu = of(recording, Stream.IMU).values
    assert np.isfinite(imu[:, :3]).all()
    assert np.isnan(imu[:, 3:]).all()


def test_inav(read):
    recording = read(
        log_of(
            {
                "gyroADC": (3, lambda k: (0, 0, 0)),
                "attitude": (3, lambda k: (100, -200, 3000)),
                "navPos": (3, lambda k: (100 * (k // 10), -250, 500)),
                "navVel": (3, lambda k: (10 * (k // 10), 20, 30)),
                "motor": (6, lambda k: (1500,) * 6),
            }
        )
    )
    angles = to_euler(of(recording, Stream.ATTITUDE).values[0])
    assert np.degrees(angles) == pytest.approx([10.0, 20.0, -60.0])
    velocity = of(recording, Stream.VELOCITY)
    assert velocity.t.tolist() == pytest.approx([5.010, 5.020, 5.030, 5.040])
    assert velocity.values[0] == pytest.approx([0.1, 0.2, -0.3, 1.0, -2.5, -5.0])
    assert recording.vehicle_type == mavlink.MAV_TYPE_HEXAROTOR


def test_indiflight(read):
    recording = read(
        log_of(
            {
                "gyroADC": (3, lambda k: (9, 9, 9)),
                "gyroADCafterRpm": (3, lambda k: (10, 20, 30)),
                "accSmooth": (3, lambda k: (9, 9, 9)),
                "accUnfiltered": (3, lambda k: (0, 0, 2048)),
                "quat": (4, lambda k: (8127, 0, 0, 0)),
                "omegaUnfiltered": (8, lambda k: (500, 600, 700, 800, 0, 0, 0, 0)),
                "motor": (4, lambda k: (158,) * 4),
                "extPos": (3, lambda k: (1000 + k // 25, 2000, -3000)),
                "extVel": (3, lambda k: (100 + k // 25, 0, -50)),
                "vel": (3, lambda k: (9, 9, 9)),
                "pos": (3, lambda k: (k, 9, 9)),
                "gyroSp": (3, lambda k: (90, 0, 0)),
            },
            frames=80,
        )
    )
    assert of(recording, Stream.IMU).values[0] == pytest.approx(
        [*np.radians([10.0, -20.0, -30.0]), 0.0, 0.0, -G]
    )
    assert of(recording, Stream.ROTOR_SPEED).values[0].tolist() == [500, 600, 700, 800]
    assert of(recording, Stream.ATTITUDE).values[0].tolist() == [1, 0, 0, 0]
    velocity = of(recording, Stream.VELOCITY)
    assert len(velocity.t) == 3  # when motion capture told something new
    assert velocity.values[0] == pytest.approx([1.01, 0.0, -0.5, 1.001, 2.0, -3.0])
    asked = of(recording, Stream.RATE_SETPOINT)
    assert asked.values[0] == pytest.approx([math.pi / 2, 0.0, 0.0])


def test_a_motor_stop_disarms(read):
    writer = log_of({"gyroADC": (3, lambda k: (0, 0, 0))})
    writer.event(15, b"\4")
    writer.intra([64, 5_064_000, 0, 0, 0])
    armed = of(read(writer), Stream.ARMED)
    assert armed.values[:, 0].tolist() == [1.0, 0.0]
    assert armed.t[1] == pytest.approx(5.049)


@pytest.mark.parametrize("yaw", [1, -1])
def test_the_mixer_is_what_the_pid_sums_do_to_the_motors(read, yaw):
    """Whatever crashes and limits do beside it; props-out where yaw is reversed."""
    rng = random.Random(1)
    wanted = [[round(rng.gauss(0, 60)) for _ in range(3)] for _ in range(1500)]
    mixer = ((-1, 1, yaw), (-1, -1, -yaw), (1, 1, -yaw), (1, -1, yaw))

    def motors(k):
        if k % 10 == 0:
            return (48, 2047, 48, 2047)
        free = [800 + 2 * sum(map(operator.mul, row, wanted[k])) for row in mixer]
        return [min(max(round(m), 48), 2047) for m in free]

    columns = {
        "axisP": (3, lambda k: [one // 2 for one in wanted[k]]),
        "axisI": (3, lambda k: [one - one // 2 for one in wanted[k]]),
        "gyroADC": (3, lambda k: (k % 7, 0, 0)),
        "motor": (4, motors),
    }
    told = {name: value for _, name, value in read(log_of(columns, 1500)).parameters}
    layout = reported_layout("generic", told)
    places = ["rear right", "front right", "rear left", "front left"]
    assert [place_words(rotor) for rotor in layout.rotors] == places
    usual = load_airframe("betaflight-quad-x")
    assert [r.spin for r in layout.rotors] == [yaw * r.spin for r in usual.rotors]
    assert differences(usual, layout) == ()
    assert ["props-out" in note for note in notes(usual, layout)] == [True] * (yaw < 0)
    swapped = replace(usual, rotors=usual.rotors[::-1])
    assert differences(swapped, layout)
    columns["motor"] = 4, lambda k: [rng.randrange(200, 1800) for _ in range(4)]
    told = {name: value for _, name, value in read(log_of(columns, 1500)).parameters}
    assert reported_layout("generic", told) is None


@pytest.fixture
def sessions(tmp_path):
    """Three sessions with junk between them: two flights, and one that was never begun."""
    first, second = (log_of({"gyroADC": (3, lambda k, i=i: (i, 0, 0))}, frames=900) for i in (1, 2))
    junk = random.Random(1).randbytes(300)
    path = tmp_path / "three.bbl"
    path.write_bytes(first.data + bbl.END + junk + second.data + junk + first.header())
    return path


def test_sessions(sessions):
    for number, expected in ((None, 1.0), (1, 1.0), (2, 2.0)):
        imu = of(read_blackbox(sessions, number), Stream.IMU)
        assert np.degrees(imu.values[:, 0]) == pytest.approx(expected)
        assert len(imu.t) == pytest.approx(900, abs=2)
    assert flight_sessions(sessions) == [1, 2]
    with pytest.raises(InputError, match=r"session 3 of .*holds no flight data.*three\.bbl#2"):
        read_blackbox(sessions, 3)
    with pytest.raises(InputError, match=r"no session 4; it holds three\.bbl#1 .*2026-03-05 16:30"):
        read_blackbox(sessions, 4)


def test_a_session_is_named_behind_the_file(sessions):
    path = Path(f"{sessions}#2")
    log = open_log(path)
    assert log.kind == "blackbox"
    assert str(log.vehicle) == "generic vehicle 1:1"
    assert next(r for r in records_of(log) if r.stream is Stream.IMU).values[0] == pytest.approx(
        math.radians(2.0)
    )
    assert split_session(path) == (sessions, 2)
    path.write_bytes(sessions.read_bytes())  # a file may be called so
    assert split_session(path) == (path, None)
    assert split_session(Path("a#b")) == (Path("a#b"), None)


def test_batch_takes_each_session(sessions):
    expected = [Path(f"{sessions}#1"), Path(f"{sessions}#2")]
    assert find_logs([sessions.parent]) == find_logs([sessions]) == expected
    assert find_logs([expected[1]]) == [expected[1]]


def test_of_several_sessions_the_longest_is_read_and_said(tmp_path):
    writer = log_of({"gyroADC": (3, lambda k: (0, 0, 0))}, frames=900)
    path = tmp_path / "log.txt"
    path.write_bytes(writer.header() + writer.data)
    assert open_log(path).problems == ("it holds 2 sessions: the longest, log.txt#2, is read",)
    assert open_log(Path(f"{path}#2")).problems == ()
    with pytest.raises(InputError, match=r"session 1 of .*it holds log\.txt#1 .*log\.txt#2"):
        open_log(Path(f"{path}#1"))
    assert find_logs([tmp_path]) == [tmp_path / "log.txt#2"]


def test_only_blackbox_logs_have_sessions(tmp_path, sender):
    path = tmp_path / "a.tlog"
    path.write_bytes(b"\0" * 8 + sender.heartbeat().raw)
    with pytest.raises(InputError, match="only blackbox logs hold sessions"):
        open_log(Path(f"{path}#1"))


def test_told_by_content(tmp_path):
    writer = log_of({"gyroADC": (3, lambda k: (0, 0, 0))})
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"\xff\0" * 100 + writer.data)  # the end of a log that was overwritten
    log = open_log(path)
    assert log.kind == "blackbox"
    assert sum(1 for record in records_of(log) if record.stream is Stream.IMU) == 50
    assert log.as_dict()["damaged"] is False


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (bbl.MAGIC, "does not describe the frames"),
        (log_of({"gyroADC": (3, lambda k: (0, 0, 0))}).header(), "no flight data"),
        (log_of({"gyroADC": (3, lambda k: (0, 0, 0))}).data[:120], "does not describe"),
        (b"", "no session 1; it holds none"),
    ],
)
def test_what_is_no_log_is_refused_in_one_line(read, data, said):
    with pytest.raises(InputError, match=said) as error:
        read(data)
    assert "\n" not in str(error.value)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["LOG00259", pytest.param("LOG00340", marks=pytest.mark.thorough)])
def test_real_logs_give_what_their_tlogs_give(shared_logs, name):
    """There speeds were rounded to 1 rpm, and the first samples come before the heartbeat."""
    most = {Stream.IMU: 1e-5, Stream.ROTOR_SPEED: 0.06, Stream.VELOCITY: 1e-5}
    for stream, expected in most.items():
        ours, theirs = (
            np.array([r.values for r in records_of(open_log(path)) if r.stream is stream])
            for path in (shared_logs / "real" / f"{name}{suffix}" for suffix in (".BFL", ".tlog"))
        )
        assert len(ours) - 2 <= len(theirs) <= len(ours) + 1
        n = min(len(ours), len(theirs))
        assert np.abs(ours[-n:] - theirs[-n:]).max() < expected
