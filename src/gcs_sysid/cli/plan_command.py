"""`gcs-sysid plan`: what to fly, on paper. Nothing is sent to a vehicle."""

import argparse
import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.cli.airframe_choice import airframe_of
from gcs_sysid.cli.followed_session import coach_options
from gcs_sysid.cli.output import check_outputs, deliver
from gcs_sysid.coach.choice import HOVER, Plan, Step, make_plan, shares
from gcs_sysid.coach.information import prior_vehicle
from gcs_sysid.coach.manoeuvre_library import RAMP, Manoeuvre, gain_words, motion_words
from gcs_sysid.errors import InputError
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.model.airframe import ScaleReference
from gcs_sysid.model.parameters import AXES
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.report.drawing import line, picture, polyline, text
from gcs_sysid.results.summary import priors_for, values_of
from gcs_sysid.results.words import PLAIN, wrapped
from gcs_sysid.setup_help.checks import can_show
from gcs_sysid.strict_json import json_text

_BLOCKS, _PLAIN = "▁▂▃▄▅▆▇█", "_.,-~=*#"
_AXES = (*AXES, "climb")
_FOOT = (
    "An estimate for a vehicle of this size and mass with usual sensors (IMU and rotor speeds at "
    "250 Hz). In flight the coach uses the measured data."
)
_COLORS = ("#1f6fb4", "#c2571a", "#2b8a3e", "#7048a8")


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 where no plan within the limits is enough."""
    if options.json == options.svg == "-":
        raise InputError("--json and --svg cannot both go to standard output: give one a file")
    check_outputs(options.json, options.svg, force=options.force)
    airframe = airframe_of(options)
    own = airframe.anchor()
    assert own is not None
    rotor_input = (
        (RotorInput(options.rotor_input) if options.rotor_input else airframe.wanted_input)
        or RotorInput.scaled_by(own[0])
        or RotorInput.SPEED
    )
    replace(airframe, rotor_input=rotor_input).check_scale_fits()
    anchor = ScaleReference(*own)
    priors = priors_for(airframe.priors, rotor_input)

    def judge(fit: Fit) -> dict[str, float | None]:
        values = values_of(fit, anchor, airframe.arm, priors, rotor_input, cant=airframe.canted)
        return shares(values, airframe.arm, rotor_input)

    known = prior_vehicle(airframe, rotor_input)
    coach = coach_options(options)
    plan = make_plan(airframe.name, known, judge, coach.target, coach.limits)
    deliver(
        plan_text(plan, unicode=can_show("▁▂▃▄▅▆▇█±°")),
        (options.svg, lambda: plan_svg(plan)),
        (options.json, lambda: json_text(plan.as_json(), 1) + "\n"),
        force=options.force,
    )
    return 0 if plan.enough else 1


def plan_text(plan: Plan, *, unicode: bool = True) -> str:
    """The plan as lines for a terminal or a sheet of paper.

    `unicode`: blocks can be printed; signs of ASCII otherwise.
    """
    limits = plan.limits
    lines = [
        *wrapped(
            f"Flight plan for {plan.airframe}: every 95 % interval within "
            f"{100.0 * plan.target:g} % of the value"
        ),
        f"limits: tilt {math.degrees(limits.tilt):.0f}°, rate {math.degrees(limits.rate):.0f}°/s, "
        f"height ±{limits.height:g} m",
        "",
        f"{0.0:4.0f} s  hover, {HOVER:.0f} s",
    ]
    for step in plan.steps:
        lines += wrapped(motion_words(step.manoeuvre), f"{step.start:4.0f} s  ")
        for axis, wave in _waves(step.manoeuvre):
            lines.append(f"        {axis:6} {_spark(wave, _BLOCKS if unicode else _PLAIN)}")
        lines += wrapped(_gains(step), " " * 8)
    lines += [f"{plan.seconds:4.0f} s  end", "", *wrapped(_widths(plan), "expected: ")]
    if not plan.enough:
        lines.append("that is not enough: allow more tilt, rate or a wider interval")
    lines += ["", *wrapped(_FOOT)]
    if not unicode:
        return "\n".join(lines).replace("±", "+-").replace("°", " deg")
    return "\n".join(lines)


def _gains(step: Step) -> str:
    return ", ".join(
        gain_words(name, step.now.get(name), share)
        for name in step.names[:4]
        for share in (step.expected[name],)
        if share is not None
    )


def _widths(plan: Plan) -> str:
    return ", ".join(f"{name} {PLAIN.percent(share, 1)}" for name, share in plan.expected.items())


def _waves(manoeuvre: Manoeuvre) -> Iterator[tuple[str, Array]]:
    t = np.linspace(0.0, 4.0, 32)  # s shown, in columns
    for axis, wave in zip(_AXES, manoeuvre.angles(t).T, strict=True):
        if wave.any():
            yield axis, wave / np.abs(wave).max()


def _spark(wave: Array, signs: str) -> str:
    places = np.clip((0.5 * (wave + 1.0) * len(signs)).astype(int), 0, len(signs) - 1)
    return "".join(signs[place] for place in places)


def plan_svg(plan: Plan) -> str:
    """The motion over time, a lane for each axis; complete, nothing is loaded."""
    width, left, lane, top = 900.0, 70.0, 70.0, 60.0
    used = [
        i
        for i, axis in enumerate(_AXES)
        if any(getattr(step.manoeuvre, axis) for step in plan.steps)
    ]
    height = top + lane * len(used) + 24.0 * (len(plan.steps) + 2) + 20.0
    scale = (width - left - 20.0) / max(plan.seconds, 1.0)
    title = f"Flight plan for {plan.airframe}: every interval within {100.0 * plan.target:g} %"
    out = [text(left, 24.0, f"{title}, {plan.seconds:.0f} s", size=16)]
    for row, i in enumerate(used):
        middle = top + lane * (row + 0.5)
        most = max(getattr(step.manoeuvre, _AXES[i]) for step in plan.steps)
        unit = f"±{most:g} m" if _AXES[i] == "climb" else f"±{math.degrees(most):.0f}°"
        points = [
            (left + scale * t, middle - 0.42 * lane * value / most)
            for t, value in _history(plan, i)
        ]
        out += [
            text(8.0, middle, _AXES[i], size=13),
            text(8.0, middle + 16.0, unit, size=11),
            polyline(points, _COLORS[i], 1.2),
        ]
    under = top + lane * len(used)
    for number, step in enumerate(plan.steps, 1):
        x = left + scale * step.start
        words = f"{number}.  {step.start:.0f} s: {motion_words(step.manoeuvre)}"
        out += [
            line(x, top - 14.0, x, under, "step", stroke="#999", stroke_dasharray="3 3"),
            text(x + 3.0, top - 4.0, str(number), size=13),
            text(left, under + 24.0 * number, words, size=13),
        ]
    below = under + 24.0 * (len(plan.steps) + 1)
    out.append(text(left, below, f"expected: {_widths(plan)}", size=11))
    return picture((width, height), title, out, letters=13)


def _history(plan: Plan, axis: int) -> Iterator[tuple[float, float]]:
    """Times and values of an axis from the start to the end, swings growing and fading."""
    edges = [*(step.start for step in plan.steps), plan.seconds]
    yield 0.0, 0.0
    for step, (start, _) in zip(plan.steps, pairwise(edges), strict=True):
        t = np.arange(0.0, step.manoeuvre.seconds + 1e-9, 0.04)
        grown = np.clip(np.minimum(t, step.manoeuvre.seconds - t) / RAMP, 0.0, 1.0)
        values = step.manoeuvre.angles(t)[:, axis] * grown
        yield from zip((start + t).tolist(), values.tolist(), strict=True)
    yield plan.seconds, 0.0
