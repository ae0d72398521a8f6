"""`gcs-sysid inspect`: what is in a log or on a link, and whether it can be identified from."""

import argparse
import math
import shutil
import threading
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path

from gcs_sysid.cli import airframe_choice, output
from gcs_sysid.cli.output import on_signals
from gcs_sysid.errors import InputError
from gcs_sysid.files import TABLE_SUFFIXES, log_file
from gcs_sysid.inspection.facts import (
    GROUPS,
    ONBOARD,
    Inspection,
    Obtainable,
    RotorMessage,
    StreamFacts,
    group_of,
    role,
)
from gcs_sysid.inspection.inspector import inspect_link, inspect_log
from gcs_sysid.inspection.stream_watch import assumed_airframe
from gcs_sysid.inspection.thresholds import THRESHOLDS
from gcs_sysid.judgement.status import level_of
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.estimate import Objection
from gcs_sysid.results.words import STREAM_WORDS, losses, wrapped
from gcs_sysid.session.reported_layout import suggested_airframe
from gcs_sysid.telemetry.link import open_link
from gcs_sysid.telemetry.log_formats import ANY_SUFFIX, BY_NAME, usual_endings
from gcs_sysid.telemetry.message_table import RPM
from gcs_sysid.telemetry.urls import parse_url

_ROLES = {
    "vehicle": "vehicle",
    "radio": "telemetry radio",
    "gcs": "ground station",
    "other": "other",
    "unknown": "no heartbeat",
}
_RECOGNIZED_BY = {
    "autopilot": "",
    "rotors": " (armed with rotors turning; not reported by the autopilot)",
    "arming": " (armed; flight is not reported by the autopilot)",
    "": "",
}
_OBTAINABLE: dict[Obtainable, str] = {
    "everything": "everything: scale, CG, inertia, rotor coefficients",
    "all but Izz": "scale, CG, Ixx, Iyy; yaw was hardly flown, so Izz and k_M are poorly "
    "determined",
    "in part": "CG and scale from hover; inertia as far as it was flown, perhaps rough",
    "health": "health alone: CG, rotor loads, thrust curve and margins from hover, no inertia",
    "nothing": "nothing",
}
_NAME = 14
"""Columns of the names at the left."""
_TIE = "\u00a0"
"""A space at which lines do not break."""


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when nothing at all was received on a link."""
    if options.target is None and options.json not in (None, "-"):
        # `inspect --json LOG`: the option took the log for its file.
        options.target, options.json = options.json, "-"
    if options.target is None:
        raise InputError(f"give a LOG ({usual_endings()}) or a link's URL")
    is_log = _is_log(options.target)
    read = (options.target,) if is_log else ()
    output.check_outputs(options.json, force=options.force, sources=read)
    found = _log(options) if is_log else _link(options)
    # Lines of more than 120 columns are hard to read.
    width = min(shutil.get_terminal_size((80, 24)).columns, 120)
    document = (options.json, lambda: output.as_json(found.as_json()))
    command = next_command(found, options)
    text = "\n".join([report(found, width), *(["", f"Next: {command}"] if command else [])])
    output.deliver(text, document, force=options.force)
    return 0 if found.is_received else 1


def _is_log(target: str) -> bool:
    """Whether it is a file, or is named like one; serial devices are neither."""
    path = log_file(Path(target))
    return path.is_file() or path.is_dir() or path.suffix.lower() in ANY_SUFFIX | TABLE_SUFFIXES


def _airframe(options: argparse.Namespace) -> Airframe | None:
    """As named, or with the given number of rotors; None: by the vehicle's type."""
    if options.airframe is not None:
        if options.rotors is not None:
            raise InputError("--rotors and --airframe exclude each other")
        return airframe_choice.layout_of(options)
    if options.arm is not None or airframe_choice.given_scale(options):
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


def report(found: Inspection, width: int = 80) -> str:
    """All that was found, in lines of at most `width` columns where words allow it."""
    parts = [
        _head(found, width),
        _systems(found),
        _streams(found, width),
        _clock(found, width),
        _rotors(found, width),
        _motion(found),
        _parameters(found, width),
        [
            f"Can be identified from: {found.verdict.upper()}",
            *_entry("Obtainable", obtainable(found), width),
            *objection_lines(found.objections, width),
        ],
    ]
    return "\n\n".join("\n".join(part) for part in parts if part)


def _entry(name: str, text: str, width: int) -> list[str]:
    """A name at the left and its text beside it."""
    lines = wrapped(text, f"{name:<{_NAME}}", max(width, 40))
    return [line.replace(_TIE, " ") for line in lines]


