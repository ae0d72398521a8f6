"""Harnesses of what lies in files and what users type."""

import argparse
import contextlib
import gzip
import io
import json
import struct
import zipfile
from pathlib import Path

import numpy as np

from gcs_sysid.argument_types import prior, setting, vehicle_address, web_address
from gcs_sysid.cli.output import read_truth
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import builtin_names, load_airframe
from gcs_sysid.model.parameters import PARAMETERS
from gcs_sysid.results.result_data import SCHEMA
from gcs_sysid.results.result_file import read_result
from gcs_sysid.setup_help.airframe_file import ASCII, airframe_text, checked
from gcs_sysid.setup_help.wizard import GivenAnswers, Wizard
from gcs_sysid.signals.columns import Track
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.dataflash import read_dataflash
from gcs_sysid.telemetry.logs import open_log
from gcs_sysid.telemetry.rosbag import read_rosbag
from gcs_sysid.telemetry.signing import KEY_SIZE, LARGEST_TIME, SigningClock, read_key
from gcs_sysid.telemetry.track_collector import Recording
from gcs_sysid.telemetry.ulog import read_ulog
from gcs_sysid.telemetry.urls import parse_url
from sim_bridge.swings import read_plan
from testbed.fuzz.harness import Scratch, one_line_errors
from testbed.recordings import in_sequence
from testbed.ros_bags import mavros_bag, px4_bag

_ulg, _bin, _bbl = Scratch(".ulg"), Scratch(".bin"), Scratch(".bbl")
_log = Scratch("")
_toml, _json, _key = Scratch(".toml"), Scratch(".json"), Scratch(".key")


def check_recording(recording: Recording) -> None:
    """What a reader has made of a log is sound."""
    block = recording.block()
    for track in block.tracks:
        assert np.isfinite(track.t).all()
        assert (np.diff(track.t) >= 0.0).all()
        assert len(track.t) == len(track.values) == len(track.order)
    for record in in_sequence(block):
        assert np.isfinite(record.t)
    assert all(np.isfinite(value) for _, _, value in recording.parameters)


def check_ulg(data: bytes) -> None:
    """A PX4 log is read or refused."""
    path = _ulg.put(data)
    with one_line_errors():
        check_recording(read_ulog(path))


def check_bin(data: bytes) -> None:
    """An ArduPilot log is read or refused."""
    path = _bin.put(data)
    with one_line_errors():
        recording = read_dataflash(path)
        check_recording(recording)
        assert 0 <= recording.garbage_bytes <= len(data)


def check_rosbag(data: bytes) -> None:
    """A recording of ROS 2 is read or refused."""
    path = _log.put(data)
    with one_line_errors():
        check_recording(read_rosbag(path))


def check_log(data: bytes) -> None:
    """What is given as a log is unpacked and read, or refused."""
    path = _log.put(data)
    with one_line_errors():
        for _ in open_log(path).blocks():
            pass


def check_airframe(data: bytes) -> None:
    """An airframe file is read or refused; what is read is sound."""
    path = _toml.put(data)
    with one_line_errors():
        airframe = load_airframe(str(path))
        assert np.isfinite(airframe.geometry).all()
        assert 0.0 < airframe.arm < 101.0
        assert airframe.command.max > airframe.command.min
        json.dumps(airframe.as_json(), allow_nan=False)


def check_result(data: bytes) -> None:
    """A result is read or refused; one that is read can be written, and read again as itself."""
    path = _json.put(data)
    with one_line_errors():
        result = read_result(path)
        text = result.dumps()
        assert read_result(_json.put(text.encode())).dumps() == text


def check_plan(data: bytes) -> None:
    """A flight plan is read or refused."""
    path = _json.put(data)
    with one_line_errors():
        read_plan(path)


def check_truth(data: bytes) -> None:
    """A truth file is read or refused."""
    path = _json.put(data)
    with one_line_errors():
        assert all(np.isfinite(value) for value in read_truth(str(path)).values())


