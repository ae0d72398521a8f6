"""One vocabulary, and numbers and units as people read them: in terminal, screen, report, pages.

Parameters have the names of the JSON everywhere; what they are and what makes them observable is in
`model.parameters`. Statuses and verdicts are the words of the JSON, each with one sign.

A value is rounded to two digits of its 95 % interval; a share is written in per cent with two
digits. Terminals and screen write plain signs (`PLAIN`), pages true minus signs and spaces at
which no line breaks (`PAGE`).

    >>> rounded(0.0165529, 8.1e-5)
    '0.016553'
    >>> PLAIN.percent(0.00487), PLAIN.percent(0.031), PLAIN.percent(12.0)
    ('0.49 %', '3.1 %', '>999 %')
    >>> PAGE.measure(11.8, 0.4, "ms")
    '11.80 ± 0.40 ms'
    >>> scaled_unit("kg m^2", -3)
    '10⁻³ kg m²'
"""

import math
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from gcs_sysid.judgement.status import RULES
from gcs_sysid.model.estimate import Status, Verdict
from gcs_sysid.model.parameters import PARAMETERS, REGISTRY

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_PREFIX = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M"}
TEXT_WIDTH = 79
"""Columns of texts that are printed the same everywhere."""


def wrapped(text: str, begin: str = "", width: int = TEXT_WIDTH) -> list[str]:
    """A text in lines behind its beginning, whose width the later lines are indented by."""
    return textwrap.wrap(
        text,
        width,
        initial_indent=begin,
        subsequent_indent=" " * len(begin),
        break_long_words=False,
        break_on_hyphens=False,
    )


def decimals_for(half: float, size: float = 0.0, most: int | None = None) -> int:
    """Decimals that show two digits of an interval (0.081, 1.2, 35), within reason.

    Args:
        half: of the interval; 0 or not finite: none.
        size: of the value, which gets no more than seven digits.
        most: decimals that there is room for.
    """
    if not (half > 0.0 and math.isfinite(half)):
        if most is not None:
            return most
        return max(5 - math.floor(math.log10(size)), 0) if size > 0.0 else 0
    wanted = 1 - math.floor(math.log10(half))
    if size > 0.0:
        wanted = min(wanted, 6 - math.floor(math.log10(size)))
    return max(wanted if most is None else min(wanted, most), 0)


def significant(value: float, digits: int) -> str:
    """A number with so many digits, as a program would write it: `2.05e-04`, `0.0165`, `1.500`."""
    return f"{value:#.{digits}g}".replace(".e", "e").rstrip(".")


def rounded(value: float | None, half: float | None, digits: int = 6) -> str:
    """A value for a terminal: two digits of its interval, `digits` of its own at most.

    Args:
        value: in SI; None: unknown.
        half: of its 95 % interval; 0 or None: exact.
        digits: most.
    """
    if value is None or not math.isfinite(value):
        return "-"
    if not half or not math.isfinite(half):
        return f"{value:.{digits}g}"
    size = math.floor(math.log10(abs(value))) if value else -999
    known = size - math.floor(math.log10(half)) + 2
    return significant(value, min(known, digits)) if known > 0 else f"{value:.0e}" if value else "0"


def engineering_exponent(magnitude: float, previous: int | None = None) -> int:
    """The power of ten, a multiple of three, that brings a magnitude between 1 and 1000.

    A previous power is held while the scaled magnitude lies between 0.5 and 1000.
    """
    if not math.isfinite(magnitude) or magnitude <= 0.0:
        return previous if previous is not None else 0
    if previous is not None and 0.5 <= magnitude / 10.0**previous < 1000.0:
        return previous
    return 3 * math.floor(math.log10(magnitude) / 3.0)


def power_of_ten(size: float) -> int:
    """The multiple of three by which a single number is shown; 0 where it reads well as it is."""
    return 0 if 0.1 <= size < 1e4 else engineering_exponent(size)


def round_numbers(low: float, high: float, wanted: float) -> tuple[list[float], int]:
    """About so many round numbers within a range, at least two, and the decimals that show them."""
    rough = (high - low) / max(1.0, wanted)
    power = 10.0 ** math.floor(math.log10(rough))
    steps = [m * power for m in (0.5, 1.0, 2.0, 5.0, 10.0)]
    widest = next(i for i, step in enumerate(steps) if step >= 0.999 * rough)
    for step in reversed(steps[: widest + 1]):
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        numbers = [n * step for n in range(first, last + 1)]
        if len(numbers) > 1:
            break
    return numbers, max(0, -math.floor(math.log10(step) + 1e-9))


def pretty_unit(unit: str) -> str:
    """A unit with real exponents: `kg m^2` becomes `kg m²`; the unit 1 is left blank."""
    if unit == "1":
        return ""
    head, *raised = unit.split("^")
    return head + "".join(part[:1].translate(_SUPERSCRIPT) + part[1:] for part in raised)


