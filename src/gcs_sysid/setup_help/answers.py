"""What a user types, understood or refused in plain words."""

import math
import re

from gcs_sysid.argument_types import split_prior
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import MOST_ARM, Rotor

_SPINS = {"ccw": 1, "cw": -1}


def _words(text: str) -> list[str]:
    """Apart at spaces, commas, semicolons and colons."""
    return [word for word in re.split(r"[\s,;:]+", text.strip()) if word]


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{text!r} is not a number; write 0.25, with a point")
    return value


def plain_name(text: str) -> str:
    """A name of one line.

    Raises:
        InputError: it is empty, or has characters that cannot be printed.
    """
    if not text.strip() or not text.isprintable():
        raise InputError(f"the name must be one line of text, not {text!r}")
    return text.strip()


def positive_number(text: str) -> float:
    """A finite number above zero.

    Raises:
        InputError: it is none.
    """
    value = _number(text)
    if value <= 0.0:
        raise InputError(f"must be positive, not {text}")
    return value


def arm_lengths(text: str, *, two: bool = True) -> float | tuple[float, float]:
    """One length in m, or two where `two` allows it: forward and sideways.

    Raises:
        InputError: it is neither.
    """
    if re.fullmatch(r"\d+,\d+", text.strip()):
        raise InputError(f"decimals with a point: {text.strip().replace(',', '.')}")
    words = _words(text)
    if len(words) not in ((1, 2) if two else (1,)):
        raise InputError("one length in m" + (", or two: forward and sideways" if two else ""))
    lengths = [positive_number(word) for word in words]
    if max(lengths) > MOST_ARM:
        raise InputError(f"enter m; {max(lengths):g} m is too long")
    return lengths[0] if len(lengths) == 1 else (lengths[0], lengths[1])


def rotor(text: str) -> Rotor:
    """A rotor: x, y and spin in either order, such as "0.2 -0.2 cw" or "cw:0.2,-0.2".

    Raises:
        InputError: it is none.
    """
    words = _words(text)
    turns = [word.lower() for word in words if word.lower() in _SPINS]
    numbers = [_number(word) for word in words if word.lower() not in _SPINS]
    if len(turns) != 1 or len(numbers) != 2:
        raise InputError("enter x, y and ccw or cw, such as 0.2 -0.2 cw")
    if math.hypot(*numbers) > MOST_ARM:
        raise InputError(f"x and y are in m; {math.hypot(*numbers):g} m is too far out")
    return Rotor(numbers[0], numbers[1], _SPINS[turns[0]])


def spins(text: str, count: int) -> list[int]:
    """So many spins: +1 ccw, -1 cw.

    Raises:
        InputError: there are not so many, or they are something else.
    """
    words = [word.lower() for word in _words(text)]
    if len(words) != count or any(word not in _SPINS for word in words):
        raise InputError(f"usual, reversed, or {count} spins, each ccw or cw; not {text!r}")
    return [_SPINS[word] for word in words]


def imu_position(text: str) -> tuple[float, float, float]:
    """Three lengths in m: forward, right and down.

    Raises:
        InputError: they are not.
    """
    words = _words(text)
    if len(words) != 3:
        raise InputError("three lengths in m: forward, right and down, such as 0.02 0 -0.03")
    x, y, z = (_number(word) for word in words)
    if max(abs(x), abs(y), abs(z)) > MOST_ARM:
        raise InputError("enter the position of the IMU in m")
    return x, y, z


def prior(text: str) -> tuple[str, float, float]:
    """NAME=VALUE+-STD; ± and +/- do as well.

    Raises:
        InputError: it is something else.
    """
    words = split_prior(text)
    if words is None:
        raise InputError(f"must be NAME=VALUE+-STD, not {text!r}")
    name, value, std = words
    return name, _number(value), positive_number(std)
