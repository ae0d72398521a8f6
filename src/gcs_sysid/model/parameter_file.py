"""Files of autopilot parameters as ground stations write them.

QGroundControl: vehicle, component, name, value and MAV_PARAM_TYPE between tabs (.params). Mission
Planner and MAVProxy: name and value between a comma or blanks (.param, .parm). Betaflight and INAV:
"set name = value". Lines that begin with # are comments.
"""

import math
import re
from collections.abc import Mapping
from pathlib import Path

from gcs_sysid.errors import InputError
from gcs_sysid.files import read_text

SUFFIXES = (".params", ".param", ".parm")
REAL32, INT32 = 9, 6
"""MAV_PARAM_TYPE."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}")


def read_parameter_file(path: Path) -> dict[str, float]:
    """Name -> value of a .params, .param or .parm file, or of lines for a CLI.

    Raises:
        InputError: it cannot be read, or a line in it is no parameter.
    """
    found: dict[str, float] = {}
    for number, line in enumerate(read_text(path, "the parameters").splitlines(), 1):
        text = line.strip()
        if not text or text.startswith("#") or text == "save":
            continue
        words = re.split(r"[\s,=]+", text.removeprefix("set "))
        name, value = words[2:4] if len(words) == 5 else (words[0], words[1:2] and words[1])
        if not _NAME.fullmatch(name) or not value:
            raise InputError(f"{path}: line {number} is not a parameter: {text[:60]!r}")
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = math.nan
        if not math.isfinite(found[name]):
            raise InputError(f"{path}: line {number}: {name} is not a number: {str(value)[:40]!r}")
    if not found:
        raise InputError(f"{path}: holds no parameters")
    return found


def parameter_lines(
    values: Mapping[str, float],
    notes: Mapping[str, str],
    suffix: str,
    address: tuple[int, int] = (1, 1),
) -> list[str]:
    """Lines of a file: each parameter below what is said of it.

    An `int` is one of the autopilot's whole numbers: QGroundControl skips what is of another type.

    The suffix ".params" is QGroundControl's, ".txt" has whole numbers for Betaflight's CLI, others
    are Mission Planner's.
    """
    named = suffix == ".params"
    lines = ["# Vehicle-Id Component-Id Name Value Type"] if named else []
    system, component = address
    for name, value in values.items():
        lines += [f"# {name}: {notes[name]}"] if name in notes else []
        if suffix == ".txt":
            lines.append(f"set {name} = {value:.0f}")
        elif named:
            kind = INT32 if isinstance(value, int) else REAL32
            lines.append(f"{system}\t{component}\t{name}\t{value:.9g}\t{kind}")
        else:
            lines.append(f"{name},{value:.9g}")
    return lines
