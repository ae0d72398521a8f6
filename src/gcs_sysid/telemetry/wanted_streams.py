"""Which messages identification needs of an autopilot, at which rates, and which it had before.

The rates are those that fit the link. What each stream's interval was before the first request is
kept, so that it can be put back: the vehicle is asked for its intervals before anything is changed.
Where it does not answer, the rates that arrived until then count. While others run, the vehicle is
asked again now and then: an interval that is no longer what this session's request made of it was
set by another station, and is what will be put back. What was found is kept in a small file for
each vehicle and link while the session lasts: a session that is killed with everything else leaves
it behind, and the next one puts back what it finds there. There is no clock in here: the caller
says what time it is.
"""

import json
import math
import re
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from gcs_sysid.errors import InputError
from gcs_sysid.files import read_text, write_whole
from gcs_sysid.signals.records import NEEDED_RATE
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.frames import CHECKSUM, HEADER_2, LONGEST_1, SIGNATURE
from gcs_sysid.telemetry.messages import MESSAGE_IDS
from gcs_sysid.telemetry.outgoing import LONGEST_INTERVAL, MOST_OF_GROUP, SHORTEST_INTERVAL, Gate
from gcs_sysid.telemetry.vehicles import MavlinkSystem

USABLE = 0.92
"""Part of a serial link's bytes to plan with; the rest is for what the vehicle sends unasked."""
SPEEDS = {
    "px4": ("ESC_STATUS",),
    "ardupilot": (
        "ESC_TELEMETRY_1_TO_4",
        "ESC_TELEMETRY_5_TO_8",
        "ESC_TELEMETRY_9_TO_12",
        "ESC_TELEMETRY_13_TO_16",
    ),
}
"""Autopilot -> messages with measured rotor speeds, each for four rotors where there are more."""
COMMANDS = {"px4": "ACTUATOR_OUTPUT_STATUS", "ardupilot": "SERVO_OUTPUT_RAW"}
"""Autopilot -> the message with its actuator outputs."""

IMU = ("HIGHRES_IMU", "RAW_IMU")
"""Messages requested for IMU data; the second for ArduPilot before 4.6, which lacks the first."""


class MessageGroup(NamedTuple):
    """A group of messages as ArduPilot sets their rates together."""

    number: int
    """MAV_DATA_STREAM."""
    size: int
    """Bytes of all that comes with one round of it."""
    most: int
    """Hz; more adds nothing."""


GROUPS = {
    "RAW_IMU": MessageGroup(mavlink.MAV_DATA_STREAM_RAW_SENSORS, 160, MOST_OF_GROUP),
    "SERVO_OUTPUT_RAW": MessageGroup(mavlink.MAV_DATA_STREAM_RC_CHANNELS, 100, MOST_OF_GROUP),
    "ATTITUDE": MessageGroup(mavlink.MAV_DATA_STREAM_EXTRA1, 80, MOST_OF_GROUP),
    "GLOBAL_POSITION_INT": MessageGroup(mavlink.MAV_DATA_STREAM_POSITION, 80, 10),
}
"""Message that is needed -> the group of ArduPilot's that brings it."""
ESC_GROUP = MessageGroup(mavlink.MAV_DATA_STREAM_EXTRA3, 300, MOST_OF_GROUP)
"""The group with ESC_TELEMETRY, which brings much besides."""

LAST_ID_OF_VERSION_1 = len(LONGEST_1) - 1
ARDUPILOT_LOOP_RATE = 400.0
"""Hz: SCHED_LOOP_RATE of a copter, unless it reports another."""
_ATTITUDE, _POSITION = 100.0, 50.0
"""Hz: more than these adds nothing."""

# Bytes of whole frames in version 2, as recorded from real autopilots: trailing zeros are cut.
_SIZES = {
    "HIGHRES_IMU": 74,
    "RAW_IMU": 41,
    "ATTITUDE": 40,
    "LOCAL_POSITION_NED": 40,
    "EXTENDED_SYS_STATE": 14,
    "ESC_STATUS": 69,
    "ACTUATOR_OUTPUT_STATUS": 88,
    "SERVO_OUTPUT_RAW": 49,
}
_ESC_TELEMETRY_SIZE = (
    HEADER_2
    + mavlink.mavlink_map[mavlink.MAVLINK_MSG_ID_ESC_TELEMETRY_1_TO_4].unpacker.size
    + CHECKSUM
)


