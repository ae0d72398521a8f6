"""A ground station on a link: what it sends to a vehicle, and which frames it accepts.

Everything here depends on when things happen. Only accepted frames reach the estimate, which is why
the analysis of a recording ends with the live session's numbers.
"""

from pathlib import Path
from typing import Any

from gcs_sysid.errors import authority
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.parameter_requests import ParameterRequests
from gcs_sysid.telemetry.requests import StreamRequests
from gcs_sysid.telemetry.signing import Refusal
from gcs_sysid.telemetry.transceiver import Port, Rival
from gcs_sysid.telemetry.wanted_streams import StreamRestoration

_REFUSED = {
    Refusal.UNSIGNED: "unsigned frames are rejected, because a signing key is set",
    Refusal.WRONG_KEY: "frames signed with another key, or altered, are rejected",
    Refusal.REPLAYED: "repeated frames are rejected: their signing time is not new",
    Refusal.TOO_OLD: "frames are rejected until the vehicle has this tool's signing time",
}


class GroundStation:
    """Asks a vehicle for what is needed.

    Args:
        port: to receive from and send through; `close` closes it.
        rotors: how many the airframe has.
        rate: Hz wished for IMU and rotors.
        connects_once: whether a connection that is closed means that the sender has finished.
        state_folder: where the rates to restore are kept, see `wanted_streams`; None: nowhere.

    Attributes:
        lost: whether a vehicle received before is silent now, or the link is gone.
        received_at: when the vehicle last sent; None before.
    """

    LOST_AFTER = 3.0
    """s of silence after which the link counts as lost."""

    def __init__(
        self,
        port: Port,
        rotors: int,
        rate: float,
        *,
        connects_once: bool = False,
        state_folder: Path | None = None,
    ) -> None:
        self.lost = False
        self.received_at: float | None = None
        self._port = port
        self._connects_once = connects_once
        restoration = StreamRestoration(port.gate, rotors, state_folder, str(port.url))
        self._streams = StreamRequests(port.gate, rate, restoration, rotors, port.url.line_rate)
        self._parameters = ParameterRequests(port.gate, rotors)
        self._events = restoration.events
        self._reported: set[str] = set()
        self._followed: tuple[int, int] | None = None
        self._reboots = 0
        self._from_vehicle = 0
        self._breaks = 0
        self._floods = 0

    @property
    def asked(self) -> dict[str, float]:
        """Message name -> Hz asked for."""
        return self._streams.asked

    def follow(self, now: float, intake: Intake) -> None:
        """See what the latest frames mean for whom to answer. Call it after all that came.

        Args:
            now: any steady clock, s.
            intake: has taken the frames.
        """
        vehicle = intake.vehicle
        if vehicle is not None and vehicle.address != self._followed:
            self._followed = vehicle.address
            self._port.follow(vehicle.address)
        reboots = intake.decoder.clock.reboots
        if reboots != self._reboots:
            self._reboots = reboots
            self._streams.reboot()
        report, url = self._port.link_report, self._port.url
        if report.breaks != self._breaks:
            self._breaks = report.breaks
            if self._connects_once:
                self._events.append(f"{url}: the sender has finished")
            else:
                self._events.append(
                    f"{url} was closed by the other side or unplugged: waiting for it to return"
                )
                self.lost = True
        if report.floods != self._floods:
            self._floods = report.floods
            self._events.append(f"{url} is flooded by other senders: the vehicle is read first")
        from_vehicle = intake.monitor.from_vehicle
        if from_vehicle != self._from_vehicle:
            self._from_vehicle = from_vehicle
            if self.lost and self.received_at is not None:
                self._events.append(f"link back after {now - self.received_at:.1f} s")
                self._streams.reboot()
                self._parameters.again()
            self.lost = False
            self.received_at = now
        elif (
            not self.lost
            and self.received_at is not None
            and now - self.received_at > self.LOST_AFTER
        ):
            self._events.append(f"link lost: no data from {vehicle} for {self.LOST_AFTER:.0f} s")
            self.lost = True

    def tick(self, now: float, intake: Intake) -> None:
        """Send what is due. Call it a few times a second."""
        monitor = intake.monitor
        self._streams.tick(
            now,
            intake.vehicle,
            monitor.rates(),
            intake.turning,
            (monitor.lost, monitor.sent),
            intake.intervals,
            intake.parameters.get("SCHED_LOOP_RATE"),
            intake.motor_order.outputs,
        )
        self._parameters.tick(now, intake.vehicle, intake.parameters)
        report = self._port.link_report
        if report.marks:
            self._report_once("ignored a reset received over the link: only the user may reset")
        if report.rival is not None:
            self._report_once(_rival_text(report.rival))
        for refusal in report.refused or ():
            self._report_once(f"signing: {_REFUSED[refusal]}")
        if report.signing_problem:
            self._report_once(report.signing_problem)

    def _report_once(self, text: str) -> None:
        if text not in self._reported:
            self._reported.add(text)
            self._events.append(text)

    def take_events(self) -> list[str]:
        """Events since this was last asked, one line each."""
        events = list(self._events)
        self._events.clear()
        return events

    @property
    def problems(self) -> tuple[str, ...]:
        """Why the link brings too little to identify anything, one line each."""
        report = self._port.link_report
        lines = [self._streams.problem] if self._streams.problem else []
        if report.refused and not report.accepted:
            reasons = ", ".join(f"{n} {reason}" for reason, n in sorted(report.refused.items()))
            lines.append(f"no frame is signed with this key; rejected: {reasons}")
        if report.rival is not None:
            lines.append(_rival_text(report.rival))
        return tuple(lines)

    def as_dict(self) -> dict[str, Any]:
        """For the result's `telemetry`: senders refused; empty when all were accepted."""
        report = self._port.link_report
        out: dict[str, Any] = {}
        if report.refused is not None:
            refused = {reason.value: report.refused.get(reason, 0) for reason in Refusal}
            out["signing"] = {"accepted": report.accepted, "refused": refused}
        if report.rival is not None:
            out["two_senders"] = {
                "believed": authority(*report.rival.address),
                "other": authority(*report.rival.other),
                "passed_over": report.passed_over,
            }
        return out

    def leave(self) -> None:
        """Give the vehicle its own rates back: another one will be followed."""
        self._streams.close()

    def close(self) -> None:
        """Give the vehicle its own rates back, and the port too."""
        self._streams.close()
        self._port.close()


def _rival_text(rival: Rival) -> str:
    """Another sender with the vehicle's address, as text."""
    system, component = rival.vehicle
    believed, other = authority(*rival.address), authority(*rival.other)
    return (
        f"two senders use the address {system}:{component}: {believed}, taken as the vehicle, and "
        f"{other}; unless both are its links, one forges its messages, which signing prevents"
    )
