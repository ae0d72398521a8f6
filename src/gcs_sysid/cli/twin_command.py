"""`gcs-sysid twin`: does the identified model fly like the vehicle?"""

import argparse
from pathlib import Path

from gcs_sysid.cli import airframe_choice, output
from gcs_sysid.errors import InputError, NoAnswerError
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.report.evidence_sections import twin_svg
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_file import read_result
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.twin.held_out_flight import fly_held_out
from gcs_sysid.twin.twin_flight import twin_table


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when result or log do not allow an answer."""
    log = Path(options.log)
    output.check_outputs(
        options.json, options.picture, force=options.force, sources=[options.result, options.log]
    )
    airframe = _airframe(options, log)
    try:
        result = _result(options, airframe)
        bar = output.progress_bar(str(log))
        twin = fly_held_out(result, log, airframe, options.vehicle, bar, options.seed)
    except NoAnswerError as error:
        output.say(f"gcs-sysid: {error}")
        return 1
    output.deliver(
        twin_table(twin),
        (options.json, lambda: output.as_json(twin.as_json())),
        (options.picture, lambda: twin_svg(twin)),
        force=options.force,
    )
    return 0


def _airframe(options: argparse.Namespace, log: Path) -> Airframe | None:
    """What is given of the vehicle; None: taken from the result."""
    if options.airframe is not None:
        return airframe_choice.of_log(log, options)[0]
    if options.prior or options.arm is not None or airframe_choice.given_scale(options):
        raise InputError("--arm, --mass, --k-t, --t-max and --prior need --airframe")
    return None


def _result(options: argparse.Namespace, airframe: Airframe | None) -> Result:
    """The result, read or analyzed."""
    path = Path(options.result)
    if path.suffix.lower() == ".json":
        return read_result(path)
    if airframe is None:
        if Path(options.log).suffix.lower() == ".json":
            raise InputError(f"the result comes first: gcs-sysid twin {options.log} {path}")
        raise InputError(
            f"{path}: a log as RESULT needs --airframe, or write its result first: "
            f"gcs-sysid analyze {path} --json result.json"
        )
    result = analyze_log(path, airframe, options.vehicle)
    if result.verdict == "refused":
        raise NoAnswerError(f"{path}: cannot identify from this: {'; '.join(result.reasons)}")
    return result
