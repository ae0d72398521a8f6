"""The airframe: where the rotors are, which way they turn, and what is known of the scale.

And how well that is known: no flight shows an error of rotor positions, scale or the IMU's place.
With arms given 3 % too long everything fits as well, at inertias 3 % too large. Its standard
deviation is therefore given too, in an airframe file's `[uncertainty]` or behind the value
(`--arm 0.25+-0.003`), and enters every interval (`given_errors`).
"""

import math
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from importlib import resources
from itertools import combinations
from pathlib import Path
from typing import Any, Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray

from gcs_sysid.errors import InputError, nearest
from gcs_sysid.files import as_it_is, parse_toml, read_text, real_number, reject_unknown
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.model.rotor_input import RotorInput

ScaleKind = Literal["mass", "k_T", "T_max", "added_mass"]
Known = tuple[float, float]
"""A value and its standard deviation."""


@dataclass(frozen=True)
class ScaleReference:
    """The fact that sets the scale.

    Attributes:
        kind: which.
        value: of it, SI.
        std: of the value; zero as given by a user, not where it comes from an earlier segment.
        origin: where it comes from; empty for a user.
        loaded: of "added_mass", k_T / m of the flight with the mass added, and its deviation.
        given: share by which what was given at first may be wrong, which no flight shows: all
            that is in proportion to the scale is off by it, after changes in flight too.
    """

    kind: ScaleKind
    value: float
    std: float = 0.0
    origin: str = ""
    loaded: Known | None = None
    given: float = 0.0


@dataclass(frozen=True)
class Sigma:
    """A standard deviation, in the unit of its value or as a share of it."""

    amount: float
    relative: bool = False

    def of(self, size: float) -> float:
        """In the unit of a value of this size."""
        return self.amount * abs(size) if self.relative else self.amount

    def __str__(self) -> str:
        """As options and files take it."""
        return f"{100.0 * self.amount:.9g}%" if self.relative else f"{self.amount:.9g}"


@dataclass(frozen=True)
class GivenUncertainty:
    """Standard deviations of what is given.

    Attributes:
        arm: scale common to all rotor positions, by the mean arm; m or share. A tape measure reads
            to 1 mm, and whether it was held to the motor's axis matters as much.
        rotor_position: x and y of each rotor by itself; m or share of the arm. Plates and tubes are
            cut to a few tenths of a millimeter.
        rotor_thrust: of each rotor at a speed, or a command, as a share of the mean: propellers of
            one make scatter by a few percent, motors on commands by more.
        mass: kg or share; kitchen scales read to a few grams, and batteries differ.
        k_T: N s^2 or share; thrust benches are good to a percent or two, and air density changes.
        T_max: N or share; the same.
        imu_position: each coordinate, m.
        imu_rotation: about each body axis, degrees; what is left after the autopilot's level
            calibration.
    """

    arm: Sigma = Sigma(0.01, relative=True)
    rotor_position: Sigma = Sigma(0.002, relative=True)
    rotor_thrust: Sigma = Sigma(0.03, relative=True)
    mass: Sigma = Sigma(0.005, relative=True)
    k_T: Sigma = Sigma(0.02, relative=True)
    T_max: Sigma = Sigma(0.02, relative=True)
    imu_position: Sigma = Sigma(0.02)
    imu_rotation: Sigma = Sigma(1.0)

    def scale_share(self, kind: str, value: float) -> float:
        """Standard deviation of the scale over its value.

        `kind` is "mass", "k_T", "T_max" or "added_mass"; `value` is SI.
        """
        sigma: Sigma = getattr(self, "mass" if kind == "added_mass" else kind)
        return sigma.of(value) / abs(value)

    def altered(self, entries: Mapping[str, object], where: str) -> Self:
        """The same with other standard deviations.

        Of name -> number in the unit above, or text such as "1%".

        Raises:
            InputError: there is none of that name, or it is no standard deviation.

        Example:
            >>> USUAL.altered({"arm": "3%", "mass": 0.01}, "here").arm.of(0.25)
            0.0075
        """
        for name in entries:
            if name not in UNCERTAIN:
                known = ", ".join(UNCERTAIN)
                raise InputError(f"{where}: unknown key {name!r}; known are {known}")
        sigmas = {name: parse_sigma(e, f"{where}: {name}") for name, e in entries.items()}
        for name, limit in _MOST.items():
            if name in sigmas and (sigmas[name].relative or sigmas[name].amount > limit[0]):
                raise InputError(f"{where}: {name} must be at most {limit[0]:g} {limit[1]}")
        return replace(self, **sigmas)


