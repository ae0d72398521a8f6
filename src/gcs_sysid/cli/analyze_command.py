"""`gcs-sysid analyze`: identify from recordings."""

import argparse
import contextlib
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gcs_sysid.cli import airframe_choice, output
from gcs_sysid.cli.health_command import health_text
from gcs_sysid.cli.program import OneByOne
from gcs_sysid.errors import InputError
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.files import check_target
from gcs_sysid.health.whole_analysis import WholeAnalysis, analyze_whole
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_view import result_table
from gcs_sysid.session.analysis import analyze_pair
from gcs_sysid.session.chain import HISTORY_INTERVAL, ChainOptions

if TYPE_CHECKING:
    from gcs_sysid.web.log_report import Reporter


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when a log does not allow an answer."""
    if options.end <= options.start:
        raise InputError(f"--end {options.end:g} must come after --start {options.start:g}")
    relative = options.added_mass is None
    airframe, opened = airframe_choice.of_log(Path(options.logs[0]), options, relative=relative)
    truth = output.read_truth(options.truth) if options.truth else None
    reporter = None
    if options.report is not None:
        reporter = _reporter(options, airframe, truth)
    chain = ChainOptions(
        tuning=_tuning(options.method),
        history_interval=None if reporter is None else HISTORY_INTERVAL,
        start=options.start,
        end=options.end,
        offline=options.offline,
        progress=output.offline_progress(),
    )
    if options.offline and options.method != "forward":
        raise InputError("--offline needs --method forward")
    output.check_outputs(options.json, force=options.force, sources=options.logs)
    show = _PrintedResults(truth, deliveries := output.Deliveries(), on_stdout=options.json != "-")
    results: list[Result] = []
    documents: list[dict[str, Any]] = []
    if options.added_mass is not None:
        results = _pair(options, airframe, chain)
        documents = [result.as_json() for result in results]
        for log, result in zip(options.logs, results, strict=True):
            show.result(log, result)

    one_by_one = OneByOne(options.logs)
    with contextlib.nullcontext(()) if reporter is None else reporter as observers:
        for log in options.logs if not results else ():
            with one_by_one.attempt(log):
                found = analyze_whole(
                    Path(log),
                    airframe,
                    options.vehicle,
                    chain,
                    output.progress_bar(log),
                    observers,
                    opened=opened,
                )
                results.append(found.result)
                documents.append(found.as_json())
                show.result(log, found.result)
                show.health(log, found)
                if reporter is not None:
                    bar = output.progress_bar(f"{log}, telemetry")
                    deliveries.give(functools.partial(reporter.write, found, bar))
            opened = None  # of the first
    deliveries.give_json(documents, options.logs, options.json, force=options.force)
    deliveries.check()
    if one_by_one.failed:
        return 2
    return 1 if any(result.verdict == "refused" for result in results) else 0


def _reporter(
    options: argparse.Namespace, airframe: Airframe, truth: Mapping[str, float] | None
) -> "Reporter":
    """What makes the report that is asked for.

    Raises:
        InputError: it cannot be of this, or not be written there.
    """
    from gcs_sysid.web.log_report import Reporter, ReportJob  # only those who ask wait for it

    if len(options.logs) != 1:
        raise InputError("--report takes one LOG; analyze them one by one")
    if options.report in ("", "-"):
        raise InputError("--report needs a file name, such as flight.html")
    (log,), target = map(Path, options.logs), Path(options.report)
    others = [options.json if options.json != "-" else None, options.truth, options.airframe]
    sources = (log, *(Path(name) for name in others if name))
    check_target(target, replace=options.force, sources=sources)
    return Reporter(
        ReportJob(
            log, target, airframe, options.argv, options.vehicle, truth or {}, options.start,
            options.force,
        )
    )  # fmt: skip


class _PrintedResults:
    """Results as they come: tables on standard output, why not on standard error."""

    def __init__(
        self,
        truth: Mapping[str, float] | None,
        deliveries: output.Deliveries,
        *,
        on_stdout: bool,
    ) -> None:
        self._truth, self._deliveries, self._on_stdout = truth, deliveries, on_stdout

    def result(self, log: str, result: Result) -> None:
        if result.verdict == "refused":
            why = "; ".join(result.reasons)
            output.say(f"gcs-sysid: {log}: cannot identify from this: {why}")
        known = any(e.value is not None and e.status != "given" for e in result.parameters.values())
        if known and self._on_stdout:
            table = result_table(result, self._truth, output.terminal_width())
            self._deliveries.give(lambda: output.show(table))

    def health(self, log: str, found: WholeAnalysis) -> None:
        health = found.health
        if health.contradicted:
            output.say(f"gcs-sysid: {log}: no health: {'; '.join(health.reasons)}")
        elif found.result.verdict == "refused" and health.available and self._on_stdout:
            facts = health_text(health, answered=True)
            self._deliveries.give(lambda: output.show(f"From hover only:\n\n{facts}"))


def _pair(options: argparse.Namespace, airframe: Airframe, chain: ChainOptions) -> list[Result]:
    if len(options.logs) != 2:
        raise InputError("--added-mass needs two logs: the light flight, then the heavy one")
    if airframe_choice.given_scale(options):
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


def _tuning(method: str) -> EstimatorTuning:
    if method == "forward-td":
        return EstimatorTuning(smoother="td")
    if method == "forward-window":
        return EstimatorTuning(smoother="window")
    return EstimatorTuning(method=method)  # type: ignore[arg-type]
