"""Requests the streams that identification needs, and checks that they arrive.

An ACK proves nothing (PX4 acknowledges streams that never arrive), and another ground station
may reset the rates at any time, so only what arrives counts. There is no clock in here: the
caller says what time it is.
"""

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType

from gcs_sysid.signals.records import NEEDED_RATE
from gcs_sysid.telemetry.messages import MESSAGE_IDS
from gcs_sysid.telemetry.outgoing import MOST_OF_GROUP, Gate
from gcs_sysid.telemetry.vehicles import MavlinkSystem
from gcs_sysid.telemetry.wanted_streams import (
    ARDUPILOT_LOOP_RATE,
    ESC_GROUP,
    GROUPS,
    IMU,
    USABLE,
    StreamRestoration,
    bytes_per_second,
    fitting_groups,
    fitting_rates,
    interval_us,
    rotor_streams,
    too_slow,
)

ASK_AGAIN_AFTER = 5.0
"""s between two requests for the same group or message: time for it to arrive and be judged."""
ENOUGH = 0.7
"""Part of the asked rate that satisfies: busy PX4 links give 160-182 Hz when asked for 200."""
ASKS_AT_MOST = 60
"""Unanswered requests for a group or message; five minutes. A stream that the vehicle has not got
(ESC_STATUS without telemetry, say) need not be asked for during a whole flight."""


class GroupRequests:
    """Keeps the asked rates of groups going, and gives the vehicle's own back.

    ArduPilot before 4.0 sets rates by groups of messages alone. `arriving` is message name -> Hz
    before anything was asked for: the vehicle's own rates.

    Attributes:
        asked: name of the message that a group was asked for -> Hz.
        short: name -> Hz that arrive, of those that stay away however often they are asked for.
    """

    _SILENT_BELOW = 0.3
    """Hz. What came slower than this was not on."""

    def __init__(self, gate: Gate, vehicle: MavlinkSystem, arriving: Mapping[str, float]) -> None:
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
            self._ask(name, 0.0 if own < self._SILENT_BELOW else min(max(1.0, own), asked))


