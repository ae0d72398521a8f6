"""Results and snapshots as the pages show them: numbers, units and words are made here, not in the
browser.
"""

import math
from collections.abc import Mapping
from pathlib import PureWindowsPath
from typing import Any

from gcs_sysid.errors import InputError
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.report.page_figures import ChartData, add_history
from gcs_sysid.results.comparison import Comparison, Difference, compare, comparison_sentences
from gcs_sysid.results.health_view import absent_health
from gcs_sysid.results.history import known_history
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_view import (
    Figures,
    figures,
    number_figures,
    parameter_rows,
    verdict_sentence,
)
from gcs_sysid.results.snapshot import Advice, LinkState, LinkStatus, Playback, Snapshot
from gcs_sysid.results.summary import before_data
from gcs_sysid.results.words import CHANGE, PAGE, VERDICT, clock, clock_tenths, duration
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
from gcs_sysid.significance import Z95


def verdict_view(result: Result) -> dict[str, Any]:
    """The verdict in words."""
    word = VERDICT[result.verdict]
    return {
        "word": result.verdict,
        "sign": word.sign,
        "meaning": word.meaning,
        "sentence": verdict_sentence(result),
        "reasons": list(result.reasons),
    }


def why_no_health(document: Mapping[str, Any]) -> list[str]:
    """Why a result's hover has no findings; empty where it has, or nothing hovers.

    Args:
        document: of a result's file.
    """
    found = document.get("health")
    if not isinstance(found, dict) or found.get("verdict") != "refused":
        return []
    return [f"no health: {reason}" for reason in found["reasons"]]


def health_view(document: Mapping[str, Any] | None, look: int) -> dict[str, Any]:
    """What hover shows, in words; a picture of it can be had.

    Args:
        document: a health file's content; None before the first look.
        look: number of it, by which a browser knows that the picture is another one.
    """
    if document is None or document["verdict"] == "refused":
        return {"text": absent_health(document)}
    text = f"From {document['seconds_of_hover']:.0f} s of hover."
    return {"text": text, "advice": list(document["advice"]), "look": look}


def value_view(shown: Figures) -> dict[str, str]:
    """Value, half of the 95 % interval and unit."""
    out = {"value": shown.value, "half": "", "unit": shown.scaled_unit, "percent": shown.percent}
    if shown.kind == "limit":
        return {**out, "half": shown.limit, "unit": ""}
    return {**out, "half": f"± {shown.half}" if shown.half else ""}


def result_rows(
    result: Result,
    truth: Mapping[str, float] | None = None,
    *,
    waiting: bool = False,
    ended: bool = False,
) -> list[dict[str, Any]]:
    """The parameters in the order of all tables; arguments as of `parameter_rows`."""
    found = parameter_rows(result, PAGE, truth=truth, waiting=waiting, ended=ended)
    return [
        {
            "name": row.name,
            "meaning": row.parameter.meaning,
            "status": row.status,
            "sign": row.sign,
            "hint": row.hint,
            "error": _error(row.error),
            **value_view(row.figures),
        }
        for row in found
    ]


def _error(error: float | None) -> str:
    if error is None:
        return ""
    return f"{'+' if error > 0.0 else ''}{PAGE.percent(error)}"


def comparison_rows(comparison: Comparison) -> dict[str, Any]:
    """Two results side by side."""
    return {
        "verdict": comparison.verdict,
        "sign": CHANGE[comparison.verdict].sign,
        "sentence": " ".join(comparison_sentences(comparison)),
        "rows": [_difference(found) for found in comparison.differences.values()],
        "notes": list(comparison.notes),
    }


def _difference(found: Difference) -> dict[str, Any]:
    out: dict[str, Any] = {
        "name": found.name,
        "meaning": REGISTRY[found.name].meaning,
        "before": _both(found.before, REGISTRY[found.name].exponent),
        "after": _both(found.after, REGISTRY[found.name].exponent),
        "difference": PAGE.nothing,
        "verdict": CHANGE[found.verdict].meaning,
        "sign": CHANGE[found.verdict].sign,
        "why": found.why,
    }
    if found.value is not None and found.std:
        half, exponent = Z95 * found.std, REGISTRY[found.name].exponent
        shown = value_view(number_figures(found.value, half, found.unit, PAGE, exponent=exponent))
        out["difference"] = _in_one(shown)
    return out


def _both(estimate: Estimate | None, exponent: int | None) -> str:
    return _in_one(value_view(figures(estimate, PAGE, exponent=exponent)))


def _in_one(shown: Mapping[str, str]) -> str:
    return " ".join(filter(None, (shown["value"], shown["half"], shown["unit"])))


MOST_POINTS = 240
"""Of a plot."""


def session_view(
    snapshot: Snapshot, truth: Mapping[str, float], baseline: EarlierResult | None
) -> dict[str, Any]:
    """All but the plot.

    `truth` is by parameter name, where known.
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
        "recording": PureWindowsPath(link.recording).name,
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
