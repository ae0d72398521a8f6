"""When the vehicle counts as flying."""

import numpy as np
import pytest

from gcs_sysid.model.airframe import ScaleReference, load_airframe
from gcs_sysid.signals.columns import Track
from gcs_sysid.signals.flight_detection import TAKE_OFF, FlightDetector, GroundTest
from gcs_sysid.signals.records import Stream
from gcs_sysid.signals.rotor_source_selector import RotorSourceSelector
from gcs_sysid.signals.sampling import Sampler
from gcs_sysid.telemetry.logs import open_log
from sim_bridge.cli import main as sim_bridge
from testbed.recordings import AIR_TIMES

RATE = 50.0
T = np.arange(0.0, 30.0, 1.0 / RATE)
UNKNOWN = np.full(len(T), np.nan)


def between(start, end, inside=1.0, outside=0.0):
    return np.where((start <= T) & (end > T), inside, outside)


def flown(in_air=UNKNOWN, armed=UNKNOWN, speed=UNKNOWN, height=UNKNOWN, block=10**6):
    """Times of the samples that count."""
    detector, speeds = FlightDetector(), np.repeat(speed[:, None], 4, axis=1)
    every = T, in_air, armed, speeds, np.stack([0.0 * T, 0.0 * T, -height], axis=1)
    parts = (slice(i, i + block) for i in range(0, len(T), block))
    return T[np.concatenate([detector.update(*(each[k] for each in every)) for k in parts])]


def spans(times, start, end):
    assert times[0] == pytest.approx(start, abs=1.5 / RATE)
    assert times[-1] == pytest.approx(end, abs=1.5 / RATE)
    assert len(times) == pytest.approx((end - start) * RATE, abs=2)


def test_the_autopilot_says_it():
    spans(flown(in_air=between(10.0, 20.0)), 10.0 + TAKE_OFF, 20.0)


def test_a_flight_that_was_on_when_the_record_began_counts_from_there():
    spans(flown(in_air=between(0.0, 20.0)), 0.0, 20.0)


@pytest.mark.parametrize("tells", ["armed", "speed"])
def test_what_stands_does_not_fly_though_the_autopilot_tells_late(tells):
    spans(flown(in_air=between(10.0, 20.5), **{tells: between(8.0, 20.0)}), 11.0, 20.0)


def test_armed_rotors_that_turn_serve_where_nothing_is_told():
    spans(flown(armed=between(8.0, 25.0), speed=between(10.0, 20.0, 500.0)), 11.0, 20.0)
    assert len(flown(armed=0.0 * T, speed=500.0 + 0.0 * T)) == 0
    assert len(flown()) == 0


def test_height_tells_idling_on_the_ground_from_flight():
    height = 37.0 + between(12.0, 20.0, 5.0)  # above wherever the autopilot counts from
    idles = {"armed": between(8.0, 25.0), "speed": between(9.0, 24.0, 500.0)}
    spans(flown(height=height, **idles), 12.0 + TAKE_OFF, 20.0)
    # Where it stood is not known when the record begins in flight.
    spans(flown(height=height, speed=500.0 + 0.0 * T), 0.0, T[-1])


def test_forged_heartbeats_do_not_land_it():
    """They say disarmed; the autopilot says that it flies, and all rotors turn."""
    forged = np.where((T > 9.0) & (np.floor(10.0 * T) % 2.0 == 0.0), 0.0, between(8.0, 20.0))
    constant = between(9.0, 20.5, 500.0)
    turning = {"in_air": between(10.0, 20.0), "speed": constant + (constant > 0.0) * np.sin(T)}
    spans(flown(armed=forged, **turning), 11.0, 20.0)
    # Outputs that nothing changes are no motors that turn: carried about by hand.
    held = np.full_like(T, 1100.0)
    assert len(flown(armed=0.0 * T, in_air=turning["in_air"], speed=held)) == 0
    assert len(flown(armed=forged, in_air=turning["in_air"])) == 0  # nothing bears it out


