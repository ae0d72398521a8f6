"""What flights determine of the autopilot's parameters, and files that ground stations load.

The one place for that: `params`, `health`, `batch` and `trend` show what is here. Files hold what
is to be set alone, as a value that fits need not be nearer to the truth than what is there.

Conventions, by the autopilots' own sources and parameter descriptions:

- MOT_THST_EXPO and THR_MDL_FAC are c of T/T_max = (1 - c) u + c u^2 (f_c(u) below).
- ArduPilot's throttle is f_c(u v) times the density of the air over that at sea level, v the
  battery's voltage, without sag, over MOT_BAT_VOLT_MAX, or 1 where that is 0
  (AP_Motors_Thrust_Linearization: f_c(u v) = lift_max thrust, thrust = throttle / lift_max /
  density). MOT_THST_HOVER is that throttle of a hover, MPC_THR_HOVER is f_c(u).
- CA_ROTORn_PX, PY are from the center of gravity, forward and right, in m; KM is the moment ratio,
  positive for counter-clockwise. INS_POSn_* and EKF2_IMU_POS_* are forward, right and down, of the
  IMU from the CG.
- MOT_SPIN_MIN is a share of the whole range of the outputs, MOT_BAT_VOLT_* are volts of the pack.
- PX4 takes a motor for failed whose current departs from MOTFAIL_C2T times its thrust command plus
  MOTFAIL_IDLE, one line for all motors (MotorFailureDetector, mfd_fit).
- PX4 multiplies its thrust by 1 / v where MC_BAT_SCALE_EN is set; Betaflight takes off
  vbat_sag_compensation percent of what a full battery gives beyond an empty one (mixer.c).
- Betaflight's output is u (1 + k (1 - u)^2), k thrust_linear in percent (pid.c).
- A notch follows the throttle by INS_HNTCH_FREQ sqrt(throttle / INS_HNTCH_REF) in mode 1
  (AP_Vehicle::update_throttle_notch, ArduPilot 4.6). In modes 2 to 5 it follows rotors or a
  spectrum, and INS_HNTCH_FREQ is the least frequency that it goes to, as IMU_GYRO_DNF_MIN and
  rpm_filter_min_hz are.

QGroundControl loads lines of vehicle, component, name, value and MAV_PARAM_TYPE between tabs;
Mission Planner lines of NAME,VALUE; Betaflight's command line `set name = value`. All skip lines
that begin with #. Nothing is sent: a pilot loads the file, sees the differences and decides.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from gcs_sysid.errors import InputError
from gcs_sysid.health.balance import pooled
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.health.vehicle_health import Health
from gcs_sysid.judgement.plausibility import of_turning
from gcs_sysid.model.estimate import Quantity
from gcs_sysid.model.parameter_file import SUFFIXES, parameter_lines

_FULL, _EMPTY = 4.2, 3.3
"""V of a LiPo cell: what MOT_BAT_VOLT_MAX and MIN are a pack's multiple of."""
_CELLS = 24
_WHOLE = ("MC_BAT_SCALE_EN",)

ParameterVerdict = Literal["set", "leave", "cannot tell"]