USUAL = GivenUncertainty()
"""Where nothing is said."""
UNCERTAIN = tuple(field.name for field in fields(GivenUncertainty))
"""Keys of `[uncertainty]`."""
_MOST = {"imu_position": (1.0, "m"), "imu_rotation": (30.0, "degrees")}
_MOST_SHARE = 0.5
"""Beyond this first-order propagation means nothing."""


def parse_sigma(entry: object, where: str) -> Sigma:
    """A standard deviation from a file or an option.

    Of a number, or text: a number or a percentage such as "1%".

    Raises:
        InputError: it is neither.
    """
    number, relative = entry, False
    if isinstance(entry, str):
        text = entry.strip()
        relative = text.endswith("%")
        try:
            number = float(text.removesuffix("%"))
        except ValueError:
            number = None
    if (
        isinstance(number, bool)
        or not isinstance(number, int | float)
        or not 0.0 <= number <= sys.float_info.max
        or (relative and number > 100.0 * _MOST_SHARE)
    ):
        raise InputError(
            f"{where}: the standard deviation must be a number from zero on, or a percentage up "
            f"to {100.0 * _MOST_SHARE:g} such as '1%', got {entry!r:.40}"
        )
    return Sigma(float(number) / 100.0, relative=True) if relative else Sigma(float(number))


def check_share(name: str, value: float, sigma: Sigma) -> None:
    """Refuse a value that is hardly known at all.

    Raises:
        InputError: its standard deviation is more than half of it.
    """
    if not (math.isfinite(value) and sigma.of(value) <= _MOST_SHARE * abs(value)):
        raise InputError(f"{name}: a standard deviation of {sigma} is more than half of {value:g}")


AnchorName = Literal["mass", "k_T", "T_max"]
ANCHORS: dict[AnchorName, str] = {name: REGISTRY[name].unit for name in get_args(AnchorName)}
"""The values that can set the scale, with their units."""

_SCALES: dict[str, tuple[float, float]] = {
    "mass": (1e-3, 1e5), "k_T": (1e-12, 1e3), "T_max": (1e-3, 1e6),
}  # fmt: skip
"""Least and most that a multirotor can have; beyond lie the squares that overflow."""
_MOST_PRIOR, _LEAST_STD = 1e9, 1e-15
"""Of a prior, in whatever unit; also the least of one that must be positive."""
_LEAST_CUTOFF = 0.1
"""Hz, of a gyro filter."""

PRIORS = tuple(name for name, parameter in REGISTRY.items() if parameter.prior)
"""Parameters that may be known beforehand."""

_VEHICLES = ("paper", "px4-sih")
"""Built-in airframes of one vehicle with its own size; the others are layouts to be scaled."""

LEAST_ARM, MOST_ARM = 0.001, 100.0
"""m; a rotor further out than this is a slip of the pen."""

SIMULATION_TABLE = "simulation"
"""A table for the emulator alone. This reader drops it unread: truth never gets in here."""


OWN_UNITS = (("mass",), ("mass", "arm"))
"""What may be a unit, where it is not given: see `Airframe.own_units`."""
_SAME_PLACE = 0.2
"""Arms between two rotors, below which they are coaxial: places are measured to millimeters."""
_UPRIGHT = (0.0, 0.0, -1.0)
_MOST_TILT = math.radians(30.0)


@dataclass(frozen=True)
class Rotor:
    """One rotor.

    Attributes:
        x: m forward of the geometric center.
        y: m to the right of it.
        spin: +1 counter-clockwise seen from above (the s_i of the yaw equation), -1 clockwise.
        axis: unit vector of its thrust, forward, right and down.
    """

    x: float
    y: float
    spin: int
    axis: tuple[float, float, float] = _UPRIGHT

    @property
    def yaw_arm(self) -> float:
        """m, yaw torque of a canted rotor's thrust over the part of it along the body's z axis.

        (x n_y - y n_x) / -n_z, n the axis.
        """
        return (self.x * self.axis[1] - self.y * self.axis[0]) / -self.axis[2]


