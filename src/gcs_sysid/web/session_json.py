"""A snapshot as the live page shows it."""

import math
from collections.abc import Mapping
from typing import Any

from gcs_sysid.errors import InputError
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.report.page_figures import ChartData, add_history
from gcs_sysid.results.comparison import compare
from gcs_sysid.results.history import known_history
from gcs_sysid.results.number_format import PAGE, clock, clock_tenths, duration
from gcs_sysid.results.result_view import number_figures
from gcs_sysid.results.snapshot import Advice, LinkState, LinkStatus, Playback, Snapshot
from gcs_sysid.results.summary import before_data
from gcs_sysid.screen.snapshot_view import (
    LINK_SIGN,
    call_outs,
    compared,
    converged,
    gain_text,
    headline,
    level_of,
    message_rates,
    notice,
    playback_text,
    seconds_left,
    shares,
    sign_of,
    standing_of,
)
from gcs_sysid.screen.view import EarlierResult
from gcs_sysid.web.result_json import result_rows

MOST_POINTS = 240
"""Of a plot."""


def session_view(
    snapshot: Snapshot, truth: Mapping[str, float], baseline: EarlierResult | None
) -> dict[str, Any]:
    """All but the plot.

    Args:
        snapshot: to show.
        truth: true values by parameter name, where known.
        baseline: an earlier result to compare with.
    """
    waiting = before_data(snapshot)
    standing = standing_of(snapshot)
    reached = shares(snapshot.result)
    ended = snapshot.link.state is LinkState.ENDED
    parameters = result_rows(snapshot.result, truth, waiting=waiting, ended=ended)
    for row in parameters:
        share = reached.get(row["name"])
        row["done"] = (
            round(converged(share, snapshot.target), 2) if row["name"] in reached else None
        )
    return {
        "t": clock(snapshot.t),
        "used": duration(snapshot.used_seconds),
        "flying": snapshot.flying,
        "target": PAGE.percent(snapshot.target),
        "verdict": {
            "word": snapshot.result.verdict,
            "sign": sign_of(snapshot),
            "headline": headline(snapshot),
            "level": level_of(snapshot),
            "reached": standing.reached,
            "total": standing.total,
            "reasons": list(snapshot.result.reasons),
        },
        "baseline": _baseline(snapshot, baseline),
        "link": _link(snapshot.link),
        "call_outs": call_outs(snapshot),
        "coach": None if snapshot.advice is None else _coach(snapshot.advice),
        "parameters": parameters,
        "rotors": _rotors(snapshot),
        "attitude": None
        if snapshot.attitude is None
        else [round(math.degrees(angle), 1) for angle in snapshot.attitude],
        "events": [
            {"t": clock_tenths(event.t), "text": event.text} for event in snapshot.events[-40:]
        ],
        "playback": None if snapshot.playback is None else _playback(snapshot.playback),
    }


def history_view(
    snapshot: Snapshot, name: str, truth: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """The plot of one parameter over the flight, in words and as the figure of a report.

    Raises:
        InputError: there is no such parameter.
    """
    parameter = REGISTRY.get(name)
    if parameter is None:
        raise InputError(f"no parameter {name!r}")
    plot, text = ChartData(), f"{name}: no estimate yet."
    t, value, half = known_history(snapshot.history, name)
    if len(t):
        last = 0.0 if math.isnan(half[-1]) else float(half[-1])
        shown = number_figures(
            float(value[-1]), last, parameter.unit, PAGE, exponent=parameter.exponent
        )
        text = f"{name}, {parameter.meaning}: {shown.measure}"
    add_history(plot, snapshot.history, name, MOST_POINTS, (truth or {}).get(name))
    return {"name": name, "text": text, **plot.as_json()}


def _baseline(snapshot: Snapshot, baseline: EarlierResult | None) -> dict[str, str] | None:
    if baseline is None:
        return None
    try:
        sign, text = compared(compare(baseline.result, snapshot.result), 400)
    except InputError as error:
        sign, text = "?", str(error)
    return {"name": baseline.name, "sign": sign, "text": text}


def _link(link: LinkStatus) -> dict[str, Any]:
    found = notice(link)
    slow = "This computer is too slow: data are queued, advice is delayed." if link.too_slow else ""
    rates = [
        {
            "name": each.name,
            "rate": f"{each.got:.0f}",
            "asked": f"{each.asked:.0f}",
            "slow": each.slow,
        }
        for each in message_rates(link)
        if each.asked is not None
    ]
    return {
        "state": link.state.value,
        "sign": LINK_SIGN[link.state],
        "notice": slow if found is None else found[0],
        "vehicle": link.vehicle,
        "rates": rates,
        "lost": f"{PAGE.fixed(link.lost_percent, 1)} %",
        "gaps": link.gaps,
        "recording": link.recording.replace("\\", "/").rpartition("/")[2],
        "vehicles": [
            {"address": list(one.address), "name": one.name, "chosen": one.chosen}
            for one in link.vehicles
        ],
    }


def _coach(advice: Advice) -> dict[str, Any]:
    # The order in large letters, and aloud; what it is for below.
    text, _, aim = advice.text.rpartition(": ") if advice.manoeuvre else (advice.text, "", "")
    return {
        "text": text or aim,
        "aim": aim if text else "",
        "fly": bool(advice.manoeuvre),
        "enough": advice.enough,
        "progress": round(advice.progress, 2),
        "left": f"{seconds_left(advice):.0f} s left" if advice.manoeuvre else "",
        "gains": [] if text and aim else [gain_text(gain) for gain in advice.gains[:4]],
    }


def _rotors(snapshot: Snapshot) -> list[dict[str, Any]]:
    """Each rotor's speed or command against the mean of all."""
    speeds = snapshot.rotor_speeds
    if not speeds or not all(map(math.isfinite, speeds)):
        return []
    mean = sum(speeds) / len(speeds)
    places = snapshot.result.airframe.get("rotors", ())
    return [
        {
            "value": snapshot.result.rotor_input.shown(speed),
            "share": round(min(speed / mean, 2.0), 2) if mean > 0.0 else 0.0,
            "spin": places[i]["spin"] if i < len(places) else "",
        }
        for i, speed in enumerate(speeds)
    ]


def _playback(playback: Playback) -> dict[str, Any]:
    return {
        "state": playback_text(playback),
        "position": round(playback.position, 1),
        "duration": round(playback.duration, 1),
        "clock": f"{clock(playback.position)} / {clock(playback.duration)}",
        "paused": playback.paused,
    }
