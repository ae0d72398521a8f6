"""Which rotor stream is believed."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.model.airframe import CommandRange, ScaleReference, load_airframe
from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.signals.redundant_commands import mean_of
from gcs_sysid.signals.rotor_source_selector import STRETCH, RotorSourceSelector, _is_function
from gcs_sysid.signals.rotor_units import (
    Range,
    are_digital,
    command_range,
    gyro_cutoff,
    normalized,
    starts_of,
)
from testbed.recordings import block_of

RATE = 100.0
RPM = 2.0 * math.pi / 60.0
MASS = ScaleReference("mass", 1.5)
PAPER = load_airframe("paper")


def signals(rotors=4, seconds=STRETCH, lag=0.03, rate=RATE, seed=1):
    """Times, commands of 0..1, and the speeds (rad/s) of the paper's rotors that follow them."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    wander = np.cumsum(rng.normal(size=(len(t), rotors)), axis=0) / math.sqrt(rate)
    u = 0.5 + 0.05 * np.tanh(wander) + 0.02 * rng.normal(size=(len(t), rotors))
    follows = u.copy()
    decay = math.exp(-1.0 / (rate * lag)) if lag else 0.0
    for k in range(1, len(t)):
        follows[k] = decay * follows[k - 1] + (1.0 - decay) * u[k]
    return t, u, 190.0 * np.sqrt(follows)


def records(stream, source, t, values, offset=0):
    return [
        Record(stream, x, tuple(row), offset, source)
        for x, row in zip(t.tolist(), values.tolist(), strict=True)
    ]


def speeds(values, t, source="ESC_STATUS", offset=0):
    return records(Stream.ROTOR_SPEED, source, t, np.round(values / RPM) * RPM, offset)


def commands(u, t, source="ACTUATOR_OUTPUT_STATUS"):
    return records(Stream.ROTOR_COMMAND, source, t, np.round(1000.0 + 1000.0 * u))


def judged(*streams, airframe=PAPER, anchor=MASS, rotor_selector=None):
    rotor_selector = rotor_selector or RotorSourceSelector(airframe, anchor)
    every = sorted((r for s in streams for r in s), key=lambda r: r.t)
    rotor_selector.extend(block_of(every).tracks)
    assert rotor_selector.fly(STRETCH)
    return rotor_selector


def test_measured_speeds_are_preferred():
    t, u, v = signals()
    rotor_selector = judged(commands(u, t), speeds(v, t))
    assert rotor_selector.choice.name == "ESC_STATUS"
    assert rotor_selector.choice.kind == "speed"
    assert rotor_selector.choice.scale == 1.0
    assert rotor_selector.choice.interval == pytest.approx(t[1] - t[0])
    assert rotor_selector.refused == {}


def test_readings_that_only_rounding_repeats_are_new_as_often_as_they_come():
    t, u, v = signals()
    calm = np.where(t[:, None] < 0.3 * t[-1], v, v[0] + np.sin(0.5 * t[:, None]))
    choice = judged(commands(u, t), speeds(np.round(calm), t)).choice
    assert choice.kind == "speed"
    assert choice.interval == pytest.approx(t[1] - t[0], rel=0.05)


@pytest.mark.parametrize(("slows", "speed"), [(True, 0.0), (False, np.nan)])
def test_a_speed_of_0_is_a_rotor_that_stands_where_it_has_slowed_down(slows, speed):
    t, _, v = signals()
    v[100:, 2] *= np.exp(-np.maximum(np.arange(len(t) - 100), 0) / 3.0) if slows else 1.0
    v[120:140, 2] = 0.0
    v[140:, 2] = v[:-140, 2]
    choice = judged(speeds(v, t)).choice
    assert choice.stops == slows
    np.testing.assert_equal(choice.read(v)[130, 2], speed)
    assert np.isfinite(choice.read(v)[130, 1])


def dead(v):
    v[:, 2] = 0.0


def frozen(v):
    v[:, 1] = v[0, 1]


