"""Autopilots without physics, for tests that look at what a vehicle is sent."""

from collections import Counter, defaultdict

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import FrameScanner
from gcs_sysid.telemetry.messages import message_name
from testbed.fuzz.link_harnesses import check_sent
from testbed.payloads import unpack

SETS, GROUPS, READS = "SET_MESSAGE_INTERVAL", "REQUEST_DATA_STREAM", "PARAM_REQUEST_READ"
INTERVALS, MESSAGES = "GET_MESSAGE_INTERVAL", "REQUEST_MESSAGE"
_COMMANDS = {511: SETS, 510: INTERVALS, 512: MESSAGES}
_DATA_US = 50_000
"""us between two messages of those that are sent; all others are off."""
_ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED


class Autopilot:
    """Speaks, answers, provokes, and judges every message that it is sent.

    Args:
        autopilot: MAV_AUTOPILOT.
        version: of MAVLink.
        mute: sends heartbeats and acknowledges, and nothing more.
        old: knows groups of messages alone, as ArduPilot before 4.0.
        key: signs with it; None: unsigned.

    Attributes:
        received: bytes.
        understood: of those, how many were whole messages.
        targets: (sysid, compid) that were asked for something.
        asked: name of a message, or of a command -> the messages, groups or parameters that it
            asked for (None: for nothing) -> how often.
        own_rate: message -> whether the last that was asked for it was the vehicle's own rate.
        signed: whether messages were signed; both, when some were.
    """

    def __init__(
        self, autopilot=mavlink.MAV_AUTOPILOT_PX4, *, version=2, mute=False, old=False, key=None
    ):
        self.received = 0
        self.asked = defaultdict(Counter)
        self.understood = 0
        self.targets = set()
        self.own_rate = {}
        self.signed = set()
        self.now = 10.0
        self._autopilot, self._version, self._mute, self._old = autopilot, version, mute, old
        self._packers = [mavlink.MAVLink(None, srcSystem=n, srcComponent=1) for n in (1, 2)]
        for packer in self._packers:
            packer.signing.secret_key, packer.signing.sign_outgoing = key, key is not None
            packer.signing.timestamp = 2**47
        self._scanner = FrameScanner()
        self._beat_at = 0.0

    def _packed(self, message, sender=0):
        packer = self._packers[sender]
        raw = bytes(message.pack(packer, force_mavlink1=self._version == 1))
        packer.seq = (packer.seq + 1) % 256
        return raw

    def speak(self, seconds=0.05):
        """What is sent in the next moment: frames."""
        self.now += seconds
        said = []
        if self.now - self._beat_at >= 1.0:
            self._beat_at = self.now
            beat = mavlink.MAVLink_heartbeat_message(2, self._autopilot, _ARMED, 0, 4, 3)
            said += [self._packed(beat), self._packed(beat, 1), *map(self._packed, _provocations())]
        if not self._mute:
            said += map(self._packed, self._data())
        return said

    def _data(self):
        us, ms = round(1e6 * self.now), round(1e3 * self.now)
        still = (0.0, 0.0, -9.8, 0.01, 0.0, 0.0)
        if self._old:
            yield mavlink.MAVLink_raw_imu_message(us, 0, 0, -1000, 10, 0, 0, 0, 0, 0)
        else:
            yield mavlink.MAVLink_highres_imu_message(us, *still, 0, 0, 0, 1013, 0, 0, 20, 63, 0)
        yield mavlink.MAVLink_attitude_message(ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def notice(self, data):
        """Take bytes; the answers."""
        self.received += len(data)
        answers = []
        for frame in self._scanner.feed(data):
            fields = unpack(frame.message_id, frame.payload)
            self._judge(frame, fields)
            sender = max(fields.get("target_system", 1) - 1, 0)
            if frame.message_id == mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
                said = mavlink.MAV_RESULT_UNSUPPORTED if self._old else mavlink.MAV_RESULT_ACCEPTED
                answer = mavlink.MAVLink_command_ack_message(fields["command"], said)
                answers += self._intervals(fields, sender)
            elif frame.message_id == mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ:
                name = fields["param_id"].encode()
                answer = mavlink.MAVLink_param_value_message(name, 1.5, 9, 900, 1)
            else:
                continue
            answers.append(self._packed(answer, sender))
        return answers

    def _intervals(self, fields, sender):
        """MESSAGE_INTERVAL, where it is asked for and known."""
        if self._mute or self._old or fields["command"] not in (510, 512):
            return
        asked = int(fields["param1" if fields["command"] == 510 else "param2"])
        own = self._own(message_name(asked))
        yield self._packed(mavlink.MAVLink_message_interval_message(asked, own), sender)

    def _own(self, name):
        """us between two messages, as SET_MESSAGE_INTERVAL has it; 0 where nobody can know."""
        imu = "RAW_IMU" if self._old else "HIGHRES_IMU"
        if not self._mute and name in (imu, "ATTITUDE"):
            return _DATA_US
        return 0 if self._mute or self._old else -1

    def _judge(self, frame, fields):
        """Count what was sent by kind: none is harmful."""
        check_sent(frame.raw)
        self.understood += len(frame.raw)
        kind, what = message_name(frame.message_id), None
        if kind == "COMMAND_LONG":
            kind, what = _COMMANDS[fields["command"]], message_name(int(fields["param1"]))
            if kind == SETS:
                own = self._own(what)
                self.own_rate[what] = abs(fields["param2"] - own) <= 0.05 * max(own, 0)
        elif kind == GROUPS:
            what = fields["req_stream_id"]
        elif kind == READS:
            what = fields["param_id"]
        self.asked[kind][what] += 1
        if "target_system" in fields:
            self.targets.add((fields["target_system"], fields["target_component"]))
        self.signed.add(frame.signed)


def _provocations():
    """What asks for an answer, of a ground station that knows all of MAVLink."""
    to = (245, 190)
    yield mavlink.MAVLink_timesync_message(0, 123_456_789)
    yield mavlink.MAVLink_param_request_list_message(*to)
    yield mavlink.MAVLink_param_request_read_message(*to, b"SYS_AUTOSTART", -1)
    for command in (
        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
        mavlink.MAV_CMD_REQUEST_MESSAGE,
        mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
    ):
        yield mavlink.MAVLink_command_long_message(*to, command, 0, 0, 0, 0, 0, 0, 0, 0)
    yield mavlink.MAVLink_request_data_stream_message(*to, 0, 4, 1)