@dataclass(frozen=True)
class Proposal:
    """A parameter's value by one flight or by several, and what to do about it.

    Attributes:
        name: of the parameter.
        quantity: its value, in the autopilot's unit; None: not determined.
        now: what the log says that it was; None: not logged.
        note: where it comes from.
        use: half of the widest 95 % interval that is of use.
        lacks: what is missing before it may be set, if anything.
        fly: what gives that.
        keep: why it is left as it is whatever its value, if so.
        then: what the value of now amounts to once the others are set; None: the same.
        flights: that determine it.
    """

    name: str
    quantity: Quantity | None
    now: float | None
    note: str = ""
    use: float = math.inf
    lacks: str = ""
    fly: str = ""
    keep: str = ""
    then: float | None = None
    flights: int = 1

    @property
    def verdict(self) -> ParameterVerdict:
        """What to do: it is set where the truth is surely nearer to the new value than to the old.

        The new value is that of the flights, or what the old one amounts to once others are set.
        """
        if self.known and self.keep:
            return "leave"
        if not self.known or self.now is None:
            return "cannot tell"
        return "leave" if self._chosen is None else "set"

    @property
    def known(self) -> bool:
        """Whether there is a value that is of use."""
        return self._value is not None and not self.lacks and self._half <= self.use

    @property
    def _chosen(self) -> float | None:
        """The value that the truth is surely nearer to than to the old one; None: there is none."""
        if not self.known or self.quantity is None or self.now is None:
            return None
        value, sure = self.quantity.value, TUNING.sure * self.quantity.std
        # What a file holds is rounded to single precision.
        sure = max(sure, 1e-6 * abs(value))
        others = [self.now] if self.then is None else [self.now, self.then]
        if all(0.5 * abs(value - other) > sure for other in others):
            return value
        if self.then is None:
            return None
        beyond = value - 0.5 * (self.now + self.then)
        return self.then if math.copysign(beyond, beyond * (self.then - self.now)) > sure else None

    @property
    def new(self) -> float | None:
        """The value to set, or that would be."""
        return self._value if self._chosen is None else self._chosen

    @property
    def reason(self) -> str:
        """Why, and where the value comes from, in words."""
        value, half = self._value, self._half
        if self.verdict == "set":
            why = "" if self.new == value else "the old value as it reads once the others are set"
        elif value is None or self.lacks:
            return self.lacks or "not determined"
        elif half > self.use:
            why = f"known to {half:.2g}, which is too little: {self.use:.2g} is of use"
        elif self.keep:
            return self.keep
        elif self.now is None:
            why = "what it is now is not in the log"
        elif abs(value - self.now) <= max(half, 1e-6 * abs(value)):
            why = "what it is now lies in the interval"
        else:
            why = "not surely nearer to the truth than what it is now"
        return "; ".join(filter(None, (self.note, why)))

    @property
    def action(self) -> str:
        """What to fly or to log where it is not known; else empty."""
        if self.verdict != "cannot tell":
            return ""
        return "log the autopilot's parameters" if self.known else self.fly

    @property
    def _value(self) -> float | None:
        return None if self.quantity is None else self.quantity.value

    @property
    def _half(self) -> float:
        half = None if self.quantity is None else self.quantity.half
        return half or 0.0

    def as_json(self) -> dict[str, Any]:
        """As the JSON of `params` has it."""
        return {
            "name": self.name,
            "old": self.now,
            "new": self.new,
            "by_flights": None if self.quantity is None else self.quantity.as_json(),
            "verdict": self.verdict,
            "reason": self.reason,
            "fly": self.action or None,
            "note": self.note or None,
            "flights": self.flights if self.quantity is not None else 0,
        }


_CLIMB = (
    "hover for 60 s with climbs and descents of 2 m, ESC telemetry logged: the rotors' speeds over "
    "a range of commands"
)
_SPEEDS = "log the rotors' speeds: ESC telemetry, or bidirectional DShot"
_FOLLOWS = ", and this is the least that the notch goes to: judge the gains again (tune)"
_LEGS = "fly legs of 20 s at 3 m/s and at 10 m/s, north, east, south and west, in calm air"
_STEADY = "hover for 60 s, in calm air and with one load"
_CURRENTS = "hover for 60 s with climbs and descents of 2 m, the ESCs' currents logged (esc_status)"
_STILL_AIR = (
    "hover for 60 s in still air, above 3 m, with brisk climbs and descents of 1 m, and take the "
    "autopilot's own log"
)
_DISCHARGE = "hover from a full battery until it is low, with the voltage logged"


def determined(flights: Sequence[Health]) -> tuple[Proposal, ...]:
    """What flights of one vehicle say of its autopilot's parameters: each by all of them together.

    Args:
        flights: in their order; those of other vehicles, without a hover and whose loads and
            commands mean little (`Finding.spoils`) do not count.
    """
    of = {"px4": _px4, "ardupilot": _ardupilot, "generic": _betaflight}
    usable = [health for health in flights if not excluded(health)]
    if not usable or usable[-1].autopilot not in of:
        return ()
    curve = _together([c for h in usable if (c := _curve(h)) is not None])
    voltage = _together([h.by_voltage for h in usable if h.by_voltage is not None])
    current = _together([h.motor_current.slope for h in usable if h.motor_current is not None])
    found: dict[str, list[Proposal]] = {}
    for health in usable:
        for one in of[health.autopilot](_HoverFlight(health, curve, voltage, current)):
            found.setdefault(one.name, []).append(one)
    return tuple(_merged(some) for some in found.values())


