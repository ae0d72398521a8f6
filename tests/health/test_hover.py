"""Averages over hover at any rate: exact where signals are straight, and the chain to a health."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.health import balance, command_curve
from gcs_sysid.health.airframe_guess import GuessedAirframe
from gcs_sysid.health.assessment import health_of
from gcs_sysid.health.hover import windows_of
from gcs_sysid.health.log_streams import FlightTimes, RotorStream, Streams, streams_of
from gcs_sysid.health.vehicle_health import HealthOptions
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.signals.columns import IntakeEvent
from gcs_sysid.signals.records import Record, Stream
from gcs_sysid.signals.recursions import lfilter
from testbed.recordings import block_of

G = 9.80665


def flight(
    *, seconds=40.0, imu=25.0, rotors=10.0, loads=(1.0, 1.0, 1.0, 1.0), start=100.0, drag=0.0,
    commands=None, curve=0.5, reboot=False, climb=True, throttles=(0.4, 0.4, 0.4, 0.4),
    sensors=True, rocks=0.0, gyro=1.0,
):  # fmt: skip
    """Records of a quad that hovers, its speeds squared over 1e5 as `loads`, climbing a little.

    It rocks in roll by `rocks` rad, of which the gyro reads a share.
    """
    out = []

    def lift(t):
        return 1.0 + (0.08 * math.sin(0.9 * t) * (t > 10.0) if climb else 0.0)

    def add(stream, rate, make, source=""):
        for i in range(int(seconds * rate)):
            t = i / rate
            late = 90.0 if reboot and t > seconds / 2.0 else 0.0
            out.append((t, Record(stream, start + t - late, make(t), 0, source)))

    def imu_of(t):
        rate = gyro * rocks * 2.0 * math.cos(2.0 * t)
        return (rate, 0.0, 0.0, -drag, 0.0, -G * lift(t) if sensors else 0.0)

    def attitude_of(t):
        half = 0.5 * rocks * math.sin(2.0 * t)
        return (math.cos(half), math.sin(half), 0.0, 0.0)

    def speeds(t):
        return tuple(math.sqrt(1e5 * load * lift(t)) for load in loads)

    def u_of(t):
        # (1 - c) u + c u^2 = share
        share = [full * load * lift(t) for full, load in zip(throttles, loads, strict=True)]
        a, b = 1.0 - curve, curve
        return tuple(
            1000.0 + 1000.0 * (s / a if b < 1e-9 else (-a + math.sqrt(a * a + 4 * b * s)) / (2 * b))
            for s in share
        )

    add(Stream.IMU, imu, imu_of)
    if sensors:
        add(Stream.ATTITUDE, 10.0, attitude_of)
    add(Stream.IN_AIR, 1.0, lambda t: (1.0,))
    if commands:
        add(Stream.ROTOR_COMMAND, rotors, u_of, "ACTUATOR_OUTPUT_STATUS")
    if commands != "alone":
        add(Stream.ROTOR_SPEED, rotors, speeds, "ESC_STATUS")
    ordered = [record for _, record in sorted(out, key=lambda entry: entry[0])]
    block = block_of(ordered)
    if reboot:
        first = next(i for i, r in enumerate(ordered) if i and r.t < ordered[i - 1].t - 10.0)
        block = replace(block, events=((first, IntakeEvent(start, "reboot", "")),))
    return [block]


@pytest.fixture(scope="module")
def airframe():
    return load_airframe("px4-quad-x").with_arm(0.3).with_anchor("mass", 2.0)


PULSES = {"PWM_MAIN_FUNC1": 101.0, "PWM_MAIN_MIN1": 1000.0, "PWM_MAIN_MAX1": 2000.0}


def told(blocks, airframe, parameters=PULSES, **given):
    streams = streams_of(blocks, airframe, "px4", parameters)
    options = HealthOptions(airframe, **given)
    return health_of(streams, GuessedAirframe(airframe, "given"), options, parameters)


@pytest.mark.parametrize(
    ("imu", "rotors"), [(250.0, 250.0), (25.0, 10.0), (10.0, 5.0), (12.5, 3.0)]
)
def test_a_loaded_rotor_moves_the_cg_at_any_rate(airframe, imu, rotors):
    loads = (1.0, 1.1, 0.95, 1.05)
    health = told(flight(imu=imu, rotors=rotors, loads=loads), airframe)
    x, y, spin = airframe.geometry
    share = np.array(loads) / sum(loads)
    assert health.cg[0].value == pytest.approx(share @ x, abs=2e-4)
    assert health.cg[1].value == pytest.approx(share @ y, abs=2e-4)
    assert [r.thrust_share.value for r in health.rotors] == pytest.approx(share, abs=2e-4)
    assert health.yaw_imbalance.value == pytest.approx(share @ spin, abs=2e-4)
    name, k_T = health.scale
    assert name == "k_T"
    assert k_T.value == pytest.approx(2.0 * G / (1e5 * sum(loads)), rel=3e-3)
    assert k_T.ci95[0] < 2.0 * G / (1e5 * sum(loads)) < k_T.ci95[1]


def test_rotors_that_idle_at_their_least_command_do_not_hover(airframe):
    """Armed on the ground: the ESCs report that the rotors turn."""
    health = told(flight(commands="beside", throttles=(0.0, 0.0, 0.0, 0.0)), airframe)
    assert not health.available
    assert "never in the air" in health.reasons[0]


def test_an_accelerometer_that_reads_zero_shows_no_hover(airframe):
    health = told(flight(commands="alone", sensors=False), airframe)
    assert not health.available
    assert "there is no accelerometer" in health.reasons[0]


@pytest.mark.parametrize(
    ("given", "what"),
    [
        ({"mass": 1400.0}, "1400 kg is implausible for an arm of 0.3 m"),
        ({"mass": 0.02}, "0.02 kg is implausible"),
        ({"k_T": 2e-9}, "kg is implausible for an arm"),
        ({"mass": 30.0}, "takes rotors that do not fit"),
    ],
)
def test_what_cannot_be_given_together_is_named_and_no_scale_comes_of_it(airframe, given, what):
    ((name, value),) = given.items()
    health = told(flight(), airframe.with_anchor(name, value))
    assert health.findings[0].at == "what was given"
    assert what in health.findings[0].what
    assert (health.scale, health.mass) == (None, None)


def test_what_is_in_proportion_to_an_assumed_unit_is_no_number(airframe):
    known, streams = airframe.with_anchor("mass", 1.5), streams_of(flight(), airframe, "px4", {})
    guess = GuessedAirframe(known, "given")
    dshot = {"MOT_PWM_TYPE": 6.0, "SERVO_BLH_POLES": 28.0}
    for source, parameters, said in (
        ("eRPM", {}, "14 poles"), ("eRPM", {"motor_poles": 14.0}, "14 poles"),
        ("eRPM", {"motor_poles": 28.0}, "28 poles"), ("omegaUnfiltered", {"motor_poles": 28.0}, ""),
        ("ESC", dshot, "28 poles"), ("ESC", {"MOT_PWM_TYPE": 0.0, "SERVO_BLH_POLES": 28.0}, ""),
        ("esc_status", {"PWM_AUX_FUNC1": 101.0, "PWM_AUX_TIM0": -4.0}, "14 poles"),
    ):  # fmt: skip
        read = replace(streams, speeds=replace(streams.speeds, source=source))
        health = health_of(read, guess, HealthOptions(known), parameters)
        assert any(said and said in text for text in health.assumptions) is bool(said)
        assert (health.scale is None) is bool(said)


def test_rad_s_in_a_field_of_rpm_are_read_as_by_an_analysis(airframe):
    known = airframe.with_anchor("mass", 1.5)
    streams = streams_of(flight(), airframe, "px4", {})
    slow = tuple((t, 0.1 * v) for t, v in streams.speeds.samples)
    streams = replace(streams, speeds=replace(streams.speeds, samples=slow))
    health = health_of(streams, GuessedAirframe(known, "given"), HealthOptions(known), {})
    assert "read as rad/s" in health.findings[0].what
    assert health.scale is None


@pytest.mark.parametrize("commands", ["alone", "beside"])
def test_of_commands_whose_range_is_assumed_the_balance_is_shown(airframe, commands):
    """Pulses of 1100 to 1900 us are taken for 1000 to 2000, which the CG's interval holds."""
    records = flight(commands=commands, loads=(1.2, 0.8, 1.2, 0.8), climb=False)
    pulses = {"PWM_MAIN_MIN1": 1100.0, "PWM_MAIN_MAX1": 1900.0}
    right, health = (told(records, airframe, each) for each in (PULSES | pulses, {}))
    assert health.hover_throttle is health.thrust_to_weight is None
    assert health.through_motors is (commands == "alone")
    assert any("1000 to 2000" in text for text in health.assumptions)
    off = abs(health.cg[0].value - right.cg[0].value)
    assert (off > 0.005) is health.through_motors
    assert off < 1.5 * health.cg[0].std
    bent = replace(airframe, command=replace(airframe.command, thrust_curve=0.5))
    gain = told(records, bent, {}).rotors[0].motor_gain
    assert gain is None or abs(right.rotors[0].motor_gain.value - gain.value) < 2.0 * gain.std


