"""A session in lines on standard error, where there is no screen."""

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from gcs_sysid.cli import output
from gcs_sysid.live.live_view import Session
from gcs_sysid.model.parameters import CORE_OF, REGISTRY
from gcs_sysid.results.result_view import figures
from gcs_sysid.results.snapshot import Event, LinkState, Snapshot
from gcs_sysid.results.summary import before_data, contradicted
from gcs_sysid.results.words import WAITING, WRONG_AIRFRAME

if TYPE_CHECKING:
    from gcs_sysid.screen.call_outs import Announcer


def say_until_end(session: Session, announcer: "Announcer | None" = None) -> None:
    """One line a second on standard error, and one for each event; call-outs where wanted."""
    every = 1.0  # s between lines
    said = -every
    last = ""
    printed: Event | None = None
    advised = ""
    ended = False
    while not ended:
        ended = session.join(0.1)
        now = time.monotonic()
        snapshot = session.latest()
        if snapshot is None:
            continue
        if announcer is not None:
            announcer.see(snapshot)
        for event in events_after(printed, snapshot.events):
            output.say(f"{event.t:7.1f} s  {event.text}")
            printed = event
        if ended:
            return
        if snapshot.advice is not None and snapshot.advice.text != advised:
            advised = snapshot.advice.text
            output.say(f"{snapshot.t:7.1f} s  coach: {advised}")
        if now - said < every:
            continue
        line = status_line(snapshot)
        if line != last:
            output.say(line)
        said, last = now, line


def events_after(last: Event | None, events: Sequence[Event]) -> Sequence[Event]:
    """The events after the last one printed; all, when that is long gone."""
    for i in range(len(events) - 1, -1, -1):
        if events[i] is last:
            return events[i + 1 :]
    return events


def status_line(snapshot: Snapshot) -> str:
    """The state of a session in one line."""
    link = snapshot.link
    if link.state is LinkState.WAITING:
        reasons = snapshot.result.reasons
        if link.received or link.rejected or len(reasons) > 1:  # something, but no vehicle
            return f"listening on {link.url}: {'; '.join(reasons)}"
        return f"listening on {link.url}: no vehicle yet"
    words = [f"{snapshot.t:7.1f} s", link.vehicle or link.url]
    if link.state is not LinkState.CONNECTED:
        words.append(str(link.state.value))
    words.append(_verdict_words(snapshot))
    for name in CORE_OF[snapshot.result.rotor_input]:
        estimate = snapshot.result.parameters.get(name)
        if REGISTRY[name].sign != "positive" or (estimate and estimate.status == "given"):
            continue
        words.append(f"{name} {figures(estimate, digits=4).short}")
    reasons = snapshot.result.reasons
    if snapshot.result.verdict == "refused" and reasons:
        words.append(f"({reasons[0]})")
    return "  ".join(words)


def _verdict_words(snapshot: Snapshot) -> str:
    """The verdict, or what stands in its place before there are data."""
    if contradicted(snapshot.result):
        return WRONG_AIRFRAME
    waiting = snapshot.result.verdict == "refused" and before_data(snapshot)
    return WAITING.meaning if waiting else snapshot.result.verdict
