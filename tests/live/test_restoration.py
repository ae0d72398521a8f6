"""However a session ends, the vehicle sends what it sent before, as often as before."""

import json
import os
import signal
import subprocess
import sys
import threading
from collections import Counter

import numpy as np
import pytest

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import FrameScanner
from gcs_sysid.telemetry.outgoing import Gate
from gcs_sysid.telemetry.requests import StreamRequests
from gcs_sysid.telemetry.vehicles import MavlinkSystem
from gcs_sysid.telemetry.wanted_streams import SCHEMA, StreamRestoration
from sim_bridge.ardupilot import LOOP_STEPS, STEP_US, ArduPilot
from sim_bridge.missions import MISSIONS
from sim_bridge.px4 import Px4
from sim_bridge.simulation import Simulation
from sim_bridge.vehicle_files import load_vehicle
from testbed.payloads import unpack
from tests.test_what_is_sent import PATIENCE, needs_posix, on_udp

IMU, ATTITUDE, POSITION, LANDED, ESC, OUTPUTS, RAW_IMU, ESC_TELEMETRY = (
    getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
    for name in (
        "HIGHRES_IMU", "ATTITUDE", "LOCAL_POSITION_NED", "EXTENDED_SYS_STATE", "ESC_STATUS",
        "ACTUATOR_OUTPUT_STATUS", "RAW_IMU", "ESC_TELEMETRY_1_TO_4",
    )
)  # fmt: skip
OTHERS = {
    "px4": {IMU: 0.0, ATTITUDE: 49.0, POSITION: 49.0, LANDED: 1.0, ESC: 3.0, OUTPUTS: 0.0},
    "ardupilot": {RAW_IMU: 20.0, ATTITUDE: 10.0, POSITION: 25.0, ESC_TELEMETRY: 5.0},
}
"""Hz that a companion has asked for on the same link: not the autopilot's defaults."""


def autopilot_of(kind):
    seed = np.random.SeedSequence(1)
    vehicle, mission = load_vehicle("paper"), MISSIONS["hover"]
    if kind == "px4":
        pilot = Px4(Simulation(vehicle, mission, seed), "none", 0.0, 250.0, seed)
    else:
        loop = {"step_us": STEP_US, "control_steps": LOOP_STEPS}
        pilot = ArduPilot(Simulation(vehicle, mission, seed, **loop), "none", 0.0, seed)
    for number, hertz in OTHERS[kind].items():
        pilot.set_rate(number, hertz)
    return pilot


class Emulated:
    """An emulated autopilot that holds still between the messages that it sends.

    Attributes:
        asked: how often each command came.
        changed, restored: set when the IMU comes quickly; when all is as it was.
    """

    def __init__(self, kind):
        self.asked = Counter()
        self.changed, self.restored = threading.Event(), threading.Event()
        self.pilot = autopilot_of(kind)
        self._tick = 0
        self._scanner = FrameScanner()
        self.own = self.intervals()

    def intervals(self):
        return {n: round(s.interval) for n, s in self.pilot.schedule.streams.items()}

    def speak(self, seconds):
        said = []
        for _ in range(round(seconds / self.pilot.instruments.simulation.step_size)):
            self._tick += 1
            self.pilot.instruments.simulation.tick = self._tick
            said += self.pilot.poll(self._tick)
        return said

    def notice(self, data):
        for frame in self._scanner.feed(data):
            if frame.message_id == mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
                self.asked[unpack(76, frame.payload)["command"]] += 1
        answers = self.pilot.receive(data, self._tick)
        now = self.intervals()
        if 0 < now[IMU] <= 5000:
            self.changed.set()
        if now == self.own:
            self.restored.set()
        return answers


def session(url, folder, *options):
    command = [sys.executable, "-m", "gcs_sysid", "live", url, "--airframe", "paper"]
    words = [*command, "--headless", "--no-record", *options]
    quiet = subprocess.DEVNULL
    return subprocess.Popen(words, cwd=folder, stdin=quiet, stdout=quiet, stderr=quiet)


