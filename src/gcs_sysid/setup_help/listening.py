"""UDP ports usually used, and vehicles found there. Nothing here can send."""

import errno
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from gcs_sysid.errors import LinkError
from gcs_sysid.results.words import NO_MAVLINK
from gcs_sysid.setup_help.checks import VEHICLE, SetupFinding, Sign, quoted
from gcs_sysid.telemetry.frame_block import FrameBlock
from gcs_sysid.telemetry.link import Link, open_link
from gcs_sysid.telemetry.transceiver import Receiver
from gcs_sysid.telemetry.urls import LinkUrl, parse_url
from gcs_sysid.telemetry.vehicles import MavlinkSystem, VehicleSelector

USUAL_PORTS = {
    14550: "ground stations",
    14540: "PX4's port for companions",
    14445: "what QGroundControl forwards",
}
"""UDP port -> what it is for."""


@dataclass
class Ear:
    """A link that is listened to, what is found on it, and how bad it is if there is no vehicle."""

    link: Link
    selector: VehicleSelector
    silent: Sign = Sign.WARNING
    garbage_bytes: int = 0

    @property
    def url(self) -> str:
        """As the user names it."""
        return str(self.link.url)


def open_ears(
    urls: Sequence[LinkUrl], lacking: Sign = Sign.WARNING
) -> tuple[list[Ear], list[SetupFinding]]:
    """Open links to listen on.

    `lacking` is how bad it is that another program has a port, or that nothing comes there.

    Returns:
        Those that could be opened, and a finding on every one.
    """
    ears, findings = [], []
    for url in urls:
        topic = f"UDP {url.port}" if url.kind == "udpin" else str(url)
        use = USUAL_PORTS.get(url.port, "")
        try:
            ears.append(Ear(open_link(url), VehicleSelector(), lacking))
        except LinkError as error:
            findings.append(_not_open(topic, url, error, lacking))
        else:
            findings.append(SetupFinding(topic, Sign.OK, f"free ({use})" if use else "open"))
    return ears, findings


def _not_open(topic: str, url: LinkUrl, error: LinkError, taken: Sign) -> SetupFinding:
    # Windows calls a port that is kept exclusively a matter of permission.
    in_use = getattr(error.__cause__, "errno", None) in (errno.EADDRINUSE, errno.EACCES)
    if not (in_use and url.kind == "udpin" and url.port >= 1024):
        return SetupFinding(topic, Sign.PROBLEM, str(error))
    holder = holder_of_udp_port(url.port)
    advice = [] if holder else [_who_has(url.port)]
    advice += [
        "close that program, or forward to port 14445 and listen there:",
        "QGroundControl: Application Settings, MAVLink, localhost:14445",
        "MAVProxy: output add 127.0.0.1:14445",
    ]
    return SetupFinding(topic, taken, f"in use by {holder or 'another program'}", advice)


def _who_has(port: int) -> str:
    """The command that shows which program has a UDP port."""
    if platform.system() == "Windows":
        return (
            f"who? Get-Process -Id (Get-NetUDPEndpoint -LocalPort {port}).OwningProcess"
            "  (in PowerShell)"
        )
    return f"who? lsof -nP -iUDP:{port}"


def listen(
    ears: Sequence[Ear], seconds: float, clock: Callable[[], float] = time.monotonic
) -> None:
    """Listen for vehicles on all links at once, then close the links."""
    turn = 0.05  # s for all links
    receivers = [(Receiver(ear.link), ear) for ear in ears]
    end = clock() + seconds
    try:
        while receivers and clock() < end:
            for receiver, ear in receivers:
                ear.selector.listen(FrameBlock.of(receiver.poll(turn / len(receivers))))
                ear.garbage_bytes = receiver.garbage_bytes
    finally:
        for ear in ears:
            ear.link.close()


def received(ears: Sequence[Ear], seconds: float) -> list[SetupFinding]:
    """A finding for every vehicle found, with the command to start; and one where none is that was
    to be, or none anywhere.
    """
    findings = []
    for ear in ears:
        several = len(ear.selector.autopilots) > 1
        for vehicle in ear.selector.autopilots:
            count = ear.selector.frames[vehicle.address]
            text = f"{vehicle} on {ear.url}, {count} messages in {seconds:g} s"
            findings.append(
                SetupFinding(VEHICLE, Sign.OK, text, [start_command(vehicle, ear.url, several)])
            )
    silent = [ear for ear in ears if not ear.selector.autopilots]
    if findings:
        silent = [ear for ear in silent if ear.silent is Sign.PROBLEM]
        if not silent:
            return findings
    others = [
        f"{system} on {ear.url}"
        for ear in silent
        for system in ear.selector.systems.values()
        if not system.is_autopilot
    ]
    where = ", ".join(ear.url for ear in silent) or "no port"
    text = f"no vehicle in {seconds:g} s on {where}"
    if others:
        text += f"; no vehicle, but: {', '.join(others)}"
    for ear in silent:
        if ear.garbage_bytes and not ear.selector.systems:
            text += f"; {ear.url}: {NO_MAVLINK}"
    advice = [
        "check that it is powered and sends to this machine (SITL: --out 127.0.0.1:14550)",
        "on a serial port: gcs-sysid doctor /dev/ttyUSB0 --baud 57600",
        "without a vehicle: gcs-sysid demo",
    ]
    waited_for = [ear for ear in silent if ear.silent is Sign.PROBLEM]
    sign = Sign.PROBLEM if waited_for or not ears else Sign.WARNING
    return [*findings, SetupFinding(VEHICLE, sign, text, advice)]


def start_command(vehicle: MavlinkSystem, url: str, several: bool = False) -> str:
    """What to type to identify a vehicle; the size and the mass are for the user to fill in."""
    # The type in its heartbeat gives no order of motors, and for many a hexa not even the number;
    # its parameters do, once they may be requested.
    reported = vehicle.key in ("px4", "ardupilot") and vehicle.rotors != 3
    frame = "--airframe auto --arm M" if reported else "--airframe FILE.toml"
    which = f" --vehicle {vehicle.system}:{vehicle.component}" if several else ""
    return f"gcs-sysid live {quoted(url)} {frame} --mass KG{which}"


def usual_urls() -> list[LinkUrl]:
    """The ports usually used."""
    return [parse_url(f"udpin:0.0.0.0:{port}") for port in USUAL_PORTS]


def holder_of_udp_port(port: int, proc: Path = Path("/proc")) -> str | None:
    """Which program listens on a UDP port: "name (process N)"; None where that is unknown.

    From /proc on Linux, for the user's own programs.
    """
    inodes = set()
    for table in ("udp", "udp6"):
        try:
            lines = (proc / "net" / table).read_text(encoding="ascii").splitlines()[1:]
        except (OSError, ValueError):
            continue
        for line in lines:
            words = line.split()
            if len(words) > 9 and int(words[1].rpartition(":")[2], 16) == port:
                inodes.add(f"socket:[{words[9]}]")
    if not inodes:
        return None
    for process in proc.glob("[0-9]*"):
        try:
            if any(os.readlink(entry) in inodes for entry in (process / "fd").iterdir()):
                name = (process / "comm").read_text(encoding="utf-8", errors="replace").strip()
                return f"{name} (process {process.name})"
        except OSError:  # another user's, or gone meanwhile
            continue
    return None
