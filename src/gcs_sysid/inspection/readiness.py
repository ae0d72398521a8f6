"""Whether a vehicle can be identified from what was found, in a pilot's words."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace

from gcs_sysid.inspection.facts import ONBOARD, Inspection, Obtainable, RotorMessage
from gcs_sysid.inspection.thresholds import THRESHOLDS as LIMITS
from gcs_sysid.judgement.imu_faults import of_sensors
from gcs_sysid.judgement.prediction import is_still
from gcs_sysid.judgement.received import NO_ATTITUDE, loss_of
from gcs_sysid.judgement.status import level_of, on_sound_data
from gcs_sysid.model.estimate import Objection
from gcs_sysid.model.parameters import AXES
from gcs_sysid.results.result_view import names_text
from gcs_sysid.signals.records import ROTOR_STREAMS, Stream
from gcs_sysid.signals.rotor_source_selector import MIN_RATE
from gcs_sysid.telemetry.vehicles import GIVE_MULTIROTOR

_IDENTIFIED_BY_AXIS = {"roll": "Ixx", "pitch": "Iyy", "yaw": "Izz and k_M"}
_ESC_RATE = 100
"""Hz, SERVO_BLH_TRATE that fits identification."""
_PROFILES = {0: "default", 3: "system identification", 4: "high rate"}
_BITS = {
    Stream.ATTITUDE: {0: "fast attitude"},
    Stream.ROTOR_COMMAND: {10: "RCOUT, motor outputs at 10 Hz"},
    Stream.IMU: {18: "fast IMU"},
}
"""Of ArduCopter's LOG_BITMASK."""
_FASTER_BLACKBOX = (
    "log more: on Betaflight raise blackbox_sample_rate (1/2), on INAV set blackbox_rate_denom = 1"
)
_SPEEDS = "log rotor speeds (ESC telemetry): ArduPilot logs outputs at 10 Hz, too slow for inertia"
_FASTER_LINK = (
    "record with gcs-sysid live, which requests the rates, over a fast link (460800 baud, USB, "
    "WiFi), or analyze the autopilot's own log"
)


def objections_to(inspection: Inspection) -> tuple[Objection, ...]:
    """Everything that decides or is worth knowing, the worst first."""
    order = {"blocks": 0, "limits": 1, "note": 2}
    looked_at = _is_multirotor(inspection)
    found = [
        replace(objection, by=by)
        for by, object_to in _PRODUCERS
        if looked_at or by in ("link", "vehicle")
        for objection in object_to(inspection)
    ]
    return tuple(sorted(on_sound_data(found), key=lambda objection: order[level_of(objection)]))


def _is_multirotor(found: Inspection) -> bool:
    return found.vehicle is not None and not found.vehicle.no_multirotor


def _blocks(reason: str, how: str = "") -> Objection:
    return Objection(reason, verdict="refused", how=how)


def _limits(reason: str, how: str = "") -> Objection:
    return Objection(reason, verdict="partial", how=how)


def _note(reason: str, how: str = "") -> Objection:
    return Objection(reason, verdict="identified", how=how)


def _problems(found: Inspection) -> Iterator[Objection]:
    yield from map(_limits, found.problems)


def _vehicle(found: Inspection) -> Iterator[Objection]:
    if found.vehicle is not None:
        if found.vehicle.no_multirotor:
            yield _blocks(found.vehicle.no_multirotor, GIVE_MULTIROTOR)
        return
    names = ", ".join(map(str, found.systems))
    if not found.is_received:
        how = "check the link, its port and its baud rate"
        yield _blocks("no MAVLink message received", how)
    elif any(system.is_autopilot for system in found.systems):
        text = f"the requested vehicle was not found; found: {names}"
        yield _blocks(text, "name one of these with --vehicle")
    else:
        text = f"no autopilot heartbeat; received: {names}"
        yield _blocks(text, "check that it is powered and sends to this link")


