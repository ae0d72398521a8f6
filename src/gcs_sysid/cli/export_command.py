"""`gcs-sysid export`: an identified vehicle as a file that a simulator loads."""

import argparse
import sys
from pathlib import Path

from gcs_sysid.cli.output import print_file, save
from gcs_sysid.errors import InputError
from gcs_sysid.exports.exported_vehicle import MissingError, assemble
from gcs_sysid.exports.formats import TARGETS
from gcs_sysid.model.airframe import Airframe, load_airframe
from gcs_sysid.results.result_file import read_result


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when the result does not tell what the format needs."""
    path = None if options.output == "-" else Path(options.output)
    if path is not None and path.exists() and not options.force:
        raise InputError(f"{path} exists; --force overwrites it")
    result = read_result(Path(options.result))
    vehicle = assemble(result, _airframe(options), dict(options.set), options.name)
    target = TARGETS[options.to]
    try:
        text = target.write(vehicle)
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


def _airframe(options: argparse.Namespace) -> Airframe | None:
    if options.airframe is None:
        if options.arm is not None:
            raise InputError("--arm needs --airframe")
        return None
    airframe = load_airframe(options.airframe)
    return airframe if options.arm is None else airframe.with_arm(options.arm)