def silent(v):
    v[:] = 0.0


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (silent, "reads 0 in flight"),
        (dead, "rotor 3 reads 0 while the others move"),
        (frozen, "rotor 2 stands still while the others move"),
    ],
)
def test_unsound_speeds_give_way_to_commands(spoil, why):
    t, u, v = signals()
    spoil(v)
    rotor_selector = judged(commands(u, t), speeds(v, t))
    assert rotor_selector.choice.kind == "command"
    assert rotor_selector.choice.name == "ACTUATOR_OUTPUT_STATUS"
    assert rotor_selector.choice.refused == {"ESC_STATUS": why}
    alone = judged(speeds(v, t))
    assert alone.choice is None
    assert alone.refused == {"ESC_STATUS": why}


def calm(v, spread=0.002):
    return v.mean(axis=0) * (1.0 + spread * (v - v.mean(axis=0)) / np.ptp(v, axis=0))


@pytest.mark.parametrize("ever", [True, False])
def test_a_rotor_found_dead_stays_so_in_a_calm_hover(ever):
    """A reading that never moved was believed in the calm hover before, wrongly."""
    t, _, v = signals()
    rotor_selector = RotorSourceSelector(PAPER, MASS)
    stuck = v.mean(axis=0)[1]

    def fly(n, values, reads):
        values = values.copy()
        if reads is not None:
            values[:, 1] = reads
        rotor_selector.extend(block_of(speeds(values, t + n * STRETCH)).tracks)
        assert rotor_selector.fly(STRETCH)
        return rotor_selector.choice is not None

    assert fly(0, calm(v), stuck if ever else None)
    assert not fly(1, v, stuck)
    assert rotor_selector.never_moved is ever
    assert not fly(2, calm(v), stuck)
    assert rotor_selector.refused == {"ESC_STATUS": "rotor 2 stands still as before"}
    assert fly(3, calm(v), None)
    assert fly(4, calm(v), stuck)  # it has moved since it was found dead
    assert not fly(5, calm(v), 0.0)
    assert rotor_selector.refused == {"ESC_STATUS": "rotor 2 reads 0 while the others move"}


def test_a_motor_at_its_limit_is_no_dead_telemetry():
    """A payload far out: one motor at full throttle, while the others fly the vehicle."""
    t, u, v = signals()
    u[:, 1] = 1.0
    assert judged(commands(u, t)).choice.kind == "command"
    # Another one has been as fast, or this one would only be the fastest there is.
    top = 1.2 * v.max()
    v[:, 1] = top
    assert judged(speeds(v, t)).choice is None
    v[5:9, 0] = top
    assert judged(speeds(v, t)).choice.name == "ESC_STATUS"
    u[:, 1] = 0.5  # below the others
    refused = judged(commands(u, t)).refused
    assert refused == {"ACTUATOR_OUTPUT_STATUS": "rotor 2 stands still while the others move"}


@pytest.mark.parametrize("rate", [4.0, 20.0])
def test_slow_speeds_do_not_follow_the_rotors(rate):
    t, u, v = signals()
    every = round(RATE / rate)
    rotor_selector = judged(commands(u, t), speeds(v[::every], t[::every]))
    assert rotor_selector.choice.kind == ("command" if rate < 15.0 else "speed")


@pytest.mark.parametrize("unit", [1.0, RPM])
def test_commands_sold_as_measured_speeds_are_commands(unit):
    t, u, v = signals(lag=0.0)
    rotor_selector = judged(commands(u, t), speeds(unit * v, t))
    assert rotor_selector.choice.kind == "command"
    assert "ACTUATOR_OUTPUT_STATUS under another name" in rotor_selector.refused["ESC_STATUS"]


def test_speeds_of_a_slow_climb_are_measured():
    """What a lag leaves of it is less than rounding."""
    t = signals()[0]
    u, behind = (np.tile(0.5 + 0.04 * (t - late)[:, None], 4) for late in (0.0, 0.03))
    rotor_selector = judged(commands(u, t), speeds(190.0 * np.sqrt(behind), t))
    assert rotor_selector.choice.name == "ESC_STATUS"
    few = t[:21] / 3.0, u[:21], 190.0 * np.sqrt(u[:21])  # no longer than a lag
    assert not _is_function(few[0], few[2][:, 0], few[0], few[1][:, 0])