def excluded(health: Health) -> str:
    """Why a flight does not count, in words; empty where it does."""
    if not health.available:
        return "; ".join(health.reasons[:1])
    spoilt = next((f"{f.at}: {f.what}; {f.do}" for f in health.findings if f.spoils), "")
    return health.apart or spoilt


def proposed(flights: Sequence[Health]) -> tuple[Proposal, ...]:
    """All values of use that flights of one vehicle have together."""
    return tuple(one for one in determined(flights) if one.known and not one.keep)


def _together(some: Sequence[Quantity]) -> Quantity | None:
    return pooled(some) if some else None


def _curve(health: Health) -> Quantity | None:
    """C of a flight, where it is of use."""
    curve = health.curve
    return None if curve is None or not 0.0 < curve.c.std < TUNING.usable_curve else curve.c


def _merged(some: Sequence[Proposal]) -> Proposal:
    """One proposal of all flights' for a parameter."""
    known = [one for one in some if one.quantity is not None]
    if not known:
        return some[-1]
    quantity = pooled([one.quantity for one in known if one.quantity is not None])
    return replace(known[-1], quantity=quantity, flights=len(known))


@dataclass(frozen=True)
class _HoverFlight:
    """A flight, and what all flights of the vehicle determine together.

    Attributes:
        health: of the flight.
        curve: c of the thrust curve.
        voltage: power of the voltage, see `Health.by_voltage`.
        current: A of a motor for full thrust.
    """

    health: Health
    curve: Quantity | None
    voltage: Quantity | None
    current: Quantity | None

    def now(self, name: str) -> float | None:
        return self.health.parameters.get(name)

    def propose(
        self, name: str, quantity: Quantity | None, note: str = "", **more: Any
    ) -> Proposal:
        sound = (
            quantity is not None and math.isfinite(quantity.value) and math.isfinite(quantity.std)
        )
        return Proposal(name, quantity if sound else None, self.now(name), note, **more)

    @property
    def air(self) -> tuple[float, float]:
        """Density of the air over that at sea level, and its relative standard deviation.

        ArduPilot's own throttle shows what it takes for it, where its log has that.
        """
        x, now = self.health.hover_command, self.now("MOT_THST_EXPO")
        if x is None or x.throttle is None or now is None:
            return 1.0, TUNING.unknown_air
        before = 1.0 if not self.now("MOT_BAT_VOLT_MAX") else x.voltage
        if before is None or not x.thrust(now, before) > 0.0:
            return 1.0, TUNING.unknown_air
        return x.throttle / x.thrust(now, before), 0.0

    @property
    def falls(self) -> bool | None:
        """Whether thrust falls with the voltage; None: not surely one or the other.

        Powers far from both are of a voltage that is none of the pack's.
        """
        power = self.voltage
        if power is None:
            return None
        off, sure = power.value - 0.5, TUNING.sure * power.std
        return off > 0.0 if sure < abs(off) < 1.0 + sure else None

    def of_curve(self, name: str) -> Proposal:
        """THR_MDL_FAC or MOT_THST_EXPO."""
        now, c = self.now(name), _curve(self.health)
        note = "thrust curve"
        if c is not None and self.curve is not None and now is not None:
            gain = self.slope_over(now, self.curve.value)
            if abs(gain - 1.0) > 0.05:
                note += f"; rate gains act {gain:.2f} times as now in hover: mind them"
        lacks = "" if c is not None else "no climbs or speeds that show the thrust curve"
        return self.propose(name, c, note, use=TUNING.usable_curve, lacks=lacks, fly=_CLIMB)

    def slope_over(self, one: float, other: float) -> float:
        """Slope in hover of the thrust by a curve over that by another."""
        u = 0.5 if self.health.hover_command is None else self.health.hover_command.mean
        return (1.0 - one + 2.0 * one * u) / (1.0 - other + 2.0 * other * u)

    def curve_after(self, name: str) -> Quantity:
        """C that the autopilot has once what is to be set is set: exact where it is the old one."""
        old = Quantity(self.now(name) or 0.0, 0.0, "1")
        if self.curve is None or self.now(name) is None:
            return self.curve or old
        proposal = self.propose(name, self.curve, use=TUNING.usable_curve)
        return self.curve if proposal.verdict == "set" else old


