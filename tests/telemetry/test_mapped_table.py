"""Tables with a mapping give the records that a log of the same flight would have given."""

import gzip
import math
from datetime import UTC, datetime

import numpy as np
import pytest

from gcs_sysid.cli.program import run
from gcs_sysid.errors import InputError
from gcs_sysid.fleet.batch import find_logs
from gcs_sysid.model.attitude import align_signs, from_euler, matrices
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.logs import open_log
from gcs_sysid.telemetry.mapped_table import read_mapping

N = 40
FLU = np.diag([1.0, -1.0, -1.0])
ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
T = 5.0 + 0.01 * np.arange(N)
RANDOM = np.random.default_rng(1)
GYRO, FORCE, V, X = (RANDOM.normal(size=(N, 3)) for _ in range(4))
Q = align_signs(np.array([from_euler(0.3 * math.sin(t), 0.2, 2.0 + t) for t in T]))
SPEEDS = 500.0 + RANDOM.normal(size=(N, 4))
FOREIGN = """
time = "stamp"
time_unit = "us"
frame = "FLU"
world = "ENU"
gyro = { columns = ["p", "q", "r"], unit = "deg/s" }
force = { columns = ["ax", "ay", "az"], unit = "g" }
attitude = { columns = ["qx", "qy", "qz", "qw"], order = "xyzw" }
velocity = ["vx", "vy", "vz"]
position = ["x", "y", "z"]
speeds = { columns = ["m1", "m2", "m3", "m4"], unit = "rpm" }
commands = { columns = ["u1", "u2", "u3", "u4"], min = 1000, max = 2000 }
in_air = "flying"
parameters = { THR_MDL_FAC = 0.3 }
"""


def quaternion(rotation):
    """w, x, y, z by the eigenvector of the largest eigenvalue (Bar-Itzhack, 2000)."""
    m = rotation
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2], m[2, 1] - m[1, 2]],
            [m[1, 0] + m[0, 1], m[1, 1] - m[0, 0] - m[2, 2], m[2, 1] + m[1, 2], m[0, 2] - m[2, 0]],
            [m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], m[2, 2] - m[0, 0] - m[1, 1], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], np.trace(m)],
        ]
    )
    x, y, z, w = np.linalg.eigh(k)[1][:, -1]
    return np.array([w, x, y, z])


def columns():
    """The flight in FLU and ENU, deg/s, g, rpm, pulses and microseconds."""
    to_table = np.array([ENU.T @ rotation @ FLU for rotation in matrices(Q)])
    q = np.array([quaternion(rotation) for rotation in to_table])
    parts = {
        "stamp": T * 1e6,
        "p q r": np.degrees(GYRO @ FLU),
        "ax ay az": FORCE @ FLU / 9.80665,
        "qw qx qy qz": q,
        "vx vy vz": V @ ENU,
        "x y z": X @ ENU,
        "m1 m2 m3 m4": -SPEEDS * 60.0 / (2.0 * math.pi),
        "u1 u2 u3 u4": np.full((N, 4), 1250.0),
        "flying": np.ones(N),
    }
    out = {}
    for names, values in parts.items():
        for name, column in zip(names.split(), np.atleast_2d(values.T), strict=True):
            out[name] = column
    return out


def write_csv(path, table, delimiter=",", blank=()):
    names = list(table)
    lines = [delimiter.join(names)]
    for i in range(N):
        row = ["" if (name, i) in blank else repr(float(table[name][i])) for name in names]
        lines.append(delimiter.join(row))
    path.write_text("\n".join(lines) + "\n")


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "columns.toml").write_text(FOREIGN)
    return tmp_path


def tracks_of(path):
    log = open_log(path)
    (block,) = log.blocks()
    return {track.stream: track for track in block.tracks}, log


def check(tracks):
    imu = tracks[Stream.IMU]
    np.testing.assert_allclose(imu.t, T, atol=1e-9)
    np.testing.assert_allclose(imu.values, np.hstack([GYRO, FORCE]), atol=1e-9)
    np.testing.assert_allclose(matrices(tracks[Stream.ATTITUDE].values), matrices(Q), atol=1e-9)
    np.testing.assert_allclose(tracks[Stream.VELOCITY].values, np.hstack([V, X]), atol=1e-9)
    np.testing.assert_allclose(tracks[Stream.ROTOR_SPEED].values, SPEEDS, atol=1e-9)
    np.testing.assert_allclose(tracks[Stream.ROTOR_COMMAND].values, 0.25)
    assert (tracks[Stream.IN_AIR].values == 1.0).all()


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_units_and_axes_of_others_come_out_as_ours(folder, delimiter):
    write_csv(folder / "a.csv", columns(), delimiter)
    tracks, log = tracks_of(folder / "a.csv")
    check(tracks)
    assert log.kind == "table"
    assert log.parameters == {"THR_MDL_FAC": 0.3}
    assert log.vehicle.vehicle_type == 2  # MAV_TYPE_QUADROTOR