def check_key(data: bytes) -> None:
    """A key file gives 32 bytes or is refused; a damaged state file never stops the clock."""
    path = _key.put(data)
    with one_line_errors():
        assert len(read_key(path)) == KEY_SIZE
    clock = SigningClock(path, now=lambda: 1000)
    first = clock.time
    assert 1000 <= first <= LARGEST_TIME
    assert clock.next_time() >= first


def check_url(data: bytes) -> None:
    """A link's name is understood or refused."""
    text = data.decode("utf-8", "surrogateescape")
    with one_line_errors():
        url = parse_url(text)
        assert url.kind in ("udpin", "udpout", "tcp", "tcpin", "serial")
        if url.kind == "serial":
            assert url.device
            assert url.baud > 0
            assert url.line_rate is None or url.line_rate > 0
        else:
            assert url.host
            assert 0 < url.port < 65536


def check_options(data: bytes) -> None:
    """Options that are more than a word are understood or refused."""
    text = data.decode("utf-8", "surrogateescape")
    for parse in (vehicle_address, prior, setting, web_address):
        with contextlib.suppress(argparse.ArgumentTypeError):
            parse(text)


def check_wizard(data: bytes) -> None:
    """Whatever is typed, the wizard asks on; where it ends, its file can be read."""
    typed = data.decode("utf-8", "replace").split("\n")

    def ask(question: str) -> str:
        if not typed:
            raise InputError("the answers ended")
        return typed.pop(0)

    with one_line_errors():
        airframe, origin = Wizard(ask, lambda text: None, ASCII).answers(GivenAnswers())
        text = airframe_text(airframe, origin)
        try:
            made = checked(text, "the wizard's file")
        except InputError as error:
            raise AssertionError(f"the wizard made a file that is refused: {error}") from error
        assert made.name == airframe.name


def toml_seeds() -> list[bytes]:
    """The airframes that come with the program, and a full one."""
    folder = Path(__file__).parents[2] / "src" / "gcs_sysid" / "model" / "airframes"
    full = b"""name = "x"\nmass = 1.5\nrotor_input = "command"
[command]\nmin = 0.0\nmax = 1\nthrust_curve = 0.3\n[imu]\ngyro_filter = 80\nposition = [0, 0.1, 0]
[prior]\nk_M = [6e-6, 1e-7]\nIxx = [0.01, 1e-3]\n[simulation]\nx = [[[1]]]\n"""
    places = ((0.2, 0.2, b"ccw"), (-0.2, -0.2, b"ccw"), (0.2, -0.2, b"cw"), (-0.2, 0.2, b"cw"))
    rotors = b"".join(b'[[rotor]]\nx = %g\ny = %g\nspin = "%s"\n' % place for place in places)
    shipped = [(folder / f"{name}.toml").read_bytes() for name in builtin_names()]
    return [*shipped, full + rotors, b"a = " + b"[" * 400]


def result_seeds() -> list[bytes]:
    """A result with everything in it, and one of little."""
    estimate = {"value": 1.5, "std": 0.1, "unit": "kg", "status": "identified", "bound": 0.1}
    full = {
        "schema": SCHEMA, "verdict": "identified", "reasons": ["a"], "source": "f.tlog",
        "vehicle": {"sysid": 1}, "scale": {"anchor": "mass", "value": 1.5, "unit": "kg",
        "std": 0.0, "from": "--mass"}, "estimator": "offline", "rotor_input": "speed",
        "parameters": {name: {**estimate, "rests_on": "mass"} for name in PARAMETERS},
        "timing": {"rotor_delay": estimate}, "events": [{"t": 1.0, "kind": "x", "text": "y"}],
        "segments": [{"start": 0}], "validation": {}, "priors": {}, "telemetry": {"lost": 0},
        "airframe": {"name": "x", "rotors": []},
    }  # fmt: skip
    little = {"schema": SCHEMA, "verdict": "refused", "rotor_input": "command"}
    nested = b'{"schema": ' + b"[" * 500
    return [*(json.dumps(table).encode() for table in (full, little, [little])), nested]


def plan_seeds() -> list[bytes]:
    """Plans as `gcs-sysid plan` writes them."""
    swing = {"axis": "roll", "kind": "swing", "amplitude": 0.2, "period": 1.0, "swings": 3,
             "start": 5.0, "seconds": 6.0}  # fmt: skip
    return [
        json.dumps({"schema": "gcs-sysid-plan/1", "manoeuvres": [swing, swing]}).encode(),
        b'{"manoeuvres": [{}]}',
    ]