def _hover(flight: _HoverFlight, c: Quantity, before: float, after: float) -> Quantity | None:
    """Throttle of a hover, by the curve and the share of the voltage made up for after all is set.

    It is that of flights to come: loads and charges differ from one to the next.

    Args:
        flight: with commands.
        c: of the curve after.
        before: share of the full voltage that was made up for, 1 for none.
        after: the same, once all is set.
    """
    x = flight.health.hover_command
    if x is None:
        return None
    air, by_air = (1.0, 0.0) if flight.health.autopilot == "px4" else flight.air
    value = air * x.thrust(c.value, after)
    # The curve in force is exact; one that is set is off in all flights alike.
    by_curve = air * abs(after**2 * x.square - after * x.mean) * c.std
    own = math.hypot(x.share, TUNING.common_command) * value
    return Quantity(value, own, "1").off_by(given=math.hypot(by_air * value, by_curve))


def _then(
    flight: _HoverFlight, name: str, of_curve: str, c: Quantity, voltage: tuple[float, float]
) -> float | None:
    """What a hover's throttle of now amounts to by another curve and voltage; None: the same."""
    x, now = flight.health.hover_command, flight.now(name)
    if x is None or now is None:
        return None
    old = x.thrust(flight.now(of_curve) or 0.0, voltage[0])
    then = now * x.thrust(c.value, voltage[1]) / old if old > 0.0 else now
    return None if math.isclose(then, now, rel_tol=1e-6) else then


def _px4(flight: _HoverFlight) -> Iterator[Proposal]:
    health = flight.health
    yield flight.of_curve("THR_MDL_FAC")
    c = flight.curve_after("THR_MDL_FAC")
    yield flight.propose(
        "MPC_THR_HOVER",
        hover := _hover(flight, c, 1.0, 1.0),
        f"hover with THR_MDL_FAC {c.value:.3g}",
        use=_of_hover(hover),
        lacks="" if hover is not None else "no commands of the motors",
        fly=_STEADY if hover is not None else "log actuator_motors or actuator_outputs",
        then=_then(flight, "MPC_THR_HOVER", "THR_MDL_FAC", c, (1.0, 1.0)),
    )
    yield _by_voltage(flight, "MC_BAT_SCALE_EN", 1.0, "")
    yield from _current(flight)
    yield from _barometer(flight, "SENS_BARO_K_T", "THR_MDL_FAC", "m")
    if int(flight.now("IMU_GYRO_DNF_EN") or 0) & 1:
        yield _notch(flight, "IMU_GYRO_DNF_MIN", None, _FOLLOWS)
    assert health.airframe is not None
    assert health.cg is not None
    if any(name.startswith("CA_ROTOR") for name in health.parameters) or health.arm_known:
        lacks = "" if health.arm_known else "the size of the airframe is not known"
        use = TUNING.worth_knowing * health.airframe.arm
        ratio = health.airframe.priors.get("moment_ratio")
        rotors = health.airframe.rotors
        # Each stands where the file says but for its own error, of which the CG has the mean.
        std = health.airframe.uncertainty.rotor_position.of(health.airframe.arm)
        own = std**2 * (1.0 - 2.0 / len(rotors))
        for i, rotor in enumerate(rotors):
            for axis, place, offset in zip("XY", (rotor.x, rotor.y), health.cg, strict=True):
                yield flight.propose(
                    f"CA_ROTOR{i}_P{axis}", None if lacks else _less(place, offset, own),
                    "m from the CG as flown", use=use, lacks=lacks, fly="give --arm",
                )  # fmt: skip
            if ratio is not None and not lacks:
                turn = Quantity(rotor.spin * ratio[0], ratio[1], "m", std_given=ratio[1])
                yield flight.propose(f"CA_ROTOR{i}_KM", turn, "moment ratio as given")
    yield from _imu(flight, "EKF2_IMU_POS_")
    yield from _drag(flight, "EKF2_")


