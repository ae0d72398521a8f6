"""Objections by the data themselves: what is missing, and what link or log say of it.

Everything depends on the vehicle's clock: angular acceleration, and with it inertia, has its
relative error. The other clock is the receiving computer's, and where the two drift apart either
may be wrong; or GPS time, in the autopilot's own log. Good clocks hardly drift. A simulator that
does not keep real time does so without being wrong: its clock is that of its physics.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.judgement.evidence import ClockDoubt, Evidence, Received
from gcs_sysid.judgement.imu_faults import gyro_fault
from gcs_sysid.judgement.prediction import is_hover
from gcs_sysid.judgement.status import ROTORS, RULES
from gcs_sysid.model.airframe import ScaleKind
from gcs_sysid.model.estimate import Objection, Verdict
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.signals.records import NEEDED_RATE, Stream
from gcs_sysid.signals.rotor_source_selector import MIN_RATE
from gcs_sysid.signals.rotor_units import is_simulated

NAMED_LOSS = 0.1
"""Share of IMU samples missing from which it is reported: five times what PX4 leaves out."""
TOO_MUCH_LOSS = 0.6
"""The same, from which the verdict is at most `partial`: no study goes beyond a half."""
_ENOUGH_TO_ANSWER = 10.0
"""s of flight in which roll and pitch are seen to answer the rotors, if they do at all."""
TWO_GOOD_CLOCKS = 500.0
"""ppm. Crystals are off by less than 100; a computer's clock that is being set by the network is
slewed by up to 500. What stays below it costs inertia 0.05 %, less than its noise usually does."""
NO_CLOCK = 30_000.0
"""ppm, from which on it is a matter of simulated time. A serial port whose clock is off by 2 to 3 %
is not understood any more."""


def vehicle(evidence: Evidence) -> Iterator[Objection]:
    """No vehicle at all."""
    if evidence.no_vehicle:
        yield Objection(evidence.no_vehicle, verdict="refused")


def layout(evidence: Evidence) -> Iterator[Objection]:
    """Rotors elsewhere than the vehicle has them: all fits assumed other rotor positions."""
    for reason in evidence.layout:
        yield Objection(
            reason,
            frozenset(evidence.estimates),
            cap="unobservable",
            verdict="refused",
            void=True,
        )
    yield from (Objection(note, verdict="identified") for note in evidence.layout_notes)


def estimator(evidence: Evidence) -> Iterator[Objection]:
    """Another estimator was asked for; or there are two that do not agree."""
    if evidence.note and not evidence.no_vehicle:
        yield Objection(evidence.note, verdict="identified")
    estimates = evidence.estimates
    apart = {
        name: share
        for name, share in evidence.apart.items()
        if name in estimates and estimates[name].status != "zero"
    }
    if apart:
        yield Objection(
            f"the online estimate differs by more than chance in {', '.join(apart)}: "
            "intervals hold both",
            frozenset(apart),
            verdict="identified",
            evidence=apart,
        )


def missing_data(evidence: Evidence) -> Iterator[Objection]:
    """What of the data an identification lacks, the first cause alone: the rest follows from it."""
    received, fit = evidence.received, evidence.fit
    if received is None or evidence.no_vehicle:
        return
    if fit.other_layout is not None:
        yield Objection(
            f"{fit.other_layout}: corrected, it would explain the motion far better",
            evidence.names(lambda p: bool(p.axes)),
            cap="unobservable",
            verdict="refused",
            by=ROTORS,
            how="correct the airframe file",
        )
        return
    verdict: Verdict | None = "refused" if fit.rotation is None else None
    cut, still = bool(evidence.saturated), is_hover(evidence)
    for by, flying, reasons in (
        ("data", False, _missing(received, evidence.anchor)),
        ("gyro", False, _misread(evidence)),
        (ROTORS, False, _contradicted(fit)),
        ("data", False, _too_little(received, fit)),
        ("data", True, _unexplained(fit, cut=cut, still=still)),
    ):
        if reasons:
            doubt = received.doubt if verdict else ""
            yield from (
                Objection(reason, verdict=verdict, by=by, how=how, flying=flying and not doubt)
                for reason, how in (*(((doubt, ""),) if doubt else ()), *reasons)
            )
            return


def without_attitude(evidence: Evidence) -> Iterator[Objection]:
    """What was identified, was so without the attitude."""
    received = evidence.received
    if received is not None and evidence.fit.rotation and Stream.ATTITUDE not in received.seen:
        yield Objection(NO_ATTITUDE, verdict="identified")


def problems(evidence: Evidence) -> Iterator[Objection]:
    """What link or log say of themselves."""
    if not evidence.no_vehicle:
        yield from map(Objection, evidence.problems)


def lost_samples(evidence: Evidence) -> Iterator[Objection]:
    """IMU samples that are missing by the vehicle's own stamps."""
    yield from loss_of(*missing_share(evidence.imu_loss))


def loss_of(share: float, longest: float = 0.0) -> Iterator[Objection]:
    """The same of a share that is missing, for so many s at most where that is known."""
    most = f", for {longest:.2f} s at most" if longest else ""
    yield from _unused(
        share,
        f"{100.0 * share:.0f} % of the IMU's samples are missing by their timestamps{most}: the "
        "estimate uses the rest",
    )