def test_of_an_arm_that_is_not_known_only_what_no_arm_allows_is_named(airframe):
    for mass, named in ((20.0, False), (14000.0, True)):
        known = airframe.with_anchor("mass", mass)
        guess = GuessedAirframe(known, "assumed", arm_std=0.5)
        health = health_of(streams_of(flight(), known, "px4", {}), guess, HealthOptions(known), {})
        assert any(found.at == "what was given" for found in health.findings) is named


@pytest.mark.parametrize(
    ("gyro", "said"), [(1.0, ""), (0.5, "reads 0.50 of what"), (57.3, "deg/s")]
)
def test_a_gyro_that_misreads_is_the_first_thing_said(airframe, gyro, said):
    records = flight(rocks=0.1, gyro=gyro, climb=False)
    health = told(records, airframe)
    first = [f.what for f in health.findings if f.at == "the gyro"] or list(health.reasons)
    assert said in " ".join(first[:1])
    assert bool(first) is bool(said)
    # No motor order is contradicted by it.
    guess = GuessedAirframe(airframe, "given", as_flown="another order")
    health = health_of(streams_of(records, airframe, "px4", {}), guess, HealthOptions(airframe), {})
    assert health.contradicted is not bool(said)


def test_a_rotor_that_stands_has_no_load_to_compare(airframe):
    health = told(flight(seconds=80.0, loads=(1.0, 1.0, 0.0, 1.0)), airframe)
    assert health.load is None
    assert health.weakened is None


