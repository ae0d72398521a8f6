"""Signatures: ours against pymavlink's, and what is refused."""

import hashlib
import random

import pytest
from pymavlink.dialects.v20 import common

from gcs_sysid.errors import InputError
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import FrameScanner, Validity, read_frame
from gcs_sysid.telemetry.outgoing import Gate, NotAllowedError
from gcs_sysid.telemetry.signing import (
    KEY_SIZE,
    UNITS,
    Refusal,
    SignatureCheck,
    SigningClock,
    read_key,
)

KEY = hashlib.sha256(b"correct horse").digest()
OTHER = hashlib.sha256(b"battery staple").digest()
NOW = 37_000_000_000_000
"""Units since 2015: some day in 2026."""


@pytest.fixture
def clock():
    return SigningClock(now=lambda: NOW)


@pytest.fixture
def check(clock):
    return SignatureCheck(KEY, clock)


@pytest.fixture
def signing(make_sender):
    """Makes vehicles that sign with pymavlink's own code."""

    def make(key=KEY, time=NOW, link=3, system=1):
        sender = make_sender(system, 1)
        state = sender.packer.signing
        state.secret_key, state.sign_outgoing = key, True
        state.timestamp, state.link_id = time, link
        return sender

    return make


def test_what_we_sign_pymavlink_believes(clock):
    sent = []
    gate = Gate(sent.append, key=KEY, clock=clock)
    gate.heartbeat()
    gate.set_message_interval((1, 1), 105, 4000)
    gate.read_parameter((1, 1), "INS_GYRO_FILTER")
    vehicle = common.MAVLink(None, srcSystem=1, srcComponent=1)
    vehicle.signing.secret_key, vehicle.signing.timestamp = KEY, NOW
    messages = vehicle.parse_buffer(b"".join(sent))
    assert [m.get_type() for m in messages] == ["HEARTBEAT", "COMMAND_LONG", "PARAM_REQUEST_READ"]
    assert all(m.get_signed() for m in messages)
    attacker = common.MAVLink(None)
    attacker.signing.secret_key, attacker.signing.timestamp = OTHER, NOW
    attacker.robust_parsing = True
    assert {m.get_type() for m in attacker.parse_buffer(b"".join(sent))} == {"BAD_DATA"}


def test_the_key_is_never_sent(clock):
    gate = Gate(pytest.fail, key=KEY, clock=clock)
    for dialect in (common, mavlink):
        message = dialect.MAVLink_setup_signing_message(1, 1, list(KEY), NOW)
        with pytest.raises(NotAllowedError, match="SETUP_SIGNING must never be sent"):
            gate.send(message)


def test_frames_with_the_right_key_are_believed_whatever_they_are(signing, check, make_message):
    vehicle, rng = signing(), random.Random(3)
    for cls in mavlink.mavlink_map.values():
        assert check.refusal_of(vehicle.frame(make_message(cls, rng))) is None
    assert check.accepted == len(mavlink.mavlink_map)
    assert check.refused == {}


@pytest.mark.parametrize("at", [5, 10, 15, -13, -10, -1])
def test_a_frame_changed_on_the_way_is_not_believed(signing, check, at):
    raw = bytearray(signing().heartbeat().raw)
    raw[at] ^= 0x10
    frame = read_frame(bytes(raw))
    assert check.refusal_of(frame) is Refusal.WRONG_KEY or frame.valid is Validity.BAD_CRC
    assert check.accepted == 0


def test_what_is_repeated_is_refused(signing, check):
    vehicle = signing()
    frames = [vehicle.imu(1.0 + 0.004 * i) for i in range(10)]
    assert [check.refusal_of(frame) for frame in frames] == [None] * 10
    assert [check.refusal_of(frame) for frame in frames] == [Refusal.REPLAYED] * 10
    assert check.refusal_of(vehicle.heartbeat()) is None


def test_forged_times_leave_no_trace(signing, check):
    """Else one frame with a time far ahead would shut the vehicle out."""
    vehicle = signing()
    check.refusal_of(vehicle.heartbeat())
    check.refusal_of(signing(OTHER, time=NOW + 10**9).heartbeat())
    assert check.refusal_of(vehicle.heartbeat()) is None


def test_a_recording_of_yesterday_is_refused(signing, check):
    assert check.refusal_of(signing(time=NOW - 86400 * UNITS).heartbeat()) is Refusal.TOO_OLD
    assert check.refusal_of(signing(time=NOW - 59 * UNITS, link=4).heartbeat()) is None


def test_each_link_of_each_system_has_its_own_time(signing, check):
    fast, slow, other = signing(), signing(time=NOW - UNITS, link=4), signing(system=2)
    for sender in (fast, slow, other, fast, slow, other):
        assert check.refusal_of(sender.heartbeat()) is None


