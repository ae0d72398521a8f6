"""The autopilots' laws: frequency responses against the difference equations, and mixers."""

import math

import numpy as np
import pytest

from gcs_sysid.control.rate_loops import HoverPoint, ardupilot_mixer, px4_mixer, read_loop
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import load_airframe
from sim_bridge.rate_controllers import CONTROLLERS
from sim_bridge.simulation import trim
from sim_bridge.vehicle_files import load_vehicle

QUAD = load_airframe("px4-quad-x").with_arm(0.25).rotors
SETTINGS = {
    "px4": {"MC_ROLLRATE_P": 0.1, "MC_ROLLRATE_I": 0.4, "MC_ROLLRATE_D": 0.004,
            "MC_ROLLRATE_K": 1.2},
    "ardupilot": {"ATC_RAT_RLL_P": 0.1, "ATC_RAT_RLL_I": 0.3, "ATC_RAT_RLL_D": 0.004,
                  "ATC_RAT_RLL_FLTE": 30.0},
    "betaflight": {"p_roll": 60.0, "i_roll": 300.0, "d_roll": 40.0, "dshot_bidir": 1.0,
                   "looptime": 1250.0, "pid_process_denom": 2.0, "rpm_filter_min_hz": 30.0,
                   "gyro_lpf1_static_hz": 250.0, "dterm_lpf1_static_hz": 75.0,
                   "rpm_filter_harmonics": 3.0, "rpm_filter_q": 500.0,
                   "rpm_filter_fade_range_hz": 0.0},
    "inav": {"mc_p_roll": 60.0, "mc_i_roll": 200.0, "mc_d_roll": 40.0, "looptime": 2500.0,
             "gyro_lpf_hz": 90.0, "dterm_lpf_hz": 70.0, "rpm_gyro_filter_enabled": 1.0,
             "rpm_gyro_min_hz": 30.0, "rpm_gyro_harmonics": 2.0},
    "betaflight-adrc": {"adrc_wc_roll": 40.0, "adrc_b0_roll": 3000.0, "looptime": 2500.0,
                        "gyro_lpf1_static_hz": 250.0},
}  # fmt: skip


@pytest.mark.parametrize("autopilot", [*SETTINGS])
@pytest.mark.parametrize("tone", [6.3, 90.0])
def test_the_response_is_that_of_the_emulated_controller(autopilot, tone):
    """A sine as the roll rate, no attitude error: the torque that the emulator's code asks for."""
    vehicle = load_vehicle("px4-sih")
    period, step = 1.0 / 400.0, 1.0 / 2000.0
    omega = 2.0 * math.pi * round(tone * 2.0 / (2.0 * math.pi)) / 2.0
    controller = CONTROLLERS[autopilot](vehicle, period, SETTINGS[autopilot])
    state = trim(vehicle)
    asked, times = [], []
    for k in range(round(4.0 / step)):
        t = k * step
        state.body[10] = 0.05 * math.sin(omega * t)
        controller.observe(state, step)
        if k % 5 == 0:
            asked.append(controller._torques([0.0, 0.0, 0.0])[0])
            times.append(t)
    t, u = np.array(times)[-800:], np.array(asked)[-800:]
    wave = np.exp(-1j * omega * t)
    found = -(wave @ (u - u.mean())) / (wave @ (0.05 * np.sin(omega * t)))
    hertz = math.sqrt(vehicle.mass * 9.80665 / (len(vehicle.rotors) * vehicle.k_T)) / 2.0 / math.pi
    hover = HoverPoint(rotor_frequency=hertz)
    loop = read_loop(autopilot, SETTINGS[autopilot], vehicle.rotors, hover)
    expected = loop.controllers(np.array([omega]))[0][0, 0]
    assert abs(found / expected - 1.0) < 0.03
    assert abs(np.degrees(np.angle(found / expected))) < 2.0


def test_mixers_of_a_quad_are_those_of_the_autopilots():
    # PX4's quad X: 0.707 on roll and pitch, 1 on yaw; ArduPilot's: 0.5 on all.
    places = np.array([[r.x, r.y] for r in QUAD])
    spins = np.array([r.spin for r in QUAD])
    mixer = px4_mixer(places, 0.05 * spins)
    assert np.abs(mixer[:, :2]) == pytest.approx(np.full((4, 2), math.sqrt(0.5)))
    assert mixer[:, 2] == pytest.approx(spins)
    assert np.sign(mixer[:, 0]).tolist() == np.sign(-places[:, 1]).tolist()
    factors = ardupilot_mixer(QUAD)
    assert np.abs(factors) == pytest.approx(np.full((4, 3), 0.5))
    assert np.sign(factors).tolist() == np.sign(mixer).tolist()


