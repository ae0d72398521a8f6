"""Only what cannot harm is ever sent."""

import ast
import random
import re
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import all as everything

import gcs_sysid
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import Validity, read_frame
from gcs_sysid.telemetry.outgoing import (
    ADMITTED,
    FILE_HEADER,
    FileRequest,
    Gate,
    NotAllowedError,
    is_allowed,
)
from testbed.payloads import unpack

PACKAGE = Path(gcs_sysid.__file__).parent
SECURITY = Path(__file__).parents[2] / "docs" / "security.md"
ALLOWED = {
    "HEARTBEAT", "COMMAND_LONG", "REQUEST_DATA_STREAM", "PARAM_REQUEST_READ", "LOG_REQUEST_LIST",
    "LOG_REQUEST_DATA", "LOG_REQUEST_END", "FILE_TRANSFER_PROTOCOL",
}  # fmt: skip
"""In harmless forms alone."""
ALLOWED_COMMANDS = {510, 511, 512}
ASKED_FOR = {
    "HIGHRES_IMU", "RAW_IMU", "ATTITUDE", "LOCAL_POSITION_NED", "EXTENDED_SYS_STATE",
    "ESC_STATUS", "ESC_TELEMETRY_1_TO_4", "ESC_TELEMETRY_5_TO_8", "ESC_TELEMETRY_9_TO_12",
    "ESC_TELEMETRY_13_TO_16", "ACTUATOR_OUTPUT_STATUS", "SERVO_OUTPUT_RAW",
}  # fmt: skip
"""What the tool itself asks for; it may be stopped again, and nothing else."""


@pytest.fixture
def sent():
    return []


@pytest.fixture
def gate(sent):
    return Gate(sent.append)


def command(number, p1=105.0, p2=0.0, rest=(0.0,) * 5, target=(1, 1)):
    return mavlink.MAVLink_command_long_message(*target, number, 0, p1, p2, *rest)


@pytest.mark.parametrize("cls", mavlink.mavlink_map.values(), ids=lambda cls: cls.msgname)
def test_no_other_message_can_be_sent(cls, gate, sent, make_message):
    rng = random.Random(1)
    for _ in range(50):
        message = make_message(cls, rng)
        if not is_allowed(message):
            with pytest.raises(NotAllowedError):
                gate.send(message)
    if cls.msgname not in ALLOWED:
        assert not sent


def test_no_other_command_can_be_sent():
    known = set(everything.enums["MAV_CMD"]) | ALLOWED_COMMANDS
    few = {0.0, 1.0, 105.0, 148.0, 244.0, 300.0}
    names = set(mavlink.mavlink_map) | few
    forms = {(n, float(p1), p2) for n in ALLOWED_COMMANDS for p1 in names for p2 in (0.0, 105.0)}
    others = known | set(range(0, 65536, 31))
    forms |= {(n, p1, p2) for n in others for p1 in few for p2 in (0.0, 105.0)}
    passing = {form for form in forms if is_allowed(command(*form))}
    assert {n for n, *_ in passing} == ALLOWED_COMMANDS
    # Of all messages only the one that tells an interval may be asked for, of one that is used.
    assert {form for form in passing if form[0] == 512} == {(512, 244.0, 105.0)}
    rated = {mavlink.mavlink_map[p1].msgname for n, p1, _ in passing if n in (510, 511)}
    assert rated == ASKED_FOR


def test_the_page_on_security_names_what_the_gate_admits_and_nothing_else():
    text = SECURITY.read_text(encoding="utf-8")
    section = text.partition("## Sending")[2].partition("\n## ")[0]
    named = set(re.findall(r"(?<!@)\b[A-Z][A-Z_]{3,}[A-Z]\b", section))
    commands = {
        everything.enums["MAV_CMD"][n].name.removeprefix("MAV_CMD_") for n in ALLOWED_COMMANDS
    }
    assert {mavlink.mavlink_map[n].msgname for n in ADMITTED} == ALLOWED
    assert named == ALLOWED | commands


