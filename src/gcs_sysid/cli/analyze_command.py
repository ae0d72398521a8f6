"""`gcs-sysid analyze`: identify from recordings."""

import argparse
import contextlib
import sys
from collections.abc import Mapping
from pathlib import Path

from gcs_sysid.cli import arguments, output
from gcs_sysid.cli.result_table import result_table
from gcs_sysid.errors import InputError
from gcs_sysid.estimation.tuning import Tuning
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.results.result import Result
from gcs_sysid.session.analysis import analyze_log, analyze_pair
from gcs_sysid.session.chain import ChainOptions


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when a log does not allow an answer."""
    if options.end <= options.start:
        raise InputError(f"--end {options.end:g} must come after --start {options.start:g}")
    airframe = arguments.airframe_of(options)
    truth = output.read_truth(options.truth) if options.truth else None
    reporter = None
    if options.report is not None:
        from gcs_sysid.cli.reporting import Reporter  # only those who ask wait for it

        reporter = Reporter(options, airframe, truth)
    chain = ChainOptions(
        tuning=_tuning(options.method),
        history_interval=None if reporter is None else reporter.history_interval,
        start=options.start,
        end=options.end,
        offline=options.offline,
    )
    if options.offline and options.method != "forward":
        raise InputError("--offline needs --method forward")
    output.check_json(options.json, force=options.force)
    results: list[Result] = []
    unreadable = 0
    if options.added_mass is not None:
        results = _pair(options, airframe, chain)
        for log, result in zip(options.logs, results, strict=True):
            _print(log, result, truth, table=options.json != "-")
    for log in options.logs if not results else ():
        bar = output.progress_bar(log)
        with contextlib.nullcontext() if reporter is None else reporter as observer:
            try:
                result = analyze_log(
                    Path(log), airframe, options.vehicle, chain, bar, observer=observer
                )
            except InputError as error:
                # The others may still be good.
                print(f"gcs-sysid: error: {error}", file=sys.stderr)
                unreadable += 1
                continue
            results.append(result)
            if reporter is not None:
                reporter.write(result)
            # Last: whoever reads it may go away.
            _print(log, result, truth, table=options.json != "-")
    if results:
        documents = [result.as_json() for result in results]
        document = documents[0] if len(options.logs) == 1 else documents
        output.write_json(options.json, document, force=options.force)
    if unreadable:
        return 2
    return 1 if any(result.verdict == "refused" for result in results) else 0


def _pair(options: argparse.Namespace, airframe: Airframe, chain: ChainOptions) -> list[Result]:
    if len(options.logs) != 2:
        raise InputError("--added-mass needs two logs: the light flight, then the heavy one")
    if any(value is not None for value in (options.mass, options.k_t, options.t_max)):
        raise InputError("--added-mass sets the scale; give no --mass, --k-t or --t-max with it")
    light, heavy = map(Path, options.logs)
    return analyze_pair(
        (light, heavy),
        options.added_mass,
        airframe,
        options.vehicle,
        chain,
        output.progress_bar("two flights"),
    )


def _print(log: str, result: Result, truth: Mapping[str, float] | None, *, table: bool) -> None:
    if result.verdict == "refused":
        why = "; ".join(result.reasons)
        print(f"gcs-sysid: {log}: cannot identify from this: {why}", file=sys.stderr)
    known = any(e.value is not None and e.status != "given" for e in result.parameters.values())
    if table and known:
        print(result_table(result, truth, output.terminal_width()))


def _tuning(method: str) -> Tuning:
    if method == "forward-td":
        return Tuning(smoother="td")
    if method == "forward-whitened":
        return Tuning(smoother="whitened")
    return Tuning(method=method)  # type: ignore[arg-type]
