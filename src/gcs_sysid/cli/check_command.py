"""`gcs-sysid LOG...`: what a flight is, whether the vehicle is all right, what can be had."""

import argparse
import functools
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from gcs_sysid.cli import airframe_choice, health_command, output
from gcs_sysid.cli.health_command import answer_lines
from gcs_sysid.cli.inspect_command import next_command, objection_lines, obtainable
from gcs_sysid.cli.program import OneByOne
from gcs_sysid.files import split_mapping
from gcs_sysid.health.assessment import ReadLog, beside_analysis
from gcs_sysid.health.health_file import condition_text, document_of
from gcs_sysid.health.vehicle_health import Health, against_first
from gcs_sysid.health.whole_analysis import WholeAnalysis
from gcs_sysid.inspection.inspector import inspect_log
from gcs_sysid.judgement.status import level_of
from gcs_sysid.results.health_view import short_facts
from gcs_sysid.results.result_view import verdict_sentence
from gcs_sysid.results.words import TEXT_WIDTH, wrapped
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import ChainOptions
from gcs_sysid.session.reported_layout import suggested_airframe
from gcs_sysid.telemetry.logs import Log

_NAME = 16
"""Columns of the names at the left."""
_MOST = 2
"""Reasons against an identification that have room on a screen."""


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 where a log does not show whether the vehicle is all right."""
    output.check_outputs(options.json, force=options.force, sources=options.logs)
    given = health_command.given_of(options)
    documents: list[dict[str, Any]] = []
    words: list[str] = []
    one_by_one, deliveries = OneByOne(options.logs), output.Deliveries()
    for log in options.logs:
        with one_by_one.attempt(log):
            bar = output.progress_bar(log)
            # Reading takes some third of the time, before the flight is analyzed.
            reading, rest = output.part_of(bar, 0.0, 0.3), output.part_of(bar, 0.3, 1.0)
            read = ReadLog(Path(log), options.vehicle, reading)
            health = read.health(given)
            given = against_first(given, health)
            document, lines = _found(log, health, read.again(), options, rest)
            documents.append(document)
            words.append(document["summary"]["word"])
            text = "\n".join([*([""] if len(documents) > 1 else []), *lines])
            if options.json != "-":
                deliveries.give(functools.partial(output.show, text))
    deliveries.give_json(documents, options.logs, options.json, force=options.force)
    deliveries.check()
    if one_by_one.failed:
        return 2
    return 1 if "CANNOT TELL" in words else 0


def _found(
    log: str,
    health: Health,
    opened: Log,
    options: argparse.Namespace,
    progress: Callable[[float], None] | None,
) -> tuple[dict[str, Any], list[str]]:
    """The content of a file, and the text for a screen."""
    width = min(output.terminal_width() or TEXT_WIDTH, TEXT_WIDTH)
    airframe = health.airframe
    sized = airframe is not None and health.arm_known and airframe.anchor() is not None
    if airframe is not None and sized and not health.contradicted:
        chain = ChainOptions()
        result = analyze_log(Path(log), airframe, options.vehicle, chain, progress, opened=opened)
        whole = WholeAnalysis(result, beside_analysis(health, result))
        document, health = whole.as_json(), whole.health
        suggestion = suggested_airframe(opened.kind, opened.vehicle)
        command = airframe_choice.command_for(log, health.layout, options, suggestion)
        known = verdict_sentence(result)
        if result.verdict == "refused":
            why = [each.words for each in result.objections if each.verdict != "identified"]
            known = f"not from this flight: {next(iter([*why, *result.reasons]), '')}"
            command = f"gcs-sysid inspect {shlex.quote(log)}"
        more = [*_entry("identified", known, width), *_next(command)]
    else:
        document = document_of(health)
        inspection = inspect_log(Path(log), options.vehicle, progress, opened=opened, health=health)
        more = _entry("can be had", obtainable(inspection), width)
        against = [one for one in inspection.objections if level_of(one) != "note"]
        more += objection_lines(against[:_MOST], width)
        more += _next(next_command(inspection, options) or f"gcs-sysid inspect {shlex.quote(log)}")
    facts = _facts(log, health, document.get("health", document), width)
    return document, [*answer_lines(document["summary"], width), "", *facts, *more]


def _facts(log: str, health: Health, document: dict[str, Any], width: int) -> Iterator[str]:
    name = split_mapping(Path(log))[0].name
    if not health.available or health.rotor_input is None:
        yield name
        for reason in health.reasons[1:]:  # the first one is the answer
            yield from wrapped(reason, "- ", width)
        return
    rotors = f"rotors by {health.rotor_input.words} ({health.rotor_source})"
    yield from wrapped(f"{name}: {health.seconds:.0f} s of hover, {rotors}", "", width)
    for name, text in short_facts(document):
        yield from _entry(name, text, width)
    if health.condition is not None:
        yield from _entry("since the first", condition_text(health.condition), width)


def _next(command: str) -> list[str]:
    return [f"{'all of it':<{_NAME}}{command}"]


def _entry(name: str, text: str, width: int) -> list[str]:
    """A name at the left and its text beside it."""
    return wrapped(text, f"{name:<{_NAME - 1}} ", width)
