"""Which rotor each value of a stream belongs to, by the functions of the outputs."""

import numpy as np
import pytest

from gcs_sysid.signals.columns import Track
from gcs_sysid.signals.motor_order import MotorOrder, out_of_order
from gcs_sysid.signals.records import Stream

T = np.arange(500) / 250.0


def servos(*outputs):
    return {f"SERVO{output}_FUNCTION": 33.0 + motor for motor, output in enumerate(outputs)}


def pwm(*outputs, driver="PWM_MAIN"):
    return {f"{driver}_FUNC{output}": 101.0 + motor for motor, output in enumerate(outputs)}


def sent(source, offset=0, width=16, stream=Stream.ROTOR_COMMAND):
    """Each value the number of its output."""
    return Track(stream, T, np.tile(np.arange(1.0 + offset, 1 + offset + width), (500, 1)),
                 offset, source)  # fmt: skip


def by_motor(order, *tracks):
    found = {}
    for track in order.tracks(tracks):
        for i, value in enumerate(track.values[0].tolist()):
            found.setdefault(track.source.partition("_TELEMETRY_")[0], {})[track.offset + i] = value
    return {name: [motors[i] for i in sorted(motors)] for name, motors in found.items()}


@pytest.mark.parametrize("outputs", [(1, 2, 3, 4), (9, 10, 11, 12), (5, 2, 13, 3), (4, 3, 2, 1)])
def test_motors_are_found_on_whatever_outputs_and_nothing_else_is_taken(outputs):
    order = MotorOrder.of("ardupilot", {**servos(*outputs), "SERVO7_FUNCTION": 7.0}, 4)
    escs = [sent(f"ESC_TELEMETRY_{n + 1}_TO_{n + 4}", n, 4, Stream.ROTOR_SPEED)
            for n in (0, 4, 8, 12)]  # fmt: skip
    expected = [float(output) for output in outputs]
    assert by_motor(order, sent("SERVO_OUTPUT_RAW"), *escs) == {
        "SERVO_OUTPUT_RAW": expected,
        "ESC": expected,
    }
    assert by_motor(order, sent("RCOU", width=14), sent("RCOU", 14, 4)) == {"RCOU": expected}
    # An order of which a part is known is not used.
    assert MotorOrder.of("ardupilot", servos(*outputs[1:]), 4) == MotorOrder("ardupilot")


def test_a_motor_that_version_1_cannot_hold_is_named():
    order = MotorOrder.of("ardupilot", servos(9, 10, 11, 12), 4)
    (track,) = order.tracks([sent("SERVO_OUTPUT_RAW", width=8)])
    assert track.values.shape == (500, 0)
    assert "motor 1 is on output 9, and MAVLink 1 has 8" in order.gap_in("SERVO_OUTPUT_RAW", 0)


@pytest.mark.parametrize("driver", ["PWM_MAIN", "PWM_AUX", "UAVCAN_EC", "SIM_GZ_EC"])
def test_outputs_of_px4_are_those_of_the_driver_that_turns_the_motors(driver):
    order = MotorOrder.of("px4", pwm(2, 4, 1, 3, driver=driver), 4)
    assert by_motor(order, sent("ACTUATOR_OUTPUT_STATUS")) == {
        "ACTUATOR_OUTPUT_STATUS": [2.0, 4.0, 1.0, 3.0]
    }
    assert by_motor(order, sent("actuator_motors", width=4)) == {
        "actuator_motors": [1.0, 2.0, 3.0, 4.0]
    }


def test_drivers_that_are_off_turn_no_motor():
    parameters = {
        **pwm(2, 4, 1, 3),
        **pwm(1, 2, 3, 4, driver="UAVCAN_EC"),
        **pwm(1, 2, 3, 4, driver="HIL_ACT"),
        "UAVCAN_ENABLE": 2.0,
        "SYS_HITL": 0.0,
    }
    assert MotorOrder.of("px4", parameters, 4).orders == (("PWM_MAIN", (1, 3, 0, 2)),)
    # Of two drivers that share the motors none has all.
    parameters = {**pwm(1, 2), "PWM_AUX_FUNC1": 103.0, "PWM_AUX_FUNC2": 104.0}
    order = MotorOrder.of("px4", parameters, 4)
    assert by_motor(order, sent("ACTUATOR_OUTPUT_STATUS")) == {}
    assert "no driver has all motors" in order.gap_in("ACTUATOR_OUTPUT_STATUS", 0)