def _current(flight: _HoverFlight) -> Iterator[Proposal]:
    """The line of PX4's motor failure detection: MOTFAIL_IDLE is what C2T leaves of the hover."""
    slope, idle = flight.now("MOTFAIL_C2T"), flight.now("MOTFAIL_IDLE")
    if slope is None or idle is None:
        return
    line, pooled_slope = flight.health.motor_current, flight.current
    if line is None or pooled_slope is None:
        for name in ("MOTFAIL_C2T", "MOTFAIL_IDLE"):
            lacks = "no currents of the ESCs over a range of thrust"
            yield flight.propose(name, None, lacks=lacks, fly=_CURRENTS)
        return
    use = 2.0 * TUNING.worth_knowing * pooled_slope.value
    note = "current over thrust commanded, of all motors"
    after = flight.propose("MOTFAIL_C2T", pooled_slope, note, use=use, fly=_CURRENTS)
    yield replace(after, quantity=line.slope)
    used = pooled_slope.value if after.verdict == "set" else slope
    level = Quantity(max(line.mean.value - used * line.thrust, 0.0), line.mean.std, "A")
    # The same line in hover as before, where only C2T is surely another.
    then = max(idle + (slope - used) * line.thrust, 0.0) if used != slope else None
    note = f"{line.mean.value:.3g} A in hover with MOTFAIL_C2T {used:.3g}"
    lacks = "MOTFAIL_C2T is not known" if after.verdict == "cannot tell" else ""
    yield flight.propose("MOTFAIL_IDLE", level, note, lacks=lacks, then=then, fly=_CURRENTS)


def _barometer(flight: _HoverFlight, name: str, of_curve: str, unit: str) -> Iterator[Proposal]:
    """What the autopilot takes off the barometer for full thrust, where its firmware can.

    Thrust is that by the curve that the autopilot has afterwards, near the hover.
    """
    found, hover = flight.health.barometer, flight.health.hover_thrust
    if flight.now(name) is None:
        return
    if found is None or hover is None:
        lacks = "no pressure and thrust over climbs and descents in the autopilot's own log"
        yield flight.propose(name, None, lacks=lacks, fly=_STILL_AIR)
        return
    meter = 1.0 if unit == "m" else found.meter
    by = flight.slope_over(flight.now(of_curve) or 0.0, flight.curve_after(of_curve).value)
    full = found.full.times(by * meter / found.meter, unit)
    use = TUNING.worth_height * meter / hover.value
    yield flight.propose(name, full, "pressure over climbs", use=use, fly=_STILL_AIR)


def _of_hover(hover: Quantity | None) -> float:
    """Half of an interval of a hover's throttle that is of use."""
    return math.inf if hover is None else 2.5 * TUNING.worth_knowing * hover.value


def _ardupilot(flight: _HoverFlight) -> Iterator[Proposal]:
    health = flight.health
    yield flight.of_curve("MOT_THST_EXPO")
    yield from _battery(flight)
    yield (hover := _thrust_hover(flight))
    for name in ("INS_HNTCH", "INS_HNTC2"):
        if flight.now(f"{name}_ENABLE"):
            yield from _harmonic_notch(flight, name, hover.quantity)
    idle = _spin_min(health)
    if idle is not None:
        note = "0.03 above the least output at which all rotors were measured turning"
        yield flight.propose("MOT_SPIN_MIN", idle, note)
    yield from _barometer(flight, "BARO1_THST_SCALE", "MOT_THST_EXPO", "Pa")
    if health.arm_known:
        yield from _imu(flight, "INS_POS1_")
    yield from _drag(flight, "EK3_DRAG_")


def _drag(flight: _HoverFlight, prefix: str) -> Iterator[Proposal]:
    """Drag by which the autopilot estimates the wind, where its log has parameters of it."""
    names = [f"{prefix}{name}" for name in ("MCOEF", "BCOEF_X", "BCOEF_Y")]
    if not set(names) <= flight.health.parameters.keys():
        return
    drag = flight.health.drag
    air, by_air = flight.air
    keep = ""
    if not any(flight.now(name) for name in names):
        keep = "0, which turns the estimate of the wind off; for that, set all three by hand"
    if drag is None:
        lacks = "no legs through the air whose drag exceeds what gusts do"
        for name in names:
            yield flight.propose(name, None, lacks=lacks, fly=_LEGS)
        return
    # Both by the density of the air (drag_fusion.cpp): M as its root, B as itself.
    linear = drag.linear
    note = f"legs of up to {drag.fastest:.0f} m/s through the air, wind taken off"
    value = max(linear.value, 0.0) / math.sqrt(air)
    found = Quantity(value, linear.std / math.sqrt(air), "1/s")
    found = found.off_by(given=0.5 * by_air * abs(linear.value))
    use = max(2.0 * TUNING.worth_knowing * value, TUNING.worth_drag)
    yield flight.propose(names[0], found, note, use=use, keep=keep, fly=_LEGS)
    square = drag.square
    ballistic = None
    if square.value > TUNING.sure * square.std:
        ballistic = square.under(0.5 * TUNING.sea_level * air, "kg/m^2")
        ballistic = ballistic.off_by(given=by_air * ballistic.value)
    lacks = "" if ballistic is not None else "no legs fast enough for drag of the speed squared"
    use = math.inf if ballistic is None else 4.0 * TUNING.worth_knowing * ballistic.value
    for name in names[1:]:
        yield flight.propose(name, ballistic, note, use=use, lacks=lacks, keep=keep, fly=_LEGS)