def slow_imu(evidence: Evidence) -> Iterator[Objection]:
    """An IMU that comes too slowly: what the vehicle, or a motor that lags, does in between is not
    seen.
    """
    motors = evidence.rotor_input.motors
    too_slow = evidence.interval > 1.0 / MIN_RATE
    if too_slow or (motors and evidence.interval > 1.1 / NEEDED_RATE):
        with_motors = "" if too_slow else " by commands"
        yield Objection(
            f"the IMU comes at {1.0 / evidence.interval:.1f} Hz; identification{with_motors} needs "
            f"{NEEDED_RATE:.0f} Hz",
            evidence.names(lambda p: motors or p.fit in ("rotation", "actuator")),
            cap="weak",
            verdict="refused" if too_slow else "partial",
            how="log or request it faster",
        )


def frozen_samples(evidence: Evidence) -> Iterator[Objection]:
    """IMU samples that measure nothing, though they come."""
    yield from _unused(
        evidence.frozen,
        f"the IMU stands still: {100.0 * evidence.frozen:.0f} % of its samples repeat the one "
        "before in all values, and only the others are used",
        how="check that sensor, and have the one recorded that the autopilot flies by",
    )


def disordered_samples(evidence: Evidence) -> Iterator[Objection]:
    """IMU samples that came after later ones: half of a flight may be passed over for that."""
    yield from _unused(
        evidence.disordered,
        f"{100.0 * evidence.disordered:.0f} % of the IMU's samples came after later ones, or "
        "twice, and are not used",
        how="record where messages keep their order: at the autopilot, or on one link alone",
    )


def _unused(share: float, words: str, how: str = "") -> Iterator[Objection]:
    """A share of the IMU's samples that is not used, where it is large enough to be named."""
    if share >= NAMED_LOSS:
        verdict: Verdict = "partial" if share >= TOO_MUCH_LOSS else "identified"
        yield Objection(words, verdict=verdict, evidence={"share": share}, how=how)


def missing_share(imu_loss: Mapping[str, Any]) -> tuple[float, float]:
    """Share of the IMU's samples that are missing, and the longest gap, s."""
    return 0.01 * imu_loss.get("missing_percent", 0.0), imu_loss.get("longest", 0.0)


NO_ATTITUDE = "no attitude (ATTITUDE or ATTITUDE_QUATERNION): thrust is by the accelerometer alone"
"""What its absence costs; a moment of inertia needs none."""
_Reasons = tuple[tuple[str, str], ...]
"""What is wrong, and what to do."""


def _missing(received: Received, anchor: ScaleKind) -> _Reasons:
    """Why there are no samples, by what came."""
    seen = received.seen
    if not seen:
        if received.recorded is None:
            return (("no usable telemetry", ""),)
        lasts = f"the record lasts {received.recorded:.1f} s"
        return ((f"nothing between --start and --end: {lasts}", ""),)
    if Stream.IMU not in seen:
        return (("no IMU data (HIGHRES_IMU)", "request it from the autopilot"),)
    if not seen & {Stream.ROTOR_SPEED, Stream.ROTOR_COMMAND}:
        none = (
            "no rotor speeds (ESC_STATUS, ESC_TELEMETRY) and no actuator outputs "
            "(ACTUATOR_OUTPUT_STATUS, SERVO_OUTPUT_RAW)"
        )
        return ((none, "request them from the autopilot"),)
    if received.searched and not received.has_rotors:
        return _no_input(received, anchor)
    if received.outdated:
        late = "the autopilot's parameters came too late to set filters and ranges"
        return ((late, "analyze the recording"),)
    return ()


def _misread(evidence: Evidence) -> _Reasons:
    """Why no rotors can match the motion: the gyro does not read it."""
    fault = gyro_fault(evidence.gyro) if evidence.gyro and evidence.fit.rotation is None else None
    return (fault,) if fault else ()


def _contradicted(fit: Fit) -> _Reasons:
    """Why the motion cannot be that of the airframe's rotors."""
    if fit.rotation is None and fit.seconds > _ENOUGH_TO_ANSWER:
        check = "check motor order and rotor positions in the airframe file, and fly roll and pitch"
        return (("the motion does not match these rotors", check),)
    return ()


def _too_little(received: Received, fit: Fit) -> _Reasons:
    """Why there is no fit at all."""
    if fit.rotation is not None:
        return ()
    used = f"only {fit.seconds:.1f} s of {received.flown:.0f} s in the air have all needed data"
    return ((received.input_lost or (used if received.flown else "never seen in the air"), ""),)


def _unexplained(fit: Fit, *, cut: bool, still: bool) -> _Reasons:
    """Why the motion shows too little of the rotors."""
    rotation = fit.rotation
    if rotation is None or still:
        return ()
    least, share = RULES.explained(whitened=rotation.of_steps)[0], rotation.r_squared.min()
    if not share < least:
        return ()
    what = f"the rotors explain only {max(100.0 * share, 0.0):.0f} % of the motion on one axis"
    # Harder inputs would be cut off the more.
    harder = "fly in less wind" if cut else "fly harder inputs or in less wind"
    return ((what, f"check the motor order and each rotor's readings; if right, {harder}"),)


def _no_input(received: Received, anchor: ScaleKind) -> _Reasons:
    """Why no rotor stream can be used."""
    if not received.refused:
        none = "no rotor speeds and no commands in flight"
        return ((none if received.flown else "never seen in the air", ""),)
    reasons = tuple((f"{name} {why}", "") for name, why in received.refused.items())
    if anchor == "k_T":
        scale = "without rotor speeds k_T cannot set the scale"
        return (*reasons, (scale, "give --mass or --t-max"))
    if anchor == "T_max":
        return (*reasons, ("without commands T_max cannot set the scale", "give --mass or --k-t"))
    return reasons


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
