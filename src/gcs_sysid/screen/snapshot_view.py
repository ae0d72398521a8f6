"""What a person is shown of a running session, for screen, page and loudspeaker; no Textual.

The verdict in a word, what is known and missing, orders of the coach, notices of the link.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from gcs_sysid.coach import choice as targets
from gcs_sysid.judgement.status import NOTHING
from gcs_sysid.model.estimate import KNOWN, Estimate, Status, Verdict
from gcs_sysid.model.parameters import CORE_OF
from gcs_sysid.results import words
from gcs_sysid.results.comparison import Comparison
from gcs_sysid.results.result import Result
from gcs_sysid.results.snapshot import (
    Advice,
    Gain,
    LinkState,
    LinkStatus,
    Playback,
    Snapshot,
    speed_text,
)
from gcs_sysid.results.summary import before_data, contradicted
from gcs_sysid.results.words import NO_MAVLINK, PLAIN, clock, duration

Known = tuple[str, float | None]
"""Label of a parameter, and its share of `shares`."""


def shares(result: Result) -> dict[str, float | None]:
    """Half of each 95 % interval over what it is measured against, see `coach.choice`."""
    estimates = result.parameters
    # Flying on makes no interval narrower by what was given.
    values = {name: Estimate(e.value, e.std_data, status=e.status) for name, e in estimates.items()}
    complete = dict.fromkeys(CORE_OF[result.rotor_input], NOTHING) | values
    places = [(rotor["x"], rotor["y"]) for rotor in result.airframe.get("rotors", ())]
    arm = sum(math.hypot(x, y) for x, y in places) / max(len(places), 1)
    found = targets.shares(complete, arm, result.rotor_input)
    return {name: share for name, share in found.items() if name in estimates}


@dataclass(frozen=True)
class Standing:
    """The parameters of a complete identification, the widest first.

    Attributes:
        known: those identified.
        weak: those seen, with a wide interval.
        missing: those of which this flight says nothing.
        reached: how many are within the target.
    """

    known: tuple[Known, ...]
    weak: tuple[Known, ...]
    missing: tuple[Known, ...]
    reached: int

    @property
    def total(self) -> int:
        """All that are to be identified."""
        return len(self.known) + len(self.weak) + len(self.missing)


def standing_of(snapshot: Snapshot) -> Standing:
    """Sort a snapshot's parameters."""
    groups: dict[Status | None, list[Known]] = {"identified": [], "weak": [], "unobservable": []}
    reached = 0
    for name, share in shares(snapshot.result).items():
        status = snapshot.result.parameters[name].status
        known = status in KNOWN
        groups["identified" if known else status].append((words.label(name), share))
        reached += known and share is not None and share <= snapshot.target
    widest_first = {
        status: tuple(sorted(group, key=lambda known: -(known[1] or 0.0)))
        for status, group in groups.items()
    }
    return Standing(
        widest_first["identified"], widest_first["weak"], widest_first["unobservable"], reached
    )


_TO = "IDENTIFIED TO "
_SHORT = {_TO: "", words.WRONG_AIRFRAME.upper(): "AIRFRAME"}
"""What headlines have instead where there is little room."""
Level = Verdict | Literal["waiting"]
"""What sign and color of the headline go by."""


def headline(snapshot: Snapshot) -> str:
    """The verdict in a word or two: `IDENTIFIED` once every interval is within the target.

    Before that, to how much: the widest of them.
    """
    if snapshot.link.state is LinkState.WAITING:
        return "WAITING"
    if snapshot.advice is not None and snapshot.advice.enough:
        return "ENOUGH"
    if contradicted(snapshot.result):
        return words.WRONG_AIRFRAME.upper()
    if level_of(snapshot) == "waiting":
        return "WAITING"
    if snapshot.result.verdict == "refused":
        return "NO ANSWER" if snapshot.link.state is LinkState.ENDED else "NOT YET"
    if _above_target(snapshot):
        every = (share for share in shares(snapshot.result).values() if share is not None)
        return f"{_TO}±{PLAIN.percent(max(every), target=snapshot.target)}"
    return snapshot.result.verdict.upper()


