"""What a page asks for, checked before a process is started for it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

from gcs_sysid.argument_types import GivenName, Measured, parse_given
from gcs_sysid.errors import InputError, printable
from gcs_sysid.files import reject_unknown
from gcs_sysid.model.airframe import ANCHORS, Airframe, AnchorName, builtin_names, parse_airframe

Kind = Literal["log", "builtin", "rotors", "file"]
RESULT, REPORT, PICTURE = "result.json", "report.html", "health.svg"
"""Files that an analysis leaves in its folder."""
_MOST_NAME = 120
"""Characters of a file's name that are kept."""
_MEANING: dict[GivenName, str] = {
    "mass": "mass (kg)",
    "k_T": "k_T (N s²)",
    "T_max": "T_max (N)",
    "arm": "arm (m)",
}


@dataclass(frozen=True)
class AnalysisRequest:
    """Airframe and scale for one log.

    Attributes:
        kind: where the airframe comes from.
        name: of a built-in airframe, or of the file.
        text: of the file.
        drawn: the airframe of the picture.
        arm: m, mean distance of the rotors from the center; None: as the airframe has it.
        scale: what sets it, and its value in SI; None: the airframe's own.
    """

    kind: Kind
    name: str = ""
    text: str = ""
    drawn: Airframe | None = None
    arm: Measured | None = None
    scale: tuple[AnchorName, Measured] | None = None


def parse_request(document: object) -> AnalysisRequest:
    """A page's request.

    Raises:
        InputError: it is none, in one line.
    """
    table = _table(document, "request", {"airframe", "arm", "scale"})
    airframe = _table(table.get("airframe"), "airframe", {"kind", "name", "text", "rotors"})
    kind: Kind | None = next((k for k in get_args(Kind) if k == airframe.get("kind")), None)
    if kind is None:
        raise InputError(f"airframe: kind must be one of {', '.join(get_args(Kind))}")
    name = short_text(airframe.get("name", ""), "airframe: name", _MOST_NAME)
    if kind == "builtin" and name not in builtin_names():
        raise InputError(f"no built-in airframe {name!r}: choose one from the list")
    drawn = None
    if kind == "rotors":
        picture = {"name": "drawn", "rotor": airframe.get("rotors")}
        drawn = parse_airframe(picture, "the picture")
    arm = table.get("arm")
    return AnalysisRequest(
        kind,
        name or "airframe.toml",
        short_text(airframe.get("text", ""), "airframe: text", 60_000),
        drawn,
        None if arm in (None, "") else _number(arm, "arm"),
        _scale(table.get("scale")),
    )


def file_name(text: str) -> str:
    """The name of an uploaded file, harmless and short; never a path.

    Raises:
        InputError: nothing is left of it.
    """
    name = printable(text.replace("\\", "/").rpartition("/")[2]).strip()
    if not name or name.strip(".") == "":
        raise InputError("a file needs a name")
    stem, dot, suffix = name.rpartition(".")
    return f"{stem[: _MOST_NAME - 10]}{dot}{suffix[:9]}" if dot else name[:_MOST_NAME]


def _scale(entry: object) -> tuple[AnchorName, Measured] | None:
    if entry is None:
        return None
    table = _table(entry, "scale", {"name", "value"})
    for name in ANCHORS:
        if table.get("name") == name:
            return name, _number(table.get("value"), name)
    raise InputError(f"scale: name must be one of {', '.join(ANCHORS)}")


def _table(value: object, what: str, known: set[str]) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise InputError(f"{what}: must be a JSON object")
    reject_unknown(value, known, what)
    return value


def short_text(value: object, what: str, most: int) -> str:
    """Text of so many characters at most.

    Raises:
        InputError: it is none.
    """
    if not isinstance(value, str) or len(value) > most:
        raise InputError(f"{what}: must be text of at most {most} characters")
    return value


def _number(value: object, name: GivenName) -> Measured:
    text = short_text(str(value) if isinstance(value, int | float) else value, name, 40)
    return parse_given(name, text, _MEANING[name])