def test_without_a_signature_only_radios_are_believed(make_sender, check):
    vehicle, radio = make_sender(), make_sender(51, 68)
    assert check.refusal_of(vehicle.heartbeat()) is Refusal.UNSIGNED
    assert (
        check.refusal_of(make_sender().frame(mavlink.MAVLink_timesync_message(0, 1), 1)) is not None
    )
    status = mavlink.MAVLink_radio_status_message(200, 190, 100, 30, 20, 0, 0)
    assert check.refusal_of(radio.frame(status)) is None
    assert check.refused == {Refusal.UNSIGNED: 2}


def test_signed_frames_go_through_the_scanner_in_any_pieces(signing, check):
    vehicle, rng = signing(), random.Random(5)
    data = b"".join(vehicle.imu(1.0 + 0.004 * i).raw for i in range(200))
    scanner, frames, at = FrameScanner(), [], 0
    while at < len(data):
        step = rng.randint(1, 200)
        frames += scanner.feed(data[at : at + step])
        at += step
    frames += scanner.flush()
    assert [check.refusal_of(frame) for frame in frames] == [None] * 200
    assert scanner.garbage_bytes == 0


def test_our_time_is_never_behind_what_is_believed(signing, check, clock):
    check.refusal_of(signing(OTHER, time=NOW + 5000 * UNITS).heartbeat())
    assert clock.next_time() == NOW + 1
    check.refusal_of(signing(time=NOW + 100 * UNITS).heartbeat())
    assert clock.next_time() == NOW + 100 * UNITS + 1


def test_our_time_does_not_go_back_after_a_crash(tmp_path):
    state = tmp_path / "key.time"
    wall = NOW
    first = SigningClock(state, now=lambda: wall)
    last = 0
    for _ in range(200):
        wall += UNITS
        last = first.next_time()
    second = SigningClock(state, now=lambda: 0)  # no close: it was killed
    assert last < second.next_time() <= last + SigningClock.RESERVED + 1


def test_time_kept_ahead_shuts_out_nobody(tmp_path, signing):
    state = tmp_path / "key.time"
    SigningClock(state, now=lambda: NOW).next_time()  # killed after one frame
    check = SignatureCheck(KEY, SigningClock(state, now=lambda: NOW))
    assert check.refusal_of(signing(time=NOW - 30 * UNITS).heartbeat()) is None


@pytest.mark.parametrize("content", [b"", b"nonsense", b"\xff\xfe", b"-5", b"9" * 40])
def test_a_damaged_state_file_does_no_harm(tmp_path, content):
    state = tmp_path / "key.time"
    state.write_bytes(content)
    clock = SigningClock(state, now=lambda: NOW)
    assert NOW <= clock.next_time() < 2**48


def test_a_state_that_cannot_be_kept_is_told(tmp_path):
    clock = SigningClock(tmp_path / "no such folder" / "key.time", now=lambda: NOW)
    assert clock.next_time() == NOW + 1
    assert "cannot keep the time of signatures" in clock.problem
    assert clock.next_time() == NOW + 2


@pytest.mark.parametrize(
    ("content", "key"),
    [
        (KEY, KEY),
        (b"*" * 32, b"*" * 32),
        (bytes(range(31)) + b"\n", bytes(range(31)) + b"\n"),
        (KEY.hex().encode(), KEY),
        (KEY.hex().upper().encode() + b"\r\n", KEY),
        (b"correct horse", KEY),
        (b"correct horse\n", KEY),
        (b"p" * 31 + b"\n", hashlib.sha256(b"p" * 31).digest()),
        ("schl\u00fcssel\n".encode(), hashlib.sha256("schl\u00fcssel".encode()).digest()),
    ],
)
def test_a_key_file_holds_bytes_digits_or_a_passphrase(tmp_path, content, key):
    path = tmp_path / "key"
    path.write_bytes(content)
    assert read_key(path) == key
    assert len(key) == KEY_SIZE


@pytest.mark.parametrize("content", [b"", b"\n \n", b"\xff\x00\x80", b"two\nlines\n", KEY + KEY])
def test_a_file_without_a_key_gives_its_line(tmp_path, content):
    path = tmp_path / "key"
    path.write_bytes(content)
    with pytest.raises(InputError, match="no signing key in") as caught:
        read_key(path)
    assert "\n" not in str(caught.value)


def test_a_missing_key_file_gives_its_line(tmp_path):
    with pytest.raises(InputError, match="cannot read the signing key"):
        read_key(tmp_path / "missing")
