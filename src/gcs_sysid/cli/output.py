"""What commands print: tables, JSON, truth files, progress."""

import json
import math
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TextIO

from gcs_sysid.errors import InputError
from gcs_sysid.model.parameters import PARAMETERS
from gcs_sysid.session.result import Result

_MAX_TRUTH_BYTES = 1_000_000


def read_truth(path: str) -> dict[str, float]:
    """True parameters of an emulated vehicle, for display beside the estimates only.

    Raises:
        InputError: the file cannot be read or is no such JSON.
    """
    try:
        file = Path(path)
        if file.stat().st_size > _MAX_TRUTH_BYTES:
            raise InputError(f"{path}: too large for a truth file")
        table = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot read the truth file: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON: {error}") from error
    if not isinstance(table, dict):
        raise InputError(f"{path}: must be a JSON object of parameter names and numbers")
    return {
        name: float(value)
        for name, value in table.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }


def result_table(result: Result, truth: Mapping[str, float] | None = None) -> str:
    """The result as lines of text, with truth and error where truth is known."""
    head = f"{'parameter':<20}{'value':>13}{'± 95 %':>12}{'%':>8}  {'unit':<9}{'status':<13}"
    bounded = any(estimate.bound is not None for estimate in result.parameters.values())
    if bounded:
        head += f"{'bound 95 %':>11}"
    if truth:
        head += f"{'truth':>13}{'error %':>9}"
    lines = [f"{result.verdict}: {result.source}", *_scale_lines(result), "", head]
    for name, estimate in result.parameters.items():
        unit = PARAMETERS[name].unit
        if estimate.value is None or estimate.std is None:
            cells = f"{'-':>13}{'-':>12}{'-':>8}"
        else:
            half = 1.959963984540054 * estimate.std
            share = 100.0 * half / abs(estimate.value) if estimate.value else math.inf
            percent = f"{share:.2f}" if share < 1000.0 else ">999"
            if estimate.status == "given":
                cells = f"{estimate.value:>13.6g}{'':>12}{'':>8}"
            else:
                cells = f"{estimate.value:>13.6g}{half:>12.2g}{percent:>8}"
        line = f"{name:<20}{cells}  {unit:<9}{estimate.status:<13}"
        if bounded:
            bound = estimate.bound
            line += f"{'-':>11}" if not bound else f"{1.959963984540054 * bound:>11.2g}"
        if truth:
            line += _truth_cells(estimate.value, truth.get(name))
        lines.append(line.rstrip())
    leaning: dict[str, list[str]] = {}
    for name, estimate in result.parameters.items():
        if estimate.rests_on:
            leaning.setdefault(estimate.rests_on, []).append(name)
    notes = [f"{', '.join(names)}: mostly from {what}" for what, names in leaning.items()]
    notes += [_event_line(event) for event in result.events if "detected" in event]
    spikes = result.telemetry.get("imu_outliers", {}).get("spikes", 0)
    if spikes:
        notes.append(f"{spikes} gyro samples were spikes, replaced by what their neighbours say")
    notes += result.reasons
    if notes:
        lines += ["", *(f"- {note}" for note in notes)]
    return "\n".join(lines)


def _scale_lines(result: Result) -> list[str]:
    """What sets the scale, where it is not simply the mass or k_T given."""
    scale = result.scale
    if scale is None or not (scale.origin or scale.anchor == "added_mass"):
        return []
    source = f" from {scale.origin}" if scale.origin else ""
    return [f"scale: {scale.anchor} = {scale.value:.6g} {scale.unit}{source}"]


def _event_line(event: Mapping[str, Any]) -> str:
    """A change in flight in one line."""
    line = f"{event['t']:.2f} s: {event['kind'].replace('_', ' ')}"
    if "loss" in event:
        low, high = (100.0 * v for v in event["loss"]["ci95"])
        return f"{line}, rotor {event['rotor'] + 1} lost {low:.0f} to {high:.0f} % of its thrust"
    mass = event.get("parameters", {}).get("mass")
    if mass:
        return f"{line}, mass {mass['before']:.4g} -> {mass['after']:.4g} kg"
    return line


def _truth_cells(value: float | None, true: float | None) -> str:
    if true is None:
        return f"{'-':>13}{'-':>9}"
    if value is None or true == 0.0:
        return f"{true:>13.6g}{'-':>9}"
    return f"{true:>13.6g}{100.0 * (value / true - 1.0):>9.2f}"


def open_output(path: str) -> TextIO:
    """A text file for writing, or standard output for `-`.

    Raises:
        InputError: the file cannot be written.
    """
    if path == "-":
        return sys.stdout
    try:
        return open(path, "w", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot write: {error.strerror}") from error


def progress_bar(what: str) -> Callable[[float], None] | None:
    """A progress line on standard error, if that is a terminal."""
    if not sys.stderr.isatty():
        return None

    def show(share: float) -> None:
        end = "\r\033[K" if share >= 1.0 else ""
        print(f"\r{what}: {100.0 * min(share, 1.0):3.0f} %{end}", end="", file=sys.stderr)

    return show