def test_tables_of_spreadsheets_are_read(folder):
    """Decimal commas, `sep=`, UTF-16 with and without its mark, Latin-1, dates, and packed."""
    write_csv(folder / "plain.csv", columns(), ";")
    text = (folder / "plain.csv").read_text()
    header, *rows = text.splitlines()
    dated = [header]
    for t, row in zip(T, rows, strict=True):
        stamp = datetime.fromtimestamp(t, UTC).replace(tzinfo=None).isoformat()
        dated.append(f"{stamp};{row.partition(';')[2]}")
    for content in (
        text.replace(".", ",").encode(), f"sep=;\n{text}".encode(), text.encode("utf-16"),
        text.encode("utf-16-le"), "\n".join(dated).encode(),
        text.replace(header, header + ";°C").encode("latin-1"), gzip.compress(text.encode()),
    ):  # fmt: skip
        (folder / "a.csv").write_bytes(content)
        check(tracks_of(folder / "a.csv")[0])
    check(tracks_of((folder / "a.csv").rename(folder / "a.csv.gz"))[0])


def test_rows_of_two_sensors_under_one_time_are_told(folder):
    table = columns()
    write_csv(folder / "a.csv", {**table, "stamp": np.repeat(table["stamp"][::2], 2)})
    with pytest.raises(InputError, match="of two sensors"):
        open_log(folder / "a.csv")


@pytest.mark.parametrize(("unit", "scale"), [("s", 1e3), ("ns", 1e6)])
def test_times_of_another_unit_are_noticed(folder, unit, scale):
    text = FOREIGN.replace('time_unit = "us"', f'time_unit = "{unit}"')
    (folder / "columns.toml").write_text(text)
    write_csv(folder / "a.csv", {**columns(), "stamp": T * scale})
    with pytest.raises(InputError, match="set time_unit"):
        open_log(folder / "a.csv")


@pytest.mark.slow
def test_parquet_is_the_same(folder):
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    table = columns()
    stamps = pa.array((table.pop("stamp")).astype(np.int64), pa.timestamp("us"))
    parquet.write_table(pa.table({"stamp": stamps, **table}), folder / "a.parquet")
    tracks, _ = tracks_of(folder / "a.parquet")
    check(tracks)


def test_the_mapping_may_be_named_and_lie_elsewhere(tmp_path):
    write_csv(tmp_path / "a.csv", columns())
    other = tmp_path / "maps"
    other.mkdir()
    (other / "map.toml").write_text(FOREIGN)
    check(tracks_of(tmp_path / f"a.csv#{other / 'map.toml'}")[0])
    (tmp_path / "map.toml").write_text(FOREIGN)
    check(tracks_of(tmp_path / "a.csv#map.toml")[0])


def test_empty_fields_are_no_samples(folder):
    blank = {(name, i) for i in range(1, N, 2) for name in ("m1", "m2", "m3", "m4")}
    write_csv(folder / "a.csv", columns(), blank=blank)
    tracks, _ = tracks_of(folder / "a.csv")
    np.testing.assert_allclose(tracks[Stream.ROTOR_SPEED].t, T[::2], atol=1e-9)
    np.testing.assert_allclose(tracks[Stream.ROTOR_SPEED].values, SPEEDS[::2], atol=1e-9)
    assert len(tracks[Stream.IMU].t) == N


def test_euler_angles_and_the_inverse_attitude(tmp_path):
    table = columns()
    for name, value in zip(("roll", "pitch", "yaw"), (0.1, -0.2, 0.7), strict=True):
        table[name] = np.full(N, math.degrees(value))
    write_csv(tmp_path / "a.csv", table)
    mapping = """
time = "stamp"
time_unit = "us"
gyro = ["p", "q", "r"]
commands = { columns = ["u1", "u2", "u3", "u4"], min = 1000, max = 2000 }
attitude = { columns = ["roll", "pitch", "yaw"], unit = "deg"%s }
"""
    (tmp_path / "m.toml").write_text(mapping % "")
    q = tracks_of(tmp_path / "a.csv#m.toml")[0][Stream.ATTITUDE].values[0]
    np.testing.assert_allclose(q, from_euler(0.1, -0.2, 0.7), atol=1e-12)
    (tmp_path / "m.toml").write_text(mapping % ", inverse = true")
    back = tracks_of(tmp_path / "a.csv#m.toml")[0][Stream.ATTITUDE].values[0]
    np.testing.assert_allclose(back, q * (1, -1, -1, -1), atol=1e-12)