def scaled_unit(unit: str, exponent: int) -> str:
    """A unit with its power of ten: `mm`, `10⁻³ kg m²`."""
    if exponent == 0:
        return pretty_unit(unit)
    # A prefix reads fastest, but only where it can mean one thing: before m, s or N alone.
    if unit in ("m", "s", "N") and exponent in _PREFIX:
        return _PREFIX[exponent] + unit
    return f"10{str(exponent).translate(_SUPERSCRIPT)} {pretty_unit(unit)}".rstrip()


@dataclass(frozen=True)
class Notation:
    """Numbers with the signs of a terminal or of a page.

    Attributes:
        minus: sign.
        space: within a measure.
        nothing: where there is no number.
        arrow: from before to after.
        raised: whether powers are raised; terminals write `2.05e-04` and `kg m^2`.
    """

    minus: str = "-"
    space: str = " "
    nothing: str = "-"
    arrow: str = "->"
    raised: bool = False

    def fixed(self, value: float, decimals: int) -> str:
        """A number with so many decimals; never a negative zero."""
        text = f"{value:.{decimals}f}"
        if text.startswith("-") and not text.strip("-0."):
            text = text[1:]
        return text.replace("-", self.minus)

    def number(self, value: float | None, digits: int = 3) -> str:
        """A number with so many significant digits."""
        if value is None or not math.isfinite(value):
            return self.nothing
        if not self.raised:
            return significant(value, digits)
        exponent = power_of_ten(abs(value))
        scaled = value / 10.0**exponent
        if scaled == 0.0:
            return "0"
        size = math.floor(math.log10(abs(scaled)))
        return self.fixed(scaled, max(digits - 1 - size, 0)) + times_power(exponent)

    def percent(self, share: float | None, most: int = 9, target: float | None = None) -> str:
        """A share in per cent with two digits: `12 %`, `3.0 %`, `0.49 %`.

        Args:
            share: of one; None: unknown.
            most: decimals.
            target: a share above it is rounded up where it would read as one within it.
        """
        if share is None or math.isnan(share):
            return self.nothing
        if abs(share) >= 9.995:
            return f"{'>' if share > 0.0 else '<' + self.minus}999{self.space}%"
        size = int(f"{100.0 * share:.1e}".partition("e")[2])  # after rounding
        decimals = min(max(1 - size, 0), most)
        shown = 100.0 * share
        if target is not None and share > target and round(shown, decimals) <= 100.0 * target:
            shown = (math.floor(shown * 10.0**decimals) + 1.0) / 10.0**decimals
        return f"{self.fixed(shown, decimals)}{self.space}%"

    def unit(self, unit: str, exponent: int = 0) -> str:
        """A unit with its power of ten; nothing for pure numbers."""
        if not self.raised and exponent == 0:
            return unit.strip("1")
        return scaled_unit(unit, exponent).replace(" ", self.space)

    def measure(self, value: float, half: float | None, unit: str) -> str:
        """A value in a unit that suits its size, with the half of its interval if it has one."""
        if not half:
            return f"{self.number(value)} {unit}"
        decimals = decimals_for(max(half, 1e-3 * abs(value), 1e-3))
        return f"{self.fixed(value, decimals)} ± {self.fixed(half, decimals)} {unit}"

    def value_and_half(
        self, value: float, half: float, exponent: int | None = None
    ) -> tuple[str, str, str, int]:
        """A value and the half of its interval on one scale.

        `exponent` is the scale's power of ten; None: by the size.

        Returns:
            The value, the half, the power of ten as text, and that power.
        """
        if exponent is None:
            exponent = power_of_ten(max(abs(value), half))
        scale = 10.0**exponent
        decimals = decimals_for(half / scale, abs(value) / scale)
        return (
            self.fixed(value / scale, decimals),
            self.fixed(half / scale, decimals),
            times_power(exponent),
            exponent,
        )


PLAIN = Notation()
PAGE = Notation("\N{MINUS SIGN}", "\N{NO-BREAK SPACE}", "\N{EN DASH}", "→", raised=True)


def times_power(exponent: int) -> str:
    """Such as " × 10⁻³"; nothing for one."""
    return f" × 10{str(exponent).translate(_SUPERSCRIPT)}" if exponent else ""


def percent_column(share: float | None, *, signed: bool = False) -> str:
    """A share for a column, two decimals at most: `0.49 %`, `+12 %`; blank where unknown."""
    if share is None or math.isnan(share):
        return ""
    text = PLAIN.percent(share, 2)
    return f"+{text}" if signed and text[0].isdigit() else text


def clock(seconds: float) -> str:
    """Flight time as `mm:ss` (minutes run past 59)."""
    minutes, rest = divmod(max(0, math.floor(seconds)), 60)
    return f"{minutes:02d}:{rest:02d}"


def clock_tenths(seconds: float) -> str:
    """Event time as `mm:ss.s`."""
    tenths = max(0, round(10.0 * seconds))
    minutes, rest = divmod(tenths, 600)
    return f"{minutes:02d}:{rest // 10:02d}.{rest % 10}"