def _faster(found: Inspection, *lacking: Stream) -> str:
    """The very settings that log more of some streams: never one that is set already."""
    known = found.parameters
    changes = []
    if found.kind == "ulog":
        changes = _with_bits("SDLOG_PROFILE", known, _PROFILES)
    elif found.kind == "dataflash":
        changes = _limited_rates(known)
        # LOG_FILE_BUFSIZE came when LOG_BITMASK grew beyond 16 bits.
        wide = "LOG_FILE_BUFSIZE" in known or "LOG_BITMASK" not in known
        bits = {k: v for one in lacking for k, v in _BITS.get(one, {}).items() if k < 16 or wide}
        changes += _with_bits("LOG_BITMASK", known, bits)
        rotors = any(one in ROTOR_STREAMS for one in lacking)
        if rotors and known.get("SERVO_BLH_TRATE", _ESC_RATE) < _ESC_RATE:
            changes.append(
                f"SERVO_BLH_TRATE = {_ESC_RATE} (now {known['SERVO_BLH_TRATE']:.0f}) if the ESCs "
                "can send that fast"
            )
        if not changes and rotors:
            return _SPEEDS
    if changes:
        return f"log more: set {', and '.join(changes)}"
    if found.kind == "blackbox" and lacking != (Stream.ATTITUDE,):
        return _FASTER_BLACKBOX
    return "" if found.kind in ONBOARD else _FASTER_LINK


def _limited_rates(known: Mapping[str, float]) -> list[str]:
    """What caps all rates of ArduPilot's backends that write logs on board."""
    backends = int(known.get("LOG_BACKEND_TYPE", 1.0))
    return [
        f"{name} = 0 (no limit; now {known[name]:g} Hz)"
        for bit, name in ((1, "LOG_FILE_RATEMAX"), (4, "LOG_BLK_RATEMAX"))
        if backends & bit and 0.0 < known.get(name, 0.0) < LIMITS.command_rate
    ]


def _with_bits(name: str, known: Mapping[str, float], wanted: Mapping[int, str]) -> list[str]:
    """A mask with the bits that it lacks; of one not recorded or negative (16 bits) these alone."""
    mask = int(known.get(name, 0.0))
    lacking = {bit: words for bit, words in wanted.items() if not mask >> bit & 1}
    if not lacking:
        return []
    bits = " and ".join(f"bit {bit} ({words})" for bit, words in lacking.items())
    if mask < 0 or name not in known:
        return [f"{bits} of {name}"]
    return [f"{name} = {mask | sum(1 << bit for bit in lacking)} (now {mask}), for {bits}"]


def obtainable(found: Inspection) -> Obtainable:
    """Obtainable results: the most that `analyze`, and `health` beside it, would give."""
    if found.verdict != "no":
        little = [axis for axis in found.motion if _is_little(found, axis)]
        misread = any(objection.by == "sensors" for objection in found.objections)
        assumed = found.rotor_input.assumed
        if 0.0 < found.in_air < LIMITS.short or _is_rough(found) or misread or assumed:
            return "in part"
        if not little:
            return "everything"
        return "all but Izz" if little == ["yaw"] else "in part"
    if found.hover is not None or not _is_multirotor(found):
        return "health" if found.hover else "nothing"
    imu = found.stream(Stream.IMU)
    slow = imu is not None and (imu.rate or 0.0) >= LIMITS.hover_imu
    rotors = any((source.rate or 0.0) >= LIMITS.hover_rotors for source in found.rotor_sources)
    return "health" if slow and rotors and found.flights else "nothing"


def _imu(found: Inspection) -> Iterator[Objection]:
    imu = found.stream(Stream.IMU)
    if imu is None:
        yield _blocks("no IMU data (HIGHRES_IMU)", _faster(found, Stream.IMU))
        return
    rate = imu.rate or 0.0
    if rate < MIN_RATE:
        text = (
            f"{imu.message} comes at {rate:.1f} Hz; identification needs {LIMITS.imu_rate:.0f} Hz"
        )
        yield _blocks(text, _faster(found, Stream.IMU))
    elif rate < LIMITS.nearly * LIMITS.command_rate:
        needed = rate >= LIMITS.nearly * LIMITS.imu_rate
        text = f"{imu.message} at {rate:.0f} Hz is {'' if needed else 'too '}slow for fast motion"
        yield (_note if needed else _limits)(text, _faster(found, Stream.IMU))
    # PX4's IMU data come from before its filter.
    cutoff = found.parameters.get("INS_GYRO_FILTER", 0.0)
    if 0.0 < cutoff < LIMITS.slow_gyro_filter:
        yield _note(f"the gyro is low-passed at {cutoff:.0f} Hz (INS_GYRO_FILTER)")


def _sensors(found: Inspection) -> Iterator[Objection]:
    # What carries the vehicle is seen by its acceleration or its velocity.
    absent = any(each.absent for each in found.saturated)
    blind = absent and found.stream(Stream.VELOCITY) is None
    for objection in of_sensors(found.gyro, found.saturated, found.parameters):
        blocks = blind and objection.by == "saturation"
        yield _blocks(objection.reason, objection.how) if blocks else objection


