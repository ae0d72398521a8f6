"""Which airframe a command works with: one that is named, the vehicle's own, or a result's."""

import argparse
import shlex
import time
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

from gcs_sysid.argument_types import GIVEN_OPTIONS, GivenName, given_words, with_given
from gcs_sysid.cli import output
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import ANCHORS, Airframe, AnchorName, builtin_names, load_airframe

if TYPE_CHECKING:  # only a log or a link needs these, which take a while to load
    from gcs_sysid.live.receiver_process import ReceiverProcess
    from gcs_sysid.live.reception import Item
    from gcs_sysid.session.reported_layout import ReportedLayout
    from gcs_sysid.telemetry.logs import Log

_NO_SCALE = (
    "nothing sets the scale: weigh the vehicle and give --mass KG (or --k-t VALUE, or "
    "--t-max VALUE with commands); IMU and rotor data alone fix ratios only"
)


def given_scale(options: argparse.Namespace) -> tuple[AnchorName, float] | None:
    """What an option sets the scale to; None: none does."""
    for name in ANCHORS:
        value: float | None = getattr(options, name.lower())
        if value is not None:
            return name, value
    return None


def given_of(options: argparse.Namespace) -> list[tuple[GivenName, float]]:
    """Arm and scale, those that options set."""
    scale = given_scale(options)
    arm: list[tuple[GivenName, float]] = [] if options.arm is None else [("arm", options.arm)]
    return arm if scale is None else [*arm, scale]


def layout_of(options: argparse.Namespace, reported: Airframe | None = None) -> Airframe:
    """The airframe that is named, or the one reported, with the scale that is given, if any.

    Raises:
        InputError: there is none of that name, or it is no airframe.
    """
    airframe = load_airframe(options.airframe) if reported is None else reported
    for name, value in given_of(options):
        airframe = with_given(airframe, name, value, GIVEN_OPTIONS[name])
    return airframe


def airframe_of(
    options: argparse.Namespace, reported: Airframe | None = None, *, relative: bool = False
) -> Airframe:
    """The airframe with its scale and priors, as the options say.

    `reported`, the layout that the vehicle reports, replaces `--airframe`; `relative`: there may be
    no scale.

    Raises:
        InputError: there is none, or nothing sets the scale.
    """
    if reported is None and is_auto(options):
        raise InputError(
            "which airframe? Give --airframe FILE.toml or one of "
            + ", ".join(builtin_names())
            + " (with --arm for its size)"
        )
    airframe = layout_of(options, reported)
    if given_scale(options) is None and getattr(options, "added_mass", None) is not None:
        # Of the two flights; until they are compared any mass does.
        airframe = airframe.with_anchor("mass", 1.0)
    for name, value, std in getattr(options, "prior", ()):
        airframe = airframe.with_prior(name, value, std)
    if airframe.anchor() is None and not relative:
        raise InputError(_NO_SCALE)
    airframe.check_scale_fits()
    return airframe


def is_auto(options: argparse.Namespace) -> bool:
    """Whether the layout comes from the vehicle."""
    return options.airframe in (None, "auto")


def _is_scale_given(options: argparse.Namespace) -> bool:
    return given_scale(options) is not None or getattr(options, "added_mass", None) is not None


def check_scale_given(options: argparse.Namespace) -> None:
    """See that something sets the scale of an airframe that the vehicle reports.

    Raises:
        InputError: nothing does.
    """
    if not _is_scale_given(options):
        also = "" if options.arm is not None else "; most vehicles also need --arm M"
        raise InputError(f"{_NO_SCALE}; without --airframe the layout comes from the vehicle{also}")


def of_log(
    path: Path, options: argparse.Namespace, *, relative: bool = False
) -> tuple[Airframe, "Log | None"]:
    """The airframe for a log, named or by the parameters in it; the log, if that took reading it.

    `relative`: mass, and with it the size, may be missing.

    Raises:
        InputError: the log cannot be read; or the line names every option that is missing.
    """
    if not is_auto(options):
        return airframe_of(options, relative=relative), None
    from gcs_sysid.health.assessment import ReadLog
    from gcs_sysid.results.result_view import names_text
    from gcs_sysid.session.reported_layout import suggested_airframe
    from gcs_sysid.telemetry.vehicles import GIVE_MULTIROTOR

    read = ReadLog(path, options.vehicle)
    layout, vehicle = read.layout(), read.log.vehicle
    if vehicle is not None and vehicle.no_multirotor:
        raise InputError(f"{path}: {vehicle.no_multirotor}: {GIVE_MULTIROTOR}")
    lacking = _lacking(layout, options, suggested_airframe(read.log.kind, vehicle))
    relative = relative and not _is_scale_given(options)
    if lacking and not (relative and layout is not None):
        what = names_text([one.what for one in lacking])
        give = names_text([one.words for one in lacking])
        raise InputError(f"{path}: the log does not contain the vehicle's {what}: give {give}")
    return _by_layout(layout, options, str(path), relative=relative), read.again()


class _Lacking(NamedTuple):
    """What an identification needs beside a log."""

    what: str
    option: str
    about: str

    @property
    def words(self) -> str:
        return f"{self.option}{self.about}"