class StreamRequests:
    """Keeps the heartbeat and the asked rates going.

    Args:
        gate: sends.
        rate: Hz wished for IMU and rotors.
        restoration: finds out and keeps the vehicle's own rates before others are asked for, and
            takes the events of both.
        rotors: how many the airframe has.
        baud: of the serial line, where that limits; None elsewhere.

    Attributes:
        asked: message name -> Hz asked for; empty before the vehicle is known.
        problem: one line when the link brings too little to identify anything, else "".
    """

    HEARTBEAT_EVERY = 1.0
    """s."""
    INTRODUCTIONS = 3
    """Heartbeats in version 2 to a vehicle that sends version 1: PX4 sends 1 until it receives 2,
    and systems limited to 1 ignore them."""
    REPORT_AFTER = 3
    """Requests after which a missing stream is reported, and gets no share of the link."""

    def __init__(
        self,
        gate: Gate,
        rate: float,
        restoration: StreamRestoration,
        rotors: int = 4,
        baud: int | None = None,
    ) -> None:
        self.asked: dict[str, float] = {}
        self.problem = ""
        self._gate = gate
        self._rate = rate
        self._rotors = rotors
        self._baud = baud
        self._line = None if baud is None else baud / 10.0 * USABLE
        self._vehicle: MavlinkSystem | None = None
        self._heartbeat_at: float | None = None
        self._introductions = 0
        self._rates: dict[str, float] = {}
        self._asked_at: dict[str, float] = {}
        self._asks: dict[str, int] = {}
        self._came: set[str] = set()
        self._turning: set[str] = set()
        self._planned: object = None
        self._reported: set[str] = set()
        self._loss = _LossCut()
        self._groups: GroupRequests | None = None
        self._restoration = restoration
        self._loop_rate: float | None = None
        self._outputs: tuple[int, ...] = ()

    def tick(
        self,
        now: float,
        vehicle: MavlinkSystem | None,
        arriving: Mapping[str, float],
        turning: Collection[str] = (),
        lost_of: tuple[int, int] = (0, 0),
        intervals: Mapping[int, tuple[int, int]] = MappingProxyType({}),
        loop_rate: float | None = None,
        outputs: Sequence[int] = (),
    ) -> None:
        """Do what is due.

        Args:
            now: any steady clock, s. Call it a few times a second.
            vehicle: the chosen vehicle, None while there is none.
            arriving: message name -> Hz observed, as `Monitor.rates` gives it.
            turning: messages that have shown all their rotors turning.
            lost_of: messages of the vehicle lost and sent so far.
            intervals: as of `StreamRestoration.tick`.
            loop_rate: ArduPilot's SCHED_LOOP_RATE, Hz; None: not known.
            outputs: that drive motors, from 0; empty while unknown.
        """
        if self._gate.listen_only:
            return
        if vehicle is not None and (
            self._vehicle is None or vehicle.address != self._vehicle.address
        ):
            self._restoration.follow(vehicle)
            self.reboot()
            self.asked = {}
            self._groups = None
            self._came, self._turning = set(), set()
        self._vehicle = vehicle
        self._heartbeat(now, vehicle)
        if vehicle is None:
            return
        self._loop_rate, self._outputs = loop_rate, tuple(outputs)
        restoration = self._restoration
        if not restoration.tick(now, arriving, intervals):
            return
        self._came |= {name for name, hz in arriving.items() if hz > 0.0}
        self._turning |= set(turning)
        share = self._loss.cut_at(now, *lost_of, bytes_per_second(self.asked, self._rotors))
        if self._groups is None and self._knows_groups_alone(vehicle, arriving):
            self._turn_to_groups(vehicle, arriving)
        if self._groups is not None:
            self._see_to_groups(self._groups, vehicle, now, arriving)
            return
        self._plan(vehicle)
        for name in restoration.taken_over(now, arriving, intervals):
            self._restore(name)  # theirs already: nothing to be undone later
        if share is not None:
            self._report_loss(share)
        for name, hz in self._rates.items():
            self._see_to(name, hz, arriving.get(name, 0.0), now, intervals)

    def _heartbeat(self, now: float, vehicle: MavlinkSystem | None) -> None:
        due = self._heartbeat_at is None or now - self._heartbeat_at >= self.HEARTBEAT_EVERY
        if due:
            self._gate.version = 2
            if vehicle is not None and self._introductions >= self.INTRODUCTIONS:
                self._gate.version = vehicle.version
            elif vehicle is not None:
                self._introductions += 1
            self._gate.heartbeat()
            self._heartbeat_at = now
        if vehicle is not None:
            self._gate.version = vehicle.version

    def _rotor_streams(self, vehicle: MavlinkSystem) -> tuple[tuple[str, ...], str]:
        return rotor_streams(vehicle.key, self._rotors, vehicle.version, self._outputs)

    def _plan(self, vehicle: MavlinkSystem) -> None:
        """Decide what to ask for; ask at once for what has changed."""
        speeds, commands = self._rotor_streams(vehicle)
        signed = self._gate.signing and vehicle.version == 2
        capacity = self._capacity
        absent = {name for name in ("HIGHRES_IMU", *speeds, commands) if self._is_absent(name)}
        wanted: tuple[str, ...] = (*speeds, commands)
        if capacity is not None and speeds and self._turning.issuperset(speeds):
            wanted = speeds  # no room for both, and speeds are the better input
        if self._planned == (wanted, absent, capacity, signed, self._loop_rate):
            return
        self._planned = (wanted, absent, capacity, signed, self._loop_rate)
        present = tuple(name for name in wanted if name not in absent) or wanted
        rates = fitting_rates(present, self._rate, self._rotors, capacity, signed)
        # An absent one takes no room, and may still begin: some ESCs report once they turn.
        rates |= {name: rates["HIGHRES_IMU"] for name in wanted if name not in rates}
        if vehicle.key == "ardupilot" and self._is_absent("HIGHRES_IMU"):
            rates["RAW_IMU"] = rates["HIGHRES_IMU"]  # as it came before 4.6
        if vehicle.key == "ardupilot":
            rates = self._even(rates)
        for name, hz in rates.items():
            if hz != self._rates.get(name):
                self._asked_at.pop(name, None)
        for name in self._rates.keys() - rates.keys():
            self._restore(name)
        for name in self._restoration.left_over(rates):
            self._restore(name, asked=True)
        self._restoration.remember({n: self._interval(hz) for n, hz in rates.items()})
        before, self._rates = self._rates, rates
        if self._baud is not None and not self._loss.capacity:
            self._report_line(before.get("HIGHRES_IMU"), rates["HIGHRES_IMU"])

    def _even(self, rates: Mapping[str, float]) -> dict[str, float]:
        """The rates that ArduPilot's loop sends evenly."""
        even = {name: 1e6 / self._interval(hz) for name, hz in rates.items()}
        hertz, wished = even["HIGHRES_IMU"], rates["HIGHRES_IMU"]
        if hertz < ENOUGH * wished or (hertz < wished and wished == self._rate):
            self._report(
                f"asking for {hertz:.0f} Hz instead of {wished:.0f} Hz: the autopilot's loop of "
                f"{self._loop_rate or ARDUPILOT_LOOP_RATE:.0f} Hz would send that unevenly"
            )
        return even

    def _interval(self, hertz: float) -> int:
        assert self._vehicle is not None
        return interval_us(self._vehicle.key, hertz, self._loop_rate)

    def _knows_groups_alone(self, vehicle: MavlinkSystem, arriving: Mapping[str, float]) -> bool:
        """Whether this is ArduPilot before 4.0, by what does not come although asked for.

        HIGHRES_IMU came to ArduPilot after the requests for single messages. Those in between
        bring at least the commands.
        """
        if vehicle.key != "ardupilot" or "HIGHRES_IMU" in self._came:
            return False
        _, commands = self._rotor_streams(vehicle)
        if arriving.get(commands, 0.0) > 1.1 * MOST_OF_GROUP:
            return False
        return all(
            self._asks.get(name, 0) >= self.REPORT_AFTER for name in ("HIGHRES_IMU", commands)
        )

    def _turn_to_groups(self, vehicle: MavlinkSystem, arriving: Mapping[str, float]) -> None:
        for name in list(self.asked):
            self._restore(name)
        self._groups = GroupRequests(self._gate, vehicle, arriving)
        self._report(
            "this ArduPilot lacks SET_MESSAGE_INTERVAL: requesting stream groups, "
            f"which it sends at {MOST_OF_GROUP} Hz at most"
        )

    def _see_to_groups(
        self,
        groups: GroupRequests,
        vehicle: MavlinkSystem,
        now: float,
        arriving: Mapping[str, float],
    ) -> None:
        speeds, _ = self._rotor_streams(vehicle)
        turning = speeds[0] if speeds and self._turning.issuperset(speeds) else None
        groups.tick(now, arriving, self._rate, self._capacity, turning)
        self.asked = dict(groups.asked)
        hertz = groups.asked.get("RAW_IMU", 0.0)
        got = groups.short.get("RAW_IMU")
        self.problem = ""
        if got is not None and got < self._needed:
            what = f"requested {hertz:.0f} Hz, this link carries"
            self.problem = too_slow(what, got, self._needed)
        elif hertz < self._needed:
            what = "such losses leave" if self._baud is None else f"{self._baud} baud carries"
            self.problem = too_slow(what, hertz, self._needed)
        if self.problem and "RAW_IMU" not in self._reported:
            self._reported.add("RAW_IMU")
            self._report(self.problem)

    @property
    def _capacity(self) -> float | None:
        limits = [limit for limit in (self._line, self._loss.capacity) if limit is not None]
        return min(limits, default=None)

    def _is_absent(self, name: str) -> bool:
        return name not in self._came and self._asks.get(name, 0) >= self.REPORT_AFTER

    @property
    def _needed(self) -> float:
        return min(NEEDED_RATE, self._rate)

    def _report_line(self, before: float | None, hertz: float) -> None:
        if hertz < self._needed:
            self.problem = too_slow(f"{self._baud} baud carries", hertz, self._needed)
            self._report(self.problem)
        else:
            self.problem = ""
            if before is None and hertz < self._rate:
                self._report(
                    f"{self._baud} baud carries about {hertz:.0f} Hz of IMU and rotor data: "
                    f"requesting that instead of {self._rate:.0f} Hz"
                )

    def _report_loss(self, share: float) -> None:
        hertz = self._rates["HIGHRES_IMU"]
        self._report(f"{100.0 * share:.0f} % of the messages are lost: requesting {hertz:.0f} Hz")
        if hertz < self._needed:
            self.problem = too_slow("without such loss the link carries", hertz, self._needed)
            self._report(self.problem)

    def _see_to(
        self,
        name: str,
        hz: float,
        got: float,
        now: float,
        intervals: Mapping[int, tuple[int, int]],
    ) -> None:
        """Request a stream where due, and report those that do not arrive."""
        enough = got >= ENOUGH * hz
        if enough:
            self._asks[name] = min(self._asks.get(name, 0), 1)
            self._reported.discard(name)
            if name in IMU and hz >= self._needed:
                self.problem = ""
        asks = self._asks.get(name, 0)
        if not enough and asks >= self.REPORT_AFTER and name not in self._reported:
            self._reported.add(name)
            self._report_shortage(name, hz, got)
        if name not in self._asked_at:
            self._asks[name] = max(asks, 1)
            self._ask(name, hz, now)
        elif not enough and asks < ASKS_AT_MOST and now - self._asked_at[name] >= ASK_AGAIN_AFTER:
            if not self._restoration.looked(now, name, intervals):
                return
            self._asks[name] = asks + 1
            self._ask(name, hz, now)

    def _report_shortage(self, name: str, hz: float, got: float) -> None:
        if got == 0.0:
            self._report(f"{name} does not arrive after {self.REPORT_AFTER} requests")
        elif name in IMU and got < self._needed:
            self.problem = too_slow(f"requested {hz:.0f} Hz, this link carries", got, self._needed)
            self._report(self.problem)
        else:
            self._report(f"{name} arrives at {got:.0f} Hz instead of {hz:.0f} Hz")

    def _ask(self, name: str, hz: float, now: float) -> None:
        assert self._vehicle is not None
        self._asked_at[name] = now
        interval, own = self._interval(hz), self._restoration.own(name)
        self._restoration.requested(now, name, interval)
        address = self._vehicle.address
        if self._gate.set_message_interval(address, MESSAGE_IDS[name], interval, own):
            self.asked[name] = hz

    def _restore(self, name: str, *, asked: bool = False) -> None:
        """Put a stream's own interval back, if another was asked for."""
        asked |= self.asked.pop(name, None) is not None
        if self._vehicle is not None and asked:
            own = self._restoration.own(name)
            self._gate.set_message_interval(self._vehicle.address, MESSAGE_IDS[name], own, own)
            self._restoration.restored(name)

    def _report(self, text: str) -> None:
        if text not in self._restoration.events:
            self._restoration.events.append(text)

    def reboot(self) -> None:
        """Request again: the vehicle has forgotten, or may have while out of contact."""
        if self._groups is not None:
            self._groups.again()
        self._restoration.again()
        self._asked_at.clear()
        self._asks.clear()
        self._reported.clear()
        self._introductions = 0

    def close(self) -> None:
        """Restore the vehicle's rates. Sent twice, as there is no later retry."""
        asked = dict(self.asked)
        for _ in range(2):
            if self._groups is not None:
                self._groups.close()
                continue
            self.asked = dict(asked)
            for name in asked:
                self._restore(name)
        self._restoration.close()


