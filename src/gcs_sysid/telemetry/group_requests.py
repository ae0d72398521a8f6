"""Asks ArduPilot before 4.0 for its streams: it sets rates by groups of messages alone.

As with single messages only what arrives counts, and another ground station may reset it. There
is no clock in here either.
"""

from collections.abc import Mapping

from gcs_sysid.telemetry.transceiver import Requests
from gcs_sysid.telemetry.vehicles import Vehicle
from gcs_sysid.telemetry.wanted_streams import ESC_GROUP, GROUPS, fitting_groups

ASK_AGAIN_AFTER = 5.0
"""s between two requests for the same group or message: time for it to arrive and be judged."""
ENOUGH = 0.7
"""Part of the asked rate that satisfies: busy PX4 links give 160-182 Hz when asked for 200."""
ASKS_AT_MOST = 60
"""Unanswered requests for a group or message; five minutes. A stream that the vehicle has not got
(ESC_STATUS without telemetry, say) need not be asked for during a whole flight."""
_SILENT_BELOW = 0.3
"""Hz. What came slower than this was not on."""


class GroupRequests:
    """Keeps the asked rates of groups going, and gives the vehicle's own back.

    Args:
        gate: sends.
        vehicle: that is asked.
        arriving: message name -> Hz before anything was asked for: the vehicle's own rates.

    Attributes:
        asked: name of the message that a group was asked for -> Hz.
        short: name -> Hz that arrive, of those that stay away however often they are asked for.
    """

    def __init__(self, gate: Requests, vehicle: Vehicle, arriving: Mapping[str, float]) -> None:
        self.asked: dict[str, float] = {}
        self.short: dict[str, float] = {}
        self._gate = gate
        self._vehicle = vehicle
        self._own = dict(arriving)
        self._asked_at: dict[str, float] = {}
        self._asks: dict[str, int] = {}

    def tick(
        self,
        now: float,
        arriving: Mapping[str, float],
        rate: float,
        capacity: float | None,
        speeds: str | None,
    ) -> None:
        """Do what is due.

        Args:
            now: any steady clock, s.
            arriving: message name -> Hz observed.
            rate: Hz wished for IMU and rotors.
            capacity: bytes a second that the link carries; None: not known.
            speeds: the message with rotor speeds, where the vehicle has any.
        """
        for name, hertz in fitting_groups(speeds, rate, capacity).items():
            got = arriving.get(name, 0.0)
            enough = got >= ENOUGH * hertz
            if enough:
                self._asks[name] = 0
                self.short.pop(name, None)
            elif self._asks.get(name, 0) > 1:
                self.short[name] = got
            changed = self.asked.get(name) != hertz
            due = name not in self._asked_at or now - self._asked_at[name] >= ASK_AGAIN_AFTER
            if changed or (not enough and due and self._asks.get(name, 0) < ASKS_AT_MOST):
                self._asks[name] = self._asks.get(name, 0) + 1
                self._asked_at[name] = now
                if self._ask(name, hertz):
                    self.asked[name] = hertz

    def _ask(self, name: str, hertz: float) -> bool:
        number = GROUPS.get(name, ESC_GROUP).number
        return self._gate.request_group(self._vehicle.address, number, round(hertz))

    def again(self) -> None:
        """Request again: the vehicle may have forgotten."""
        self._asked_at.clear()
        self._asks.clear()

    def close(self) -> None:
        """Give the vehicle the rates that were seen before; what was silent falls silent."""
        for name, asked in self.asked.items():
            own = self._own.get(name, 0.0)
            self._ask(name, 0.0 if own < _SILENT_BELOW else min(max(1.0, own), asked))
