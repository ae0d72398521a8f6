"""What the numbers of a rotor stream mean: units, ranges, and the gyro's own filter.

Commands come in the unit of whatever drives the motors. What maps them to 0..1 is taken from the
airframe file, else from the autopilot's parameters, else from its convention. Which of them, is
part of the result.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.model.airframe import Airframe, CommandRange
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.signals.motor_order import MotorOrder, motor_outputs

Parameters = Mapping[str, float]
"""The autopilot's parameters by name, as far as they are known."""

PARAMETER_NAMES = ("MOT_PWM_", "MOT_SPIN_M", "PWM_M", "PWM_AUX_M", "UAVCAN_E", "SYS_HITL",
                   "PWM_MAIN_TIM", "PWM_AUX_TIM", "DSHOT_", "SERVO_BLH_3DMASK", "CA_R_REV",
                   "SIM_", "SIH_MASS", "SYS_AUTOSTART", "HIL_ACT_M", "INS_GYRO_FILTER",
                   "motorOutput", "minthrottle", "maxthrottle", "dshot_bidir", "features",
                   "motor_pwm_protocol", "motor_poles", "RCMAP_THROTTLE", "MOT_TCRV_",
                   "THR_MIN", "IMU_GYRO_CUTOFF", "SERVO_BLH_POLES", "MOT_POLE_COUNT",
                   "SERVO_FTW_", "KDE_NPOLE", "CAN_D1_", "CAN_D2_",
                   *(f"RC{n}_M" for n in range(1, 9)))  # fmt: skip
"""How the names of the parameters that matter here begin, beside functions of outputs."""

_USUAL = (800.0, 2200.0)
"""Pulses of servo outputs lie between, in us."""
_LEAST_PULSE = 600.0
"""us, a pulse that there may be."""
_DSHOT = (48.0, 2047.0)
"""Outputs of digital drivers that turn a motor; those of PX4 are what is above the first."""
_DSHOT_PROTOCOLS, _DSHOT_TYPES = range(5, 9), range(4, 8)
"""Values of Betaflight's motor_pwm_protocol, and of ArduPilot's MOT_PWM_TYPE."""
MOTOR_POLES = 14.0
"""The default of every firmware."""
DEFINED_SPEEDS = ("eRPM", "omegaUnfiltered")
"""Speeds of blackbox logs, whose unit the firmware defines; of others a sender may be wrong."""
_AS_SENT = (
    "rotor speeds are taken as sent: the IMU shows no lines to check their scale by, and k_T "
    "is in proportion to its inverse square"
)
_NO_MOTOR_OUTPUT = " assumed: the log has no motorOutput"
LARGEST_ROTOR = 0.0098
"""k_T, kg/m^3, over the fourth power of the distance between neighbors, at most: C_T rho D^4 /
(4 pi^2) for a thrust coefficient of 0.25, as of ducted ones with many blades (the CineRat), and a
diameter of 1.06 times that distance."""
RADIANS = 30.0 / math.pi
"""Scale of speeds that were rad/s in a field of rpm."""
_BEYOND = 3.0
"""Times that thrust, from which speeds are not rpm: half of them give 4 times what they should."""
_REVERSIBLE = 1 << 12
"""Bit of Betaflight's features: motors turn either way."""
_STOPPED = -0.05
"""Commands below are none; curves between samples do not reach so far."""
ARDUPILOT_GYRO_FILTER = 20.0
"""Hz, default of INS_GYRO_FILTER for multirotors."""
PX4_LOOP_FILTER = 40.0
"""Hz, default of IMU_GYRO_CUTOFF."""


@dataclass(frozen=True)
class Range:
    """Outputs at which a motor begins to thrust (low) and thrusts in full (high)."""

    low: float
    high: float
    origin: str
    """Where it comes from, in words."""
    assumed: bool = False
    """Whether the log lacks what would define it."""