def wait_for(event, program):
    """Wait for an event; the program must not end before."""
    for _ in range(round(PATIENCE / 0.05)):
        if event.wait(0.05):
            return
        assert program.poll() is None
    raise AssertionError("nothing was asked for")


def ended(vehicle):
    """Whether all has come back, soon."""
    vehicle.restored.clear()
    return vehicle.restored.wait(PATIENCE) and vehicle.intervals() == vehicle.own


@needs_posix
@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "kind"),
    [
        ("SIGTERM", "ardupilot"),
        ("SIGKILL", "px4"),
        *(
            pytest.param(how, kind, marks=pytest.mark.thorough)
            for how, kind in (("SIGINT", "px4"), ("SIGINT", "ardupilot"), ("SIGTERM", "px4"))
        ),
    ],
)
def test_a_signal_ends_the_session_and_the_rates_are_what_they_were(how, kind, tmp_path):
    vehicle = Emulated(kind)
    with on_udp(vehicle, lambda _: False, lambda: None) as url:
        program = session(url, tmp_path)
        try:
            wait_for(vehicle.changed, program)
            program.send_signal(getattr(signal, how))
            assert ended(vehicle)
        finally:
            program.kill()
            program.wait()
    assert vehicle.asked[510] > 0


@needs_posix
@pytest.mark.slow
@pytest.mark.skipif(not os.path.isdir("/proc/self/task"), reason="finds the receiver in /proc")
def test_the_next_session_puts_back_what_one_left_that_was_killed_with_its_receiver(
    tmp_path, state_home
):
    vehicle = Emulated("px4")
    with on_udp(vehicle, lambda _: False, lambda: None) as url:
        program = session(url, tmp_path)
        try:
            wait_for(vehicle.changed, program)
            with open(f"/proc/{program.pid}/task/{program.pid}/children") as children:
                receivers = [int(pid) for pid in children.read().split()]
            assert receivers
            # The session first: it would tell nobody, but might restore.
            program.send_signal(signal.SIGSTOP)
            for pid in [*receivers, program.pid]:
                os.kill(pid, signal.SIGKILL)
            program.wait()
            (kept,) = state_home.glob("gcs-sysid/*.json")
            assert vehicle.intervals() != vehicle.own
            vehicle.restored.clear()
            program = session(url, tmp_path, "--rate", "200", "--duration", "4")
            assert program.wait(PATIENCE) == 1  # too short to tell anything
            assert ended(vehicle)
        finally:
            program.kill()
            program.wait()
    assert not kept.exists()


# --- a station and a vehicle in memory


class Ground:
    """A station driven by hand; what it sets and asks for."""

    def __init__(self, folder=None, vehicle=None, **options):
        self.raws = []
        self.vehicle = vehicle or MavlinkSystem(1, 1, 2, 12)
        gate = Gate(self.raws.append)
        self.restoration = StreamRestoration(gate, 4, folder, "udpin:0.0.0.0:14550")
        self.requests = StreamRequests(gate, 250.0, self.restoration, **options)
        self.now = 0.0
        self.intervals = {}
        self._told = 0

    def tell(self, **intervals):
        for name, interval in intervals.items():
            self._told += 1
            number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
            self.intervals[number] = interval, self._told

    def turn(self, seconds=0.2, **arriving):
        for _ in range(max(1, round(seconds / 0.2))):
            self.requests.tick(self.now, self.vehicle, arriving, (), (0, 0), self.intervals)
            self.now += 0.2

    def take(self):
        """(command, message, its parameter) of what was sent since."""
        said = []
        for frame in FrameScanner().feed(b"".join(self.raws)):
            if frame.message_id == mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
                f = unpack(76, frame.payload)
                said.append((int(f["command"]), int(f["param1"]), f["param2"]))
        self.raws.clear()
        return said

    def put_back(self):
        """Message -> its interval as the station leaves it."""
        self.take()
        self.requests.close()
        return {n: interval for _, n, interval in self.take()}