def test_a_rotor_that_turns_without_a_command_has_no_motor_gain(airframe):
    health = told(flight(commands="beside", throttles=(0.4, 0.0, 0.4, 0.4)), airframe)
    assert [rotor.motor_gain for rotor in health.rotors] == [None] * 4
    assert health.thrust_to_weight is None or np.isfinite(health.thrust_to_weight.value)


@pytest.mark.parametrize("curve", [0.0, 0.3, 0.65, 1.0])
@pytest.mark.parametrize("commands", ["alone", "beside"])
def test_the_thrust_curve_by_climbs(airframe, curve, commands):
    health = told(flight(commands=commands, curve=curve, seconds=80.0), airframe)
    assert health.curve.c.value == pytest.approx(curve, abs=0.05)
    assert health.thrust_to_weight.value == pytest.approx(2.5, rel=0.02)
    if commands == "alone":
        assert health.scale[0] == "T_max"
        assert health.scale[1].value == pytest.approx(2.0 * G / 4.0 / 0.4, rel=0.03)


def test_without_climbs_the_curve_is_assumed_and_says_so(airframe):
    health = told(flight(commands="alone", climb=False), airframe)
    assert health.curve.c.std == pytest.approx(0.35)
    assert any("thrust curve: near 0.5" in text for text in health.assumptions)


def test_a_curve_that_no_propeller_has_is_not_taken(airframe, monkeypatch):
    windows = hover_windows(airframe, flight(commands="alone"))
    for c, taken in ((2.1, False), (-0.9, False), (1.1, True)):
        monkeypatch.setattr(command_curve, "_by_lift", lambda _, c=c: (c, 0.1, "thrust"))
        curve = command_curve.curve_of(windows, None, 0.8, "MOT_THST_EXPO")
        assert curve.c.value == (1.0 if taken else 0.8)
        assert curve.origin == ("thrust" if taken else "MOT_THST_EXPO of the vehicle, assumed to "
                                "be near")  # fmt: skip


