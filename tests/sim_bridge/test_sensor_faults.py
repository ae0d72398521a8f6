"""Each trap does what its name says, and nothing else."""

from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge import ardupilot
from sim_bridge.ardupilot import ArduPilot, recorder_rates
from sim_bridge.missions import MISSIONS
from sim_bridge.px4 import Px4
from sim_bridge.sensor_faults import make_sensor_faults, parse_sensor_fault
from sim_bridge.simulation import Simulation
from sim_bridge.vehicle_files import load_vehicle

OpenDesk = Callable[..., Any]


def begun(desk: Any) -> Any:
    """Past the start, where every stream is due at once."""
    desk.autopilot.poll(0)
    return desk


@pytest.fixture
def px4(open_desk: Any) -> OpenDesk:
    """A PX4 with traps, all axes excited."""

    def make(*sensor_faults: str, noise: str = "none", airframe: str = "px4-quad-x") -> Any:
        gusts, sensors = np.random.SeedSequence(0).spawn(2)
        simulation = Simulation(load_vehicle(airframe), MISSIONS["all-axes"], gusts, 0.0)
        chosen = make_sensor_faults(map(parse_sensor_fault, sensor_faults))
        return begun(open_desk(simulation, Px4(simulation, noise, 0.02, 250.0, sensors, chosen)))

    return make


@pytest.fixture
def copter(open_desk: Any) -> OpenDesk:
    """An ArduCopter with traps, asked for what a recording needs."""

    def make(*sensor_faults: str) -> Any:
        gusts, sensors = np.random.SeedSequence(0).spawn(2)
        simulation = Simulation(
            load_vehicle("ardupilot-quad-x"),
            MISSIONS["all-axes"],
            gusts,
            0.0,
            step_us=ardupilot.STEP_US,
            control_steps=ardupilot.LOOP_STEPS,
        )
        chosen = make_sensor_faults(map(parse_sensor_fault, sensor_faults))
        asked = recorder_rates(250.0)
        autopilot = ArduPilot(simulation, "none", 0.02, sensors, chosen, asked=asked)
        return begun(open_desk(simulation, autopilot))

    return make


def of_type(messages: list[Any], name: str) -> list[Any]:
    return [m for m in messages if m.get_type() == name]


def rpm_of(messages: list[Any]) -> np.ndarray:
    names = ("ESC_STATUS", "ESC_TELEMETRY_1_TO_4")
    return np.array([m.rpm for m in messages if m.get_type() in names])


@pytest.mark.slow
@pytest.mark.parametrize("autopilot", ["px4", "copter"])
def test_rotor_speeds_that_lie(autopilot: str, request: pytest.FixtureRequest) -> None:
    make: OpenDesk = request.getfixturevalue(autopilot)
    plain = rpm_of(make().notice(2.0))
    assert not rpm_of(make("rpm-zero").notice(2.0)).any()
    dead = rpm_of(make("rpm-dead=3").notice(2.0))
    assert not dead[:, 2].any()
    np.testing.assert_array_equal(dead[:, [0, 1, 3]], plain[:, [0, 1, 3]])
    radians = rpm_of(make("rpm-rad").notice(2.0))
    np.testing.assert_allclose(radians * 30.0 / np.pi, plain, atol=6.0)


def test_commanded_speeds_sold_as_measured_ones(px4: OpenDesk) -> None:
    desk = px4("rpm-command")
    heard = desk.notice(3.0)
    vehicle = desk.simulation.vehicle
    outputs = of_type(heard, "ACTUATOR_OUTPUT_STATUS")
    commands = (np.array([m.actuator[:4] for m in outputs]) - 1000.0) / 1000.0
    speeds = np.vectorize(vehicle.speed_of)(commands) * 30.0 / np.pi
    np.testing.assert_allclose(rpm_of(heard), speeds, atol=1.0)


