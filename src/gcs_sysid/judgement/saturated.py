"""A sensor that stood at the limit of its range."""

import math
from collections.abc import Iterator

from gcs_sysid.intervals import Z95
from gcs_sysid.judgement.evidence import Evidence
from gcs_sysid.model.estimate import Objection
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.saturation import Saturated


def saturation_reason(found: Saturated) -> str:
    """What stood at which limit, in one line."""
    limit = f"{found.limit:.1f} m/s^2 ({found.limit / GRAVITY:.1f} g)"
    if found.sensor == "gyro":
        limit = f"{found.limit:.2f} rad/s ({math.degrees(found.limit):.0f} deg/s)"
    return (
        f"the {found.sensor} stands at its limit of {limit} in {100.0 * found.share:.2g} % of its "
        "samples"
    )


def saturated_sensors(evidence: Evidence) -> Iterator[Objection]:
    """What is claimed more closely than the share that a sensor did not measure.

    What is cut off is at least as large as what is left, so that a parameter is off by that share
    and more.
    """
    for found in evidence.saturated:
        names = frozenset(
            name
            for name, estimate in evidence.estimates.items()
            if estimate.value is not None
            and estimate.std is not None
            and Z95 * estimate.std < found.share * abs(estimate.value)
        )
        if names:
            yield Objection(
                saturation_reason(found),
                names,
                cap="weak",
                verdict="partial",
                evidence={"limit": found.limit, "share": found.share},
                how="give it a larger range, damp its mount, or fly gentler",
            )
