"""From a log to the health of its vehicle."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from gcs_sysid.argument_types import with_given
from gcs_sysid.arrays import Array, complete_rows
from gcs_sysid.errors import InputError, NoAnswerError
from gcs_sysid.health import balance
from gcs_sysid.health.advice import advised
from gcs_sysid.health.airframe_guess import GuessedAirframe, guess_airframe, layout_by_motion
from gcs_sysid.health.barometer import thrust_pressure
from gcs_sysid.health.command_curve import Commanded, Curve, curve_of, thrust_of
from gcs_sysid.health.drag import drag_of
from gcs_sysid.health.drive_health import (
    battery_of,
    idle_output,
    motor_current,
    motor_gains,
    power_of_voltage,
    vibration_of,
    with_throttle,
)
from gcs_sysid.health.hover import Windows, lines_of, windows_of
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.health.log_streams import RotorStream, Streams
from gcs_sysid.health.rotor_condition import Load, compare_loads, load_of, watch_rotors
from gcs_sysid.health.vehicle_health import Finding, Health, HealthOptions, RotorHealth
from gcs_sysid.judgement.imu_faults import of_sensors
from gcs_sysid.judgement.plausibility import REREAD, misfits, of_spins, of_turning, too_fast
from gcs_sysid.judgement.status import READINGS, ROTORS, SPINS, on_sound_data
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.estimate import Objection, Quantity
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.health_view import HOVER
from gcs_sysid.results.result import Result
from gcs_sysid.session.reported_layout import ReportedLayout
from gcs_sysid.signals.columns import RecordBlock
from gcs_sysid.signals.records import Stream
from gcs_sysid.signals.rotor_units import RADIANS, speed_scale, unit_doubt
from gcs_sysid.signals.sampling import Sampler
from gcs_sysid.telemetry.logs import Log, OnboardLog, Telemetry, open_log

_AS_FLOWN = (
    "the motion does not match this motor order ({}); as flown, {}",
    "give --airframe with the rotors in that order, or see what changed places in the record",
)
_REVERSED = Objection(
    "yaw answers the rotors the other way round: all spin in reverse of the airframe",
    verdict="identified",
    by=SPINS,
    how="check spin in the airframe file",
)
_WITHHELD = "CG and rotor shares are withheld: they depend on the motor order, and {}"


class HoverRecords:
    """Keeps of a log what hovering needs, while an analysis or anyone else reads it.

    So that memory is bounded, that is up to `most_samples` of the IMU.
    """

    def __init__(self) -> None:
        self._log: Telemetry | None = None
        self._blocks: list[RecordBlock] = []
        self._room = TUNING.most_samples
        self._sampler: Sampler | None = None

    def begin(self, log: Telemetry) -> None:
        """A reading of the log, or link, begins; one before it does not count."""
        self._log, self._blocks, self._sampler = log, [], None
        self._room = TUNING.most_samples

    def end(self, sampler: Sampler) -> None:
        """Another took all of it, by the airframe that is given to `health`."""
        self._sampler = sampler

    @property
    def full(self) -> bool:
        """Whether it keeps nothing of what follows."""
        return self._room < 0

    def add_records(self, block: RecordBlock) -> None:
        """The next block of records."""
        if self.full:
            return
        tracks = block.tracks
        taken = block.imu_samples
        if taken > self._room:
            orders = [track.order for track in tracks if track.stream is Stream.IMU]
            stop = int(np.sort(np.concatenate(orders))[self._room])
            tracks = tuple(part for track in tracks if len((part := track.between(0, stop)).t))
        self._room -= taken
        self._blocks.append(RecordBlock(tracks, events=block.events))

    def health(
        self, source: str, given: HealthOptions, span: tuple[float, float] = (0.0, math.inf)
    ) -> Health:
        """What the hover in the log read shows; the records are given up.

        Args:
            source: the log's name.
            given: what is known beforehand.
            span: s from the first record, between which hover counts.

        Raises:
            InputError: no vehicle has an arm or a scale as given.
        """
        log, blocks = self._log, self._blocks
        self._blocks = []
        if log is None:
            return _refused("nothing was read", source=source)
        if log.vehicle is None:
            found = ", ".join(map(str, log.systems))
            text = "no heartbeat of an autopilot was found" + (f"; found: {found}" if found else "")
            return _refused(text, source=source)
        autopilot = log.vehicle.key
        try:
            guess = guess_airframe(log.vehicle, log.parameters, given.airframe, given.arm)
        except NoAnswerError as error:
            return _refused(error.reason, how=error.how, source=source)
        guess, streams = layout_by_motion(blocks, guess, autopilot, log.parameters, self._sampler)
        if given.mass is not None:
            airframe = with_given(guess.airframe, "mass", given.mass, "--mass")
            guess = replace(guess, airframe=airframe)
        if isinstance(log, OnboardLog):
            streams = replace(streams, extras=log.extras)
        health = health_of(streams, guess, given, log.parameters, span)
        if health.available and log.problems:
            of_record = (Objection(p, verdict="identified", by="link") for p in log.problems)
            health = advised(replace(health, doubts=(*health.doubts, *of_record)))
        if self.full:
            kept = f"hover of the log's first {TUNING.most_samples} IMU samples"
            health = replace(health, assumptions=(*health.assumptions, kept))
        return replace(
            health,
            source=source,
            vehicle=log.vehicle.as_dict(),
            autopilot=autopilot,
            parameters=dict(log.parameters),
            layout=None if health.contradicted else guess.layout,
            explained=guess.explained,
            explained_coupled=guess.explained_coupled,
        )

    def layout(self) -> ReportedLayout | None:
        """Where the log's parameters, or its flight, have the rotors; None: neither shows it."""
        log = self._log
        if log is None or log.vehicle is None:
            return None
        try:
            guess = guess_airframe(log.vehicle, log.parameters, None, None)
        except NoAnswerError:
            return None
        if guess.layout is None:
            guess, _ = layout_by_motion(self._blocks, guess, log.vehicle.key, log.parameters)
        return guess.layout