@pytest.mark.parametrize("told", ["in_air", "armed"])
def test_what_its_rotors_carry_flies_though_it_is_said_to_stand_or_to_be_disarmed(told):
    speed = between(5.0, 25.0, HOVER) * (1.0 + 0.05 * np.sin(5.0 * T))
    force = np.where(speed > 0.0, G * (speed / HOVER) ** 2, G)
    found = sensed(speed, force, **{told: 0.0 * T})
    spans(found, found[0], 25.0)
    assert found[0] < 9.0
    assert not len(sensed(speed, 0.0 * T + G, 0.0 * T, **{told: 0.0 * T}))


def test_commands_of_hardly_anything_are_rotors_that_turn():
    spans(flown(speed=between(10.0, 20.0, 0.05)), 11.0, 20.0)


def test_a_single_rotor_that_stands_is_no_landing_and_no_flight():
    detector = FlightDetector()
    speeds = np.full((len(T), 4), 500.0)
    speeds[:, 2] = 0.0
    unknown = np.full((len(T), 3), np.nan)
    assert not detector.update(T, UNKNOWN, UNKNOWN, speeds, unknown).any()
    assert FlightDetector().update(T, 0.0 * T + 1.0, UNKNOWN, speeds, unknown).all()


# --- with an IMU: rotors at zero are not the ground, rotors that turn are not flight

HOVER, IDLE = 800.0, 250.0
G = 9.81


def sensed(speed, force=None, rate=None, block=10**6, commands=False, **told):
    """Times of the samples that count, with what an IMU tells.

    Args:
        speed: (n,) of all rotors.
        force: (n,) specific force along the body's z axis; None: rotors carry what they can, from
            a ground that carries the rest.
        rate: (n,) body rate; None: that of a hover where it is in the air, else none.
        block: samples at once.
        commands: whether the speeds are commands, 0 to 1.
        told: as of `flown`.
    """
    rng = np.random.default_rng(1)
    thrust = G * (speed / HOVER) ** (1 if commands else 2)
    force = np.maximum(thrust, G) if force is None else force
    rate = np.where(thrust > 0.8 * G, 0.2, 0.01) if rate is None else rate
    noise = rng.normal(size=(len(T), 2)) * [0.3, 0.01]
    forces = np.stack([0.0 * T, 0.0 * T, -force + noise[:, 0]], axis=1)
    rates = np.stack([rate + noise[:, 1], 0.0 * T, 0.0 * T], axis=1)
    effort = np.stack([UNKNOWN, speed] if commands else [speed**2, UNKNOWN], axis=1)
    in_air, armed, height = (told.get(n, UNKNOWN) for n in ("in_air", "armed", "height"))
    detector, speeds = FlightDetector(), np.repeat(speed[:, None], 4, axis=1)
    position = np.stack([0.0 * T, 0.0 * T, -height], axis=1)
    every = T, in_air, armed, speeds, position, forces, rates, effort
    parts = (slice(i, i + block) for i in range(0, len(T), block))
    return T[np.concatenate([detector.update(*(each[k] for each in every)) for k in parts])]


def falling(start, end, drag=0.8):
    """Speed and specific force of a flight from 5 to 25 s whose throttle is cut in between."""
    cut = (start <= T) & (end > T)
    speed = np.where(cut, 0.0, between(5.0, 25.0, HOVER))
    return speed, np.where(cut, drag, G)


@pytest.mark.parametrize("in_air", [UNKNOWN, between(5.0, 25.0)], ids=["untold", "told"])
@pytest.mark.parametrize("length", [0.04, 0.5, 1.5])
def test_a_throttle_that_is_cut_in_the_air_is_no_landing(length, in_air):
    speed, force = falling(15.0, 15.0 + length)
    found = sensed(speed, force, in_air=in_air)
    spans(found, 5.0 + TAKE_OFF, min(found[-1], 25.3))
    assert found[-1] >= 24.97


def test_a_mixer_that_saturates_at_zero_while_it_tumbles_is_no_landing():
    speed, _ = falling(15.0, 16.0)
    rate = np.where((T > 14.9) & (T < 16.1), 8.0, 0.01)
    spans(sensed(speed, np.full(len(T), G), rate), 5.0 + TAKE_OFF, 25.22)