def test_rad_per_second_in_a_field_of_rpm_shows_by_the_thrust():
    t, _u, v = signals()
    right, wrong = judged(speeds(v, t)), judged(speeds(RPM * v, t))
    assert right.choice.scale == 1.0
    assert wrong.choice.scale == pytest.approx(1.0 / RPM)
    assert "rad/s" in wrong.choice.why
    read = wrong.choice.read(RPM * v)
    np.testing.assert_allclose(read, v)
    # Coaxial rotors, measured a few millimeters apart, are no small ones.
    under = tuple(replace(rotor, x=rotor.x + 0.004, spin=-rotor.spin) for rotor in PAPER.rotors)
    coaxial = replace(PAPER, rotors=PAPER.rotors + under)
    both = np.hstack([v, v]) / np.sqrt(2.0)
    assert judged(speeds(both, t), airframe=coaxial).choice.scale == 1.0
    assert judged(speeds(RPM * both, t), airframe=coaxial).choice.scale == pytest.approx(1.0 / RPM)


def test_sensors_are_no_input_beside_escs_nor_speeds_that_may_be_backward():
    t, u, v = signals()
    sensors, slow = speeds(1.1 * v, t, "RPM"), speeds(v[::20], t[::20], "ESC")
    assert judged(sensors).choice.name == "RPM"
    beside = judged(sensors, slow, commands(u, t))
    assert beside.refused["RPM"] == "is of RPM sensors, beside ESC"
    assert beside.choice.kind == "command"
    for name, value in (("CA_R_REV", 15.0), ("SERVO_BLH_3DMASK", 1.0), ("features", 4097.0)):
        both_ways = RotorSourceSelector(PAPER, MASS)
        both_ways.learn(name, value)
        refused = judged(speeds(v, t), commands(u, t), rotor_selector=both_ways).refused
        assert len([why for why in refused.values() if "3D mode" in why]) == 2


def test_groups_of_one_kind_are_one_source():
    t, _u, v = signals(rotors=6)
    airframe = load_airframe("ardupilot-hexa-x")
    first = speeds(v[:, :4], t, "ESC_TELEMETRY_1_TO_4")
    second = speeds(v[:, 4:], t, "ESC_TELEMETRY_5_TO_8", offset=4)
    assert judged(first, second, airframe=airframe).choice.name == "ESC_TELEMETRY"
    half = judged(first, airframe=airframe)
    assert half.choice is None
    assert half.refused == {"ESC_TELEMETRY": "lacks rotor 5 of 6"}


@pytest.mark.parametrize(
    ("anchor", "wanted", "kind"),
    [
        (ScaleReference("k_T", 2e-4), "auto", "speed"),
        (ScaleReference("T_max", 7.0), "auto", "command"),
        (MASS, "command", "command"),
        (MASS, "speed", "speed"),
    ],
)
def test_scale_and_airframe_decide_between_sound_sources(anchor, wanted, kind):
    t, u, v = signals()
    airframe = replace(PAPER, rotor_input=wanted)
    found = judged(commands(u, t), speeds(v, t), airframe=airframe, anchor=anchor)
    assert found.choice.kind == kind


@pytest.mark.parametrize(
    ("late", "above", "every", "source", "together"),
    [
        (0.0, 0.0, 1, "SERVO_OUTPUT_RAW", True),
        (0.5, 0.0, 1, "SERVO_OUTPUT_RAW", False),
        (0.0, 0.1, 1, "SERVO_OUTPUT_RAW", False),
        (0.0, 0.0, 2, "SERVO_OUTPUT_RAW", False),
        (0.0, 0.0, 1, "RCOU", False),
    ],
)
def test_streams_that_tell_the_same_commands_are_used_together(
    late, above, every, source, together
):
    """And not what comes late, is about something else, or comes more seldom."""
    t, u, _ = signals(rate=2.0 * RATE)
    first, second = slice(None, None, 2), slice(1, None, 2 * every)
    other = commands(u[second] + above, t[second] + late, source)
    rotor_selector = judged(commands(u[first], t[first]), other)
    assert rotor_selector.choice.name == "ACTUATOR_OUTPUT_STATUS"
    assert rotor_selector.twin == (source if together else None)


def test_two_streams_make_one_of_what_each_has():
    one = np.array([[1.0, 1.0], [np.nan, 1.0], [2.0, np.nan]])
    other = np.array([[2.0, 3.0], [4.0, np.nan], [6.0, np.nan]])
    np.testing.assert_array_equal(mean_of(one, other), [[1.5, 2.0], [4.0, 1.0], [4.0, np.nan]])