def test_no_other_message_can_be_stopped():
    names = {c.msgname for n, c in mavlink.mavlink_map.items() if is_allowed(command(511, n, -1.0))}
    assert names == ASKED_FOR


def group(stream, rate, start=1, target=(1, 1)):
    return mavlink.MAVLink_request_data_stream_message(*target, stream, rate, start)


def test_no_other_group_can_be_asked_for():
    forms = [(s, r, b) for s in range(256) for r in (0, 1, 50, 51, 65535) for b in (0, 1, 2, 255)]
    forms += [(1, r, b) for r in (0, 1, 50) for b in range(256)]
    passing = {form for form in forms if is_allowed(group(*form))}
    streams = {1, 3, 6, 10, 12}
    started = {(s, r, 1) for s in streams for r in (1, 50)}
    # A rate of 0 stops: the way back to a vehicle that was silent.
    stopped = {(s, 0, 0) for s in streams}
    assert passing == started | stopped


def file_request(opcode, path="", size=None, target=(0, 1, 1), asked=0, session=0):
    size = len(path) if size is None else size
    head = FILE_HEADER.pack(1, session, opcode, size, asked, 0, 0)
    payload = (head + path.encode()).ljust(251, b"\0")
    return mavlink.MAVLink_file_transfer_protocol_message(*target, payload)


def test_files_are_listed_opened_read_and_closed_under_the_logs_and_nothing_else():
    log = "@MAV_LOG/2026-01-02/03_04_05.ulg"
    paths = ["", "@MAV_LOG", log, "/", "/fs/microsd/log", "@MAV_LOG/..", "@MAV_LOG/../etc/x",
             "@MAV_LOG/a b", "@MAV_LOGS/1", "@PARAM/param.pck", "@SYS/threads.txt"]  # fmt: skip
    passing = {(o, p) for o in range(256) for p in paths if is_allowed(file_request(o, p))}
    named = {(opcode, path) for opcode in (3, 4) for path in ("@MAV_LOG", log)}
    assert passing == named | {(1, ""), (5, "")}
    assert is_allowed(file_request(5, size=239))
    assert not is_allowed(file_request(5, size=240))
    assert not is_allowed(file_request(4, log, size=8))
    assert not is_allowed(file_request(4, log, asked=4))
    assert not is_allowed(file_request(4, log, target=(0, 0, 0)))
    assert not is_allowed(file_request(4, log, target=(1, 1, 1)))


@pytest.mark.parametrize(
    "message",
    [
        group(0, 4),  # all of them
        group(1, 50, target=(0, 0)),
        command(511, 33.0, -1.0),  # would switch off what somebody else asked for
        command(511, 0.0, -1.0),
        command(512, 244.0, 60_999.0),
        command(512, 244.0, 105.0, rest=(0.0, 0.0, 0.0, 0.0, 2.0)),
        command(511, 105.0, 1e9),
        command(511, 60_999.0, 4000.0),
        command(511, 105.5, 4000.0),
        command(511, float("nan"), 4000.0),
        command(511, 105.0, 4000.0, rest=(1.0, 0.0, 0.0, 0.0, 0.0)),
        command(511, 105.0, 4000.0, target=(0, 0)),
        command(512, 148.0),
        command(511, 105.0, 499.0),  # faster than any autopilot can
        command(511, 105.0, -0.5),
        command(511, float("inf"), 4000.0),
        command(510, 105.0, 1.0),
        mavlink.MAVLink_command_long_message(1, 1, 511, 1, 105.0, 4000.0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_timesync_message(tc1=5, ts1=7),  # an answer
        mavlink.MAVLink_timesync_message(tc1=0, ts1=-1),
        mavlink.MAVLink_param_request_read_message(1, 1, b"", 7),  # by number
        mavlink.MAVLink_param_request_read_message(1, 1, b"A\x1b[2J", -1),
        mavlink.MAVLink_param_request_read_message(0, 0, b"SYS_AUTOSTART", -1),
        mavlink.MAVLink_param_request_list_message(0, 0),
        mavlink.MAVLink_log_request_list_message(0, 0, 0, 65535),
        mavlink.MAVLink_log_request_data_message(0, 0, 1, 0, 90),
        mavlink.MAVLink_log_erase_message(1, 1),
        mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3),  # would pose as a vehicle
        mavlink.MAVLink_heartbeat_message(6, 8, 128, 0, 4, 3),
    ],
)
def test_harmful_forms_of_allowed_messages_are_refused(message, gate, sent):
    with pytest.raises(NotAllowedError, match="must never be sent"):
        gate.send(message)
    assert not sent


