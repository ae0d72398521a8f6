"""What an inspection finds: plain facts, fit for a table and for JSON."""

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from gcs_sysid.judgement.status import Readiness, level_of, readiness
from gcs_sysid.model.estimate import Objection
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.session.reported_layout import ReportedLayout
from gcs_sysid.signals.imu_checks import GyroAgainstAttitude, Saturated
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.vehicles import RADIO, MavlinkSystem

SCHEMA = "gcs-sysid-inspect/1"
ONBOARD = ("ulog", "dataflash", "blackbox")
"""Kinds of log that the autopilot wrote itself."""

FlightBy = Literal["autopilot", "rotors", "arming", ""]
"""What says that it flies; "" when nothing does."""
Obtainable = Literal["everything", "all but Izz", "in part", "health", "nothing"]
"""Obtainable results; "all but Izz" where yaw was hardly flown."""


@dataclass(frozen=True)
class StreamFacts:
    """One stream: in flight, where there is flight, else all of it."""

    stream: Stream
    message: str
    """Name of the message or topic that it comes from."""
    offset: int
    """Index of its first rotor."""
    samples: int
    rate: float | None
    """Hz between the gaps; None for a single sample."""
    gaps: int
    longest_gap: float
    """s; 0.0 without gaps."""
    missing_percent: float | None
    """Samples lost or never sent, by the stamps; None of others than the IMU, which come when the
    autopilot finds time."""
    repeats_percent: float
    """Samples that repeat the values of the one before under a later stamp."""


@dataclass(frozen=True)
class RotorFacts:
    """One rotor of one source."""

    low: float
    high: float
    mean: float
    """rad/s, or the autopilot's own unit of outputs."""
    zero_percent: float


@dataclass(frozen=True)
class RotorMessage:
    """All rotors in one message."""

    message: str
    kind: RotorInput
    rate: float | None
    """Hz of the slowest of its streams."""
    repeats_percent: float
    rotors: tuple[RotorFacts, ...]
    """In the autopilot's motor order; as many as the vehicle has, where its type gives that."""

    @property
    def dead(self) -> tuple[int, ...]:
        """Motors, from 1, without data: zero nearly always, or no change in flight."""
        return tuple(
            motor
            for motor, rotor in enumerate(self.rotors, 1)
            if rotor.zero_percent > 95.0 or (self.kind.motors and rotor.low == rotor.high)
        )


@dataclass(frozen=True)
class ChosenSource:
    """The source that identification uses, as the chain's own selector decides."""

    chosen: RotorMessage | None
    reasons: tuple[str, ...] = ()
    """Why not the others, and why this one where that is not plain."""
    judged: bool = False
    """Whether there was flight to judge by."""
    range: tuple[float, float] | None = None
    """Outputs without thrust and at full thrust, of commands."""
    range_from: str = ""
    assumed: str = ""
    """What is assumed of its unit, in words."""


@dataclass(frozen=True)
class AxisMotion:
    """How an axis was moved in flight, without white sensor noise and constant bias."""

    rate_rms: float
    """rad/s."""
    acceleration_rms: float
    """rad/s^2, below about 5 Hz."""


@dataclass(frozen=True)
class ClockFacts:
    """The vehicle's clock."""

    drift_ppm: float | None
    """How fast it ran against the computer that recorded; None when not known."""
    reboots: int
    wraps: int
    """Wraps of 32-bit stamps in microseconds (SERVO_OUTPUT_RAW)."""