@dataclass(frozen=True)
class Cant:
    """What canted rotors do to a flight that upright ones would not.

    Attributes:
        adds: m, to the moment ratio, as more drag torque would; see `Airframe.cant`.
        lean: 1/m, by which the moment ratio shortens all arms: the drag torque leans with the
            rotor, against the roll and pitch torque of its thrust.
    """

    adds: float = 0.0
    lean: float = 0.0

    def shortened(self, ratio: float) -> float:
        """What arms seem to be multiplied by, at the moment ratio that a flight shows."""
        return (1.0 + self.adds * self.lean) / (1.0 + ratio * self.lean)

    def shown(self, ratio: float) -> float:
        """The moment ratio that a flight shows of rotors that have this one."""
        return (ratio + self.adds) / (1.0 - ratio * self.lean)


NOT_CANTED = Cant()


@dataclass(frozen=True)
class CommandRange:
    """How actuator outputs map to the rotor's command u in 0..1, and u to thrust."""

    min: float = 1000.0
    max: float = 2000.0
    thrust_curve: float | None = None
    """c of T/T_max = (1 - c) u + c u^2; None: to be identified."""
    given: bool = False
    """Whether min and max are known, not what is usual."""


@dataclass(frozen=True)
class Airframe:
    """What is known about a vehicle before it flies.

    Attributes:
        name: as in the file.
        rotors: in the autopilot's motor order.
        rotor_input: which telemetry carries the rotors' inputs; "auto": the first sound.
        motor_poles: magnets of a motor, counted; None: as the autopilot has it.
        command: the range of actuator outputs.
        mass: kg, or None.
        k_T: N s^2, or None.
        T_max: N, or None.
        gyro_filter: Hz, second-order low-pass already applied to the gyro; 0: none, None: the
            autopilot's.
        imu_position: m, forward, right and down from the geometric center, or None.
        uncertainty: of rotor positions, scale and IMU.
        own_units: "mass" and "arm" that were not given, and are one here: what is in proportion to
            them is per kg of the mass, or per m of the arm.
    """

    name: str
    rotors: tuple[Rotor, ...]
    rotor_input: RotorInput | Literal["auto"] = "auto"
    motor_poles: int | None = None
    command: CommandRange = CommandRange()
    mass: float | None = None
    k_T: float | None = None
    T_max: float | None = None
    gyro_filter: float | None = None
    imu_position: tuple[float, float, float] | None = None
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Parameters known beforehand: name -> value and standard deviation, SI."""
    uncertainty: GivenUncertainty = USUAL
    placeholder: tuple[Rotor, ...] = ()
    """Rotors of a built-in layout, whose size is not that of any vehicle: see `_VEHICLES`."""
    own_units: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.rotor_input != "auto":
            object.__setattr__(self, "rotor_input", RotorInput(self.rotor_input))

    @property
    def wanted_input(self) -> RotorInput | None:
        """The kind of rotor stream asked for; None: whichever is sound."""
        return None if self.rotor_input == "auto" else self.rotor_input

    @property
    def arm_known(self) -> bool:
        """Whether the size is the vehicle's own: False for a built-in layout as it is."""
        return self.rotors != self.placeholder

    @property
    def geometry(self) -> NDArray[np.float64]:
        """(3, n) matrix of x, y and spin of every rotor."""
        return np.array([[r.x, r.y, float(r.spin)] for r in self.rotors]).T

    @property
    def arm(self) -> float:
        """Mean distance of the rotors from the geometric center, m."""
        return sum(math.hypot(r.x, r.y) for r in self.rotors) / len(self.rotors)

    @property
    def apart(self) -> float:
        """M between the nearest rotors that are not coaxial."""
        return min((d for d in self._distances if d >= _SAME_PLACE * self.arm), default=math.inf)

    @property
    def coaxial(self) -> bool:
        """Whether two rotors share a position, seen from above."""
        return any(d < _SAME_PLACE * self.arm for d in self._distances)

    @property
    def _distances(self) -> list[float]:
        return [math.hypot(a.x - b.x, a.y - b.y) for a, b in combinations(self.rotors, 2)]

    @property
    def cant(self) -> float:
        """m, what canted rotors add to the moment ratio: their yaw arm along their spin.

        With rotors canted so that thrust adds to their drag torque, the yaw moment

            N = sum k_T Omega_i^2 (s_i k_M / k_T + yaw_arm_i) ,  yaw_arm_i = s_i cant

        is, to any flight, that of upright rotors with more drag torque.
        """
        return sum(r.spin * r.yaw_arm for r in self.rotors) / len(self.rotors)

    @property
    def canted(self) -> Cant:
        """All that their cant does."""
        return Cant(self.cant, self.cant / self.arm**2)

    def as_json(self) -> dict[str, Any]:
        """Name and rotors, as a result states them."""
        rotors: list[dict[str, Any]] = []
        for r in self.rotors:
            rotors.append({"x": r.x, "y": r.y, "spin": "ccw" if r.spin > 0 else "cw"})
            if r.axis != _UPRIGHT:
                rotors[-1]["axis"] = list(r.axis)
        own = {"own_units": list(self.own_units)} if self.own_units else {}
        return {"name": self.name, "rotors": rotors, **own}

    @property
    def imu_arm(self) -> tuple[float, float, float] | None:
        """Position of the IMU from the CG, m, with the CG of the priors; None: not given."""
        if self.imu_position is None:
            return None
        x, y, z = self.imu_position
        cg_x, cg_y = (self.priors.get(name, (0.0, 0.0))[0] for name in ("cg_x", "cg_y"))
        return x - cg_x, y - cg_y, z

    def anchor(self) -> tuple[AnchorName, float] | None:
        """The scale anchor given, or None."""
        for name in ANCHORS:
            value: float | None = getattr(self, name)
            if value is not None:
                return name, value
        return None

    def with_anchor(self, name: AnchorName, value: float) -> "Airframe":
        """The same airframe with this scale reference only.

        Raises:
            InputError: the value is not a positive number.

        Example:
            >>> load_airframe("paper").with_anchor("k_T", 2.05e-4).anchor()
            ('k_T', 0.000205)
        """
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} must be a positive number ({ANCHORS[name]}), got {value}")
        _check_scale(name, value, name)
        cleared: dict[str, float | None] = dict.fromkeys(ANCHORS)
        cleared[name] = value
        return replace(self, **cleared)  # type: ignore[arg-type]

    def in_own_units(self) -> "Airframe":
        """The same airframe of which neither mass nor thrust is known, with its mass as the unit.

        Of a built-in layout whose size is not the vehicle's, so is its arm. Motion and rotors
        determine all else in these units, exactly.

        Raises:
            InputError: a prior is in proportion to what is not known.
        """
        own = OWN_UNITS[0] if self.arm_known else OWN_UNITS[1]
        for name in self.priors:
            if REGISTRY[name].unit_per(own) != REGISTRY[name].unit:
                raise InputError(f"a prior of {name} needs the {' and the '.join(own)}, not given")
        sized = self if self.arm_known else self.with_arm(1.0)
        exact = replace(self.uncertainty, mass=Sigma(0.0))
        if "arm" in own:
            exact = replace(exact, arm=Sigma(0.0))
        return replace(sized.with_anchor("mass", 1.0), uncertainty=exact, own_units=own)

    def check_scale_fits(self) -> None:
        """Refuse a scale that does not fit the rotor input, or is hardly known.

        Raises:
            InputError: it does not fit.
        """
        own = self.anchor()
        if own is not None:
            if self.wanted_input is not None and not self.wanted_input.fits(own[0]):
                kind = self.wanted_input
                raise InputError(
                    f"{own[0]} cannot set the scale with {kind.words} as the input; give mass or "
                    f"{kind.thrust} (--mass, --{kind.thrust.lower().replace('_', '-')})"
                )
            check_share(*own, getattr(self.uncertainty, own[0]))
        check_share("arm", self.arm, self.uncertainty.arm)

    def with_uncertainty(self, entries: Mapping[str, object], where: str) -> "Airframe":
        """The same airframe with other standard deviations of what is given.

        Entries are as in a file's `[uncertainty]`.

        Raises:
            InputError: see `GivenUncertainty.altered`.

        Example:
            >>> load_airframe("paper").with_uncertainty({"mass": 0.01}, "here").uncertainty.mass
            Sigma(amount=0.01, relative=False)
        """
        # An arm given with its uncertainty has been measured.
        placeholder = () if "arm" in entries else self.placeholder
        uncertainty = self.uncertainty.altered(entries, where)
        return replace(self, uncertainty=uncertainty, placeholder=placeholder)

    def with_prior(self, name: str, value: float, std: float) -> "Airframe":
        """The same airframe with one more (or another) prior.

        Raises:
            InputError: no prior of that name is possible, or the numbers make no sense.

        Example:
            >>> load_airframe("paper").with_prior("Izz", 0.03, 0.002).priors
            {'Izz': (0.03, 0.002)}
        """
        _check_prior(name, value, std, "prior")
        return replace(self, priors={**self.priors, name: (value, std)})

    def with_arm(self, meters: float) -> "Airframe":
        """The same layout scaled so that the mean rotor distance is `meters`.

        Raises:
            InputError: the length is not one of a vehicle.

        Example:
            >>> round(load_airframe("paper").with_arm(0.2).arm, 6)
            0.2
        """
        if not LEAST_ARM <= meters <= MOST_ARM:
            raise InputError(
                f"--arm must lie between {LEAST_ARM:g} and {MOST_ARM:g} m, got {meters:g}"
                + ("; 250 mm are 0.25" if meters > MOST_ARM else "")
            )
        k = meters / self.arm
        rotors = tuple(replace(r, x=r.x * k, y=r.y * k) for r in self.rotors)
        return replace(self, rotors=rotors, placeholder=())


