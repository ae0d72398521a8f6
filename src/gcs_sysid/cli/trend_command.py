"""`gcs-sysid trend`: a fleet's vehicles over their flights, as a page."""

import argparse
from pathlib import Path

from gcs_sysid.cli.output import say
from gcs_sysid.errors import InputError, needed
from gcs_sysid.files import check_target, write_whole
from gcs_sysid.fleet import batch as table
from gcs_sysid.fleet.batch import TABLE
from gcs_sysid.fleet.trend import render, vehicles_of


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when no log of the fleet has a result."""
    needed("pyarrow.parquet", "the fleet's table")
    fleet, target = Path(options.fleet), Path(options.output)
    file = fleet / TABLE if fleet.is_dir() else fleet
    if fleet.is_dir() and not file.is_file():
        raise InputError(f"{fleet}: no {TABLE} here; gcs-sysid batch writes it at the end")
    check_target(target, replace=options.force, sources=(file,))
    vehicles, unused = vehicles_of(table.read_table(file))
    name = (fleet if fleet.is_dir() else file).resolve()
    write_whole(target, render(name.name, vehicles, unused), replace=options.force)
    if vehicles:
        return 0
    say(f"gcs-sysid: {file}: no log identified any parameter, and none hovers")
    return 1
