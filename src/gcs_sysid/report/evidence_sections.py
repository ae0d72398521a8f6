"""The sections on how far the findings can be trusted; and the picture of a twin's errors."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from gcs_sysid.inspection.thresholds import THRESHOLDS
from gcs_sysid.model.parameters import AXES
from gcs_sysid.report.data import ReportData
from gcs_sysid.report.drawing import BLUE, PALE, RED, SOFT, line, picture, polyline, text
from gcs_sysid.report.page_figures import (
    ChartData,
    add_prediction,
    add_rates,
    add_spectrum,
    add_timeline,
)
from gcs_sysid.report.parts import (
    Child,
    Markup,
    element,
    facts,
    figure,
    grid,
    legend,
    note,
    numbers,
    section,
    table,
)
from gcs_sysid.results.snapshot import Event
from gcs_sysid.results.words import PAGE, STREAM_WORDS, event_text, losses
from gcs_sysid.significance import Z95
from gcs_sysid.twin.twin_flight import SHOWN, TwinFlight

_NEEDED = {
    "imu": THRESHOLDS.imu_rate,
    "rotor_speed": THRESHOLDS.imu_rate,
    "rotor_command": THRESHOLDS.command_rate,
    "attitude": THRESHOLDS.attitude_rate,
}
"""Hz."""
AXIS_COLUMNS = numbers(*(axis.capitalize() for axis in AXES))


def prediction(data: ReportData, figures: ChartData) -> Markup:
    """Measured against predicted, on what was not fitted."""
    found = data.result.validation
    shown = add_prediction(figures, data)
    if not found:
        text = "The flight is too short for validation on held-out data."
        return section("prediction", "Prediction of held-out data", note(text))
    share = PAGE.percent(found["fitted_share"])
    rows = [
        ["R² (1 is perfect)", *(_number(found["r_squared"][axis], 4) for axis in AXES)],
        ["Theil (0 is perfect)", *(_number(found["theil"][axis], 3) for axis in AXES)],
    ]
    return section(
        "prediction",
        "Prediction of held-out data",
        note(
            f"A model fitted to {share} of {_which_flight(data)} predicts the angular acceleration "
            "of the stretches in between from rotors and rates. Both sides pass the estimator's "
            "window."
        ),
        legend(("measured", "measured"), ("predicted", "predicted")) if shown else None,
        grid(
            "one",
            (figure(f"prediction-{axis}", axis.capitalize(), _agreement(found, axis))
             for axis in AXES),
        )
        if shown
        else None,
        _per_axis("Agreement with held-out data", rows),
    )  # fmt: skip


def _which_flight(data: ReportData) -> str:
    segments = data.result.segments
    return f"the flight since {segments[-1]['end']:.1f} s" if segments else "the flight"


def _per_axis(caption: str, rows: Iterable[Sequence[Child]]) -> Markup:
    return table(caption, ["Measure", *AXIS_COLUMNS], rows, layout="axes")


def _agreement(found: Mapping[str, Any], axis: str) -> str:
    r_squared, theil = (_number(found[key][axis], 4) for key in ("r_squared", "theil"))
    return f"R² {r_squared}, Theil {theil}"


def _number(value: float | None, digits: int, factor: float = 1.0) -> str:
    return PAGE.nothing if value is None else PAGE.fixed(factor * value, digits)


_TWIN_UNITS = {
    "rates": (180.0 / math.pi, "°/s"),
    "attitude": (180.0 / math.pi, "°"),
    "velocity": (1.0, "m/s"),
}


def twin(data: ReportData) -> Child:
    """The identified model flown beside the vehicle; None where nothing was held out."""
    if not data.twin:
        return None

    def shown(value: float | None, scale: float, unit: str) -> str:
        return "–" if value is None else f"{PAGE.number(scale * value)} {unit}"

    rows = []
    for name, (scale, unit) in _TWIN_UNITS.items():
        for horizon in data.twin["horizons"]:
            a = horizon.get(name)
            if a is None:
                continue
            share = "–" if a["inside"] is None else f"{100.0 * a['inside']:.0f} %"
            rows.append(
                [
                    f"{name.capitalize()}, {horizon['seconds']:g} s ahead",
                    *(shown(a[each], scale, unit) for each in ("rms", "band")),
                    share,
                    *(shown(a[each], scale, unit) for each in ("basic", "guess")),
                ]
            )
    titles = ("Error, rms", "95 % band, ±", "Inside", "Basic model", "Constant guess")
    columns = ["Ahead", *numbers(*titles)]
    spans = " and ".join(f"{start:.0f} to {end:.0f} s" for start, end in data.twin["held_out"])
    return section(
        "twin",
        "Does the model fly like the vehicle?",
        note(
            "The model fitted to the first part of the flight, flown with the rotors' inputs from "
            f"the measured state over {spans}, which it has not seen. The band is predicted by the "
            "covariance of the parameters, sensor noise and disturbance; 95 % of the errors should "
            "be inside. The basic model lacks drag, damping, rotor inertia and differences between "
            "rotors; the guess keeps rates and velocity as they are."
        ),
        element("div", Markup(data.twin_picture.strip()), class_="health"),
        table("Errors at the end of the stretches", columns, rows),
    )


_LEFT, _WIDE, _GAP, _TOP, _HIGH = 60.0, 250.0, 60.0, 64.0, 220.0
"""Of the panels of a twin's picture."""


