"""From the ground and back: what is said and measured before, between and after flights."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.cli import main
from sim_bridge.ground_cycle import CLIMB, GroundCycle
from sim_bridge.missions import MISSIONS, HoverMission

Read = Callable[[Path], Iterator[tuple[int, Any]]]

GROUND = 4.0
HOVER = 3.0


def test_set_points_are_continuous_and_the_rates_their_derivatives() -> None:
    ground_cycle = GroundCycle(HoverMission(duration=HOVER), GROUND, flights=2)
    step = 1e-3
    for t in np.arange(GROUND + step, GROUND + 2 * CLIMB + HOVER - step, 0.05):
        before, here, after = (ground_cycle.reference(t + k * step) for k in (-1, 0, 1))
        rate = (after.position[2] - before.position[2]) / (2.0 * step)
        assert here.velocity[2] == pytest.approx(rate, abs=1e-4)
        change = (after.velocity[2] - before.velocity[2]) / (2.0 * step)
        assert here.acceleration[2] == pytest.approx(change, abs=5e-3)
    assert ground_cycle.reference(GROUND).position == (0.0, 0.0, 0.0)
    assert ground_cycle.reference(GROUND + CLIMB).position[2] == -10.0
    assert ground_cycle.duration == 2 * (GROUND + 2 * CLIMB + HOVER) + GROUND


def test_the_next_flight_begins_where_the_last_one_ended() -> None:
    ground_cycle = GroundCycle(MISSIONS["paper"], GROUND, flights=2)
    cycle = (ground_cycle.duration - GROUND) / 2
    end = ground_cycle.reference(cycle - 1e-6).position
    assert end[0] > 5.0
    assert ground_cycle.reference(cycle + GROUND + 1.0).position[:2] == pytest.approx(end[:2])


@pytest.fixture(scope="module")
def records(
    tmp_path_factory: pytest.TempPathFactory, read_tlog: Read
) -> dict[str, list[tuple[float, Any]]]:
    """A PX4 from the ground through ten seconds of the mission that excites all axes."""
    path = tmp_path_factory.mktemp("outing") / "f.tlog"
    options = ["--airframe", "px4-quad-x", "--mission", "all-axes", "--rate", "50"]
    options += ["--trap", f"ground={GROUND}", "--duration", "20", "--tlog", str(path)]
    assert main(options) == 0
    found: dict[str, list[tuple[float, Any]]] = {}
    start = None
    for stamp, message in read_tlog(path):
        start = stamp if start is None else start
        found.setdefault(message.get_type(), []).append(((stamp - start) * 1e-6, message))
    return found


@pytest.mark.slow
def test_on_the_ground_it_says_so(records: dict[str, list[tuple[float, Any]]]) -> None:
    for t, state in records["EXTENDED_SYS_STATE"]:
        on_ground = t < GROUND
        assert state.landed_state == (
            mavlink.MAV_LANDED_STATE_ON_GROUND if on_ground else mavlink.MAV_LANDED_STATE_IN_AIR
        )
    armed = [
        (t, bool(m.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)) for t, m in records["HEARTBEAT"]
    ]
    assert all(flag == (t >= GROUND - 1.5) for t, flag in armed)


def test_outputs_are_900_while_disarmed(records: dict[str, list[tuple[float, Any]]]) -> None:
    for t, outputs in records["ACTUATOR_OUTPUT_STATUS"]:
        if t < GROUND - 1.51:
            assert set(outputs.actuator[:4]) == {900.0}
        elif t > GROUND:
            assert min(outputs.actuator[:4]) > 1000.0
    for t, status in records["ESC_STATUS"]:
        assert t > GROUND - 1.51 or max(status.rpm) < 30


def test_at_rest_the_sensors_are_quieter(records: dict[str, list[tuple[float, Any]]]) -> None:
    imu = [(t, m.xgyro, m.zacc) for t, m in records["HIGHRES_IMU"]]
    rest = np.array([row[1:] for row in imu if row[0] < GROUND - 1.6])
    assert rest[:, 0].std() < 5e-4
    assert rest[:, 1].mean() == pytest.approx(-9.80665, abs=0.02)


def test_it_climbs_and_flies_the_mission(records: dict[str, list[tuple[float, Any]]]) -> None:
    down = {round(t, 2): m.z for t, m in records["LOCAL_POSITION_NED"]}
    assert down[2.0] == 0.0
    assert down[GROUND + CLIMB + 1.0] == pytest.approx(-10.0, abs=0.3)
    assert max(m.z for _, m in records["LOCAL_POSITION_NED"]) < 0.05
    gyro = np.array([m.xgyro for t, m in records["HIGHRES_IMU"] if t > 14.0])
    assert gyro.std() > 0.5


@pytest.mark.thorough
def test_two_flights_land_between(tmp_path: Path, read_tlog: Read) -> None:
    path = tmp_path / "f.tlog"
    options = ["--airframe", "px4-quad-x", "--rate", "20", "--mission", "hover"]
    options += ["--trap", "ground=3", "--trap", "flights=2", "--tlog", str(path)]
    assert main(options) == 0
    states, heights = [], []
    for _, message in read_tlog(path):
        if message.get_type() == "EXTENDED_SYS_STATE":
            states.append(message.landed_state)
        elif message.get_type() == "LOCAL_POSITION_NED":
            heights.append(-message.z)
    runs = [s for i, s in enumerate(states) if i == 0 or s != states[i - 1]]
    ground, air = mavlink.MAV_LANDED_STATE_ON_GROUND, mavlink.MAV_LANDED_STATE_IN_AIR
    assert runs == [ground, air, ground, air, ground]
    # No lower than the ground, and no jump when the vehicle touches it.
    assert min(heights) > -0.1
    assert np.abs(np.diff(heights)).max() < 0.3
