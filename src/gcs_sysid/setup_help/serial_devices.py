"""Serial devices, and whether this user may open them."""

import os
import platform
import stat
from collections.abc import Sequence

from gcs_sysid.setup_help.checks import Finding, Sign
from gcs_sysid.telemetry.link import SerialDevice

_TOPIC = "serial"
_GROUPS = ("dialout", "uucp")
"""Who owns serial ports: Debian and most others; Arch."""


def check_serial(devices: Sequence[SerialDevice], system: str = platform.system()) -> list[Finding]:
    """One finding for each device, or one for there being none.

    Args:
        devices: that are plugged in.
        system: "Linux", "Darwin" or "Windows".
    """
    if not devices:
        text = "no serial device is plugged in (a network needs none)"
        missing = missing_group(_usual_group()) if system == "Linux" else None
        advice = _permission_lines(missing) if missing else [_how_named(system)]
        return [Finding(_TOPIC, Sign.WARNING if missing else Sign.OK, text, advice)]
    return [_judge(device, system) for device in devices]


def _judge(device: SerialDevice, system: str) -> Finding:
    kind = device.description or ("USB" if device.usb else "a port of the board")
    topic = f"{_TOPIC} {device.name}"
    start = _start_command(device.name)
    if system != "Linux":
        # Nothing to be allowed there: a port that cannot be opened is taken.
        return Finding(topic, Sign.OK, kind, [start, _how_named(system)])
    if os.access(device.name, os.R_OK | os.W_OK):
        return Finding(topic, Sign.OK, f"{kind}, may be opened", [start])
    sign = Sign.PROBLEM if device.usb else Sign.WARNING
    advice = _permission_lines(_owning_group(device.name))
    return Finding(topic, sign, f"{kind}, no permission to open it", advice)


def _start_command(name: str) -> str:
    """An autopilot's own USB port takes any rate; telemetry radios have 57600 as they come."""
    own = "ttyACM" in name or "usbmodem" in name
    return f"gcs-sysid live {name}{'' if own else ' --baud 57600'} --airframe FILE.toml"


def _how_named(system: str) -> str:
    if system == "Windows":
        return "ports are COM3 and so on (Device Manager); access denied: another has it"
    if system == "Darwin":
        return "take the name with /dev/cu., not /dev/tty.; close other programs"
    return "/dev/ttyACM0 would be an autopilot's USB port, /dev/ttyUSB0 a radio"


def _permission_lines(group: str | None) -> list[str]:
    if group is None:
        return ["ask the administrator of this machine for access to serial ports"]
    if _in_group_since_login(group):
        return [f"you joined the group {group} since you logged in: log out and in again"]
    return [f"sudo usermod -aG {group} $USER", "then log out and in again"]


def _owning_group(device: str) -> str | None:
    """The group whose members may open a device; None where that is nobody to join."""
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