def hover_windows(airframe, blocks):
    return windows_of(streams_of(blocks, airframe, "px4", {}), 4)


def test_the_drag_of_climbs_is_no_part_of_the_thrust_coefficient(airframe):
    steady = hover_windows(airframe, flight(seconds=80.0, climb=False))
    sink = 0.8 * np.sin(0.5 * steady.t)
    sink -= sink.mean()
    noise = np.random.default_rng(4).normal(0.0, 0.01, len(sink))
    # m (g - sink') = T + D sink, D / m of 0.2 1/s.
    lift = G - 0.4 * np.cos(0.5 * steady.t)
    speeds = steady.speeds * ((lift - 0.2 * sink + noise) / G)[:, None]
    flown = replace(steady, sink=sink, lift=lift, speeds=speeds)
    value, std = balance.specific_thrust(flown, flown.speeds)
    assert value == pytest.approx(G / 4e5, rel=5e-4)
    unseen = replace(flown, sink=np.full_like(sink, np.nan))
    _, wide = balance.specific_thrust(unseen, unseen.speeds)
    assert std < 0.0011 * value
    assert wide > 2.0 * std
    # A flight that climbs all the while shows what that may have cost.
    climbing = replace(flown, sink=sink - 1.0, speeds=speeds + steady.speeds * 0.2 / G)
    same, wider = balance.specific_thrust(climbing, climbing.speeds)
    assert same == pytest.approx(value / (1.0 + 0.2 / G), rel=2e-3)
    assert wider > 0.4 * 0.2 / G * value


def test_slow_scatter_widens_what_white_scatter_does_not():
    """Flicker noise keeps the means of blocks apart, however long; white noise does not."""
    random = np.random.default_rng(5)
    white = random.normal(size=(256, 40))
    spectrum = np.fft.rfft(random.normal(size=(4096, 40)), axis=0)
    spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)) / 4096)[:, None]
    flicker = np.fft.irfft(spectrum, axis=0)[:256]
    n, half = len(white), 0.5
    plain = np.sqrt(balance.long_memory(white, half))
    assert np.median(plain) == pytest.approx(1.0 / np.sqrt(n), rel=0.5)
    slow = np.sqrt(np.median(balance.long_memory(flicker, half)))
    assert slow > 3.0 * float(np.median(flicker.std(axis=0))) / np.sqrt(n)


def test_wind_is_told_from_the_drag_and_widens_the_interval(airframe):
    calm = told(flight(), airframe)
    assert calm.by_wind == pytest.approx((0.0, 0.0), abs=1e-6)
    # Without any change of the drag the lever is not known, and nothing is claimed.
    steady = told(flight(drag=0.4), airframe)
    assert steady.by_wind == pytest.approx((0.0, 0.0), abs=1e-4)


@pytest.mark.parametrize(("change", "problem"), [(0.2, True), (0.02, False)])
def test_an_esc_that_always_reports_one_speed_is_no_measurement(airframe, change, problem):
    (block,) = flight()
    tracks = []
    for track in block.tracks:
        if track.stream is Stream.ROTOR_SPEED:
            values = track.values.mean(axis=0) * (1.0 + 0.5 * change * np.sin(track.t))[:, None]
            values[5:, 2] = values[5, 2]
            values[:5] = 0.0  # before take-off
            track = replace(track, values=values)
        tracks.append(track)
    streams = streams_of([replace(block, tracks=tuple(tracks))], airframe, "px4", {})
    assert (streams.speeds is None) is problem
    assert streams.refused == ({"ESC_STATUS": "rotor 3 always reads the same"} if problem else {})
    assert streams.misread == streams.refused


def test_an_order_that_speeds_are_not_in_is_no_wrong_reading(airframe):
    (block,) = flight(commands=True, loads=(1.0, 1.1, 0.95, 1.05))
    own = {"ACTUATOR_OUTPUT_STATUS": "actuator_motors"}  # by motor
    tracks = tuple(replace(t, source=own.get(t.source, t.source)) for t in block.tracks)
    known = {f"PWM_AUX_FUNC{output}": 101.0 + i for i, output in enumerate((5, 2, 6, 3))}
    streams = streams_of([replace(block, tracks=tracks)], airframe, "px4", known)
    assert streams.speeds.source == "ESC_STATUS by motor"
    assert (streams.misread, [*streams.refused]) == ({}, ["ESC_STATUS by output"])