def own_units_words(own: Collection[str]) -> tuple[str, str]:
    """What values are per, as of `Airframe.own_units`, and what would scale them."""
    if "arm" in own:
        return (
            "values are per kg of the mass and per m of the arm, which were not given",
            "give --mass KG and --arm M",
        )
    return "values are per kg of the mass, which was not given", "give --mass KG"


def builtin_names() -> list[str]:
    """Names of the airframes that come with the program, sorted."""
    folder = resources.files("gcs_sysid.model") / "airframes"
    return sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".toml"))


def load_airframe(name_or_path: str) -> Airframe:
    """Read an airframe by built-in name, or from a TOML file.

    Raises:
        InputError: no such name or file, or the file is not a valid airframe.
    """
    airframe = parse_airframe(*read_airframe_table(name_or_path))
    layout = name_or_path in builtin_names() and name_or_path not in _VEHICLES
    return replace(airframe, placeholder=airframe.rotors) if layout else airframe


def read_airframe_table(name_or_path: str) -> tuple[dict[str, Any], str]:
    """Read an airframe's TOML and report its origin, without judging its content.

    Raises:
        InputError: no such name or file, or the text is not TOML.
    """
    if name_or_path in builtin_names():
        where = f"built-in airframe {name_or_path!r}"
        text = (
            resources.files("gcs_sysid.model") / "airframes" / f"{name_or_path}.toml"
        ).read_text(encoding="utf-8")
    else:
        path = Path(name_or_path)
        where = str(path)
        if path.suffix != ".toml" and not path.exists():
            names = builtin_names()
            raise InputError(
                f"no airframe {name_or_path!r}: name a .toml file or one of {', '.join(names)}"
                + nearest(str(name_or_path), names)
            )
        text = read_text(path, "the airframe file")
    return parse_toml(text, where, "an airframe file"), where


