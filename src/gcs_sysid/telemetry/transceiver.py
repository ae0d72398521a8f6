"""A link, the frames it accepts and what may be sent on it: all that touches a vehicle."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from gcs_sysid.telemetry.link import Link
from gcs_sysid.telemetry.outgoing import Gate
from gcs_sysid.telemetry.receiver import ReceivedFrames, Receiver, Rival
from gcs_sysid.telemetry.signing import Refusal, SignatureCheck, Signer, SigningClock, read_key
from gcs_sysid.telemetry.urls import LinkUrl

STATE_SUFFIX = ".time"
"""Added to the key file's name for the time of signatures."""


@dataclass(frozen=True)
class LinkReport:
    """The state of a link, beside its frames.

    Attributes:
        ended: as of `Link`, as are `breaks`, `floods` and `dropped`.
        garbage_bytes: that were part of no frame.
        marks: as of `Receiver`.
        rival: another sender with the vehicle's address.
        passed_over: frames of others with the vehicle's state.
        accepted: frames that are signed with the key; None: there is no key.
        refused: reason -> frames that are not.
        signing_problem: one line about the file of the signatures' time, else "".
    """

    ended: bool = False
    breaks: int = 0
    floods: int = 0
    dropped: int = 0
    garbage_bytes: int = 0
    marks: int = 0
    rival: Rival | None = None
    passed_over: int = 0
    accepted: int | None = None
    refused: dict[Refusal, int] | None = None
    signing_problem: str = ""


class Requests(Protocol):
    """What may be asked of a vehicle: see `outgoing.Gate`, which decides it."""

    version: int

    @property
    def listen_only(self) -> bool:
        """Whether nothing is sent at all."""

    @property
    def signing(self) -> bool:
        """Whether frames are signed."""

    def heartbeat(self) -> bool:
        """As of `Gate`."""

    def set_message_interval(
        self, target: tuple[int, int], message_id: int, interval_us: int, own_us: int = 0
    ) -> bool:
        """As of `Gate`."""

    def get_message_interval(self, target: tuple[int, int], message_id: int) -> bool:
        """As of `Gate`."""

    def request_message_interval(self, target: tuple[int, int], message_id: int) -> bool:
        """As of `Gate`."""

    def request_group(self, target: tuple[int, int], group: int, hertz: int) -> bool:
        """As of `Gate`."""

    def read_parameter(self, target: tuple[int, int], name: str) -> bool:
        """As of `Gate`."""


class Port(Protocol):
    """The port of a ground station, here or in another process."""

    @property
    def url(self) -> LinkUrl:
        """Of the link."""

    @property
    def gate(self) -> Requests:
        """What is to be sent goes here."""

    @property
    def link_report(self) -> LinkReport:
        """As things stand."""

    def follow(self, vehicle: tuple[int, int]) -> None:
        """Answer to this vehicle (sysid, compid) from now on."""

    def close(self) -> None:
        """Give the port back."""


class Transceiver:
    """Receives from a link, and sends what the gate lets pass.

    Args:
        link: open; `close` closes it.
        listen_only: send nothing at all.
        signing_key: file with the key; None: nothing is signed or checked.

    Raises:
        InputError: there is no key in that file.
    """

    def __init__(
        self, link: Link, *, listen_only: bool = False, signing_key: Path | None = None
    ) -> None:
        self._link = link
        self._clock: SigningClock | None = None
        check = signer = None
        if signing_key is not None:
            key = read_key(signing_key)
            state = signing_key.with_name(signing_key.name + STATE_SUFFIX)
            self._clock = SigningClock(state)
            check, signer = SignatureCheck(key, self._clock), Signer(key, self._clock)
        self._receiver = Receiver(link, check)
        self.gate = Gate(link.send, listen_only=listen_only, signer=signer)

    @property
    def url(self) -> LinkUrl:
        """Of the link."""
        return self._link.url

    def receive(self, timeout: float) -> list[ReceivedFrames]:
        """Wait up to `timeout` s for bytes; the accepted frames."""
        return self._receiver.receive(timeout)

    def follow(self, vehicle: tuple[int, int]) -> None:
        """Reply from now on to the address that the vehicle (sysid, compid) sends from."""
        self._receiver.follow(vehicle)

    @property
    def link_report(self) -> LinkReport:
        """As things stand."""
        link, receiver = self._link, self._receiver
        check, whereabouts = receiver.check, receiver.whereabouts
        signing: dict[str, Any] = {}
        if check is not None:
            signing = {"accepted": check.accepted, "refused": dict(check.refused)}
        return LinkReport(
            ended=link.ended,
            breaks=link.breaks,
            floods=link.floods,
            dropped=link.dropped,
            garbage_bytes=receiver.garbage_bytes,
            marks=receiver.marks,
            rival=whereabouts.rival,
            passed_over=whereabouts.passed_over,
            signing_problem=self._clock.problem if self._clock else "",
            **signing,
        )

    def close(self) -> None:
        """Give the link's port back."""
        self._link.close()
        if self._clock is not None:
            self._clock.close()
