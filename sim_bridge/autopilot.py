"""What any emulated autopilot has: a clock and streams that come due."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from sim_bridge.dynamics import STEP_US
from sim_bridge.sensor_faults import SensorFaults

BOOT_US = 20_000_000
"""The vehicle's clock at the start of the flight: it was switched on 20 s before."""

EPOCH_US = 1_735_689_600_000_000
"""us since 1970 at which the vehicle was switched on (2025-01-01).

Fixed, so that the same seed gives the same bytes.
"""


class VehicleClock:
    """The vehicle's clock as its messages carry it.

    Attributes:
        step_us: us of true time in a physics step.
    """

    def __init__(
        self, start_us: int = BOOT_US, step_us: int = STEP_US, drift_ppm: float = 0.0
    ) -> None:
        self.step_us = step_us
        self._start_us = start_us
        self._start_tick = 0
        self._drift = drift_ppm * 1e-6

    def at(self, tick: int) -> int:
        """Us since the vehicle was switched on."""
        true = (tick - self._start_tick) * self.step_us
        now = self._start_us + true
        return now + round(true * self._drift) if self._drift else now

    def restart(self, tick: int, start_us: int) -> None:
        """The vehicle was rebooted `start_us` before this step."""
        self._start_tick = tick
        self._start_us = start_us

    def jump(self, tick: int, by_us: int) -> None:
        """Set it ahead, or back where that is negative, but not below zero at this step."""
        self._start_us += max(by_us, -self.at(tick))


def vehicle_clock(
    sensor_faults: SensorFaults, step_us: int, start_us: int = BOOT_US
) -> VehicleClock:
    """The clock of a vehicle switched on so long before, unless the traps say otherwise."""
    if sensor_faults.wrap_us:
        start_us = (1 << 32) - round(1e6 * sensor_faults.wrap_us)
    if sensor_faults.wrap_ms:
        # 2^32 ms are a whole number of times 2^32 us: both wrap at once.
        start_us = 1000 * (1 << 32) - round(1e6 * sensor_faults.wrap_ms)
    return VehicleClock(start_us, step_us, sensor_faults.clock_drift)


class Autopilot(Protocol):
    """An autopilot as its ground station sees it."""

    @property
    def clock(self) -> VehicleClock:
        """The vehicle's."""
        ...

    @property
    def rotor_delay(self) -> float:
        """S by which the rotor stream lags behind the IMU stream."""
        ...

    def poll(self, tick: int) -> list[bytes]:
        """Frames due at this physics step, in the order they are sent."""
        ...

    def receive(self, data: bytes, tick: int) -> list[bytes]:
        """Frames that answer what a ground station sent."""
        ...


@dataclass
class Stream:
    """One message sent again and again.

    Attributes:
        msgid: message number.
        make: makes its frames (several for messages in groups).
        default: us between messages at the start; 0 for never.
        interval: us between messages; 0 for never.
        due: us since the start when the next is due.
    """

    msgid: int
    make: Callable[[], list[bytes]]
    default: float
    interval: float
    due: float


class Schedule:
    """Decides which streams are due.

    The next due time is counted up, never measured, so that a rate that does not fit the grid of
    the physics keeps its mean and does not drift.

    Attributes:
        streams: by message number, in the order of sending.
        step_us: us in a physics step.
    """

    def __init__(self, step_us: int = STEP_US) -> None:
        self.streams: dict[int, Stream] = {}
        self.step_us = step_us
        self._wake = 0.0

    def add(self, msgid: int, rate: float, make: Callable[[], list[bytes]]) -> None:
        """Add a stream of this many messages a second; 0 for one that is only on request.

        The order of adding is the order of sending.
        """
        interval = 1e6 / rate if rate else 0.0
        self.streams[msgid] = Stream(msgid, make, interval, interval, 0.0)

    def set_interval(self, msgid: int, interval: float, tick: int) -> bool:
        """Change a stream: us, 0 for its default, negative for never. False: no such stream."""
        stream = self.streams.get(msgid)
        if stream is None:
            return False
        if interval < 0:
            stream.interval = 0.0
        else:
            # Faster than the physics is not to be had.
            stream.interval = max(interval, self.step_us) if interval else stream.default
        stream.due = tick * self.step_us + stream.interval
        self._wake = 0.0
        return True

    def take(self, tick: int) -> list[Stream]:
        """The streams due at this step."""
        now = tick * self.step_us
        if now < self._wake:
            return []
        taken = []
        wake = float("inf")
        # Half a microsecond of slack: due times are sums of floats.
        latest = now + 0.5
        for stream in self.streams.values():
            if not stream.interval:
                continue
            due = stream.due
            if due <= latest:
                taken.append(stream)
                due = stream.due = due + stream.interval
            if due < wake:
                wake = due
        self._wake = wake - 0.5
        return taken
