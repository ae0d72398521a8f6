"""`gcs-sysid export`: an identified vehicle as a file that a simulator loads."""

import argparse
from contextlib import closing
from pathlib import Path

from gcs_sysid.cli.airframe_choice import airframe_of, beside_result
from gcs_sysid.cli.output import check_outputs, print_file, progress_bar, say
from gcs_sysid.errors import InputError
from gcs_sysid.exports import FORMATS
from gcs_sysid.exports.autopilot_simulators import mission
from gcs_sysid.exports.exported_vehicle import (
    ExportedVehicle,
    MissingError,
    assemble,
    drawn_vehicles,
)
from gcs_sysid.exports.file_format import Format
from gcs_sysid.files import check_target, log_file, write_whole
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.report.data import signal_table, writer_of
from gcs_sysid.results.result_file import read_result
from gcs_sysid.session.analysis import aligned_samples, analyze_log
from gcs_sysid.telemetry.logs import open_log
from gcs_sysid.twin.measured_flight import FlightRecorder


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when the result lacks what the format needs."""
    if options.signals is not None:
        return _signals(options)
    if options.to is None or options.output is None:
        raise InputError("give --to FORMAT and --output FILE, or --signals FILE with a log")
    path = None if options.output == "-" else Path(options.output)
    if options.ensemble is None:
        check_outputs(options.output, force=options.force, sources=[options.result])
    result = read_result(Path(options.result))
    vehicle = assemble(result, beside_result(options), dict(options.set), options.name)
    target = FORMATS[options.to]
    plan = _mission(options, vehicle, target, path)
    try:
        text = target.write(vehicle)
        if options.ensemble is not None:
            _ensemble(options, vehicle, target, path)
        elif path is None:
            print_file(text)
        else:
            write_whole(path, text, replace=options.force)
        for place, way in plan:
            write_whole(place, way, replace=options.force)
    except MissingError as error:
        say(f"gcs-sysid: {options.result}: {error}")
        return 1
    for note in target.notes(vehicle):
        say(f"gcs-sysid: note: {note}")
    return 0


def _mission(
    options: argparse.Namespace, vehicle: ExportedVehicle, target: Format, path: Path | None
) -> list[tuple[Path, str]]:
    """The way of a log's flight beside the vehicle that flies it, where that is asked for."""
    if options.along is None:
        return []
    if target.begins is None or path is None:
        raise InputError("--along goes with -o FILE and a simulator that flies missions: px4-sih, "
                         "px4-sih-1.17 or ardupilot-sitl")  # fmt: skip
    place = path.with_suffix(".plan")
    check_outputs(str(place), force=options.force, sources=[options.along])
    log = open_log(Path(options.along), options.vehicle)
    samples = aligned_samples(log, Airframe("result", vehicle.rotors))
    return [(place, mission(samples, target.begins, target.name.startswith("px4")))]


def _signals(options: argparse.Namespace) -> int:
    """Write the signals of a log; 1 when nothing flies in it."""
    if options.to is not None or options.output is not None:
        raise InputError("--signals names its own file: give neither --to nor -o with it")
    target, log = Path(options.signals), Path(options.result)
    write = writer_of(target)
    check_target(target, replace=options.force, sources=(log_file(log),))
    airframe = airframe_of(options)
    with closing(FlightRecorder()) as recorder:
        result = analyze_log(
            log, airframe, options.vehicle, progress=progress_bar(str(log)), observers=[recorder]
        )
        table = signal_table(result, recorder, airframe)
    if not len(table["t"]):
        why = "; ".join(result.reasons)
        say(f"gcs-sysid: {log}: no signals to write: {why}")
        return 1
    write_whole(target, write(table), replace=options.force)
    print(f"{target}: {len(table['t'])} rows of {len(table)} columns")
    return 0


def _ensemble(
    options: argparse.Namespace, vehicle: ExportedVehicle, target: Format, path: Path | None
) -> None:
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
        write_whole(place, target.write(one), replace=options.force)
