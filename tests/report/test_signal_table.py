"""`export --signals`: what the estimator took and left, as files that other programs read."""

import io
import json
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from gcs_sysid.cli.program import run
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.report.data import signal_table, writer_of
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.logs import open_log
from gcs_sysid.twin.measured_flight import FlightRecorder

MAPPING = """
time = "t"
gyro = ["gyro_x", "gyro_y", "gyro_z"]
force = ["force_x", "force_y", "force_z"]
attitude = ["q_w", "q_x", "q_y", "q_z"]
velocity = ["v_north", "v_east", "v_down"]
speeds = ["rotor_speed_1", "rotor_speed_2", "rotor_speed_3", "rotor_speed_4"]
in_air = "flying"
"""


@pytest.fixture(scope="module")
def analyzed(paper_flight):
    airframe = load_airframe("paper").with_anchor("mass", 1.5)
    with closing(FlightRecorder()) as recorder:
        result = analyze_log(paper_flight.tlog, airframe, observers=[recorder])
        return signal_table(result, recorder, airframe), result


@pytest.mark.slow
def test_residuals_are_what_the_fit_leaves(analyzed):
    table, result = analyzed
    assert (np.diff(table["t"]) > 0.0).all()
    for axis in ("roll", "pitch", "yaw"):
        measured, rest = table[f"{axis}_acceleration"], table[f"{axis}_residual"]
        there = np.isfinite(rest)
        assert there.mean() > 0.5
        np.testing.assert_allclose(
            rest[there], (measured - table[f"{axis}_acceleration_predicted"])[there]
        )
    # The article's flight has every axis excited in turn; the fit explains the motion.
    explained = 1.0 - np.nanvar(table["roll_residual"]) / np.nanvar(table["roll_acceleration"])
    assert explained > 0.8
    assert result.rotor_input == "speed"


@pytest.mark.slow
def test_csv_comes_back_as_the_log_it_is_from(analyzed, tmp_path):
    table, _ = analyzed
    (tmp_path / "columns.toml").write_text(MAPPING)
    (tmp_path / "a.csv").write_bytes(writer_of(Path("a.csv"))(table))
    (block,) = open_log(tmp_path / "a.csv").blocks()
    tracks = {track.stream: track for track in block.tracks}
    imu = np.column_stack([table[f"{kind}_{axis}"] for kind in ("gyro", "force") for axis in "xyz"])
    there = np.isfinite(imu[:, :3]).all(axis=1)
    np.testing.assert_allclose(tracks[Stream.IMU].values, imu[there], rtol=1e-7, atol=1e-8)
    speeds = np.column_stack([table[f"rotor_speed_{i}"] for i in range(1, 5)])
    whole = np.isfinite(speeds).all(axis=1)
    np.testing.assert_allclose(tracks[Stream.ROTOR_SPEED].values, speeds[whole], rtol=1e-7)


@pytest.mark.slow
def test_parquet_and_mcap_hold_the_same(analyzed):
    table, _ = analyzed
    parquet = pytest.importorskip("pyarrow.parquet")
    read = parquet.read_table(io.BytesIO(writer_of(Path("a.parquet"))(table)))
    assert read.column_names == list(table)
    np.testing.assert_array_equal(read.column("yaw_residual").to_numpy(), table["yaw_residual"])
    reader = pytest.importorskip("mcap.reader")
    data = io.BytesIO(writer_of(Path("a.mcap"))(table))
    messages = [
        (message.log_time, json.loads(message.data))
        for _, _, message in reader.make_reader(data).iter_messages()
    ]
    assert len(messages) == len(table["t"])
    at = len(messages) // 2
    stamp, values = messages[at]
    assert stamp == pytest.approx(1e9 * table["t"][at])
    for name, value in values.items():
        assert value == table[name][at]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--signals", "a.txt"], "writes .csv, .parquet or .mcap"),
        (["--signals", "a.csv", "--to", "urdf"], "neither --to nor -o"),
        (["--signals", "a.csv"], "which airframe?"),
        (["--signals", "a.csv", "--airframe", "px4-quad-x"], "nothing sets the scale"),
        ([], "give --to FORMAT and --output FILE, or --signals FILE"),
        (["--signals", "none/a.csv"], "no such folder"),
    ],
)
def test_what_cannot_be_written_is_said(options, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flight.tlog").write_bytes(b"")
    assert run(["export", "flight.tlog", *options]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


@pytest.mark.slow
def test_the_command_writes_a_table_once(paper_flight, tmp_path, capsys):
    target = str(tmp_path / "a.csv")
    command = ["export", str(paper_flight.tlog), "--signals", target, "--airframe", "paper"]
    assert run([*command, "--mass", "1.5"]) == 0
    assert "rows of 34 columns" in capsys.readouterr().out
    assert run([*command, "--mass", "1.5"]) == 2
    assert "--force overwrites it" in capsys.readouterr().err
