"""Is this machine ready: versions, terminal, the folder of recordings."""

import importlib.metadata
import os
import platform
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from gcs_sysid.setup_help.checks import Finding, Sign, can_show

PACKAGE = "gcs-sysid"
_REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+)(?:\[[^\]]*\])?\s*(?:>=\s*([0-9][0-9.]*))?")
_SMALLEST = (80, 24)
"""Columns and lines that the live screen needs."""
_FREE_BYTES = 500 * 2**20
"""A recording at 250 Hz takes some 100 MB an hour."""


def _numbers(version: str) -> tuple[int, ...]:
    """The leading numbers of a version, without trailing zeros: "2.10.0rc1" -> (2, 10)."""
    found = [int(n) for n in re.findall(r"\d+", re.split(r"[^0-9.]", version, maxsplit=1)[0])]
    while found and found[-1] == 0:
        found.pop()
    return tuple(found)


def check_python(version: str = platform.python_version(), requires: str | None = None) -> Finding:
    """Python against what the package asks for.

    Args:
        version: of Python.
        requires: such as ">=3.11"; None: as installed.
    """
    if requires is None:
        try:
            requires = importlib.metadata.metadata(PACKAGE)["Requires-Python"] or ""
        except importlib.metadata.PackageNotFoundError:
            requires = ""
    least = requires.removeprefix(">=").strip()
    text = f"{version} on {platform.system()} {platform.machine()}"
    if _numbers(version) < _numbers(least):
        return Finding(
            "Python", Sign.PROBLEM, f"{text}; {least} or newer is needed",
            ["install it from python.org, and gcs-sysid again with it"],
        )  # fmt: skip
    return Finding("Python", Sign.OK, text)


def _installed_version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def check_packages(
    requirements: Sequence[str] | None = None,
    installed: Callable[[str], str | None] = _installed_version,
) -> Finding:
    """The packages against what this one asks for.

    Args:
        requirements: such as "numpy>=1.26"; None: as installed. Extras are left out.
        installed: the version of a package, None where there is none.
    """
    if requirements is None:
        try:
            requirements = importlib.metadata.requires(PACKAGE) or []
        except importlib.metadata.PackageNotFoundError:
            return Finding(
                "packages", Sign.WARNING, "gcs-sysid runs from its source, without being installed",
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
        return Finding(
            "packages", Sign.PROBLEM, text, [f"{python_command()} -m pip install {asked}"]
        )
    return Finding("packages", Sign.OK, ", ".join(good))


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
) -> Finding:
    """Whether the live screen can be shown here. None: see for yourself."""
    if is_terminal is None:
        is_terminal = sys.stdout.isatty() and sys.stdin.isatty()
    if not is_terminal:
        return Finding(
            "terminal", Sign.WARNING, "this is none (a pipe or a file): live and demo print lines",
            ["run it in a terminal window to see the screen"],
        )  # fmt: skip
    columns, lines = size or shutil.get_terminal_size(_SMALLEST)
    encoding = encoding or sys.stdout.encoding or "ascii"
    term = environment.get("TERM", "")
    words = [f"{columns}x{lines}", encoding.upper(), _colours(environment)]
    advice = []
    if columns < _SMALLEST[0] or lines < _SMALLEST[1]:
        advice.append("make the window larger: the screen needs 80 columns and 24 lines")
    if not can_show("±▲┼█", encoding):
        advice.append(_unicode_advice())
    if term == "dumb":
        words.append("TERM=dumb")
        advice.append("use another terminal, or --headless: this one cannot place text")
    return Finding("terminal", Sign.WARNING if advice else Sign.OK, ", ".join(words), advice)


def _unicode_advice() -> str:
    if os.name == "nt":
        return "use Windows Terminal, or first, in PowerShell: $env:PYTHONUTF8=1"
    return "lines and bars become question marks; first: export LC_ALL=C.UTF-8"


def _colours(environment: Mapping[str, str]) -> str:
    if environment.get("NO_COLOR"):
        return "no colours (NO_COLOR is set)"
    if environment.get("COLORTERM") in ("truecolor", "24bit") or environment.get("WT_SESSION"):
        return "16 million colours"
    if "256" in environment.get("TERM", ""):
        return "256 colours"
    return "colours unknown"


def check_recordings(folder: Path = Path("logs")) -> Finding:
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
            "change to a folder of your own, or name a place: --record FILE.tlog",
            "or leave the recording out: --no-record",
        ]
        return Finding("recordings", Sign.PROBLEM, f"cannot write to {full}: {why}", advice)
    text = f"{full}, {free / 2**30:.1f} GiB free"
    if free < _FREE_BYTES:
        advice = ["make room, or name another place: --record FILE.tlog"]
        return Finding("recordings", Sign.WARNING, f"{text}; an hour takes 0.1 GiB", advice)
    return Finding("recordings", Sign.OK, text)