def short_headline(snapshot: Snapshot) -> str:
    """The headline where there is little room."""
    text = headline(snapshot)
    for long, short in _SHORT.items():
        text = text.replace(long, short)
    return text


def level_of(snapshot: Snapshot) -> Level:
    """The verdict, but `partial` above the target, and `waiting` before there are data."""
    if contradicted(snapshot.result):
        return "refused"
    if snapshot.result.verdict == "refused" and before_data(snapshot):
        return "waiting"
    enough = snapshot.advice is not None and snapshot.advice.enough
    return "partial" if _above_target(snapshot) and not enough else snapshot.result.verdict


def sign_of(snapshot: Snapshot) -> str:
    """The sign before the headline."""
    level = level_of(snapshot)
    return words.WAITING.sign if level == "waiting" else words.VERDICT[level].sign


def _above_target(snapshot: Snapshot) -> bool:
    """Whether all are identified and some intervals are wider than the target."""
    if snapshot.result.verdict != "identified":
        return False
    standing = standing_of(snapshot)
    return standing.reached < standing.total


def named(
    group: Sequence[Known], room: int, *, shares: bool = True, target: float | None = None
) -> str:
    """As many names as there is room for, and how many there are besides: `Izz ±8 %, +2`.

    What is above the target never reads as within it.
    """
    words = [
        f"{name} ±{PLAIN.percent(share, target=target)}" if shares and share is not None else name
        for name, share in group
    ]
    for count in range(len(words), 0, -1):
        rest = len(words) - count
        text = ", ".join([*words[:count], *([f"+{rest}"] if rest else [])])
        if len(text) <= room:
            return text
    return f"{len(words)}" if words else "nothing"


def compared(comparison: Comparison, room: int) -> tuple[str, str]:
    """A comparison with the baseline in a sentence, and its sign."""
    groups = {
        verdict: [(words.label(name), None) for name in comparison.named(verdict)]
        for verdict in ("changed", "no_change_seen", "cannot_tell")
    }
    same, unknown = len(groups["no_change_seen"]), len(groups["cannot_tell"])
    tail = f"no change seen in {same}" + (f", undetermined {unknown}" if unknown else "")
    if comparison.verdict == "cannot_tell":
        return "?", "change undetermined so far"
    if comparison.verdict == "changed":
        names = named(groups["changed"], max(8, room - len(tail) - 11), shares=False)
        return "≠", f"changed: {names}; {tail}"
    return "=", tail


# The link ---------------------------------------------------------------------------------------

LINK_SIGN: dict[LinkState, str] = {
    LinkState.WAITING: "○",
    LinkState.CONNECTED: "●",
    LinkState.REPLAY: "▶",
    LinkState.LOST: "✗",
    LinkState.ENDED: "■",
}


def notice(link: LinkStatus, silence: float = 0.0) -> tuple[str, str] | None:
    """What should be known before reading on, and its level; None while all is well.

    `silence` is s since the link last brought something; 0: unknown.
    """
    if link.state is LinkState.WAITING and link.rejected and not link.received:
        return f"Listening on {link.url}: {NO_MAVLINK}.", "warning"
    if link.state is LinkState.WAITING:
        return (
            f"Listening on {link.url}: no vehicle yet. Is the vehicle on, or telemetry forwarding "
            "enabled?",
            "warning",
        )
    if link.state is LinkState.LOST:
        since = f": no data for {duration(silence)}" if silence else ""
        return f"Link lost{since}. Estimates are kept; still listening.", "error"
    if link.state is LinkState.ENDED:
        return "Stream ended, numbers are final.", "info"
    return None


