"""`gcs-sysid fetch`: a log from the vehicle."""

import argparse
from datetime import UTC, datetime
from pathlib import Path

from gcs_sysid.cli.output import progress_bar, show
from gcs_sysid.errors import InputError, NoAnswerError
from gcs_sysid.files import cannot_write, check_target
from gcs_sysid.telemetry.link import PersistentLink, open_link
from gcs_sysid.telemetry.log_formats import ANY_SUFFIX
from gcs_sysid.telemetry.remote_logs import Exchange, RemoteLog, RemoteLogs
from gcs_sysid.telemetry.transceiver import Transceiver
from gcs_sysid.telemetry.urls import parse_url
from gcs_sysid.telemetry.vehicles import MavlinkSystem

_SUFFIXES = {"px4": ".ulg", "ardupilot": ".bin"}


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    link = PersistentLink(open_link(parse_url(options.url, options.baud)))
    key = Path(options.signing_key) if options.signing_key else None
    port = Transceiver(link, signing_key=key)
    try:
        exchange = Exchange(port, options.vehicle)
        vehicle, logs = exchange.vehicle(), RemoteLogs(exchange)
        listed = logs.listed()
        if not listed:
            raise NoAnswerError(f"{options.url}: {vehicle} has no logs")
        if options.list:
            show("\n".join(map(_row, listed)))
            return 0
        log = _chosen(listed, vehicle, options.number)
        target = Path(options.output or _name(log, vehicle))
        check_target(target, replace=options.force)
        part = target.with_name(f"{target.name}.part")
        try:
            with open(part, "r+b" if part.exists() else "w+b") as file:
                logs.read(log, file, progress_bar(f"log {log.number}"))
            part.replace(target)
        except OSError as error:
            raise cannot_write(target, error) from error
    finally:
        port.close()
    show(f"{target}: {_words(log)}\nnext: gcs-sysid {target}")
    return 0


def _chosen(listed: list[RemoteLog], vehicle: MavlinkSystem, number: int | None) -> RemoteLog:
    if number is None:
        # PX4 numbers them as its folders lie on the card.
        by_time = vehicle.key == "px4"
        return max(listed, key=lambda log: (log.time if by_time else 0, log.number))
    for log in listed:
        if log.number == number:
            return log
    raise InputError(f"{vehicle} has no log {number}; --list shows those that it has")


def _name(log: RemoteLog, vehicle: MavlinkSystem) -> str:
    """Nothing of it is the vehicle's to choose but a known ending."""
    own = Path(log.path).suffix.lower()
    suffix = own if own in ANY_SUFFIX else _SUFFIXES.get(vehicle.key, ".log")
    begun = f"-{_begun(log):%Y-%m-%d_%H-%M-%S}" if log.time else ""
    return f"log{log.number}{begun}{suffix}"


def _row(log: RemoteLog) -> str:
    return f"{log.number:6d}  {_words(log)}"


def _words(log: RemoteLog) -> str:
    begun = f"  {_begun(log):%Y-%m-%d %H:%M:%S} UTC" if log.time else ""
    return f"{log.size / 1e6:9.3f} MB{begun}{log.path and f'  {log.path}'}"


def _begun(log: RemoteLog) -> datetime:
    return datetime.fromtimestamp(log.time, UTC)