def _head(found: Inspection, width: int) -> list[str]:
    lines = [found.source, f"{_kind(found)}, {found.duration:.1f} s"]
    if found.flights:
        most = 8
        spans = [f"{start:.0f}-{end:.0f} s" for start, end in found.flights[:most]]
        more = [f"{len(found.flights) - most} more"] if len(found.flights) > most else []
        count = "1 flight" if len(found.flights) == 1 else f"{len(found.flights)} flights"
        text = f"in the air {found.in_air:.1f} s, {count}: {', '.join(spans + more)}"
        lines += wrapped(text + _RECOGNIZED_BY[found.flight_told_by], "", width)
    elif found.flight_told_by:
        lines.append("never in the air" + _RECOGNIZED_BY[found.flight_told_by])
    return lines


def _kind(found: Inspection) -> str:
    return "live link" if found.kind == "link" else BY_NAME[found.kind].words


def _systems(found: Inspection) -> list[str]:
    if not found.systems:
        return []
    rows = []
    for system in found.systems:
        address = f"{system.system}:{system.component}"
        name = str(system).removesuffix(address).strip()
        what = _ROLES[role(system)]
        chosen = ", inspected" if system.address == found.vehicle_address else ""
        rows.append((address, name or "?", what + chosen))
    wide = max(len(name) for _, name, _ in rows)
    return ["Systems", *(f"  {a:<{_NAME - 2}}{n:<{wide}}  {w}".rstrip() for a, n, w in rows)]


def _streams(found: Inspection, width: int) -> list[str]:
    where = "in flight" if found.flights else "all of it"
    lines = []
    if found.streams:
        lines.append(
            f"{'Streams':<{_NAME}}{where:<22}{'rate':>10}{'gaps':>6}{'longest':>9}"
            f"{'missing':>9}{'repeats':>9}"
        )
        lines += [
            _stream_row(list(parts))
            for _, parts in groupby(found.streams, key=lambda part: (part.stream, part.message))
        ]
    elif found.systems:
        lines.append("Messages")
    messages = found.telemetry.get("messages", {})
    used = {stream.message for stream in found.streams}
    others = {name: entry for name, entry in messages.items() if name not in used}
    if others:
        lines += _entry("  other", _others(others), width)
    received = found.telemetry.get("received", 0)
    if received:
        lost = f"{found.telemetry.get('lost', 0)} lost"
        share = f"{found.telemetry.get('lost_percent', 0.0):.2f} %"
        text = ", ".join([f"{received} messages", f"{lost} ({share})", *losses(found.telemetry)])
        lines += _entry("  all", text, width)
    return lines


def _stream_row(parts: Sequence[StreamFacts]) -> str:
    """One message's; of the worst of several, as of ESCs that report one by one.

    Outputs that drive nothing repeat: what repeats least counts.
    """
    first = parts[0]
    rates = [part.rate for part in parts if part.rate is not None]
    rate = f"{min(rates):.1f} Hz" if rates else "-"
    gaps = max(part.gaps for part in parts)
    longest = f"{max(part.longest_gap for part in parts):.1f} s" if gaps else "-"
    message = first.message if len(parts) == 1 else f"{first.message} ({len(parts)} parts)"
    return (
        f"  {STREAM_WORDS.get(first.stream, first.stream):<{_NAME - 2}}{message:<22}{rate:>10}"
        f"{gaps:>6}{longest:>9}"
        f"{_percent(first.missing_percent):>9}"
        f"{_percent(min(part.repeats_percent for part in parts)):>9}"
    )


def _percent(value: float | None) -> str:
    return f"{value:.1f} %" if value else "-"


def _others(messages: Mapping[str, Mapping[str, float | None]]) -> str:
    by_count = sorted(messages.items(), key=lambda item: -(item[1]["count"] or 0.0))
    most, named = 6, []
    for name, entry in by_count[:most]:
        rate = entry["rate"]
        named.append(name if rate is None else f"{name}{_TIE}{_short(rate)}{_TIE}Hz")
    more = ["..."] if len(by_count) > most else []
    kinds = "1 kind" if len(by_count) == 1 else f"{len(by_count)} kinds"
    return f"{kinds}: {', '.join(named + more)}"


def _clock(found: Inspection, width: int) -> list[str]:
    if found.vehicle is None:
        return []
    drift = found.clock.drift_ppm
    if drift is None:
        against = "drift unknown"
    else:
        ppm = round(drift)
        way = "" if ppm == 0 else " fast" if ppm > 0 else " slow"
        other = "GPS time" if found.kind in ONBOARD else "the computer that received"
        against = f"{abs(ppm)} ppm{way} against {other}"
    text = (
        f"the autopilot's; {against}; {_times(found.clock.reboots, 'reboot')}, "
        f"{_times(found.clock.wraps, 'wrap')} of a 32-bit stamp"
    )
    return _entry("Clock", text, width)


