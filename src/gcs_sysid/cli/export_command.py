"""`gcs-sysid export`: an identified vehicle as a file that a simulator loads."""

import argparse
import sys
from pathlib import Path

from gcs_sysid.cli.output import print_file, save
from gcs_sysid.errors import InputError
from gcs_sysid.exports.exported_vehicle import MissingError, Vehicle, assemble
from gcs_sysid.exports.formats import TARGETS, Target
from gcs_sysid.exports.vehicle_ensemble import drawn_vehicles
from gcs_sysid.files import check_target
from gcs_sysid.model.airframe import Airframe, load_airframe
from gcs_sysid.results.result_file import read_result


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when the result does not tell what the format needs."""
    path = None if options.output == "-" else Path(options.output)
    if path is not None and path.exists() and not options.force and options.ensemble is None:
        raise InputError(f"{path} exists; --force overwrites it")
    result = read_result(Path(options.result))
    vehicle = assemble(result, airframe_for(options), dict(options.set), options.name)
    target = TARGETS[options.to]
    try:
        text = target.write(vehicle)
        if options.ensemble is not None:
            return _ensemble(options, vehicle, target, path)
    except MissingError as error:
        print(f"gcs-sysid: {options.result}: {error}", file=sys.stderr)
        return 1
    if path is None:
        print_file(text)
    else:
        save(path, text, force=options.force)
    for note in target.notes(vehicle):
        print(f"gcs-sysid: note: {note}", file=sys.stderr)
    return 0


def _ensemble(
    options: argparse.Namespace, vehicle: Vehicle, target: Target, path: Path | None
) -> int:
    """Vehicles drawn from the covariance, a file each: NAME-001.xml beside NAME.xml."""
    if path is None:
        raise InputError("--ensemble writes several files: give -o FILE, not -")
    digits = max(3, len(str(options.ensemble)))
    places = [
        path.with_name(f"{path.stem}-{i:0{digits}}{path.suffix}")
        for i in range(1, options.ensemble + 1)
    ]
    for place in places:
        check_target(place, replace=options.force)
    try:
        drawn = drawn_vehicles(vehicle, options.ensemble, options.seed)
    except ValueError as error:
        raise InputError(f"{options.result}: {error}") from error
    for place, one in zip(places, drawn, strict=True):
        save(place, target.write(one), force=options.force)
    for note in target.notes(vehicle):
        print(f"gcs-sysid: note: {note}", file=sys.stderr)
    return 0


def airframe_for(options: argparse.Namespace) -> Airframe | None:
    """The airframe of --airframe and --arm; None: not given.

    Raises:
        InputError: there is no such airframe.
    """
    if options.airframe is None:
        if options.arm is not None:
            raise InputError("--arm needs --airframe")
        return None
    airframe = load_airframe(options.airframe)
    return airframe if options.arm is None else airframe.with_arm(options.arm)
