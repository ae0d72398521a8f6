"""Reasons of a verdict below `identified`."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from gcs_sysid.estimation.parameters.status import RULES
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.scale_reference import ScaleReference
from gcs_sysid.signals.records import Stream
from gcs_sysid.signals.rotor_source_selector import RotorSourceSelector

if TYPE_CHECKING:
    from gcs_sysid.session.chain import Chain

_ENOUGH_TO_ANSWER = 10.0
"""s of flight in which roll and pitch are seen to answer the rotors, if they do at all."""
_MISMATCH = "the motion does not match these rotors"
_CORRECTED = ": corrected, it would explain the motion far better"


def blames_rotors(reason: str) -> bool:
    """Whether a reason is that the airframe's rotors contradict the motion."""
    return reason.startswith(_MISMATCH) or reason.endswith(_CORRECTED)


def data_reasons(chain: "Chain", *, still: bool = False) -> tuple[str, ...]:
    """What is missing, the first cause alone: the rest follows from it.

    Args:
        chain: with what came, and the latest fit.
        still: whether no axis was flown: rotors then explain nothing, even where they are right.
    """
    sampler, fit = chain.sampler, chain.fit
    seen = sampler.seen
    if not seen:
        seconds = sampler.recorded
        if seconds is None:
            return ("no usable telemetry",)
        return (f"nothing between --start and --end: the record lasts {seconds:.1f} s",)
    if Stream.IMU not in seen:
        return ("no IMU data (HIGHRES_IMU): request it from the autopilot",)
    if not seen & {Stream.ROTOR_SPEED, Stream.ROTOR_COMMAND}:
        return (
            "no rotor speeds (ESC_STATUS, ESC_TELEMETRY) and no actuator outputs "
            "(ACTUATOR_OUTPUT_STATUS, SERVO_OUTPUT_RAW): request them from the autopilot",
        )
    if chain.rotors is None and sampler.rotor_selector.judged:
        return _input_reasons(sampler.rotor_selector, chain.anchors[0])
    if chain.outdated:
        return (
            "the autopilot's parameters came too late to set filters and ranges: "
            "analyze the recording",
        )
    if Stream.ATTITUDE not in seen:
        return ("no attitude (ATTITUDE or ATTITUDE_QUATERNION)",)
    if fit.other_layout is not None:
        return (f"{fit.other_layout}{_CORRECTED}",)
    if fit.rotation is None:
        if fit.seconds > _ENOUGH_TO_ANSWER:
            return (
                f"{_MISMATCH}: check motor order and rotor positions in the airframe file, and fly "
                "roll and pitch",
            )
        return (chain.input_lost or "too little flight with all needed data",)
    rotation = fit.rotation
    least, _ = RULES.explained(whitened=bool(rotation.whiteners))
    if not still and rotation.r_squared.min() < least:
        share = max(100.0 * rotation.r_squared.min(), 0.0)
        return (
            f"the rotors explain only {share:.0f} % of the motion on one axis: "
            "fly harder inputs or in less wind, and check the motor order",
        )
    return ()


def limit_by_given(
    by_flight: Mapping[str, Estimate], whole: Mapping[str, Estimate]
) -> tuple[str, ...]:
    """Parameters that the flight determines well enough, but the given values do not.

    Args:
        by_flight: values with the uncertainty of the flight alone.
        whole: the same with that of what was given.
    """
    limited = [n for n, v in by_flight.items() if v.status == "identified" != whole[n].status]
    if not limited:
        return ()
    return (
        f"given values limit {', '.join(limited)}, not the flight: measure rotors, mass and "
        "IMU better and state it in [uncertainty]",
    )


def _input_reasons(rotor_selector: RotorSourceSelector, anchor: ScaleReference) -> tuple[str, ...]:
    """Why no rotor stream can be used."""
    if not rotor_selector.refused:
        return ("no rotor speeds and no commands in flight",)
    reasons = tuple(f"{name} {why}" for name, why in rotor_selector.refused.items())
    kind = anchor.kind
    if kind == "k_T":
        return (*reasons, "without rotor speeds k_T cannot set the scale: give --mass or --t-max")
    if kind == "T_max":
        return (*reasons, "without commands T_max cannot set the scale: give --mass or --k-t")
    return reasons
