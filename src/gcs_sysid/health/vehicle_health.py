"""The health of a vehicle, from the hover of one flight, as plain facts."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from gcs_sysid.health.balance import Center
from gcs_sysid.health.barometer import ThrustPressure
from gcs_sysid.health.command_curve import Curve
from gcs_sysid.health.drag import Drag
from gcs_sysid.health.rotor_condition import Condition, Load, Weakened
from gcs_sysid.judgement.status import ROTORS
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.estimate import Estimate, Objection, Quantity
from gcs_sysid.model.rotor_input import RotorInput

if TYPE_CHECKING:  # reports, which know no logs, read health too
    from gcs_sysid.session.reported_layout import ReportedLayout


@dataclass(frozen=True)
class HealthOptions:
    """What the user knows.

    Attributes:
        airframe: with a scale or without; None: taken from the log's parameters.
        arm: m, that scales the airframe from the log; None: its own.
        mass: kg, where the airframe is from the log.
        battery_mass: kg, for advice.
        baseline: an earlier flight's loads, and its CG.
        unchanged: whether nothing was moved or loaded since then.
    """

    airframe: Airframe | None = None
    arm: float | None = None
    mass: float | None = None
    battery_mass: float | None = None
    baseline: "Baseline | None" = None
    unchanged: bool = False


@dataclass(frozen=True)
class Baseline:
    """A flight before, to compare rotors with.

    Attributes:
        source: its log.
        load: of its rotors.
        cg: x and y, m.
        asked: whether the user named it: then it must fit, else it may be left out.
    """

    source: str
    load: Load
    cg: tuple[float, float]
    asked: bool = True


@dataclass(frozen=True)
class Finding:
    """Something of the vehicle that is worth a look.

    Attributes:
        at: what to look at: a rotor, the CG.
        what: is seen there.
        do: about it, a sentence that says all.
        spoils: whether loads, commands and what follows from them mean little before it is done.
    """

    at: str
    what: str
    do: str
    spoils: bool = False


@dataclass(frozen=True)
class HoverCommand:
    """What the autopilot commands in hover: its thrust by any curve follows.

    Attributes:
        mean: of commands, for a thrust of the weight.
        square: mean of their squares, likewise.
        share: standard deviation of that thrust, relative.
        throttle: the autopilot's own, before curve, voltage and air; None: not logged.
        voltage: share of the full voltage that it made up for; None: not logged.
    """

    mean: float
    square: float
    share: float
    throttle: float | None = None
    voltage: float | None = None

    def thrust(self, c: float, voltage: float = 1.0) -> float:
        """Over full thrust, by the curve c of commands times a share of the full voltage."""
        return (1.0 - c) * voltage * self.mean + c * voltage**2 * self.square


@dataclass(frozen=True)
class MotorCurrent:
    """Current of the mean motor, straight over the thrust commanded.

    Attributes:
        slope: A for full thrust.
        mean: A, at the mean thrust.
        thrust: that mean, over full thrust.
    """

    slope: Quantity
    mean: Quantity
    thrust: float


@dataclass(frozen=True)
class RotorHealth:
    """One rotor in hover.

    Attributes:
        thrust_share: of all thrust.
        efficiency: thrust for its speed, or for its command, over that of the mean rotor. Against
            the baseline where there is one; else nothing but what is assumed.
        motor_gain: speed squared for its command over that of the mean rotor; None without both.
        headroom: of its command in hover to full.
        saturated: share of the flight that it was at full command.
        vibration: amplitude of specific force at its frequency; None where not seen.
    """

    thrust_share: Quantity
    efficiency: Quantity
    motor_gain: Quantity | None
    headroom: Quantity | None
    saturated: float | None
    vibration: Quantity | None

    def as_json(self) -> dict[str, Any]:
        """As health files write it."""
        entries = vars(self).items()
        return {n: v.as_json() if isinstance(v, Quantity) else v for n, v in entries}


@dataclass(frozen=True)
class Health:
    """What hover shows of a vehicle; all but the first four are empty where nothing hovers.

    Attributes:
        source: the log.
        vehicle: as in a result.
        autopilot: "px4", "ardupilot" or another key; "" when not known.
        objections: why there is no answer; empty when there is one.
        airframe: used for the balances.
        layout: as of `GuessedAirframe`.
        rotor_input: that loads were taken from.
        seconds: of hover.
        cg: x and y from the geometric center, m.
        cg_of_hover: the same by hover, where `cg` is that of an analysis beside it, which knows it
            better; else None.
        misread: rotor stream -> why it is not read.
        doubts: objections to the IMU's sensors and to what was given, as an analysis raises them.
        by_wind: x and y of what wind may have moved the CG by, m; it is in `cg`.
        center: of thrust, and how drag moves it.
        rotors: in motor order.
        yaw_imbalance: share of the rotors' load that turns counter-clockwise less the other's.
        hover_throttle: mean command in hover, 0 to 1; None without commands.
        hover_thrust: thrust in hover over full thrust; None without commands.
        hover_command: of which that is; None without commands.
        hover_frequency: Hz, of the mean rotor in hover; None without measured speeds.
        turning: as of `Evidence`.
        by_voltage: power of the battery's voltage that a command is multiplied by: 1 where rotors
            slow down with the battery, 0 where the ESC makes up for it; None: not logged.
        barometer: what thrust does to it; None where that is not seen.
        motor_current: None where ESCs do not report it, or hardly any thrust but the weight was
            commanded.
        thrust_to_weight: full thrust over weight; None without commands.
        scale: name of the coefficient (k_T or T_max) and its value; None without a mass.
        mass: kg, where k_T or T_max was given.
        curve: of thrust over commands; None without commands.
        drift: change of the thrust for a command (or a speed) in a minute, relative.
        idle: least output at which all rotors were measured turning; None where not seen.
        arm_std: m, of an arm that is assumed; 0.0 where the size of the airframe is known.
        drag: over mass, by legs through the air; None where there are none.
        battery: V, highest, lowest and median; None where not logged.
        battery_mass: kg, of the battery, which may be moved; None: not given.
        motor_lag: s that rotors or thrust follow the commands by; None without commands.
        condition: of the rotors against a baseline; None without one.
        apart: why it was not compared with the first of several logs; empty where it was.
        weakened: a rotor that became weak in this flight; None where none did, or the hover is
            too short to judge.
        watched: stretches of hover that were compared with the start of the flight for that.
        explained: as of `GuessedAirframe`.
        explained_coupled: the same.
        load: for later flights.
        assumptions: behind the intervals, as text.
        unit: that of them on the unit of rotor speeds, or of the commands used.
        findings: what to look at, the most important first; empty where all is well.
        advice: what to do, of the findings and to know more.
        parameters: of the autopilot as they were in the log.
    """

    source: str
    vehicle: Mapping[str, Any] = field(default_factory=dict)
    autopilot: str = ""
    objections: tuple[Objection, ...] = ()
    airframe: Airframe | None = None
    layout: "ReportedLayout | None" = None
    rotor_input: RotorInput | None = None
    rotor_source: str = ""
    seconds: float = 0.0
    cg: tuple[Quantity, Quantity] | None = None
    cg_of_hover: tuple[Quantity, Quantity] | None = None
    misread: Mapping[str, str] = field(default_factory=dict)
    doubts: tuple[Objection, ...] = ()
    by_wind: tuple[float, float] | None = None
    center: Center | None = None
    rotors: tuple[RotorHealth, ...] = ()
    yaw_imbalance: Quantity | None = None
    hover_throttle: Quantity | None = None
    hover_thrust: Quantity | None = None
    hover_command: HoverCommand | None = None
    hover_frequency: Quantity | None = None
    turning: float | None = None
    by_voltage: Quantity | None = None
    barometer: ThrustPressure | None = None
    motor_current: MotorCurrent | None = None
    thrust_to_weight: Quantity | None = None
    scale: tuple[str, Quantity] | None = None
    mass: Quantity | None = None
    curve: Curve | None = None
    drift: Estimate | None = None
    motor_lag: float | None = None
    condition: Condition | None = None
    apart: str = ""
    weakened: Weakened | None = None
    watched: int = 0
    explained: float | None = None
    explained_coupled: float | None = None
    load: Load | None = None
    idle: float | None = None
    arm_std: float = 0.0
    drag: Drag | None = None
    battery: tuple[float, float, float] | None = None
    battery_mass: float | None = None
    assumptions: tuple[str, ...] = ()
    unit: str = ""
    findings: tuple[Finding, ...] = ()
    advice: tuple[str, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def known_mass(self) -> float | None:
        """Kg, as given or by the scale given."""
        if self.airframe is not None and self.airframe.mass is not None:
            return self.airframe.mass
        return None if self.mass is None else self.mass.value

    @property
    def arm_known(self) -> bool:
        """Whether the size of the airframe is."""
        return self.arm_std == 0.0

    @property
    def through_motors(self) -> bool:
        """Whether loads are those of commands."""
        return self.rotor_input is not None and self.rotor_input.motors

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why there is no answer, in words."""
        return tuple(objection.words for objection in self.objections)

    @property
    def contradicted(self) -> bool:
        """Whether the motion contradicts the airframe: then nothing that depends on its motor order
        is given, and `reasons` say so even where an analysis has its own.
        """
        return any(objection.by == ROTORS for objection in self.objections)

    @property
    def available(self) -> bool:
        """Whether anything hovered."""
        return self.cg is not None

    @property
    def reported(self) -> bool:
        """Whether it belongs beside an analysis: something hovered, or the motion contradicts."""
        return self.available or self.contradicted


def against_first(given: HealthOptions, health: Health) -> HealthOptions:
    """What is given for the flights after one: without a baseline, the first that hovers is it."""
    first = as_baseline(health)
    if given.baseline is not None or first is None:
        return given
    return replace(given, baseline=replace(first, asked=False))


def as_baseline(health: Health) -> Baseline | None:
    """A flight as baseline of later ones; None where nothing hovered."""
    if health.load is None or health.cg is None:
        return None
    x, y = (place.value for place in health.cg)
    assert x is not None
    assert y is not None
    return Baseline(health.source, health.load, (x, y))