@dataclass(frozen=True)
class MessageRate:
    """How often a message comes, and was asked for.

    Attributes:
        name: of the message.
        got: Hz.
        asked: Hz; None: not asked for.
    """

    name: str
    got: float
    asked: float | None

    @property
    def slow(self) -> bool:
        """Whether it comes at less than nine tenths of the rate asked for."""
        return self.asked is not None and self.got < 0.9 * self.asked


def message_rates(link: LinkStatus) -> list[MessageRate]:
    """Every message; first what was asked for, which the identification needs."""
    names = sorted(set(link.rates) | set(link.asked), key=lambda n: (n not in link.asked, n))
    return [MessageRate(name, link.rates.get(name, 0.0), link.asked.get(name)) for name in names]


# Coach, replay and call-outs --------------------------------------------------------------------


def gain_text(gain: Gain) -> str:
    """What a maneuver does to one parameter: `Izz 12 % → 3 %`; `Izz 3 % ✓` once it is there."""
    now = "?" if gain.now is None else PLAIN.percent(gain.now, 1)
    if gain.now is not None and gain.now <= gain.expected:
        return f"{words.label(gain.name)} {now} ✓"
    return f"{words.label(gain.name)} {now} → {PLAIN.percent(gain.expected, 1)}"


def converged(share: float | None, target: float) -> float:
    """How far a parameter has come, on a logarithmic scale: 0 at ±100 %, 1 at the target."""
    if share is None or share <= 0.0:
        return 0.0
    return min(1.0, max(0.0, math.log(share) / math.log(min(target, 0.99))))


def playback_text(playback: Playback) -> str:
    """What a replay does now, in a sign and a word or two."""
    if playback.seeking is not None:
        return f"» to {clock(playback.seeking)}"
    if playback.ended:
        return "■ end"
    speed = speed_text(playback.speed)
    return f"‖ paused ({speed})" if playback.paused else f"▶ {speed}"


LAST_SECONDS = 5
"""s left of a maneuver when that is said."""
_PRONOUNCED = (
    (r"±\s*", "plus or minus "), (r"°", " degrees"), (r"\bHz\b", "hertz"), (r"\s*%", " percent"),
    (r"\bI([xyz])([xyz])\b", r"I \1 \2"), (r"_", " "), (r"(\d) m\b", r"\1 meters"),
)  # fmt: skip


def pronounced(text: str) -> str:
    """A text as a speech program says it right: symbols and names of parameters as words."""
    for written, said in _PRONOUNCED:
        text = re.sub(written, said, text)
    return text


def call_outs(snapshot: Snapshot) -> dict[str, str]:
    """What could be said now: kind -> words, empty where there is nothing to say."""
    link = {
        LinkState.CONNECTED: "Link is up.",
        LinkState.LOST: "Link lost.",
        LinkState.ENDED: "Stream ended, numbers are final.",
    }
    standing = standing_of(snapshot)
    counted = (
        snapshot.used_seconds > 0.0
        and level_of(snapshot) != "waiting"
        and snapshot.link.state is not LinkState.LOST
    )
    return {
        "link": link.get(snapshot.link.state, ""),
        "coach": "" if snapshot.advice is None else pronounced(_order(snapshot.advice)),
        "time": "" if snapshot.advice is None else _time_left(snapshot.advice),
        "verdict": f"{headline(snapshot).capitalize()}, {standing.reached} of {standing.total}."
        if counted
        else "",
    }


def _order(advice: Advice) -> str:
    if advice.enough:
        return "Enough. Every interval is within the target."
    if not advice.manoeuvre:
        return ""
    return f"Fly {', '.join(advice.axes) or advice.manoeuvre}, for {advice.seconds:.0f} seconds."


def _time_left(advice: Advice) -> str:
    left = seconds_left(advice)
    return f"{LAST_SECONDS} seconds left." if 0.0 < left <= LAST_SECONDS < advice.seconds else ""


def seconds_left(advice: Advice) -> float:
    """Seconds of the maneuver that are still to be flown."""
    return max(0.0, (1.0 - advice.progress) * advice.seconds)