def parse_airframe(table: Mapping[str, Any], where: str) -> Airframe:
    """Make an airframe of a parsed TOML table.

    Raises:
        InputError: a key is unknown, missing or has a value that makes no sense.
    """
    tables = {"command", "imu", "rotor", "prior", "uncertainty", SIMULATION_TABLE}
    reject_unknown(table, {"name", "rotor_input", "motor_poles", *ANCHORS, *tables}, where)
    name = table.get("name", Path(where).stem)
    if not isinstance(name, str):
        raise InputError(f"{where}: name must be text, got {as_it_is(name)}")
    rotor_input = table.get("rotor_input", "auto")
    kinds = ["auto", *RotorInput]
    if rotor_input not in kinds:
        names = " or ".join([", ".join(f"'{kind}'" for kind in kinds[:-1]), f"'{kinds[-1]}'"])
        raise InputError(f"{where}: rotor_input must be {names}, got {as_it_is(rotor_input)}")
    poles = table.get("motor_poles")
    if poles is not None and (type(poles) is not int or poles % 2 or not 2 <= poles <= 80):
        raise InputError(f"{where}: motor_poles must be even, 2 to 80, got {as_it_is(poles)}")
    anchors: dict[str, Any] = {
        name: _positive(table[name], f"{where}: {name}") for name in ANCHORS if name in table
    }
    for anchor, value in anchors.items():
        _check_scale(anchor, value, f"{where}: {anchor}")
    if len(anchors) > 1:
        raise InputError(
            f"{where}: give one scale only, not {' and '.join(anchors)} together; "
            "the others are identified from it"
        )
    gyro_filter, imu_position = _imu(table.get("imu", {}), f"{where}: [imu]")
    return Airframe(
        name=name,
        rotors=_rotors(table.get("rotor"), where),
        rotor_input=rotor_input,
        motor_poles=poles,
        command=_command(table.get("command", {}), f"{where}: [command]"),
        gyro_filter=gyro_filter,
        imu_position=imu_position,
        priors=_priors(table.get("prior", {}), where),
        uncertainty=_uncertainty(table.get("uncertainty", {}), f"{where}: [uncertainty]"),
        **anchors,
    )