def command_range(
    source: str,
    given: CommandRange,
    autopilot: str,
    parameters: Parameters,
    seen: tuple[float, float],
) -> Range | str:
    """The range of a source of commands, or why it has none.

    Args:
        source: as in `Record`.
        given: by the airframe file.
        autopilot: "px4" or "ardupilot".
        parameters: known so far.
        seen: least output above zero, and the largest.
    """
    least, largest = seen
    if source == "actuator_motors":  # PX4's own commands, before any unit
        return Range(0.0, 1.0, "actuator_motors is 0..1")
    # What stays below 1 is normalized already, as by the mapping of a table.
    if given.given and not largest <= 1.0 < given.max:
        return Range(given.min, given.max, "the airframe file")
    if largest <= 1.0:
        return Range(0.0, 1.0, "outputs up to 1")
    if turns_either_way(parameters):
        return "is of 3D mode, in which outputs turn motors either way"
    if autopilot == "ardupilot":
        return _of_ardupilot(parameters)
    found = _of_blackbox(parameters) if source == "motor" else _of_px4(parameters)
    if found is not None and found.low >= _USUAL[0] > least:
        found = None  # what is less than any pulse is none
    if found is not None and (source == "motor" or largest <= 1.05 * found.high):
        return found
    if _USUAL[0] <= least <= largest <= _USUAL[1]:
        simulated = is_simulated(parameters) or parameters.get("SYS_HITL", 0.0) > 0.0
        if autopilot == "px4" and simulated:  # which have no parameters of a range
            return replace(_CONVENTION, origin="pulses of PX4's simulators", assumed=False)
        return _CONVENTION
    return (
        "has an unknown unit: give [command] min and max in the airframe file, the outputs "
        "without thrust and at full thrust"
    )


def seen_of(outputs: Sequence[Array]) -> tuple[float, float]:
    """Least output above zero, and the largest, of (n,) of each rotor: at 0 no driver works."""
    largest = max(float(values.max()) for values in outputs)
    least = min(float(values.min(initial=largest, where=values > 0.0)) for values in outputs)
    return least, largest


def is_simulated(parameters: Parameters) -> bool:
    """Whether it is a simulator, by parameters that only simulators have.

    Where PX4's firmware can simulate its vehicle, it answers for SIH_MASS in real flight as well.
    """
    if any(name.startswith("SIM_") for name in parameters):
        return True
    if "SIH_MASS" not in parameters:
        return False
    # SYS_AUTOSTART of vehicles that PX4 simulates on a computer.
    low, high = 10_000.0, 20_000.0
    # SYS_HITL: PX4 simulates its own vehicle.
    on_board = parameters.get("SYS_HITL") == 2.0
    return on_board or low <= parameters.get("SYS_AUTOSTART", 0.0) < high


def turns_either_way(parameters: Parameters) -> bool:
    """Whether half of the outputs' range turns motors backward: speeds do not show which."""
    masks = ("DSHOT_3D_ENABLE", "SERVO_BLH_3DMASK", "CA_R_REV")
    blackbox = int(parameters.get("features", 0.0)) & _REVERSIBLE
    return bool(blackbox) or any(parameters.get(name, 0.0) > 0.0 for name in masks)


UNSIGNED = "shows no direction, and in 3D mode motors turn either way"
"""Why speeds are not used where motors turn either way."""


_CONVENTION = Range(1000.0, 2000.0, "pulses of 1000 to 2000 us assumed by convention", assumed=True)


def _of_ardupilot(parameters: Parameters) -> Range:
    pulses = _pulses_of_ardupilot(parameters)
    start, full = parameters.get("MOT_SPIN_MIN", 0.15), parameters.get("MOT_SPIN_MAX", 0.95)
    spin, assumed = "MOT_SPIN_*", pulses.assumed
    if "MOT_SPIN_MIN" not in parameters and parameters.get("MOT_TCRV_ENABLE") == 1.0:
        # Copter up to 3.2: THR_MIN in thousandths, the curve's end in percent.
        start = 1e-3 * parameters.get("THR_MIN", 130.0)
        full = 1e-2 * parameters.get("MOT_TCRV_MAXPCT", 93.0)
        spin = "THR_MIN, MOT_TCRV_MAXPCT"
    elif (
        not {"MOT_SPIN_MIN", "MOT_SPIN_MAX"} <= parameters.keys() or not 0.0 <= start < full <= 1.0
    ):
        start, full = 0.15, 0.95
        spin, assumed = "MOT_SPIN_MIN 0.15, MOT_SPIN_MAX 0.95 assumed", True
    low, span = pulses.low, pulses.high - pulses.low
    origin = f"{pulses.origin} and {spin}"
    return Range(low + start * span, low + full * span, origin, assumed)


