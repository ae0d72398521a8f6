"""Text to values, as both command lines and the page's form take them; one-line usage errors.

A parse function takes what a user types and returns the value, or raises
`argparse.ArgumentTypeError` with what is wrong, to stand after the option's name.
"""

import argparse
import math
import re
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NoReturn

from gcs_sysid.errors import InputError, nearest, one_line

if TYPE_CHECKING:
    from gcs_sysid.model.airframe import Airframe

GivenName = Literal["arm", "mass", "k_T", "T_max"]


class OneLineParser(argparse.ArgumentParser):
    """Reports wrong usage as one line and exit status 2, with the nearest word that is known."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse, but each command refuses options that it does not know itself."""
        found, extra = super().parse_known_args(args, namespace)
        if extra:
            near = nearest(extra[0].partition("=")[0], self._option_string_actions)
            self.error(f"unrecognized arguments: {' '.join(extra)}{near}")
        return found, extra

    def _get_value(self, action: argparse.Action, arg_string: str) -> Any:
        """A value; an empty one is a variable that was never set, and what it asks for lost."""
        if not arg_string and action.nargs != argparse.PARSER:
            raise argparse.ArgumentError(action, "must not be empty")
        return super()._get_value(action, arg_string)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """A choice; one that is misspelt is answered with the nearest."""
        if action.choices is not None and value not in action.choices:
            near = nearest(str(value), map(str, action.choices))
            listed = "" if near else f" (choose from {', '.join(map(str, action.choices))})"
            raise argparse.ArgumentError(action, f"invalid choice: {value!r}{near}{listed}")

    def error(self, message: str) -> NoReturn:
        """Say it and stop."""
        said = one_line(message)
        self.exit(2, f"{self.prog.split()[0]}: error: {said}; see {self.prog} --help\n")


