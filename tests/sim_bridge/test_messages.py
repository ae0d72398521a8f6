"""What is on the wire, read by pymavlink with the project's dialect."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.autopilot import EPOCH_US
from sim_bridge.cli import main
from sim_bridge.simulated_vehicle import Vehicle

Read = Callable[[Path], Any]


@pytest.fixture(scope="module")
def records(tlog: Path, read_tlog: Read) -> list[tuple[int, Any]]:
    return list(read_tlog(tlog))


def of_type(records: list[tuple[int, Any]], name: str) -> list[Any]:
    return [m for _, m in records if m.get_type() == name]


def clock_us(message: Any) -> int | None:
    """The vehicle's clock as the message carries it."""
    for field, unit in (("time_usec", 1), ("time_boot_ms", 1000)):
        if hasattr(message, field):
            return int(getattr(message, field)) * unit
    return None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "hertz"),
    [
        ("HIGHRES_IMU", 250), ("ESC_STATUS", 250), ("ACTUATOR_OUTPUT_STATUS", 250),
        ("SERVO_OUTPUT_RAW", 250), ("ATTITUDE", 100), ("ATTITUDE_QUATERNION", 100),
        ("LOCAL_POSITION_NED", 50), ("EXTENDED_SYS_STATE", 2), ("HEARTBEAT", 1), ("SYS_STATUS", 1),
        ("SYSTEM_TIME", 1), ("ESC_INFO", 1), ("GLOBAL_POSITION_INT", 5),
    ],
)  # fmt: skip
def test_message_set_and_rates(records: list[tuple[int, Any]], name: str, hertz: float) -> None:
    assert len(of_type(records, name)) == 5 * hertz + 1  # 0 s and 5 s included


def test_records_carry_the_vehicle_clock_on_a_fixed_epoch(records: list[tuple[int, Any]]) -> None:
    for stamp, message in records:
        clock = clock_us(message)
        if clock is not None and message.get_type() != "SYSTEM_TIME":
            assert stamp - EPOCH_US == clock
    stamps = [stamp for stamp, _ in records]
    assert stamps == sorted(stamps)
    assert stamps[-1] - stamps[0] == 5_000_000


def test_it_says_that_it_is_a_flying_px4_quadrotor(records: list[tuple[int, Any]]) -> None:
    heartbeat = of_type(records, "HEARTBEAT")[0]
    assert heartbeat.type == mavlink.MAV_TYPE_QUADROTOR
    assert heartbeat.autopilot == mavlink.MAV_AUTOPILOT_PX4
    assert heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    state = of_type(records, "EXTENDED_SYS_STATE")[0]
    assert state.landed_state == mavlink.MAV_LANDED_STATE_IN_AIR


def test_rotor_speeds_are_those_of_the_physics(
    records: list[tuple[int, Any]], paper_vehicle: Vehicle
) -> None:
    first = of_type(records, "ESC_STATUS")[0]
    speeds = np.array(first.rpm) * math.pi / 30.0
    shares = paper_vehicle.k_T * speeds**2 / (1.5 * 9.80665)
    np.testing.assert_allclose(shares, [0.4, 0.1, 0.3, 0.2], atol=0.01)
    assert first.index == 0
    assert all(v > 10.0 for v in first.voltage)
    assert all(c > 0.0 for c in first.current)


def test_commands_follow_the_thrust_curve(
    records: list[tuple[int, Any]], paper_vehicle: Vehicle
) -> None:
    first = of_type(records, "ACTUATOR_OUTPUT_STATUS")[0]
    assert first.active == 4
    assert not any(first.actuator[4:])
    u = (np.array(first.actuator[:4]) - 1000.0) / 1000.0
    thrust = paper_vehicle.T_max * (0.5 * u + 0.5 * u * u)
    np.testing.assert_allclose(thrust / (1.5 * 9.80665), [0.4, 0.1, 0.3, 0.2], atol=1e-6)
    servo = of_type(records, "SERVO_OUTPUT_RAW")[0]
    assert servo.servo1_raw == round(first.actuator[0])
    assert servo.servo5_raw == 0


def test_a_hexarotor_reports_two_groups(tmp_path: Path, read_tlog: Read) -> None:
    path = tmp_path / "hexa.tlog"
    assert main(["--airframe", "px4-hexa-x", "--tlog", str(path), "--duration", "1"]) == 0
    records = list(read_tlog(path))
    status = of_type(records, "ESC_STATUS")
    assert [m.index for m in status[:4]] == [0, 4, 0, 4]
    assert all(status[0].rpm)
    assert [bool(x) for x in status[1].rpm] == [True, True, False, False]
    assert of_type(records, "HEARTBEAT")[0].type == mavlink.MAV_TYPE_HEXAROTOR
    assert of_type(records, "ACTUATOR_OUTPUT_STATUS")[0].active == 6
    info = of_type(records, "ESC_INFO")[0]
    assert (info.count, info.info) == (6, 0b111111)


def test_a_low_rate_lowers_all_fast_streams(tmp_path: Path, read_tlog: Read) -> None:
    path = tmp_path / "slow.tlog"
    assert main(["--rate", "20", "--tlog", str(path), "--duration", "2"]) == 0
    records = list(read_tlog(path))
    for name in ("HIGHRES_IMU", "ATTITUDE", "ESC_STATUS", "LOCAL_POSITION_NED"):
        assert len(of_type(records, name)) == 41, name


def test_truth_is_flat_and_has_every_name(tmp_path: Path) -> None:
    truth = tmp_path / "t.json"
    options = ["--tlog", str(tmp_path / "f.tlog"), "--duration", "2", "--truth", str(truth)]
    assert main(options) == 0
    content = json.loads(truth.read_text())
    assert content["mass"] == 1.5
    assert all(isinstance(v, float) for v in content.values())
    assert {"rotor_delay", "motor_lag", "moment_ratio", "T_max"} <= set(content)


def test_truth_after_a_mass_step_is_that_at_the_end(tmp_path: Path) -> None:
    truth = tmp_path / "t.json"
    options = ["--tlog", str(tmp_path / "f.tlog"), "--duration", "2", "--truth", str(truth)]
    assert main([*options, "--mass-step", "1:1.2"]) == 0
    content = json.loads(truth.read_text())
    assert content["mass"] == pytest.approx(1.8)
    (event,) = content["events"]
    assert (event["t"], event["kind"]) == (1.0, "mass_change")
    assert event["before"]["mass"] == 1.5
    assert event["after"]["mass"] == pytest.approx(1.8)
    assert event["time_usec"] == 21_000_000


def test_a_truth_file_takes_no_other_files_place_unasked(tmp_path: Path, capsys: Any) -> None:
    log, truth = tmp_path / "f.tlog", tmp_path / "t.json"
    truth.write_text("mine")
    fly = ["--tlog", str(log), "--duration", "0.1", "--truth"]
    assert main([*fly, str(truth)]) == 2
    assert "t.json exists; --force replaces it" in capsys.readouterr().err
    assert truth.read_text() == "mine"
    assert not log.exists()
    assert main([*fly, str(log), "--force"]) == 2
    assert "name the same file" in capsys.readouterr().err
    assert main([*fly, str(truth), "--force"]) == 0
    assert json.loads(truth.read_text())["mass"] == 1.5