def rotor_streams(
    autopilot: str, rotors: int, version: int = 2, outputs: Sequence[int] = ()
) -> tuple[tuple[str, ...], str]:
    """Names of the messages with measured speeds, and of the one with commands.

    Args:
        autopilot: "px4", "ardupilot"; any other is asked as PX4 is.
        rotors: how many the airframe has.
        version: of MAVLink; version 1 has no room for message numbers above 255.
        outputs: that drive its motors, from 0; empty while unknown: the first.
    """
    key = "ardupilot" if autopilot == "ardupilot" else "px4"
    speeds = SPEEDS[key]
    if key == "ardupilot":
        groups = {output // 4 for output in outputs or range(rotors)}
        speeds = tuple(name for i, name in enumerate(speeds) if i in groups)
    if version == 1:
        return tuple(n for n in speeds if MESSAGE_IDS[n] <= LAST_ID_OF_VERSION_1), (
            "SERVO_OUTPUT_RAW"
        )
    return speeds, COMMANDS[key]


def default_rates(rotor_messages: tuple[str, ...], rate: float) -> dict[str, float]:
    """Message name -> Hz to ask for, given the rate of IMU and rotors."""
    return {
        "HIGHRES_IMU": rate,
        **dict.fromkeys(rotor_messages, rate),
        "ATTITUDE": min(rate, _ATTITUDE),
        "LOCAL_POSITION_NED": min(rate, _POSITION),
        "EXTENDED_SYS_STATE": min(rate, 2.0),
    }


def bytes_per_second(rates: Mapping[str, float], rotors: int, signed: bool = False) -> float:
    """Bytes a second that messages at these rates take on the wire."""
    total = 0.0
    for name, hz in rates.items():
        size = _SIZES.get(name, _ESC_TELEMETRY_SIZE) + SIGNATURE * signed
        frames = -(-rotors // 4) if name == "ESC_STATUS" else 1
        total += size * frames * hz
    return total


def fitting_rates(
    rotor_messages: tuple[str, ...],
    rate: float,
    rotors: int,
    capacity: float | None,
    signed: bool = False,
) -> dict[str, float]:
    """`default_rates`, lowered to what a link carries.

    Args:
        rotor_messages: names.
        rate: Hz wished for IMU and rotors.
        rotors: how many the airframe has.
        capacity: bytes a second; None for a link without a known limit.
        signed: whether frames carry a signature.

    Returns:
        Message name -> Hz. IMU and rotors share one rate, of at least 1 Hz.
    """
    rates = default_rates(rotor_messages, rate)
    if capacity is None or bytes_per_second(rates, rotors, signed) <= capacity:
        return rates
    # Attitude and position keep their share of the full rates: they are the cheap part to thin.
    low = int(rate)
    while low > 1:
        rates = default_rates(rotor_messages, float(low))
        rates["ATTITUDE"] = min(max(0.4 * low, 10.0), rates["ATTITUDE"])
        rates["LOCAL_POSITION_NED"] = min(max(0.2 * low, 5.0), rates["LOCAL_POSITION_NED"])
        if bytes_per_second(rates, rotors, signed) <= capacity:
            return rates
        low -= 1
    return default_rates(rotor_messages, 1.0)


def fitting_groups(speeds: str | None, rate: float, capacity: float | None) -> dict[str, float]:
    """Whole Hz to request ArduPilot's groups at, by the message that each is requested for.

    Args:
        speeds: the message with rotor speeds, where the vehicle has any.
        rate: Hz wished for IMU and rotors.
        capacity: bytes a second; None for a link without a known limit.
    """
    groups = GROUPS if speeds is None else {**GROUPS, speeds: ESC_GROUP}
    low = max(round(min(rate, MOST_OF_GROUP)), 1)
    while True:
        rates = {name: float(min(low, group.most)) for name, group in groups.items()}
        total = sum(rates[name] * group.size for name, group in groups.items())
        if low == 1 or capacity is None or total <= capacity:
            return rates
        low -= 1


def interval_us(autopilot: str, hertz: float, loop_rate: float | None = None) -> int:
    """What to ask for in SET_MESSAGE_INTERVAL, us, so that it is sent evenly.

    ArduPilot knows whole milliseconds and sends once a turn of its main loop: asked for 4 ms, a
    loop of 400 Hz alternates between 2.5 and 5 ms. So it is asked for the shortest interval not
    below the one wished for that is a whole number both of milliseconds and of turns.

    Args:
        autopilot: "px4", "ardupilot", ...
        hertz: wished for.
        loop_rate: ArduPilot's SCHED_LOOP_RATE, Hz; None: not known.
    """
    if autopilot != "ardupilot":
        return round(1e6 / hertz)
    loop = loop_rate if loop_rate and 50.0 <= loop_rate <= 10_000.0 else ARDUPILOT_LOOP_RATE
    # ArduPilot sends nothing faster than at 0.8 of its loop rate.
    shortest = max(1e3 / hertz, 1e3 / (0.8 * loop))
    # A loop whose turns fit into no fewer whole ms has no even rate of use.
    for step in range(1, 21):
        if (step * loop) % 1e3 < 1e-6:
            return 1000 * step * math.ceil(shortest / step - 1e-9)
    return 1000 * math.ceil(shortest - 1e-9)


def too_slow(what: str, hertz: float, needed: float = NEEDED_RATE) -> str:
    """The line for a link that cannot carry what identification needs."""
    return (
        f"{what} about {hertz:.0f} Hz of IMU and rotor data; identification needs {needed:.0f} Hz "
        "or more: use a faster link (460800 baud, USB, WiFi) or analyze the vehicle's own log"
    )


VEHICLE_DEFAULT, OFF = 0, -1
"""Intervals of SET_MESSAGE_INTERVAL that are none."""
SAME = 0.02
"""Share by which an interval may differ and still be the one asked for: autopilots round."""
SCHEMA = "gcs-sysid-streams/1"


class StreamRestoration:
    """Finds out each stream's own interval, and keeps it.

    Without a folder for the file nothing is kept beyond the session; `link` is the link's URL: PX4
    has rates for each link. `events` are lines for the user, the latest of those not yet taken.
    """

    ROUND_EVERY = 0.6
    """s between two rounds of questions; a telemetry radio answers within it."""
    ROUNDS = 3
    """Of questions, by GET_MESSAGE_INTERVAL and REQUEST_MESSAGE in turn: some know only one."""
    OBSERVED_FOR = 3.0
    """s after which what arrived must do, where a question is not answered."""
    SILENT_FOR = 0.7
    """s after which a vehicle that neither answers nor sends any of the streams is not waited
    for."""
    CHECKED_EVERY = 5.0
    """s between questions whether another station has set an interval."""
    SETTLED = 1.0
    """s after a request in which it has taken effect; s that an answer is waited for."""

    def __init__(self, gate: Gate, rotors: int, folder: Path | None = None, link: str = "") -> None:
        self.events: deque[str] = deque(maxlen=100)
        self._gate = gate
        self._rotors = rotors
        self._folder = folder
        self._link = link
        self._vehicle: MavlinkSystem | None = None
        self._names: tuple[str, ...] = ()
        self._began: float | None = None
        self._received_before = 0
        self._rounds = 0
        self._known = False
        self._own: dict[str, int] = {}
        self._asked: dict[str, int] = {}
        self._kept: object = None
        self._answered: set[str] = set()
        self._became: dict[str, int] = {}
        self._check_at = 0.0
        self._received_at_check = 0
        self._looking: dict[str, tuple[float, int]] = {}
        self._reported: set[str] = set()

    def follow(self, vehicle: MavlinkSystem) -> None:
        """Begin with another vehicle."""
        self._vehicle = vehicle
        speeds, commands = rotor_streams(vehicle.key, self._rotors, vehicle.version)
        names = [*default_rates((*speeds, commands), 1.0)]
        if vehicle.key == "ardupilot":
            names.append("RAW_IMU")
        self._names = tuple(
            n for n in names if vehicle.version == 2 or MESSAGE_IDS[n] <= LAST_ID_OF_VERSION_1
        )
        self._own, self._asked, self._answered = {}, {}, set()
        self._read()
        self._names += tuple(self._asked.keys() - set(self._names))
        self.again()

    def again(self) -> None:
        """Request again: the vehicle has forgotten, or may have while out of contact."""
        self._began = None
        self._known = False
        self._became.clear()
        self._looking.clear()

    def tick(
        self,
        now: float,
        arriving: Mapping[str, float],
        intervals: Mapping[int, tuple[int, int]],
    ) -> bool:
        """Ask where that is due; whether all is known, so that rates may be changed.

        Args:
            now: any steady clock, s.
            arriving: message name -> Hz observed.
            intervals: message number -> us from MESSAGE_INTERVAL, and how many had come.
        """
        if self._known or self._vehicle is None:
            return self._known
        if self._began is None:
            self._began = now
            self._rounds = 0
            self._received_before = self._received(intervals)
        answers = {
            name: intervals[MESSAGE_IDS[name]][0]
            for name in self._names
            if intervals.get(MESSAGE_IDS[name], (0, 0))[1] > self._received_before
        }
        missing = [name for name in self._names if name not in answers]
        waited = now - self._began
        silent = not answers and not any(arriving.get(name) for name in self._names)
        if missing and waited < (self.SILENT_FOR if silent else self.OBSERVED_FOR):
            if self._rounds < self.ROUNDS and waited >= self._rounds * self.ROUND_EVERY:
                self._ask(missing)
            return False
        for name in self._names:
            self._settle(name, answers.get(name), arriving.get(name, 0.0))
        self._answered |= answers.keys()
        self._known = True
        self._check_later(now, intervals)
        return True

    def _check_later(self, now: float, intervals: Mapping[int, tuple[int, int]]) -> None:
        self._check_at = now + self.CHECKED_EVERY
        self._received_at_check = self._received(intervals)

    @staticmethod
    def _received(intervals: Mapping[int, tuple[int, int]]) -> int:
        """How many MESSAGE_INTERVAL have come."""
        return max((count for _, count in intervals.values()), default=0)

    def taken_over(
        self,
        now: float,
        arriving: Mapping[str, float],
        intervals: Mapping[int, tuple[int, int]],
    ) -> list[str]:
        """Streams whose interval another station has set since the last request for them.

        `own` is that interval from now on. Asks the vehicle where that is due; call it, with the
        arguments of `tick`, once all is known.
        """
        found = []
        for name in self._names:
            answer, count = intervals.get(MESSAGE_IDS[name], (0, 0))
            if count <= self._received_at_check or name not in self._answered:
                continue
            if self._is_others(name, answer):
                if name in self._asked:
                    found.append(name)
                self._take_over(name, answer, arriving.get(name, 0.0))
        if now >= self._check_at and self._vehicle is not None:
            self._check_later(now, intervals)
            for name in self._names:
                if name in self._answered:
                    self._gate.get_message_interval(self._vehicle.address, MESSAGE_IDS[name])
        return found

    def _is_others(self, name: str, answer: int) -> bool:
        asked = self._asked.get(name)
        if asked is None:  # theirs already
            return answer != self._own.get(name)
        if abs(answer - asked) <= SAME * asked:
            self._became[name] = answer
            return False
        # Autopilots round, and limit: what the first answer says is what the request became.
        became = self._became.setdefault(name, answer)
        return abs(answer - became) > SAME * abs(became)

    def looked(self, now: float, name: str, intervals: Mapping[int, tuple[int, int]]) -> bool:
        """Whether a stream that has become slow may be asked for again: first the vehicle is asked
        whether another station has set it, which the request would undo.
        """
        if name not in self._answered or self._vehicle is None:
            return True
        _, count = intervals.get(MESSAGE_IDS[name], (0, 0))
        if name not in self._looking:
            self._looking[name] = now, count
            self._gate.get_message_interval(self._vehicle.address, MESSAGE_IDS[name])
            return False
        since, before = self._looking[name]
        done = count > before or now - since >= self.SETTLED
        if done:
            del self._looking[name]
        return done

    def _take_over(self, name: str, answer: int, hertz: float) -> None:
        assert self._vehicle is not None
        own = self._own[name] = self._meaning(self._vehicle.key, answer, hertz)
        self._became.pop(name, None)
        if name not in self._asked:
            return
        rate = f"set to {1e6 / own:.1f} Hz" if own > 0 else "reset"
        text = f"{name} was {rate} by another ground station: that is restored at the end"
        if text not in self._reported:
            self._reported.add(text)
            self.events.append(text)

    def requested(self, now: float, name: str, interval: int) -> None:
        """A stream is being asked for, every `interval` us."""
        self._became.pop(name, None)
        self._check_at = min(self._check_at, now + self.SETTLED)
        self.remember({name: interval})

    def _ask(self, names: Iterable[str]) -> None:
        assert self._vehicle is not None
        gate, address = self._gate, self._vehicle.address
        ask = gate.request_message_interval if self._rounds % 2 else gate.get_message_interval
        self._rounds += 1
        for name in names:
            ask(address, MESSAGE_IDS[name])

    def _settle(self, name: str, answer: int | None, hertz: float) -> None:
        """Decide what a stream's own interval is."""
        assert self._vehicle is not None
        now = self._meaning(self._vehicle.key, answer, hertz)
        asked = self._asked.get(name)
        if asked and now > 0 and abs(now - asked) <= SAME * asked:
            return  # the rate that an earlier session, or this one, asked for: not its own
        self._own[name] = now
        self._asked.pop(name, None)

    @staticmethod
    def _meaning(autopilot: str, answer: int | None, hertz: float) -> int:
        """The interval to restore, by the vehicle's reply and the arrival rate."""
        if (answer is None or answer <= 0) and hertz > 0.0:
            # Not reported, or sent as fast as available (-1 of PX4's).
            answer = round(1e6 / hertz)
        if answer is not None and answer > 0:
            return min(max(answer, SHORTEST_INTERVAL), LONGEST_INTERVAL)
        # PX4 reports 0 for a message that it does not send, others for one that they do not have.
        if answer == OFF or (answer == 0 and autopilot == "px4"):
            return OFF
        return VEHICLE_DEFAULT

    def own(self, name: str) -> int:
        """The interval to put back, us; 0: the vehicle's default, -1: none."""
        return self._own.get(name, VEHICLE_DEFAULT)

    def left_over(self, wanted: Iterable[str]) -> list[str]:
        """Streams beside those wanted that an earlier session changed and could not put back."""
        return [name for name in self._asked if name not in set(wanted)]

    def remember(self, asked: Mapping[str, int]) -> None:
        """Keep what is about to be asked for, and what is to be put back.

        Args:
            asked: message name -> interval, us.
        """
        self._asked.update(asked)
        kept = {name: [self.own(name), interval] for name, interval in self._asked.items()}
        if kept != self._kept:
            self._kept = kept
            self._write(kept)

    def restored(self, name: str) -> None:
        """A stream has its own interval again."""
        self._asked.pop(name, None)
        self._became.pop(name, None)

    def close(self) -> None:
        """All is put back: nothing is left for the next session to do."""
        self._asked.clear()
        path = self._path
        if path is not None and self._kept is not None:
            self._kept = None
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                self.events.append(f"{path}: cannot be removed: {error.strerror}")

    # -- the file

    @property
    def _path(self) -> Path | None:
        if self._folder is None or self._vehicle is None:
            return None
        link = re.sub(r"[^A-Za-z0-9.]+", "_", self._link)[-80:]
        return (
            self._folder / f"streams_{link}_{self._vehicle.system}_{self._vehicle.component}.json"
        )

    def _write(self, kept: Mapping[str, list[int]]) -> None:
        path = self._path
        if path is None:
            return
        content = {"schema": SCHEMA, "streams": kept}
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, json.dumps(content, indent=1) + "\n", replace=True)
        except (InputError, OSError) as error:
            self.events.append(
                f"{error}: if this session is killed, the next one cannot restore the rates"
            )

    def _read(self) -> None:
        """What a killed session left; an invalid file is skipped."""
        path = self._path
        if path is None or not path.is_file():
            return
        try:
            table = json.loads(read_text(path, "the rates to restore"))
            streams = table["streams"] if table["schema"] == SCHEMA else {}
            kept = {
                name: (int(own), int(asked))
                for name, (own, asked) in streams.items()
                if name in MESSAGE_IDS and _is_interval(int(own)) and int(asked) > 0
            }
        except (InputError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
            self.events.append(f"{path} is damaged: rates that a killed session left stay")
            return
        self._own = {name: own for name, (own, _) in kept.items()}
        self._asked = {name: asked for name, (_, asked) in kept.items()}
        self._kept = path


def _is_interval(interval: int) -> bool:
    return interval in (VEHICLE_DEFAULT, OFF) or SHORTEST_INTERVAL <= interval <= LONGEST_INTERVAL
