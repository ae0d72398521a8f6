"""Objections by the vehicle's clock, which may be wrong.

Everything depends on it: angular acceleration, and with it inertia, has its relative error. The
other clock is the receiving computer's, and where the two drift apart either may be wrong; or GPS
time, in the autopilot's own log.
Good clocks hardly drift. A simulator that does not keep real time does so without being wrong: its
clock is that of its physics.
"""

from collections.abc import Iterator, Mapping

from gcs_sysid.judgement.evidence import ClockDoubt, Evidence
from gcs_sysid.model.estimate import Objection
from gcs_sysid.model.parameters import REGISTRY

TWO_GOOD_CLOCKS = 500.0
"""ppm. Crystals are off by less than 100; a computer's clock that is being set by the network is
slewed by up to 500. What stays below it costs inertia 0.05 %, less than its noise usually does."""
NO_CLOCK = 30_000.0
"""ppm, from which on it is a matter of simulated time. A serial port whose clock is off by 2 to 3 %
is not understood any more."""


def clock_doubt(
    bounds: tuple[float, float] | None, parameters: Mapping[str, float], *, by_gps: bool = False
) -> ClockDoubt | None:
    """What is to be doubted; None where nothing is.

    Args:
        bounds: ppm between which the vehicle's clock drifts against the receiving computer's;
            None: not known.
        parameters: of the autopilot, as far as they are known.
        by_gps: whether the other clock is GPS time.
    """
    if bounds is None or (bounds[0] <= TWO_GOOD_CLOCKS and bounds[1] >= -TWO_GOOD_CLOCKS):
        return None
    ppm = 0.5 * sum(bounds)
    if abs(ppm) >= NO_CLOCK or is_simulated(parameters):
        return None
    return ClockDoubt(1e-6 * ppm, by_gps)


def is_simulated(parameters: Mapping[str, float]) -> bool:
    """Whether it is a simulator, by parameters that only simulators have.

    Where PX4's firmware can simulate its vehicle, it answers for SIH_MASS in real flight as well.
    """
    if any(name.startswith("SIM_") for name in parameters):
        return True
    if "SIH_MASS" not in parameters:
        return False
    # SYS_AUTOSTART of vehicles that PX4 simulates on a computer.
    low, high = 10_000.0, 20_000.0
    # SYS_HITL: PX4 simulates its own vehicle.
    on_board = parameters.get("SYS_HITL") == 2.0
    return on_board or low <= parameters.get("SYS_AUTOSTART", 0.0) < high


def wrong_clock(evidence: Evidence) -> Iterator[Objection]:
    """Two clocks that drift apart: all that needs one is uncertain by as much."""
    doubt = evidence.clock
    if doubt is None:
        return
    widening = {}
    for name in evidence.estimates:
        clock = REGISTRY[name].clock
        sized = evidence.estimates.get(clock.of or name)
        if clock.power and sized is not None and sized.value is not None:
            widening[name] = abs(doubt.share) * clock.power * abs(sized.value)
    yield Objection(
        doubt.reason,
        frozenset(widening),
        verdict="partial",
        widening=widening,
        evidence={"share": doubt.share},
        how=doubt.how,
    )