def _pulses_of_ardupilot(parameters: Parameters) -> Range:
    """Least and largest pulse in us.

    Zero, as of Copter up to 3.3, which has no MOT_PWM_*, is the range of the throttle's channel;
    there that is channel 3, whatever RCMAP_THROTTLE says.
    """
    low, high = parameters.get("MOT_PWM_MIN", 0.0), parameters.get("MOT_PWM_MAX", 0.0)
    if 0.0 < low < high:
        return Range(low, high, "MOT_PWM_*")
    if low > 0.0:  # its other end is lost
        return _CONVENTION
    channel = int(parameters.get("RCMAP_THROTTLE", 3.0)) if "MOT_PWM_MIN" in parameters else 3
    low, high = (parameters.get(f"RC{channel}_{end}", 0.0) for end in ("MIN", "MAX"))
    if 0.0 < low < high:
        return Range(low, high, f"RC{channel}_MIN, RC{channel}_MAX")
    return _CONVENTION


def _of_blackbox(parameters: Parameters) -> Range | None:
    """Of Betaflight and its kin, where the header of their log gives one."""
    high = parameters.get("motorOutput[1]")
    digital = (
        parameters.get("dshot_bidir") == 1.0
        or parameters.get("motor_pwm_protocol") in _DSHOT_PROTOCOLS
    )
    # Firmware that knows DShot writes motorOutput, from which it counts; older has pulses alone.
    lost = high is None and bool(parameters.keys() & {"dshot_bidir", "motor_pwm_protocol"})
    if high == _DSHOT[1] or (lost and digital):
        return Range(*_DSHOT, "DShot is 48..2047" + lost * _NO_MOTOR_OUTPUT, lost)
    high = parameters.get("maxthrottle", 0.0) if high is None else high
    low = parameters.get("minthrottle", parameters.get("motorOutput[0]", 0.0))
    if 0.0 < low < high:
        origin = "minthrottle and maxthrottle" + lost * _NO_MOTOR_OUTPUT
        return Range(low, high, origin, lost)
    return None


def are_digital(source: str, parameters: Parameters, values: Array) -> bool:
    """Whether outputs are those of DShot or CAN, and not pulses, of which 1000 us stop a motor.

    By parameters, or where (n, rotors) on the grid stay or turn back at what no pulse is: others
    only pass there from nothing to the first pulse.
    """
    known = _of_blackbox(parameters) if source == "motor" else _of_px4(parameters)
    if known is not None and known.low < _LEAST_PULSE:
        return True
    steps, there = np.diff(values, axis=0), values[1:-1]
    with np.errstate(invalid="ignore"):
        turns = (steps[1:] * steps[:-1] <= 0.0) & (there > _DSHOT[0]) & (there < _LEAST_PULSE)
    return bool(turns.any())


def starts_of(source: str, values: Array, *, digital: bool) -> Array:
    """Up to which output a motor stands, for (n, rotors): of pulses 1000 us, of most others 0."""
    if digital:  # PX4 counts from the first that turns a motor
        return np.full_like(values, _DSHOT[0] if source == "motor" else 0.0)
    return np.where((values >= _LEAST_PULSE) & (values <= 2400.0), 1000.0, 0.0)


class UnitDoubt(NamedTuple):
    """Of the unit of a rotor stream, in words; empty where it is known.

    Attributes:
        assumed: what the log does not define; nothing in proportion to it is known.
        as_sent: that nothing checks a unit that the source defines.
    """

    assumed: str = ""
    as_sent: str = ""


