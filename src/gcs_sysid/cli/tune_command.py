"""`gcs-sysid tune`: margins of the gains that a vehicle has, and gains for it. Nothing is sent."""

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from gcs_sysid.cli.export_command import airframe_for
from gcs_sysid.cli.output import (
    Deliveries,
    check_json,
    is_device,
    show,
    write_json,
    write_text,
)
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
from gcs_sysid.model.parameter_file import SUFFIXES, read_parameter_file
from gcs_sysid.results.result_file import read_result

_OF_TARGET = {"px4-params": "px4", "ardupilot-param": "ardupilot"}
_INDI = {"indi": "indiflight", "paparazzi": "paparazzi"}


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 where the result does not carry gains."""
    _check_outputs(options)
    vehicle = _vehicle(options)
    try:
        if options.to in _INDI:
            return _effectiveness(options, vehicle)
        return _gains(options, vehicle)
    except MissingError as error:
        print(f"gcs-sysid: {options.result}: {error}", file=sys.stderr)
        return 1


def _check_outputs(options: argparse.Namespace) -> None:
    """See beforehand whether all that is asked for can be written."""
    if (options.to is None) != (options.output is None):
        raise InputError("--to and -o go together: give both, or neither")
    for path in (options.json, options.output, options.bode):
        check_json(path, force=options.force)
    if (options.json, options.output, options.bode).count("-") > 1:
        raise InputError("--json, --bode and --output: only one can go to standard output")
    wanted = {"px4-params": (".params",), "ardupilot-param": (".param", ".parm")}.get(options.to)
    if wanted is None or options.output == "-" or is_device(options.output):
        return
    if Path(options.output).suffix not in wanted:
        raise InputError(f"{options.output}: {options.to} is written to a file NAME{wanted[0]}")


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


def _gains(options: argparse.Namespace, vehicle: Vehicle) -> int:
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
    if "-" not in (options.json, options.output, options.bode):
        deliveries.give(lambda: show(tuning_text(tuning)))
    deliveries.give(lambda: write_json(options.json, document_of(tuning), force=options.force))
    if options.bode is not None:
        picture = bode_svg(tuning)
        deliveries.give(lambda: write_text(options.bode, picture, force=options.force))
    if options.to is not None:
        text = parameter_text(tuning, ".params" if autopilot == "px4" else ".param")
        deliveries.give(lambda: write_text(options.output, text, force=options.force))
    deliveries.check()
    return 0


def _effectiveness(options: argparse.Namespace, vehicle: Vehicle) -> int:
    """G1 and G2, which INDI has in place of gains."""
    if options.json is not None or options.bode is not None:
        raise InputError("--json and --bode apply to gains: leave them out with INDI")
    target = TARGETS[_INDI[options.to]]
    write_text(options.output, target.write(vehicle), force=options.force)
    for note in target.notes(vehicle):
        print(f"gcs-sysid: note: {note}", file=sys.stderr)
    return 0


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
