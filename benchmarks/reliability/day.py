"""A day in the air: wraps of stamps, reboots, packs changed; numbers and memory flight by flight.

    python -m benchmarks.reliability.day [--hours 24] [--packs 6]

The emulator flies, for each pack, some minutes of the article's mission without noise: the ground,
the climb, three turns of 60 s, the landing, the ground again; packs differ by a few grams. Two of
the turns are repeated until the pack's share of the hours is full, with stamps that go on, fresh
white noise on gyro, accelerometer and attitude each time, and new numbers. What is
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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.results.result import Result
from gcs_sysid.session.chain import Chain, ChainOptions
from gcs_sysid.session.origin import Origin
from gcs_sysid.significance import Z95
from gcs_sysid.telemetry.frame_block import FrameBlock
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.messages import MESSAGE_IDS
from sim_bridge.autopilot import BOOT_US
from sim_bridge.missions import MISSIONS, Mission, Reference
from sim_bridge.simulation import mass_step
from testbed.ground_cycles import emulate
from testbed.repeated import add_to, frames_of, later
from testbed.study import arguments
from testbed.watched import resident

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
NOISE = (
    (MESSAGE_IDS["HIGHRES_IMU"], 8, [0.1] * 3 + [0.01] * 3),
    (MESSAGE_IDS["ATTITUDE"], 4, [0.003] * 3),
)
"""Message, offset of its floats, standard deviations of their white noise: m/s^2, rad/s, rad."""
SHOWN = ("Ixx", "Iyy", "Izz", "k_T", "k_M", "cg_x", "cg_y")
BAR = 2.0
"""% of error at the end of each flight."""
GROWN_MB = 5.0
_TOGETHER = 0.2
"""s of frames taken at a time."""


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


class Replayer:
    """Sends parts of recordings again as the frames of one vehicle that flies on.

    Args:
        seed: of the noise.
        start: s, the vehicle's clock at the start.
    """

    def __init__(self, seed: int, start: float) -> None:
        self.clock = start
        self.wraps = {"us": 0, "ms": 0}
        self.sent = 0
        self._random = np.random.default_rng(seed)

    def reboot(self) -> None:
        """The clock restarts."""
        self.clock = 2.0

    def send(self, flight: FrameBlock, begin: float, end: float) -> Iterator[FrameBlock]:
        """The part [begin, end) s of a flight, some frames at a time; the clock goes on."""
        t = seconds_of(flight)
        part = flight.part(*np.searchsorted(t, [begin, end]).tolist())
        ms = round(1e3 * (self.clock - begin)) - round(1e-3 * BOOT_US)
        part = self._noisy(later(part, 1000 * ms, self.sent))
        cuts = np.searchsorted(seconds_of(part), np.arange(_TOGETHER, end - begin, _TOGETHER))
        for first, last in pairwise([0, *cuts.tolist(), len(part)]):
            yield part.part(first, last)
        for unit, scale in (("us", 1e6), ("ms", 1e3)):
            before, after = (int(scale * s) >> 32 for s in (self.clock, self.clock + end - begin))
            self.wraps[unit] += after - before
        self.clock += end - begin
        self.sent += len(part)

    def _noisy(self, part: FrameBlock) -> FrameBlock:
        for message_id, offset, std in NOISE:
            rows = (part.message_id == message_id) & (part.payload_size >= offset + 4 * len(std))
            noise = self._random.standard_normal((np.count_nonzero(rows), len(std))) * std
            add_to(part.data, part.payload_at[rows] + offset, "<f4", noise)
        return part


def seconds_of(frames: FrameBlock) -> Array:
    """(n,) s from the first on."""
    t: Array = 1e-6 * (frames.time_us - frames.time_us[0]).astype(float)
    return t


def template(folder: Path, pack: int) -> tuple[FrameBlock, dict[str, float]]:
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
    return frames_of(path), json.loads(path.with_suffix(".truth.json").read_text())


def fly(
    take: Callable[[FrameBlock], None], replayer: Replayer, flight: FrameBlock, seconds: float
) -> None:
    """Take off, fly turns for so long, land."""
    begin = GROUND + CLIMB + 2.0 + TURN
    end = begin + (TURNS - 1) * TURN
    last = float(seconds_of(flight)[-1]) + 1.0 / RATE
    parts = [(0.0, begin)]
    left = seconds - begin - (last - end)
    while left > 0.0:
        parts.append((begin, min(end, begin + TURN * max(round(left / TURN), 1))))
        left -= parts[-1][1] - begin
    for part in (*parts, (end, last)):
        for frames in replayer.send(flight, *part):
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

    def take(frames: FrameBlock) -> None:
        chain.take(intake.block(frames))

    replayer = Replayer(1, (1 << 32) * 1e-3 - TO_WRAP)
    print(f"{'flight':<8}{'flown':>8}{'clock':>12}{'MB':>8}  errors in % (+- half width of 95 %)")
    memory, spent, bad = [], time.process_time(), 0
    with tempfile.TemporaryDirectory() as folder:
        for pack in range(options.packs):
            flight, truth = template(Path(folder), pack)
            if pack in REBOOTS:
                replayer.reboot()
            fly(take, replayer, flight, 3600.0 * options.hours / options.packs)
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