def unit_doubt(
    source: str,
    range_: Range | None,
    parameters: Parameters,
    airframe: Airframe,
    *,
    seen: bool = False,
) -> UnitDoubt:
    """What the unit of a rotor stream is in doubt by.

    Args:
        source: as in `Record`.
        range_: of commands; None: they are speeds.
        parameters: known so far.
        airframe: which may have the poles.
        seen: whether the IMU shows how fast the rotors turn.
    """
    if range_ is not None:
        return UnitDoubt(f"{source}: {range_.origin}" if range_.assumed else "")
    divided, counted = pole_count(source, parameters), airframe.motor_poles is not None
    if seen or (divided is not None and counted):
        return UnitDoubt()
    if divided is None or source == DEFINED_SPEEDS[1]:
        unused = "; motor_poles is not used, as no pole count of theirs is known" if counted else ""
        return UnitDoubt(as_sent="" if is_simulated(parameters) else _AS_SENT + unused)
    name, poles = divided
    if not parameters.get(name, 0.0) >= 2.0:
        return UnitDoubt(f"{source} without {name} in the log: {poles:g} poles assumed")
    return UnitDoubt(f"{source} by {name}, as it was entered or left: {poles:g} poles assumed")


def pole_count(source: str, parameters: Parameters) -> tuple[str, float] | None:
    """The parameter by which electrical speeds became those of rotors, and its value.

    What drives ESCs by DShot, FETtec's or KDE's protocol divides by a number that the user counts;
    others send rpm. None: so does this source, as far as the parameters show, or it is of a
    simulator.
    """
    of_escs, firmware = source.lower().startswith("esc"), "motor_poles"
    if source == DEFINED_SPEEDS[0] or (source in DEFINED_SPEEDS and firmware in parameters):
        name = firmware
    elif is_simulated(parameters) or not of_escs:
        return None
    elif parameters.get("MOT_PWM_TYPE") in _DSHOT_TYPES:
        name = "SERVO_BLH_POLES"
    elif parameters.get("SERVO_FTW_MASK", 0.0) > 0.0:
        name = "SERVO_FTW_POLES"
    elif 8.0 in (parameters.get("CAN_D1_PROTOCOL"), parameters.get("CAN_D2_PROTOCOL")):  # KDE's
        name = next((each for each in parameters if each.endswith("KDE_NPOLE")), "KDE_NPOLE")
    elif any(_is_dshot(driver, parameters) for driver in motor_outputs("px4", parameters)):
        name = "DSHOT_MOT_POL1" if "DSHOT_MOT_POL1" in parameters else "MOT_POLE_COUNT"
    else:
        return None
    poles = parameters.get(name, 0.0)
    return name, poles if poles >= 2.0 else MOTOR_POLES


def speed_scale(
    source: str, speeds: Sequence[Array], airframe: Airframe, mass: float | None, poles: Parameters
) -> float:
    """Rad/s for what a decoder took for rad/s: by the poles counted, else `RADIANS` where as rpm
    the largest rotors that fit could not carry the vehicle.

    Args:
        source: as in `Record`.
        speeds: (n,) of each rotor in flight.
        airframe: whose rotors.
        mass: kg; None: not known.
        poles: parameters, with those of `pole_count`.
    """
    divided = pole_count(source, poles)
    if divided is not None and airframe.motor_poles:
        return divided[1] / airframe.motor_poles
    if mass is None or source in DEFINED_SPEEDS or airframe.own_units:
        return 1.0
    most = LARGEST_ROTOR * airframe.apart**4 * sum(float(np.mean(v * v)) for v in speeds)
    return RADIANS if mass * GRAVITY > _BEYOND * most else 1.0


def _of_px4(parameters: Parameters) -> Range | None:
    """Of the driver whose output is motor 1, where its parameters give a range."""
    for driver, outputs in motor_outputs("px4", parameters).items():
        if _is_dshot(driver, parameters):
            full, start = _DSHOT[1] - _DSHOT[0], parameters.get("DSHOT_MIN")
            origin = "DShot from DSHOT_MIN" + " 0.055 assumed" * (start is None)
            return Range((0.055 if start is None else start) * full, full, origin, start is None)
        output = outputs.get(0, -1) + 1
        low, high = (parameters.get(f"{driver}_{end}{output}") for end in ("MIN", "MAX"))
        if low is not None and high is not None and low < high:
            return Range(low, high, f"{driver}_MIN{output}, {driver}_MAX{output}")
    for all_outputs in ("PWM_MAIN", "PWM"):  # up to version 1.12, and up to 1.11
        low, high = (parameters.get(f"{all_outputs}_{end}", 0.0) for end in ("MIN", "MAX"))
        if 0.0 < low < high:
            return Range(low, high, f"{all_outputs}_MIN, {all_outputs}_MAX")
    return None


