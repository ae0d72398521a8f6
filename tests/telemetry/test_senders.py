"""Several who speak in the vehicle's name."""

import pytest

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.ground_station import GroundStation
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.link import ReceivedBytes
from gcs_sysid.telemetry.outgoing import OWN_COMPONENT, OWN_SYSTEM
from gcs_sysid.telemetry.tlog_writer import RESET_TEXT
from gcs_sysid.telemetry.transceiver import Receiver, Transceiver, Whereabouts
from gcs_sysid.telemetry.vehicles import Contradictions
from tests.telemetry.in_memory import Ether

HOME, FORGER = ("10.0.0.1", 14550), ("10.6.6.6", 666)
ARMED = {"base_mode": mavlink.MAV_MODE_FLAG_SAFETY_ARMED}


class Field:
    """A receiver that follows 1:1, and a clock."""

    def __init__(self):
        self.link, self.now = Ether(), 0.0
        self.receiver = Receiver(self.link, clock=lambda: self.now)
        self.receiver.follow((1, 1))

    def notice(self, source, *frames):
        """Frames of one datagram; those that were believed."""
        self.link.arriving = [ReceivedBytes(b"".join(frame.raw for frame in frames), source)]
        return self.receiver.poll(0.0)


@pytest.fixture
def field():
    return Field()


@pytest.fixture
def forged(make_sender):
    """What disarms the vehicle and sets it on the ground."""
    sender = make_sender()
    state = mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_ON_GROUND)
    return [sender.heartbeat(), sender.frame(state)]


def test_state_is_believed_from_where_the_imu_data_come(field, sender, forged):
    flying = mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_IN_AIR)
    field.notice(HOME, sender.heartbeat(**ARMED))
    assert field.notice(FORGER, *forged) == forged  # nobody knows yet
    field.notice(HOME, sender.imu(1.0))
    assert field.notice(FORGER, *forged) == forged[1:]  # the vehicle has said nothing of that
    field.notice(HOME, sender.frame(flying))
    others = [sender.imu(2.0), sender.attitude(2.0)]
    assert field.notice(FORGER, forged[0], *others, forged[1]) == others
    assert field.receiver.whereabouts.passed_over == 3
    assert len(field.notice(HOME, sender.heartbeat(**ARMED), sender.imu(3.0))) == 2


def test_other_systems_on_other_addresses_are_heard(field, sender, make_sender):
    field.notice(HOME, sender.heartbeat(), sender.imu(1.0))
    camera = [make_sender(1, 100).heartbeat(), make_sender(2, 1).heartbeat()]
    assert field.notice(FORGER, *camera) == camera
    assert field.receiver.whereabouts.rival is None


def test_who_forges_much_gets_no_answers_while_the_imu_data_come(field, sender, forged):
    field.notice(HOME, sender.heartbeat(**ARMED), sender.imu(1.0))
    for n in range(300):
        field.now += 0.01
        assert field.notice(FORGER, *forged) == forged[1:]
        if n % 100 == 0:
            field.notice(HOME, sender.imu(1.0 + field.now))
        assert field.link.to == HOME


def test_a_vehicle_that_begins_anew_elsewhere_is_believed_there(field, sender):
    field.notice(HOME, sender.heartbeat(), sender.imu(1.0))
    moved = ("10.0.0.1", 14999)
    field.now += Whereabouts.SILENT_FOR + 0.1
    beats = [len(field.notice(moved, sender.heartbeat())) for _ in range(4)]
    assert beats == [0, 0, 1, 1]
    assert field.link.to == moved
    assert field.receiver.whereabouts.rival is None


def test_another_vehicle_to_follow_may_be_elsewhere(field, sender, make_sender):
    field.notice(HOME, sender.heartbeat(), sender.imu(1.0))
    field.receiver.follow((2, 1))
    other = make_sender(2, 1)
    for _ in range(3):
        assert len(field.notice(FORGER, other.heartbeat())) == 1
    assert field.link.to == FORGER


def test_two_that_speak_by_turns_are_told_of_once(sender, forged):
    link, intake, told = Ether(), Intake(), []
    transceiver = Transceiver(link)
    station = GroundStation(transceiver, 4, 250.0)
    sequence = [(HOME, [sender.heartbeat(**ARMED), sender.imu(0.1 * n)]) for n in (1, 2)]
    for n in range(20):
        sequence += [(FORGER, forged[:1]), (HOME, [sender.imu(1.0 + n)])]
    for n, (source, frames) in enumerate(sequence):
        link.arriving = [ReceivedBytes(frame.raw, source) for frame in frames]
        for batch in transceiver.receive(0.0):
            intake.frames(batch.frames)
        station.follow(0.1 * n, intake)
        station.tick(0.1 * n, intake)
        told += [event for event in station.take_events() if "senders" in event]
    assert told == [
        "two senders use the address 1:1: 10.0.0.1:14550, taken as the vehicle, and 10.6.6.6:666; "
        "unless both are its links, one forges its messages, which signing prevents"
    ]
    assert told[0] in station.problems
    assert station.as_dict()["two_senders"] == {
        "believed": "10.0.0.1:14550", "other": "10.6.6.6:666", "passed_over": 20,
    }  # fmt: skip
    assert intake.problems == ()


@pytest.mark.parametrize("with_key", [False, True])
def test_a_reset_that_comes_over_the_link_is_none(with_key, sender, make_sender, tmp_path):
    """Not even one that is signed: another ground station may have the key."""
    link, key = Ether(), bytes(range(32))
    path = tmp_path / "vehicle.key"
    path.write_bytes(key)
    transceiver = Transceiver(link, signing_key=path if with_key else None)
    station = GroundStation(transceiver, 4, 250.0)
    forger = make_sender(OWN_SYSTEM, OWN_COMPONENT)
    state = forger.packer.signing
    state.secret_key, state.sign_outgoing, state.timestamp = key, with_key, 2**47
    words = [f"{RESET_TEXT}, not", RESET_TEXT]
    frames = [forger.frame(mavlink.MAVLink_statustext_message(5, w.encode())) for w in words]
    link.arriving = [ReceivedBytes(frame.raw, FORGER) for frame in frames]
    (batch,) = transceiver.receive(0.0)
    assert batch.frames == frames[:1]  # neither used nor recorded
    station.tick(0.0, Intake())
    assert [event for event in station.take_events() if "reset" in event] == [
        "ignored a reset received over the link: only the user may reset"
    ]


# --- by what is said alone, on any link and in any recording


@pytest.mark.parametrize("lie", [{"base_mode": 0}, {"autopilot": 3}, {"type": 13}])
def test_heartbeats_that_contradict_each_other_are_noticed_once(sender, lie):
    intake = Intake()
    for _ in range(30):
        intake.frames([sender.heartbeat(**ARMED), sender.heartbeat(**(ARMED | lie))])
    told = [event for event in intake.take_events() if event.kind == "senders"]
    assert [event.text for event in told] == list(intake.problems)
    assert "contradict each other" in intake.problems[0]
    assert "1:1" in intake.problems[0]


def test_arming_now_and_then_is_no_contradiction():
    watch = Contradictions()
    for flight in range(50):
        for n in range(8):
            assert not watch.note_heartbeat(2, 12, armed=n >= 4), flight
    assert not watch.found


def test_others_are_told_of_up_to_a_number(make_sender):
    intake = Intake()
    for n in range(1, 200):
        intake.frames([make_sender(n, 1).heartbeat()])
    told = [event.text for event in intake.take_events() if event.kind == "vehicles"]
    assert len(told) == 5
    assert told[-1] == "more than 4 other vehicles: further ones are not listed"
