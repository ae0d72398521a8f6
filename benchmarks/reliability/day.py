"""A day in the air: wraps of stamps, reboots, packs changed; numbers and memory flight by flight.

    python -m benchmarks.reliability.day [--hours 24] [--packs 6]

The emulator flies, for each pack, some minutes of the article's mission without noise: the ground,
the climb, three turns of 60 s, the landing, the ground again; packs differ by a few grams. Two of
the turns are repeated until the pack's share of the hours is full, with stamps that go on, fresh
white noise on gyro, accelerometer and attitude each time, and new numbers and checksums. What is
repeated is thus the motion, not the noise. The rates are low (20 Hz), so that a day takes minutes.

The vehicle's clock begins two hours before its 32-bit milliseconds wrap. It goes on while packs
are changed, but for two changes that switch the autopilot off: then it begins at zero. The 32-bit
microseconds of SERVO_OUTPUT_RAW wrap each 71.6 min besides.

The frames go into the same `Chain` that a live session feeds, 0.2 s of them at a time, without
a socket and without waiting; blocks are of 1 s and an estimate is made each 10 s of the vehicle's
clock, instead of 0.1 and 0.5 s, which changes when numbers are renewed and not what they are.
"""

import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reliability.watched import resident
from gcs_sysid.intervals import Z95
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.results.result import Result
from gcs_sysid.session.chain import Chain
from gcs_sysid.session.chain_options import ChainOptions
from gcs_sysid.session.origin import Origin
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frame_block import FrameBlock
from gcs_sysid.telemetry.frames import Frame, read_frame
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.messages import MESSAGE_IDS
from gcs_sysid.telemetry.tlog import read_tlog
from sim_bridge.missions import MISSIONS, Mission, Reference
from sim_bridge.simulation import mass_step
from sim_bridge.wire import FrameWriter
from testbed.ground_cycles import emulate
from testbed.study import arguments

RATE = 20.0
RATES = {
    "ESC_STATUS": RATE,
    "ATTITUDE": RATE,
    "LOCAL_POSITION_NED": 5.0,
    "SERVO_OUTPUT_RAW": 5.0,
    "EXTENDED_SYS_STATE": 1.0,
    "ACTUATOR_OUTPUT_STATUS": 0.0,
    "ATTITUDE_QUATERNION": 0.0,
    "GLOBAL_POSITION_INT": 0.0,
    "VFR_HUD": 0.0,
    "GPS_RAW_INT": 0.0,
    "SYS_STATUS": 0.0,
    "ESC_INFO": 0.0,
    "BATTERY_STATUS": 0.0,
    "HOME_POSITION": 0.0,
}
GROUND, CLIMB, TURN, TURNS = 10.0, 6.0, 60.0, 3
GRAMS = (0.0, 3.0, -2.0, 1.0, -3.0, 2.0)
REBOOTS = (2, 4)
"""Packs, counted from 0, before which the autopilot was switched off."""
TO_WRAP = 7200.0
"""s from the day's start to the wrap of 32-bit milliseconds."""
NOISE = {"gyro": 0.01, "force": 0.1, "attitude": 0.003}
"""rad/s, m/s^2, rad: standard deviations of white noise."""
SHOWN = ("Ixx", "Iyy", "Izz", "k_T", "k_M", "cg_x", "cg_y")
BAR = 2.0
"""% of error at the end of each flight."""
GROWN_MB = 5.0
_TOGETHER = 0.2
"""s of frames taken at a time."""
_US64, _US32, _MS32 = (
    {MESSAGE_IDS[name] for name in names}
    for names in (
        ("HIGHRES_IMU", "ESC_STATUS"),
        ("SERVO_OUTPUT_RAW",),
        ("ATTITUDE", "LOCAL_POSITION_NED"),
    )
)
_IMU, _ATTITUDE = MESSAGE_IDS["HIGHRES_IMU"], MESSAGE_IDS["ATTITUDE"]