def _rotors(found: Inspection) -> Iterator[Objection]:
    chosen = found.rotor_input.chosen
    stream = Stream.ROTOR_SPEED if found.rotor_sources else Stream.ROTOR_COMMAND
    if found.rotors_assumed and found.rotor_sources:
        text = f"the vehicle type does not define the number of rotors: {found.rotors} assumed"
        yield _note(text, "give --rotors N, or --airframe")
    if chosen is None:
        reasons, slow = found.rotor_input.reasons, not any(map(_is_quick, found.rotor_sources))
        if not slow and not (found.rotor_input.judged and reasons):
            return  # what flight would show; that there was none is reported separately
        why = "; ".join(reasons) or "; ".join(
            f"{source.message} comes at {source.rate or 0.0:.1f} Hz"
            for source in found.rotor_sources
        )
        none = f"no rotor input that can be used: {why}" if why else "no rotor input at all"
        if (why and slow) or found.kind == "dataflash":
            yield _blocks(none, _faster(found, stream))
        elif why:
            yield _blocks(none, "mend that, or record another rotor stream")
        else:
            how = (
                "enable rpm telemetry of the ESCs, or record the actuator outputs "
                "(gcs-sysid live requests both)"
            )
            yield _blocks(none, how)
        return
    for reason in found.rotor_input.reasons:
        yield _note(reason)
    if chosen.kind.motors and (chosen.rate or 0.0) < LIMITS.nearly * LIMITS.command_rate:
        yield _limits(
            f"{chosen.message}'s commands at {chosen.rate:.0f} Hz leave out commands in between",
            _faster(found, stream),
        )
    elif (chosen.rate or 0.0) < LIMITS.nearly * LIMITS.imu_rate:
        text = f"{chosen.message} at {chosen.rate:.0f} Hz is slow: fast motion cannot be used"
        yield _limits(text, _faster(found, stream))


def _is_quick(source: RotorMessage) -> bool:
    return source.rate is not None and source.rate >= MIN_RATE


def _attitude_and_velocity(found: Inspection) -> Iterator[Objection]:
    attitude = found.stream(Stream.ATTITUDE)
    if attitude is None:
        yield _note(NO_ATTITUDE, _faster(found, Stream.ATTITUDE))
    elif (attitude.rate or 0.0) < LIMITS.attitude_rate:
        yield _limits(
            f"{attitude.message} at {attitude.rate or 0.0:.1f} Hz is slow",
            _faster(found, Stream.ATTITUDE),
        )
    if found.stream(Stream.VELOCITY) is None:
        yield _note("no velocity (LOCAL_POSITION_NED): linear_drag is not observable")


def _flight(found: Inspection) -> Iterator[Objection]:
    if not found.flight_told_by:
        advice = "record EXTENDED_SYS_STATE too (gcs-sysid live requests it)"
        if found.kind == "table":
            advice = "name a column of it in the mapping file: in_air or armed"
        yield _blocks("no flight state in the data", advice)
    elif found.kind == "link":
        if not found.flights:
            text = "not in the air while listening: flight-dependent checks are skipped"
            yield _blocks(text, "inspect again in flight, or start gcs-sysid live")
    elif found.in_air < LIMITS.too_short:
        text = f"only {found.in_air:.0f} s in the air" if found.in_air else "never in the air"
        yield _blocks(text, "fly a minute, with roll, pitch and yaw inputs")
    elif found.in_air < LIMITS.short:
        text = f"only {found.in_air:.0f} s in the air: intervals stay wide"
        yield _limits(text, "fly a minute or more")
    if len(found.flights) > 1:
        text = f"{len(found.flights)} flights: joined only where they agree"
        yield _note(text)


def _motion(found: Inspection) -> Iterator[Objection]:
    little = [a for a in AXES if a in found.motion and _is_little(found, a)]
    if not little:
        return
    identified = ", ".join(_IDENTIFIED_BY_AXIS[axis] for axis in little)
    axes = names_text(little)
    now = "right now " if found.kind == "link" else ""
    yield replace(
        _limits(
            f"too little {axes} motion {now}to identify {identified}",
            f"fly fast {axes} inputs both ways (doublets) for 10 s an axis, in calm air",
        ),
        flying=True,
    )


