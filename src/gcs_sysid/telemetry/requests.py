"""Asks a vehicle for the streams that identification needs, and sees to it that they come.

An ACK proves nothing (PX4 acknowledges streams that never arrive), and another ground station
may reset the rates at any time, so only what arrives counts. There is no clock in here: the
caller says what time it is.
"""

from collections.abc import Mapping

from gcs_sysid.telemetry.messages import MESSAGE_IDS
from gcs_sysid.telemetry.outgoing import Gate
from gcs_sysid.telemetry.vehicles import Vehicle

HEARTBEAT_EVERY = 1.0
"""s."""
ASK_AGAIN_AFTER = 5.0
"""s between two requests for the same message: time for it to arrive and be judged."""
ENOUGH = 0.7
"""Part of the asked rate that satisfies: busy PX4 links give 160-182 Hz when asked for 200."""
ASKS_AT_MOST = 60
"""Unanswered requests a message; five minutes. A stream that the vehicle has not got (ESC_STATUS
without telemetry, say) need not be asked for during a whole flight."""


def default_rates(rate: float) -> dict[str, float]:
    """Message name -> Hz to ask for, given the rate of IMU and rotors."""
    return {
        "HIGHRES_IMU": rate,
        "ESC_STATUS": rate,
        "ACTUATOR_OUTPUT_STATUS": rate,
        "ATTITUDE": min(rate, 100.0),
        "LOCAL_POSITION_NED": min(rate, 50.0),
        "EXTENDED_SYS_STATE": 2.0,
    }


class StreamRequests:
    """Keeps the heartbeat and the asked rates going.

    Attributes:
        asked: message name -> Hz asked for; empty before the vehicle is known.
    """

    def __init__(self, gate: Gate, rates: Mapping[str, float]) -> None:
        self.asked: dict[str, float] = {}
        self._gate = gate
        self._rates = {name: hz for name, hz in rates.items() if hz > 0.0}
        self._vehicle: Vehicle | None = None
        self._asked_at: dict[str, float] = {}
        self._asks: dict[str, int] = {}
        self._heartbeat_at: float | None = None

    def tick(self, now: float, vehicle: Vehicle | None, arriving: Mapping[str, float]) -> None:
        """Do what is due.

        Args:
            now: any steady clock, s. Call it a few times a second.
            vehicle: the chosen vehicle, None while there is none.
            arriving: message name -> Hz observed, as `Monitor.rates` gives it.
        """
        if self._heartbeat_at is None or now - self._heartbeat_at >= HEARTBEAT_EVERY:
            self._gate.heartbeat()
            self._heartbeat_at = now
        if vehicle is None:
            return
        if self._vehicle is None or vehicle.address != self._vehicle.address:
            self._vehicle = vehicle
            self._asked_at.clear()
            self._asks.clear()
        for name, hz in self._rates.items():
            since = now - self._asked_at.get(name, -1e9)
            enough = arriving.get(name, 0.0) >= ENOUGH * hz
            if enough:
                self._asks[name] = min(self._asks.get(name, 0), 1)
            if name not in self._asked_at or (
                not enough and since >= ASK_AGAIN_AFTER and self._asks.get(name, 0) < ASKS_AT_MOST
            ):
                self._ask(name, hz, now)

    def _ask(self, name: str, hz: float, now: float) -> None:
        assert self._vehicle is not None
        target = self._vehicle.address
        self._asked_at[name] = now
        self._asks[name] = self._asks.get(name, 0) + 1
        if self._gate.set_message_interval(target, MESSAGE_IDS[name], round(1e6 / hz)):
            self.asked[name] = hz

    def reboot(self) -> None:
        """Ask anew: the vehicle has forgotten."""
        self._asked_at.clear()
        self._asks.clear()

    def close(self) -> None:
        """Give the vehicle its own rates back."""
        if self._vehicle is None:
            return
        target = self._vehicle.address
        for name in self.asked:
            self._gate.set_message_interval(target, MESSAGE_IDS[name], 0)
        self.asked = {}
