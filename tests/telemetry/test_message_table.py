"""A row of the table is all that a message takes: on a link and in a file alike."""

import random

import numpy as np
import pytest

from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry import message_table
from gcs_sysid.telemetry.decode import STATE_IDS
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import FrameScanner
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.logs import open_log
from gcs_sysid.telemetry.message_table import MESSAGES, STAMP_FIELDS, Message, Stamp
from gcs_sysid.telemetry.messages import LAYOUTS, MESSAGE_IDS
from gcs_sysid.telemetry.tlog_writer import TlogWriter
from testbed.recordings import in_sequence, records_of

AXES = ("xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc")
MILLI = (1e-3, 1e-3, 1e-3, 9.80665e-3, 9.80665e-3, 9.80665e-3)
NEW = {
    "an IMU that is read when there is no better": (
        Message("SCALED_IMU2", Stream.IMU, Stamp.MS32, AXES, MILLI, rank=3),
        lambda t, k: mavlink.MAVLink_scaled_imu2_message(
            round(t * 1e3), *(k % 7, -k % 11, 981, k % 13, 5, -k % 17), 0, 0, 0
        ),
    ),
    "a velocity": (
        Message(
            "GPS_RAW_INT", Stream.VELOCITY, Stamp.US64, ("", "", "vel", "", "", "alt"),
            (0.0, 0.0, 0.01, 0.0, 0.0, -1e-3), rank=2, only={"fix_type": 3},
        ),
        lambda t, k: mavlink.MAVLink_gps_raw_int_message(
            round(t * 1e6), 3 if k % 50 else 2, 1, 2, 100 * k, 3, 4, k % 300, 5, 6
        ),
    ),
    "rotors without a stamp": (
        Message("VIBRATION", Stream.ROTOR_SPEED, Stamp.NONE,
                ("vibration_x", "vibration_y", "vibration_z"), 2.0, offset=4),
        lambda t, k: mavlink.MAVLink_vibration_message(
            round(t * 1e6), 100.0 + k % 9, 200.0, float("nan") if k % 100 == 7 else 5.0, 0, 0, 0
        ),
    ),
    "rotors, as many as a field says": (
        Message("RC_CHANNELS", Stream.ROTOR_COMMAND, Stamp.MS32,
                tuple(f"chan{i}_raw" for i in range(1, 9)),
                used=lambda rows, _values: np.minimum(rows["chancount"], 8)),
        lambda t, k: mavlink.MAVLink_rc_channels_message(
            round(t * 1e3), 4 + 4 * (k > 250), *(1000 + (k * i) % 900 for i in range(18)), 0
        ),
    ),
}  # fmt: skip
COUNT = 320


def frames_of(sender, make):
    """What a vehicle sends that has no other message of its kind."""
    frames = [sender.heartbeat(), sender.attitude(0.99)]
    for k in range(COUNT):
        t = 1.0 + 0.02 * k
        frames += [sender.frame(make(t, k)), sender.attitude(t + 0.01)]
    return frames


def live(frames, cuts):
    """Records of an intake that is given frames piece by piece, as they came over a link."""
    intake, scanner, records, at = Intake(), FrameScanner(), [], 0
    data = b"".join(frame.raw for frame in frames)
    while at < len(data):
        size = cuts()
        records += in_sequence(intake.frames(scanner.feed(data[at : at + size]), 1.0 + at))
        at += size
    return records


@pytest.mark.slow
@pytest.mark.parametrize("what", NEW)
def test_a_row_alone_takes_up_a_message(what, sender, tmp_path, monkeypatch):
    row, make = NEW[what]
    frames = frames_of(sender, make)
    assert not [r for r in live(frames, lambda: 300) if r.stream is row.stream]
    monkeypatch.setattr(message_table, "MESSAGES", (*MESSAGES, row))
    path = tmp_path / "flight.tlog"
    with TlogWriter(path) as writer:
        for number, frame in enumerate(frames):
            writer.write(1_700_000_000_000_000 + 10_000 * number, [frame])
    whole = records_of(open_log(path))
    rng = random.Random(1)
    assert live(frames, lambda: 40) == whole  # hardly more than a frame at a time
    assert live(frames, lambda: rng.randrange(1, 2000)) == whole
    assert live(frames, lambda: 10**6) == whole
    new = [record for record in whole if record.stream is row.stream]
    skipped = {"GPS_RAW_INT": 7, "VIBRATION": 4}.get(row.name, 0)
    assert len(new) == COUNT - skipped
    assert {record.source for record in new} == {row.source}


def test_the_best_of_those_that_tell_the_same_is_taken(sender, monkeypatch):
    row, make = NEW["an IMU that is read when there is no better"]
    monkeypatch.setattr(message_table, "MESSAGES", (*MESSAGES, row))
    frames = frames_of(sender, make)
    better = sender.imu(6.001)
    half = 2 + 2 * 251
    times = [r.t for r in in_sequence(Intake().frames(frames)) if r.stream is Stream.IMU]
    fewer = in_sequence(Intake().frames([*frames[:half], better, *frames[half:]]))
    left_out = set(times) - {r.t for r in fewer if r.stream is Stream.IMU}
    assert min(left_out) == pytest.approx(6.02)
    assert max(left_out) == pytest.approx(7.0)
    assert len(left_out) == 50


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.name)
def test_rows_are_sound(message):
    places = LAYOUTS[MESSAGE_IDS[message.name]].places
    named = [*filter(None, message.fields), *message.only, *filter(None, [message.sensor])]
    stamp = STAMP_FIELDS.get(message.stamp)
    named += [] if stamp is None else [stamp]
    named += [message.offset] if isinstance(message.offset, str) else []
    assert set(named) <= set(places)
    assert MESSAGE_IDS[message.name] not in STATE_IDS
    alike = [m for m in MESSAGES if m.stream is message.stream and not m.source]
    assert len({m.rank for m in alike}) == len(alike)
