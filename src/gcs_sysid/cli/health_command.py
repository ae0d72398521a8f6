"""`gcs-sysid health`: the vehicle's condition from any flight that hovers."""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from gcs_sysid.cli import arguments, output
from gcs_sysid.cli.health_text import health_text
from gcs_sysid.errors import InputError
from gcs_sysid.files import check_target
from gcs_sysid.health.assessment import health_of_log
from gcs_sysid.health.autopilot_parameters import format_of, parameter_file
from gcs_sysid.health.health_file import document_of, read_baseline
from gcs_sysid.health.health_trend import series_of, trend_text
from gcs_sysid.health.vehicle_health import Given, Health, as_baseline


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when nothing hovers in a log."""
    given = _given(options)
    logs = tuple(map(Path, options.logs))
    output.check_json(options.json, force=options.force)
    for target in (options.params, options.picture):
        if target is not None:
            check_target(Path(target), replace=options.force, sources=logs)
    form = None if options.params is None else format_of(Path(options.params))
    found: list[Health] = []
    unreadable = 0
    for log in logs:
        try:
            health = health_of_log(log, given, options.vehicle)
        except InputError as error:
            if len(logs) == 1:
                raise
            # The others may still be good.
            print(f"gcs-sysid: error: {error}", file=sys.stderr)
            unreadable += 1
            continue
        found.append(health)
        if given.baseline is None:
            first = as_baseline(health)
            given = replace(given, baseline=first and replace(first, asked=False))
        if not health.available:
            why = "; ".join(health.reasons)
            print(f"gcs-sysid: {log}: no result: {why}", file=sys.stderr)
    best = max(
        (health for health in found if health.available), key=lambda h: h.seconds, default=None
    )
    deliveries = output.Deliveries()
    if options.json != "-":
        texts = [health_text(health) for health in found if health.available]
        if trend := trend_text(found):
            texts.append("\n".join(trend))
        if texts:
            deliveries.give(lambda: output.show("\n\n".join(texts)))
    # Files last: what cannot be written costs no number.
    _write(options, found, best, form, deliveries)
    if unreadable:
        return 2
    return 0 if all(health.available for health in found) else 1


def _given(options: argparse.Namespace) -> Given:
    airframe = None
    if options.airframe is not None:
        airframe = arguments.layout_of(options)
    elif options.k_t is not None or options.t_max is not None:
        raise InputError("--k-t and --t-max need --airframe; --mass does without")
    baseline = None if options.baseline is None else read_baseline(Path(options.baseline))
    battery, mass = options.battery_mass, options.mass
    if battery is not None and mass is not None and battery >= mass:
        raise InputError(
            f"--battery-mass {battery:g} must be less than --mass {mass:g}, which includes it"
        )
    return Given(
        airframe, options.arm, options.mass, options.battery_mass, baseline, options.unchanged
    )


def _write(
    options: argparse.Namespace,
    found: list[Health],
    best: Health | None,
    form: str | None,
    deliveries: output.Deliveries,
) -> None:
    """The files that were asked for; parameters and picture are of the longest hover."""
    documents = [document_of(health) for health in found]
    if documents:
        document = documents[0] if len(options.logs) == 1 else documents
        deliveries.give(lambda: output.write_json(options.json, document, force=options.force))
    if best is not None and form is not None:
        text = parameter_file(best, form)
        deliveries.give(lambda: output.save(Path(options.params), text, force=options.force))
    if best is not None and options.picture is not None:
        from gcs_sysid.report.health_picture import health_picture  # only who asks waits for it

        usable = [health for health in found if health.available and not health.apart]
        picture = health_picture(document_of(best), series_of(usable) if len(usable) > 1 else ())
        deliveries.give(lambda: output.save(Path(options.picture), picture, force=options.force))
    deliveries.check()