def truth_seeds() -> list[bytes]:
    """Truth files."""
    return [b'{"mass": 1.5, "Ixx": 1e-2, "k_T": 8.5e-06}', b'{"mass": 1e400}', b"{}"]


def key_seeds() -> list[bytes]:
    """Keys of every form, and a state file."""
    return [bytes(range(32)), b"0123456789abcdef" * 4, b"a passphrase\n", b"5000000000000\n"]


def url_seeds() -> list[bytes]:
    """Links of every kind."""
    return [
        b"udpin:0.0.0.0:14550", b"udp:127.0.0.1:14550", b"tcp:[::1]:5760", b"COM3,57600",
        b"/dev/ttyUSB0,921600", b"localhost:14550", b"tcpin://host:1", b"flight.tlog",
        b"\\\\.\\COM12", "udpin:0.0.0.0:١٤٥٥٠".encode(),
    ]  # fmt: skip


def option_seeds() -> list[bytes]:
    """Addresses of vehicles, priors, settings, addresses of the page."""
    return [
        b"1", b"1:1", b"255:255", "k_M=6e-6±1e-7".encode(), b"mass=1.5+-0.1", b"Ixy=0+/-1e-4",
        b"8000", b"0.0.0.0:8000", b"[::1]:8000", "1:²".encode(),
    ]  # fmt: skip


def wizard_seeds() -> list[bytes]:
    """Whole dialogues."""
    return [
        b"px4-quad-x\n0.25\n\n1\n1.5\n\n\n\n",
        b"1\n0.25\nreversed\n2\n8.5e-6\n0.02 0 -0.03\nk_M=6.1e-6+-1e-7\n\nmy quad\n",
        b"own\n0.2 0.2 ccw\n-0.2 -0.2 ccw\n0.2 -0.2 cw\n-0.2 0.2 cw\n\n\n4\n\n\n\n",
        b"2\n0.15 0.2\nccw ccw cw cw\n3\n7\ny\n\n\n\n",
    ]


def _ulog_entry(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<H", len(content)) + kind + content


def ulg_seeds() -> list[bytes]:
    """A log with every topic that is read, and one with a parameter alone."""
    topics = {
        "sensor_combined": ("float[3] gyro_rad", "float[3] accelerometer_m_s2"),
        "vehicle_attitude": ("float[4] q",),
        "vehicle_local_position": tuple(f"float {n}" for n in ("vx", "vy", "vz", "x", "y", "z")),
        "actuator_motors": ("float[4] control",),
        "actuator_outputs": ("uint32_t noutputs", "float[4] output"),
        "vehicle_land_detected": ("bool landed",),
        "vehicle_status": ("uint8_t arming_state", "uint8_t nav_state", "uint8_t system_id"),
        "esc_status": ("uint8_t esc_count", "esc_report[4] esc"),
        "estimator_sensor_bias": ("float[3] gyro_bias", "float[3] accel_bias"),
    }
    sizes = {"float": 4, "uint32_t": 4, "bool": 1, "uint8_t": 1, "esc_report": 5}
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000)
    report = b"esc_report:int32_t esc_rpm;uint8_t actuator_function;"
    key = b"int32_t MAV_SYS_ID"
    parameter = _ulog_entry(b"P", bytes([len(key)]) + key + struct.pack("<i", 1))
    logs = []
    for chosen in ([*topics], *([name] for name in topics)):
        definitions, rows = _ulog_entry(b"F", report), b""
        for number, name in enumerate(chosen):
            fields = topics[name]
            text = f"{name}:uint64_t timestamp;{';'.join(fields)};".encode()
            definitions += _ulog_entry(b"F", text)
            rows += _ulog_entry(b"A", struct.pack("<BH", 0, number) + name.encode())
            width = 0
            for field in fields:
                kind, _, count = field.split()[0].rstrip("]").partition("[")
                width += sizes[kind] * int(count or 1)
            for step in range(3):
                stamp = struct.pack("<HQ", number, 1_000_000 + 4000 * step)
                rows += _ulog_entry(b"D", stamp + bytes([1, 0, 0, 63] * 8)[:width])
        rows += _ulog_entry(b"O", struct.pack("<H", 20)) + parameter
        logs.append(head + definitions + parameter + rows)
    return [*logs, head + parameter]