def _lacking(
    layout: "ReportedLayout | None", options: argparse.Namespace, suggestion: str | None
) -> list[_Lacking]:
    """What neither the log nor the options give, and the options that would."""
    out = []
    if layout is None and is_auto(options):
        about = " (the firmware's default order of motors; or FILE.toml)"
        if suggestion is None:
            about = f" or one of {', '.join(builtin_names())}"
        out.append(_Lacking("layout", f"--airframe {suggestion or 'FILE.toml'}", about))
    sized = layout is not None and layout.sized
    if not is_auto(options):
        sized = load_airframe(options.airframe).arm_known
    if options.arm is None and not sized:
        out.append(_Lacking("size", "--arm M", " (center to each motor)"))
    if not _is_scale_given(options) and (is_auto(options) or layout_of(options).anchor() is None):
        about = " (weighed; or --k-t, or --t-max with commands)"
        out.append(_Lacking("mass", "--mass KG", about))
    return out


def command_for(
    log: str,
    layout: "ReportedLayout | None",
    options: argparse.Namespace,
    suggestion: str | None = None,
    *,
    command: Literal["analyze", "health"] = "analyze",
) -> str:
    """The command that gets more from a log: with what is given, and what is still to be given.

    Args:
        log: as it was named.
        layout: that log or flight show; None: neither does.
        options: given so far.
        suggestion: airframe to try where neither log nor options give one.
        command: its name; `health` assumes a layout by itself where there is one to try.
    """
    words = [f"gcs-sysid {command}", shlex.quote(log)]
    if not is_auto(options):
        words.append(f"--airframe {shlex.quote(options.airframe)}")
    words += [" ".join(given_words(*each)) for each in given_of(options)]
    assumed = command == "health" and suggestion is not None
    words += [
        one.option
        for one in _lacking(layout, options, suggestion)
        if not (assumed and one.what == "layout")
    ]
    return " ".join(words)


def of_link(receiver: "ReceiverProcess", options: argparse.Namespace) -> Airframe:
    """The airframe for a vehicle on a link, by requests; what comes meanwhile is kept.

    Raises:
        InputError: the vehicle reports no layout; nothing sets the scale.
        LinkError: the receiver has died.
    """
    from gcs_sysid.session.reported_layout import reported_layout
    from gcs_sysid.telemetry.intake import Intake
    from gcs_sysid.telemetry.parameter_requests import ParameterRequests
    from gcs_sysid.telemetry.requests import StreamRequests
    from gcs_sysid.telemetry.transceiver import ReceivedFrames

    wait = 0.05  # s on the link at a time
    reply_within = 8.0  # s, once the vehicle is received: some 20 parameters
    usual_rotors = 4  # are requested until the vehicle reports their number
    output.say(f"listening on {receiver.url} for the vehicle's own layout (--airframe auto)")
    intake = Intake(options.vehicle)
    requests = ParameterRequests(receiver.gate, usual_rotors)
    taken: list[Item] = []
    began, received, beat_at, reported = (
        time.monotonic(),
        None,
        -StreamRequests.HEARTBEAT_EVERY,
        None,
    )
    while reported is None:
        items = receiver.next_items(wait)
        taken += items
        for item in items:
            if isinstance(item, ReceivedFrames):
                intake.frames(item.frames, 1e-6 * item.time_us)
        now, vehicle = time.monotonic(), intake.vehicle
        if now - beat_at >= StreamRequests.HEARTBEAT_EVERY:
            receiver.gate.heartbeat()
            beat_at = now
        if vehicle is not None:
            if received is None:
                received = now
                receiver.follow(vehicle.address)
            requests.tick(now, vehicle, intake.parameters)
            found = reported_layout(vehicle.key, intake.parameters)
            # Its outputs are reported too, or overdue.
            if found is not None and (
                len(found.outputs) >= len(found.rotors) or now - received >= 0.5 * reply_within
            ):
                reported = found
        waited = now - (began if received is None else received)
        limit = options.duration if received is None else reply_within
        if receiver.link_report.ended or (limit is not None and waited >= limit):
            break
    receiver.put_back(taken)
    who = (
        "no vehicle was found" if intake.vehicle is None else f"{intake.vehicle} does not report it"
    )
    return _by_layout(reported, options, f"{who}: its layout is not known")


def _by_layout(
    reported: "ReportedLayout | None",
    options: argparse.Namespace,
    problem: str,
    *,
    relative: bool = False,
) -> Airframe:
    from gcs_sysid.session.reported_layout import airframe_of_layout, proposal

    if reported is None:
        # Says which airframes there are.
        try:
            airframe_of(options)
        except InputError as error:
            raise InputError(f"{problem}. {str(error)[:1].upper()}{str(error)[1:]}") from None
    assert reported is not None
    if relative and options.arm is None and not reported.sized:
        of_any_size = Airframe("auto", reported.rotors, placeholder=reported.rotors)
        airframe = airframe_of(options, of_any_size, relative=True)
    else:
        layout = airframe_of_layout(reported, options.arm)
        airframe = airframe_of(options, layout, relative=relative)
    output.say(f"airframe: {proposal(reported)}")
    return airframe


def beside_result(options: argparse.Namespace) -> Airframe | None:
    """The airframe that supplies what a result lacks; None: not given.

    Raises:
        InputError: there is no such airframe.
    """
    if options.airframe is None:
        if options.arm is not None:
            raise InputError("--arm needs --airframe")
        return None
    airframe = load_airframe(options.airframe)
    return airframe if options.arm is None else airframe.with_arm(options.arm)