@pytest.mark.slow
def test_old_rotor_speeds_under_fresh_stamps(px4: OpenDesk) -> None:
    status = of_type(px4("rpm-repeats=0.4", noise="mems").notice(6.0), "ESC_STATUS")
    repeats = [a.rpm == b.rpm for a, b in pairwise(status)]
    assert np.mean(repeats) == pytest.approx(0.4, abs=0.05)
    assert np.unique(np.diff([m.time_usec for m in status])).tolist() == [4000]
    again = of_type(px4(noise="mems").notice(2.0), "ESC_STATUS")
    assert sum(a.rpm == b.rpm for a, b in pairwise(again)) == 0


@pytest.mark.slow
def test_quaternions_flip_and_stay_the_same_attitude(px4: OpenDesk) -> None:
    heard = of_type(px4("quaternion-flips").notice(6.0), "ATTITUDE_QUATERNION")
    plain = of_type(px4().notice(6.0), "ATTITUDE_QUATERNION")
    q = np.array([[m.q1, m.q2, m.q3, m.q4] for m in heard])
    p = np.array([[m.q1, m.q2, m.q3, m.q4] for m in plain])
    signs = (q * p).sum(axis=1)
    np.testing.assert_allclose(np.abs(signs), 1.0, atol=1e-6)
    assert np.mean(signs < 0.0) == pytest.approx(0.2, abs=0.05)


def gyro_of(messages: list[Any]) -> np.ndarray:
    return np.array([[m.xgyro, m.ygyro, m.zgyro] for m in of_type(messages, "HIGHRES_IMU")])


def force_of(messages: list[Any]) -> np.ndarray:
    return np.array([[m.xacc, m.yacc, m.zacc] for m in of_type(messages, "HIGHRES_IMU")])


@pytest.mark.slow
def test_gyro_outliers(px4: OpenDesk) -> None:
    off = np.abs(gyro_of(px4("gyro-outliers=0.01").notice(5.0)) - gyro_of(px4().notice(5.0)))
    struck = off.max(axis=1) > 1.0
    assert np.mean(struck) == pytest.approx(0.01, abs=0.006)
    assert off[struck].max(axis=1).min() >= 8.0
    assert ((off > 0.0).sum(axis=1) <= 1).all()


def still(values: np.ndarray) -> np.ndarray:
    """(n,) whether a row repeats the one before."""
    return np.concatenate([[False], (np.diff(values, axis=0) == 0.0).all(axis=1)])


def test_sensors_that_stand_still_or_say_nothing(px4: OpenDesk) -> None:
    sensor_faults = ("imu-stuck=0.5:0.2", "imu-nan=1:0.1:0.5", "rpm-stuck=0.4:0.3")
    desk = px4(*sensor_faults, "attitude-nan=1.2:0.3", "attitude-stuck=0.6:0.4", noise="mems")
    heard = desk.notice(2.0)
    imu = of_type(heard, "HIGHRES_IMU")
    t = np.array([1e-6 * m.time_usec for m in imu])
    t -= t[0] - 0.004
    gyro = gyro_of(imu)
    stuck = still(np.hstack([gyro, force_of(imu)]))
    assert stuck[(t > 0.51) & (t < 0.69)].all()
    assert not stuck[(t < 0.49) | (t > 0.71)].any()
    missing = np.isnan(gyro).all(axis=1)
    assert missing[((t > 1.01) & (t < 1.09)) | ((t > 1.51) & (t < 1.59))].all()
    assert not missing[(t < 0.99) | ((t > 1.11) & (t < 1.49)) | ((t > 1.61) & (t < 1.95))].any()
    angles = np.array([[m.roll, m.pitch, m.yaw] for m in of_type(heard, "ATTITUDE")])
    t = np.arange(1, len(angles) + 1) * 2.0 / len(angles)
    assert still(angles)[(t > 0.63) & (t < 0.97)].all()
    assert np.isnan(angles)[(t > 1.23) & (t < 1.47)].all()
    assert np.isfinite(angles)[(t < 1.17) | (t > 1.53)].all()
    rpm = rpm_of(heard)
    t = 0.004 * np.arange(1, len(rpm) + 1)
    assert still(rpm)[(t > 0.41) & (t < 0.69)].all()
    assert still(rpm)[t > 0.71].mean() < 0.9