@pytest.mark.parametrize("in_air", [UNKNOWN, between(5.0, 27.0)], ids=["untold", "told late"])
@pytest.mark.parametrize("after", [0.0, IDLE], ids=["stopped", "idling"])
def test_a_landing_is_found_within_half_a_second(after, in_air):
    speed = np.where(T >= 25.0, after, between(5.0, 25.0, HOVER))
    found = sensed(speed, in_air=in_air)
    assert found[0] == pytest.approx(5.0 + TAKE_OFF, abs=0.05)
    assert 25.0 <= found[-1] < 25.5


def test_a_part_of_the_rotors_does_not_show_what_all_of_them_carry():
    t = np.arange(0.0, 20.0, 0.004)
    sway = 60.0 * np.sin(np.outer(t, [2.0, 2.0]))  # in yaw
    speeds = 600.0 + np.column_stack([sway, -sway]) + 20.0 * np.sin(t / 3.0)[:, None]
    imu = np.random.default_rng(1).normal(0.0, 0.1, (len(t), 6))
    imu[:, 5] -= G * (speeds**2).mean(axis=1) / 600.0**2
    airframe = load_airframe("px4-quad-x")
    sampler = Sampler(RotorSourceSelector(airframe, ScaleReference("mass", 1.0)), 4)
    streams = (
        (Stream.IMU, imu, 0, ""),
        (Stream.ATTITUDE, np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1)), 0, ""),
        (Stream.ROTOR_SPEED, speeds, 0, "ESC_STATUS by motor"),
        (Stream.ROTOR_SPEED, speeds[:, :2], 1, "ESC_STATUS by output"),
    )
    order = 4 * np.arange(len(t))
    tracks = [Track(stream, t, *rest, order + i) for i, (stream, *rest) in enumerate(streams)]
    blocks = [*sampler.feed_tracks(tracks), *sampler.finish()]
    assert np.concatenate([block.flying for block in blocks])[500:].all()


def test_a_rotor_that_is_read_wrong_grounds_nothing_that_its_commands_or_the_others_carry():
    carried, sway = 1.0 + 0.05 * np.sin(T), 0.1 * np.sin(2.9 * T)
    alike, yawed = (np.sqrt(1.0 + np.outer(sway, each)) for each in ((1.0, 1.0), (7.0, -7.0)))
    for force, commands, speeds, stands in (
        (G * carried, UNKNOWN, alike, True),
        (G * carried, UNKNOWN, yawed, False),
        (G * carried, carried, alike, False),
        (np.full_like(T, G), carried, alike, True),
    ):
        seen = np.column_stack([carried + sway, commands])
        rates = np.full((len(T), 3), 0.1)
        assert (GroundTest().update(T, force, rates, seen, speeds) < 0.0).any() == stands


@pytest.mark.slow
@pytest.mark.parametrize("block", [pytest.param(1, marks=pytest.mark.thorough), 10**6])
@pytest.mark.parametrize("in_air", [UNKNOWN, between(5.0, 27.0)], ids=["untold", "told late"])
def test_what_lies_on_its_back_has_landed(in_air, block):
    """Rotors still turn after a crash, but they pull the other way."""
    force = np.where(T < 20.0, G, -G)
    found = sensed(between(5.0, 29.0, HOVER), force, in_air=in_air, block=block)
    spans(found, 5.0 + TAKE_OFF, found[-1])
    assert 20.0 <= found[-1] < 20.5
    # An accelerometer that never showed its weight the right way up tells nothing.
    assert len(sensed(between(5.0, 25.0, HOVER), np.full(len(T), -G))) > 15.0 * RATE


def test_where_a_record_begins_with_idling_rotors_is_known_once_it_has_left():
    speed = np.where(T < 5.0, IDLE, HOVER)
    found = sensed(speed)
    spans(found[found > 5.2], 5.0 + TAKE_OFF, T[-1])
    # Where it stood becomes known too, and with it the landing on the same ground.
    height = 12.0 + between(6.0, 20.0, 2.0)
    found = sensed(speed, height=height)
    spans(found[found > 5.2], 6.0 + TAKE_OFF, 20.0)