class ReadLog:
    """A recording that was read once, for what hover shows and for who takes its records after.

    Args:
        path: of a log.
        wanted: system and perhaps component; None: the first autopilot in it.
        progress: called with the share of the log read, 0 to 1, now and then.

    Attributes:
        log: as it was opened, read to its end.

    Raises:
        InputError: the file cannot be read as a log.
    """

    def __init__(
        self,
        path: Path,
        wanted: tuple[int, int | None] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        show = progress or (lambda _: None)
        show(0.0)
        self._path, self._wanted = path, wanted
        self._keeper, self.log = HoverRecords(), open_log(path, wanted)
        self._blocks: list[RecordBlock] = []
        self._keeper.begin(self.log)
        for block in self.log.blocks():
            show(self.log.share_read)
            self._keeper.add_records(block)
            self._blocks.append(block)
            if self._keeper.full:
                self._blocks.clear()
        show(1.0)

    def health(self, given: HealthOptions, span: tuple[float, float] = (0.0, math.inf)) -> Health:
        """What hover shows, as of `HoverRecords`."""
        return self._keeper.health(str(self._path), given, span)

    def layout(self) -> ReportedLayout | None:
        """As of `HoverRecords`."""
        return self._keeper.layout()

    def again(self) -> Log:
        """The log, to be read once more: from memory, where all of it fits there."""
        if self._keeper.full:
            return open_log(self._path, self._wanted)
        return cast(Log, _LogAgain(self.log, self._blocks))


class _LogAgain:
    """A log that was read, whose blocks come once more."""

    def __init__(self, log: Log, blocks: list[RecordBlock]) -> None:
        self._log, self._blocks = log, blocks
        self.share_read = 0.0

    def blocks(self) -> Iterator[RecordBlock]:
        """As of the log."""
        for number, block in enumerate(self._blocks, 1):
            self.share_read = number / len(self._blocks)
            yield block

    def __getattr__(self, name: str) -> Any:
        return getattr(self._log, name)


def health_of(
    streams: Streams,
    guess: GuessedAirframe,
    given: HealthOptions,
    parameters: Mapping[str, float],
    span: tuple[float, float] = (0.0, math.inf),
) -> Health:
    """What the hover in streams shows.

    Args:
        streams: of one log.
        guess: the airframe and where it is from.
        given: what else is known.
        parameters: the autopilot's.
        span: s between which windows count.
    """
    airframe, scale = guess.airframe, 1.0
    if problem := _missing(streams):
        return _refused(*problem, airframe=airframe)
    if (speeds := streams.speeds) is not None and len(streams.flight.t):
        flown = [v[streams.flight.at(t)] for t, v in speeds.samples]
        mass = airframe.mass if all(map(len, flown)) and not guess.arm_std else None
        scale = speed_scale(speeds.source, flown, airframe, mass, parameters)
        read = tuple((t, scale * v) for t, v in speeds.samples)
        streams = replace(streams, speeds=replace(speeds, samples=read))
    saturated = streams.flight.saturated
    sensors = tuple(of_sensors(streams.flight.gyro, saturated, parameters))
    # A gyro that misreads contradicts any motor order.
    turns_shown = not any(objection.by == "gyro" for objection in sensors)
    if guess.as_flown and turns_shown:
        reason, how = _AS_FLOWN
        return _contradicted(airframe, reason.format(guess.origin, guess.as_flown), how)
    windows = windows_of(streams, len(airframe.rotors))
    windows = windows.part((windows.t >= span[0]) & (windows.t <= span[1]))
    own, own_name = _own_curve(parameters)
    curve = None
    if streams.commands is not None and len(windows.t):
        curve = curve_of(windows, airframe.command.thrust_curve, own, own_name)
    rotor_input, source = _rotor_stream(streams, airframe)
    c = curve.c.value if curve is not None and rotor_input.motors else None
    thrust = thrust_of(windows, c)
    if rotor_input.motors and c is None:
        reason, how = _no_hover(streams, windows)
        return _refused(*streams.doubts, reason, how=how, airframe=airframe)
    sound = windows.hovering & complete_rows(thrust) & (thrust.sum(axis=1) > 0.0)
    sound &= ~windows.idle
    sound &= np.isfinite(balance.lift_of(windows)) & complete_rows(windows.turning)
    if np.count_nonzero(sound) < TUNING.fewest_windows:
        # A sensor that reads otherwise than the vehicle moves is the cause of the rest.
        reason, how = _no_hover(streams, windows)
        unseen = _refused(*streams.doubts, reason, how=how, airframe=airframe)
        # Without an accelerometer nothing is calm.
        others = () if any(each.absent for each in saturated) else unseen.objections
        return replace(unseen, objections=on_sound_data((*sensors, *others)))
    hover, thrust = windows.part(sound), thrust[sound]
    assert hover is not None
    commands, commanded = streams.commands, None
    if commands is not None and curve is not None:
        ranged = []
        if commands.range is not None and commands.range.assumed:
            for start in (-TUNING.range_std, TUNING.range_std):
                of_range = windows.starting_at(start)
                bent = curve_of(of_range, airframe.command.thrust_curve, own, own_name)
                ranged.append(thrust_of(of_range.part(sound), bent.c.value))
        commanded = Commanded.of(hover, curve, ranged)
    health = _balances(streams, hover, thrust, commanded, guess, motors=rotor_input.motors)
    load, lines = load_of(hover, thrust, c), lines_of(streams, airframe.geometry[2])
    health = replace(
        health,
        rotor_input=rotor_input,
        rotor_source=source.source,
        seconds=hover.seconds,
        load=load,
        curve=curve,
        motor_lag=None if streams.commands is None else windows.lag,
        idle=idle_output(streams),
        arm_std=guess.arm_std * airframe.arm,
        battery=battery_of(streams),
        by_voltage=power_of_voltage(streams, windows, curve),
        barometer=thrust_pressure(
            streams, windows, parameters.get("THR_MDL_FAC", parameters.get("MOT_THST_EXPO", 0.0))
        ),
        motor_current=motor_current(streams, windows, parameters.get("THR_MDL_FAC", 0.0)),
        drag=drag_of(streams, windows),
        turning=lines.factor,
    )
    health = with_throttle(health, streams, hover, thrust, commanded)
    health = _compared(health, given, hover, thrust, c)
    places = [place.value for place in health.cg or ()]
    weakened, watched = watch_rotors(hover, thrust, c, airframe, places)
    health = replace(health, weakened=weakened, watched=watched)
    unfit = (*_misfits(health, guess), *((REREAD,) if scale == RADIANS else ()))
    seen = health.turning is not None
    assumed, unit = unit_doubt(source.source, source.range, parameters, airframe, seen=seen)
    open_range, unit = "", assumed or unit
    if commands is not None:  # beside speeds too
        open_range = unit_doubt(commands.source, commands.range, parameters, airframe).assumed
    said = filter(None, dict.fromkeys((unit, open_range)))
    health = replace(health, assumptions=(*health.assumptions, *said), unit=unit)
    otherwise = tuple(of_turning(health.turning))
    if not rotor_input.motors:
        otherwise += tuple(of_spins(lines.unlike_spins))
    # What is in proportion to it is no number.
    if unfit or assumed or (otherwise and not rotor_input.motors):
        health = replace(health, scale=None, mass=None)
    if open_range:
        health = replace(
            health,
            curve=None,
            drift=None,
            barometer=None,
            motor_current=None,
            hover_throttle=None,
            hover_thrust=None,
            hover_command=None,
            thrust_to_weight=None,
            rotors=tuple(replace(r, headroom=None, saturated=None) for r in health.rotors),
        )
    doubts = (*sensors, *unfit, *otherwise, *((_REVERSED,) if guess.reversed else ()))
    return advised(
        replace(health, doubts=doubts, misread=streams.misread, battery_mass=given.battery_mass)
    )


def _misfits(health: Health, guess: GuessedAirframe) -> Iterator[Objection]:
    """What was given against the flight."""
    assert health.rotor_input is not None
    known = {} if health.scale is None else {health.scale[0]: health.scale[1].value}
    if health.known_mass is not None:
        known["mass"] = health.known_mass
    yield from misfits(known, guess.airframe, health.rotor_input, guess.arm_std)
    yield from too_fast(known, guess.airframe)


def beside_analysis(health: Health, result: Result) -> Health:
    """The health to show beside an analysis: of one vehicle with one CG and one scale.

    It is withheld where the analysis was refused by the rotors.

    Args:
        health: of the same log and airframe.
        result: of the analysis.
    """
    health = _changed(_as_identified(_of_one_scale(health, result), result), result)
    blamed = (objection for objection in result.objections if objection.by == ROTORS)
    refused = next(blamed, None) if result.verdict == "refused" else None
    if refused is None or health.contradicted or not health.available:
        return health
    assert health.airframe is not None
    return replace(
        _contradicted(health.airframe, _WITHHELD.format(refused.reason), refused.how),
        source=health.source,
        vehicle=health.vehicle,
        autopilot=health.autopilot,
        parameters=health.parameters,
        explained=health.explained,
        explained_coupled=health.explained_coupled,
    )


def _changed(health: Health, result: Result) -> Health:
    """With a change in flight that the analysis found: hover is of two vehicles then."""
    if not result.segments or not health.available:
        return health
    at = result.segments[-1]["end"]
    found = Finding(
        "what it carries",
        f"the vehicle changed at {at:.0f} s",
        f"was something dropped, loaded or moved at {at:.0f} s? CG, loads and hover throttle are "
        "of before and after together",
        spoils=True,
    )
    findings, advice = (found, *health.findings), (found.do, *health.advice)
    return replace(health, findings=findings, advice=advice, drift=None)


def _of_one_scale(health: Health, result: Result) -> Health:
    """With the analysis' k_T or T_max, where it has one, and what it assumes of it."""
    if health.scale is None or (found := result.parameters.get(health.scale[0])) is None:
        return health
    name, of_hover = health.scale
    if found.status == "unobservable" or (known := found.known) is None:
        return health
    said = {o.reason for o in result.objections} | {a["source"] for a in result.assumptions}
    one = tuple(text for text in health.assumptions if text != health.unit or text in said)
    scale = name, known if known.unit == of_hover.unit else of_hover
    return replace(health, scale=scale, assumptions=one)


def _as_identified(health: Health, result: Result) -> Health:
    """With what the analysis knows better: the CG, and rotors that are unlike."""
    if health.cg is None or result.verdict == "refused":
        return health
    x, y = _better(result, "cg_x", health.cg[0]), _better(result, "cg_y", health.cg[1])
    if x is not None and y is not None:
        health = replace(health, cg=(x, y), cg_of_hover=health.cg)
    # Whether rotors are unlike, moments and yaw of all the flight show the analysis alone.
    unlike = tuple(objection for objection in result.objections if objection.by == READINGS)
    own = (each for each in health.doubts if each.by != READINGS)
    health = _by_own_thrusts(health, result) if unlike else health
    return advised(replace(health, doubts=(*own, *unlike)))


def _by_own_thrusts(health: Health, result: Result) -> Health:
    """Shares and yaw balance by what each rotor was found to lift for the speed that it reads."""
    lifts = [known for each in result.rotors if (known := each["k_T"].known) is not None]
    if health.through_motors or not lifts or len(lifts) != len(health.rotors):
        return health
    assert health.airframe is not None
    read = [rotor.thrust_share for rotor in health.rotors]
    total = sum(share.value * k_T.value for share, k_T in zip(read, lifts, strict=True))
    rotors, moved, doubts = [], [], []
    for rotor, share, k_T in zip(health.rotors, read, lifts, strict=True):
        flown = Quantity(share.value, share.std_data or 0.0, "1").times(k_T.value / total, "1")
        doubts.append(share.value * k_T.std / total)
        moved.append(flown.value - share.value)
        rotors.append(replace(rotor, thrust_share=flown.off_by(doubts[-1])))
    yaw = health.yaw_imbalance
    if yaw is not None:
        by_speed = float(health.airframe.geometry[2] @ moved)
        yaw = replace(yaw, value=yaw.value + by_speed).off_by(math.hypot(*doubts))
    return replace(health, rotors=tuple(rotors), yaw_imbalance=yaw)


def _better(result: Result, name: str, of_hover: Quantity) -> Quantity | None:
    """A parameter as identified, if its interval is the narrower one; else None."""
    found = result.parameters.get(name)
    if found is None or found.status not in ("identified", "zero"):
        return None
    known = found.known
    if known is None or known.unit != of_hover.unit or known.std >= of_hover.std:
        return None
    return known


def _rotor_stream(streams: Streams, airframe: Airframe) -> tuple[RotorInput, RotorStream]:
    """The rotor stream that loads are taken from: measured where nothing asks for another."""
    sources = {RotorInput.SPEED: streams.speeds, RotorInput.COMMAND: streams.commands}
    given = airframe.anchor()
    wanted = None if given is None else RotorInput.scaled_by(given[0])
    for kind in (wanted, airframe.wanted_input, *RotorInput):
        source = None if kind is None else sources[kind]
        if kind is not None and source is not None:
            return kind, source
    raise ValueError("no rotor stream")


def _contradicted(airframe: Airframe, reason: str, how: str) -> Health:
    """Nothing but why: CG, shares and positions all depend on the motor order."""
    return _refused(reason, how=how, airframe=airframe, by=ROTORS)


def _refused(
    *reasons: str,
    how: str = "",
    source: str = "",
    airframe: Airframe | None = None,
    by: str = "hover",
) -> Health:
    """No answer, for these reasons."""
    objections = tuple(
        Objection(why, verdict="refused", how=how, flying=how == HOVER, by=by) for why in reasons
    )
    return Health(source, airframe=airframe, objections=objections)


def _missing(streams: Streams) -> tuple[str, ...]:
    if Stream.IMU not in streams.tracks:
        return ("no IMU data",)
    if streams.speeds is None and streams.commands is None:
        why = tuple(f"{name} {problem}" for name, problem in streams.refused.items())
        return why or ("no rotor speeds and no actuator outputs",)
    return ()


def _no_hover(streams: Streams, windows: Windows) -> tuple[str, str]:
    """Why there is no hover to judge by, and what to do."""
    if not len(windows.t):
        if turned := max(s.turned for s in (streams.speeds, streams.commands) if s is not None):
            on_ground = f"the rotors turn for {turned:.0f} s, on the ground, a bench or in a hand"
            return f"never seen in the air: {on_ground}", HOVER
        return "never seen in the air, with IMU and rotor data together", HOVER
    if windows.idle.all():
        return "the rotors only idle, at no command above their least: never in the air", HOVER
    flown = len(windows.t) * windows.half
    if windows.hovering.all():
        return f"only {flown:.1f} s in the air with all that hover takes", HOVER
    calm = f"{windows.seconds:.1f} s of {flown:.1f} s in the air are calm enough"
    return f"hardly hovers: {calm}", HOVER


def _own_curve(parameters: Mapping[str, float]) -> tuple[float | None, str]:
    for name in ("MOT_THST_EXPO", "THR_MDL_FAC"):
        if name in parameters:
            return parameters[name], name
    return None, ""


def _balances(
    streams: Streams,
    hover: Windows,
    thrust: Array,
    commanded: Commanded | None,
    guess: GuessedAirframe,
    *,
    motors: bool,
) -> Health:
    """CG, shares, yaw balance and scale; `motors`: whether thrust is that of commands."""
    airframe = guess.airframe
    x, y, spin = airframe.geometry
    total = thrust.sum(axis=1)

    def balanced(thrust: Array) -> Array:
        each = thrust.sum(axis=1)
        share = (thrust / each[:, None]).mean(axis=0)
        ends = [share @ np.array([x, y]).T, share, [share @ spin, total.mean() / each.mean()]]
        return np.concatenate(ends)

    center = balance.cg_of(hover, airframe, thrust)
    cg = center.cg
    shares = (thrust / total[:, None]).mean(axis=0)
    per_thrust, per_std = balance.specific_thrust(hover, thrust)
    yaw = balance.robust_fit(
        np.column_stack([np.ones(len(total)), hover.turning[:, 2]]),
        thrust @ spin / total,
        between=hover.half,
    )
    by_curve, by_given = np.zeros((2, len(shares) + 4))
    if motors and commanded is not None:
        by_curve, by_given = commanded.doubt(balanced)
    flown = np.sqrt(np.diag(center.covariance) + by_curve[:2] ** 2)
    assumed = np.sqrt(np.diag(balance.scatter_of_cg(airframe, shares, cg)) + by_given[:2] ** 2)
    assumed = np.hypot(assumed, center.level_std)
    assumed = np.hypot(assumed, guess.arm_std * np.abs(cg))
    places = [
        Quantity(v, f, "m").off_by(given=a)
        for v, f, a in zip(cg.tolist(), flown.tolist(), assumed.tolist(), strict=True)
    ]
    share_flown = np.array(
        [balance.mean_of(share, hover.half).std for share in (thrust / total[:, None]).T]
    )
    by_wind = balance.shares_by_wind(airframe, center)
    share_flown = np.sqrt(share_flown**2 + by_curve[2:-2] ** 2 + by_wind**2)
    scatter = airframe.uncertainty.rotor_thrust.of(1.0)
    share_assumed = np.hypot(balance.share_std(shares, scatter), by_given[2:-2])
    gains, shaking = motor_gains(hover, commanded), vibration_of(streams, hover)
    alike = Quantity(1.0, 0.0, "1").off_by(given=scatter)
    each = zip(shares.tolist(), share_flown.tolist(), share_assumed.tolist(), strict=True)
    rotors = tuple(
        RotorHealth(Quantity(s, f, "1").off_by(given=a), alike, gains[i], None, None, shaking[i])
        for i, (s, f, a) in enumerate(each)
    )
    (yaw_own, own), (yaw_given, given) = by_curve[-2:].tolist(), by_given[-2:].tolist()
    yaw_std = math.sqrt(float(yaw.covariance[0, 0]))
    lifts = Quantity(per_thrust, per_std, "1").off_by(own * per_thrust, given * per_thrust)
    scale, mass = _scale(airframe, lifts, by_command=motors)
    return Health(
        "",
        airframe=airframe,
        cg=(places[0], places[1]),
        by_wind=(float(center.by_wind[0]), float(center.by_wind[1])),
        center=center,
        rotors=rotors,
        yaw_imbalance=Quantity(float(yaw.value[0]), yaw_std, "1").off_by(yaw_own, yaw_given),
        scale=scale,
        mass=mass,
        assumptions=_assumptions(guess, commanded.curve if motors and commanded else None),
    )


def _scale(
    airframe: Airframe, per_thrust: Quantity, *, by_command: bool
) -> tuple[tuple[str, Quantity] | None, Quantity | None]:
    """k_T or T_max of a given mass, or the mass of a given coefficient.

    per_thrust is lift over the sum of thrust in the rotors' unit: k_T / m or T_max / m.
    """
    name, unit = ("T_max", "N") if by_command else ("k_T", "N s^2")
    given = airframe.T_max if by_command else airframe.k_T
    known_to = airframe.uncertainty.scale_share
    if airframe.mass is not None:
        thrust = per_thrust.times(airframe.mass, unit)
        return (name, thrust.off_by(given=known_to("mass", airframe.mass) * thrust.value)), None
    if given is None:
        return None, None
    mass = per_thrust.under(given, "kg")
    return (name, Quantity(given, 0.0, unit)), mass.off_by(given=known_to(name, given) * mass.value)


def _compared(
    health: Health, given: HealthOptions, hover: Windows, thrust: Array, c: float | None
) -> Health:
    """With the rotors against a baseline, where there is one that fits."""
    base = given.baseline
    if base is None or health.load is None or health.airframe is None or health.cg is None:
        return health
    problem = _of_another_kind(base.load, health.load)
    if problem and base.asked:
        raise InputError(f"{base.source}: {problem}; take a flight of this vehicle as baseline")
    if problem:
        return replace(health, apart=f"not compared with {Path(base.source).name}: {problem}")
    load = health.load
    if base.load.thrust_curve is not None and base.load.thrust_curve != c:
        again = load_of(hover, thrust_of(hover, base.load.thrust_curve), base.load.thrust_curve)
        load = again or load
    condition = compare_loads(base.load, load, health.airframe, base.cg, unchanged=given.unchanged)
    rotors = tuple(
        replace(rotor, efficiency=efficiency)
        for rotor, efficiency in zip(health.rotors, condition.efficiency, strict=True)
    )
    return replace(health, condition=condition, rotors=rotors)


def _of_another_kind(before: Load, now: Load) -> str:
    """Why loads cannot be compared; empty where they can."""
    if before.kind != now.kind:
        return f"its rotors were measured by {before.kind}s, here by {now.kind}s"
    if len(before.value) != len(now.value):
        return f"it has {len(before.value)} rotors, not {len(now.value)}"
    ratio = float(np.mean(np.log(now.value / before.value)))
    if abs(ratio) > math.log(TUNING.same_vehicle):
        more = math.exp(abs(ratio))
        return (
            f"its rotors do {more:.1f} times {'less' if ratio > 0.0 else 'more'} for the same "
            "thrust, as another vehicle's"
        )
    return ""


def _assumptions(guess: GuessedAirframe, curve: Curve | None) -> tuple[str, ...]:
    given, arm = guess.airframe.uncertainty, guess.airframe.arm
    alike, placed = given.rotor_thrust.of(1.0), given.rotor_position.of(arm) / arm
    out = [f"airframe: {guess.origin}"]
    if alike or placed:
        rotors = f"rotors alike to {100.0 * alike:.2g} % (1 sigma) in thrust for their speed, "
        out.insert(0, f"{rotors}placed to {100.0 * placed:.2g} % of the arm")
    if curve is not None and "assumed" in curve.origin:
        usual = "near 0.5, as of most propellers"
        out.append(f"thrust curve: {usual if curve.origin == 'assumed' else curve.origin}")
    return tuple(out)
