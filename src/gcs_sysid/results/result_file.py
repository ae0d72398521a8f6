"""Results read back from the files that `--json` writes."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NoReturn, cast, get_args

from gcs_sysid.errors import InputError, one_line
from gcs_sysid.files import read_text, real_number
from gcs_sysid.model.airframe import ANCHORS, OWN_UNITS
from gcs_sysid.model.estimate import Estimate, Objection, Status, Verdict
from gcs_sysid.model.parameters import PARAMETERS, TIMING
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_data import SCHEMA, Scale
from gcs_sysid.strict_json import parse_json

MOST_BYTES = 256 * 1024 * 1024
"""A file beyond this is no result."""
_MADE_BY = "gcs-sysid analyze {} --json result.json makes one of a log"


def read_result(path: str | Path) -> Result:
    """Read one result.

    Args:
        path: of a file by `analyze --json`, or by `live --json`, whose last line counts.

    Raises:
        InputError: the file cannot be read, holds several results, or is none.

    Example:
        >>> import tempfile
        >>> import gcs_sysid
        >>> result = gcs_sysid.analyze("logs/sample.tlog", "paper")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder, "flight.json")
        ...     result.write(file)
        ...     again = gcs_sysid.read_result(file)
        >>> again.parameters["Ixx"] == result.parameters["Ixx"]
        True
    """
    where = str(path)
    try:
        text = read_text(Path(path), "the result", MOST_BYTES)
    except InputError as error:
        if isinstance(error.__cause__, UnicodeDecodeError):
            raise InputError(
                f"{where} is no text, and no result: {_MADE_BY.format(where)}"
            ) from None
        raise
    return parse_result(parse_json(text, where), where)


def parse_result(document: object, where: str) -> Result:
    """Make a result of parsed JSON.

    Args:
        document: as `Result.as_json` gives it.
        where: name of the file, for messages.

    Raises:
        InputError: it is no result of this program.
    """
    if isinstance(document, list) and len(document) == 1:
        document = document[0]
    if isinstance(document, list):
        raise InputError(
            f"{where}: holds {len(document)} results; analyze the logs one by one, "
            "each with its own --json"
        )
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        found = document.get("schema") if isinstance(document, dict) else None
        if isinstance(found, str) and found.startswith("gcs-sysid-health/"):
            raise InputError(f"{where}: a flight's health, and no result: {_MADE_BY.format('LOG')}")
        raise InputError(f"{where}: not a result of gcs-sysid (no schema {SCHEMA!r} in it)")
    table = _Table(document, where)
    rotor_input = table.text("rotor_input")
    if rotor_input not in tuple(RotorInput):
        table.fail("rotor_input")
    return Result(
        verdict=cast(Verdict, table.one_of("verdict", get_args(Verdict))),
        reasons=tuple(one_line(str(reason)) for reason in table.list("reasons")),
        objections=_objections(table, "verdict"),
        source=table.text("source"),
        vehicle=table.table("vehicle").entries,
        scale=_scale(table),
        rotor_input=RotorInput(rotor_input),
        parameters=_estimates(table.table("parameters"), PARAMETERS),
        estimator="offline" if document.get("estimator") == "offline" else "online",
        method=one_line(str(document.get("method", ""))),
        timing=_estimates(table.table("timing"), TIMING),
        events=tuple(event for event in table.list("events") if isinstance(event, dict)),
        segments=tuple(part for part in table.list("segments") if isinstance(part, dict)),
        validation=table.table("validation").entries,
        priors=table.table("priors").entries,
        assumptions=tuple(each for each in table.list("assumptions") if isinstance(each, dict)),
        telemetry=table.table("telemetry").entries,
        airframe=table.table("airframe").entries,
        disturbance=table.table("disturbance").entries,
        rotors=tuple(
            _estimates(_Table(rotor, where), PARAMETERS)
            for rotor in table.list("rotors")
            if isinstance(rotor, dict)
        ),
        covariance=table.table("covariance").entries,
        health=table.table("health").entries or None,
    )


def segment_estimates(segment: Mapping[str, Any]) -> dict[str, Estimate]:
    """The parameters that held in one of a result's segments."""
    return _estimates(_Table(segment["parameters"], "a segment"), PARAMETERS)


class _Table:
    """A JSON object whose entries are checked as they are taken."""

    def __init__(self, entries: dict[str, Any], where: str) -> None:
        self.entries, self.where = entries, where

    def fail(self, key: str) -> NoReturn:
        raise InputError(f"{self.where}: not a complete result: {key} is missing or invalid")

    def text(self, key: str) -> str:
        value = self.entries.get(key, "")
        return one_line(value) if isinstance(value, str) else self.fail(key)

    def one_of(self, key: str, words: tuple[str, ...]) -> str:
        value = self.text(key)
        return value if value in words else self.fail(key)

    def list(self, key: str) -> list[Any]:
        value = self.entries.get(key, [])
        return value if isinstance(value, list) else self.fail(key)

    def table(self, key: str) -> "_Table":
        value = self.entries.get(key, {})
        return _Table(value, self.where) if isinstance(value, dict) else self.fail(key)

    def number(self, key: str) -> float | None:
        value = self.entries.get(key)
        if value is None:
            return None
        try:
            return real_number(value, key)
        except InputError:
            self.fail(key)


def _estimates(table: _Table, known: Mapping[str, Any]) -> dict[str, Estimate]:
    """Those that this version knows, in its order."""
    out = {}
    for name, parameter in known.items():
        if name not in table.entries:
            continue
        entry = table.table(name)
        units = [parameter.unit_per(own) for own in OWN_UNITS]
        std = entry.number("std")
        if std is not None and std < 0.0:
            entry.fail(f"std of {name}")
        out[name] = Estimate(
            entry.number("value"),
            std,
            next((unit for unit in units if unit == entry.text("unit")), parameter.unit),
            cast(Status, entry.one_of("status", get_args(Status))),
            entry.number("bound"),
            entry.text("rests_on") or None,
            min(entry.number("std_given") or 0.0, std or 0.0),
            parameter.sign == "not negative",
            _objections(entry, "cap"),
        )
    return out


def _objections(table: _Table, limits: Literal["cap", "verdict"]) -> tuple[Objection, ...]:
    """What stands behind reasons or a status; results of earlier versions have none.

    `limits` is what their cap is of: a status or the verdict.
    """
    known = get_args(Status if limits == "cap" else Verdict)
    out = []
    for entries in table.list("objections"):
        entry = _Table(entries if isinstance(entries, dict) else {}, table.where)
        found = Objection(entry.text("reason"), how=entry.text("how"), by=entry.text("by"))
        if entry.entries.get("cap") is not None:
            found = replace(found, **{limits: entry.one_of("cap", known)})  # type: ignore[arg-type]
        out.append(found)
    return tuple(out)


def _scale(table: _Table) -> Scale | None:
    if table.entries.get("scale") is None:
        return None
    scale = table.table("scale")
    value = scale.number("value")
    anchor = scale.one_of("anchor", (*ANCHORS, "added_mass"))
    if value is None or value <= 0.0:
        scale.fail("value of the scale")
    return Scale(
        anchor,  # type: ignore[arg-type]
        value,
        scale.text("unit"),
        scale.number("std") or 0.0,
        scale.text("from"),
        scale.number("std_given") or 0.0,
    )