@pytest.mark.parametrize("curve", [1.0, 2.0], ids=["linear", "square"])
def test_commands_that_idle_are_told_from_those_that_carry(curve):
    """As thrust over command is: a punch-out is no landing, nor is the gentle hover after it."""
    command = np.where(T < 5.0, 0.1, 0.5) + between(10.0, 11.0, 0.45)
    thrust = G * (command / 0.5) ** curve
    idles = T >= 25.0
    force = np.where(idles | (T < 5.0), G, thrust)
    rate = np.where(idles | (T < 5.0), 0.01, 0.2)
    command[idles] = 0.1
    found = sensed(command * HOVER, force, rate, commands=True)
    found = found[found > 5.2]
    assert found[0] == pytest.approx(5.0 + TAKE_OFF, abs=0.1)
    assert 25.0 <= found[-1] < 25.5
    assert len(found) == pytest.approx((found[-1] - found[0]) * RATE, abs=2)


def test_a_hand_throw_counts_from_its_free_fall():
    """Rotors stand while it is thrown, and are told to turn in the air (LOG00230)."""
    speed = between(10.3, 20.0, HOVER)
    force = np.select([(T > 9.5) & (T < 9.8), (T >= 9.8) & (T < 10.3)], [30.0, 0.9], G)
    rate = np.select([(T > 8.0) & (T < 9.8), (T >= 9.8) & (T < 20.0)], [1.5, 4.0], 0.01)
    found = sensed(speed, force, rate)
    assert found[0] == pytest.approx(9.9, abs=0.1)
    assert 20.0 <= found[-1] < 20.5


def test_carrying_it_about_is_no_flight():
    rate = np.where((T > 5.0) & (T < 15.0), 2.0, 0.01)
    force = G + np.where((T > 5.0) & (T < 15.0), 3.0 * np.sin(7.0 * T), 0.0)
    assert len(sensed(0.0 * T, force, rate)) == 0


@pytest.mark.parametrize(("rest", "fallen"), [(1e-3, 1e-3), (5.0, 0.9), (20.0, 0.9)])
def test_an_accelerometer_that_never_read_one_g_tells_no_fall(rest, fallen):
    assert len(sensed(0.0 * T, between(10.0, 11.0, fallen, rest), 0.01 + 0.0 * T)) == 0


def test_hops_are_flights_of_their_own():
    height = between(5.0, 12.0, 1.0) + between(14.0, 20.0, 1.0)
    found = sensed(between(3.0, 22.0, HOVER), height=height)
    for start, end in ((5.0, 12.0), (14.0, 20.0)):
        inside = found[(found > start - 0.5) & (found < end + 0.5)]
        spans(inside, start + TAKE_OFF, end)


def test_a_height_that_is_lost_for_a_while_neither_lands_it_nor_lets_it_take_off():
    height = between(5.0, 12.0, 0.5) + between(20.0, 25.0, 0.5)
    height[(T > 8.0) & (T < 9.0) | (T > 12.5) & (T < 13.5)] = np.nan
    found = sensed(between(3.0, 29.0, HOVER), height=height)
    spans(found[found < 15.0], 5.0 + TAKE_OFF, 12.0)


def test_without_any_rotor_for_a_second_nothing_says_that_it_flies():
    speed = np.where((T > 15.0) & (T < 18.0), np.nan, between(5.0, 25.0, HOVER))
    force = np.full(len(T), G)
    found = sensed(speed, force, 0.2 + 0.0 * T)
    assert not np.any((found > 16.1) & (found < 18.9))
    assert np.any(found > 19.1)


