"""`gcs-sysid tune`: margins of the gains that a vehicle has, and gains for it. Nothing is sent."""

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from gcs_sysid.cli.export_command import airframe_for
from gcs_sysid.cli.output import Deliveries, check_json, print_file, save, show, write_json
from gcs_sysid.control.bode_picture import bode_svg
from gcs_sysid.control.rate_loops import AUTOPILOTS, Autopilot
from gcs_sysid.control.tuning_study import (
    document_of,
    joined_vehicle,
    parameter_text,
    study,
    tuning_text,
    with_delay,
    with_deviations,
)
from gcs_sysid.errors import InputError
from gcs_sysid.exports.exported_vehicle import MissingError, Vehicle, assemble
from gcs_sysid.exports.formats import TARGETS
from gcs_sysid.files import check_target
from gcs_sysid.model.parameter_file import SUFFIXES, read_parameter_file
from gcs_sysid.results.result_file import read_result

_OF_TARGET = {"px4-params": "px4", "ardupilot-param": "ardupilot"}
_INDI = {"indi": "indiflight", "paparazzi": "paparazzi"}


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 where the result does not carry gains."""
    path = _target(options)
    check_json(options.json, force=options.force)
    if options.bode is not None:
        check_target(Path(options.bode), replace=options.force)
    if "-" in (options.json, options.output) and options.json == options.output:
        raise InputError("--json and --output cannot both go to standard output")
    vehicle = _vehicle(options)
    try:
        if options.to in _INDI:
            return _effectiveness(options, vehicle, path)
        return _gains(options, vehicle, path)
    except MissingError as error:
        print(f"gcs-sysid: {options.result}: {error}", file=sys.stderr)
        return 1


def _target(options: argparse.Namespace) -> Path | None:
    if (options.to is None) != (options.output is None):
        raise InputError("--to and -o go together: give both, or neither")
    if options.output is None or options.output == "-":
        return None
    path = Path(options.output)
    check_target(path, replace=options.force)
    wanted = {"px4-params": (".params",), "ardupilot-param": (".param", ".parm")}.get(options.to)
    if wanted is not None and path.suffix not in wanted:
        raise InputError(f"{path}: {options.to} is written to a file NAME{wanted[0]}")
    return path


def _vehicle(options: argparse.Namespace) -> Vehicle:
    airframe = airframe_for(options)
    given = {name: float(value) for name, value, _ in options.set}
    deviations = {name: std for name, _, std in options.set if std}
    result = read_result(Path(options.result))
    vehicle = with_delay(assemble(result, airframe, given, options.name))
    if options.beside is not None:
        other = with_delay(assemble(read_result(Path(options.beside)), airframe))
        vehicle = joined_vehicle(vehicle, other)
    return with_deviations(vehicle, deviations)


def _gains(options: argparse.Namespace, vehicle: Vehicle, path: Path | None) -> int:
    parameters, heard = _parameters(options)
    autopilot = _autopilot(options, vehicle, heard, parameters)
    try:
        tuning = study(
            vehicle,
            autopilot,
            parameters,
            delay=options.delay,
            draws=options.draws,
            seed=options.seed,
        )
    except ValueError as error:
        raise InputError(f"{options.result}: {error}") from error
    deliveries = Deliveries()
    if "-" not in (options.json, options.output):
        deliveries.give(lambda: show(tuning_text(tuning)))
    deliveries.give(lambda: write_json(options.json, document_of(tuning), force=options.force))
    if options.bode is not None:
        picture = bode_svg(tuning)
        deliveries.give(lambda: save(Path(options.bode), picture, force=options.force))
    if options.to is not None:
        text = parameter_text(tuning, ".params" if autopilot == "px4" else ".param")
        deliveries.give(lambda: _write(text, path, options))
    deliveries.check()
    return 0


def _effectiveness(options: argparse.Namespace, vehicle: Vehicle, path: Path | None) -> int:
    """G1 and G2, which INDI has in place of gains."""
    if options.json is not None or options.bode is not None:
        raise InputError("--json and --bode are of gains: leave them out with INDI")
    target = TARGETS[_INDI[options.to]]
    _write(target.write(vehicle), path, options)
    for note in target.notes(vehicle):
        print(f"gcs-sysid: note: {note}", file=sys.stderr)
    return 0


def _write(text: str, path: Path | None, options: argparse.Namespace) -> None:
    if path is None:
        print_file(text)
    else:
        save(path, text, force=options.force)


def _parameters(options: argparse.Namespace) -> tuple[Mapping[str, float], str]:
    """The autopilot's parameters from a file of them or a log, and its name by the latter."""
    if options.parameters is None:
        return {}, ""
    path = Path(options.parameters)
    if path.suffix.lower() in SUFFIXES:
        return read_parameter_file(path), ""
    from gcs_sysid.telemetry.logs import open_log  # only who reads a log waits for it

    log = open_log(path, options.vehicle)
    for _ in log.blocks():
        pass
    if not log.parameters:
        raise InputError(
            f"{path}: holds no parameters of the autopilot: give a .params or .param file saved "
            "by the ground station"
        )
    return log.parameters, "" if log.vehicle is None else log.vehicle.key


def _autopilot(
    options: argparse.Namespace, vehicle: Vehicle, heard: str, parameters: Mapping[str, Any]
) -> Autopilot:
    wanted = _OF_TARGET.get(options.to)
    named = options.autopilot or wanted or heard or vehicle.result.vehicle.get("autopilot")
    if options.autopilot and wanted and options.autopilot != wanted:
        raise InputError(f"--to {options.to} is not for --autopilot {options.autopilot}")
    if named not in AUTOPILOTS:
        raise InputError("which autopilot? Give --autopilot px4 or ardupilot")
    prefix = {"px4": "MC_", "ardupilot": "ATC_"}[named]
    if parameters and not any(name.startswith(prefix) for name in parameters):
        raise InputError(
            f"{options.parameters}: holds no {prefix}* parameters: not those of {named}; "
            "give --autopilot, or the right file"
        )
    return cast(Autopilot, named)
