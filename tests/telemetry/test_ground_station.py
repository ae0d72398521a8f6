"""The ground station's side of a conversation, by an invented clock."""

import hashlib

import pytest

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.ground_station import GroundStation
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.link import ReceivedBytes
from gcs_sysid.telemetry.messages import MESSAGE_IDS, message_name
from gcs_sysid.telemetry.transceiver import Transceiver
from testbed.payloads import unpack
from tests.telemetry.in_memory import Ether

KEY = hashlib.sha256(b"correct horse").digest()


class Talk:
    """A station, its link and what it heard, driven by hand."""

    def __init__(self, link=None, **options):
        self.link = link or Ether()
        once = options.pop("connects_once", False)
        self.transceiver = Transceiver(self.link, **options)
        self.station = GroundStation(self.transceiver, 4, 250.0, connects_once=once)
        self.intake = Intake()
        self.now = 0.0
        self.said = []

    def notice(self, *frames, source=("vehicle", 1)):
        self.link.arriving += [ReceivedBytes(frame.raw, source) for frame in frames]
        self.turn(0.0)

    def turn(self, seconds):
        """Let time pass, in steps of 0.2 s."""
        for _ in range(max(1, round(seconds / 0.2))):
            for batch in self.transceiver.receive(0.0):
                self.intake.frames(batch.frames)
            self.station.follow(self.now, self.intake)
            self.station.tick(self.now, self.intake)
            self.said += self.station.take_events()
            self.now += min(seconds, 0.2)

    def requested(self):
        """Names of what was asked for since: messages and parameters."""
        names = []
        for _, frame in self.link.sent:
            fields = unpack(frame.message_id, frame.payload)
            if frame.message_id == mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
                names.append(message_name(int(fields["param1"])))
            elif frame.message_id == mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ:
                names.append(fields["param_id"])
        self.link.sent.clear()
        return names


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / "vehicle.key"
    path.write_bytes(KEY)
    return path


@pytest.fixture
def signing(make_sender):
    """A vehicle that signs with pymavlink's own code."""

    def make(system=1, key=KEY, late=0):
        sender = make_sender(system, 1)
        state = sender.packer.signing
        state.secret_key, state.sign_outgoing = key, True
        # Far ahead of the wall clock of whoever runs this, unless it is late on purpose.
        state.timestamp = 1000 if late else 2**47
        return sender

    return make


def test_a_vehicle_that_is_heard_is_asked_for_streams_and_parameters(sender):
    talk = Talk()
    talk.notice(sender.heartbeat())
    talk.turn(5.0)
    asked = talk.requested()
    assert {"HIGHRES_IMU", "ESC_STATUS", "CA_ROTOR_COUNT", "THR_MDL_FAC"} <= set(asked)


def test_silence_is_told_and_so_is_the_return(sender):
    talk = Talk()
    talk.notice(sender.heartbeat())
    talk.turn(GroundStation.LOST_AFTER - 0.5)
    assert not talk.station.lost
    talk.turn(5.0)
    assert talk.station.lost
    assert sum("link lost: no data from PX4 quadrotor 1:1" in text for text in talk.said) == 1
    talk.requested()
    talk.notice(sender.heartbeat())
    assert not talk.station.lost
    assert any(text.startswith("link back after") for text in talk.said)
    assert "HIGHRES_IMU" in talk.requested()  # it may have forgotten


def test_a_vehicle_that_does_not_number_its_messages_is_not_lost(sender):
    talk = Talk()
    beat = sender.heartbeat()
    for _ in range(10):
        talk.notice(beat)
        talk.turn(1.0)
    assert not talk.station.lost


def test_others_speaking_are_no_sign_of_the_vehicle(sender, make_sender):
    talk = Talk()
    talk.notice(sender.heartbeat())
    other = make_sender(7, 1)
    for _ in range(10):
        talk.turn(1.0)
        talk.notice(other.heartbeat())
    assert talk.station.lost


def test_a_vehicle_that_never_spoke_is_not_lost(make_sender):
    talk = Talk()
    talk.notice(make_sender(255, 190).heartbeat(type=6, autopilot=8))
    talk.turn(20.0)
    assert not talk.station.lost
    assert talk.station.received_at is None


