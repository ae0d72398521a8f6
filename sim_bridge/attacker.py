"""A hostile sender on the vehicle's port: garbage, forged heartbeats, floods."""

import numpy as np

from gcs_sysid.telemetry.dialect import mavlink
from sim_bridge.line_faults import LineFaults
from sim_bridge.wire import MAGIC, FrameWriter

VEHICLE = (1, 1)
"""System and component in whose name it lies."""

_LONGEST_GARBAGE = 300


class Attacker:
    """Makes the datagrams that a hostile sender sends.

    Args:
        faults: which, and how many a second.
        seed: of what they hold.
    """

    def __init__(self, faults: LineFaults, seed: np.random.SeedSequence) -> None:
        self._faults = faults
        self._random = np.random.default_rng(seed)
        self._sent = dict.fromkeys(("garbage", "forged", "flood"), 0)

    def datagrams(self, now: float) -> list[bytes]:
        """Those due since the last time, `now` s after the start of the flight."""
        out = []
        for name, make in (
            ("garbage", self._garbage),
            ("forged", self._heartbeat),
            ("flood", self._flood),
        ):
            due = int(now * getattr(self._faults, name))
            out += [make() for _ in range(due - self._sent[name])]
            self._sent[name] = max(due, self._sent[name])
        return out

    def _garbage(self) -> bytes:
        """Random bytes; every other piece begins as a frame does."""
        data = self._random.bytes(int(self._random.integers(1, _LONGEST_GARBAGE)))
        return bytes((MAGIC,)) + data if self._random.random() < 0.5 else data

    def _heartbeat(self) -> bytes:
        """The vehicle's, reporting it on the ground as another type; or another vehicle's."""
        system, component = VEHICLE
        if self._random.random() < 0.5:
            system, component = (int(n) for n in self._random.integers(1, 256, 2))
        autopilots = (mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)
        return self._writer(system, component).frame(
            mavlink.MAVLink_heartbeat_message,
            int(self._random.integers(2**32)),
            mavlink.MAV_TYPE_QUADROTOR,
            autopilots[int(self._random.integers(2))],
            0,  # disarmed
            mavlink.MAV_STATE_STANDBY,
            3,
        )

    def _flood(self) -> bytes:
        """Messages that would spoil an estimate, from systems that were not asked."""
        system = int(self._random.integers(2, 256))
        values = self._random.standard_normal(9).tolist()
        return self._writer(system, 1).frame(
            mavlink.MAVLink_highres_imu_message,
            int(self._random.integers(2**40)),
            *values,
            *(955.0, 0.0, 490.0, 30.0, 63, 0),
        )

    def _writer(self, system: int, component: int) -> FrameWriter:
        writer = FrameWriter(system, component)
        writer.sequence = int(self._random.integers(256))
        return writer
