"""`gcs-sysid inspect`: what is in a log or on a link, and whether it can be identified from."""

import argparse
import shutil
import threading
from pathlib import Path

from gcs_sysid.cli import arguments, output
from gcs_sysid.cli.inspection_text import report
from gcs_sysid.cli.signals import on_signals
from gcs_sysid.errors import InputError
from gcs_sysid.files import TABLE_SUFFIXES, log_file
from gcs_sysid.inspection.derived_facts import assumed_airframe
from gcs_sysid.inspection.facts import Inspection
from gcs_sysid.inspection.inspector import inspect_link, inspect_log
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.telemetry.link import open_link
from gcs_sysid.telemetry.urls import LOG_SUFFIXES, parse_url

WIDEST = 120
"""Columns that lines are wrapped to at most: longer ones are hard to read."""


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when nothing at all was received on a link."""
    if options.target is None and options.json not in (None, "-"):
        # `inspect --json LOG`: the option took the log for its file.
        options.target, options.json = options.json, "-"
    if options.target is None:
        raise InputError("give a LOG (.tlog, .ulg, .bin, .bbl) or a link's URL")
    is_log = _is_log(options.target)
    output.check_json(options.json, force=options.force)
    found = _log(options) if is_log else _link(options)
    deliveries = output.Deliveries()
    if options.json != "-":
        width = min(shutil.get_terminal_size((80, 24)).columns, WIDEST)
        deliveries.give(lambda: output.show(report(found, width)))
    deliveries.give(lambda: output.write_json(options.json, found.as_json(), force=options.force))
    deliveries.check()
    return 0 if found.heard else 1


def _is_log(target: str) -> bool:
    """Whether it is a file, or is named like one; serial devices are neither."""
    path = log_file(Path(target))
    return path.is_file() or path.is_dir() or path.suffix.lower() in LOG_SUFFIXES | TABLE_SUFFIXES


def _airframe(options: argparse.Namespace) -> Airframe | None:
    """As named, or with the given number of rotors; None: by the vehicle's type."""
    scale = [options.mass, options.k_t, options.t_max]
    if options.airframe is not None:
        if options.rotors is not None:
            raise InputError("--rotors and --airframe exclude each other")
        return arguments.layout_of(options)
    if options.arm is not None or scale.count(None) < len(scale):
        raise InputError("--arm and a scale need --airframe")
    return None if options.rotors is None else assumed_airframe(options.rotors)


def _log(options: argparse.Namespace) -> Inspection:
    path, progress = Path(options.target), output.progress_bar(options.target)
    return inspect_log(path, options.vehicle, progress, _airframe(options))


def _link(options: argparse.Namespace) -> Inspection:
    try:
        url = parse_url(options.target, options.baud)
    except InputError as error:
        raise InputError(f"{options.target} is no file; {error}") from error
    stop = threading.Event()
    airframe = _airframe(options)
    link = open_link(url)
    with on_signals(stop.set):
        return inspect_link(
            link,
            options.duration,
            rate=options.rate,
            airframe=airframe,
            listen_only=options.listen_only,
            wanted=options.vehicle,
            signing_key=Path(options.signing_key) if options.signing_key else None,
            stop=stop.is_set,
            progress=output.progress_bar(f"listening on {url}"),
        )
