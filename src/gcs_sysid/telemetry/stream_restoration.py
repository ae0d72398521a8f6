"""What each stream's interval was before the first request, so that it can be put back.

The vehicle is asked for its intervals before anything is changed. Where it does not answer, the
rates that arrived until then count. While others run, the vehicle is asked again now and then: an
interval that is no longer what this session's request made of it was set by another station, and is
what will be put back. What was found is kept in a small file for each vehicle and
link while the session lasts: a session that is killed with everything else leaves it behind, and
the next one puts back what it finds there. There is no clock in here: the caller says what time
it is.
"""

import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from gcs_sysid.errors import InputError
from gcs_sysid.files import read_text, write_whole
from gcs_sysid.telemetry.messages import MESSAGE_IDS
from gcs_sysid.telemetry.outgoing import LONGEST_INTERVAL, SHORTEST_INTERVAL
from gcs_sysid.telemetry.transceiver import Requests
from gcs_sysid.telemetry.vehicles import MavlinkSystem
from gcs_sysid.telemetry.wanted_streams import LAST_ID_OF_VERSION_1, default_rates, rotor_streams

VEHICLE_DEFAULT, OFF = 0, -1
"""Intervals of SET_MESSAGE_INTERVAL that are none."""
SAME = 0.02
"""Share by which an interval may differ and still be the one asked for: autopilots round."""
SCHEMA = "gcs-sysid-streams/1"


class StreamRestoration:
    """Finds out each stream's own interval, and keeps it.

    Args:
        gate: sends.
        rotors: how many the airframe has.
        folder: for the file; None: nothing is kept beyond the session.
        link: the link's URL: PX4 has rates for each link.
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

    def __init__(
        self, gate: Requests, rotors: int, folder: Path | None = None, link: str = ""
    ) -> None:
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
        self._events: list[str] = []
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
        self._check_at, self._received_at_check = (
            now + self.CHECKED_EVERY,
            self._received(intervals),
        )
        return True

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
            self._check_at, self._received_at_check = (
                now + self.CHECKED_EVERY,
                self._received(intervals),
            )
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
            self._events.append(text)

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
        if answer is not None and answer > 0:
            return min(max(answer, SHORTEST_INTERVAL), LONGEST_INTERVAL)
        if hertz > 0.0:
            # Not reported, or sent as fast as available (-1 of PX4's).
            return min(max(round(1e6 / hertz), SHORTEST_INTERVAL), LONGEST_INTERVAL)
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
                self._events.append(f"{path}: cannot be removed: {error.strerror}")

    def take_events(self) -> list[str]:
        """Events since this was last asked, one line each."""
        events, self._events = self._events, []
        return events

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
            self._events.append(
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
            self._events.append(f"{path} is damaged: rates that a killed session left stay")
            return
        self._own = {name: own for name, (own, _) in kept.items()}
        self._asked = {name: asked for name, (_, asked) in kept.items()}
        self._kept = path


def _is_interval(interval: int) -> bool:
    return interval in (VEHICLE_DEFAULT, OFF) or SHORTEST_INTERVAL <= interval <= LONGEST_INTERVAL