class AppendNamed(argparse.Action):
    """Appends (name, ...) as "append" does, and refuses a name that was given before."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        """Append one; of two for a name, one would be ignored."""
        before = getattr(namespace, self.dest)
        if any(values[0] == name for name, *_ in before):
            raise argparse.ArgumentError(self, f"{values[0]} is given twice")
        setattr(namespace, self.dest, [*before, values])


def number(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"must be a number, got {text!r}")
    return value


def baud(text: str) -> int:
    """The baud rate of a serial port."""
    if not text.isdecimal() or not 1 <= len(text) <= 8 or int(text) == 0:
        raise argparse.ArgumentTypeError(f"must be a baud rate such as 57600, got {text!r}")
    return int(text)


def positive(text: str) -> float:
    """A finite number above zero."""
    value = number(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f"must be positive, got {text!r}")
    return value


def not_negative(text: str) -> float:
    """A finite number, zero or more."""
    value = number(text)
    if value < 0.0:
        raise argparse.ArgumentTypeError(f"must not be negative, got {text!r}")
    return value


def between(least: float, most: float, unit: str) -> Callable[[str], float]:
    """Parse function of a number from `least` to `most` of a unit."""

    def checked(text: str) -> float:
        value = number(text)
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(
                f"must lie between {least:g} and {most:g} {unit}, got {text!r}"
            )
        return value

    return checked


class Measured(float):
    """A number, with the standard deviation that was given behind it as it was written, or None."""

    sigma: str | None = None


def measured(
    check: Callable[[str], float], units: Mapping[str, float] = MappingProxyType({})
) -> Callable[[str], Measured]:
    """Parse function of VALUE or VALUE±STD, the latter perhaps in percent; +- and +/- do as well.

    Args:
        check: parses the value.
        units: that may follow it -> how many of them make the SI unit.
    """

    def checked(text: str) -> Measured:
        value, sign, sigma = _plus_minus(text)
        bare, per_unit = _without_unit(value, units)
        out = Measured(check(value if per_unit is None else repr(number(bare) / per_unit)))
        if sign and not sigma.endswith("%") and units:
            sigma, own = _without_unit(sigma, units)
            if (own or per_unit) and _SIGMA.fullmatch(sigma):
                sigma = repr(number(sigma) / (own or per_unit or 1.0))
        if sign:
            if not _SIGMA.fullmatch(sigma):
                raise argparse.ArgumentTypeError(
                    f"must be VALUE or VALUE±STD (or +-), such as 0.25+-0.003 or 0.25+-1%, "
                    f"got {text!r}"
                )
            out.sigma = sigma
        return out

    return checked


def _without_unit(text: str, units: Mapping[str, float]) -> tuple[str, float | None]:
    """The number, and how many of its unit make the SI unit; None where there is no unit."""
    found = _WITH_UNIT.fullmatch(text) if units else None
    if found is None:
        return text, None
    unit = found[2].lower()
    if unit not in units:
        of_propellers = unit.startswith(("in", '"')) and units is LENGTHS
        why = " (inches are of propellers: measure from the center to a motor)"
        raise argparse.ArgumentTypeError(
            f"must be in {' or '.join(units)}, got {text!r}{why if of_propellers else ''}"
        )
    return found[1], units[unit]


_WITH_UNIT = re.compile(
    r"\s*([^a-z]*?[\d.](?:e[+-]?\d+)?)\s*([a-z]+|\")\s*", re.IGNORECASE | re.ASCII
)
LENGTHS: Mapping[str, float] = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
MASSES: Mapping[str, float] = {"kg": 1.0, "g": 1000.0}
_SIGMA = re.compile(r"(\d+\.?\d*|\.\d+)(e[+-]?\d+)?\s*%?", re.IGNORECASE | re.ASCII)


def _plus_minus(text: str) -> tuple[str, str, str]:
    """The text before and after ±, and that sign; empty where there is none."""
    for sign in ("+/-", "+-"):
        text = text.replace(sign, "±")
    value, sign, std = text.partition("±")
    return value.strip(), sign, std.strip()


def split_prior(text: str) -> tuple[str, str, str] | None:
    """Name, value and standard deviation of NAME=VALUE±STD; +- and +/- do as well."""
    name, equals, rest = text.partition("=")
    value, plus_minus, std = _plus_minus(rest)
    return (name.strip(), value, std) if equals and plus_minus else None


def prior(text: str) -> tuple[str, float, float]:
    """NAME=VALUE±STD; +- and +/- do as well."""
    words = split_prior(text)
    try:
        if words:
            return words[0], float(words[1]), float(words[2])
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"must be NAME=VALUE±STD (or +-), got {text!r}")


def setting(text: str) -> tuple[str, float]:
    """NAME=VALUE."""
    name, equals, value = text.partition("=")
    if not equals:
        raise argparse.ArgumentTypeError(f"must be NAME=VALUE, got {text!r}")
    return name.strip(), number(value)


def uncertain_setting(text: str) -> tuple[str, float, float]:
    """NAME=VALUE or NAME=VALUE±STD; +- and +/- do as well."""
    words = split_prior(text)
    try:
        if words:
            return words[0], number(words[1]), not_negative(words[2])
    except argparse.ArgumentTypeError:
        raise argparse.ArgumentTypeError(f"must be NAME=VALUE[±STD], got {text!r}") from None
    name, value = setting(text)
    return name, value, 0.0


def uncertain_delay(text: str) -> tuple[float, float]:
    """A loop's delay in s, perhaps with ±STD."""
    _, value, std = uncertain_setting(f"delay={text}")
    if not 0.0 <= value <= 0.2:
        raise argparse.ArgumentTypeError(f"must be 0 to 0.2 s, got {text!r}")
    return value, std


def change(text: str) -> tuple[str, str | float | tuple[float, ...]]:
    """What is tried: gains=proposed or =FILE, thrust=SHARE, payload=KG[@X,Y,Z] in m."""
    name, _, value = text.partition("=")
    if name == "gains" and value:
        return name, value
    if name == "thrust" and 0.2 <= number(value) <= 1.5:
        return name, number(value)
    mass, _, place = value.partition("@")
    numbers = tuple(map(number, place.split(",") if place else ()))
    if name == "payload" and len(numbers) in (0, 3):
        return name, (measured(positive, MASSES)(mass), *(numbers or (0.0, 0.0, 0.0)))
    raise argparse.ArgumentTypeError(
        f"must be gains=FILE, payload=KG[@X,Y,Z] or thrust=SHARE (0.2 to 1.5), got {text!r}"
    )