WRONG_MAPPINGS = {
    "gyro = [": "not valid TOML",
    "".join(f"k{i}{'.a' * 900} = 1\n" for i in range(90)): "too many lines with hundreds of dots",
    "a" + ".a" * 90_000 + " = 1": "not a mapping file: a line with more than 1000 dots",
    'time = "t"': "gyro is missing",
    'gyro = ["p", "q", "r"]\nspeeds = ["m"]': "time is missing",
    'time = "t"\ngyro = ["p", "q", "r"]': r"neither \[speeds\] nor \[commands\]",
    'time = "t"\ngyro = ["p", "q"]': "gyro: needs 3 columns, not 2",
    'time = "t"\ngyro = ["p", "p", "r"]': "gyro: names a column twice",
    'time = "t"\ngyro = { columns = ["p", "q", "r"], unit = "rpm" }': "unit must be one of rad/s",
    'time = "t"\ngyro = { columns = ["p", "q", "r"], frame = "XYZ" }': "frame must be one of FRD",
    'time = "t"\ngyros = ["p", "q", "r"]': "unknown key 'gyros'",
    'time = 1\ngyro = ["p", "q", "r"]': "time must be text",
    'time = "t"\ngyro = 3': "gyro: must be a table with columns",
    'time = "t"\ncommands = { columns = ["a"], min = 2, max = 1 }': "min 2 must be less than max 1",
    'time = "t"\nparameters = { A = "x" }\ngyro = ["p", "q", "r"]\nspeeds = ["m"]': "A must be a n",
    'time = "t"\nposition = ["a", "b", "c"]\ngyro = ["p", "q", "r"]\nspeeds = ["m"]': "needs .vel",
}


@pytest.mark.parametrize("text", WRONG_MAPPINGS)
def test_a_wrong_mapping_is_said_in_one_line(tmp_path, text):
    path = tmp_path / "m.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=WRONG_MAPPINGS[text]) as caught:
        read_mapping(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("a,b\n1,2\n", "has no column 'stamp'"),
        ("", "has no column 'stamp'"),
        ("HEADER\n", "a header and no rows"),
        ("HEADER\nROW\nBAD\n", "line 3, column 'p': 'abc' is no number"),
        ("HEADER\nROW\nROW\n", "never rise"),
        (b"\xff\xfe\x00\x01" * 20, "neither text nor Parquet"),
        (b"PAR1" + b"x" * 100, "Parquet"),
    ],
)
def test_a_table_that_does_not_fit_is_said_in_one_line(folder, content, said, capsys):
    path = folder / "a.csv"
    if isinstance(content, str):
        names = list(columns())
        row = ",".join("1" for _ in names)
        content = content.replace("HEADER", ",".join(names)).replace("ROW", row)
        content = content.replace("BAD", row.replace("1,1,", "2,abc,", 1)).encode()
    path.write_bytes(content)
    assert run(["health", str(path)]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert error.startswith("gcs-sysid: error: ")


def test_a_table_without_mapping_says_what_it_needs(tmp_path, capsys):
    write_csv(tmp_path / "a.csv", columns())
    assert run(["inspect", str(tmp_path / "a.csv")]) == 2
    assert "--csv MAPPING.toml" in capsys.readouterr().err
    assert run(["inspect", str(tmp_path / "a.csv"), "--csv", str(tmp_path / "no.toml")]) == 2
    assert "no.toml: no such file" in capsys.readouterr().err


def test_folders_hold_tables_that_are_mapped(folder):
    other = folder / "other"
    other.mkdir()
    for path in (folder / "a.csv", other / "b.csv"):
        write_csv(path, columns())
    assert find_logs([folder]) == [folder / "a.csv"]
    found = find_logs([folder], folder / "columns.toml")
    assert [str(path) for path in found] == [
        f"{folder}/a.csv#columns.toml",
        f"{other}/b.csv#{folder}/columns.toml",
    ]


def test_inspect_reads_a_table(folder, capsys):
    write_csv(folder / "a.csv", columns())
    assert run(["inspect", str(folder / "a.csv"), "--csv", str(folder / "columns.toml")]) == 0
    told = capsys.readouterr().out
    assert "table of signals" in told
    assert "100.0 Hz" in told
