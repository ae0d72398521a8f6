"""The health panel: CG, what each rotor carries, margins, and what to do about it."""

import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.health_view import cg_facts, half_of, health_fact
from gcs_sysid.results.number_format import PLAIN
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.view import View
from gcs_sysid.screen.widgets.lines import Line, Lines

_NAME = 16
_BAR = 12
_WARNING = "bold $text-warning"
_NOT_YET = "No hover yet: hover for 10 s."
_SUMS = ("yaw_imbalance", "hover_throttle", "thrust_to_weight", "drift_per_minute")
_UNEQUAL = "± includes unequal rotors (3 %)"


def health_lines(health: Mapping[str, Any] | None, width: int) -> list[Line]:
    """A health file's content as lines.

    Args:
        health: None before the first look.
        width: columns.
    """
    if health is None or health["verdict"] == "refused":
        why = _NOT_YET if health is None else f"No health: {'; '.join(health['reasons'])}"
        return [[(line, fmt.MUTED)] for line in textwrap.wrap(why, width)]
    lines = [_source(health), *_weak(health, width), *_places(health), *_rotors(health, width)]
    for name, text in filter(None, (health_fact(health, key) for key in _SUMS)):
        lines.append([(f"{name:<{_NAME}}", fmt.MUTED), (text, "")])
    for text in health["advice"]:
        lines += _wrapped(f"→ {text}", width, "")
    return lines


def _wrapped(text: str, width: int, style: str) -> list[Line]:
    lines = textwrap.wrap(text, width, subsequent_indent="  ", break_on_hyphens=False)
    return [[(line, style)] for line in lines]


def _source(health: Mapping[str, Any]) -> Line:
    by = RotorInput(health["rotor_input"]).words
    return [(f"{health['seconds_of_hover']:.0f} s of hover, rotors by {by}; {_UNEQUAL}", fmt.MUTED)]


def _weak(health: Mapping[str, Any], width: int) -> Iterator[Line]:
    weakened = health["weakened"]
    if weakened is not None and weakened["rotor"] is not None and weakened["loss"]:
        loss = PLAIN.measure(
            100.0 * weakened["loss"]["value"], 100.0 * half_of(weakened["loss"]), "%"
        )
        text = f"! rotor {weakened['rotor'] + 1} gives {loss} less thrust than before"
        yield from _wrapped(text, width, _WARNING)


def _places(health: Mapping[str, Any]) -> Iterator[Line]:
    for name, size, way, alike in cg_facts(health):
        head = (f"{name:<{_NAME}}", fmt.MUTED)
        yield [head, (f"{size} {way}", "bold"), (f"  ({alike})", fmt.MUTED)]


def _rotors(health: Mapping[str, Any], width: int) -> Iterator[Line]:
    """A table; the bar is the rotor's load over the most that any has to do."""
    rotors = health["rotors"]
    shares = [rotor["thrust_share"]["value"] for rotor in rotors]
    wide = width >= 70
    head = f"{'rotor':<6}{'share':>8}{'':>{_BAR + 3}}{'motor gain':>11}{'margin':>9}"
    yield [(head + (f"{'at full':>10}{'vibration':>14}" if wide else ""), fmt.MUTED)]
    for number, (rotor, share) in enumerate(zip(rotors, shares, strict=True), 1):
        parts: Line = [
            (f"{number:<6}", fmt.MUTED),
            (f"{100.0 * share:6.1f} % ", "bold"),
            (fmt.bar(share / max(shares), _BAR), "$text-primary on $panel"),
            (_cell(rotor["motor_gain"], 1.0, "", 13, 3), ""),
            (_cell(rotor["headroom"], 100.0, " %", 9, 1), ""),
        ]
        if wide:
            full = rotor["saturated"]
            saturated = "-" if full is None else f"{100.0 * full:.1f} %"
            parts.append((f"{saturated:>10}", "" if not full else _WARNING))
            parts.append((_cell(rotor["vibration"], 1.0, " m/s²", 14, 3), ""))
        yield parts


def _cell(
    quantity: Mapping[str, Any] | None, factor: float, unit: str, width: int, digits: int
) -> str:
    known = quantity is not None and quantity["value"] is not None
    text = f"{factor * quantity['value']:.{digits}f}{unit}" if known and quantity else "-"
    return f"{text:>{width}}"


class HealthPanel(Lines):
    """The vehicle's health by the hover of the last minutes, or of a whole log that is played."""

    BORDER_TITLE = "Health in hover"

    def __init__(self) -> None:
        super().__init__(id="health")
        self._shown: tuple[Mapping[str, Any] | None, int] | None = None
        self._view: View | None = None

    def show(self, view: View) -> None:
        """Bring the panel up to date; a look is the same object until there is another."""
        self._view = view
        health = None if view.snapshot is None else view.snapshot.health
        width = self.content_size.width or 76
        if self._shown is None or self._shown[0] is not health or self._shown[1] != width:
            self._shown = health, width
            self.put(health_lines(health, width))

    def on_resize(self) -> None:
        """Wrap the lines again."""
        if self._view is not None:
            self.show(self._view)