@dataclass(frozen=True)
class Inspection:
    """Everything found. Times are s since the first record, going on over reboots."""

    source: str
    kind: Literal["tlog", "ulog", "dataflash", "blackbox", "table", "link"]
    duration: float
    vehicle: MavlinkSystem | None
    systems: tuple[MavlinkSystem, ...]
    flights: tuple[tuple[float, float], ...]
    flight_told_by: FlightBy
    streams: tuple[StreamFacts, ...]
    rotor_sources: tuple[RotorMessage, ...]
    motion: Mapping[str, AxisMotion]
    """Axis -> motion; empty without flight."""
    clock: ClockFacts
    parameters: Mapping[str, float]
    """Those that matter for identification."""
    parameter_count: int
    """How many there are."""
    rotors: int
    """How many the airframe has, by its name, by the vehicle's type or as assumed."""
    rotors_assumed: bool
    """Whether their number is unknown."""
    telemetry: Mapping[str, Any]
    """As in a result: counts, losses, messages."""
    rotor_input: ChosenSource = field(default_factory=lambda: ChosenSource(None))
    gyro: GyroAgainstAttitude | None = None
    """What the gyro reads of what the attitude turns; None where too little was flown."""
    saturated: tuple[Saturated, ...] = ()
    """Sensors that stood at a limit."""
    problems: tuple[str, ...] = ()
    """Why a link brings too little, as far as the link itself shows."""
    hover: float | None = None
    """Seconds of hover that `health` uses; None: not looked for."""
    layout: ReportedLayout | None = None
    """Where log or flight have the rotors; None: neither shows it, or not looked for."""
    explained: float | None = None
    """The smaller of the roll and pitch shares that the rotors' moments explain; None: too
    little was flown, or not looked for."""
    explained_coupled: float | None = None
    """The same with products of inertia and a CG off the center allowed for."""
    objections: tuple[Objection, ...] = ()
    """What decides, or is worth knowing, the worst first."""
    obtainable: Obtainable = "nothing"

    @property
    def in_air(self) -> float:
        """Seconds of flight."""
        return sum(end - start for start, end in self.flights)

    @property
    def is_received(self) -> bool:
        """Whether anything at all came."""
        return bool(self.systems)

    @property
    def vehicle_address(self) -> tuple[int, int] | None:
        """(sysid, compid) of the vehicle inspected."""
        return None if self.vehicle is None else self.vehicle.address

    @property
    def verdict(self) -> Readiness:
        """Whether the vehicle can be identified from this."""
        return readiness(self.objections)

    def stream(self, kind: Stream) -> StreamFacts | None:
        """The stream of a kind, the first where there are several."""
        return next((s for s in self.streams if s.stream is kind), None)

    def as_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "obtainable": self.obtainable,
            "seconds_of_hover": self.hover,
            "explained_by_rotors": self.explained,
            "reasons": [
                {"level": level_of(objection), "text": objection.reason, "advice": objection.how}
                for objection in self.objections
            ],
            "source": self.source,
            "kind": self.kind,
            "duration": self.duration,
            "vehicle": self.vehicle.as_dict() if self.vehicle else {},
            "systems": [
                {**system.as_dict(), "name": str(system), "role": role(system)}
                for system in self.systems
            ],
            "flights": [{"start": start, "end": end} for start, end in self.flights],
            "in_air": self.in_air,
            "flight_told_by": self.flight_told_by,
            "streams": [asdict(stream) for stream in self.streams],
            "clock": asdict(self.clock),
            "rotor_input": {
                "kind": self.rotor_input.chosen.kind if self.rotor_input.chosen else None,
                "message": self.rotor_input.chosen.message if self.rotor_input.chosen else None,
                "rotors": self.rotors,
                "judged": self.rotor_input.judged,
                "reasons": list(self.rotor_input.reasons),
                "range": list(self.rotor_input.range) if self.rotor_input.range else None,
                "range_from": self.rotor_input.range_from or None,
                "sources": [
                    {**asdict(source), "unit": unit(source), "dead": list(source.dead)}
                    for source in self.rotor_sources
                ],
            },
            "excitation": {axis: asdict(motion) for axis, motion in self.motion.items()},
            "parameters": dict(self.parameters),
            "parameter_count": self.parameter_count,
            "telemetry": dict(self.telemetry),
        }


def role(system: MavlinkSystem) -> str:
    """What a system is: "vehicle", "radio", "gcs", "other"; "unknown" without a heartbeat."""
    if system.address == RADIO:
        return "radio"
    if system.autopilot is None:
        return "unknown"
    if system.is_autopilot:
        return "vehicle"
    return "gcs" if "ground station" in str(system) else "other"


def unit(source: RotorMessage) -> str:
    """Unit of its rotors' values."""
    return "autopilot's output" if source.kind.motors else source.kind.unit


GROUPS = {
    "frame": r"FRAME|FRAME_(CLASS|TYPE)|SYS_AUTOSTART|CA_AIRFRAME|CA_ROTOR_COUNT|SCHED_LOOP_RATE",
    "filters": r"INS_(GYRO|ACCEL)_FILTER|IMU_(GYRO|ACCEL)_CUTOFF|IMU_GYRO_RATEMAX|IMU_INTEG_RATE",
    "motors": r"MOT_PWM_(MIN|MAX)|MOT_SPIN_(ARM|ARMED|MIN|MAX)|MOT_THST_EXPO|THR_MDL_FAC"
    r"|PWM_MAIN_(MIN|MAX)[1-8]|motorOutput\[[01]\]|(min|max)throttle|motor_poles|dshot_bidir",
    "logging": r"LOG_(BITMASK|BACKEND_TYPE|FILE_BUFSIZE|(FILE|BLK)_RATEMAX)|SDLOG_PROFILE"
    r"|SERVO_BLH_TRATE|acc_hardware|fields_disabled_mask",
    "IMU place": r"INS_POS1_[XYZ]|IMU_POS_[XYZ]",
    "simulator": r"SIH_(MASS|I[XYZ][XYZ]|T_MAX|Q_MAX|L_ROLL|L_PITCH|KDV|KDW|T_TAU)",
}
"""Group -> pattern of whole names."""

_PATTERNS = {group: re.compile(pattern) for group, pattern in GROUPS.items()}


def group_of(name: str) -> str | None:
    """The group that a parameter belongs to; None when it does not matter."""
    for group, pattern in _PATTERNS.items():
        if pattern.fullmatch(name):
            return group
    return None


def that_matter(parameters: Mapping[str, float]) -> dict[str, float]:
    """Those that matter, by group, then by name."""
    order = list(GROUPS)
    names = [(order.index(group), name) for name in parameters if (group := group_of(name))]
    return {name: parameters[name] for _, name in sorted(names)}