def speak(gate):
    return [
        gate.heartbeat(),
        gate.set_message_interval((1, 1), 105, 4000),
        gate.set_message_interval((1, 1), 105, 0),
        gate.set_message_interval((1, 1), 105, -1),
        gate.get_message_interval((1, 1), 105),
        gate.request_message_interval((1, 1), 105),
        gate.request_group((1, 1), 1, 50),
        gate.request_group((1, 1), 1, 0),
        gate.read_parameter((1, 1), "INS_GYRO_FILTER"),
        gate.request_log_list((1, 1)),
        gate.request_log_data((1, 1), 7, 90, 90),
        gate.end_log_requests((1, 1)),
        gate.request_file((1, 1), 1, 0, FileRequest.LIST_DIRECTORY, 0, 8, b"@MAV_LOG"),
    ]


def test_everything_the_gate_offers_passes_and_is_ours(gate, sent):
    assert all(speak(gate))
    frames = [read_frame(raw) for raw in sent]
    assert all(frame.valid is Validity.OK for frame in frames)
    assert {(frame.system, frame.component) for frame in frames} == {(245, 190)}
    assert [frame.sequence for frame in frames] == list(range(13))
    interval = unpack(76, frames[1].payload)
    assert (interval["command"], interval["param1"], interval["param2"]) == (511, 105.0, 4000.0)


def test_listening_only_sends_nothing_at_all(sent):
    gate = Gate(sent.append, listen_only=True)
    assert not any(speak(gate))
    assert sent == []
    with pytest.raises(NotAllowedError):
        gate.send(command(400))


def test_version_1_is_spoken_to_those_that_speak_it(gate, sent):
    gate.version = 1
    gate.heartbeat()
    assert read_frame(sent[0]).version == 1


def modules(words):
    """(name, tree) of every module with one of these words."""
    for path in sorted(PACKAGE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if re.search(words, text):
            yield path.relative_to(PACKAGE).as_posix(), ast.parse(text)


def test_no_other_module_writes_to_a_link_or_socket():
    calls = {"send", "sendto", "sendall", "sendmsg", "send_bytes"}
    writers = set()
    for name, tree in modules(rf"\.({'|'.join(calls)})\b"):
        for node in ast.walk(tree):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and node.func.attr in calls
            ):
                writers.add(name)
    # web/ speaks to browsers.
    links = {"telemetry/link.py", "telemetry/outgoing.py"}
    assert writers <= links | {"web/share.py"}


def test_no_other_module_opens_a_socket_or_a_port():
    users = set()
    for name, tree in modules("socket|serial|asyncio|mavutil"):
        for node in ast.walk(tree):
            imported = []
            if isinstance(node, ast.Import):
                imported = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                imported = [node.module or ""]
            if any(i.split(".")[0] in ("socket", "serial", "asyncio") for i in imported) or any(
                i == "pymavlink.mavutil" for i in imported
            ):
                users.add(name)
    # Screens may use asyncio for their timers; web/ speaks to browsers.
    users = {user for user in users if not user.startswith(("screen/", "web/"))}
    assert users <= {"telemetry/link.py"}


def test_what_speaks_to_browsers_never_has_a_link():
    """web/ has sockets of its own, but nothing that leads to a vehicle."""
    for name, tree in modules("telemetry|pymavlink"):
        for node in ast.walk(tree) if name.startswith("web/") else ():
            named = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            named += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            files = ("gcs_sysid.telemetry.logs", "gcs_sysid.telemetry.log_formats")
            named = [n for n in named if n not in files]
            assert not [n for n in named if n.startswith(("gcs_sysid.telemetry", "pymavlink"))]
