"""The part that live sessions and logs share: choosing, decoding, counting."""

import math
import random

import numpy as np
import pytest

from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.decode import RecordDecoder
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import FrameScanner
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.tlog import TlogReader
from gcs_sysid.telemetry.vehicles import VehicleSelector
from testbed.recordings import in_sequence


def ground_station(make_sender):
    return make_sender(255, 190).heartbeat(
        type=mavlink.MAV_TYPE_GCS, autopilot=mavlink.MAV_AUTOPILOT_INVALID
    )


def heard(selector, frame):
    selector.note_senders(*(np.array([n], np.uint8) for n in (frame.system, frame.component)))
    if frame.message_id == 0:
        selector.notice(frame)
    return selector.is_chosen(frame)


def test_the_first_autopilot_heard_is_chosen(make_sender):
    selector = VehicleSelector()
    vehicle = make_sender(3, 1)
    assert not heard(selector, ground_station(make_sender))
    assert not heard(selector, vehicle.imu(1.0))
    assert selector.chosen is None
    assert heard(selector, vehicle.heartbeat())
    assert heard(selector, vehicle.imu(1.0))
    assert not heard(selector, make_sender(4, 1).heartbeat())
    assert not heard(selector, make_sender(3, 100).imu(1.0))
    assert str(selector.chosen) == "PX4 quadrotor 3:1"
    assert selector.chosen.as_dict() == {"sysid": 3, "compid": 1, "autopilot": "px4"}
    assert str(next(iter(selector.systems.values()))) == "ground station 255:190"


@pytest.mark.parametrize(("wanted", "chosen"), [((4, None), (4, 1)), ((4, 2), (4, 2))])
def test_the_vehicle_wanted_is_chosen(make_sender, wanted, chosen):
    selector = VehicleSelector(wanted)
    for who in [(3, 1), (4, 1), (4, 2)]:
        heard(selector, make_sender(*who).heartbeat())
    assert selector.chosen.address == chosen


def test_the_table_of_systems_is_bounded(make_sender):
    selector = VehicleSelector()
    for system in range(1, 256):
        for component in (1, 2, 3):
            heard(selector, make_sender(system, component).heartbeat())
    assert len(selector.systems) <= 256


def test_records_come_from_the_chosen_vehicle_alone(make_sender):
    intake = Intake()
    vehicle, other = make_sender(1, 1), make_sender(2, 1)
    frames = [vehicle.imu(0.9), vehicle.heartbeat(), other.heartbeat()]
    for i in range(10):
        frames += [vehicle.imu(1.0 + 0.004 * i), other.imu(50.0 + 0.004 * i)]
    records = in_sequence(intake.frames(frames))
    assert [r.t for r in records if r.stream is Stream.IMU] == pytest.approx(
        [1.0 + 0.004 * i for i in range(10)]
    )
    assert [event.kind for event in intake.take_events()] == ["vehicle", "vehicles"]
    assert intake.take_events() == []


def stray_and_vehicle(make_sender, seconds, before=()):
    """Heartbeats of 66:1 and all of 1:1, the stray one first, with more frames after it."""
    stray, vehicle = make_sender(66, 1), make_sender(1, 1)
    frames = [stray.heartbeat(), *before]
    for i in range(round(100 * seconds)):
        if i % 100 == 0:
            frames += [stray.heartbeat(), vehicle.heartbeat()]
        frames.append(vehicle.imu(5.0 + 0.01 * i))
    return frames


def test_a_stray_heartbeat_is_not_the_vehicle_for_long(make_sender):
    intake = Intake()
    records = in_sequence(intake.frames(stray_and_vehicle(make_sender, 5.0)))
    assert intake.vehicle.address == (1, 1)
    times = [record.t for record in records if record.stream is Stream.IMU]
    assert times == pytest.approx(7.0 + 0.01 * np.arange(300))  # from its third heartbeat on
    assert intake.monitor.lost == 0
    assert [event.text for event in intake.take_events()] == [
        "PX4 quadrotor 66:1 found",
        "several vehicles: PX4 quadrotor 1:1 too; using PX4 quadrotor 66:1, "
        "the first received (choose with --vehicle 1:1)",
        "PX4 quadrotor 66:1, the first received, sends heartbeats only: using PX4 quadrotor "
        "1:1, which sends IMU data",
    ]


def test_a_vehicle_that_tells_something_stays_the_vehicle_and_the_other_is_named(make_sender):
    intake = Intake()
    level = make_sender(66, 1).attitude(3.0)
    intake.frames(stray_and_vehicle(make_sender, 5.0, [level]))
    assert intake.vehicle.address == (66, 1)
    (problem,) = intake.problems
    assert problem == (
        "PX4 quadrotor 1:1 sent 505 messages, PX4 quadrotor 66:1, the first received, 7: choose it "
        "with --vehicle 1:1"
    )


