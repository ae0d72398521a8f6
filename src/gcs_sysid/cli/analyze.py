"""`gcs-sysid analyze`: identify from recordings."""

import argparse
import json
import sys
from pathlib import Path

from gcs_sysid.cli import arguments, output
from gcs_sysid.errors import InputError
from gcs_sysid.estimation.online import Tuning
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import ChainOptions
from gcs_sysid.session.result import Result


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when a log does not allow an answer."""
    if options.end <= options.start:
        raise InputError(f"--end {options.end:g} must come after --start {options.start:g}")
    airframe = arguments.airframe_of(options)
    truth = output.read_truth(options.truth) if options.truth else None
    chain = ChainOptions(
        tuning=_tuning(options.method),
        course_interval=None,
        start=options.start,
        end=options.end,
    )
    results: list[Result] = []
    for log in options.logs:
        result = analyze_log(Path(log), airframe, options.vehicle, chain, output.progress_bar(log))
        results.append(result)
        if result.verdict == "refused":
            why = "; ".join(result.reasons)
            print(f"gcs-sysid: {log}: cannot identify from this: {why}", file=sys.stderr)
        if options.json != "-" and any(
            e.value is not None and e.status != "given" for e in result.parameters.values()
        ):
            print(output.result_table(result, truth))
    if options.json:
        documents = [result.as_json() for result in results]
        text = json.dumps(
            documents[0] if len(documents) == 1 else documents, indent=2, allow_nan=False
        )
        if options.json == "-":
            print(text)
        else:
            with output.open_output(options.json) as file:
                print(text, file=file)
    return 1 if any(result.verdict == "refused" for result in results) else 0


def _tuning(method: str) -> Tuning:
    if method == "forward-td":
        return Tuning(smoother="td")
    return Tuning(method=method)  # type: ignore[arg-type]