class _LossCut:
    """Lowers what is asked for while lowering it helps against loss.

    A link that is too narrow loses what does not fit; one with a bad antenna, or a router that
    forwards a part, loses its share of however little is asked for.

    Attributes:
        capacity: bytes a second to ask for; None while loss gives no limit.
    """

    LOSS_JUDGED_EVERY = 10.0
    """s."""
    TOO_MUCH_LOSS = 0.1
    FITS = 0.9
    """Part of the bytes that arrived which is asked for after too much was lost."""
    HELPED = 0.7
    """A cut has helped when the share lost came below this part of what it was."""
    CUTS_AT_MOST = 3
    _LEAST_MESSAGES = 200
    """Fewer sent in `LOSS_JUDGED_EVERY` give no loss rate."""

    def __init__(self) -> None:
        self.capacity: float | None = None
        self._before: list[float | None] = []
        self._share: float | None = None
        self._settled = False
        self._since: tuple[float, int, int] | None = None

    def cut_at(self, now: float, lost: int, sent: int, asked: float) -> float | None:
        """Take the counts so far and bytes a second asked; the share lost when that is cut."""
        if self._since is None:
            self._since = now, lost, sent
            return None
        began, lost_before, sent_before = self._since
        if self._settled or now - began < self.LOSS_JUDGED_EVERY:
            return None
        self._since = now, lost, sent
        if sent - sent_before < self._LEAST_MESSAGES:
            return None
        share = (lost - lost_before) / (sent - sent_before)
        if share <= self.TOO_MUCH_LOSS:
            self._share = None
            return None
        if self._share is not None and share > self.HELPED * self._share:
            self.capacity = self._before.pop()  # the last cut did not help: it is not the width
            self._settled = True
            return None
        if len(self._before) >= self.CUTS_AT_MOST or not asked:
            return None
        self._share = share
        self._before.append(self.capacity)
        self.capacity = self.FITS * (1.0 - share) * asked
        return share
