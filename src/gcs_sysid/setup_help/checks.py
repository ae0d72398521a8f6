"""Is this machine ready: versions, terminal, serial devices, the folder of recordings."""

import enum
import importlib.metadata
import os
import platform
import re
import shutil
import stat
import sys
import tempfile
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the doctor starts without the packages that it looks for
    from gcs_sysid.telemetry.link import SerialDevice


class Sign(enum.StrEnum):
    """How something stands."""

    OK = "ok"
    WARNING = "warning"
    PROBLEM = "problem"


VEHICLE = "vehicle"
"""Topic of the vehicles that are received."""
_MARKS = {Sign.OK: "✓", Sign.WARNING: "!", Sign.PROBLEM: "✗"}
_PLAIN_MARKS = {Sign.OK: "+", Sign.WARNING: "!", Sign.PROBLEM: "x"}


@dataclass(frozen=True)
class SetupFinding:
    """One thing that was looked at.

    Attributes:
        topic: what it is about, such as "UDP 14550".
        sign: how it stands.
        text: what was found.
        advice: what to do, one line each; commands as they are to be typed.
    """

    topic: str
    sign: Sign
    text: str
    advice: Sequence[str] = ()

    def as_json(self) -> dict[str, Any]:
        """For a machine to read."""
        return asdict(self) | {"advice": list(self.advice)}


def can_show(text: str, encoding: str | None = None) -> bool:
    """Whether an encoding has every character of a text; by default standard output's."""
    try:
        text.encode(encoding or sys.stdout.encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def worst(findings: Iterable[SetupFinding]) -> Sign:
    """The gravest of the signs; ok where there is none."""
    order = list(Sign)
    return max((finding.sign for finding in findings), key=order.index, default=Sign.OK)


def as_text(findings: Iterable[SetupFinding], width: int, *, unicode: bool) -> str:
    """Findings as lines: a mark and a word for the sign, then what was found and what to do.

    Lines keep to `width` columns; advice is kept whole, to be copied.
    """
    marks = _MARKS if unicode else _PLAIN_MARKS
    lines = []
    for finding in findings:
        head = f"{marks[finding.sign]} {finding.sign:<8} "
        said = textwrap.wrap(
            f"{finding.topic}: {finding.text}",
            max(width, 40),
            initial_indent=head,
            subsequent_indent=" " * len(head),
            break_on_hyphens=False,
            break_long_words=False,
        )
        lines += [*said, *(f"{'':{len(head)}}-> {line}" for line in finding.advice)]
    return "\n".join(lines)


PACKAGE = "gcs-sysid"
_REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+)(?:\[[^\]]*\])?\s*(?:>=\s*([0-9][0-9.]*))?")
_SMALLEST = (80, 24)
"""Columns and lines that the live screen needs."""


def _numbers(version: str) -> tuple[int, ...]:
    """The leading numbers of a version, without trailing zeros: "2.10.0rc1" -> (2, 10)."""
    found = [int(n) for n in re.findall(r"\d+", re.split(r"[^0-9.]", version, maxsplit=1)[0])]
    while found and found[-1] == 0:
        found.pop()
    return tuple(found)


def check_python(
    version: str = platform.python_version(), requires: str | None = None
) -> SetupFinding:
    """Python against what the package asks for.

    `requires` is such as ">=3.11"; None: as installed.
    """
    if requires is None:
        try:
            requires = importlib.metadata.metadata(PACKAGE)["Requires-Python"] or ""
        except importlib.metadata.PackageNotFoundError:
            requires = ""
    least = requires.removeprefix(">=").strip()
    text = f"{version} on {platform.system()} {platform.machine()}"
    if _numbers(version) < _numbers(least):
        return SetupFinding(
            "Python", Sign.PROBLEM, f"{text}; {least} or newer is needed",
            ["install it from python.org, then reinstall gcs-sysid"],
        )  # fmt: skip
    return SetupFinding("Python", Sign.OK, text)