def _thrust_hover(flight: _HoverFlight) -> Proposal:
    health, x = flight.health, flight.health.hover_command
    c = flight.curve_after("MOT_THST_EXPO")
    note = f"hover with MOT_THST_EXPO {c.value:.3g}"
    before = after = 1.0
    lacks = "" if x is not None else "no outputs of the motors"
    if flight.now("MOT_BAT_VOLT_MAX"):
        full = flight.now("MOT_BAT_VOLT_MAX") or 1.0
        if x is not None and x.voltage is not None:
            before = x.voltage
        elif health.battery is not None:
            before = min(health.battery[2] / full, 1.0)
        else:
            lacks = "no voltage of the battery, which MOT_BAT_VOLT_MAX makes up for"
        after = before
        if flight.falls is False:
            after, note = 1.0, f"{note}, MOT_BAT_VOLT_MAX 0"
    hover = None if lacks else _hover(flight, c, before, after)
    if hover is not None and after < 1.0 and flight.falls is None:
        # Of another battery's charge, unless thrust falls with the voltage: then made up for.
        hover = hover.off_by(given=(1.0 - after) * hover.value)
    logged = x is not None and x.throttle is not None and not lacks
    fly = _STEADY if logged else "take the autopilot's own log (.bin), with CTUN, MOTB and BAT"
    return flight.propose(
        "MOT_THST_HOVER", hover, note, use=_of_hover(hover), lacks=lacks, fly=fly,
        then=_then(flight, "MOT_THST_HOVER", "MOT_THST_EXPO", c, (before, after)),
    )  # fmt: skip


def _notch(flight: _HoverFlight, name: str, of_hover: float | None, why: str) -> Proposal:
    """A notch's frequency.

    Args:
        flight: with rotor speeds, else there is no proposal.
        name: of the parameter.
        of_hover: what it is over the rotors' frequency in hover; None: the least that a notch goes
            to which follows the rotors, those of half of the thrust. Below the hover it is left:
            lower costs phase, higher costs the notch.
        why: behind the rotors' frequency.
    """
    hertz, now = flight.health.hover_frequency, flight.now(name) or 0.0
    if hertz is None:
        lacks = "no measured speeds of the rotors"
        return flight.propose(name, None, lacks=lacks, fly=_SPEEDS)
    for otherwise in of_turning(flight.health.turning):
        return flight.propose(name, None, lacks=otherwise.reason, fly=otherwise.how)
    keep = ""
    if of_hover is None:
        of_hover, keep = math.sqrt(0.5), "below that" if now < hertz.value else ""
    # The thrust of flights to come differs, as does the air; it goes with the speed squared.
    note = f"rotors turn with {hertz.value:.0f} Hz in hover{why}"
    found = hertz.times(of_hover, "Hz")
    found = found.off_by(given=0.5 * TUNING.common_command * found.value)
    return flight.propose(name, found, note, keep=keep and f"{note}; it is {keep}")


def _harmonic_notch(
    flight: _HoverFlight, name: str, throttle: Quantity | None
) -> Iterator[Proposal]:
    """ArduPilot's, by the throttle of a hover once all is set; as wide for its frequency as now."""
    reference, mode = flight.now(f"{name}_REF"), flight.now(f"{name}_MODE") or 0.0
    used = None if throttle is None else throttle.value
    if mode > 1.0 and reference:
        found = _notch(flight, f"{name}_FREQ", None, _FOLLOWS)
    elif mode == 1.0 and reference and used:
        ratio = math.sqrt(reference / used)
        found = _notch(flight, f"{name}_FREQ", ratio, f", at a throttle of {used:.2f}")
    else:
        found = _notch(flight, f"{name}_FREQ", 1.0, "")
        found = replace(found, keep="it stands still, and may be there for something else")
    yield found
    width = flight.now(f"{name}_BW")
    if found.verdict == "set" and width and found.now and found.new:
        size = Quantity(width * found.new / found.now, 0.0, "Hz")
        yield flight.propose(f"{name}_BW", size, "as wide for its frequency as now")


