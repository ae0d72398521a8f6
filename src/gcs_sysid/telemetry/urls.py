"""Names of links, as MAVProxy and pymavlink users write them."""

import os
import re
from dataclasses import dataclass
from pathlib import Path

from gcs_sysid.errors import InputError
from gcs_sysid.telemetry.log_formats import ANY_SUFFIX

FORMS = (
    "udpin:HOST:PORT (listen), udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT "
    "or a serial device such as /dev/ttyUSB0 or COM3"
)
DEFAULT_BAUD = 115200
_NETWORK_KINDS = {
    "udp": "udpin",  # as in pymavlink
    "tcpout": "tcp",  # as of MAVSDK
    "tcp-l": "tcpin",  # as of MAVROS
    **{kind: kind for kind in ("udpin", "udpout", "tcpin", "tcp")},
}
_SERIAL_KINDS = ("serial", "serial_flowcontrol", "serial-hwfc", "uart")
"""Of MAVSDK, MAVROS and ArduPilot. A port is opened ready to receive, with flow control or not."""
_SENT_TO_MANY = ("mcast", "udpbcast", "udp-b", "udp-pb")
"""Of pymavlink and MAVROS: to all of a group or network, also from here, where one is answered."""
_SERIAL_NAME = re.compile(r"/dev/|/tmp/|COM\d+$|\\\\\.\\COM\d+$", re.IGNORECASE)
_OWN_IDS = re.compile(r"ids=\d+,\d+")
"""Behind a link of MAVROS: its own system and component, which ours are not."""
_RATE_BEHIND = re.compile(r"(.+[^:/\s])[:@\s]\s*(\d{4,})")
"""A device and its baud rate: ports of hubs, which names end in too, have fewer digits."""
_IN_DEV = re.compile(r"(tty|cu\.)\w")
"""Begins names of devices without their folder."""
_ANY_RATE = re.compile(r"/dev/(ttyACM|(cu|tty)\.usbmodem|pts/|ttys\d)")


@dataclass(frozen=True)
class LinkUrl:
    """A link as the user named it, taken apart."""

    kind: str
    """"udpin", "udpout", "tcp", "tcpin" or "serial"."""
    text: str
    host: str = ""
    port: int = 0
    device: str = ""
    baud: int = 0
    baud_chosen: bool = False
    """Whether the user named the baud rate."""

    @property
    def line_rate(self) -> int | None:
        """Baud that limit the link; None on networks and where the rate is a formality.

        USB devices of class ACM (an autopilot's own USB port) and pseudo terminals take any
        rate and are as fast as they are; with a rate named they are taken to stand for a radio.
        """
        if self.kind != "serial" or (not self.baud_chosen and _takes_any_rate(self.device)):
            return None
        return self.baud

    @property
    def sends_first(self) -> bool:
        """Whether the vehicle is silent until it receives something, so that listening alone is in
        vain.
        """
        return self.kind == "udpout"

    def __str__(self) -> str:
        return self.text


def _takes_any_rate(device: str) -> bool:
    real = os.path.realpath(device)  # /dev/serial/by-id/... and socat's names are links
    return bool(_ANY_RATE.match(real))


def parse_url(text: str, baud: int | None = None) -> LinkUrl:
    """Understand a link's name.

    `baud` is that of a serial device that does not name its own as DEVICE,BAUD.

    Raises:
        InputError: one line saying what is wrong with it.
    """
    text = text.strip()
    if not text:
        raise InputError(f"no link given: use {FORMS}")
    if not text.isprintable():
        raise InputError(f"cannot understand the link {text!r}: a name is one line of text")
    is_log = Path(text).suffix.lower() in ANY_SUFFIX
    plain, asked, options = text.partition("?")
    if asked and not (_OWN_IDS.fullmatch(options) or is_log):
        raise InputError(f"{text}: what is behind ? is not understood: write {plain}")
    kind, colon, rest = plain.partition(":")
    kind, slashes, rest = kind.lower(), rest.startswith("//"), rest.removeprefix("//")
    if colon and kind in _NETWORK_KINDS:
        bind, at, remote = rest.partition("@") if slashes else (rest, "", "")
        # MAVROS: udp://[BIND]@[REMOTE]; REMOTE without a host is no address.
        out = at and not bind and remote.partition(":")[0]
        kind, rest = ("udpout", remote) if out else (_NETWORK_KINDS[kind], bind or remote)
        if slashes and bind.startswith(":") and kind in ("udpin", "tcpin"):
            rest = f"0.0.0.0{rest}"  # as of MAVSDK: on any address
        host, port = _host_and_port(rest.partition("/")[0] if slashes else rest, text, kind)
        return LinkUrl(kind, text, host, port)
    if colon and kind in _SENT_TO_MANY:
        raise InputError(
            f"{text}: links to many at once are not understood: have the vehicle or a forwarder "
            "(mavproxy.py --master=LINK --out=127.0.0.1:14550) send to this computer, then use "
            "udpin:0.0.0.0:14550"
        )
    if is_log:
        raise InputError(f"{text} is a log, not a link: use gcs-sysid analyze {text}")
    own_text = rest if kind in _SERIAL_KINDS and colon else plain
    device, comma, own_baud = own_text.partition(",")
    if not comma and (rate := _RATE_BEHIND.fullmatch(device)) is not None:
        device, comma, own_baud = rate[1], ":", rate[2]  # as MAVSDK, MAVROS and Windows write it
    if _IN_DEV.match(device):
        device = f"/dev/{device}"
    if _SERIAL_NAME.match(device) or Path(device).is_char_device():
        if comma:
            if not own_baud.isdecimal():
                raise InputError(f"{text}: the baud rate must be a number, not {own_baud!r}")
            baud = int(own_baud)
        if baud is not None and baud <= 0:
            raise InputError(f"{text}: the baud rate must be positive, not {baud}")
        return LinkUrl(
            "serial",
            text,
            device=device,
            baud=DEFAULT_BAUD if baud is None else baud,
            baud_chosen=baud is not None,
        )
    if plain.isdecimal() or (colon and plain.count(":") == 1 and rest.isdecimal()):
        host, port = _host_and_port(plain, text, "udpin")
        return LinkUrl("udpin", text, host, port)  # as in pymavlink
    raise InputError(f"cannot understand the link {text!r}: use {FORMS}")


def _host_and_port(text: str, whole: str, kind: str) -> tuple[str, int]:
    host, colon, port_text = text.rpartition(":")
    if not colon or not host:
        # What is left out never opens a port to the world.
        port_text = port_text if port_text.isdecimal() else "14550"
        such = f"{kind}:127.0.0.1:{port_text}"
        if kind in ("udpin", "tcpin"):
            such = f"{kind}:0.0.0.0:{port_text}, from this computer alone {such}"
        raise InputError(f"{whole}: write the link as KIND:HOST:PORT, such as {such}")
    if not port_text.isdecimal() or not 0 < int(port_text) < 65536:
        raise InputError(f"{whole}: the port must be a number from 1 to 65535, not {port_text!r}")
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
        if not host:
            raise InputError(f"{whole}: no address between the brackets")
    elif ":" in host:
        raise InputError(f"{whole}: write an IPv6 address in brackets, as udpin:[::1]:14550")
    return host, int(port_text)
