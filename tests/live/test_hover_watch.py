"""Health while it flies: every ten seconds of the vehicle's clock, by the last minutes."""

import numpy as np
import pytest

from gcs_sysid.live.live_estimate import HoverWatch
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.signals.columns import IntakeEvent, RecordBlock, Track
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.vehicles import MavlinkSystem

RATE = 25.0


class Told:
    """What a link tells beside its records."""

    def __init__(self):
        self.vehicle = MavlinkSystem(1, 1, mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4)
        self.systems = (self.vehicle,)
        self.parameters, self.problems = {}, ()


@pytest.fixture(scope="module")
def airframe():
    return load_airframe("px4-quad-x").with_arm(0.3).with_anchor("mass", 2.0)


def hover(start, stop, loads=(1.0, 1.0, 1.0, 1.0), events=()):
    """Seconds of a quad that hovers, its speeds squared as `loads`."""
    random = np.random.default_rng(round(start))
    t = np.arange(start, stop, 1.0 / RATE)
    n = len(t)
    imu = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, -9.80665], (n, 1))
    imu += 0.01 * random.standard_normal(imu.shape)
    speeds = np.sqrt(1e5 * np.array(loads) * (1.0 + 0.003 * random.standard_normal((n, 4))))
    quaternion = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    order = 4 * np.arange(n)
    tracks = (
        Track(Stream.IMU, t, imu, order=order),
        Track(Stream.ATTITUDE, t, quaternion, order=order + 1),
        Track(Stream.ROTOR_SPEED, t, speeds, 0, "ESC_STATUS", order + 2),
        Track(Stream.IN_AIR, t, np.ones((n, 1)), order=order + 3),
    )
    return RecordBlock(tracks, events=tuple(events))


@pytest.mark.slow
def test_it_looks_every_ten_seconds_and_forgets_after_ninety(airframe):
    watch = HoverWatch(Told(), "udp")
    looked, told = [], []
    for second in range(0, 100, 2):
        watch.add_records(hover(10.0 + second, 12.0 + second))
        # Nobody looks while the session is busy.
        news = watch.look(airframe) if second < 20 or second > 90 else None
        if news is not None:
            looked.append(second)
            told.append(news[0])
    assert looked[:2] == [0, 10]
    assert told[0]["verdict"] == "refused"
    told = told[-1]
    assert told["verdict"] == "available"
    assert 75.0 < told["seconds_of_hover"] <= 90.0
    assert told["source"] == "udp"
    assert told["cg"]["x"]["value"] == pytest.approx(0.0, abs=1e-3)
    assert told["k_T"]["value"] == pytest.approx(2.0 * 9.80665 / 4e5, rel=1e-3)


@pytest.mark.slow
def test_a_rotor_that_becomes_weak_is_named_once(airframe):
    watch = HoverWatch(Told(), "udp")
    x, y, spin = airframe.geometry
    strength = np.array([1.0, 1.0, 0.95, 1.0])
    effect = np.vstack([np.ones(4), x, y, spin]) * strength
    weak = np.linalg.solve(effect, [4.0, 0.0, 0.0, 0.0])
    texts = []
    for second in range(0, 75, 5):
        loads = np.ones(4) if second < 40 else weak
        watch.add_records(hover(10.0 + second, 15.0 + second, loads))
        news = watch.look(airframe)
        if news is not None and news[1]:
            texts.append((second, news[1]))
    assert len(texts) == 1
    second, text = texts[0]
    assert text.startswith("rotor 3 gives")
    assert 50 <= second <= 60


def test_a_reboot_begins_another_flight(airframe):
    watch = HoverWatch(Told(), "udp")
    watch.add_records(hover(500.0, 540.0))
    assert watch.look(airframe)[0]["verdict"] == "available"
    event = IntakeEvent(2.0, "reboot", "the vehicle's clock went back: reboot")
    watch.add_records(hover(2.0, 3.0, events=[(0, event)]))
    assert watch.look(airframe)[0]["verdict"] == "refused"


@pytest.mark.parametrize("place", [0, 40, 100])
def test_an_event_comes_before_what_follows_it_alone(place):
    event = IntakeEvent(501.0, "reset", "estimate reset by the user")
    seen, before = 0, None
    for part in hover(500.0, 501.0, events=[(place, event)]).windows():
        before = seen if part.events else before
        seen += len(part)
    assert (before, seen) == (place, 100)