def _installed_version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def check_packages(
    requirements: Sequence[str] | None = None,
    installed: Callable[[str], str | None] = _installed_version,
) -> SetupFinding:
    """The packages against what this one asks for.

    Args:
        requirements: such as "numpy>=1.26"; None: as installed. Extras are left out.
        installed: the version of a package, None where there is none.
    """
    if requirements is None:
        try:
            requirements = importlib.metadata.requires(PACKAGE) or []
        except importlib.metadata.PackageNotFoundError:
            return SetupFinding(
                "packages", Sign.WARNING, "gcs-sysid runs from its source tree, not installed",
                ["python -m pip install ."],
            )  # fmt: skip
    good, lacking = [], []
    for requirement in requirements:
        match = _REQUIREMENT.match(requirement)
        if match is None or "extra ==" in requirement:
            continue
        name, least = match.groups()
        version = installed(name)
        if version is None:
            lacking.append((name, least, "is not installed"))
        elif least and _numbers(version) < _numbers(least):
            lacking.append((name, least, f"is {version}, {least} or newer is needed"))
        else:
            good.append(f"{name} {version}")
    if lacking:
        asked = " ".join(f'"{name}>={least}"' if least else name for name, least, _ in lacking)
        text = "; ".join(f"{name} {what}" for name, _, what in lacking)
        return SetupFinding(
            "packages", Sign.PROBLEM, text, [f"{python_command()} -m pip install {asked}"]
        )
    return SetupFinding("packages", Sign.OK, ", ".join(good))


def python_command() -> str:
    """The Python that runs, as one types it."""
    return quoted(sys.executable or "python")


def quoted(path: str) -> str:
    """A path as one types it, in a POSIX shell as in those of Windows."""
    return f'"{path}"' if " " in path else path


def check_terminal(
    *,
    is_terminal: bool | None = None,
    size: tuple[int, int] | None = None,
    encoding: str | None = None,
    environment: Mapping[str, str] = os.environ,
) -> SetupFinding:
    """Whether the live screen can be shown here. None: see for yourself."""
    if is_terminal is None:
        is_terminal = sys.stdout.isatty() and sys.stdin.isatty()
    if not is_terminal:
        return SetupFinding(
            "terminal", Sign.WARNING, "not a terminal (a pipe or a file): live and demo "
            "print lines",
            ["run it in a terminal window to see the screen"],
        )  # fmt: skip
    columns, lines = size or shutil.get_terminal_size(_SMALLEST)
    encoding = encoding or sys.stdout.encoding or "ascii"
    term = environment.get("TERM", "")
    words = [f"{columns}x{lines}", encoding.upper(), _colors(environment)]
    advice = []
    if columns < _SMALLEST[0] or lines < _SMALLEST[1]:
        advice.append("make the window larger: the screen needs 80 columns and 24 lines")
    if not can_show("±▲┼█", encoding):
        advice.append(_unicode_advice())
    if term == "dumb":
        words.append("TERM=dumb")
        advice.append("use another terminal, or --headless: this one cannot position the cursor")
    return SetupFinding("terminal", Sign.WARNING if advice else Sign.OK, ", ".join(words), advice)


def _unicode_advice() -> str:
    if os.name == "nt":
        return "use Windows Terminal, or set, in PowerShell: $env:PYTHONUTF8=1"
    return "lines and bars print as question marks; set: export LC_ALL=C.UTF-8"


def _colors(environment: Mapping[str, str]) -> str:
    if environment.get("NO_COLOR"):
        return "no colors (NO_COLOR is set)"
    if environment.get("COLORTERM") in ("truecolor", "24bit") or environment.get("WT_SESSION"):
        return "16 million colors"
    if "256" in environment.get("TERM", ""):
        return "256 colors"
    return "number of colors unknown"


def check_recordings(folder: Path = Path("logs")) -> SetupFinding:
    """Whether a recording can be written where `live` puts it."""
    place = folder if folder.exists() else folder.parent
    full = folder.resolve()
    try:
        # os.access says yes on Windows where writing then fails.
        with tempfile.TemporaryFile(dir=place):
            pass
        free = shutil.disk_usage(place).free
    except OSError as error:
        why = error.strerror or "no folder"
        advice = [
            "change to a writable folder, or use --record FILE.tlog",
            "or do not record: --no-record",
        ]
        return SetupFinding("recordings", Sign.PROBLEM, f"cannot write to {full}: {why}", advice)
    text = f"{full}, {free / 2**30:.1f} GiB free"
    if free < 500 * 2**20:  # a recording at 250 Hz takes some 100 MB an hour
        advice = ["free some space, or use --record FILE.tlog elsewhere"]
        return SetupFinding("recordings", Sign.WARNING, f"{text}; an hour takes 0.1 GiB", advice)
    return SetupFinding("recordings", Sign.OK, text)