@pytest.mark.parametrize(
    ("once", "said"),
    [(False, " was closed by the other side or unplugged"), (True, ": the sender has finished")],
)
def test_a_pulled_plug_is_said_at_once_and_ends_what_connects_once(sender, once, said):
    talk = Talk(connects_once=once)
    talk.notice(sender.heartbeat())
    talk.link.breaks += 1
    talk.turn(0.2)
    assert talk.station.lost is not once
    assert f"udpin:0.0.0.0:14550{said}" in talk.said[-1]


def test_rates_are_given_back_at_the_end_and_the_port_too(sender):
    talk = Talk()
    talk.notice(sender.heartbeat())
    own = {"HIGHRES_IMU": 0, "ATTITUDE": 20408, "LOCAL_POSITION_NED": -1}
    for name, interval in own.items():
        talk.notice(sender.message_interval(MESSAGE_IDS[name], interval))
    talk.turn(5.0)
    asked = set(talk.station.asked)
    assert len(asked) == 6
    talk.link.sent.clear()
    talk.station.close()
    back = [unpack(76, frame.payload) for _, frame in talk.link.sent]
    told = {message_name(int(fields["param1"])): fields["param2"] for fields in back}
    # PX4 tells 0 of what it does not send; of the others, which it does not tell, its defaults.
    assert told == dict.fromkeys(asked, 0.0) | own | {"HIGHRES_IMU": -1.0}
    assert talk.link.closed


def test_a_signed_vehicle_is_believed_and_asked_with_signatures(signing, key_file):
    talk = Talk(signing_key=key_file)
    talk.notice(signing().heartbeat())
    talk.turn(2.0)
    assert str(talk.intake.vehicle) == "PX4 quadrotor 1:1"
    assert talk.link.sent
    assert all(frame.signed for _, frame in talk.link.sent)
    assert talk.station.problems == ()
    refused = talk.station.as_dict()["signing"]["refused"]
    assert set(refused.values()) == {0}


def test_with_a_wrong_key_nothing_is_believed_and_that_is_said(signing, key_file):
    talk = Talk(signing_key=key_file)
    attacker = signing(key=bytes(32))
    talk.notice(attacker.heartbeat(), attacker.imu(1.0))
    assert talk.intake.vehicle is None
    assert talk.intake.monitor.received == 0
    assert talk.station.as_dict() == {
        "signing": {
            "accepted": 0,
            "refused": {"unsigned": 0, "wrong key": 2, "replayed": 0, "too old": 0},
        }
    }
    (problem,) = talk.station.problems
    assert problem == "no frame is signed with this key; rejected: 2 wrong key"
    assert sum("signed with another key" in text for text in talk.said) == 1


def test_who_has_no_key_gets_no_answers(signing, make_sender, key_file):
    talk = Talk(signing_key=key_file)
    vehicle = signing()
    talk.notice(vehicle.heartbeat(), source=("vehicle", 1))
    status = mavlink.MAVLink_radio_status_message(200, 190, 100, 30, 20, 0, 0)
    for raw in (make_sender().heartbeat(), signing(key=bytes(32)).heartbeat()):
        talk.notice(raw, source=("stranger", 2))
    talk.notice(make_sender().frame(status), source=("stranger", 2))
    assert talk.link.to == ("vehicle", 1)


def test_a_vehicle_without_a_clock_learns_the_time_from_our_heartbeats(signing, key_file):
    """It cannot be believed before, and is not answered if that were needed first."""
    talk = Talk(signing_key=key_file)
    vehicle = signing(late=1)
    talk.notice(vehicle.heartbeat(), vehicle.imu(1.0))
    assert talk.intake.vehicle is None
    talk.turn(2.0)
    to, beat = talk.link.sent[-1]
    assert to == ("vehicle", 1)
    # As pymavlink and the C library do with a frame that they believe.
    vehicle.packer.signing.timestamp = int.from_bytes(beat.raw[-12:-6], "little") + 1
    talk.notice(vehicle.heartbeat())
    assert str(talk.intake.vehicle) == "PX4 quadrotor 1:1"


def test_a_key_kept_beside_its_time(key_file):
    talk = Talk(signing_key=key_file)
    talk.turn(0.2)
    talk.station.close()
    state = key_file.with_name("vehicle.key.time")
    assert int(state.read_text()) > 0
    assert key_file.read_bytes() == KEY