@pytest.mark.parametrize("autopilot", ["px4", "copter"])
def test_an_esc_falls_silent_in_flight(autopilot: str, request: pytest.FixtureRequest) -> None:
    rpm = rpm_of(request.getfixturevalue(autopilot)("esc-silent=3:1").notice(2.0))
    half = len(rpm) // 2
    assert rpm[: half - 2].all()
    assert not rpm[half + 2 :, 2].any()
    assert rpm[half + 2 :, [0, 1, 3]].all()


@pytest.mark.parametrize(("by", "least"), [(30.0, 51.0), (-0.5, 20.5), (-60.0, 0.0)])
def test_the_clock_is_set_in_flight(px4: OpenDesk, by: float, least: float) -> None:
    heard = px4(f"clock-jump=1:{by}").notice(2.0)
    stamps = 1e-6 * np.array([m.time_usec for m in of_type(heard, "HIGHRES_IMU")])
    steps = np.diff(stamps)
    at = int(np.argmax(np.abs(steps - 0.004)))
    assert at == pytest.approx(249, abs=2)
    assert stamps[at + 1] == pytest.approx(least, abs=0.01)
    np.testing.assert_allclose(np.delete(steps, at), 0.004, atol=2e-6)
    numbers = [m.get_seq() for m in heard]
    assert set(np.diff(numbers)) == {1, -255}  # no reboot


@pytest.mark.slow
def test_the_gyro_is_the_mean_of_the_interval_that_ends_at_its_stamp(px4: OpenDesk) -> None:
    desk = px4("gyro-average")
    rates = [desk.simulation.state.rates]
    sent = []
    for _ in range(6000):
        desk.simulation.step()
        rates.append(desk.simulation.state.rates)
        for frame in desk.autopilot.poll(desk.simulation.tick):
            message = desk.parser.decode(bytearray(frame))
            if message.get_type() == "HIGHRES_IMU":
                sent.append((desk.simulation.tick, message.xgyro, message.ygyro, message.zgyro))
    ticks = [int(row[0]) for row in sent[1:]]
    truth = np.array(rates)
    # 2 ms before the stamp to second order in time.
    middle = truth[[tick - 2 for tick in ticks]]
    np.testing.assert_allclose([row[1:] for row in sent[1:]], middle, atol=5e-4)
    assert np.abs(truth[ticks] - middle).max() > 0.05
    assert desk.autopilot.rotor_delay == pytest.approx(-0.002)


@pytest.mark.slow
def test_streams_that_are_late(px4: OpenDesk) -> None:
    plain = px4().notice(2.5)
    late = px4("rotor-late=8").notice(2.5)
    np.testing.assert_array_equal(rpm_of(late)[10:], rpm_of(plain)[8:-2])
    np.testing.assert_array_equal(gyro_of(late), gyro_of(plain))
    attitude = px4("attitude-late=20")
    imu = px4("imu-late=12")
    np.testing.assert_array_equal(gyro_of(imu.notice(2.5))[10:], gyro_of(plain)[7:-3])
    assert imu.autopilot.rotor_delay == pytest.approx(-0.012)
    rolls = [[m.roll for m in of_type(h, "ATTITUDE")] for h in (plain, attitude.notice(2.5))]
    assert rolls[1][10:] == rolls[0][8:-2]
    assert px4("rotor-late=8").autopilot.rotor_delay == pytest.approx(0.008)


@pytest.mark.slow
def test_skipped_samples_leave_no_gap_in_the_sequence(px4: OpenDesk) -> None:
    heard = px4("skips=0.02").notice(8.0)
    stamps = np.array([m.time_usec for m in of_type(heard, "HIGHRES_IMU")])
    assert 1.0 - len(stamps) / 2000 == pytest.approx(0.02, abs=0.01)
    assert set(np.diff(stamps)) > {4000, 8000}
    numbers = [m.get_seq() for m in heard]
    assert set(np.diff(numbers)) == {1, -255}