def test_a_source_that_dies_in_flight_is_replaced():
    t, u, v = signals()
    rotor_selector = judged(commands(u, t), speeds(v, t))
    later = t + STRETCH
    judged(commands(u, later), speeds(v, later), rotor_selector=rotor_selector)
    assert rotor_selector.choice.kind == "speed"
    judged(commands(u, later), speeds(0.0 * v, later), rotor_selector=rotor_selector)
    assert rotor_selector.choice.kind == "command"
    assert rotor_selector.choice.why.startswith("ESC_STATUS died in flight")
    # It does not come back: segments with different inputs cannot be one.
    judged(commands(u, later), speeds(v, later), rotor_selector=rotor_selector)
    assert rotor_selector.choice.kind == "command"


def test_stopped_outputs_are_no_input():
    t, u, _v = signals()
    rotor_selector = judged(commands(0.0 * u - 0.1, t))
    assert rotor_selector.choice is None
    assert "stopped or idling" in rotor_selector.refused["ACTUATOR_OUTPUT_STATUS"]


USUAL = CommandRange()
SPIN = {"MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0, "MOT_SPIN_MIN": 0.1, "MOT_SPIN_MAX": 0.9}
GAZEBO = {"SIM_GZ_EC_FUNC1": 101.0, "SIM_GZ_EC_MIN1": 0.0, "SIM_GZ_EC_MAX1": 1000.0}
DSHOT = {"PWM_AUX_FUNC1": 101.0, "PWM_AUX_MIN1": 1000.0, "PWM_AUX_MAX1": 2000.0,
         "PWM_AUX_TIM1": -3.0, "DSHOT_MIN": 0.1}  # fmt: skip
CAN = {"UAVCAN_EC_FUNC1": 101.0, "UAVCAN_EC_MIN1": 1.0, "UAVCAN_EC_MAX1": 8191.0}
CHANNEL = {"MOT_PWM_MIN": 0.0, "RC3_MIN": 1100.0, "RC3_MAX": 1900.0, "MOT_SPIN_MIN": 0.1,
           "MOT_SPIN_MAX": 0.9}  # fmt: skip
OTHER = CHANNEL | {"RCMAP_THROTTLE": 1.0, "RC1_MIN": 1000.0, "RC1_MAX": 2000.0}
COPTER_3_1 = {"RCMAP_THROTTLE": 1.0, "RC1_MIN": 1100.0, "RC1_MAX": 1922.0, "RC3_MIN": 1113.0,
              "RC3_MAX": 1906.0, "THR_MIN": 130.0, "MOT_TCRV_ENABLE": 1.0,
              "MOT_TCRV_MAXPCT": 93.0}  # fmt: skip
BLACKBOX = {"motorOutput[0]": 158.0, "minthrottle": 1070.0, "maxthrottle": 1900.0}
BOARD = {"PWM_MAIN_FUNC3": 101.0, "PWM_MAIN_MIN3": 1100.0, "PWM_MAIN_MAX3": 1900.0}


@pytest.mark.parametrize(
    ("source", "given", "autopilot", "parameters", "largest", "expected"),
    [
        ("actuator_motors", CommandRange(900, 2100, given=True), "px4", {}, 0.7, (0, 1)),
        ("RCOU", CommandRange(900, 2100, given=True), "ardupilot", SPIN, 1500, (900, 2100)),
        ("RCOU", USUAL, "ardupilot", SPIN, 1500, (1180, 1820)),
        # MOT_PWM_MIN = 0 means the range of the throttle's channel; of Copter 3.1 it is 3 whatever
        # RCMAP says, and the curve's end is in percent.
        ("RCOU", USUAL, "ardupilot", CHANNEL, 1600, (1180, 1820)),
        ("RCOU", USUAL, "ardupilot", OTHER, 1600, (1100, 1900)),
        ("RCOU", USUAL, "ardupilot", COPTER_3_1, 1600, (1216.09, 1850.49)),
        ("SERVO_OUTPUT_RAW", USUAL, "px4", {}, 1500, (1000, 2000)),
        ("ACTUATOR_OUTPUT_STATUS", USUAL, "px4", BOARD, 1500, (1100, 1900)),
        ("ACTUATOR_OUTPUT_STATUS", USUAL, "px4", GAZEBO, 640, (0, 1000)),
        ("ACTUATOR_OUTPUT_STATUS", USUAL, "px4", DSHOT, 1500, (199.9, 1999)),
        ("motor", USUAL, "generic", {"motor_pwm_protocol": 6.0}, 1500, (48, 2047)),
        ("motor", USUAL, "generic", BLACKBOX | {"motorOutput[1]": 2047.0}, 1500, (48, 2047)),
        ("motor", USUAL, "generic", BLACKBOX | {"dshot_bidir": 1.0}, 1500, (48, 2047)),
        ("motor", USUAL, "generic", BLACKBOX | {"motor_pwm_protocol": 1.0}, 1500, (1070, 1900)),
        ("motor", USUAL, "generic", BLACKBOX, 1500, (1070, 1900)),
        ("ACTUATOR_OUTPUT_STATUS", USUAL, "px4", {}, 0.6, (0, 1)),
        ("actuator_outputs", USUAL, "px4", {"PWM_MIN": 1075, "PWM_MAX": 1950}, 1500, (1075, 1950)),
        # A mapping has made them commands already, whatever the airframe's range is of.
        ("commands", CommandRange(0, 65535, given=True), "generic", {}, 0.7, (0, 1)),
        ("commands", CommandRange(0.1, 0.9, given=True), "generic", {}, 0.7, (0.1, 0.9)),
        ("ACTUATOR_OUTPUT_STATUS", USUAL, "px4", {}, 640, None),
        ("ACTUATOR_OUTPUT_STATUS", USUAL, "px4", {}, 5000, None),
    ],
)
def test_range_of_commands(source, given, autopilot, parameters, largest, expected):
    found = command_range(source, given, autopilot, parameters, (largest, largest))
    if expected is None:
        assert "unknown unit" in found
    else:
        assert (found.low, found.high) == pytest.approx(expected)
        assert found.assumed is ("assumed" in found.origin)


def test_numbers_of_dshot_are_no_pulses():
    outputs = np.array([150.0, 700.0, 1500.0])
    dshot = {"motorOutput[1]": 2047.0}
    for source, known in (("motor", dshot), ("RCOU", DSHOT), ("SERVO_OUTPUT_RAW", CAN)):
        assert are_digital(source, known, outputs[:, None])
    for source, known in (("motor", {"motorOutput[1]": 2000.0}), ("RCOU", dshot)):
        assert not are_digital(source, known, outputs[:, None])
    outputs = outputs.astype(float)
    assert starts_of("motor", outputs, digital=True).tolist() == [48.0] * 3
    assert starts_of("motor", outputs, digital=False).tolist() == [0.0, 1000.0, 1000.0]


@pytest.mark.parametrize(
    ("outputs", "digital"),
    [
        ([0.0, 110.0, 110.0, 700.0], True),  # idles
        ([700.0, 500.0, 650.0], True),
        ([0.0, 250.0, 500.0, 750.0, 1000.0, 1000.0], False),  # straight to the first pulse
        ([0.0, 0.0, 900.0, 900.0], False),
    ],
)
def test_what_stays_where_no_pulse_is_shows_a_digital_driver(outputs, digital):
    assert are_digital("actuator_outputs", {}, np.array(outputs)[:, None]) is digital


@pytest.mark.parametrize(("source", "low"), [("eRPM", True), ("ESC_STATUS", False)])
def test_a_unit_that_firmware_defines_is_not_guessed(source, low):
    """Ever so slow for the mass: ESCs may send rad/s as rpm, Betaflight does not."""
    t, _u, v = signals()
    rotor_selector = judged(speeds(0.1 * v, t, source))
    assert (rotor_selector.choice.scale == 1.0) is low
    doubt = rotor_selector.doubt(rotor_selector.choice)
    assert doubt.assumed == ("eRPM without motor_poles in the log: 14 poles assumed" if low else "")
    assert doubt.as_sent.startswith("" if low else "rotor speeds are taken as sent")


@pytest.mark.parametrize(
    ("source", "logged", "scale"),
    [
        ("eRPM", {}, 14.0 / 12.0), ("omegaUnfiltered", {"motor_poles": 10.0}, 10.0 / 12.0),
        ("ESC", {"SERVO_FTW_MASK": 15.0, "SERVO_FTW_POLES": 24.0}, 2.0),
        ("ESC", {"CAN_D1_PROTOCOL": 8.0, "CAN_D1_KDE_NPOLE": 6.0}, 0.5),
        ("omegaUnfiltered", {}, None), ("ESC", {"SERVO_FTW_MASK": 0.0}, None),
    ],
)  # fmt: skip
def test_poles_that_were_counted_are_given_and_no_assumption(source, logged, scale):
    t, _u, v = signals()
    rotor_selector = RotorSourceSelector(replace(PAPER, motor_poles=12), MASS)
    for name, value in logged.items():
        rotor_selector.learn(name, value)
    judged(speeds(v, t, source), rotor_selector=rotor_selector)
    assert rotor_selector.choice.scale == pytest.approx(scale or 1.0)
    assumed, as_sent = rotor_selector.doubt(rotor_selector.choice)
    assert not assumed
    assert ("motor_poles is not used" in as_sent) is (scale is None)


def test_stopped_is_zero():
    # Curves between samples pass a little below and above.
    outputs = np.array([900.0, 600.0, 0.0, 1000.0, 1500.0, 2000.0, 990.0, 2010.0])
    u = normalized(outputs, Range(1000, 2000, ""))
    np.testing.assert_allclose(u, [0.0, 0.0, 0.0, 0.0, 0.5, 1.0, -0.01, 1.01])


@pytest.mark.parametrize(
    ("given", "autopilot", "parameters", "expected"),
    [
        (None, "px4", {"IMU_GYRO_CUTOFF": 40.0}, None),
        (None, "ardupilot", {}, 20.0),
        (None, "ardupilot", {"INS_GYRO_FILTER": 40.0}, 40.0),
        (None, "ardupilot", {"INS_GYRO_FILTER": 0.0}, None),
        (30.0, "ardupilot", {"INS_GYRO_FILTER": 40.0}, 30.0),
        (0.0, "ardupilot", {}, None),
    ],
)
def test_filter_of_the_gyro(given, autopilot, parameters, expected):
    assert gyro_cutoff(given, autopilot, parameters) == expected


def repeating(v, every):
    """Speeds of which only every so many-th is read anew."""
    return v[np.arange(len(v)) // every * every]


def test_speeds_that_repeat_old_readings_give_way_if_but_of_one_rotor():
    t, u, v = signals()
    one = v.copy()
    one[:, 2] = repeating(v[:, 2], 4)
    for read, why in ((repeating(v, 20), ", 5 new ones a second"), (one, " of rotor 3, ")):
        choice = judged(commands(u, t), speeds(read, t)).choice
        assert choice.kind == "command"
        assert f"repeats old readings{why}" in choice.refused["ESC_STATUS"]


def test_groups_of_rotors_repeat_on_their_own():
    rotor_selector = RotorSourceSelector(PAPER, MASS)
    for i in range(50):
        for offset in (0, 4):
            values = (float(i) if offset else 1.0,) * 4
            source = f"ESC_TELEMETRY_{offset + 1}_TO_{offset + 4}"
            record = Record(Stream.ROTOR_SPEED, 0.01 * i, values, offset, source)
            rotor_selector.extend(block_of([record]).tracks)
    assert rotor_selector.repeats["ESC_TELEMETRY"].as_dict() == {"count": 49, "percent": 50.0}


def test_a_range_that_the_parameters_leave_open_is_assumed():
    pulses, px4 = {"MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0}, {"PWM_MAIN_FUNC1": 101.0}
    for key, known in (
        ("ardupilot", SPIN | {"MOT_PWM_MIN": 0.0}),
        ("ardupilot", pulses),
        # One end of a range is lost, as by damage.
        ("ardupilot", SPIN | {"MOT_PWM_MAX": 0.0, "RC3_MIN": 1100.0, "RC3_MAX": 1900.0}),
        ("px4", px4),
        ("ardupilot", {}),
        ("px4", {}),
    ):
        found = command_range("RCOU", CommandRange(), key, known, (1600.0, 1600.0))
        assert found.assumed
        assert "assumed" in found.origin
    simulated = px4 | {"SIM_BAT": 1}
    assert not command_range("RCOU", CommandRange(), "px4", simulated, (1000.0, 1600.0)).assumed
    # DShot, of which nothing is in the log, or the range of pulses alone.
    for known in (px4, BOARD):
        found = command_range("actuator_outputs", CommandRange(), "px4", known, (110.0, 1600.0))
        assert "unknown unit" in found
