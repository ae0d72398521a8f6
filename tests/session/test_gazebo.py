"""A simulated iris whose commands were logged more slowly than its dynamics: know what to trust."""

import csv
import json
import struct
from pathlib import Path

import pytest

from gcs_sysid.model.airframe import parse_airframe
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.telemetry.dialect import mavlink

LOGS = Path(__file__).resolve().parents[3] / "shared" / "logs" / "public"

pytestmark = [
    pytest.mark.thorough,  # slow commands of another flight: tests/session/test_real_logs.py
    pytest.mark.skipif(not LOGS.is_dir(), reason="no ../shared/logs beside the project"),
]

FULL_SPEED = 1100.0
"""rad/s at 2000 us. Gazebo's motors turn at u - 900 rad/s."""
# Front right, rear left, front left, rear right.
ROTORS = ((0.13, 0.22, "ccw"), (-0.13, -0.2, "ccw"), (0.13, -0.22, "cw"), (-0.13, 0.2, "cw"))


def as_tlog(table: Path, log: Path) -> None:
    """The CSV as the messages that a PX4 would have sent of it."""
    packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)

    def write(file, t, message):
        file.write(struct.pack(">Q", t) + message.pack(packer))
        packer.seq = (packer.seq + 1) % 256

    armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    with open(table) as rows, open(log, "wb") as file:
        for i, row in enumerate(csv.DictReader(rows)):
            v = {k: float(x) for k, x in row.items() if k and x}
            t = round(v["timestamp"])
            if i % 100 == 0:
                write(file, t, mavlink.MAVLink_heartbeat_message(2, 12, armed, 0, 4, 3))
                landed = 1 if v.get("landed") else 2
                write(file, t, mavlink.MAVLink_extended_sys_state_message(0, landed))
            acc = [v[f"acc_b_{axis}"] for axis in "xyz"]
            gyro = [v[f"ang_vel_{axis}"] for axis in "xyz"]
            rest = [0.0] * 7
            write(file, t, mavlink.MAVLink_highres_imu_message(t, *acc, *gyro, *rest, 63))
            q = [v[f"q{k}"] for k in range(4)]
            ms = t // 1000
            write(file, t, mavlink.MAVLink_attitude_quaternion_message(ms, *q, 0.0, 0.0, 0.0))
            u = [v[f"u{k}"] for k in range(4)] + [0.0] * 28
            write(file, t, mavlink.MAVLink_actuator_output_status_message(t, 4, u))
            velocity = [v[f"v{axis}"] for axis in "xyz"]
            write(file, t, mavlink.MAVLink_local_position_ned_message(ms, 0, 0, 0, *velocity))


def test_mass_and_yaw_are_told_and_the_rest_is_not_claimed(tmp_path):
    truth = json.loads((LOGS / "gazebo-iris.truth.json").read_text())
    log = tmp_path / "iris.tlog"
    as_tlog(LOGS / "gazebo-iris.csv", log)
    airframe = parse_airframe(
        {
            "name": "iris",
            "T_max": truth["rotor_k_T_N_s2"] * FULL_SPEED**2,
            "command": {"min": 900, "max": 2000, "thrust_curve": 1.0},
            # Yaw alone tells Izz over the moment ratio, and little else is in this flight.
            "prior": {"moment_ratio": [truth["rotor_moment_ratio_m"], 0.0006]},
            "rotor": [{"x": x, "y": y, "spin": spin} for x, y, spin in ROTORS],
        },
        "iris",
    )
    result = analyze_log(log, airframe)
    found = result.parameters
    assert result.rotor_input == "command"
    assert result.verdict == "partial"
    assert found["mass"].value == pytest.approx(truth["mass"], rel=0.04)
    izz = found["Izz"]
    assert abs(izz.value - truth["izz"]) <= 1.96 * izz.std < 0.25 * truth["izz"]
    for name, true in (("Ixx", truth["ixx"]), ("Iyy", truth["iyy"])):
        holds = abs(found[name].value - true) <= 1.96 * found[name].std
        assert found[name].status in ("weak", "unobservable") or holds, name