def test_sequence_numbers_out_of_order(px4: OpenDesk) -> None:
    steps = Counter(np.diff([m.get_seq() for m in px4("disorder").notice(3.0)]).tolist())
    assert steps[-1] > 20
    assert steps[1] > 20 * steps[-1] / 2
    assert len(of_type(px4("disorder").notice(1.0), "HIGHRES_IMU")) == 250


@pytest.mark.parametrize("autopilot", ["px4", "copter"])
def test_a_reboot(autopilot: str, request: pytest.FixtureRequest) -> None:
    desk = request.getfixturevalue(autopilot)("reboot=2")
    before = of_type(desk.notice(2.0 - desk.simulation.step_size), "HIGHRES_IMU")
    assert desk.counts(1.0) == {}
    assert desk.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, 105) == []
    after = desk.notice(1.0)
    imu = of_type(after, "HIGHRES_IMU")
    assert before[-1].time_usec > 20_000_000
    assert 3_000_000 <= imu[0].time_usec < 3_100_000
    assert len(imu) > 230
    assert after[0].get_seq() == 0
    if autopilot == "copter":
        assert of_type(after, "STATUSTEXT")
        assert not of_type(after, "LOCAL_POSITION_NED")  # not for 40 s after boot


@pytest.mark.parametrize(
    ("autopilot", "imu"), [("px4", 4), ("copter", 250)], ids=["px4", "ardupilot"]
)
def test_another_ground_station_resets_the_rates(
    autopilot: str, imu: int, request: pytest.FixtureRequest
) -> None:
    desk = request.getfixturevalue(autopilot)("rate-reset=1")
    step = desk.simulation.step_size
    assert desk.counts(1.0 - step)["SERVO_OUTPUT_RAW"] == 249
    counts = desk.counts(2.0 + step)
    assert counts["SERVO_OUTPUT_RAW"] == 8
    assert counts["HIGHRES_IMU"] == pytest.approx(2 * imu, abs=3)
    desk.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 36, 4000)
    assert desk.counts(1.0)["SERVO_OUTPUT_RAW"] == pytest.approx(250, abs=1)


def test_a_stream_that_is_acknowledged_and_never_comes(px4: OpenDesk) -> None:
    desk = px4("never-sent=ESC_STATUS", "never-sent=ESC_INFO")
    (ack,) = desk.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 291, 5000)
    assert ack.result == mavlink.MAV_RESULT_ACCEPTED
    assert desk.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, 291)[1].interval_us == 5000
    counts = desk.counts(2.0)
    assert counts["ESC_STATUS"] == counts["ESC_INFO"] == 0
    assert counts["HIGHRES_IMU"] == 500


def test_outputs_are_counted_with_those_that_drive_nothing(px4: OpenDesk) -> None:
    heard = px4("active-count").notice(0.1)
    outputs = of_type(heard, "ACTUATOR_OUTPUT_STATUS")[-1]
    assert outputs.active == 16
    assert min(outputs.actuator[:4]) > 1000.0
    assert set(outputs.actuator[4:16]) == {900.0}
    servo = of_type(heard, "SERVO_OUTPUT_RAW")[-1]
    assert (servo.servo5_raw, servo.servo16_raw) == (900, 900)


@pytest.mark.slow
def test_others_on_the_link(px4: OpenDesk) -> None:
    heard = px4("forwarded", "radio").notice(3.0)
    by_source: dict[tuple[int, int], Counter[str]] = {}
    for m in heard:
        source = (m.get_srcSystem(), m.get_srcComponent())
        by_source.setdefault(source, Counter())[m.get_type()] += 1
    assert set(by_source) == {(1, 1), (2, 1), (51, 68)}
    assert by_source[51, 68] == {"RADIO_STATUS": 3}
    assert by_source[2, 1] == {
        "HEARTBEAT": 3,
        "HIGHRES_IMU": 150,
        "ATTITUDE": 150,
        "ESC_STATUS": 150,
    }
    ours = [m for m in heard if m.get_srcSystem() == 1]
    assert set(np.diff([m.get_seq() for m in ours])) == {1, -255}
    np.testing.assert_array_equal(rpm_of(ours), rpm_of(px4().notice(3.0)))
