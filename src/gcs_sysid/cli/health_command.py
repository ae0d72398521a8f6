"""`gcs-sysid health`: the vehicle's condition from any flight that hovers."""

import argparse
from collections.abc import Callable
from pathlib import Path

from gcs_sysid.cli import airframe_choice, output
from gcs_sysid.cli.failures import OneByOne
from gcs_sysid.cli.health_table import health_text
from gcs_sysid.errors import InputError
from gcs_sysid.files import check_target
from gcs_sysid.health.assessment import health_of_log
from gcs_sysid.health.autopilot_parameters import format_of, parameter_file
from gcs_sysid.health.health_file import document_of, read_baseline
from gcs_sysid.health.health_trend import series_of, trend_text
from gcs_sysid.health.vehicle_health import Health, HealthOptions, against_first


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when nothing hovers in a log."""
    given = given_of(options)
    output.check_outputs(options.json, force=options.force)
    for target in (options.params, options.picture):
        if target is not None:
            check_target(
                Path(target), replace=options.force, sources=tuple(map(Path, options.logs))
            )
    form = None if options.params is None else format_of(Path(options.params))
    found: list[Health] = []
    one_by_one = OneByOne(options.logs)
    for log in options.logs:
        with one_by_one.attempt(log):
            health = health_of_log(Path(log), given, options.vehicle)
            found.append(health)
            given = against_first(given, health)
            if not health.available:
                output.say(f"gcs-sysid: {log}: no result: {'; '.join(health.reasons)}")
    usable = [health for health in found if health.available]
    _deliver(options, found, usable, form)
    if one_by_one.failed:
        return 2
    return 0 if len(usable) == len(found) else 1


def given_of(options: argparse.Namespace) -> HealthOptions:
    """What the options say of the vehicle.

    Raises:
        InputError: they contradict each other.
    """
    airframe = None
    if options.airframe is not None:
        airframe = airframe_choice.layout_of(options)
    elif options.k_t is not None or options.t_max is not None:
        raise InputError("--k-t and --t-max need --airframe; --mass does without")
    baseline = None if options.baseline is None else read_baseline(Path(options.baseline))
    battery, mass = options.battery_mass, options.mass
    if battery is not None and mass is not None and battery >= mass:
        raise InputError(
            f"--battery-mass {battery:g} must be less than --mass {mass:g}, which includes it"
        )
    return HealthOptions(
        airframe, options.arm, options.mass, options.battery_mass, baseline, options.unchanged
    )


def _deliver(
    options: argparse.Namespace, found: list[Health], usable: list[Health], form: str | None
) -> None:
    """Texts and files; parameters and picture are of the longest hover."""
    best = max(usable, key=lambda health: health.seconds, default=None)
    texts = [health_text(health) for health in usable]
    texts += ["\n".join(trend)] if (trend := trend_text(found)) else []
    documents = [document_of(health) for health in found]
    files: list[tuple[str | None, Callable[[], str]]] = []
    if documents:
        document = documents[0] if len(options.logs) == 1 else documents
        files.append((options.json, lambda: output.as_json(document)))
    if best is not None and form is not None:
        files.append((options.params, lambda: parameter_file(best, form)))
    if best is not None and options.picture is not None:
        from gcs_sysid.report.health_picture import health_picture  # only who asks waits for it

        alike = [health for health in usable if not health.apart]
        series = series_of(alike) if len(alike) > 1 else ()
        files.append((options.picture, lambda: health_picture(document_of(best), series)))
    # Files last: what cannot be written costs no number.
    output.deliver("\n\n".join(texts), *files, force=options.force)