def _uncertainty(table: object, where: str) -> GivenUncertainty:
    if not isinstance(table, dict):
        raise InputError(f"{where} must be a table")
    return USUAL.altered(table, where)


def _check_scale(name: str, value: float, where: str) -> None:
    least, most = _SCALES[name]
    if not least <= value <= most:
        raise InputError(f"{where} must lie in {least:g}..{most:g}, got {value:g}")


def _priors(table: object, where: str) -> dict[str, tuple[float, float]]:
    if not isinstance(table, dict):
        raise InputError(f"{where}: [prior] must be a table of name = [value, std]")
    out = {}
    for name, entry in table.items():
        at = f"{where}: [prior] {name}"
        if not isinstance(entry, list) or len(entry) != 2:
            raise InputError(f"{at}: must be [value, standard deviation], got {as_it_is(entry)}")
        value, std = (real_number(number, at) for number in entry)
        _check_prior(name, value, std, where)
        out[name] = (value, std)
    return out


def _check_prior(name: str, value: float, std: float, where: str) -> None:
    if name not in PRIORS:
        raise InputError(
            f"{where}: no prior on {name!r}; known are {', '.join(PRIORS)}" + nearest(name, PRIORS)
        )
    if not (math.isfinite(value) and math.isfinite(std) and std > 0.0):
        raise InputError(f"{where}: the standard deviation of {name} must be positive")
    if abs(value) > _MOST_PRIOR or not _LEAST_STD <= std <= _MOST_PRIOR:
        raise InputError(f"{where}: {name} cannot be {value:g} with a deviation of {std:g}")
    if REGISTRY[name].sign == "positive" and value < _LEAST_STD:
        raise InputError(f"{where}: {name} must be positive, got {value:g}")


def _rotors(entries: object, where: str) -> tuple[Rotor, ...]:
    if not isinstance(entries, list) or len(entries) < 4:
        raise InputError(f"{where}: at least four [[rotor]] tables are needed, in motor order")
    if len(entries) > 32:
        raise InputError(f"{where}: {len(entries)} rotors; more than 32 are not supported")
    rotors = []
    for i, entry in enumerate(entries, 1):
        at = f"{where}: [[rotor]] number {i}"
        if not isinstance(entry, dict):
            raise InputError(f"{at}: must be a table with x, y and spin")
        reject_unknown(entry, {"x", "y", "spin", "axis"}, at)
        for key in ("x", "y", "spin"):
            if key not in entry:
                raise InputError(f"{at}: {key} is missing")
        spin = {"ccw": 1, "cw": -1}.get(str(entry["spin"]).lower())
        if spin is None:
            raise InputError(f"{at}: spin must be 'ccw' or 'cw', got {as_it_is(entry['spin'])}")
        x, y = (real_number(entry[key], f"{at}: {key}") for key in ("x", "y"))
        if math.hypot(x, y) > MOST_ARM:
            raise InputError(f"{at}: x and y are in meters; {math.hypot(x, y):g} m is too far out")
        rotors.append(Rotor(x, y, spin, _axis(entry.get("axis"), f"{at}: axis")))
    layout = np.array([[1.0, r.x, r.y, r.spin] for r in rotors])
    # Without full rank the rotors cannot make all three torques and the thrust apart.
    if np.linalg.matrix_rank(layout / np.maximum(np.abs(layout).max(axis=0), 1e-9)) < 4:
        raise InputError(
            f"{where}: these rotors cannot control roll, pitch, yaw and thrust independently; "
            "check positions and spins"
        )
    if not is_evenly_canted(rotors):
        raise InputError(
            f"{where}: rotors can be canted outward, or all in the direction of their own drag "
            "torque (or all against it); check the axes"
        )
    return tuple(rotors)