WANTED = (IMU, ESC, OUTPUTS, ATTITUDE, POSITION, LANDED)
ALL = {
    "HIGHRES_IMU": 0, "ESC_STATUS": 1_000_000, "ACTUATOR_OUTPUT_STATUS": 0, "ATTITUDE": 20408,
    "LOCAL_POSITION_NED": 20408, "EXTENDED_SYS_STATE": 200_000,
}  # fmt: skip
OWN = {IMU: -1.0, ESC: 1e6, OUTPUTS: -1.0, ATTITUDE: 20408.0, POSITION: 20408.0, LANDED: 2e5}


def test_nothing_is_changed_before_the_vehicle_has_told_its_intervals():
    ground = Ground()
    ground.turn()
    assert ground.take() == [(510, n, 0.0) for n in WANTED]
    ground.tell(**{name: interval for name, interval in ALL.items() if name != "ATTITUDE"})
    ground.turn(0.6)
    # By the other kind of request, and only for what was not answered.
    assert ground.take() == [(512, 244, float(ATTITUDE))]
    ground.tell(ATTITUDE=20408)
    ground.turn()
    assert {(c, n) for c, n, _ in ground.take()} == {(511, n) for n in WANTED}
    ground.requests.close()
    assert ground.take() == [(511, n, OWN[n]) for n in WANTED] * 2


def test_what_is_not_told_is_taken_from_what_arrives():
    ground = Ground()
    ground.turn(StreamRestoration.OBSERVED_FOR, ATTITUDE=49.0, HIGHRES_IMU=100.0)
    assert {c for c, *_ in ground.take()} == {510, 512}
    ground.turn(0.4, ATTITUDE=49.0, HIGHRES_IMU=100.0)
    assert {c for c, *_ in ground.take()} == {511}
    own = ground.put_back()
    assert own == dict.fromkeys(WANTED, 0.0) | {ATTITUDE: 20408.0, IMU: 10000.0}


@pytest.mark.parametrize(
    ("autopilot", "told", "own"),
    [
        (12, 0, -1.0),  # PX4: not sent
        (12, -1, 5000.0),  # PX4: as fast as it comes
        (3, -1, -1.0),  # ArduPilot: not sent
        (3, 0, 0.0),  # ArduPilot: not available
        (3, 20_000, 20_000.0),
    ],
)
def test_what_the_autopilots_mean(autopilot, told, own):
    ground = Ground(vehicle=MavlinkSystem(1, 1, 2, autopilot))
    arriving = {"HIGHRES_IMU": 200.0} if own == 5000.0 else {}
    ground.turn(**arriving)
    ground.tell(HIGHRES_IMU=told)
    ground.turn(StreamRestoration.OBSERVED_FOR + 0.4, **arriving)
    assert ground.put_back()[IMU] == own


def killed(folder):
    """A session that asked for its rates, and was never closed."""
    ground = Ground(folder)
    ground.turn()
    ground.tell(**ALL)
    ground.turn()
    return ground


def asked_by(ground):
    """Message name -> us, of what this session asks for."""
    names = {getattr(mavlink, f"MAVLINK_MSG_ID_{name}"): name for name in ALL}
    return {names[n]: round(interval) for c, n, interval in ground.take() if c == 511}


def test_the_next_session_restores_what_a_killed_one_found(tmp_path):
    asked = asked_by(killed(tmp_path))
    ground = Ground(tmp_path)
    ground.turn()
    ground.tell(**asked)
    ground.turn()
    ground.take()
    ground.requests.close()
    assert ground.take() == [(511, n, OWN[n]) for n in WANTED] * 2
    assert not list(tmp_path.iterdir())


def test_a_vehicle_that_was_restarted_keeps_its_own_rates(tmp_path):
    killed(tmp_path)
    ground = Ground(tmp_path)
    ground.turn()
    ground.tell(**dict.fromkeys(ALL, 66667))
    ground.turn()
    assert {*ground.put_back().values()} == {66_667.0}