def duration(seconds: float) -> str:
    """A short span in words: `4 s`, `2 min 5 s`."""
    whole = max(0, math.floor(seconds))
    return f"{whole} s" if whole < 60 else f"{whole // 60} min {whole % 60} s"


def grouped(count: int) -> str:
    """A count with its thousands apart: `12 345`."""
    return f"{count:,}".replace(",", " ")


def data_rate(bytes_per_second: float) -> str:
    """A data rate: `870 B/s`, `23.4 kB/s`."""
    if bytes_per_second < 1000.0:
        return f"{bytes_per_second:.0f} B/s"
    return f"{bytes_per_second / 1000.0:.1f} kB/s"


Change = Literal["changed", "no_change_seen", "cannot_tell"]
"""What two results say of a parameter, or of the vehicle."""


@dataclass(frozen=True)
class Word:
    """A state as people meet it: its sign, since color is never the only one, and its meaning."""

    sign: str
    meaning: str
    advice: str = ""
    """What improves it, while there is more to fly."""

    @property
    def with_advice(self) -> str:
        """The meaning, and what improves it."""
        return f"{self.meaning}: {self.advice}" if self.advice else self.meaning


STATUS: dict[Status | None, Word] = {
    "identified": Word(
        "✓", f"sigma below {100.0 * RULES.identified_below:g} % of the reference value"
    ),
    "given": Word("•", "entered by you, sets the scale"),
    "zero": Word("≈", "consistent with zero, and smaller than the limit shown"),
    "weak": Word(
        "~", f"sigma below {100.0 * RULES.unobservable_above:g} %", "fly more of its motion"
    ),
    "unobservable": Word("✗", "not observable from this flight"),
}
WRONG_AIRFRAME = "wrong airframe"
"""Begins each reason that the vehicle's own parameters contradict the airframe."""
NO_MAVLINK = "bytes arrive that are no MAVLink: check the baud rate"
"""Of a link on which nothing else does."""
WAITING = Word("○", "waiting")
"""Of every parameter before there are data."""
VERDICT: dict[Verdict, Word] = {
    "identified": Word("✓", "Identified"),
    "partial": Word("~", "Partly identified"),
    "refused": Word("✗", "Not identified"),
}
CHANGE: dict[Change, Word] = {
    "changed": Word("≠", "changed"),
    "no_change_seen": Word("=", "no change seen"),
    "cannot_tell": Word("?", "undetermined"),
}


STREAM_WORDS = {
    "imu": "IMU",
    "attitude": "attitude",
    "rotor_speed": "rotor speed",
    "rotor_command": "commands",
    "velocity": "velocity",
}
"""Streams that are shown, by `signals.records.Stream`."""
_LOSSES = {
    "unknown": "of unknown kinds",
    "bad_crc": "with a wrong checksum",
    "garbage_bytes": "bytes of garbage",
    "late": "too late",
    "repeated": "repeated",
}


def losses(telemetry: Mapping[str, Any]) -> list[str]:
    """What of a result's `telemetry` came to nothing, by its kind."""
    return [f"{telemetry[key]} {what}" for key, what in _LOSSES.items() if telemetry.get(key)]


def label(name: str) -> str:
    """A parameter's name in at most thirteen letters: the result's own name where it fits."""
    return REGISTRY[name].label or name if name in REGISTRY else name


_DISTURBANCES = {
    "contact": "contact with the ground",
    "thrust": "thrust far from the usual",
    "climb": "a climb or descent",
    "airspeed": "forward flight",
    "force": "a force, as of a gust",
    "moment": "a moment, as of a gust",
}
"""Words of a disturbance's `cause`."""


def disturbance_text(event: Mapping[str, Any]) -> str:
    """What moved the vehicle without changing it."""
    cause = _DISTURBANCES.get(str(event.get("cause")), "a disturbance")
    if event.get("undecided"):
        return (
            f"{cause} or a change, undecided at the end: the result covers only the flight up to it"
        )
    return f"{cause}; the vehicle is unchanged"


def event_text(event: Mapping[str, Any], notation: Notation = PLAIN) -> str:
    """What happened, in one line: of a change all parameters that surely changed with it."""
    if event.get("text"):
        return str(event["text"])
    if event["kind"] == "disturbance":
        return disturbance_text(event)
    text = str(event["kind"]).replace("_", " ")
    if "loss" in event:
        low, high = (100.0 * v for v in event["loss"]["ci95"])
        return f"{text}: rotor {event['rotor'] + 1} lost {low:.0f} to {high:.0f} % of its thrust"
    differences = []
    for name, change in event.get("parameters", {}).items():
        before, after, ci95 = (change.get(key) for key in ("before", "after", "ci95"))
        if before is None or after is None or ci95 is None or ci95[0] <= 0.0 <= ci95[1]:
            continue
        unit = notation.unit(PARAMETERS[name].unit) if name in PARAMETERS else ""
        first, second = (notation.number(value, 4) for value in (before, after))
        differences.append(f"{name} {first} {notation.arrow} {second} {unit}".rstrip())
    return f"{text}: {', '.join(differences)}" if differences else text