def is_evenly_canted(rotors: Sequence[Rotor]) -> bool:
    """Whether rotors' axes add the same to the yaw torque of each, along its spin."""
    arms = np.array([r.spin * r.yaw_arm for r in rotors])
    # To a millimeter rms.
    return bool(arms.std() <= 1e-3)


def _axis(entry: object, where: str) -> tuple[float, float, float]:
    if entry is None:
        return _UPRIGHT
    if not isinstance(entry, list) or len(entry) != 3:
        raise InputError(
            f"{where} must be [x, y, z], forward, right and down, got {as_it_is(entry)}; "
            "[0, 0, -1] is upright"
        )
    numbers = [real_number(value, where) for value in entry]
    length = math.hypot(*numbers)
    if not 0.0 < length < math.inf or -numbers[2] < math.cos(_MOST_TILT) * length:
        raise InputError(
            f"{where} must point up to within {math.degrees(_MOST_TILT):.0f} degrees, as "
            f"[0, 0, -1] does, got {as_it_is(entry)}"
        )
    x, y, z = (value / length for value in numbers)
    return x, y, z


def _command(table: object, where: str) -> CommandRange:
    if not isinstance(table, dict):
        raise InputError(f"{where} must be a table")
    reject_unknown(table, {"min", "max", "thrust_curve"}, where)
    low = real_number(table.get("min", 1000.0), f"{where} min")
    high = real_number(table.get("max", 2000.0), f"{where} max")
    if not high > low:
        raise InputError(f"{where}: max ({high:g}) must be larger than min ({low:g})")
    curve = table.get("thrust_curve")
    if curve is not None:
        curve = real_number(curve, f"{where} thrust_curve")
        if not 0.0 <= curve <= 1.0:
            raise InputError(f"{where}: thrust_curve must lie in 0..1, got {curve:g}")
    return CommandRange(low, high, curve, given="min" in table or "max" in table)


def _imu(table: object, where: str) -> tuple[float | None, tuple[float, float, float] | None]:
    if not isinstance(table, dict):
        raise InputError(f"{where} must be a table")
    reject_unknown(table, {"gyro_filter", "position"}, where)
    position = _imu_position(table.get("position"), f"{where} position")
    return _gyro_filter(table, where), position


def _imu_position(entry: object, where: str) -> tuple[float, float, float] | None:
    if entry is None:
        return None
    if not isinstance(entry, list) or len(entry) != 3:
        raise InputError(f"{where} must be [x, y, z] in m, got {as_it_is(entry)}")
    x, y, z = (real_number(value, where) for value in entry)
    if max(abs(x), abs(y), abs(z)) > MOST_ARM:
        raise InputError(f"{where} must be in m, got {as_it_is(entry)}")
    return x, y, z


def _gyro_filter(table: Mapping[str, Any], where: str) -> float | None:
    if "gyro_filter" not in table:
        return None
    cutoff = real_number(table["gyro_filter"], f"{where} gyro_filter")
    if cutoff and not _LEAST_CUTOFF <= cutoff <= 1000.0:
        raise InputError(
            f"{where}: gyro_filter must be 0 or {_LEAST_CUTOFF}..1000 Hz, got {cutoff:g}"
        )
    return cutoff


def _positive(value: object, where: str) -> float:
    number = real_number(value, where)
    if number <= 0:
        raise InputError(f"{where} must be positive, got {number:g}")
    return number