def test_another_vehicle_on_the_link_is_told_once_with_what_to_do(make_sender):
    intake = Intake()
    for _ in range(3):
        for who in [(1, 1), (2, 1), (1, 191), (51, 68), (255, 190)]:
            kind = {191: mavlink.MAV_TYPE_ONBOARD_CONTROLLER, 190: mavlink.MAV_TYPE_GCS}.get(
                who[1], mavlink.MAV_TYPE_QUADROTOR
            )
            intake.frames([make_sender(*who).heartbeat(type=kind)])
    _, *others = intake.take_events()
    assert [event.kind for event in others] == ["vehicles"]
    text = others[0].text
    assert "PX4 quadrotor 2:1 too" in text
    assert "using PX4 quadrotor 1:1" in text
    assert "--vehicle 2:1" in text
    systems = intake.as_dict()["systems"]
    assert systems[:2] == ["PX4 quadrotor 1:1", "PX4 quadrotor 2:1"]
    assert "telemetry radio 51:68" in systems


def test_a_vehicle_chosen_by_the_user_makes_no_ado_of_others(make_sender):
    intake = Intake((2, None))
    intake.frames([make_sender(who, 1).heartbeat() for who in (1, 2, 3, 1)])
    assert [event.text for event in intake.take_events()] == ["PX4 quadrotor 2:1 found"]


def test_a_radio_is_never_the_vehicle(make_sender):
    selector = VehicleSelector()
    heard(selector, make_sender(51, 68).heartbeat())
    assert selector.chosen is None
    heard(selector, make_sender(51, 1).heartbeat())
    assert selector.chosen.address == (51, 1)


def test_parameters_that_arrive_are_noted(sender, make_sender):
    intake = Intake()

    def value(name):
        return mavlink.MAVLink_param_value_message(name, 1.0, 9, 10, 0)

    intake.frames([sender.heartbeat()])
    intake.frames([sender.frame(value(b"THR_MDL_FAC")), sender.frame(value(b"SIXTEEN_LETTERS_"))])
    intake.frames([make_sender(2, 1).frame(value(b"SYS_HITL"))])
    assert set(intake.parameters) == {"THR_MDL_FAC", "SIXTEEN_LETTERS_"}


def test_speeds_prove_good_when_all_rotors_turn(sender):
    intake = Intake()
    intake.frames([sender.heartbeat()])

    def speeds(*rpm):
        return sender.frame(mavlink.MAVLink_esc_status_message(0, 2_000_000, rpm, [0] * 4, [0] * 4))

    intake.frames([speeds(0, 0, 0, 0), speeds(5000, 5000, 0, 5000)])
    assert intake.turning == set()
    intake.frames([speeds(5000, -5000, 5000, -5000)])
    assert intake.turning == {"ESC_STATUS"}


def test_a_reboot_is_told(sender):
    intake = Intake()
    intake.frames([sender.heartbeat(), sender.imu(100.0), sender.imu(1.0), sender.imu(1.01)])
    event = intake.take_events()[-1]
    assert (event.kind, event.t) == ("reboot", pytest.approx(1.01))
    assert "100.0 s" in event.text


def test_a_clock_that_keeps_going_back_does_not_have_a_log_read_again_and_again(
    sender, monkeypatch
):
    """As of two boards that send as one vehicle, each with its own clock."""
    frames = [sender.heartbeat()]
    for i in range(400):
        frames += [sender.imu(100.0 + 0.01 * i + 0.001 * k) for k in range(4)]
        frames += [sender.attitude(10.0 + 0.01 * i + 0.001 * k) for k in range(2)]
    looked_at = []
    take = RecordDecoder.decode
    monkeypatch.setattr(
        RecordDecoder,
        "decode",
        lambda self, block, *rest: looked_at.append(len(block)) or take(self, block, *rest),
    )
    intake = Intake()
    intake.frames(frames)
    assert intake.decoder.clock.reboots > 360
    assert sum(looked_at) < 100 * len(frames)


def test_reordered_frames_are_not_lost_and_lost_ones_are(sender):
    rng = random.Random(5)
    frames = [sender.heartbeat(), *(sender.imu(1.0 + 0.004 * i) for i in range(3000))]
    order = sorted(range(len(frames)), key=lambda i: i + rng.uniform(0.0, 4.0) * (i > 0))
    late = Intake()
    late.frames(frames[i] for i in order)
    assert late.monitor.lost == 0
    thinned = Intake()
    thinned.frames(f for i, f in enumerate(frames) if i == 0 or rng.random() > 0.05)
    assert 110 < thinned.monitor.lost < 190
    assert thinned.health()["lost_percent"] == pytest.approx(5.0, abs=1.3)
    doubled = Intake()
    doubled.frames(f for f in frames for _ in range(2))
    assert doubled.monitor.lost == 0


