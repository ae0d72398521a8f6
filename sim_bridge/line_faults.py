"""What a bad link does to the frames that pass it, each to be switched on by its name."""

import argparse
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from gcs_sysid.argument_types import between, not_negative, number
from sim_bridge.choices import (
    Kind,
    Span,
    choice_help,
    gather,
    milliseconds,
    named_spans,
    parse_choice,
    share,
    span,
)


@dataclass(frozen=True)
class LineFaults:
    """Faults in force; none by default. `KINDS` says what each does; times here are in s."""

    loss: float = 0.0
    bursts: tuple[float, float] = (0.0, 10.0)
    silence: Span | None = None
    stall: tuple[tuple[int, Span], ...] = ()
    corrupt: float = 0.0
    bandwidth: float = 0.0
    delay: float = 0.0
    jitter: float = 0.0
    scatter: float = 0.0
    reorder: float = 0.0
    duplicate: float = 0.0
    garbage: float = 0.0
    forged: float = 0.0
    flood: float = 0.0

    @property
    def any(self) -> bool:
        """Whether there is any."""
        return self != NO_FAULTS

    @property
    def intruders(self) -> bool:
        """Whether another sender uses the same port."""
        return bool(self.garbage or self.forged or self.flood)


NO_FAULTS = LineFaults()

MOST_RATE = 200_000.0
"""Datagrams a second at most from a hostile sender."""


def _rate(text: str) -> float:
    value = not_negative(text)
    if value > MOST_RATE:
        raise argparse.ArgumentTypeError(f"must be 0 to {MOST_RATE:.0f} a second, got {text!r}")
    return value


def _bursts(text: str) -> tuple[float, float]:
    lost, colon, length = text.partition(":")
    value, mean = share(lost), number(length) if colon else 10.0
    if value > 0.9 or mean < 1.0:
        raise argparse.ArgumentTypeError(f"a share to 0.9, runs from 1 frame, got {text!r}")
    return value, mean


KINDS: dict[str, Kind] = {
    "loss": Kind("share of frames lost, independently", share, "SHARE", "0.2"),
    "bursts": Kind(
        "share of frames lost in bursts of this mean length (Gilbert's channel)",
        _bursts,
        "SHARE[:FRAMES]",
        "0.1:10",
    ),
    "silence": Kind("outage", span, "FROM:S[:EVERY]"),
    "stall": Kind(
        "outage of this message; may be repeated",
        named_spans,
        "MESSAGE:FROM:S[:EVERY]",
    ),
    "corrupt": Kind("share of frames with wrong bytes, or cut short", share, "SHARE", "0.02"),
    "bandwidth": Kind(
        "bytes/s that pass; half a second is buffered, the rest is lost",
        between(1.0, 1e9, "bytes/s"),
        "BYTES/S",
    ),
    "delay": Kind("constant delay", milliseconds, "MS", "50"),
    "jitter": Kind("jitter up to this, in order", milliseconds, "MS", "20"),
    "scatter": Kind("jitter up to this, frames reordered", milliseconds, "MS", "20"),
    "reorder": Kind(
        "share of frames delayed by up to 20 ms behind later ones", share, "SHARE", "0.05"
    ),
    "duplicate": Kind("share of frames duplicated, up to 20 ms apart", share, "SHARE", "0.05"),
    "garbage": Kind("random bytes of an attacker, datagrams a second", _rate, "HZ", "100"),
    "forged": Kind(
        "heartbeats of an attacker a second, half with the vehicle's address",
        _rate,
        "HZ",
        "5",
    ),
    "flood": Kind("valid frames of an attacker as other systems, a second", _rate, "HZ", "5000"),
}
"""Every fault by its name on the command line."""


def parse_fault(text: str) -> tuple[str, Any]:
    """The field of `LineFaults` and its value, for NAME or NAME=VALUE.

    Raises:
        argparse.ArgumentTypeError: no such fault, or its value makes no sense.
    """
    return parse_choice(text, KINDS, "fault")


def make_faults(parsed: Iterable[tuple[str, Any]]) -> LineFaults:
    """All of them together; stalls add up."""
    return gather(NO_FAULTS, parsed, frozenset({"stall"}))


def fault_help() -> str:
    """One line a fault, for --help."""
    return choice_help(KINDS)