def percentage(text: str) -> float:
    """Per cent, with or without the sign, as a share."""
    try:
        value = float(text.strip().removesuffix("%"))
    except ValueError:
        value = math.nan
    if not 0.1 <= value <= 50.0:
        raise argparse.ArgumentTypeError(f"must lie between 0.1% and 50%, got {text!r}")
    return 0.01 * value


def climb(text: str) -> float:
    """How far a maneuver may climb and descend in m; 0: not at all."""
    value = 0.0 if text.strip() in ("0", "0.0") else number(text)
    if value and not 0.2 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"must be 0 or lie between 0.2 and 1 m, got {text!r}")
    return value


def count(least: int, most: int) -> Callable[[str], int]:
    """Parse function of a whole number from `least` to `most`."""

    def checked(text: str) -> int:
        if not text.isdecimal() or not least <= int(text) <= most:
            raise argparse.ArgumentTypeError(
                f"must be a whole number from {least} to {most}, got {text!r}"
            )
        return int(text)

    return checked


def vehicle_address(text: str) -> tuple[int, int | None]:
    """SYSID or SYSID:COMPID."""
    system, _, component = text.partition(":")
    try:
        address = int(system), int(component) if component else None
    except ValueError:
        address = (0, None)
    if not 1 <= address[0] <= 255 or not (address[1] is None or 0 <= address[1] <= 255):
        raise argparse.ArgumentTypeError(
            f"must be SYSID or SYSID:COMPID with numbers up to 255, got {text!r}"
        )
    return address


def web_address(text: str) -> tuple[str, int]:
    """[HOST:]PORT; without a host, this machine alone."""
    host, colon, port = text.rpartition(":")
    bracketed = host.startswith("[") and host.endswith("]")
    host = host.strip("[]") if colon else "127.0.0.1"
    if not host or (":" in host and not bracketed) or not port.isdecimal() or int(port) > 65535:
        raise argparse.ArgumentTypeError(
            f"must be [HOST:]PORT, such as 8000 or 0.0.0.0:8000, got {text!r}"
        )
    return host, int(port)


_kilograms = between(0.001, 1e5, "kg")


GIVEN: dict[GivenName, Callable[[str], Measured]] = {
    "arm": measured(positive, LENGTHS),
    "mass": measured(_kilograms, MASSES),
    "k_T": measured(positive),
    "T_max": measured(positive),
}
"""What a user gives of an airframe, perhaps with a standard deviation -> its parse function: the
rotors' mean distance from the center in m, and what sets the scale."""


def mass(text: str) -> float:
    """The mass of something that flies, in kg or with its unit."""
    given = GIVEN["mass"](text)
    if given.sigma is not None:
        raise argparse.ArgumentTypeError(f"must be a mass alone, got {text!r}")
    return float(given)


GIVEN_OPTIONS: dict[GivenName, str] = {
    "arm": "--arm", "mass": "--mass", "k_T": "--k-t", "T_max": "--t-max",
}  # fmt: skip
"""The same -> the option that gives it."""


def given_words(name: GivenName, value: float, sigma: str | None = None) -> tuple[str, str]:
    """What gives a value on a command line: the option, and the value with its deviation.

    `sigma` is given behind it; None: as parsed.
    """
    sigma = sigma or getattr(value, "sigma", None)
    return GIVEN_OPTIONS[name], f"{value:.9g}" + ("" if sigma is None else f"+-{sigma}")


def parse_given(name: GivenName, text: str, what: str) -> Measured:
    """What is given of an airframe, from text that is no option's.

    `what` is what it is called, in messages.

    Raises:
        InputError: it cannot be understood.
    """
    try:
        return GIVEN[name](text)
    except argparse.ArgumentTypeError as error:
        raise InputError(f"{what} {error}") from error


def with_given(airframe: "Airframe", name: GivenName, value: float, by: str) -> "Airframe":
    """The airframe with its arm or its scale as given, and the deviation given with it, if any.

    `by` is the option or field that gave it, for messages.

    Raises:
        InputError: no vehicle is like that.
    """
    given = airframe.with_arm(value) if name == "arm" else airframe.with_anchor(name, value)
    sigma = getattr(value, "sigma", None)
    return given if sigma is None else given.with_uncertainty({name: sigma}, by)
