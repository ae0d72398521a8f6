"""`gcs-sysid health`: the vehicle's condition from any flight that hovers, in lines of text."""

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from gcs_sysid.cli import airframe_choice, output
from gcs_sysid.cli.program import OneByOne
from gcs_sysid.errors import InputError
from gcs_sysid.health.assessment import ReadLog
from gcs_sysid.health.autopilot_parameters import (
    Proposal,
    check_suffix,
    determined,
    proposal_file,
    proposed,
)
from gcs_sysid.health.health_file import condition_text, document_of, read_baseline
from gcs_sysid.health.health_trend import series_of, trend_text
from gcs_sysid.health.vehicle_health import Health, HealthOptions, against_first
from gcs_sysid.results.health_view import (
    cg_facts,
    health_fact,
    off_words,
    quantity_text,
    rotor_cells,
    telling,
    unequal_rotors,
)
from gcs_sysid.results.words import PLAIN, TEXT_WIDTH, wrapped


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when nothing hovers in a log."""
    targets = options.json, options.params, options.picture
    output.check_outputs(*targets, force=options.force, sources=options.logs)
    if options.params is not None:
        check_suffix(Path(options.params))
    found, failed = flights_of(options)
    usable = [health for health in found if health.available]
    _deliver(options, found, usable)
    if failed:
        return 2
    return 0 if len(usable) == len(found) else 1


def flights_of(options: argparse.Namespace) -> tuple[list[Health], bool]:
    """The vehicle's condition by each log that can be read, and whether one cannot.

    Each is compared with the first.

    Raises:
        InputError: the options contradict each other.
    """
    given = given_of(options)
    found: list[Health] = []
    one_by_one = OneByOne(options.logs)
    for log in options.logs:
        with one_by_one.attempt(log):
            bar = output.progress_bar(log)
            health = ReadLog(Path(log), options.vehicle, bar).health(given)
            found.append(health)
            given = against_first(given, health)
    return found, bool(one_by_one.failed)


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


def _deliver(options: argparse.Namespace, found: list[Health], usable: list[Health]) -> None:
    """Texts and files; parameters are of all flights, the picture of the longest hover."""
    best = max(usable, key=lambda health: health.seconds, default=None)
    texts = [health_text(health) for health in found]
    if trend := trend_text(found):
        texts.append("\n".join([*trend, *_parameters(proposed(usable), " (of all flights)")]))
    documents = [document_of(health) for health in found]
    files: list[tuple[str | None, Callable[[], str]]] = []
    if documents:
        document = documents[0] if len(options.logs) == 1 else documents
        files.append((options.json, lambda: output.as_json(document)))
    if usable and options.params is not None:
        suffix = Path(options.params).suffix.lower()
        every = determined(usable)
        files.append((options.params, lambda: proposal_file(usable, every, suffix)))
    if best is not None and options.picture is not None:
        from gcs_sysid.report.page import health_picture  # only who asks waits for it

        alike = [health for health in usable if not health.apart]
        series = series_of(alike) if len(alike) > 1 else ()
        files.append((options.picture, lambda: health_picture(document_of(best), series)))
    # Files last: what cannot be written costs no number.
    output.deliver("\n\n".join(texts), *files, force=options.force)


_NAME = 20


def health_text(health: Health, *, answered: bool = False) -> str:
    """All that hover shows of a vehicle, in lines.

    Args:
        health: of a flight; of one that does not hover there is the first line alone.
        answered: whether the first line was given before; else it is here.
    """
    document = document_of(health)
    answer = [] if answered else [*answer_lines(document["summary"], TEXT_WIDTH), ""]
    if not health.available:
        others = (f"- {reason}" for reason in health.reasons[1:])
        return "\n".join([*answer, health.source, *others])
    foot = _foot(health, document["summary"]["action"])
    parameters = _parameters(proposed([health]))
    whole = [*_head(health, document), "", *_rotors(document), *parameters, *foot]
    return "\n".join([*answer, *whole])


def answer_lines(answer: Mapping[str, str], width: int) -> list[str]:
    """The first line and what to do first."""
    return [
        *wrapped(answer["line"], "", width),
        *wrapped(answer["action"], "-> ", width),
    ]


def _head(health: Health, document: Mapping[str, Any]) -> Iterator[str]:
    yield health.source
    assert health.rotor_input is not None
    what = health.rotor_input.words
    yield f"{health.seconds:.0f} s of hover, rotors by {what} ({health.rotor_source})"
    yield ""
    for name, size, way, alike in cg_facts(document):
        yield from _line(name, f"{size} {way} of the center ({alike})")
    if unequal := unequal_rotors(document):
        yield from _line("", unequal)
    if health.by_wind is not None and max(map(abs, health.by_wind)) > 2e-3:  # m worth a line
        perhaps = f"perhaps {off_words(*health.by_wind, ', ')}: fly in calm air to know"
        yield from _line("  wind contribution", perhaps)
    for key in ("yaw_imbalance", "hover_throttle", "thrust_to_weight"):
        yield from _fact(document, key)
    for name in ("k_T", "T_max", "mass"):
        if telling(quantity := document.get(name)):
            yield from _line(name, quantity_text(quantity or {}))
    if health.curve is not None:
        curve = health.curve
        origin = curve.origin if curve.origin in ("given", "assumed") else f"by {curve.origin}"
        yield from _line("thrust curve", PLAIN.measure(curve.c.value, curve.c.half, origin))
    yield from _fact(document, "drift_per_minute")
    if health.motor_lag:
        yield from _line("motor lag", f"{1e3 * health.motor_lag:.0f} ms")
    if health.condition is not None:
        yield from _line("rotors", condition_text(health.condition))
    if health.apart:
        yield from _line("rotors", health.apart)
    if health.weakened is not None:
        weak_rotor = condition_text(health.weakened.condition)
        yield from _line("in this flight", f"by {health.weakened.t:.0f} s {weak_rotor}")


def _line(name: str, text: str) -> list[str]:
    return wrapped(text, f"{name:<{_NAME}}")


def _fact(document: Mapping[str, Any], key: str) -> Iterator[str]:
    found = health_fact(document, key, whole=True)
    if found is not None:
        yield from _line(*found)


def _rotors(document: Mapping[str, Any]) -> Iterator[str]:
    columns = ["rotor", "thrust share", "motor gain", "throttle left", "at full", "vibration"]
    yield "".join(f"{name:>14}" if i else f"{name:<6}" for i, name in enumerate(columns))
    for number, rotor in enumerate(document["rotors"], 1):
        yield f"{number:<6}" + "".join(f"{cell:>14}" for cell in rotor_cells(rotor, "m/s^2"))


def _parameters(found: Sequence[Proposal], of: str = "") -> Iterator[str]:
    if not found:
        return
    yield ""
    yield f"Autopilot parameters that fit{of} (`gcs-sysid params` says which to set)"
    for one in found:
        assert one.quantity is not None
        half = one.quantity.half or 0.0
        now = "" if one.now is None else f"  now {one.now:.4g}"
        interval = f" ± {half:.3f}" if half else ""
        yield f"  {one.name:<{_NAME - 2}}{one.quantity.value:.3f}{interval}{now}"


def _foot(health: Health, first: str) -> Iterator[str]:
    others = [text for text in health.advice if text != first]
    if others:
        yield ""
        for text in others:
            yield from wrapped(text, "-> ")
    yield ""
    for text in health.assumptions:
        yield from wrapped(f"assumed: {text}", "")