def _by_voltage(flight: _HoverFlight, name: str, full: float, unit: str) -> Proposal:
    """A parameter that makes up for the voltage, in full where it is `full`."""
    falls, power = flight.falls, flight.voltage
    if falls is None:
        lacks = "whether thrust falls with the voltage: the battery hardly fell, or is not logged"
        return flight.propose(name, None, lacks=lacks, fly=_DISCHARGE)
    value = Quantity(full if falls else 0.0, 0.0, unit)
    return flight.propose(name, value, _power_words(power))


def _power_words(power: Quantity | None) -> str:
    assert power is not None
    share = f"{power.value:.2f} ± {power.half:.2f}"
    return f"thrust goes with the voltage to the power {share} of that of commands"


def _battery(flight: _HoverFlight) -> Iterator[Proposal]:
    """MOT_BAT_VOLT_*: 0 where the ESC makes up for the voltage by itself, else a pack's limits."""
    names = [f"MOT_BAT_VOLT_{end}" for end in ("MAX", "MIN")]
    battery, falls = flight.health.battery, flight.falls
    if falls is False:
        yield flight.propose(names[0], Quantity(0.0, 0.0, "V"), _power_words(flight.voltage))
        return
    high, low, _ = battery or (0.0, 0.0, 0.0)
    cells = round(high / (_FULL - 0.05))
    whole = 1 <= cells <= _CELLS and cells * _EMPTY < high <= cells * (_FULL + 0.15)
    lacks = "" if falls else "whether thrust falls with the voltage"
    for name, volt in zip(names, (_FULL, _EMPTY), strict=True):
        value = None
        if not flight.now(name) and whole:
            value = Quantity(cells * volt, 0.0, "V")
        elif falls and (now := flight.now(name)):
            value = Quantity(now, 0.0, "V")
        note = f"{cells} LiPo cells by {high:.1f} V, the highest seen ({low:.1f} V the lowest)"
        why = lacks or ("" if value is not None else "no voltage of a pack of LiPo cells")
        yield flight.propose(name, value, note, lacks=why, fly=_DISCHARGE)


def _betaflight(flight: _HoverFlight) -> Iterator[Proposal]:
    """Of Betaflight, whose logs have its parameters by the names of its command line."""
    if "vbat_sag_compensation" in flight.health.parameters:
        yield _by_voltage(flight, "vbat_sag_compensation", 100.0, "%")
    if flight.now("dshot_bidir") and flight.now("rpm_filter_harmonics"):
        yield _notch(flight, "rpm_filter_min_hz", None, _FOLLOWS)
    if poles := flight.now("motor_poles"):
        factor, lacks = flight.health.turning, ""
        if factor is None:
            lacks = "another number of poles looks like another thrust coefficient"
        elif factor != 1.0:  # a line need not be that of the first order
            like = 2 * round(0.5 * poles / factor)
            lacks = f"what shakes the IMU is that of {like} poles, or a multiple of it"
        yield flight.propose(
            "motor_poles", None if lacks else Quantity(poles, 0.0, "1"),
            "the IMU is shaken at the speeds read", lacks=lacks, fly="count the motor's magnets",
        )  # fmt: skip
    c, x = _curve(flight.health), flight.health.hover_command
    if "thrust_linear" not in flight.health.parameters or x is None:
        return
    if c is None:
        lacks = "no climbs or speeds that show the thrust curve"
        yield flight.propose("thrust_linear", None, lacks=lacks, fly=_CLIMB)
        return

    def percent(c: float) -> float:
        thrust = x.thrust(c)
        return 100.0 * (x.mean / thrust - 1.0) / (1.0 - thrust) ** 2

    value, step = percent(c.value), 0.05 if c.value < 0.9 else -0.05
    std = abs(percent(c.value + step) - value) / 0.05 * c.std
    gain = 1.0 + 0.01 * value * (1.0 - x.thrust(c.value)) ** 2
    yield flight.propose(
        "thrust_linear", Quantity(value, std, "%", std_given=c.std_given / c.std * std),
        "thrust curve at hover",
        keep=f"{value:.0f} makes thrust linear, but multiplies the gains in hover by {gain:.1f}: "
        "change it only with them",
    )  # fmt: skip


