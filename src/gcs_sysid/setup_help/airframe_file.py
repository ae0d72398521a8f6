"""An airframe file from answers: its text, and its way to the disk."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import (
    ANCHORS,
    Airframe,
    AnchorName,
    Rotor,
    RotorInput,
    parse_airframe,
)
from gcs_sysid.setup_help.layouts import place_of

_ANCHOR_WORDS: dict[AnchorName, str] = {
    "mass": "weighed, ready to fly, with battery",
    "k_T": "thrust of a rotor over the square of its speed",
    "T_max": "thrust of a rotor at full command",
}


@dataclass(frozen=True)
class AirframeAnswers:
    """What a user tells of a vehicle.

    Attributes:
        name: any text of one line.
        rotors: in motor order.
        origin: where the rotors come from, in words, for a comment; may be empty.
        scale: what sets it, with its SI value; None: to be given on the command line.
        rotor_input: which telemetry carries the rotors' inputs.
        imu_position: m, forward, right and down from the centre; None: not known.
        priors: parameter -> value and standard deviation, SI.
    """

    name: str
    rotors: tuple[Rotor, ...]
    origin: str = ""
    scale: tuple[AnchorName, float] | None = None
    rotor_input: RotorInput = "auto"
    imu_position: tuple[float, float, float] | None = None
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def airframe_text(answers: AirframeAnswers) -> str:
    """The file: TOML with units as comments. `checked` says whether it can be used."""
    lines = [f"# {answers.origin}"] if answers.origin else []
    lines.append(f"name = {json.dumps(answers.name, ensure_ascii=False)}")
    if answers.scale is not None:
        anchor, value = answers.scale
        lines.append(f"{anchor} = {value!r}  # {ANCHORS[anchor]}, {_ANCHOR_WORDS[anchor]}")
    lines.append(f'rotor_input = "{answers.rotor_input}"')
    if answers.imu_position is not None:
        x, y, z = (_metres(value) for value in answers.imu_position)
        lines += ["", "[imu]"]
        lines.append(f"position = [{x}, {y}, {z}]  # m, forward, right and down from the centre")
    for number, rotor in enumerate(answers.rotors, 1):
        spin = "ccw" if rotor.spin > 0 else "cw"
        lines += ["", f"[[rotor]]  # motor {number}, {place_of(rotor.x, rotor.y)}"]
        lines.append(f"x = {_metres(rotor.x)}  # m forward")
        lines.append(f"y = {_metres(rotor.y)}  # m to the right")
        lines.append(f'spin = "{spin}"')
    if answers.priors:
        lines += ["", "[prior]  # value and standard deviation, SI"]
        lines += [f"{name} = [{value!r}, {std!r}]" for name, (value, std) in answers.priors.items()]
    return "\n".join(lines) + "\n"


def _metres(value: float) -> str:
    """To a micrometre; adding zero makes 0 of -0."""
    return repr(round(value, 6) + 0.0)


def checked(text: str, where: str) -> Airframe:
    """The airframe that a text makes, as the reader of files sees it.

    Raises:
        InputError: it makes none.
    """
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{where}: not valid TOML: {error}") from error
    return parse_airframe(table, where)


def check_new(path: Path) -> None:
    """See beforehand whether a file can be written.

    Raises:
        InputError: there is one of that name already, or no folder for it.
    """
    try:
        there, folder = path.exists(), path.parent.is_dir()
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: cannot write: {getattr(error, 'strerror', None) or error}"
        ) from error
    if there:
        raise InputError(f"{path} exists already and is not overwritten")
    if not folder:
        raise InputError(f"{path}: there is no folder {path.parent}")


def write_new(path: Path, text: str) -> None:
    """Write a file that is not there yet.

    Raises:
        InputError: there is one of that name already, or it cannot be written.
    """
    try:
        with path.open("x", encoding="utf-8", newline="\n") as file:
            file.write(text)
    except FileExistsError as error:
        raise InputError(f"{path} exists already and is not overwritten") from error
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot write: {reason}") from error