def _is_little(found: Inspection, axis: str) -> bool:
    motion, least = found.motion[axis], LIMITS.acceleration[axis]
    return is_still(motion.rate_rms, axis) or motion.acceleration_rms < least


def _turned_by_rotors(found: Inspection) -> Iterator[Objection]:
    """What turns the vehicle must be its rotors, at the rates of this log and in this order."""
    if not _is_flown(found) or found.explained is None:
        return
    if found.explained < LIMITS.explained:
        causes, order = "vibration, gusts or slow data", ""
        if found.layout is None or not found.layout.shown:
            causes = "vibration, gusts, slow data or another motor order"
            order = "give --airframe with the motors in the autopilot's order; "
        yield _blocks(
            f"the rotors explain only {100.0 * found.explained:.0f} % of roll or pitch: {causes}",
            f"{order}{_faster(found, Stream.IMU, Stream.ROTOR_SPEED)}",
        )
    elif _is_rough(found):
        yield _limits(
            f"the rotors explain {100.0 * (found.explained_coupled or 0.0):.0f} % of roll or "
            "pitch: what else moves the vehicle (propeller wash, gusts, the ground) may leave the "
            f"inertia{' and T_max' * _is_by_commands(found)} rough",
            "fly doublets from hover, in calm air, for half a minute",
        )


def _is_flown(found: Inspection) -> bool:
    """Whether there is motion that rotors could explain."""
    return any(a in found.motion and not _is_little(found, a) for a in ("roll", "pitch"))


def _is_rough(found: Inspection) -> bool:
    """Whether much else than the rotors turns the vehicle; slow data do not show this."""
    chosen, share = found.rotor_input.chosen, found.explained_coupled
    imu = found.stream(Stream.IMU)
    if chosen is None or imu is None or share is None:
        return False
    if min(chosen.rate or 0.0, imu.rate or 0.0) < LIMITS.nearly * LIMITS.imu_rate:
        return False
    return _is_flown(found) and share < LIMITS.explained_well


def _is_by_commands(found: Inspection) -> bool:
    return found.rotor_input.chosen is not None and found.rotor_input.chosen.kind.motors


def _losses(found: Inspection) -> Iterator[Objection]:
    imu = found.stream(Stream.IMU)
    advice = "" if found.kind in ONBOARD else "fly closer, or request less (--rate)"
    for objection in loss_of(0.01 * ((imu and imu.missing_percent) or 0.0)):
        yield replace(objection, how=advice)
    if imu and imu.gaps:
        text = f"{imu.gaps} gaps in {imu.message}, the longest {imu.longest_gap:.1f} s"
        yield _note(text)
    bad = int(found.telemetry.get("bad_crc", 0))
    if bad:
        yield _note(f"{bad} messages of another definition, or damaged, were skipped")
    torn = int(found.telemetry.get("cut_short", 0))
    if torn:
        text = f"the last record is cut short: {torn} bytes (the recording was not closed)"
        yield _note(text)
    garbage = int(found.telemetry.get("garbage_bytes", 0))
    if garbage >= LIMITS.garbage or found.telemetry.get("damaged"):
        text = (
            f"damaged: {garbage} bytes are not part of a message" if garbage else "damaged in part"
        )
        yield _note(text)
    drops = found.telemetry.get("dropouts", {})
    if drops.get("count"):
        text = (
            f"the autopilot could not write for {drops['seconds']:.1f} s ({drops['count']} times)"
        )
        yield _note(text, "use a faster SD card")


def _others(found: Inspection) -> Iterator[Objection]:
    if found.clock.reboots:
        yield _note(f"the autopilot restarted in between ({found.clock.reboots} x)")
    others = [s for s in found.systems if s.is_autopilot and s.address != found.vehicle_address]
    if others:
        more = [f"{len(others) - LIMITS.vehicles_named} more"] * (
            len(others) > LIMITS.vehicles_named
        )
        names = ", ".join([*map(str, others[: LIMITS.vehicles_named]), *more])
        yield _note(f"other vehicles on the link: {names}", "choose with --vehicle")


_PRODUCERS: tuple[tuple[str, Callable[[Inspection], Iterable[Objection]]], ...] = (
    ("link", _problems),
    ("vehicle", _vehicle),
    ("imu", _imu),
    ("sensors", _sensors),
    ("rotors", _rotors),
    ("attitude", _attitude_and_velocity),
    ("flight", _flight),
    ("motion", _motion),
    ("explained", _turned_by_rotors),
    ("loss", _losses),
    ("others", _others),
)