def _spin_min(health: Health) -> Quantity | None:
    """A little above the least output at which all rotors turned, over the range of outputs."""
    low, high = (health.parameters.get(f"MOT_PWM_{end}", 0.0) for end in ("MIN", "MAX"))
    if not 0.0 < low < high:
        low, high = 1000.0, 2000.0
    now = health.parameters.get("MOT_SPIN_MIN")
    if health.idle is None or now is None:
        return None
    share = (health.idle - low) / (high - low)
    # In flight no output is below MOT_SPIN_MIN: only an idle on the ground shows it.
    if not 0.0 < share < now - TUNING.idle_std:
        return None
    return Quantity(share + TUNING.above_idle, TUNING.idle_std, "1", std_given=TUNING.idle_std)


def _imu(flight: _HoverFlight, prefix: str) -> Iterator[Proposal]:
    airframe, cg = flight.health.airframe, flight.health.cg
    assert airframe is not None
    assert cg is not None
    place = airframe.imu_position
    if place is None:
        return
    for axis, value, offset in zip("XY", place[:2], cg, strict=True):
        yield flight.propose(
            f"{prefix}{axis}", _less(value, offset), "m from the CG as flown",
            use=TUNING.worth_knowing * airframe.arm,
        )  # fmt: skip


def _less(place: float, offset: Quantity, variance: float = 0.0) -> Quantity:
    """A place from the CG, m; `variance` is that of what is given of it, beyond the CG's, m^2."""
    found = Quantity(place - offset.value, offset.std, "m", std_given=offset.std_given)
    return found.off_by(given=math.sqrt(variance))


def check_suffix(path: Path) -> None:
    """See that a name's ending stands for a format.

    Raises:
        InputError: it stands for none.
    """
    if path.suffix.lower() not in (*SUFFIXES, ".txt"):
        raise InputError(
            f"{path}: end its name with .params (QGroundControl), .param (Mission Planner) or .txt "
            "(Betaflight's command line)"
        )


def proposal_file(flights: Sequence[Health], found: Sequence[Proposal], suffix: str) -> str:
    """The file of `params`: what is to be set, and in comments what is not.

    Args:
        flights: of one vehicle; at least one that counts.
        found: by them.
        suffix: of the file: ".params" is QGroundControl's, ".txt" for Betaflight's command line,
            others are Mission Planner's.

    Raises:
        InputError: the format is another autopilot's.
    """
    used = [flight for flight in flights if not excluded(flight)]
    ground_station = used[-1].autopilot in ("px4", "ardupilot")
    if (suffix == ".txt") == ground_station:
        wanted = " or ".join(SUFFIXES) if ground_station else ".txt"
        raise InputError(f"{suffix} is no format of this autopilot: end the name with {wanted}")
    names = ", ".join(Path(flight.source).name for flight in used)
    chosen = [one for one in found if one.verdict == "set"]
    others = [f"# {one.name}: {one.verdict}: {one.reason}" for one in found if one not in chosen]
    head = [
        f"# Proposed by gcs-sysid params from {names}; review each before writing it.",
        *([] if chosen else ["# Nothing is to be set."]),
    ]
    lines = _lines(chosen, used[-1], suffix) if chosen else []
    if suffix == ".txt" and chosen:
        lines.append("# save")
    return "\n".join([*head, *lines, *others]) + "\n"


def _lines(found: Sequence[Proposal], health: Health, suffix: str) -> list[str]:
    address = int(health.vehicle.get("sysid") or 1), int(health.vehicle.get("compid") or 1)
    values: dict[str, float] = {}
    notes: dict[str, str] = {}
    for one in found:
        assert one.quantity is not None
        assert one.new is not None
        value, half = one.quantity.value, one.quantity.half or 0.0
        now = "" if one.now is None else f"; was {one.now:.6g}"
        interval = f"{value - half:.6g} to {value + half:.6g}" if half else "no interval"
        values[one.name] = int(one.new) if one.name in _WHOLE else round(one.new, 6)
        notes[one.name] = f"{interval} ({one.note}{now})"
    return parameter_lines(values, notes, suffix, address)