def twin_svg(twin: TwinFlight) -> str:
    """Error growth of model and guess, and the band, a panel each; complete, nothing is loaded."""
    names = list(twin.growth.rms)
    parts = [
        text(_LEFT, 22.0, f"{twin.source or 'result'} along {twin.log}", size=15),
        text(_LEFT, 40.0, f"held out: {twin.held_out}", size=12),
    ]
    for i, name in enumerate(names):
        parts += _growth(twin, name, _LEFT + i * (_WIDE + _GAP))
    x, y = _LEFT, _TOP + _HIGH + 56.0
    for color, words in (
        (BLUE, "rms error of the model"),
        (SOFT, "of the constant guess"),
        (RED, "predicted rms of the error (half of the 95 % band)"),
    ):
        parts.append(element("rect", x=x, y=y - 9.0, width=14, height=9, fill=color))
        parts.append(text(x + 20.0, y, words, size=12))
        x += 30.0 + 7.0 * len(words)
    size = _LEFT + len(names) * (_WIDE + _GAP), _TOP + _HIGH + 76.0
    return picture(size, f"The twin along {twin.log}", parts, letters=12)


def _growth(twin: TwinFlight, name: str, left: float) -> Iterator[Markup]:
    scale, unit = SHOWN[name]
    bands = [
        (seconds, 0.5 * scale * each[name].band)
        for seconds, each in twin.accuracy.items()
        if name in each and math.isfinite(each[name].band)
    ]
    curves = [
        (color, scale * found[name])
        for color, found in ((SOFT, twin.growth.guess), (BLUE, twin.growth.rms))
    ]
    values = np.concatenate([*(curve for _, curve in curves), [band for _, band in bands]])
    values = values[np.isfinite(values) & (values > 0.0)]
    if not len(values):
        return
    end = float(twin.growth.t[-1])
    high = math.ceil(math.log10(values.max()))
    low = min(max(math.floor(math.log10(values.min())), high - 4), high - 1)
    bottom, right = _TOP + _HIGH, left + _WIDE

    def place(seconds: float, value: float) -> tuple[float, float]:
        share = (math.log10(max(value, 10.0**low)) - low) / (high - low)
        return left + _WIDE * min(seconds / end, 1.0), bottom - _HIGH * share

    yield text(left, _TOP - 6.0, f"{name}, {unit}", size=12)
    yield text(left + 0.5 * _WIDE, bottom + 30.0, "s since the measured state", size=12,
               anchor="middle")  # fmt: skip
    for power in range(low, high + 1):
        _, y = place(0.0, 10.0**power)
        yield text(left - 4.0, y + 4.0, f"{10.0**power:g}", size=12, anchor="end")
        yield line(left, y, right, y, "grid", stroke=PALE)
    for share in (0.0, 0.5, 1.0):
        x = left + _WIDE * share
        yield text(x, bottom + 14.0, f"{share * end:g}", size=12, anchor="middle")
    for color, curve in curves:
        seen = zip(twin.growth.t.tolist(), curve.tolist(), strict=True)
        yield polyline((place(s, v) for s, v in seen if math.isfinite(v)), color, 1.6)
    for x, y in (place(*band) for band in bands):
        yield element("circle", cx=f"{x:.1f}", cy=f"{y:.1f}", r=4, fill=RED)


