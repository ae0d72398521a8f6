"""How well what is given is known: rotor positions, the scale, and where the IMU sits.

No flight shows such an error: with arms given 3 % too long everything fits as well, at inertias 3 %
too large. Its standard deviation is therefore given too, in an airframe file's `[uncertainty]` or
behind the value (`--arm 0.25+-0.003`), and enters every interval (`given_errors`).
"""

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Self

from gcs_sysid.errors import InputError


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
        mass: kg or share; kitchen scales read to a few grams, and batteries differ.
        k_T: N s^2 or share; thrust benches are good to a percent or two, and air density changes.
        T_max: N or share; the same.
        imu_position: each coordinate, m.
        imu_rotation: about each body axis, degrees; what is left after the autopilot's level
            calibration.
    """

    arm: Sigma = Sigma(0.01, relative=True)
    rotor_position: Sigma = Sigma(0.002, relative=True)
    mass: Sigma = Sigma(0.005, relative=True)
    k_T: Sigma = Sigma(0.02, relative=True)
    T_max: Sigma = Sigma(0.02, relative=True)
    imu_position: Sigma = Sigma(0.02)
    imu_rotation: Sigma = Sigma(1.0)

    def scale_share(self, kind: str, value: float) -> float:
        """Standard deviation of the scale over its value.

        Args:
            kind: "mass", "k_T", "T_max" or "added_mass".
            value: SI.
        """
        sigma: Sigma = getattr(self, "mass" if kind == "added_mass" else kind)
        return sigma.of(value) / abs(value)

    def altered(self, entries: Mapping[str, object], where: str) -> Self:
        """The same with other standard deviations.

        Args:
            entries: name -> number in the unit above, or text such as "1%".
            where: for messages.

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

    Args:
        entry: a number, or text: a number or a percentage such as "1%".
        where: for messages.

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