@dataclass(frozen=True)
class Turns:
    """The article's mission, so many turns of it."""

    turns: int
    name: str = "turns"
    turbulence: float = 0.0

    @property
    def duration(self) -> float:
        """S."""
        return 2.0 + TURN * self.turns

    def reference(self, t: float) -> Reference:
        """Set-points t seconds after the start."""
        whole: Mission = MISSIONS["paper"]
        return whole.reference(t)


@dataclass(frozen=True)
class Message:
    """One of the emulated flight's, without what changes when it is sent again."""

    t: float
    """s since the flight's start."""
    message_id: int
    crc_extra: int
    payload: bytes
    """Of full length."""


def messages_of(recording: Path) -> list[Message]:
    """A recording's, in order."""
    out, first = [], None
    for time_us, frame in read_tlog(recording):
        first = time_us if first is None else first
        kind = mavlink.mavlink_map[frame.message_id]
        payload = frame.payload.ljust(kind.unpacker.size, b"\0")
        t = 1e-6 * (time_us - first)
        out.append(Message(t, frame.message_id, kind.crc_extra, payload))
    return out


class Replayer:
    """Sends messages again as the frames of one vehicle that flies on.

    Args:
        seed: of the noise.
        start: s, the vehicle's clock at the start.
    """

    def __init__(self, seed: int, start: float) -> None:
        self.clock = start
        self.wraps = {"us": 0, "ms": 0}
        self.sent = 0
        self._random = np.random.default_rng(seed)
        self._writer = FrameWriter(1, 1)
        self._last = {"us": 0, "ms": 0}

    def reboot(self) -> None:
        """The clock restarts."""
        self.clock = 2.0
        self._last = {"us": 0, "ms": 0}

    def send(self, messages: list[Message], begin: float, end: float) -> Iterator[list[Frame]]:
        """The part [begin, end) s of a flight, some frames at a time; the clock goes on."""
        part = [message for message in messages if begin <= message.t < end]
        inertial = self._random.standard_normal((len(part), 6)) * (
            [NOISE["force"]] * 3 + [NOISE["gyro"]] * 3
        )
        angles = NOISE["attitude"] * self._random.standard_normal((len(part), 3))
        frames: list[Frame] = []
        until = begin + _TOGETHER
        for message, six, three in zip(part, inertial, angles, strict=True):
            if message.t >= until:
                yield frames
                frames, until = [], until + _TOGETHER
            us = round(1e6 * (self.clock + message.t - begin))
            frames.append(self._frame(message, us, six, three))
        yield frames
        self.clock += end - begin
        self.sent += len(part)

    def _frame(self, message: Message, us: int, six: Any, three: Any) -> Frame:
        payload = bytearray(message.payload)
        if message.message_id in _US64:
            payload[:8] = us.to_bytes(8, "little")
        elif message.message_id in _US32:
            payload[:4] = self._wrapping("us", us)
        elif message.message_id in _MS32:
            payload[:4] = self._wrapping("ms", us // 1000)
        if message.message_id == _IMU:
            values = np.frombuffer(payload, "<f4", 6, 8)
            values += six
        elif message.message_id == _ATTITUDE:
            values = np.frombuffer(payload, "<f4", 3, 4)
            values += three
        raw = self._writer.frame_of_payload(message.message_id, message.crc_extra, bytes(payload))
        frame = read_frame(raw)
        assert frame is not None
        return frame

    def _wrapping(self, unit: str, stamp: int) -> bytes:
        stamp %= 1 << 32
        self.wraps[unit] += stamp < self._last[unit]
        self._last[unit] = stamp
        return stamp.to_bytes(4, "little")


def template(folder: Path, pack: int) -> tuple[list[Message], dict[str, float]]:
    """The emulated flight of a pack, and what is true of it."""
    path = folder / f"pack{pack}.tlog"
    factor = 1.0 + 1e-3 * GRAMS[pack % len(GRAMS)] / 1.5
    emulate(
        path,
        rate=RATE,
        rates=RATES,
        mission=Turns(TURNS),
        ground=GROUND,
        noise="none",
        seed=pack,
        changes=[mass_step(0.0, factor)],
    )
    return messages_of(path), json.loads(path.with_suffix(".truth.json").read_text())


def fly(
    take: Callable[[Sequence[Frame]], None],
    replayer: Replayer,
    messages: list[Message],
    seconds: float,
) -> None:
    """Take off, fly turns for so long, land."""
    begin = GROUND + CLIMB + 2.0 + TURN
    end = begin + (TURNS - 1) * TURN
    last = messages[-1].t + 1.0 / RATE
    parts = [(0.0, begin)]
    left = seconds - begin - (last - end)
    while left > 0.0:
        parts.append((begin, min(end, begin + TURN * max(round(left / TURN), 1))))
        left -= parts[-1][1] - begin
    for part in (*parts, (end, last)):
        for frames in replayer.send(messages, *part):
            take(frames)


def errors(result: Result, truth: dict[str, float]) -> dict[str, tuple[float, float]]:
    """Parameter -> error and half width of the 95 % interval, in %."""
    out = {}
    for name in SHOWN:
        estimate = result.parameters[name]
        if estimate.value is None or estimate.std is None:
            out[name] = np.inf, np.inf
        else:
            share = 100.0 / abs(truth[name])
            out[name] = share * (estimate.value - truth[name]), Z95 * share * estimate.std
    return out


def main() -> int:
    """Fly the day."""
    parser = arguments(__doc__)
    parser.add_argument("--hours", type=float, default=24.0, help="of all flights (default: 24)")
    parser.add_argument("--packs", type=int, default=6, help="flights (default: 6)")
    options = parser.parse_args()
    airframe = load_airframe("paper")
    intake = Intake()
    chain = Chain(
        airframe,
        ChainOptions(history_interval=10.0, tick=1.0),
        origin=Origin(intake, "day"),
    )

    def take(frames: Sequence[Frame]) -> None:
        chain.take(intake.block(FrameBlock.of(frames)))

    replayer = Replayer(1, (1 << 32) * 1e-3 - TO_WRAP)
    print(f"{'flight':<8}{'flown':>8}{'clock':>12}{'MB':>8}  errors in % (+- half width of 95 %)")
    memory, spent, bad = [], time.process_time(), 0
    with tempfile.TemporaryDirectory() as folder:
        for pack in range(options.packs):
            messages, truth = template(Path(folder), pack)
            if pack in REBOOTS:
                replayer.reboot()
            fly(take, replayer, messages, 3600.0 * options.hours / options.packs)
            result = chain.refit()
            memory.append(1e-6 * resident())
            found = errors(result, truth)
            bad += sum(not abs(error) < BAR for error, _ in found.values())
            words = "  ".join(f"{name} {e:+.2f}±{w:.2f}" for name, (e, w) in found.items())
            hours = chain.t / 3600.0
            print(
                f"{pack + 1:<8}{hours:>6.2f} h{replayer.clock:>10.0f} s{memory[-1]:>8.1f}  {words}",
                flush=True,
            )
    final = chain.finish()
    told = final.telemetry
    print(
        f"\nmessages sent {replayer.sent}, lost {told['lost']}, dropped {told['dropped']}, "
        f"reboots seen {told['reboots']}\n"
        f"wraps of 32-bit us {replayer.wraps['us']}, of 32-bit ms {replayer.wraps['ms']}\n"
        f"errors of {BAR:.0f} % or more: {bad}; memory after the first flight grew by "
        f"{max(memory) - memory[0]:.1f} MB (bar {GROWN_MB:.0f}); "
        f"{time.process_time() - spent:.0f} s of processor time\n"
        f"verdict {final.verdict}; events told: {len(final.events)}"
    )
    for event in final.events[-20:]:
        print(" ", {key: event[key] for key in ("t", "kind", "text") if key in event})
    return int(bad > 0 or max(memory) - memory[0] >= GROWN_MB)


if __name__ == "__main__":
    sys.exit(main())