def residual(data: ReportData, figures: ChartData) -> Markup | None:
    """The spectrum of what is left, and whether it is noise."""
    found = data.result.validation
    if not found:
        return None
    shown = add_spectrum(figures, data)
    whiteness, p = found["whiteness"], found["whiteness_p"]
    rows: list[list[Child]] = [
        ["Whiteness (1 is white)", *(_number(whiteness[axis], 2) for axis in AXES)],
        ["Probability by chance", *(_probability(p[axis]) for axis in AXES)],
        ["In words", *(_color(whiteness[axis], p[axis]) for axis in AXES)],
    ]
    gyroscopic = found.get("gyroscopic")
    if gyroscopic:
        share, std = gyroscopic["share"], gyroscopic["std"]
        rows.append(
            [
                "Gyroscopic torque found (1 is a rigid body)",
                *(f"{_number(share[a], 2)} ± {_number(std[a], 2, Z95)}" for a in AXES),
            ]
        )
    return section(
        "residual",
        "Residual",
        note(
            "Where only sensor noise is left, the residual follows the dashed curve. More at low "
            "frequencies is wind or a drifting parameter, peaks are vibration."
        ),
        legend(("residual", "residual"), ("white", "white sensor noise alone")) if shown else None,
        grid("three", (figure(f"spectrum-{axis}", axis.capitalize(), size="medium")
                       for axis in AXES)) if shown else None,
        _per_axis("Whiteness of the residual, per axis", rows),
    )  # fmt: skip


def _probability(p: float | None) -> str:
    if p is None:
        return PAGE.nothing
    return "< 0.001" if p < 0.001 else PAGE.fixed(p, 3)


def _color(whiteness: float | None, p: float | None) -> str:
    if whiteness is None or p is None:
        return "undetermined"
    if p >= 0.05:
        near = 1.0 / 1.5 < whiteness < 1.5
        return "white: sensor noise only" if near else "undetermined"
    return "slow disturbances" if whiteness > 1.0 else "fast disturbances"


def excitation(data: ReportData, figures: ChartData) -> Markup:
    """How each axis was moved."""
    shown = add_rates(figures, data)
    motion = data.inspection.get("excitation", {})
    rows: list[list[Child]] = []
    if data.prediction is not None:
        rates = data.prediction.rates
        rates = rates[np.isfinite(rates).all(axis=1)]
        if len(rates):
            peak = np.abs(rates).max(axis=0)
            rows.append(
                [
                    "Largest rate in the data used, rad/s",
                    *(PAGE.number(v) for v in peak.tolist()),
                ]
            )
    if motion:
        for key, words in (
            ("rate_rms", "Rate of the whole recording, rms, rad/s"),
            ("acceleration_rms", "Angular acceleration of the whole recording, rms, rad/s²"),
        ):
            rows.append([words, *(PAGE.number(motion[axis][key]) for axis in AXES)])
        rows.append(
            [
                "Enough?",
                *(_enough(axis, motion[axis]["acceleration_rms"]) for axis in AXES),
            ]
        )
    if not rows and not shown:
        return section("excitation", "Excitation", note("No flight."))
    return section(
        "excitation",
        "Excitation",
        note("Identification needs motion. Body rates over the whole flight:"),
        grid("one", (figure(f"rate-{axis}", f"{axis.capitalize()} rate", size="low")
                     for axis in AXES)) if shown else None,
        _per_axis("Motion in flight, per axis", rows),
    )  # fmt: skip


def _enough(axis: str, acceleration: float) -> Markup:
    good = acceleration >= THRESHOLDS.acceleration[axis]
    sign = element("span", "●" if good else "○", class_="sign", aria_hidden="true")
    word = "yes" if good else f"too little: below {THRESHOLDS.acceleration[axis]:g} rad/s²"
    return element("span", sign, word, class_=f"status {'identified' if good else 'weak'}")


def events(data: ReportData, figures: ChartData) -> Markup:
    """What happened, on the time axis."""
    shown = add_timeline(figures, data)
    listed = data.result.events
    rows = [
        [str(number), f"{PAGE.fixed(event['t'], 2)} s", event_text(event, PAGE)]
        for number, event in enumerate(listed, 1)
    ]
    columns = ["No.", *numbers("Time"), "What"]
    return section(
        "events",
        "Events",
        figure("timeline", "The flight on the time axis", size="strip") if shown else None,
        table("Events", columns, rows) if rows else note("No events."),
        _notes(data.notes),
    )


def _notes(notes: Iterable[Event]) -> Markup | None:
    """What the analysis itself noted."""
    rows = [[f"{PAGE.fixed(event.t, 2)} s", event.text] for event in notes]
    columns = ["Time", "Note"]
    return table("Notes of the analysis", columns, rows, layout="axes") if rows else None


