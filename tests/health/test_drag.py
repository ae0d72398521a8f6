"""Drag over mass by legs of a flight: separated from the wind, or not known."""

import numpy as np
import pytest

from gcs_sysid.health.assessment import ReadLog
from gcs_sysid.health.autopilot_parameters import determined
from gcs_sysid.health.drag import drag_of
from gcs_sysid.health.hover import windows_of
from gcs_sysid.health.log_streams import FlightTimes, RotorStream, Streams
from gcs_sysid.health.vehicle_health import HealthOptions
from gcs_sysid.signals.records import Stream
from gcs_sysid.signals.recursions import lfilter

G = 9.80665


def flown(seed, *, linear=0.2, square=0.015, wind=(3.0, -4.0), speeds=(3.0, 10.0), gusts=0.5):
    """Streams of legs to four sides at each of some speeds, in a steady wind and in gusts."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, 160.0, 0.04)
    leg = (t // 20.0).astype(int)
    heading = 0.5 * np.pi * (leg % 4)
    size = np.where(leg < 4, speeds[0], speeds[-1])
    wanted = size[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    velocity = lfilter([0.02], [1.0, -0.98], wanted)[0]
    colored = lfilter([np.sqrt(1.0 - 0.98**2)], [1.0, -0.98], random.standard_normal((len(t), 2)))
    air = velocity - np.array(wind) - gusts * colored[0]
    yaw = 0.3 + 0.01 * t
    x, y = np.cos(yaw), np.sin(yaw)
    body = np.column_stack([x * air[:, 0] + y * air[:, 1], x * air[:, 1] - y * air[:, 0]])
    speed = np.linalg.norm(air, axis=1)[:, None]
    force = -(linear + square * speed) * body + np.array([0.05, -0.08])
    imu = np.column_stack([np.zeros((len(t), 3)), force, np.full(len(t), -G)])
    still = np.zeros(len(t))
    tracks = {
        Stream.IMU: (t, imu + 0.2 * random.standard_normal(imu.shape) * (np.arange(6) > 2)),
        Stream.ATTITUDE: (t, np.column_stack([np.cos(yaw / 2), still, still, np.sin(yaw / 2)])),
        Stream.VELOCITY: (t, np.column_stack([velocity, np.zeros((len(t), 4))])),
    }
    u = RotorStream("u", tuple((t, np.full(len(t), 0.5)) for _ in range(4)), 25.0)
    streams = Streams(FlightTimes(0.0, t, np.ones(len(t), bool)), tracks, None, u, {})
    return streams, windows_of(streams, 4)


def test_legs_of_two_speeds_separate_drags_and_wind():
    held = []
    for seed in range(8):
        drag = drag_of(*flown(seed))
        for found, truth in ((drag.linear, 0.2), (drag.square, 0.015)):
            held.append(abs(found.value - truth) <= found.half)
            assert found.half < 0.6 * truth
    assert np.mean(held) >= 0.9


def test_a_hover_in_gusts_has_no_drag():
    assert drag_of(*flown(1, speeds=(0.05, 0.05))) is None


def test_slow_legs_leave_drag_of_the_speed_squared_open():
    drag = drag_of(*flown(2, wind=(0.0, 0.0), speeds=(2.0, 2.0), gusts=0.1))
    assert abs(drag.linear.value - 0.2) < drag.linear.half
    assert drag.square.value < 3.0 * drag.square.std


def test_px4_s_own_simulator_drags_as_its_parameter_has_it(shared_log):
    health = ReadLog(shared_log("px4-sih-default.ulg")).health(HealthOptions(arm=0.24))
    found = {one.name: one for one in determined([health])}
    drag = found["EKF2_MCOEF"]
    low, high = drag.quantity.ci95
    # N s/m, of 1 kg.
    assert low < health.parameters["SIH_KDV"] < high
    assert drag.verdict == "cannot tell"
    assert found["EKF2_BCOEF_X"].verdict == "cannot tell"
    assert "10 m/s" in found["EKF2_BCOEF_X"].action


def test_what_would_turn_the_estimate_of_the_wind_on_is_left(shared_log):
    health = ReadLog(shared_log("ardupilot-sitl.bin")).health(HealthOptions(arm=0.25))
    found = {one.name: one for one in determined([health])}
    # Quadratic: 45 degrees at 25 m/s.
    assert health.drag.square.value == pytest.approx(G / 25.0**2, rel=0.05)
    assert health.drag.linear.value < 0.002
    assert found["EK3_DRAG_BCOEF_X"].verdict == "leave"
    assert "off" in found["EK3_DRAG_BCOEF_X"].reason