@pytest.mark.parametrize("truth", ["motor", "output"])
def test_the_order_of_escs_is_that_in_which_they_follow_the_commands(truth):
    outputs = (1, 3, 0, 2)
    order = MotorOrder.of("px4", pwm(*(output + 1 for output in outputs)), 4)
    rng = np.random.default_rng(1)
    commands = np.cumsum(rng.normal(size=(500, 4)), axis=0)
    speeds = np.empty((500, 4))
    speeds[:, outputs if truth == "output" else (0, 1, 2, 3)] = 500.0 + 10.0 * commands
    speeds += rng.normal(size=speeds.shape)
    raw = Track(Stream.ROTOR_SPEED, T, speeds, 0, "ESC_STATUS")
    streams = {
        track.source: (track.stream, [(T, v) for v in track.values.T])
        for track in order.tracks([raw])
    }
    wrong = {"motor": "output", "output": "motor"}[truth]
    neither = out_of_order(streams, order)
    assert set(neither) == {"ESC_STATUS by motor", "ESC_STATUS by output"}
    assert all("motor or output" in why for why in neither.values())
    streams["ACTUATOR_OUTPUT_STATUS"] = Stream.ROTOR_COMMAND, [(T, v) for v in commands.T]
    assert set(out_of_order(streams, order)) == {f"ESC_STATUS by {wrong}"}


def test_outputs_that_no_rotor_follows_are_those_of_another_driver():
    """A gimbal on MAIN, motors on AUX: PX4 sends each driver's outputs from its own port."""
    parameters = {**pwm(2, 4, 1, 3, driver="PWM_AUX"), "PWM_MAIN_FUNC1": 0.0}
    assert MotorOrder.of("px4", parameters, 4).doubt("SERVO_OUTPUT_RAW") == ""
    order = MotorOrder.of("px4", {**parameters, "PWM_MAIN_FUNC1": 420.0}, 4)
    turn, move = np.random.default_rng(1).normal(size=(2, 500, 4)).cumsum(axis=1)
    outputs = np.hstack([move, turn[:, [2, 0, 3, 1]]])
    commands = {track.source: (track.stream, [(T, v) for v in track.values.T])
                for port in (0, 1) for track in order.tracks([Track(Stream.ROTOR_COMMAND, T,
                outputs[:, 4 * port : 4 * port + 4], 16 * port, "SERVO_OUTPUT_RAW")])}  # fmt: skip
    speeds = {"ESC_STATUS": (Stream.ROTOR_SPEED, [(T, v) for v in turn.T])}
    assert [*out_of_order(speeds | commands, order)] == ["SERVO_OUTPUT_RAW"]
    refused = out_of_order(commands, order)
    assert {*refused} == {"SERVO_OUTPUT_RAW", "SERVO_OUTPUT_RAW_1"}
    assert all("PWM_MAIN" in why and "PWM_AUX" in why for why in refused.values())
    del commands["SERVO_OUTPUT_RAW_1"]  # one alone is taken, and the motion may contradict it
    assert not out_of_order(commands, order)


def test_that_nothing_names_the_outputs_is_said():
    lacks = MotorOrder("ardupilot").unknown("SERVO_OUTPUT_RAW")
    assert lacks.endswith("the record lacks SERVOn_FUNCTION")
    assert not MotorOrder("ardupilot").unknown("RPM")
    named = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 5)}
    assert not MotorOrder.of("ardupilot", named, 4).unknown("SERVO_OUTPUT_RAW")
    assert "names 4 motors" in MotorOrder.of("ardupilot", named, 6).unknown("SERVO_OUTPUT_RAW")
