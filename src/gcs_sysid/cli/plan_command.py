"""`gcs-sysid plan`: what to fly, on paper. Nothing is sent to a vehicle."""

import argparse
import json
from dataclasses import replace
from pathlib import Path

from gcs_sysid.cli import arguments
from gcs_sysid.cli.option_groups import limits_of
from gcs_sysid.cli.output import Deliveries, check_json, print_file, save, show
from gcs_sysid.coach.flight_plan import make_plan
from gcs_sysid.coach.interval_targets import shares
from gcs_sysid.coach.plan_picture import plan_svg, plan_text
from gcs_sysid.coach.prior_vehicle import prior_vehicle
from gcs_sysid.errors import InputError
from gcs_sysid.estimation.online import Fit
from gcs_sysid.estimation.rotor_signals import RotorInput
from gcs_sysid.model.scale_reference import ScaleReference
from gcs_sysid.results.summary import priors_for, values_of
from gcs_sysid.setup_help.checks import can_show


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 where no plan within the limits is enough."""
    if options.json == options.svg == "-":
        raise InputError("--json and --svg cannot both go to standard output: give one a file")
    for path in (options.json, options.svg):
        check_json(path, force=options.force)
    airframe = arguments.airframe_of(options)
    own = airframe.anchor()
    assert own is not None
    wanted = options.rotor_input or airframe.rotor_input
    if wanted == "auto":
        wanted = "command" if own[0] == "T_max" else "speed"
    rotor_input: RotorInput = wanted
    replace(airframe, rotor_input=rotor_input).check_scale_fits()
    anchor = ScaleReference(*own)
    priors = priors_for(airframe.priors, rotor_input)

    def judge(fit: Fit) -> dict[str, float | None]:
        values = values_of(fit, anchor, airframe.arm, priors, rotor_input, cant=airframe.cant)
        return shares(values, airframe.arm, rotor_input)

    known = prior_vehicle(airframe, commands=rotor_input == "command")
    plan = make_plan(airframe.name, known, judge, options.target, limits_of(options))
    deliveries = Deliveries()
    if options.json != "-" and options.svg != "-":
        deliveries.give(lambda: show(plan_text(plan, unicode=can_show("▁▂▃▄▅▆▇█±°"))))
    if options.svg:
        deliveries.give(lambda: _write(options.svg, plan_svg(plan), options))
    if options.json:
        document = json.dumps(plan.as_json(), indent=1) + "\n"
        deliveries.give(lambda: _write(options.json, document, options))
    deliveries.check()
    return 0 if plan.enough else 1


def _write(path: str, text: str, options: argparse.Namespace) -> None:
    if path == "-":
        print_file(text)
    else:
        save(Path(path), text, force=options.force)
