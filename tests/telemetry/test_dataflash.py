"""ArduPilot's own logs give the records that a link would have given."""

import math
import random
import tracemalloc

import numpy as np
import pytest

from gcs_sysid import files
from gcs_sysid.errors import InputError
from gcs_sysid.signals.motor_order import MotorOrder
from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.telemetry import dataflash_format
from gcs_sysid.telemetry.dataflash import read_dataflash
from gcs_sysid.telemetry.logs import open_log
from testbed.recordings import columns_of, records_of

RPM = 2.0 * math.pi / 60.0


@pytest.fixture
def flight(dataflash_file):
    """Three seconds of a hexarotor at 100 Hz as firmware 4.x writes it."""
    log = dataflash_file
    log.type("PARM", "QNff", "TimeUS,Name,Value,Default")
    log.type("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.type("ATT", "Qffffff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw")
    log.type("RATE", "Qffffff", "TimeUS,RDes,R,PDes,P,YDes,Y")
    log.type("XKQ", "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4")
    log.type("XKF1", "QBccCffffff", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD")
    log.type("XKF4", "QBb", "TimeUS,C,PI")
    log.type("RCOU", "QHHHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6,C7,C8")
    log.type("ESC", "QBff", "TimeUS,Instance,RPM,RawRPM")
    log.type("RPM", "QBfB", "TimeUS,I,RPM,H")
    log.type("EV", "QB", "TimeUS,Id")
    log.type("MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn")
    log.type("ARM", "QB", "TimeUS,ArmState")
    log.type("DSF", "QI", "TimeUS,Dp")
    start = 5_000_000
    parameters = {"INS_GYRO_FILTER": 20.0, "FRAME_CLASS": 2.0, "MAV_SYSID": 9.0} | {
        # Motors 1 to 6 on channels 8, 2, 3, 4, 5, 6; a camera on 1.
        f"SERVO{channel}_FUNCTION": function
        for channel, function in {8: 33.0, 2: 34.0, 3: 35.0, 4: 36.0, 5: 37.0, 6: 38.0}.items()
    }
    for name, value in parameters.items():
        log.row("PARM", start, name, value, 0.0)
    log.row("XKF4", start, 0, 1)
    for i in range(300):
        t = start + 10_000 * i
        for sensor in (0, 1):
            log.row("IMU", t, sensor, 1.0 + sensor, 2.0, 3.0, 4.0, 5.0, -9.8)
        for esc in range(8):
            # The reading, and the slewed figure of a link.
            log.row("ESC", t, esc, 100.0 * esc, 100.0 * esc + 5.0)
        if i % 10 == 0:
            log.row("ATT", t, 0.0, 10.0, 0.0, -20.0, 0.0, 350.0 + i / 10)
            log.row("RATE", t, 90.0, 1.0, -180.0, 2.0, 9.0, 3.0)
            log.row("RCOU", t, 1500, 1102, 1103, 1104, 1105, 1106, 0, 1101)
            log.row("RPM", t, 0, 600.0, 1)
            log.row("RPM", t, 1, -1.0, 0)
        for core in (0, 1):
            if i % 20 == 0:
                log.row("XKQ", t, core, 1.0, 0.0, 0.0, 0.0)
                log.row("XKF1", t, core, 1000, 2000, 3000, 1.0 + core, 2.0, 3.0, 4.0, 5.0, 6.0)
        if i == 50:
            log.row("EV", t, 28)
        if i == 200:
            log.row("MODE", t, 9, 9, 2)
        if i == 250:
            log.row("EV", t, 18)
        if i == 280:
            log.row("ARM", t, 0)
    log.row("DSF", t, 3)
    return log


def test_the_first_imu_alone_is_taken(path, of):
    records = of(open_log(path), Stream.IMU)
    assert len(records) == 300
    np.testing.assert_allclose(records[0].values, (1.0, 2.0, 3.0, 4.0, 5.0, -9.8), rtol=1e-6)
    assert (records[0].t, records[-1].t) == (5.0, pytest.approx(7.99))


def test_an_imu_that_goes_on_is_read_for_one_that_stands_still(tmp_path, dataflash_file, of):
    dataflash_file.type("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    for i in range(300):
        for sensor in (0, 1):
            turn = float(i if sensor or i < 100 else 99) ** 2  # no change is a mere step
            dataflash_file.row("IMU", 10_000 * i, sensor, turn, 2.0, 3.0, 4.0, 5.0, -9.8)
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash_file.bytes())
    log = open_log(path)
    assert of(log, Stream.IMU)[-1].values[0] == 299.0**2
    assert log.problems == ("IMU 0 stands still in 67 % of its entries: IMU 1 is read",)


def test_setpoints_of_the_rate_loop_are_in_rad_per_s(path, of):
    setpoints = of(open_log(path), Stream.RATE_SETPOINT)
    assert len(setpoints) == 30
    assert setpoints[0].values == pytest.approx((math.pi / 2, -math.pi, math.pi / 20))


def test_rotors_come_in_motor_order_by_the_functions_of_the_channels(path):
    log = open_log(path)
    (block,) = log.blocks()
    order = MotorOrder.of("ardupilot", log.parameters, 6)
    parts = {"RCOU": [0.0] * 6, "ESC": [0.0] * 6}
    for track in order.tracks(block.tracks):
        if track.source in parts:
            stop = track.offset + track.values.shape[1]
            parts[track.source][track.offset : stop] = track.values[0]
    assert parts["RCOU"] == [1101.0, 1102.0, 1103.0, 1104.0, 1105.0, 1106.0]
    # Two ESCs drive no motor.
    expected = np.array([705.0, 105.0, 205.0, 305.0, 405.0, 505.0])
    np.testing.assert_allclose(parts["ESC"], expected * RPM)


def test_rpm_sensors_that_are_not_there_make_no_records(path, of):
    sensors = of(open_log(path), Stream.ROTOR_SPEED, "RPM")
    assert {r.offset for r in sensors} == {0}
    assert sensors[0].values == (pytest.approx(600.0 * RPM),)


def test_attitude_is_that_of_the_angles_and_continuous_through_north(path, of):
    q = np.array([r.values for r in of(open_log(path), Stream.ATTITUDE)])
    assert len(q) == 30  # ATT at 10 Hz, not the quaternions at 5
    assert (np.sum(q[1:] * q[:-1], axis=1) > 0.99).all()
    w, x, y, z = q[0]
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    angles = np.degrees([roll, math.asin(2 * (w * y - z * x)), yaw])
    np.testing.assert_allclose(angles, [10.0, -20.0, -10.0], atol=1e-4)


def test_velocity_is_that_of_the_estimator_in_use(path, of):
    assert of(open_log(path), Stream.VELOCITY)[0].values == (2.0, 2.0, 3.0, 4.0, 5.0, 6.0)


def test_a_log_that_begins_on_arming_was_armed_and_landing_by_itself_is_flight(path, of):
    armed = {r.t: r.values[0] for r in of(open_log(path), Stream.ARMED)}
    assert (armed[5.0], armed[7.8]) == (1.0, 0.0)
    flies = of(open_log(path), Stream.IN_AIR)
    assert [r.t for r in flies if r.values == (1.0,)] == pytest.approx([5.5, 6.0, 7.0])
    assert [r.t for r in flies if r.values == (0.0,)] == pytest.approx([5.0, 7.5])


def test_vehicle_parameters_and_losses_are_told(path):
    log = open_log(path)
    assert str(log.vehicle) == "ArduPilot hexarotor 9:1"
    assert log.parameters["INS_GYRO_FILTER"] == 20.0
    first = records_of(log)[0]
    assert (first.stream, first.t) == (Stream.PARAMETER, 5.0)
    assert log.as_dict()["lost"] == 3
    assert log.as_dict()["messages"]["IMU"]["count"] == 600


@pytest.mark.parametrize(
    ("message", "parameters", "kind"),
    [
        ("ArduPlane V4.5.1 (abc)", {}, "fixed wing"),
        ("ArduPlane V4.5.1 (abc)", {"Q_ENABLE": 1.0, "Q_FRAME_CLASS": 2.0}, "hexarotor"),
        ("ArduRover V4.2.0", {"FRAME_CLASS": 1.0}, "ground rover"),
        ("ArduSub V4.1.0", {}, "submarine"),
        ("ArduCopter V4.5.1", {"FRAME_CLASS": 6.0}, "helicopter"),
    ],
)
def test_firmware_and_frame_name_the_vehicle(tmp_path, dataflash_file, message, parameters, kind):
    log = dataflash_file
    log.type("MSG", "QZ", "TimeUS,Message")
    log.row("MSG", 1_000_000, message)
    log.type("PARM", "QNf", "TimeUS,Name,Value")
    for name, value in parameters.items():
        log.row("PARM", 1_000_000, name, value)
    path = tmp_path / "other.bin"
    path.write_bytes(log.bytes())
    vehicle = open_log(path).vehicle
    assert str(vehicle) == f"ArduPilot {kind} 1:1"
    assert bool(vehicle.no_multirotor) == (kind != "hexarotor")


def test_old_firmware_has_other_names_and_no_times(tmp_path, dataflash_file, of):
    log = dataflash_file
    log.type("IMU", "Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.type("ATT", "IccccCC", "TimeMS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw")
    log.type("RCOU", "Ihhhh", "TimeMS,Ch1,Ch2,Ch3,Ch4")
    log.type("ESC2", "If", "TimeMS,RPM")
    log.type("RPM", "Iff", "TimeMS,rpm1,rpm2")
    log.type("EV", "B", "Id")
    log.type("PARM", "Nf", "Name,Value")
    log.row("PARM", "SYSID_THISMAV", 3.0)
    for i in range(100):
        log.row("IMU", 1000 + 20 * i, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
        log.row("RCOU", 1000 + 20 * i, 1200, 1300, 1400, 1500)
        log.row("ATT", 1000 + 20 * i, 0, 1000, 0, 0, 0, 0)
        log.row("ESC2", 1000 + 20 * i, 600.0)
        log.row("RPM", 1000 + 20 * i, -1.0, -1.0)
        if i == 40:
            log.row("EV", 10)
            log.row("EV", 28)
    path = tmp_path / "old.bin"
    path.write_bytes(log.bytes())
    log = open_log(path)
    assert str(log.vehicle) == "ArduPilot quadrotor 3:1"
    assert of(log, Stream.ROTOR_COMMAND, "RCOU")[0].values == (1200.0, 1300.0, 1400.0, 1500.0)
    assert of(open_log(path), Stream.ROTOR_SPEED, "ESC")[0] == Record(
        Stream.ROTOR_SPEED, 1.0, (pytest.approx(600.0 * RPM),), 1, "ESC"
    )
    assert of(open_log(path), Stream.ROTOR_SPEED, "RPM") == []
    q = of(open_log(path), Stream.ATTITUDE)[0].values
    assert q[1] == pytest.approx(math.sin(math.radians(5.0)))
    flies = {r.t: r.values[0] for r in of(open_log(path), Stream.IN_AIR)}
    assert (flies[1.0], flies[1.8]) == (0.0, 1.0)


def test_an_escs_own_times_are_kept(tmp_path, dataflash_file, of):
    log = dataflash_file
    log.type("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.type("ESC", "QBff", "TimeUS,Instance,RPM,RawRPM")
    for i in range(20):
        log.row("IMU", 1000 + 1000 * i, 0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
        log.row("ESC", 1000 + 1000 * i + 200 * (i % 4), i % 4, 100.0, 0.0)
    path = tmp_path / "escs.bin"
    path.write_bytes(log.bytes())
    records = of(open_log(path), Stream.ROTOR_SPEED, "ESC")
    assert [(r.offset, r.t) for r in records[:3]] == [
        (i, pytest.approx(1e-3 + 1.2e-3 * i)) for i in range(3)
    ]


def test_damaged_stamps_and_values_are_left_out_and_counted(tmp_path, flight, path, of):
    flight.row("IMU", 10**15, 0, 1.0, 2.0, 3.0, 4.0, 5.0, -9.8)
    flight.row("IMU", 8_000_000, 0, float("nan"), 2.0, 3.0, 4.0, 5.0, -9.8)
    path.write_bytes(flight.bytes())
    log = open_log(path)
    assert len(of(log, Stream.IMU)) == 300
    assert log.as_dict()["dropped"] == {"no time": 1, "not finite": 1}
    assert log.as_dict()["duration"] < 5.0


def test_a_gap_in_the_file_costs_what_lay_in_it_alone(tmp_path, flight, of):
    data = bytearray(flight.bytes())
    data[20_000:20_400] = b"\xa3\x95" * 200
    path = tmp_path / "gap.bin"
    path.write_bytes(data)
    log = open_log(path)
    assert 290 <= len(of(log, Stream.IMU)) < 300
    assert 300 < log.as_dict()["garbage_bytes"] < 500


def test_what_is_not_read_takes_no_memory(tmp_path, dataflash_file):
    log = dataflash_file
    log.type("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.type("XYZ", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    for i in range(100):
        log.row("IMU", 1000 + 1000 * i, 0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
    log.row("XYZ", 0, 0, *[0.0] * 6)
    path = tmp_path / "long.bin"
    path.write_bytes(log.bytes() + log.bytes()[-36:] * 100_000)
    read_dataflash(path)  # what is imported and kept takes its memory
    tracemalloc.start()
    recording = read_dataflash(path, 2**16)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert recording.counts["XYZ"] == 100_001
    assert peak < path.stat().st_size / 5


def test_numbers_of_instances_that_are_none_are_no_instances(tmp_path, dataflash_file, of):
    log = dataflash_file
    log.type("IMU", "Qfffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.type("ESC", "Qfff", "TimeUS,Instance,RPM,RawRPM")
    log.type("RPM", "Qff", "TimeUS,I,RPM")
    log.type("DSF", "Qf", "TimeUS,Dp")
    nan = math.nan
    for i in range(20):
        log.row("IMU", 1000 + 1000 * i, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
        for number in (0.0, nan, math.inf):
            log.row("ESC", 1000 + 1000 * i, number, 100.0, 0.0)
            log.row("RPM", 1000 + 1000 * i, number, 100.0)
    log.row("DSF", 1000, nan)
    path = tmp_path / "numbers.bin"
    path.write_bytes(log.bytes())
    for source in ("ESC", "RPM"):
        assert {r.offset for r in of(open_log(path), Stream.ROTOR_SPEED, source)} == {0}
    assert open_log(path).as_dict()["lost"] == 0


def test_a_name_described_twice_is_that_of_which_there_are_entries(tmp_path, flight, of):
    flight.type("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", number=200)
    path = tmp_path / "twice.bin"
    path.write_bytes(flight.bytes())
    assert len(of(open_log(path), Stream.IMU)) == 300


@pytest.mark.parametrize("content", [b"\xa3\x95\x80", b"\xa3\x95" + bytes(1000)])
def test_what_is_no_log_gives_one_line(tmp_path, content):
    path = tmp_path / "some.bin"
    path.write_bytes(content)
    with pytest.raises(InputError, match="cannot be read as an ArduPilot log"):
        read_dataflash(path)


@pytest.mark.slow
def test_one_flight_recorded_both_ways_agrees(shared_logs):
    tlog, onboard = ways = [
        columns_of(open_log(shared_logs / name))
        for name in ("ardupilot-sitl.tlog", "ardupilot-sitl.bin")
    ]
    # IMU: the same filtered signal, sampled by different tasks of one loop.
    t, values = tlog[Stream.IMU, ""]
    t_onboard, v_onboard = onboard[Stream.IMU, ""]
    common, i, j = np.intersect1d(np.round(t * 1e6), np.round(t_onboard * 1e6), return_indices=True)
    assert len(common) > 30_000
    assert np.std(values[i] - v_onboard[j], axis=0).max() < 0.02 * np.std(values, axis=0).max()
    flying = np.isin(t_onboard, t_onboard[(t_onboard > 75.0) & (t_onboard < 210.0)])
    assert np.diff(t_onboard[flying]).max() < 0.01
    t, speeds = tlog[Stream.ROTOR_SPEED, "ESC_TELEMETRY_1_TO_4"]
    t_onboard, s_onboard = onboard[Stream.ROTOR_SPEED, "ESC"]
    inside = (t > 75.0) & (t < 210.0)
    for rotor in range(4):
        expected = np.interp(t[inside], t_onboard, s_onboard[:, rotor])
        assert np.corrcoef(speeds[inside, rotor], expected)[0, 1] > 0.98
    assert onboard[Stream.ROTOR_COMMAND, "RCOU"][1][0, :4].tolist() == [1000.0] * 4
    landing = [max(t[flies[:, 0] == 1.0]) for t, flies in (w[Stream.IN_AIR, ""] for w in ways)]
    assert landing[0] == pytest.approx(landing[1], abs=1.0)


def test_a_log_larger_than_any_card_holds_is_not_read(tmp_path):
    path = tmp_path / "sparse.bin"
    with open(path, "wb") as file:
        file.write(dataflash_format.HEAD)
        file.truncate(files.MOST_BYTES_OF_LOG + 1)
    with pytest.raises(InputError, match=r"too large for an autopilot's log: 4,294,967,297 bytes"):
        open_log(path)


def test_a_log_of_a_second_battery_alone_has_no_voltage(tmp_path, dataflash_file):
    log, path = dataflash_file, tmp_path / "flight.bin"
    log.type("BAT", "QBf", "TimeUS,Inst,Volt")
    log.row("BAT", 1_000_000, 1, 12.5)
    log.type("BARO", "QBf", "TimeUS,I,Press")
    log.row("BARO", 1_000_000, 0, 95000.0)
    log.row("BARO", 1_000_000, 1, 95100.0)
    path.write_bytes(log.bytes())
    recording = read_dataflash(path)
    assert recording.counts == {"BAT": 1, "BARO": 2}
    assert not recording.tracks
    assert recording.extras["pressure"][1].tolist() == [[95000.0]]


TEXT = """ArduCopter V3.1
FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format
FMT, 129, 23, PARM, Nf, Name,Value
FMT, 131, 31, IMU, Iffffff, TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ
FMT, 3, 6, MODE, Mh, Mode,ThrCrs
FMT, 10, 3, STRT, ,
PARM, FRAME, 1
PARM, MOT_SPIN_ARMED, 70.5
MODE, Stabilize, 500
IMU, 1000, 0.1, 0.2, 0.3, 0.4, 0.5, -9.8
IMU, 1040, 0.1, 0.2
IMU, 1060, 0.1, 0.2, 0.3, 0.4, 0.5, -9.7
"""


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_log_saved_as_text_is_read(tmp_path, of, end):
    path = tmp_path / "flight.log"
    path.write_text(TEXT.replace("\n", end), newline="")
    log = open_log(path)
    assert log.kind == "dataflash"
    assert [(r.t, r.values[5]) for r in of(log, Stream.IMU)] == [
        (pytest.approx(1.0), -9.8), (pytest.approx(1.06), -9.7)
    ]  # fmt: skip
    assert log.parameters == {"FRAME": 1.0, "MOT_SPIN_ARMED": 70.5}


def test_a_log_behind_other_bytes_is_read(tmp_path, dataflash_file):
    dataflash_file.type("EV", "QB", "TimeUS,Id")
    dataflash_file.row("EV", 1_000_000, 10)
    for before in (bytes(70_000), random.Random(1).randbytes(5000)):
        (tmp_path / "a.bin").write_bytes(before + dataflash_file.bytes())
        assert open_log(tmp_path / "a.bin").as_dict()["garbage_bytes"] == len(before)


def test_logs_of_px4_before_2017_are_named(tmp_path, dataflash_file):
    dataflash_file.type("TIME", "Q", "StartTime")
    dataflash_file.row("TIME", 1_000_000)
    (tmp_path / "a.bin").write_bytes(dataflash_file.bytes())
    with pytest.raises(InputError, match="PX4 from before 2017"):
        open_log(tmp_path / "a.bin")