def test_a_stream_that_this_session_does_not_want_is_restored_at_once(tmp_path):
    file = tmp_path / "streams_udpin_0.0.0.0_14550_1_1.json"
    streams = {"RAW_IMU": [50_000, 4000], "SERVO_OUTPUT_RAW": [20_000, 4000]}
    file.write_text(json.dumps({"schema": SCHEMA, "streams": streams}))
    ground = Ground(tmp_path)
    ground.turn()
    ground.tell(**ALL, RAW_IMU=4000, SERVO_OUTPUT_RAW=100_000)
    ground.turn()
    said = ground.take()
    assert (511, RAW_IMU, 50_000.0) in said
    assert not [s for s in said if s[:2] == (511, mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW)]


@pytest.mark.parametrize(
    "content",
    [
        "", "[]", "{", '{"schema": "gcs-sysid-streams/1"}', pytest.param("[" * 100_000, id="deep"),
        '{"schema": "gcs-sysid-streams/1", "streams": {"ATTITUDE": [1]}}',
        '{"schema": "gcs-sysid-streams/1", "streams": {"ATTITUDE": ["x", 4000]}}',
    ],
)  # fmt: skip
def test_a_file_that_is_damaged_is_told_and_passed_over(content, tmp_path):
    (tmp_path / "streams_udpin_0.0.0.0_14550_1_1.json").write_text(content)
    ground = Ground(tmp_path)
    ground.turn()
    assert any("is damaged" in line for line in ground.restoration.events)
    ground.tell(**ALL)
    ground.turn()
    ground.take()
    ground.requests.close()
    assert ground.take() == [(511, n, OWN[n]) for n in WANTED] * 2


def test_a_folder_that_cannot_be_written_costs_the_session_nothing(tmp_path):
    (tmp_path / "state").write_text("a file, not a folder")
    ground = killed(tmp_path / "state")
    (line,) = ground.restoration.events
    assert "cannot restore the rates" in line
    assert ground.put_back() == OWN


def test_after_an_outage_the_rates_this_session_asked_for_are_not_taken_for_its_own():
    ground = killed(None)
    asked = asked_by(ground)
    ground.requests.reboot()
    ground.turn()
    ground.tell(**asked)
    ground.turn()
    assert ground.put_back() == OWN


RATES = {
    "HIGHRES_IMU": 250.0, "ESC_STATUS": 250.0, "ACTUATOR_OUTPUT_STATUS": 250.0, "ATTITUDE": 100.0,
    "LOCAL_POSITION_NED": 50.0, "EXTENDED_SYS_STATE": 2.0,
}  # fmt: skip


@pytest.mark.parametrize("rate", [200.0, 10.0])
def test_what_another_station_sets_meanwhile_is_not_undone(rate):
    ground = killed(None)
    ground.tell(**asked_by(ground))
    ground.turn(6.0, **RATES)
    theirs = round(1e6 / rate)
    said, others = [], RATES | {"ATTITUDE": rate}
    for _ in range(40):
        ground.turn(**others)
        new = ground.take()
        said += new
        if (510, ATTITUDE, 0.0) in new:
            ours = [i for c, n, i in said if (c, n) == (511, ATTITUDE)]
            ground.tell(ATTITUDE=round(ours[-1]) if ours else theirs)
    sets = [interval for c, n, interval in said if (c, n) == (511, ATTITUDE)]
    # Too slow for identification, it is asked for again; else it is left as it is.
    assert set(sets) == ({float(theirs)} if rate > 100.0 else {float(theirs), 10_000.0})
    told = "\n".join(ground.restoration.events)
    assert told.count(f"ATTITUDE was set to {rate:.1f} Hz by another ground station") == 1
    own = ground.put_back()
    assert own.get(ATTITUDE, theirs) == theirs
    assert {**own, ATTITUDE: 0} == {**OWN, ATTITUDE: 0}


def test_an_interval_that_the_autopilot_limits_is_not_taken_for_anothers():
    ground = killed(None)
    limited = asked_by(ground) | {"HIGHRES_IMU": 5000, "ESC_STATUS": 5000}
    ground.tell(**limited)
    for _ in range(6):
        ground.turn(6.0, **RATES)
        ground.tell(**limited)
    ground.take()
    assert not ground.restoration.events
    assert ground.put_back() == OWN
