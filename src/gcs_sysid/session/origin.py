"""Where a chain's records come from, and what that adds to its results."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from gcs_sysid.judgement.evidence import ClockDoubt, Evidence
from gcs_sysid.judgement.received import clock_doubt
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.results.result import Result
from gcs_sysid.results.words import NO_MAVLINK
from gcs_sysid.session.reported_layout import ReportedLayout, differences, notes, reported_layout
from gcs_sysid.telemetry.logs import Telemetry

_SENSIBLE = (946_684_800.0, 4_102_444_800.0)
"""Unix times of the years 2000 and 2100: a record cannot be from outside."""


@dataclass(frozen=True)
class Origin:
    """The link or log behind a chain's records.

    Attributes:
        telemetry: what it says beside its records.
        name: that results name as their source.
        wanted: system and perhaps component listened to; None: the first autopilot received.
    """

    telemetry: Telemetry
    name: str
    wanted: tuple[int, int | None] | None = None

    @property
    def autopilot(self) -> str | None:
        """The vehicle's kind of autopilot; None until the vehicle is found."""
        vehicle = self.telemetry.vehicle
        return None if vehicle is None else vehicle.key

    @property
    def clock_doubt(self) -> ClockDoubt | None:
        """What the vehicle's clock may be wrong by; None where nothing is to be doubted."""
        drift = self.telemetry.drift
        return clock_doubt(drift.bounds, self.telemetry.parameters, by_gps=drift.by_gps)

    def airframe_problems(self, airframe: Airframe) -> tuple[str, ...]:
        """What the airframe says otherwise than the vehicle; empty where they agree."""
        reported = self._layout
        return () if reported is None else differences(airframe, reported)

    def confirms(self, airframe: Airframe) -> bool:
        """Whether the vehicle reports the rotors that an airframe has."""
        reported = self._layout
        return reported is not None and not differences(airframe, reported)

    def known_to(self, evidence: Evidence) -> Evidence:
        """Evidence with what link or log say."""
        telemetry = self.telemetry
        no_vehicle = ""
        if telemetry.vehicle is None:
            others = ", ".join(map(str, telemetry.systems))
            received = f"; found: {others}" if others else ""
            which = " the requested" if self.wanted else " any"
            no_vehicle = f"no heartbeat of{which} autopilot received{received}"
            if not others and telemetry.as_dict().get("garbage_bytes"):
                no_vehicle += f"; {NO_MAVLINK}"
        return replace(
            evidence,
            clock=self.clock_doubt,
            no_vehicle=no_vehicle,
            layout=self.airframe_problems(evidence.airframe),
            layout_notes=() if self._layout is None else notes(evidence.airframe, self._layout),
            problems=telemetry.problems,
            parameters=telemetry.parameters,
            imu_loss=telemetry.as_dict().get("imu_loss", {}),
        )

    def complete(
        self, result: Result, airframe: Airframe, events: Sequence[dict[str, Any]]
    ) -> Result:
        """A chain's result with its source, vehicle and telemetry."""
        vehicle = self.telemetry.vehicle
        telemetry = {**self.telemetry.as_dict(), **result.telemetry}
        doubt = self.clock_doubt
        if doubt is not None and any(o.by == "clock" for o in result.objections):
            telemetry["clock_doubt"] = doubt.share
        reported = self._layout
        if reported is not None:
            telemetry["layout"] = {
                **reported.as_json(),
                "differences": [*differences(airframe, reported)],
                "notes": [*notes(airframe, reported)],
            }
        recorded = self.telemetry.recorded
        if recorded is not None and _SENSIBLE[0] <= recorded < _SENSIBLE[1]:
            when = datetime.fromtimestamp(recorded, UTC)
            telemetry["recorded"] = f"{when:%Y-%m-%d %H:%M} UTC"
        return replace(
            result,
            source=self.name,
            vehicle=vehicle.as_dict() if vehicle else {},
            events=tuple(sorted([*events, *result.events], key=lambda event: event["t"])),
            telemetry=telemetry,
        )

    @property
    def _layout(self) -> ReportedLayout | None:
        """That the vehicle reports by its parameters, as far as received."""
        autopilot = self.autopilot
        return None if autopilot is None else reported_layout(autopilot, self.telemetry.parameters)