def test_px4_mixes_by_the_rotors_it_was_given():
    given = {}
    for i, r in enumerate(QUAD):
        given |= {f"CA_ROTOR{i}_PX": 2.0 * r.x, f"CA_ROTOR{i}_PY": r.y}
        given[f"CA_ROTOR{i}_KM"] = 0.05 * r.spin
    loop = read_loop("px4", given, QUAD)
    usual = read_loop("px4", {}, QUAD)
    ratio = np.abs(loop.mixer / usual.mixer)[:, :2]
    # Arms twice as long fore and aft need half the thrust for as much pitch.
    assert ratio[:, 1] / ratio[:, 0] == pytest.approx(np.full(4, 0.5))


def test_k_scales_the_gains_and_defaults_are_named():
    loop = read_loop("px4", {"MC_ROLLRATE_K": 2.0, "MC_ROLLRATE_P": 0.1}, QUAD)
    assert pytest.approx(0.2) == loop.gains[0].P
    assert loop.gains[1].P == 0.15
    assert "MC_PITCHRATE_P" in loop.assumed
    assert "MC_ROLLRATE_P" not in loop.assumed
    assert read_loop("px4", loop.as_parameters(), QUAD).gains == loop.gains


@pytest.mark.parametrize(
    ("autopilot", "name", "value"),
    [("px4", "MC_ROLLRATE_P", -0.1), ("px4", "THR_MDL_FAC", 3.0),
     ("ardupilot", "SCHED_LOOP_RATE", 5.0)],
)  # fmt: skip
def test_parameters_that_make_no_sense(autopilot, name, value):
    with pytest.raises(InputError, match=name):
        read_loop(autopilot, {name: value}, QUAD)


def test_notches_are_where_the_autopilot_has_them():
    of_rotors = HoverPoint(rotor_frequency=100.0)
    px4 = {"IMU_GYRO_NF0_FRQ": 80.0, "IMU_GYRO_DNF_EN": 1.0, "IMU_GYRO_DNF_HMC": 2.0}
    ardupilot = {
        "INS_HNTCH_ENABLE": 1.0,
        "INS_HNTCH_MODE": 3.0,
        "INS_HNTCH_HMNCS": 5.0,
        "INS_HNTCH_OPTS": 2.0,
    }
    found = [
        read_loop("px4", px4, QUAD, of_rotors),
        read_loop("ardupilot", ardupilot, QUAD, of_rotors),
    ]
    middles = [[each.frequency for each in loop.gyro_filters] for loop in found]
    assert middles == [[80.0, *[100.0] * 4, *[200.0] * 4], [*[100.0] * 4, *[300.0] * 4]]
    late = [np.angle(loop.controllers(np.array([60.0]))[0][0, 0]) for loop in found]
    plain = [read_loop(loop.autopilot, {}, QUAD) for loop in found]
    early = [np.angle(loop.controllers(np.array([60.0]))[0][0, 0]) for loop in plain]
    assert (np.array(late) < np.array(early)).all()
    (note,) = read_loop("px4", px4, QUAD).notes
    assert "the rotors' frequency is not known" in note


def test_a_low_pass_follows_the_throttle():
    header = {"gyro_lpf1_dyn_hz[0]": 200.0, "gyro_lpf1_dyn_hz[1]": 400.0}
    at = [
        read_loop("betaflight", header, QUAD, HoverPoint(throttle=u)).gyro_filters[0].frequency
        for u in (0.0, 0.4, 1.0)
    ]
    # Of throttle u, u + 0.5 u (1 - u) of the way.
    assert at == pytest.approx([200.0, 304.0, 400.0])


def test_betaflight_gains_by_its_header_and_back():
    header = {"rollPID[0]": 50.0, "rollPID[1]": 65.0, "rollPID[2]": 45.0, "d_min[0]": 30.0}
    loop = read_loop("betaflight", header, QUAD)
    gains = loop.as_parameters()
    assert [gains[name] for name in ("p_roll", "i_roll", "d_roll")] == [50, 65, 30]
    held = read_loop("betaflight", {**header, "d_roll": 40.0, "d_min_roll": 0.0}, QUAD)
    assert held.as_parameters()["d_roll"] == 40
    # 50 * 0.032029 per deg/s, of a PID sum of 1000.
    assert pytest.approx(50.0 * 0.032029 * math.degrees(1.0) / 1000.0) == loop.gains[0].P
    assert loop.gains_known
    # What is judged is the lower D: a proposal switches off that it rises.
    assert gains["d_min_roll"] == 0.0
    assert not read_loop("betaflight", {}, QUAD).gains_known
    inav = read_loop("inav", {"yawPID[1]": 84.0}, QUAD)
    assert inav.as_parameters()["mc_i_yaw"] == 84
    assert pytest.approx(84.0 / 4.0 * math.degrees(1.0) / 1000.0) == inav.gains[2].I
