"""Which rotor each value of a stream belongs to: decided here alone, by what outputs are for.

An autopilot sends and logs most rotor streams by output. Which motor an output drives is what the
vehicle's parameters say (SERVOn_FUNCTION; PWM_MAIN_FUNCn, UAVCAN_EC_FUNCn and their like); what
drives none is no rotor's. Readers and links leave streams as they are sent, and all that use them
(the chain, health, inspection) have them sorted here.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from gcs_sysid.signals.columns import Track
from gcs_sysid.signals.records import ROTOR_STREAMS, Stream
from gcs_sysid.signals.rotor_readings import Rotors, apart, correlation

_FUNCTION = {
    "ardupilot": re.compile(r"(SERVO)(\d+)_FUNCTION"),
    "px4": re.compile(r"(\w+)_FUNC(\d+)"),
}
_MOTORS = {
    "ardupilot": (*range(33, 41), *range(82, 86), *range(160, 180)),
    "px4": tuple(range(101, 113)),
}
"""Autopilot -> functions of motor 1 and those after it."""
_BY_OUTPUT = {
    "ardupilot": re.compile(r"SERVO_OUTPUT_RAW|RCOU|ESC|ESC_TELEMETRY(_\d+_TO_\d+)?"),
    "px4": re.compile(r"ACTUATOR_OUTPUT_STATUS|(SERVO_OUTPUT_RAW|actuator_outputs)(_\d+)?"),
}
"""Autopilot -> sources whose values are those of outputs."""
AS_SENT = "esc_status as sent"
"""ESCs of a log of PX4 that do not report which motors they drive."""
_EITHER_ORDER = ("ESC_STATUS", AS_SENT)
"""Of PX4: by output, and since late 2025 by motor; neither says which."""
MIXER = "mixer "
"""Begins the names of what a blackbox log shows of its mixer: axis and motor follow."""
_BY = " by "
"""In the name of a stream that comes once in each order that it may have."""
_OF_VERSION_1, _OF_PORT = 8, 16
"""Outputs that SERVO_OUTPUT_RAW has in MAVLink 1, and in MAVLink 2."""
_ALIKE = 0.5
"""Correlation above which two streams are of the same motors."""


def is_function(name: str) -> bool:
    """Whether a parameter says what an output is for."""
    return any(pattern.fullmatch(name) for pattern in _FUNCTION.values())


def is_in_several_orders(name: str) -> bool:
    """Whether a stream of this name comes once in each order that it may have."""
    return _BY in name


def in_any_order(name: str) -> str:
    """The source of a stream, without the order in which it is taken."""
    return name.partition(_BY)[0]


def motor_of(autopilot: str, function: float) -> int:
    """The motor, from 0, that an output of a function drives; -1: none."""
    motors = _MOTORS.get(autopilot, ())
    return motors.index(int(function)) if function in motors else -1


def motor_outputs(autopilot: str, parameters: Mapping[str, float]) -> dict[str, dict[int, int]]:
    """Driver ("SERVO", "PWM_MAIN", ...) -> motor -> its output, both from 0.

    Of "px4" and "ardupilot"; of others nothing is known.
    """
    found: dict[str, dict[int, int]] = {}
    if autopilot not in _FUNCTION:
        return found
    for name in sorted(parameters, reverse=True):  # of two for one motor, the first
        match = _FUNCTION[autopilot].fullmatch(name)
        motor = motor_of(autopilot, parameters[name]) if match else -1
        if match and motor >= 0 and _is_in_use(match[1], parameters):
            outputs = found.setdefault(match[1], {})
            outputs[motor] = min(int(match[2]) - 1, outputs.get(motor, 1 << 16))
    return found


def _is_in_use(driver: str, parameters: Mapping[str, float]) -> bool:
    """Whether a driver of PX4 may drive anything, as far as the parameters say."""
    if parameters.get("SYS_HITL", 0.0) > 0.0:
        return driver == "HIL_ACT"
    if driver == "HIL_ACT":
        return False
    return driver != "UAVCAN_EC" or parameters.get("UAVCAN_ENABLE", 3.0) >= 3.0


@dataclass(frozen=True)
class MotorOrder:
    """Which motor each output of one vehicle drives.

    Attributes:
        autopilot: "px4", "ardupilot"; any other's streams are by motor.
        orders: name of the order -> output of each motor; several where it is not known which
            driver turns the motors. Empty: nothing is known, outputs are taken for motors.
        split: whether no driver has all motors, so that outputs in one stream are not all.
        others: drivers that have outputs of something else; those in a stream may be theirs.
        named: how many motors have an output, where those are not all that the airframe has.
    """

    autopilot: str = ""
    orders: tuple[tuple[str, tuple[int, ...]], ...] = ()
    split: bool = False
    others: tuple[str, ...] = ()
    named: int = field(default=0, compare=False)

    @classmethod
    def of(
        cls, autopilot: str, parameters: Mapping[str, float], rotors: int | None = None
    ) -> "MotorOrder":
        """By the parameters so far.

        `rotors` is how many the airframe has; None: as many as there are outputs for.
        """
        drivers = motor_outputs(autopilot, parameters)
        known = {motor for outputs in drivers.values() for motor in outputs}
        count = rotors or max(known, default=-1) + 1
        if not count or not known.issuperset(range(count)):
            return cls(autopilot, named=len(known))  # not all have come, or there are fewer
        whole = {
            tuple(outputs[motor] for motor in range(count)): driver
            for driver, outputs in sorted(drivers.items(), reverse=True)
            if outputs.keys() >= set(range(count))
        }
        named = sorted((driver, outputs) for outputs, driver in whole.items())
        used = {
            match[1]
            for name, value in parameters.items()
            if value and (match := _FUNCTION[autopilot].fullmatch(name))
        }
        others = {driver for driver in used - drivers.keys() if _is_in_use(driver, parameters)}
        return cls(autopilot, tuple(named), not named, tuple(sorted(others)) if named else ())

    @property
    def outputs(self) -> tuple[int, ...]:
        """That drive motors, as far as they are known."""
        return tuple(sorted({output for _, outputs in self.orders for output in outputs}))

    def readings(self, source: str) -> list[tuple[str, tuple[int, ...] | None]]:
        """Names that a source's streams get, and the output of each motor; None: as they are."""
        either = self.autopilot == "px4" and source in _EITHER_ORDER
        if not (either or self.is_of_outputs(source)):
            return [(source, None)]
        if self.split:
            return [(source, None if either else ())]
        orders: dict[tuple[int, ...], str] = {}
        if either and self.orders:
            orders[tuple(range(len(self.orders[0][1])))] = "motor"
        for driver, outputs in self.orders:
            orders.setdefault(outputs, "output" if len(self.orders) == 1 else driver)
        if not orders:
            return [(source, None)]
        if len(orders) == 1:
            return [(source, outputs) for outputs in orders]
        return [(f"{source}{_BY}{name}", outputs) for outputs, name in orders.items()]

    def tracks(self, tracks: Iterable[Track]) -> Iterator[Track]:
        """Tracks with rotor streams by motor; one that has none of its outputs has no columns.

        A stream whose order is open comes once in each, under different names.
        """
        for track in tracks:
            if track.stream not in ROTOR_STREAMS:
                yield track
                continue
            if self.others and track.source == "SERVO_OUTPUT_RAW" and track.offset:
                # PX4 sends each driver's outputs from a port of their own.
                port, offset = divmod(track.offset, _OF_PORT)
                track = replace(track, source=f"{track.source}_{port}", offset=offset)
            for name, outputs in self.readings(track.source):
                if outputs is None:
                    yield track
                else:
                    yield from _by_motor(replace(track, source=name), outputs)

    def is_of_outputs(self, source: str) -> bool:
        """Whether a source has values by output, whatever drives that."""
        by_output = _BY_OUTPUT.get(self.autopilot)
        return by_output is not None and by_output.fullmatch(source) is not None

    def doubt(self, source: str) -> str:
        """What else a source may have than outputs of motors, in words; empty: nothing else."""
        if not (self.others and self.is_of_outputs(source)):
            return ""
        motors = " or ".join(driver for driver, _ in self.orders)
        return f"may have outputs of {' or '.join(self.others)}; the motors' are {motors}'s"

    def gap_in(self, source: str, first_missing: int) -> str:
        """Why a source lacks a motor, where its output explains it; begins with a colon."""
        if self.split and any(outputs == () for _, outputs in self.readings(source)):
            return ": no driver has all motors"
        outputs = next((o for _, o in self.readings(source) if o), ())
        if first_missing >= len(outputs):
            return ""
        output = outputs[first_missing]
        why = f": motor {first_missing + 1} is on output {output + 1}"
        if source == "SERVO_OUTPUT_RAW" and output >= _OF_VERSION_1:
            why += (
                f", and MAVLink 1 has {_OF_VERSION_1}: set the port to MAVLink 2 "
                "(SERIALn_PROTOCOL, MAV_PROTO_VER)"
            )
        return why

    def unknown(self, source: str) -> str:
        """That nothing says which of its outputs are motors'; begins with a colon, or empty."""
        if self.orders or self.split or not self.is_of_outputs(source):
            return ""
        names = "SERVOn_FUNCTION" if self.autopilot == "ardupilot" else "PWM_MAIN_FUNCn"
        if self.named:
            return f": {names} of the record names {self.named} motors, the airframe has more"
        return f": its first outputs are taken for the motors', as the record lacks {names}"


