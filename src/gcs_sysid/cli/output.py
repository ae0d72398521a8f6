"""What commands print: tables, JSON, truth files, progress."""

import json
import math
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TextIO

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
    if truth:
        head += f"{'truth':>13}{'error %':>9}"
    lines = [f"{result.verdict}: {result.source}", "", head]
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
        if truth:
            line += _truth_cells(estimate.value, truth.get(name))
        lines.append(line.rstrip())
    if result.reasons:
        lines += ["", *(f"- {reason}" for reason in result.reasons)]
    return "\n".join(lines)


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
