"""Where a chain's records come from, and what that adds to its results."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.results.result import Result
from gcs_sysid.session.clock_check import ClockDoubt, clock_doubt
from gcs_sysid.session.reported_layout import ReportedLayout, differences, notes, reported_layout
from gcs_sysid.telemetry.imu_loss import loss_reason
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
        return clock_doubt(self.telemetry.drift, self.telemetry.parameters)

    def airframe_problems(self, airframe: Airframe) -> tuple[str, ...]:
        """What the airframe says otherwise than the vehicle; empty where they agree."""
        reported = self._layout
        return () if reported is None else differences(airframe, reported)

    def complete(
        self, result: Result, airframe: Airframe, events: Sequence[dict[str, Any]]
    ) -> Result:
        """A chain's result with its source, vehicle and telemetry, and what these object to.

        Args:
            result: by the records alone.
            airframe: that it was made with.
            events: of the telemetry, as in a result.
        """
        result = self._with_clock(result)
        vehicle = self.telemetry.vehicle
        reasons = result.reasons
        if vehicle is None:
            others = ", ".join(map(str, self.telemetry.systems))
            heard = f"; found: {others}" if others else ""
            which = " the requested" if self.wanted else " any"
            reasons = (f"no heartbeat of{which} autopilot received{heard}",)
        elif result.verdict != "identified":
            reasons = (*reasons, *self.telemetry.problems)
        telemetry = {**self.telemetry.as_dict(), **result.telemetry}
        reported = self._layout
        if reported is not None:
            wrong = differences(airframe, reported)
            telemetry["layout"] = {
                **reported.as_json(),
                "differences": [*wrong],
                "notes": [*notes(airframe, reported)],
            }
            if wrong:
                # All fits assumed other rotor positions.
                result, reasons = _without_numbers(result), (*wrong, *reasons)
        loss, serious = loss_reason(telemetry)
        if loss and result.verdict != "refused":
            reasons = (*reasons, loss)
            if serious and result.verdict == "identified":
                result = replace(result, verdict="partial")
        recorded = self.telemetry.recorded
        if recorded is not None and _SENSIBLE[0] <= recorded < _SENSIBLE[1]:
            when = datetime.fromtimestamp(recorded, UTC)
            telemetry["recorded"] = f"{when:%Y-%m-%d %H:%M} UTC"
        return replace(
            result,
            source=self.name,
            reasons=reasons,
            vehicle=vehicle.as_dict() if vehicle else {},
            events=tuple(sorted([*events, *result.events], key=lambda event: event["t"])),
            telemetry=telemetry,
        )

    @property
    def _layout(self) -> ReportedLayout | None:
        """That the vehicle reports by its parameters, as far as received."""
        autopilot = self.autopilot
        return None if autopilot is None else reported_layout(autopilot, self.telemetry.parameters)

    def _with_clock(self, result: Result) -> Result:
        doubt = self.clock_doubt
        if doubt is None or result.verdict == "refused":
            return result
        return replace(
            result,
            verdict="partial",
            reasons=(doubt.reason, *result.reasons),
            telemetry={**result.telemetry, "clock_doubt": doubt.share},
        )


def _without_numbers(result: Result) -> Result:
    """The same, refused: of what is not given nothing is known."""
    parameters = {
        name: e if e.status == "given" else Estimate(None, None, e.unit, "unobservable")
        for name, e in result.parameters.items()
    }
    return replace(result, verdict="refused", parameters=parameters)