def _by_motor(track: Track, outputs: Sequence[int]) -> Iterator[Track]:
    """The columns of motors, those of neighboring ones together."""
    last = track.offset + track.values.shape[1]
    there = [motor for motor, output in enumerate(outputs) if track.offset <= output < last]
    cuts = [0, *(i for i, (a, b) in enumerate(pairwise(there), 1) if b != a + 1), len(there)]
    for start, stop in pairwise(cuts):
        run = there[start:stop]
        columns = [outputs[motor] - track.offset for motor in run]
        whole = columns == list(range(track.values.shape[1]))
        values = track.values if whole else np.ascontiguousarray(track.values[:, columns])
        # What has no motor stands behind them, in no motor's place.
        yield replace(track, offset=run[0] if run else len(outputs), values=values)


def out_of_order(sources: Mapping[str, tuple[Stream, Rotors]], order: MotorOrder) -> dict[str, str]:
    """Of streams that came in several orders, those that are not used, and why.

    A rotor follows its own command: what sets it apart from the others is that of its command.
    Commands that no rotor follows may be another driver's, which moves a gimbal by them.

    Args:
        sources: name -> whether speeds or commands, and all rotors'.
        order: by which they were sorted.
    """
    alike: dict[str, list[str]] = {}
    for name in sources:
        source, by, _ = name.partition(_BY)
        if by:
            alike.setdefault(source, []).append(name)
    sure = [
        rotors
        for name, (stream, rotors) in sources.items()
        if stream is Stream.ROTOR_COMMAND and _BY not in name
    ]
    refused: dict[str, str] = {}
    for source, names in alike.items():
        scores = {
            name: max((_likeness(sources[name][1], asked) for asked in sure), default=0.0)
            for name in names
        }
        first, *others = sorted(names, key=lambda name: -scores[name])
        # More alike than not, and twice as alike as in any other order.
        if scores[first] > max([_ALIKE, *(2.0 * scores[name] for name in others)]):
            refused |= dict.fromkeys(others, f"does not follow the commands as {first} does")
        else:
            orders = " or ".join(name.removeprefix(source + _BY) for name in names)
            refused |= dict.fromkeys(
                names, f"may be in the order of {orders}, and no commands show which"
            )
    return refused | _of_another_driver(sources, order)


def _of_another_driver(
    sources: Mapping[str, tuple[Stream, Rotors]], order: MotorOrder
) -> dict[str, str]:
    """Of streams of outputs, those that are another driver's or may be, and why."""
    open_ = {
        name: rotors
        for name, (stream, rotors) in sources.items()
        if order.others and stream is Stream.ROTOR_COMMAND and order.is_of_outputs(name)
    }
    of_motors = [rotors for name, (_, rotors) in sources.items() if name not in open_]
    if of_motors:
        return {
            name: f"has outputs that no motor follows: those of {' or '.join(order.others)}"
            for name, asked in open_.items()
            if all(_likeness(asked, motors) < _ALIKE for motors in of_motors)
        }
    moving = [rotors for rotors in open_.values() if apart(rotors[0][0], rotors).any()]
    if all(_likeness(moving[0], rotors) >= _ALIKE for rotors in moving[1:]):
        return {}
    return {name: f"{order.doubt(name)}, and no speeds show whose it has" for name in open_}


def _likeness(speeds: Rotors, commands: Rotors) -> float:
    """Correlation of what sets each rotor apart from the mean of all."""
    t = speeds[0][0]
    return correlation(apart(t, speeds), apart(t, commands))
