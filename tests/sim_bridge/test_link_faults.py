"""Each fault of the line does what its name says, and nothing else."""

from collections import Counter
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import Validity, read_frame
from gcs_sysid.telemetry.tlog import TlogReader
from sim_bridge.autopilot import BOOT_US, EPOCH_US
from sim_bridge.bad_line import BEHIND, QUEUE, BadLine
from sim_bridge.cli import main
from sim_bridge.line_faults import make_faults, parse_fault
from sim_bridge.wire import FrameWriter

STEP_US = 4000
COUNT = 3000
SECONDS = 1e-6 * STEP_US * COUNT


class Ether:
    """A link that keeps what it is given."""

    connected = True

    def __init__(self) -> None:
        self.arrived: list[tuple[int, bytes]] = []
        self.strangers: list[bytes] = []
        self.question = b""
        self.closed = False

    def send(self, frames: list[bytes], time_us: int) -> None:
        self.arrived += [(time_us, frame) for frame in frames]

    def intrude(self, datagrams: list[bytes], time_us: int) -> None:
        self.strangers += datagrams

    def receive(self) -> bytes:
        return self.question

    def close(self) -> None:
        self.closed = True


@cache
def frames_of(count: int) -> list[bytes]:
    """ATTITUDE and HEARTBEAT by turns, all different."""
    writer = FrameWriter()
    attitude, heartbeat = mavlink.MAVLink_attitude_message, mavlink.MAVLink_heartbeat_message
    return [
        writer.frame(heartbeat, n, 2, 12, 0, 4, 3)
        if n % 2
        else writer.frame(attitude, n, *[1.0] * 6)
        for n in range(count)
    ]


def sent_over(*faults: str, count: int = COUNT, seed: int = 1) -> tuple[Ether, list[bytes]]:
    """One frame each 4 ms over a line with these faults; what arrived, and what was sent."""
    ether = Ether()
    chosen = make_faults(map(parse_fault, faults))
    line = BadLine(ether, chosen, np.random.SeedSequence(seed))
    frames = frames_of(count)
    for n, frame in enumerate(frames):
        line.send([frame], BOOT_US + n * STEP_US)
    line.close()
    assert ether.closed
    return ether, frames


def late(ether: Ether, frames: list[bytes]) -> np.ndarray:
    """(m,) s, by how much each frame that arrived was late."""
    made = {frame: BOOT_US + n * STEP_US for n, frame in enumerate(frames)}
    return 1e-6 * np.array([t - made[frame] for t, frame in ether.arrived])


def numbers(ether: Ether, frames: list[bytes]) -> list[int]:
    """Which frames arrived, in the order of arrival."""
    place = {frame: n for n, frame in enumerate(frames)}
    return [place[frame] for _, frame in ether.arrived]


def runs_of_losses(arrived: list[int]) -> list[int]:
    missing = np.diff(arrived) - 1
    return [int(n) for n in missing if n]


def test_without_faults_all_arrives_at_once() -> None:
    ether, frames = sent_over()
    assert [frame for _, frame in ether.arrived] == frames
    assert not late(ether, frames).any()


def test_losses_are_independent() -> None:
    arrived = numbers(*sent_over("loss=0.2"))
    assert len(arrived) == pytest.approx(0.8 * COUNT, rel=0.03)
    # A run goes on with the probability of a loss.
    assert np.mean(runs_of_losses(arrived)) == pytest.approx(1.25, abs=0.08)


def test_bursts_lose_as_much_in_long_runs() -> None:
    arrived = numbers(*sent_over("bursts=0.2:20"))
    assert len(arrived) == pytest.approx(0.8 * COUNT, rel=0.08)
    assert np.mean(runs_of_losses(arrived)) == pytest.approx(20.0, rel=0.35)


def test_reordered_frames_come_behind_those_that_followed() -> None:
    ether, frames = sent_over("reorder=0.05")
    order = numbers(ether, frames)
    assert sorted(order) == list(range(COUNT))
    behind = late(ether, frames)
    assert np.mean(behind > 0.0) == pytest.approx(0.05, abs=0.01)
    assert behind.max() <= BEHIND
    overtaken = sum(b < a for a, b in pairwise(order))
    assert 0.02 * COUNT < overtaken < 0.06 * COUNT


@pytest.mark.parametrize(("fault", "overtakes"), [("jitter=20", False), ("scatter=20", True)])
def test_jitter_with_the_order_kept_and_without(fault: str, overtakes: bool) -> None:
    ether, frames = sent_over(fault)
    order, delays = numbers(ether, frames), late(ether, frames)
    assert sorted(order) == list(range(COUNT))
    assert (order != sorted(order)) == overtakes
    assert 0.0 <= delays.min() < 0.01
    assert 0.019 < delays.max() <= 0.0201
    assert np.std(delays) > 0.002


def test_a_second_copy_comes_soon() -> None:
    ether, frames = sent_over("duplicate=0.1")
    counts = Counter(numbers(ether, frames))
    assert len(counts) == COUNT
    assert sum(n == 2 for n in counts.values()) == pytest.approx(0.1 * COUNT, rel=0.15)
    assert max(counts.values()) == 2
    assert late(ether, frames).max() <= BEHIND


def test_corrupt_frames_are_wrong_or_short() -> None:
    ether, frames = sent_over("corrupt=0.2")
    sound = set(frames)
    spoilt = [frame for _, frame in ether.arrived if frame not in sound]
    assert len(ether.arrived) == COUNT
    assert len(spoilt) == pytest.approx(0.2 * COUNT, rel=0.1)
    assert 0.1 < np.mean([len(f) not in (len(frames[0]), len(frames[1])) for f in spoilt]) < 0.4
    readable = [read_frame(frame) for frame in spoilt]
    assert not [f for f in readable if f is not None and f.valid is Validity.OK]


