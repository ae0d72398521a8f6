"""The format of Betaflight's, INAV's and Indiflight's logs (.bbl, .bfl): headers and fields.

A file holds sessions one after the other. Each begins with lines of text that describe its frames:
`H Field I encoding:1,0,...`. A frame is a letter and then its fields, most of them of variable
length, each as the difference from what a predictor says:

- I: everything, from which the following P can be computed; P: the change since the last frame
- S: flight modes; G: GPS; H: where home is; E: events

The definition is what the firmware writes and what Betaflight's blackbox-log-viewer reads. This
module reads the headers, `blackbox_fields` turns bytes into fields, `blackbox_frames` finds the
frames and adds the predictions.
"""

import re
from dataclasses import dataclass, field

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.telemetry.log_formats import BLACKBOX_HEAD

MARKERS = b"IPGHSE"
"""First bytes of frames."""
MOST_SESSIONS = 1000
"""In a file; as the reference decoder."""
MOST_FIELDS = 512
"""Of a frame; the reference takes 128, Indiflight writes 171."""
_LONGEST_NAME, _LONGEST_LINE, _LONGEST_HEADER = 64, 2**14, 2**18
_MOST_LOOPS = 2**15
"""Of the firmware between I frames, which it counts in 16 bits."""

SIGNED_VB, UNSIGNED_VB, NEG_14BIT, TAG8_8SVB, TAG2_3S32, TAG8_4S16, NULL, TAG2_3SVARIABLE = (
    0, 1, 3, 6, 7, 8, 9, 10,
)  # fmt: skip
(
    ZERO, PREVIOUS, STRAIGHT_LINE, AVERAGE_2, MINTHROTTLE, MOTOR_0, INCREMENT, HOME_COORD,
    FIXED_1500, VBATREF, LAST_MAIN_FRAME_TIME, MINMOTOR,
) = range(12)  # fmt: skip
_ONE_EACH = (SIGNED_VB, UNSIGNED_VB, NEG_14BIT, NULL)
"""Encodings of a field for itself, which the reference cuts to 32 bits; the others are not cut."""
UNCUT = -(2**62)
GROUPS = {TAG8_8SVB: 8, TAG2_3S32: 3, TAG8_4S16: 4, TAG2_3SVARIABLE: 3}
"""Encoding -> most fields that are written together."""
_ALWAYS = {ZERO, MINTHROTTLE, MOTOR_0, FIXED_1500, VBATREF, MINMOTOR}
_PREDICTORS = {
    "I": _ALWAYS, "P": _ALWAYS | {PREVIOUS, STRAIGHT_LINE, AVERAGE_2, INCREMENT},
    "G": {*_ALWAYS, HOME_COORD, LAST_MAIN_FRAME_TIME} - {MOTOR_0},
    "H": _ALWAYS - {MOTOR_0}, "S": _ALWAYS - {MOTOR_0},
}  # fmt: skip
_LINE = re.compile(rb"H ([\x20-\x39\x3b-\x7e]{1,64}):([\x20-\x7e\x80-\xff]*)\r?")
_TEXT = bytes([0x0D, *range(0x20, 0x7F), *range(0x80, 0x100)])
"""What a line may consist of."""
_LINE_OR_FRAME = re.compile(rb"H |[IPGSE]")
_DIGITS = re.compile(r"[+-]?\d{1,9}")


@dataclass(frozen=True)
class Definition:
    """The fields of one type of frame, one entry each."""

    names: tuple[str, ...]
    signed: tuple[int, ...]
    predictors: tuple[int, ...]
    encodings: tuple[int, ...]

    def only(self, names: tuple[str, ...]) -> "Definition":
        """Some of the fields."""
        rows = [self.names.index(name) for name in names]
        lists = (self.signed, self.predictors, self.encodings)
        return Definition(names, *(tuple(numbers[i] for i in rows) for numbers in lists))

    def lowest(self) -> Array:
        """(fields,) lowest value of those that are cut to 32 bits; UNCUT for the others."""
        cut = np.isin(self.encodings, _ONE_EACH) & (np.array(self.predictors) != INCREMENT)
        return np.where(cut, np.where(np.array(self.signed) == 0, 0, -(2**31)), UNCUT)


@dataclass(frozen=True)
class Header:
    """Header of a session.

    Attributes:
        values: of the lines that define no fields, as written; the last of each name.
        frames: letter -> fields. P has those of I.
        data: position in the file of the first byte after it.
        interval: loops between I frames.
        logged: (k,) rising, loops after an I frame that are logged, 0 included.
    """

    values: dict[str, str]
    frames: dict[str, Definition]
    data: int
    interval: int = 32
    logged: Array = field(default_factory=lambda: np.arange(32))

    def numbers(self, name: str) -> list[float]:
        """The numbers of a line; [] when it is missing or says something else."""
        try:
            found = [float(word) for word in self.values[name].split(",")]
        except (KeyError, ValueError):
            return []
        return found if np.isfinite(found).all() else []

    def number(self, name: str, default: float) -> float:
        """The first number of a line."""
        return next(iter(self.numbers(name)), default)

    @property
    def version(self) -> float:
        """Of the data."""
        return self.number("Data version", 1.0)

    def constants(self) -> dict[int, int]:
        """Predictor -> what it predicts; the defaults are the reference decoder's."""
        low = self.number("minthrottle", 1150.0)
        return {
            MINTHROTTLE: _whole(low),
            FIXED_1500: 1500,
            VBATREF: _whole(self.number("vbatref", 4095.0)),
            MINMOTOR: _whole(self.number("motorOutput", low)),
        }


