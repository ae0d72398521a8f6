"""`gcs-sysid params`: the autopilot's parameters by flights: set, leave, or what to fly."""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

from gcs_sysid.cli import output
from gcs_sysid.cli.health_command import flights_of
from gcs_sysid.health.autopilot_parameters import (
    Proposal,
    check_suffix,
    determined,
    excluded,
    proposal_file,
)
from gcs_sysid.health.vehicle_health import Health
from gcs_sysid.results.words import rounded, wrapped

_SCHEMA = "gcs-sysid-params/1"
_ROW = "{:<22}{:>10}{:>10}{:>10}  {}"


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when no flight of one vehicle counts."""
    targets = options.json, options.output
    output.check_outputs(*targets, force=options.force, sources=options.logs)
    if options.output is not None:
        check_suffix(Path(options.output))
    flights, failed = flights_of(options)
    if not flights:
        return 2
    found = determined(flights)
    files: list[tuple[str | None, Callable[[], str]]] = [
        (options.json, lambda: output.as_json(_document(flights, found)))
    ]
    if found and options.output is not None:
        suffix = Path(options.output).suffix.lower()
        files.append((options.output, lambda: proposal_file(flights, found, suffix)))
    output.deliver("\n".join(_text(flights, found)), *files, force=options.force)
    if failed:
        return 2
    return 0 if found else 1


def _document(flights: Sequence[Health], found: Sequence[Proposal]) -> dict[str, Any]:
    used = [health for health in flights if not excluded(health)]
    return {
        "schema": _SCHEMA,
        "vehicle": dict(used[-1].vehicle) if used else None,
        "logs": [
            {
                "source": health.source,
                "seconds_of_hover": health.seconds,
                "excluded": excluded(health) or None,
                "assumptions": list(health.assumptions),
            }
            for health in flights
        ],
        "parameters": [one.as_json() for one in found],
    }


def _text(flights: Sequence[Health], found: Sequence[Proposal]) -> Iterator[str]:
    used = [health for health in flights if not excluded(health)]
    # What contradicts the flight comes first: nothing that depends on it is set.
    for health in flights:
        if why := excluded(health):
            yield from wrapped(f"{Path(health.source).name} does not count: {why}")
    seen = {found.at: found.what for health in used for found in health.findings}
    for at, what in seen.items():
        yield from wrapped(f"LOOK AT {at}: {what}")
    if not used:
        return
    seconds = sum(health.seconds for health in used)
    count = Path(used[0].source).name if len(used) == 1 else f"{len(used)} flights"
    if seen or len(used) < len(flights):
        yield ""
    head = f"Autopilot parameters by {count}, {seconds:.0f} s of hover (nothing is sent)"
    yield from wrapped(head)
    if not found:
        yield "the log has none of the parameters that a flight shows"
        return
    yield _ROW.format("", "old", "new", "± 95 %", "").rstrip()
    for (reason, action), alike in groupby(found, lambda one: (one.reason, one.action)):
        some = list(alike)
        if len(some) > 2 and all(one.quantity is None for one in some):
            some = [replace(some[0], name=f"{some[0].name} ..", now=None), some[-1]]
        yield from map(_row, some)
        yield from wrapped(reason, "    ")
        if action:
            yield from wrapped(action, "    -> ")
    yield ""
    for text in used[-1].assumptions:
        yield from wrapped(f"assumed: {text}")


def _row(one: Proposal) -> str:
    half = None if one.quantity is None else one.quantity.half
    interval = f"{half:.2g}" if half else "-"
    old, new = rounded(one.now, None, 4), rounded(one.new, half, 4)
    return _ROW.format(one.name, old, new, interval, one.verdict)