def bin_seeds() -> list[bytes]:
    """A log with every entry that is read."""
    types = {
        "IMU": ("QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
        "ATT": ("Qfff", "TimeUS,Roll,Pitch,Yaw"),
        "XKQ": ("QBffff", "TimeUS,C,Q1,Q2,Q3,Q4"),
        "XKF1": ("QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD"),
        "XKF4": ("QBB", "TimeUS,C,PI"),
        "RCOU": ("QHHHH", "TimeUS,C1,C2,C3,C4"),
        "ESC": ("QBff", "TimeUS,Instance,RPM,RawRPM"),
        "RPM": ("Qff", "TimeUS,rpm1,rpm2"),
        "PARM": ("QNf", "TimeUS,Name,Value"),
        "EV": ("QB", "TimeUS,Id"),
        "ARM": ("QB", "TimeUS,ArmState"),
        "MODE": ("QMB", "TimeUS,Mode,ModeNum"),
        "DSF": ("QI", "TimeUS,Dp"),
    }
    codes = {"Q": "Q", "B": "B", "f": "f", "H": "H", "N": "16s", "I": "I", "M": "B"}

    def described(number: int, size: int, name: str, letters: str, columns: str) -> bytes:
        texts = name.encode(), letters.encode(), columns.encode()
        return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", number, size, *texts)

    logs = []
    for chosen in ([*types], *([name] for name in types)):
        log = described(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
        for number, name in enumerate(chosen, 1):
            letters, columns = types[name]
            layout = struct.Struct("<" + "".join(codes[letter] for letter in letters))
            log += described(number, layout.size + 3, name, letters, columns)
            for step in range(3):
                stamp = struct.pack("<Q", 1_000_000 + 4000 * step)
                row = stamp + bytes([1, 0, 0, 63] * 8)[: layout.size - 8]
                if name == "PARM":
                    row = stamp + b"FRAME_CLASS\0\0\0\0\0" + struct.pack("<f", 1.0)
                log += b"\xa3\x95" + bytes([number]) + row
        logs.append(log)
    text = b"ArduCopter\r\nFMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format\r\n"
    text += b"FMT, 1, 31, IMU, Iffffff, TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ\r\n"
    text += b"FMT, 2, 23, PARM, Nf, Name,Value\r\nPARM, FRAME, 1\r\n"
    return [*logs, text + b"IMU, 1000, 0.1, 0.2, 0.3, 0.4, 0.5, -9.8\r\n" * 3]


def rosbag_seeds() -> list[bytes]:
    """Both containers of a flight by PX4 and by MAVROS, of few samples."""
    t = np.arange(6) * 0.01
    tracks = [
        Track(Stream.IMU, t, np.full((6, 6), -9.8)),
        Track(Stream.ATTITUDE, t, np.tile([1.0, 0.0, 0.0, 0.0], (6, 1))),
        Track(Stream.VELOCITY, t, np.ones((6, 6))),
        Track(Stream.ROTOR_SPEED, t, np.full((6, 4), 400.0)),
    ]
    seeds = []
    for bag in (px4_bag(_ulg.put(ulg_seeds()[0])), mavros_bag(tracks)):
        path = _log.put(b"")
        path.unlink()
        bag.database(path)
        seeds.append(path.read_bytes())
        with contextlib.suppress(ImportError):  # of an extra
            seeds += [bag.mcap(), bag.mcap("zstd", chunk_size=300)]
    return seeds


def packed_seeds() -> list[bytes]:
    """A log in each of the packings that are undone."""
    log, archive = bin_seeds()[1], io.BytesIO()
    with zipfile.ZipFile(archive, "w") as target:
        target.writestr("a.bin", log)
    return [gzip.compress(log), archive.getvalue(), bytes(100) + log]