def telemetry(data: ReportData) -> Markup:
    """How sound the data were."""
    counts = data.result.telemetry
    streams = data.inspection.get("streams", ())
    columns = [
        "Stream",
        "Message",
        *numbers("Needed", "Got", "Gaps", "Longest", "Missing", "Repeats"),
    ]
    return section(
        "telemetry",
        "Telemetry",
        table(
            "Streams in flight, of the whole recording",
            columns,
            (_stream(stream) for stream in streams),
        )
        if streams
        else note("No usable stream."),
        facts(_link_facts(data, counts)),
        _messages(counts.get("messages", {})),
    )


def _stream(stream: Mapping[str, Any]) -> list[Child]:
    kind = stream["stream"]
    rate, needed = stream["rate"], _NEEDED.get(kind)
    got: Child = PAGE.nothing if rate is None else f"{PAGE.fixed(rate, 1)} Hz"
    if needed and (rate is None or rate < 0.9 * needed):
        sign = element("span", "○", class_="sign", aria_hidden="true")
        got = element("span", sign, f"{got}, slow", class_="status weak")
    missing = stream["missing_percent"]
    offset = f" from rotor {stream['offset'] + 1}" if stream["offset"] else ""
    return [
        STREAM_WORDS.get(kind, kind) + offset,
        stream["message"],
        f"{needed:g} Hz" if needed else PAGE.nothing,
        got,
        str(stream["gaps"]),
        f"{PAGE.fixed(stream['longest_gap'], 2)} s" if stream["gaps"] else PAGE.nothing,
        PAGE.nothing if missing is None else f"{PAGE.fixed(missing, 1)} %",
        f"{PAGE.fixed(stream['repeats_percent'], 1)} %",
    ]


def _link_facts(data: ReportData, counts: Mapping[str, Any]) -> dict[str, Child]:
    """Counts of the link, the clock and the rotors' stream."""
    out: dict[str, Child] = {}
    if "received" in counts:
        lost, share = counts.get("lost", 0), counts.get("lost_percent", 0.0)
        out["Messages"] = f"{counts['received']}, lost {lost} ({PAGE.fixed(share, 2)} %)"
    outliers = {kind: n for kind, n in counts.get("imu_outliers", {}).items() if n}
    if outliers:
        out["Outliers of the IMU"] = ", ".join(f"{n} {kind}" for kind, n in outliers.items())
    fates = {fate: n for fate, n in counts.get("fates", {}).items() if n}
    if fates:
        out["Use"] = ", ".join(f"{n} {fate}" for fate, n in fates.items())
    if counts.get("recorded"):
        out["Recorded"] = str(counts["recorded"])
    out["Damaged or dropped"] = ", ".join(losses(counts)) or "none"
    drift = counts.get("clock_drift_ppm")
    boots = counts.get("reboots", 0)
    pace = "drift unknown" if drift is None else f"{PAGE.fixed(drift, 0)} ppm against the recorder"
    out["Vehicle's clock"] = pace + (f", {boots} reboot{'s' * (boots > 1)}" if boots else "")
    rate = counts.get("grid_rate")
    if rate:
        out["Common time base"] = f"{PAGE.fixed(rate, 1)} Hz"
    gaps = counts.get("imu_gaps", {}).get("count")
    if gaps is not None:
        out["Gaps of the IMU"] = str(gaps)
    rotors = counts.get("rotor_input", {})
    if rotors.get("source"):
        out["Rotors from"] = f"{rotors['source']}: {rotors['why']}"
    refused = rotors.get("refused") or {}
    if refused:
        out["Rejected"] = "; ".join(f"{name} {why}" for name, why in refused.items())
    if rotors.get("gyro_filter"):
        out["Gyro filter assumed"] = f"{rotors['gyro_filter']:g} Hz"
    if rotors.get("gyro_filter_found"):
        out["Gyro filter found"] = f"{rotors['gyro_filter_found']:.0f} Hz, by its delay"
    systems = counts.get("systems") or ()
    if systems:
        out["Systems"] = ", ".join(map(str, systems))
    return out


def _messages(messages: Mapping[str, Any]) -> Markup | None:
    if not messages:
        return None
    rows = [
        [name, str(entry["count"]), _number(entry.get("rate"), 1)]
        for name, entry in sorted(messages.items(), key=lambda item: -(item[1]["count"] or 0))
    ]
    columns = ["Message", *numbers("Count", "Hz")]
    return element(
        "details",
        element("summary", f"All {len(rows)} kinds of messages"),
        table("Messages received", columns, rows, layout="plain"),
    )
