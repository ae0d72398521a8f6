"""Recordings of ROS 2 give the records of the same flight in another log."""

import math
import sys
from importlib.util import find_spec

import numpy as np
import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.files import with_mapping
from gcs_sysid.signals.columns import Track
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.logs import open_log
from gcs_sysid.telemetry.ros_messages import MessageColumns
from testbed.ros_bags import Bag, cdr, mavros_bag, px4_bag

needs_mcap = pytest.mark.skipif(
    not all(map(find_spec, ("mcap", "lz4", "zstandard"))), reason="needs mcap"
)
POINT = ("/point", "geometry_msgs/msg/Point", "float64 x\nfloat64 y\nfloat64 z")


@pytest.fixture
def ulg(tmp_path, ulog_file):
    """Half a second of a PX4 with everything that it sends to ROS 2."""
    log = ulog_file
    log.nested("esc_report", ["uint64_t timestamp", "int32_t esc_rpm", "uint8_t actuator_function"])
    log.topic("sensor_combined", ["float[3] gyro_rad", "float[3] accelerometer_m_s2"])
    log.topic("vehicle_attitude", ["uint8_t quat_reset_counter", "float[4] q"])
    log.topic("vehicle_local_position", [f"float {n}" for n in ("x", "y", "z", "vx", "vy", "vz")])
    log.topic("actuator_motors", ["float[12] control"])
    log.topic("esc_status", ["uint8_t esc_count", "esc_report[2] esc"])
    log.topic("battery_status", ["bool connected", "float voltage_v"])
    log.topic("vehicle_land_detected", ["bool landed"])
    log.topic("vehicle_status", [f"uint8_t {n}" for n in ("arming_state", "nav_state",
                                                          "system_id", "system_type")])  # fmt: skip
    log.row("vehicle_status", 2.0, 2, 17, 7, 13)
    log.row("vehicle_land_detected", 2.0, True)
    for i in range(120):
        t = 2.0 + 0.004 * i
        log.row("sensor_combined", t, 1.0 + i, 2.0, 3.0, 0.0, 0.0, -9.0)
        log.row("vehicle_attitude", t + 1e-3, i % 256, math.cos(i / 100), math.sin(i / 100), 0, 0)
        log.row("actuator_motors", t, 0.5, 0.0, 1.0, *[math.nan] * 9)
        log.row("esc_status", t, 2, 2_990_000, -600 - i, 102, 2_990_000, 1200, 101)
        log.row("vehicle_local_position", t, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
        log.row("battery_status", t, True, 15.5)
    log.row("vehicle_land_detected", 2.15, False)
    path = tmp_path / "flight.ulg"
    path.write_bytes(log.bytes())
    return path


def streams(path):
    """(stream, source) -> times and values."""
    return {
        (track.stream, track.source): (track.t, track.values)
        for block in open_log(path).blocks()
        for track in block.tracks
    }


def assert_same(path, other):
    found, wanted = streams(path), streams(other)
    assert found.keys() == wanted.keys()
    for key, arrays in wanted.items():
        for values, expected in zip(found[key], arrays, strict=True):
            np.testing.assert_array_equal(values, expected, err_msg=str(key))


@needs_mcap
@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_px4_messages_in_mcap_are_the_log_of_the_vehicle(ulg, tmp_path, compression):
    path = tmp_path / "flight.mcap"
    path.write_bytes(px4_bag(ulg).mcap(compression, chunk_size=5000))
    assert_same(path, ulg)
    log = open_log(path)
    assert str(log.vehicle) == "PX4 hexarotor 7:1"
    assert not log.as_dict()["damaged"]


def test_so_are_those_in_a_database_or_in_a_folder_of_two(ulg, tmp_path):
    px4_bag(ulg).database(tmp_path / "flight.db3")
    assert_same(tmp_path / "flight.db3", ulg)
    folder = tmp_path / "flight"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    topics = px4_bag(ulg).topics
    Bag([(*words, rows[: len(rows) // 2]) for *words, rows in topics]).database(folder / "a_0.db3")
    Bag([(*words, rows[len(rows) // 2 :]) for *words, rows in topics]).database(folder / "a_1.db3")
    assert_same(folder, ulg)


def test_names_of_other_versions_and_vehicles_are_understood(ulg, tmp_path):
    old = [(f"{name.replace('/out', '')}/out", *rest) for name, *rest in px4_bag(ulg).topics]
    Bag(old).database(tmp_path / "old.db3")
    assert_same(tmp_path / "old.db3", ulg)
    topics = px4_bag(ulg).topics
    own = [(f"/uav_2{name}_v1", *rest) for name, *rest in topics]
    other = [(f"/uav_1{name}", *words, rows[:9]) for name, *words, rows in topics]
    Bag([*other, *own]).database(tmp_path / "two.db3")
    assert_same(tmp_path / "two.db3", ulg)
    assert "of another vehicle: /uav_1/" in open_log(tmp_path / "two.db3").as_dict()["dropped"]


def test_a_database_without_definitions_says_what_to_do(ulg, tmp_path):
    px4_bag(ulg).database(tmp_path / "humble.db3", described=False)
    with pytest.raises(InputError, match=r"before Iron: convert it to MCAP .*ros2 bag convert"):
        open_log(tmp_path / "humble.db3")


def flight():
    """Two seconds of every stream, at a slant."""
    t = 1_700_000_000.0 + np.arange(200) * 0.01
    angle = np.linspace(0.1, 1.0, 200)
    q = np.column_stack([np.cos(angle), 0.6 * np.sin(angle), 0.8 * np.sin(angle), 0 * angle])
    rng = np.random.default_rng(3)
    imu = rng.normal(size=(200, 6)) - [0.0, 0.0, 0.0, 0.0, 0.0, 9.8]
    return [
        Track(Stream.IMU, t, imu),
        Track(Stream.ATTITUDE, t, q),
        Track(Stream.VELOCITY, t[::4], rng.normal(size=(50, 6))),
        Track(Stream.ROTOR_SPEED, t, rng.integers(100, 200, (200, 4)) * math.pi / 30.0),
        Track(Stream.ARMED, t[::50], np.array([[0.0], [1.0], [1.0], [1.0]])),
        Track(Stream.IN_AIR, t[::50], np.array([[0.0], [0.0], [1.0], [1.0]])),
        Track(Stream.VOLTAGE, t[::50], np.full((4, 1), 15.5)),
    ]


def test_messages_of_mavros_are_turned_to_north_and_forward_right_down(tmp_path):
    tracks = flight()
    mavros_bag(tracks).database(tmp_path / "flight.db3")
    found = {stream: arrays for (stream, _), arrays in streams(tmp_path / "flight.db3").items()}
    assert found.keys() == {track.stream for track in tracks}
    for track in tracks:
        t, values = found[track.stream]
        wanted = track.values[::4] if track.stream is Stream.ATTITUDE else track.values
        np.testing.assert_allclose(values, wanted, atol=1e-9, err_msg=track.stream.name)
        assert (
            abs(t[-1] - track.t[4 * (len(t) - 1) if track.stream is Stream.ATTITUDE else -1]) < 1e-6
        )


def test_a_mapping_names_fields_of_topics(tmp_path):
    topics = [(f"{name}_of_mine", *rest) for name, *rest in mavros_bag(flight()).topics]
    # A second IMU makes it unclear which is meant.
    Bag([*topics, ("/camera/imu", *topics[0][1:])]).database(tmp_path / "flight.db3")
    with pytest.raises(InputError, match="/camera/imu or /mavros/imu/data_raw_of_mine: not clear"):
        open_log(tmp_path / "flight.db3")
    mapping = tmp_path / "map.toml"
    imu, escs = "/mavros/imu/data_raw_of_mine", "/mavros/esc_telemetry/telemetry_of_mine"
    mapping.write_text(
        f"""
        time = "{imu}.header.stamp"
        frame = "FLU"
        gyro = [{", ".join(f'"{imu}.angular_velocity.{axis}"' for axis in "xyz")}]
        [speeds]
        columns = [{", ".join(f'"{escs}.esc_telemetry[{i}].rpm"' for i in range(4))}]
        time = "{escs}.log_time"
        unit = "rpm"
        """
    )
    found = streams(with_mapping(tmp_path / "flight.db3", mapping))
    np.testing.assert_allclose(found[Stream.IMU, ""][1][:, :3], flight()[0].values[:, :3])
    np.testing.assert_allclose(found[Stream.ROTOR_SPEED, "speeds"][1], flight()[3].values)
    mapping.write_text(mapping.read_text().replace("velocity.x", "velocity.w"))
    with pytest.raises(InputError, match=r"has no field '/mavros.*velocity\.w', which .*map\.toml"):
        open_log(with_mapping(tmp_path / "flight.db3", mapping))


def test_an_imu_that_is_upside_down_is_refused(tmp_path):
    imu, *others = flight()
    turned = Track(Stream.IMU, imu.t, imu.values * (1, -1, -1, 1, -1, -1))
    mavros_bag([turned, *others]).database(tmp_path / "flight.db3")
    with pytest.raises(InputError, match="upside down"):
        open_log(tmp_path / "flight.db3")


@needs_mcap
def test_exported_signals_are_read_back(tmp_path):
    from gcs_sysid.report.data import writer_of

    t = np.arange(100) * 0.01
    table = {"t": t, "gyro_x": t, "gyro_y": -t, "gyro_z": 2 * t}
    table |= {f"rotor_speed_{i}": 100.0 + t for i in range(1, 5)} | {"flying": 1.0 + 0 * t}
    path = tmp_path / "signals.mcap"
    path.write_bytes(writer_of(path)(table))
    found = streams(path)
    np.testing.assert_array_equal(found[Stream.IMU, ""][1][:, 1], -t)
    assert found[Stream.ROTOR_SPEED, "speeds"][1].shape == (100, 4)
    assert found[Stream.IN_AIR, ""][1].all()


@needs_mcap
def test_a_file_that_was_cut_short_gives_what_is_whole(ulg, tmp_path):
    path = tmp_path / "flight.mcap"
    content = px4_bag(ulg).mcap("zstd", chunk_size=5000)
    for share in (0.5, 0.3):
        path.write_bytes(content[: int(share * len(content))])
        log = open_log(path)
        told = log.as_dict()
        assert told["damaged"]
        assert 0 < told["messages"]["sensor_combined"]["count"] < 120
    path.write_bytes(content[:50])
    with pytest.raises(InputError, match="no topic in it"):
        open_log(path)


@needs_mcap
def test_a_chunk_with_a_wrong_checksum_is_left_out(ulg, tmp_path):
    path = tmp_path / "flight.mcap"
    content = bytearray(px4_bag(ulg).mcap(chunk_size=5000))
    for share in (0.3, 0.6):
        content[int(share * len(content))] ^= 255
    path.write_bytes(content)
    told = open_log(path).as_dict()
    assert told["damaged"]
    assert told["dropped"]["damaged chunk: wrong checksum or length"] >= 1
    assert 0 < told["messages"]["sensor_combined"]["count"] < 120


def test_lengths_of_strings_and_sequences_move_what_follows():
    text = "string name\nuint8[] data\nfloat64 x\nint16[<=4] y\nbool KNOWN=1\nstring<=9 last 'a'"
    columns = MessageColumns("some_msgs/msg/Thing", text, lambda name: name in ("x", "y"))
    for i in range(20):
        data = [("uint8", 7)] * (i % 3)
        columns.add(
            cdr(("string", "a" * (i % 5)), ("uint32", len(data)), *data, ("float64", i),
                ("uint32", i % 2), *[("int16", -i)] * (i % 2), ("string", "z")), i * 10**9,
        )  # fmt: skip
    columns.add(b"\0\1\0\0\xff\xff\xff\xff", 0)
    columns.add(b"", 0)
    found = columns.columns()
    order = np.argsort(found["log_time"])
    np.testing.assert_array_equal(found["x"][order], range(20))
    np.testing.assert_array_equal(found["y[0]"][order][1::2], -np.arange(20)[1::2])
    assert np.isnan(found["y[0]"][order][::2]).all()
    assert sum(columns.unread.values()) == 2
    assert columns.count == 22


def test_without_the_library_the_line_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap", None)
    path = tmp_path / "flight.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    with pytest.raises(InputError, match=r"flight.mcap: .*pip install \"gcs-sysid\[mcap\]\""):
        open_log(path)


def test_what_is_no_flight_says_what_it_is(tmp_path):
    path = tmp_path / "some.db3"
    Bag([(*POINT, [(1, cdr(*[("float64", 1.0)] * 3))])]).database(path)
    with pytest.raises(InputError, match=r"no IMU known by its type: .*--csv.*; /point$"):
        open_log(path)
    path.write_bytes(b"SQLite format 3\0" + bytes(100))
    with pytest.raises(InputError, match="damaged: file is not a database"):
        open_log(path)