def test_pauses_of_the_imu_are_gaps(sender):
    intake = Intake()
    intake.frames([sender.heartbeat()])
    times = [1.0 + 0.004 * i for i in range(500)]
    intake.frames(sender.imu(t if t < 2.0 else t + 0.7) for t in times)
    gaps = intake.as_dict()["imu_gaps"]
    assert gaps["count"] == 1
    assert gaps["last"][0]["length"] == pytest.approx(0.704, abs=1e-3)


def test_damaged_and_unknown_frames_are_counted_and_make_no_records(sender):
    scanner = FrameScanner()
    damaged = bytearray(sender.imu(1.0).raw)
    damaged[20] ^= 1
    unknown = bytearray(sender.imu(1.0).raw)
    unknown[7:10] = (60_999).to_bytes(3, "little")
    data = sender.heartbeat().raw + damaged + unknown + sender.imu(1.1).raw
    intake = Intake()
    records = in_sequence(intake.frames([*scanner.feed(data), *scanner.flush()]))
    assert [record.t for record in records] == [pytest.approx(1.1)]
    health = intake.health()
    assert [health[key] for key in ("received", "rejected", "unknown")] == [2, 1, 1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "vehicle", "streams"),
    [
        # Its parameters come at the end.
        ("px4-esc-cg.tlog", "PX4 quadrotor 1:1", set(Stream) - {Stream.PARAMETER}),
        pytest.param(
            *("px4-sih-default.tlog", "PX4 quadrotor 1:1", set(Stream) - {Stream.ROTOR_SPEED}),
            marks=pytest.mark.thorough,
        ),
        ("ardupilot-sitl.tlog", "ArduPilot quadrotor 1:1", set(Stream) - {Stream.RATE_SETPOINT}),
    ],
)
def test_recorded_flights_give_their_streams_and_lost_nothing(shared_logs, name, vehicle, streams):
    intake = Intake()
    frames = (f for _, (_, f) in zip(range(40_000), TlogReader(shared_logs / name), strict=False))
    records = in_sequence(intake.frames(frames))
    assert str(intake.vehicle) == vehicle
    assert {record.stream for record in records} == streams
    assert intake.monitor.lost_percent < 0.05
    assert intake.decoder.clock.reboots == 0
    times = [record.t for record in records if record.stream is Stream.IMU]
    assert times == sorted(times)


@pytest.mark.parametrize("piece", [1, 7, 1000])
def test_of_frames_that_come_again_over_a_second_radio_one_counts(sender, piece):
    times = [1.0 + 0.02 * i for i in range(400)]
    once = [(t, sender.heartbeat() if i % 50 == 0 else sender.imu(t)) for i, t in enumerate(times)]
    twice = sorted(once + [(t + 3.0, frame) for t, frame in once], key=lambda each: each[0])
    found = []
    for frames in (once, twice):
        intake = Intake()
        frames = [frame for _, frame in frames]
        records = [
            record
            for first in range(0, len(frames), piece)
            for record in in_sequence(intake.frames(frames[first : first + piece]))
        ]
        found.append(records)
        assert intake.decoder.clock.reboots == 0
        assert intake.monitor.lost_percent == 0.0
    assert found[0] == found[1]
    assert intake.as_dict()["copies"] == len(once)


@pytest.mark.parametrize("piece", [1, 300])
def test_what_has_no_time_may_say_the_same_again(sender, piece):
    """256 frames a second: each heartbeat has the sequence number of the one before."""
    frames = [
        sender.heartbeat() if i % 256 == 0 else sender.imu(1.0 + i / 256.0) for i in range(600)
    ]
    intake = Intake()
    for first in range(0, len(frames), piece):
        intake.frames(frames[first : first + piece])
    assert intake.as_dict()["copies"] == 0


def test_every_message_has_a_fate(sender, make_sender):
    intake = Intake()
    imu = mavlink.MAVLink_highres_imu_message
    frames = [
        sender.imu(1.0),  # before its first heartbeat
        sender.heartbeat(),  # without a time as yet
        sender.imu(1.1),
        sender.frame(mavlink.MAVLink_scaled_imu_message(1200, *[0] * 9)),  # there is a better one
        sender.frame(mavlink.MAVLink_vfr_hud_message(0, 0, 0, 0, 0, 0)),
        sender.frame(imu(1_300_000, 0.0, 0.0, 0.0, math.nan, *[0.0] * 9, 63)),  # no gyro
        make_sender(2, 1).imu(1.4),
    ]
    for frame in frames:
        intake.frames([frame])
    assert intake.as_dict()["fates"] == {
        "used": 1,
        "not needed": 1,
        "passed over": 2,
        "dropped": 1,
        "others": 2,
    }
    assert sum(intake.fates.values()) == intake.monitor.received == len(frames)