_TOPIC = "serial"
_GROUPS = ("dialout", "uucp")
"""Who owns serial ports: Debian and most others; Arch."""


def check_serial(
    devices: "Sequence[SerialDevice]", system: str = platform.system()
) -> list[SetupFinding]:
    """One finding for each device, or one for there being none."""
    if not devices:
        text = "no serial device (not needed for a network link)"
        missing = missing_group(_usual_group()) if system == "Linux" else None
        advice = _permission_lines(missing) if missing else [_how_named(system)]
        return [SetupFinding(_TOPIC, Sign.WARNING if missing else Sign.OK, text, advice)]
    return [_judge(device, system) for device in devices]


def _judge(device: "SerialDevice", system: str) -> SetupFinding:
    kind = device.description or ("USB" if device.usb else "on-board port")
    topic = f"{_TOPIC} {device.name}"
    start = _start_command(device.name)
    if system != "Linux":
        # Nothing to be allowed there: a port that cannot be opened is taken.
        return SetupFinding(topic, Sign.OK, kind, [start, _how_named(system)])
    if os.access(device.name, os.R_OK | os.W_OK):
        return SetupFinding(topic, Sign.OK, f"{kind}, access allowed", [start])
    sign = Sign.PROBLEM if device.usb else Sign.WARNING
    advice = _permission_lines(_owning_group(device.name))
    return SetupFinding(topic, sign, f"{kind}, no permission to open it", advice)


def _start_command(name: str) -> str:
    """An autopilot's own USB port takes any rate; telemetry radios have 57600 as they come."""
    own = "ttyACM" in name or "usbmodem" in name
    return f"gcs-sysid live {name}{'' if own else ' --baud 57600'} --airframe FILE.toml"


def _how_named(system: str) -> str:
    if system == "Windows":
        return "ports are COM3 and so on (Device Manager); access denied: in use by another program"
    if system == "Darwin":
        return "use /dev/cu.*, not /dev/tty.*; close other programs"
    return "/dev/ttyACM0 is usually the USB port of an autopilot, /dev/ttyUSB0 a radio"


def _permission_lines(group: str | None) -> list[str]:
    if group is None:
        return ["ask the administrator of this machine for access to serial ports"]
    if _in_group_since_login(group):
        return [f"you joined the group {group} since you logged in: log out and in again"]
    return [f"sudo usermod -aG {group} $USER", "then log out and in again"]


def _owning_group(device: str) -> str | None:
    """The group whose members may open a device; None where there is none to join."""
    try:
        import grp

        mode = os.stat(device)
        if not mode.st_mode & stat.S_IRGRP:
            return _usual_group()
        name = grp.getgrgid(mode.st_gid).gr_name
    except (ImportError, OSError, KeyError):
        return _usual_group()
    return _usual_group() if name in ("root", "nogroup") else name


def _usual_group() -> str | None:
    """The group that this system has for serial ports."""
    try:
        import grp
    except ImportError:  # Windows
        return None
    for name in _GROUPS:
        try:
            return grp.getgrnam(name).gr_name
        except KeyError:
            continue
    return None


def missing_group(group: str | None) -> str | None:
    """The group, if this user should join it to open serial ports; else None."""
    try:
        import grp

        if group is None or os.geteuid() == 0:
            return None
        return None if grp.getgrnam(group).gr_gid in (os.getegid(), *os.getgroups()) else group
    except (ImportError, AttributeError, KeyError):
        return None


def _in_group_since_login(group: str) -> bool:
    """Whether the user has joined a group that this session does not know of yet."""
    try:
        import grp
        import pwd

        me = pwd.getpwuid(os.getuid()).pw_name
        return me in grp.getgrnam(group).gr_mem and missing_group(group) is not None
    except (ImportError, KeyError):
        return False