def test_a_narrow_link_queues_and_then_drops() -> None:
    wide = sum(map(len, frames_of(COUNT))) / (COUNT * 1e-6 * STEP_US)
    ether, frames = sent_over(f"bandwidth={0.5 * wide}")
    passed = sum(len(frame) for _, frame in ether.arrived)
    seconds = 1e-6 * (ether.arrived[-1][0] - ether.arrived[0][0])
    assert passed / seconds == pytest.approx(0.5 * wide, rel=0.01)
    delays = late(ether, frames)
    assert delays[-1] == pytest.approx(QUEUE, abs=0.02)
    assert numbers(ether, frames) == sorted(numbers(ether, frames))
    ether, frames = sent_over(f"bandwidth={2.0 * wide}")
    assert len(ether.arrived) == COUNT
    assert late(ether, frames).max() < 0.005


def test_silence_comes_back_and_nothing_passes_in_it() -> None:
    ether, frames = sent_over("silence=2:1.5:6")
    times = 4e-3 * np.array(numbers(ether, frames))
    silent = ((times - 2.0) % 6.0 < 1.5) & (times >= 2.0)
    assert not silent.any()
    assert len(times) == COUNT - 2 * 375


def test_one_message_stalls_and_the_others_pass() -> None:
    ether, _ = sent_over("stall=ATTITUDE:4:3", "stall=HEARTBEAT:10:1")
    by_name: dict[int, list[float]] = {0: [], 30: []}
    for t, frame in ether.arrived:
        by_name[int.from_bytes(frame[7:10], "little")].append(1e-6 * (t - BOOT_US))
    for number, start, length in ((30, 4.0, 3.0), (0, 10.0, 1.0)):
        times = np.array(by_name[number])
        assert len(times) == (SECONDS - length) * 125
        assert not ((times >= start) & (times < start + length)).any()


def test_what_the_ground_sends_is_lost_as_well() -> None:
    for faults, share in ((["loss=0.3"], 0.7), (["silence=0:9"], 0.0), ([], 1.0)):
        ether = Ether()
        line = BadLine(ether, make_faults(map(parse_fault, faults)), np.random.SeedSequence(2))
        assert line.receive() == b""
        ether.question = b"?"
        line.send([], BOOT_US)
        heard = sum(line.receive() == b"?" for _ in range(500))
        assert heard == pytest.approx(500 * share, abs=40 * (0.0 < share < 1.0))


def test_a_stranger_lies_and_floods() -> None:
    ether, frames = sent_over("garbage=20", "forged=10", "flood=100")
    assert [frame for _, frame in ether.arrived] == frames  # the vehicle's own are untouched
    strange = [read_frame(data) for data in ether.strangers]
    sound = [f for f in strange if f is not None and f.valid is Validity.OK]
    beats = [f for f in sound if f.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT]
    assert len(ether.strangers) == pytest.approx(SECONDS * 130, abs=100)
    assert len(beats) == pytest.approx(SECONDS * 10, abs=10)
    assert len(ether.strangers) - len(sound) == pytest.approx(SECONDS * 20, abs=20)
    ours = [f for f in beats if (f.system, f.component) == (1, 1)]
    assert 35 < len(ours) < 85
    flood = [f for f in sound if f.message_id == mavlink.MAVLINK_MSG_ID_HIGHRES_IMU]
    assert 1 not in {f.system for f in flood}


def test_faults_are_seeded_and_do_not_move_each_other() -> None:
    every = ("bursts=0.1", "corrupt=0.1", "scatter=20", "reorder=0.1", "duplicate=0.1", "garbage=9")
    one, again, other = (sent_over(*every, seed=s)[0] for s in (1, 1, 2))
    assert (one.arrived, one.strangers) == (again.arrived, again.strangers)
    assert one.arrived != other.arrived
    alone = numbers(*sent_over("loss=0.1"))
    with_others = numbers(*sent_over("loss=0.1", "jitter=10", "reorder=0.1", "bursts=0.1"))
    assert set(with_others) < set(alone)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., list[tuple[int, Any]]]:
    folder = tmp_path_factory.mktemp("lines")

    def fly(*faults: str) -> list[tuple[int, Any]]:
        path = folder / ("-".join(faults) or "clean")
        options = ["--duration", "3", "--rate", "50", "--force", "--tlog", str(path)]
        for fault in faults:
            options += ["--fault", fault]
        assert main(options) == 0
        return list(TlogReader(path))

    return fly


def test_a_file_holds_what_arrived_and_when(recorded: Callable[..., list[Any]]) -> None:
    clean, bad = recorded(), recorded("loss=0.3", "scatter=40", "corrupt=0.05", "delay=100")
    made = {frame.raw: time_us for time_us, frame in clean}
    times = [t for t, _ in bad]
    assert times == sorted(times)
    sound = [(t, frame) for t, frame in bad if frame.valid is Validity.OK]
    assert len(sound) == pytest.approx(0.7 * 0.95 * len(clean), rel=0.08)
    assert {frame.raw for _, frame in sound} <= set(made)
    delays = 1e-6 * np.array([t - made[frame.raw] for t, frame in sound])
    assert 0.1 <= delays.min() < 0.105
    assert 0.135 < delays.max() <= 0.1401
    assert min(times) >= EPOCH_US + BOOT_US + 100_000
    assert bad == recorded("loss=0.3", "scatter=40", "corrupt=0.05", "delay=100")