def _is_dshot(driver: str, parameters: Parameters) -> bool:
    """By rates of groups of outputs: below -1 they are DShot, which drives nothing but motors."""
    return any(parameters.get(f"{driver}_TIM{group}", 0.0) < -1.0 for group in range(8))


def gyro_cutoff(given: float | None, autopilot: str, parameters: Parameters) -> float | None:
    """Hz of the low-pass that the gyro has passed when it is sent; None: there is none.

    ArduPilot filters what it sends and logs; PX4 sends means over one interval, unfiltered.

    Args:
        given: by the airframe file; 0 for none.
        autopilot: "px4" or "ardupilot".
        parameters: known so far.
    """
    if given is None:
        if autopilot != "ardupilot":
            return None
        given = parameters.get("INS_GYRO_FILTER", ARDUPILOT_GYRO_FILTER)
    return given if given > 0.0 else None


def loop_cutoff(autopilot: str, parameters: Parameters) -> float | None:
    """Hz of the low-pass that the gyro passes on its way into the commands; None: there is none.

    Args:
        autopilot: "px4" or "ardupilot".
        parameters: known so far.
    """
    if autopilot == "ardupilot":
        cutoff = parameters.get("INS_GYRO_FILTER", ARDUPILOT_GYRO_FILTER)
    else:
        usual = PX4_LOOP_FILTER if autopilot == "px4" else 0.0
        cutoff = parameters.get("IMU_GYRO_CUTOFF", usual)
    return cutoff if cutoff > 0.0 else None


@dataclass(frozen=True)
class RotorSource:
    """The selected rotor stream, and how to read it.

    Attributes:
        kind: of its values.
        name: of the message or topic; messages of one kind for several groups share it.
        why: in words.
        range: of commands.
        scale: of speeds: rad/s for what the decoder took for rad/s.
        refused: name -> why not, of the others.
        interval: s between readings; 0 where that does not matter.
        order: of motors among outputs, by which the stream is sorted.
        stops: whether speeds of 0 are rotors that stand, which have been seen to slow down.
        unlike: of speeds, see `rotor_readings.unlike_squares`; None: no commands show it.
    """

    kind: RotorInput
    name: str
    why: str
    range: Range | None = None
    scale: float = 1.0
    refused: Mapping[str, str] | None = None
    interval: float = 0.0
    order: MotorOrder = field(default_factory=MotorOrder)
    stops: bool = False
    unlike: float | None = None

    @property
    def doubt(self) -> str:
        """What else it may be than the motors' input, in words; empty: nothing else."""
        doubt = self.order.doubt(self.name)
        return f"{self.name} {doubt}" if doubt else ""

    def reads_as(self, other: "RotorSource") -> bool:
        """Whether it is the same stream, read in the same way."""
        return (self.name, self.range, self.scale, self.order) == (
            other.name, other.range, other.scale, other.order
        )  # fmt: skip

    def read(self, values: Array) -> Array:
        """(n, rotors) of the stream to rad/s, or to commands of 0 (stopped) to 1 (full).

        A speed of 0, or what a curve through one passes below, is missing unless rotors stop: few
        do in flight, but an ESC may not answer.
        """
        if self.range is not None:
            return normalized(values, self.range)
        stands = 0.0 if self.stops else np.nan
        return np.where(values <= 0.0, stands, values * self.scale)


def normalized(outputs: Array, range_: Range) -> Array:
    """Commands of 0 to 1; what is below the range (disarmed, failsafe) is stopped.

    Between samples a curve passes below 0 where motors stop and above 1 where they give all; to
    cut off one of both would make the mean of what acted too large.
    """
    u = (outputs - range_.low) / (range_.high - range_.low)
    return np.where(u < _STOPPED, 0.0, u)