def test_time_goes_on_over_a_reboot(airframe):
    blocks = flight(reboot=True, seconds=60.0)
    windows = windows_of(streams_of(blocks, airframe, "px4", {}), 4)
    assert (np.diff(windows.t) > 0.0).all()
    assert windows.t[-1] == pytest.approx(59.0, abs=1.0)
    assert told(blocks, airframe).seconds > 40.0


def test_a_gap_makes_no_window(airframe):
    (block,) = flight()
    tracks = tuple(
        track.part(~((track.t > 110.0) & (track.t < 114.0)))
        if track.stream is Stream.IMU
        else track
        for track in block.tracks
    )
    windows = windows_of(streams_of([replace(block, tracks=tracks)], airframe, "px4", {}), 4)
    inside = (windows.t > 9.6) & (windows.t < 14.4)
    outside = ((windows.t < 9.4) | (windows.t > 14.7)) & (windows.t < 37.0)
    assert np.isnan(windows.rates[inside]).all()
    assert np.isfinite(windows.rates[outside]).all()


def test_one_damaged_stamp_does_not_fill_the_memory(airframe):
    (block,) = flight()
    tracks = tuple(
        replace(track, t=np.append(track.t[:-1], 1e12)) if track.stream is Stream.IMU else track
        for track in block.tracks
    )
    assert told([replace(block, tracks=tracks)], airframe).available


def test_reasons_where_there_is_nothing(airframe):
    (block,) = flight()
    no_rotors = tuple(t for t in block.tracks if t.stream is not Stream.ROTOR_SPEED)
    health = told([replace(block, tracks=no_rotors)], airframe)
    assert health.reasons == ("no rotor speeds and no actuator outputs",)
    hexa = load_airframe("px4-hexa-x").with_anchor("mass", 2.0)
    assert told([block], hexa).reasons == ("ESC_STATUS lacks rotor 5 of 6",)
    health = told(flight(seconds=3.0), airframe)
    assert not health.available
    assert "hover" in health.reasons[0]


def test_robust_fit_shrugs_at_outliers_and_collinear_columns():
    rng = np.random.default_rng(8)
    x = rng.standard_normal(100)
    y = 2.0 * x + 0.01 * rng.standard_normal(100)
    y[::20] += 50.0
    assert balance.robust_fit(x[:, None], y).value[0] == pytest.approx(2.0, abs=0.02)
    both = balance.robust_fit(np.column_stack([x, x]), 2.0 * x)
    assert both.value.sum() == pytest.approx(2.0)
    with pytest.raises(ValueError, match="do not show"):
        balance.robust_fit(np.ones((2, 3)), np.ones(2))


def test_the_curve_is_that_of_what_slow_rotors_do_not_of_what_is_commanded_meanwhile():
    """Commands that change within a rotor's time constant, sampled and averaged by any window."""
    random, lag, c = np.random.default_rng(5), 0.2, 0.7
    t = np.arange(0.0, 120.0, 0.01)
    kept = math.exp(-0.01 / lag)
    slow = 0.08 * np.sin(0.4 * t)[:, None] + 0.6
    fast = lfilter([1.0], [1.0, -0.97], 0.02 * random.standard_normal((len(t), 4)))[0]
    u = (slow + fast).clip(0.1, 1.0)
    followed = u[0] + lfilter([1.0 - kept], [1.0, -kept], u - u[0])[0]
    speeds = np.sqrt(1e5 * ((1.0 - c) * followed + c * followed**2))
    tracks = {Stream.IMU: (t[::4], np.tile([0.0, 0.0, 0.0, 0.0, 0.0, -G], (len(t[::4]), 1)))}
    commands, measured = (
        RotorStream(name, tuple((t[::10], column) for column in values[::10].T), 10.0)
        for name, values in (("u", u), ("rpm", speeds))
    )
    flight = FlightTimes(0.0, t, np.ones(len(t), bool))
    windows = windows_of(Streams(flight, tracks, measured, commands, {}), 4)
    found = command_curve.curve_of(windows, None, None, "").c
    assert windows.lag == pytest.approx(lag, abs=0.03)
    assert abs(found.value - c) < 1.96 * found.std
    assert found.std < 0.04
