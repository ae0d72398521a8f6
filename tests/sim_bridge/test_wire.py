"""MAVLink 1 and signed frames, as pymavlink reads them."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sim_bridge
from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.cli import main, read_key
from sim_bridge.missions import MISSIONS
from sim_bridge.px4 import Px4
from sim_bridge.simulated_vehicle import Vehicle
from sim_bridge.simulation import Simulation
from sim_bridge.wire import BASE_LENGTHS, FrameWriter, Signer
from tests.pymavlink_xml import SIZES, definitions

Reader = Callable[[Path], Iterator[tuple[int, Any]]]

DEFINED = definitions("minimal", "standard", "common")
KEY = bytes(range(32))
NOW_US = 1_700_000_000_000_000


def test_lengths_of_version_1_are_those_of_the_definitions() -> None:
    """Of every message that the emulator makes and that has extension fields."""
    sources = Path(sim_bridge.__file__).parent.rglob("*.py")
    made = "".join(path.read_text(encoding="utf-8") for path in sources)
    names = {name.upper() for name in re.findall(r"mavlink\.MAVLink_(\w+)_message", made)}
    lengths = {
        number: sum(SIZES[kind] * max(length, 1) for kind, length, _ in fields)
        for number, (name, fields, extension) in DEFINED.items()
        if extension and number <= 255 and name in names
    }
    assert lengths == BASE_LENGTHS


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_a_flight_in_version_1(autopilot: str, tmp_path: Path, read_tlog: Reader) -> None:
    path = tmp_path / "f.tlog"
    options = ["--mavlink", "1", "--autopilot", autopilot, "--noise", "none", "--duration", "2"]
    assert main([*options, "--tlog", str(path)]) == 0
    messages = [message for _, message in read_tlog(path)]
    assert {m.get_msgbuf()[0] for m in messages} == {0xFE}
    names = {m.get_type() for m in messages}
    assert {"HIGHRES_IMU", "ATTITUDE", "SERVO_OUTPUT_RAW", "HEARTBEAT"} <= names
    assert not names & {"ESC_STATUS", "ACTUATOR_OUTPUT_STATUS", "ESC_TELEMETRY_1_TO_4"}
    assert [m.get_seq() for m in messages] == [i % 256 for i in range(len(messages))]
    servo = next(m for m in messages if m.get_type() == "SERVO_OUTPUT_RAW")
    assert servo.servo1_raw > 1000
    assert servo.servo9_raw == 0  # an extension: not there


def signing_reader(key: bytes) -> Any:
    parser = mavlink.MAVLink(None)
    parser.signing.secret_key = key
    parser.robust_parsing = True
    return parser


def test_signed_frames_satisfy_pymavlink_with_the_key_and_only_then() -> None:
    writer = FrameWriter(signer=Signer(KEY, lambda: NOW_US, link=3))
    frames = [
        writer.frame(mavlink.MAVLink_heartbeat_message, 0, 2, 12, 128, 4, 3) for _ in range(3)
    ]
    reader = signing_reader(KEY)
    assert [reader.decode(bytearray(f)).get_type() for f in frames] == ["HEARTBEAT"] * 3
    assert reader.signing.goodsig_count == 3
    stamps = [int.from_bytes(f[-12:-6], "little") for f in frames]
    assert stamps[0] == (NOW_US - 1_420_070_400_000_000) // 10
    assert np.diff(stamps).tolist() == [1, 1]
    with pytest.raises(mavlink.MAVError, match="Invalid signature"):
        signing_reader(bytes(32)).decode(bytearray(frames[0]))


@pytest.fixture
def signed_desk(paper_vehicle: Vehicle, open_desk: Any) -> Any:
    gusts, sensors = np.random.SeedSequence(0).spawn(2)
    simulation = Simulation(paper_vehicle, MISSIONS["hover"], gusts, 0.0)
    writer = FrameWriter(signer=Signer(KEY, lambda: NOW_US))
    desk = open_desk(simulation, Px4(simulation, "none", 0.0, 50.0, sensors, writer=writer))
    desk.parser = signing_reader(KEY)
    return desk


@pytest.mark.parametrize(("key", "answers"), [(KEY, 1), (bytes(32), 0), (None, 0)])
def test_a_signing_vehicle_obeys_its_key_alone(
    signed_desk: Any, key: bytes | None, answers: int
) -> None:
    if key is not None:
        signed_desk.sender.signing.secret_key = key
        signed_desk.sender.signing.sign_outgoing = True
        signed_desk.sender.signing.timestamp = NOW_US // 10
    ask = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    assert len(signed_desk.command(ask, 105, 20_000)) == answers


@pytest.mark.parametrize(
    "content", [KEY, KEY.hex().encode(), KEY.hex().upper().encode() + b"\n"], ids=repr
)
def test_a_key_is_raw_or_hexadecimal(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "key"
    path.write_bytes(content)
    assert read_key(path) == KEY
