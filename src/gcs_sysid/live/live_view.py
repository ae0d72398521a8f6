"""The pictures that a live session shows of itself."""

from dataclasses import replace

from gcs_sysid.judgement.judge import object_to
from gcs_sysid.live.backlog import Backlog
from gcs_sysid.live.reception import Source
from gcs_sysid.model.estimate import Objection
from gcs_sysid.results.history import Acceleration
from gcs_sysid.results.result import Result
from gcs_sysid.results.snapshot import Advice, FoundVehicle, LinkState, LinkStatus, Snapshot
from gcs_sysid.session.chain import Chain
from gcs_sysid.telemetry.ground_station import GroundStation
from gcs_sysid.telemetry.intake import Intake

RESULT_EVERY = 1.0
"""s of the vehicle's clock between results that are passed on."""


def link_status(
    state: LinkState, source: Source, station: GroundStation, intake: Intake, *, too_slow: bool
) -> LinkStatus:
    """Figures of the moment.

    Args:
        state: of the link.
        source: where the data come from.
        station: that asks.
        intake: that counts.
        too_slow: whether the session cannot keep up.
    """
    health, monitor = intake.health(), intake.monitor
    chosen = None if intake.vehicle is None else intake.vehicle.address
    return LinkStatus(
        state=state,
        url=str(source.url),
        vehicle=str(intake.vehicle or ""),
        rates=health.rates,
        asked=dict(station.asked),
        received=health.received,
        rejected=health.rejected,
        unknown=health.unknown,
        lost_percent=health.lost_percent,
        lost=monitor.lost,
        gaps=monitor.gap_count,
        last_gap=monitor.gaps[-1][1] if monitor.gaps else None,
        clock_ppm=intake.drift.ppm,
        vehicles=tuple(
            FoundVehicle(v.address, str(v), v.address == chosen) for v in intake.selector.autopilots
        ),
        recording=source.recording_report.path,
        bytes_per_second=health.bytes_per_second,
        waiting=source.waiting,
        too_slow=too_slow,
        dropped=source.link_report.dropped,
    )


def with_link(
    result: Result, source: Source, station: GroundStation, backlog: Backlog, now: float
) -> Result:
    """A result with what only the link knows; the numbers stay those of the frames alone."""
    telemetry = {**result.telemetry, **station.as_dict(), "receiver": backlog.as_dict(now)}
    dropped = source.recording_report.dropped
    if dropped:
        telemetry["recording"] = {"missing": dropped}
    said = (
        *(Objection(problem, by="link") for problem in station.problems),
        *(Objection(reason, verdict="identified", by="receiver") for reason in backlog.reasons),
    )
    return replace(object_to(result, said), telemetry=telemetry)


def picture(
    chain: Chain,
    result: Result,
    link: LinkStatus,
    acceleration: Acceleration | None,
    target: float,
    advice: Advice | None,
) -> Snapshot:
    """State of a chain, with the link's and the recorder's."""
    sampler = chain.sampler
    return Snapshot(
        t=chain.t,
        used_seconds=chain.used_seconds,
        flying=sampler.flying,
        result=result,
        history=chain.history,
        link=link,
        attitude=sampler.attitude,
        rates=sampler.rates,
        rotor_speeds=sampler.rotor_speeds,
        acceleration=acceleration,
        target=target,
        events=chain.events,
        advice=advice,
    )