@pytest.mark.slow
@pytest.mark.parametrize("block", [pytest.param(1, marks=pytest.mark.thorough), 7, 100])
def test_size_of_blocks_does_not_matter_with_an_imu(block):
    speed, force = falling(15.0, 15.5)
    speed = np.where(T < 5.0, IDLE, speed)
    height = 3.0 + between(6.0, 14.0, 2.0) + between(15.2, 25.0, 2.0)
    for told in ({}, {"height": height}, {"in_air": between(5.5, 25.2)}):
        whole = sensed(speed, force, **told)
        np.testing.assert_array_equal(sensed(speed, force, block=block, **told), whole)


# --- real flights


def of_log(path, airframe):
    """Times of the samples, and whether they count."""
    scale = ScaleReference(*(airframe.anchor() or ("mass", 1.0)))
    sampler = Sampler(RotorSourceSelector(airframe, scale), len(airframe.rotors))
    blocks = []
    for block in open_log(path, None).blocks():
        for part in block.windows():
            blocks += sampler.feed_tracks(part.tracks)
    blocks += sampler.finish()
    t = np.concatenate([block.t for block in blocks])
    return t, np.concatenate([block.flying for block in blocks])


@pytest.mark.slow
def test_an_emulated_flight_whose_throttle_is_cut_is_one_flight(tmp_path):
    """From take-off after 6 s on, untold; standing rotors read noise, as ESCs do."""
    log = tmp_path / "cut.tlog"
    words = ["--airframe", "px4-quad-x", "--mission", "all-axes", "--rate", "50"]
    words += ["--duration", "18", "--physics", "throttle-cut=12:0.5", "--physics", "idle=0"]
    words += ["--trap", "never-sent=EXTENDED_SYS_STATE"]
    assert sim_bridge([*words, "--trap", "ground=6", "--tlog", str(log)]) == 0
    t, flies = of_log(log, load_airframe("px4-quad-x"))
    assert 6.5 < t[flies][0] < 8.2
    assert flies[t >= t[flies][0]].all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.thorough] if k % 4 else [])
        for k, name in enumerate(AIR_TIMES)
    ],
)
def test_real_flights_use_their_air_time(name, shared_logs):
    folder = shared_logs / "real"
    if not (folder / f"{name}.tlog").exists():
        pytest.skip("this flight is not there")
    commands = "_cmd" if "cmd" in name else ""
    airframe = load_airframe(str(folder / f"cinerat{commands}.toml"))
    t, flies = of_log(folder / f"{name}.tlog", airframe)
    for start, end in AIR_TIMES[name]:
        inside = t[flies & (t > start + 0.5) & (t < end + 0.5)]
        # At most the second of the take-off is left out; the landing is found in time.
        assert inside[0] < start + TAKE_OFF + 0.2
        assert inside[-1] == pytest.approx(end, abs=0.5)
        assert len(inside) > 0.97 * (inside[-1] - inside[0]) / np.median(np.diff(t))


@pytest.mark.parametrize(("climbs", "block"), [(1.0, 10**6), (1.0, 7), (0.05, 10**6)])
def test_calm_thrust_carries_what_has_risen_a_meter_and_is_said_to_fly(climbs, block):
    """Steps before take-off showed the ground, and constant thrust shows nothing else since."""
    squares = 1e5 * np.where(T < 10.0, 2.0 + np.sin(0.8 * T), 4.0)
    up = np.maximum(T - 12.0, 0.0) * climbs
    force = np.column_stack([0.0 * T, 0.0 * T, 0.0 * T - G])
    detector, nothing, found = FlightDetector(), np.full(len(T), np.nan), []
    speeds = np.repeat(np.sqrt(squares)[:, None], 4, axis=1)
    position = np.column_stack([0.0 * T, 0.0 * T, -up])
    thrust = np.column_stack([squares, nothing])
    values = T, between(9.0, 40.0), 1.0 + 0.0 * T, speeds, position, force, 0.0 * force, thrust
    for i in range(0, len(T), block):
        found.append(detector.update(*(value[i : i + block] for value in values)))
    flying = T[np.concatenate(found)]
    if climbs < 0.1:
        assert not len(flying)
    else:
        assert flying[0] == pytest.approx(13.0 + TAKE_OFF, abs=0.2)
        spans(flying, flying[0], T[-1])