def _times(count: int, what: str) -> str:
    return f"{count or 'no'} {what}{'s' if count > 1 else ''}"


def _rotors(found: Inspection, width: int) -> list[str]:
    if not found.rotor_sources:
        return []
    chosen = found.rotor_input.chosen
    shown = chosen or min(found.rotor_sources, key=lambda source: source.kind.motors)
    text = f"{shown.message}, {shown.kind.words} at {_short(shown.rate or 0.0)} Hz"
    if chosen is None:
        choice = "none is usable" if found.rotor_input.judged else "chosen in flight"
        text = f"{choice}; {text}"
    lines = _entry("Rotor input", text, width)
    if shown.rotors:
        unit = "output" if shown.kind.motors else "rpm"
        lines.append(f"{'  motor':<{_NAME}}{'lowest':>9}{'mean':>9}{'highest':>9}  {unit}")
        lines += _rotor_rows(shown)
    for source in found.rotor_sources:
        if source is not shown:
            dead = ", ".join(map(str, source.dead))
            silent = f", nothing of motor {dead}" if dead else ""
            lines += _entry(
                "  also", f"{source.message} {_short(source.rate or 0.0)} Hz{silent}", width
            )
    return lines


def _rotor_rows(source: RotorMessage) -> Iterable[str]:
    scale = 1.0 if source.kind.motors else 1.0 / RPM
    sent = [rotor.high for rotor in source.rotors if math.isfinite(rotor.high)]
    digits = 3 if scale == 1.0 and max(sent, default=0.0) < 10.0 else 0
    for motor, rotor in enumerate(source.rotors, 1):
        values = "".join(f"{scale * v:>9.{digits}f}" for v in (rotor.low, rotor.mean, rotor.high))
        dead = "  dead" if motor in source.dead else ""
        if not math.isfinite(rotor.high):
            values, dead = 3 * f"{'-':>9}", "  not sent"
        yield f"  {motor:<{_NAME - 2}}{values}{dead}"


def _motion(found: Inspection) -> list[str]:
    if not found.motion:
        return []
    lines = [f"{'Motion':<{_NAME}}{'rate rms':>12}{'acceleration rms':>22}"]
    for axis, motion in found.motion.items():
        little = "  too little" if motion.acceleration_rms < THRESHOLDS.acceleration[axis] else ""
        lines.append(
            f"  {axis:<{_NAME - 2}}{motion.rate_rms:>6.2f} rad/s"
            f"{motion.acceleration_rms:>14.2f} rad/s^2{little}"
        )
    return lines


def _parameters(found: Inspection, width: int) -> list[str]:
    if not found.parameter_count:
        return []
    lines = [f"Parameters    {len(found.parameters)} of {found.parameter_count} matter"]
    for group in GROUPS:
        own = {name: v for name, v in found.parameters.items() if group_of(name) == group}
        if own:
            lines += _entry(
                f"  {group}", ", ".join(f"{n}{_TIE}{v:.7g}" for n, v in own.items()), width
            )
    return lines


def obtainable(found: Inspection) -> str:
    """What can be had from the data."""
    hover = f"; {found.hover:.0f} s of hover" if found.hover else ""
    return _OBTAINABLE[found.obtainable] + hover


def objection_lines(objections: Sequence[Objection], width: int) -> list[str]:
    """What stands against more, and what to do about that."""
    lines = []
    for i, objection in enumerate(objections):
        mark = "-" if level_of(objection) == "note" else "!"
        lines += wrapped(objection.reason, f"  {mark} ", width)
        following = objections[i + 1 :]
        if objection.how and not any(o.how == objection.how for o in following):
            lines += wrapped(objection.how, "    -> ", width)
    return lines


def next_command(found: Inspection, options: argparse.Namespace) -> str:
    """The command that gives the most that a log has; empty where that is nothing."""
    if found.kind == "link" or found.obtainable == "nothing":
        return ""
    suggestion = suggested_airframe(found.kind, found.vehicle)
    return airframe_choice.command_for(
        found.source, found.layout, options, suggestion,
        command="health" if found.verdict == "no" else "analyze",
    )  # fmt: skip


def _short(rate: float) -> str:
    return f"{rate:.0f}" if rate >= 20.0 else f"{rate:.1f}"
