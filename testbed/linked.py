"""A chain and the link that feeds it, as a live session joins them, without a session."""

from gcs_sysid.model.airframe import Airframe
from gcs_sysid.session.chain import Chain, ChainOptions
from gcs_sysid.session.origin import Origin
from gcs_sysid.telemetry.intake import FrameGathering, Intake


def linked(airframe: Airframe, options: ChainOptions | None = None) -> tuple[Chain, FrameGathering]:
    """A chain, and what gives it the records of a link's frames."""
    intake = Intake()
    chain = Chain(airframe, options, origin=Origin(intake, ""))
    return chain, FrameGathering(intake, lambda: chain.until_tick)