def session_starts(data: bytes) -> list[int]:
    """Positions at which sessions begin, and the end of the file."""
    starts: list[int] = []
    at = data.find(BLACKBOX_HEAD)
    while at >= 0 and len(starts) < MOST_SESSIONS:
        starts.append(at)
        at = data.find(BLACKBOX_HEAD, at + len(BLACKBOX_HEAD))
    return [*starts, len(data) if at < 0 else at]


def read_header(data: bytes, start: int, stop: int) -> Header:
    """The header of a session that lies between two positions.

    Raises:
        InputError: it does not describe frames that firmware writes.
    """
    values: dict[str, str] = {}
    fields: dict[str, dict[str, str]] = {}
    at, last = start, min(stop, start + _LONGEST_HEADER)
    end = wrong = start  # of the line, and what is in it before which none can begin
    while found := _LINE_OR_FRAME.search(data, at, last):
        at = found.start()
        if data[at] != ord("H"):
            break
        if at >= end:
            end = data.find(b"\n", at, last)
            end = last + _LONGEST_LINE if end < 0 else end
        fits = at >= wrong and end - at < _LONGEST_LINE
        match = _LINE.fullmatch(data, at, end) if fits else None
        if match:
            name, value = match[1].decode("ascii"), match[2].decode("utf-8", "replace")
            _, letter, what = (*name.split(" ", 2), "", "")[:3]
            if name.startswith("Field ") and len(letter) == 1:
                fields.setdefault(letter, {})[what] = value
            else:
                values[name] = value
        elif fits:
            wrong = at + len(data[at:end].rstrip(_TEXT))
        at = end + 1 if match else at + 1
    else:
        at = last
    if "I" not in fields or "P" not in fields:
        raise InputError("its header does not describe the frames: it is damaged, or cut short")
    fields["P"] = {**fields["I"], **fields["P"]}
    frames = {letter: _definition(letter, f) for letter, f in fields.items() if letter in "IPGHS"}
    if frames["P"].names != frames["I"].names:
        raise InputError("its header gives I frames and P frames, which share columns, other names")
    interval, logged = _intervals(values)
    return Header(values, frames, at, interval, logged)


def _definition(letter: str, fields: dict[str, str]) -> Definition:
    names = tuple(fields.get("name", "").split(",", MOST_FIELDS))
    columns = [
        [int(w) if _DIGITS.fullmatch(w) else -1 for w in fields.get(what, "").split(",", 2**12)]
        for what in ("signed", "predictor", "encoding")
    ]
    signed, predictors, encodings = columns
    if letter in "SH":  # the reference has none before that they could be predicted from
        predictors = [ZERO if p == PREVIOUS else p for p in predictors]
    signed = (signed + [0] * len(names))[: len(names)]
    wrong = f"its header describes the fields of {letter} frames wrongly: "
    if len(names) > MOST_FIELDS:
        raise InputError(f"{wrong}more than {MOST_FIELDS}")
    if len(set(names)) < len(names) or not all(0 < len(name) <= _LONGEST_NAME for name in names):
        raise InputError(f"{wrong}two of one name, or a name of no or many letters")
    if len(predictors) != len(names) or len(encodings) != len(names):
        raise InputError(f"{wrong}{len(names)} names, {len(predictors)} predictors")
    for name, predictor, encoding in zip(names, predictors, encodings, strict=True):
        if predictor not in _PREDICTORS[letter]:
            raise InputError(f"{wrong}{name} has predictor {predictor}")
        if encoding not in (*_ONE_EACH, *GROUPS):
            raise InputError(f"{wrong}{name} has encoding {encoding}")
    if letter in "IP" and not {"loopIteration", "time"} <= set(names):
        raise InputError(f"{wrong}no loopIteration or time")
    if MOTOR_0 in predictors and "motor[0]" not in names[: predictors.index(MOTOR_0)]:
        raise InputError(f"{wrong}{names[predictors.index(MOTOR_0)]} is predicted by no motor[0]")
    return Definition(names, tuple(signed), tuple(predictors), tuple(encodings))


def _intervals(values: dict[str, str]) -> tuple[int, Array]:
    """Loops between I frames, and which of them are logged."""
    whole = Header(values, {}, 0).number("I interval", 32.0)
    words = values.get("P interval", "1/1").strip().split("/")
    if len(words) == 1:
        words = ["1", *words]
    numbers = [int(word) if _DIGITS.fullmatch(word) else 0 for word in words]
    if not 1 <= whole <= _MOST_LOOPS or len(numbers) != 2:
        raise InputError("its header gives no I interval and P interval that can be")
    interval, share, parts = int(whole), numbers[0], max(numbers[1], 1)
    loops = np.arange(interval)
    logged = loops[(loops + share - 1) % parts < share]
    if not len(logged):
        raise InputError("its header gives a P interval at which nothing is logged")
    return interval, logged


def _whole(value: float) -> int:
    return int(min(max(value, -(2.0**31)), 2.0**32 - 1.0))
