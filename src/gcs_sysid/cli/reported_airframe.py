"""`--airframe auto`: the airframe that the vehicle's own parameters propose."""

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from gcs_sysid.cli import arguments, output
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import Airframe, builtin_names
from gcs_sysid.session.reported_layout import (
    ReportedLayout,
    airframe_of_layout,
    proposal,
    reported_layout,
    suggested_airframe,
)
from gcs_sysid.telemetry.logs import open_log
from gcs_sysid.telemetry.requests import HEARTBEAT_EVERY

if TYPE_CHECKING:  # a log needs no receiver, which takes a while to load
    from gcs_sysid.live.receiver_process import ReceiverProcess
    from gcs_sysid.live.reception import Item

_POLL = 0.05
"""s."""
_REPORTED_WITHIN = 8.0
"""s in which a vehicle, once received, replies with its layout: some 20 parameters."""
_USUAL = 4
"""Rotors that are requested until the vehicle reports their number."""


def of_log(path: Path, options: argparse.Namespace) -> Airframe:
    """The airframe for a log, by the parameters in it.

    Raises:
        InputError: the log cannot be read; or the line names every option that is missing.
    """
    log = open_log(path, options.vehicle)
    for _ in log.blocks():
        pass
    reported = None if log.vehicle is None else reported_layout(log.vehicle.key, log.parameters)
    missing = _missing(reported, options, suggested_airframe(log.kind, log.vehicle))
    if missing:
        raise InputError(f"{path}: {missing}")
    return _airframe(reported, options, str(path))


def _missing(
    reported: ReportedLayout | None, options: argparse.Namespace, suggestion: str | None
) -> str:
    """What a log and the options lack, and all the options that give it; empty if nothing."""
    lacking, give = [], []
    if reported is None:
        lacking.append("layout")
        give.append(
            f"--airframe {suggestion} (the firmware's default order of motors; or FILE.toml)"
            if suggestion
            else f"--airframe FILE.toml or one of {', '.join(builtin_names())}"
        )
    if options.arm is None and not (reported is not None and reported.sized):
        lacking.append("size")
        give.append("--arm M (center to each motor)")
    if not arguments.is_scale_given(options):
        lacking.append("mass")
        give.append("--mass KG (weighed; or --k-t, or --t-max with commands)")
    if not give:
        return ""
    return f"the log does not contain the vehicle's {_listed(lacking)}: give {_listed(give)}"


def _listed(words: list[str]) -> str:
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def of_link(receiver: "ReceiverProcess", options: argparse.Namespace) -> Airframe:
    """The airframe for a vehicle on a link, by requests; what comes meanwhile is kept.

    Raises:
        InputError: the vehicle reports no layout; nothing sets the scale.
        LinkError: the receiver has died.
    """
    from gcs_sysid.telemetry.intake import Intake
    from gcs_sysid.telemetry.parameter_requests import ParameterRequests
    from gcs_sysid.telemetry.receiver import Batch

    output.say(f"listening on {receiver.url} for the vehicle's own layout (--airframe auto)")
    intake = Intake(options.vehicle)
    requests = ParameterRequests(receiver.gate, _USUAL)
    taken: list[Item] = []
    began, heard, beat_at, reported = time.monotonic(), None, -HEARTBEAT_EVERY, None
    while reported is None:
        items = receiver.take(_POLL)
        taken += items
        for item in items:
            if isinstance(item, Batch):
                intake.frames(item.frames, 1e-6 * item.time_us)
        now, vehicle = time.monotonic(), intake.vehicle
        if now - beat_at >= HEARTBEAT_EVERY:
            receiver.gate.heartbeat()
            beat_at = now
        if vehicle is not None:
            if heard is None:
                heard = now
                receiver.follow(vehicle.address)
            requests.tick(now, vehicle, intake.parameters)
            reported = _complete(vehicle.key, intake.parameters, now - heard)
        waited = now - (began if heard is None else heard)
        limit = options.duration if heard is None else _REPORTED_WITHIN
        if receiver.link_report.ended or (limit is not None and waited >= limit):
            break
    receiver.put_back(taken)
    who = (
        "no vehicle was found" if intake.vehicle is None else f"{intake.vehicle} does not report it"
    )
    return _airframe(reported, options, f"{who}: its layout is not known")


def _complete(autopilot: str, parameters: dict[str, float], waited: float) -> ReportedLayout | None:
    """The reported layout, once its outputs are reported too or are overdue."""
    reported = reported_layout(autopilot, parameters)
    if (
        reported is not None
        and len(reported.outputs) < len(reported.rotors)
        and waited < 0.5 * _REPORTED_WITHIN
    ):
        return None
    return reported


def _airframe(
    reported: ReportedLayout | None, options: argparse.Namespace, problem: str
) -> Airframe:
    if reported is None:
        # Says which airframes there are.
        try:
            arguments.airframe_of(options)
        except InputError as error:
            raise InputError(f"{problem}. {str(error)[:1].upper()}{str(error)[1:]}") from None
    assert reported is not None
    airframe = arguments.airframe_of(options, airframe_of_layout(reported, options.arm))
    output.say(f"airframe: {proposal(reported)}")
    return airframe
