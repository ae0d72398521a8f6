"""`gcs-sysid analyze`: identify from recordings."""

import argparse
import contextlib
import functools
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from gcs_sysid.cli import airframe_choice, output
from gcs_sysid.cli.failures import OneByOne
from gcs_sysid.cli.health_command import health_text
from gcs_sysid.cli.result_table import result_table
from gcs_sysid.errors import InputError
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.health.assessment import HoverRecords, beside_analysis, health_of_log
from gcs_sysid.health.health_file import document_of
from gcs_sysid.health.vehicle_health import Health, HealthOptions
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.results.result import Result
from gcs_sysid.session.analysis import analyze_log, analyze_pair
from gcs_sysid.session.chain_options import ChainOptions
from gcs_sysid.telemetry.logs import Log

_LONG_LOG = 40_000_000
"""Bytes: 9 minutes at 250 Hz, whose hover takes longer to assess than a process to start."""
_HoverTask = tuple[Path, HealthOptions, tuple[int, int | None] | None, tuple[float, float]]


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when a log does not allow an answer."""
    if options.end <= options.start:
        raise InputError(f"--end {options.end:g} must come after --start {options.start:g}")
    airframe = airframe_choice.of_log(Path(options.logs[0]), options)
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
        progress=output.offline_progress(),
    )
    if options.offline and options.method != "forward":
        raise InputError("--offline needs --method forward")
    output.check_json(options.json, force=options.force)
    results: list[Result] = []
    healths: list[Health | None] = []
    deliveries = output.Deliveries()
    if options.added_mass is not None:
        results = _pair(options, airframe, chain)
        for log, result in zip(options.logs, results, strict=True):
            _print(log, result, truth, deliveries, table=options.json != "-")
    one_by_one = OneByOne(options.logs)
    for log in options.logs if not results else ():
        hover = _hover_of(log, options, airframe)
        with (
            one_by_one.attempt(log),
            hover,
            contextlib.nullcontext() if reporter is None else reporter as observer,
        ):
            result = analyze_log(
                Path(log),
                airframe,
                options.vehicle,
                chain,
                output.progress_bar(log),
                observer=observer,
                keeper=hover.keeper,
                opened=hover.opened,
            )
            health = hover.health(result)
            results.append(result)
            healths.append(health)
            _print(log, result, truth, deliveries, table=options.json != "-")
            if health is not None and health.contradicted:
                output.say(f"gcs-sysid: {log}: no health: {'; '.join(health.reasons)}")
            elif result.verdict == "refused" and health is not None and options.json != "-":
                print(f"From hover only:\n\n{health_text(health)}")
            if reporter is not None:
                document = None if health is None else document_of(health)
                deliveries.give(functools.partial(reporter.write, result, document))
    if results:
        documents = [result.as_json() for result in results]
        for known, health in zip(documents, healths, strict=False):
            if health is not None:
                known["health"] = document_of(health)
        content = documents[0] if len(options.logs) == 1 else documents
        deliveries.give(lambda: output.write_json(options.json, content, force=options.force))
    deliveries.check()
    if one_by_one.failed:
        return 2
    return 1 if any(result.verdict == "refused" for result in results) else 0


class _Hover:
    """What hover shows, from the records that the analysis reads.

    Args:
        log: as the user named it.
        task: as of `health_of_log`: log, what is given, vehicle, span.

    Attributes:
        keeper: as of `analyze_log`.
        opened: likewise.
    """

    def __init__(self, log: str, task: _HoverTask) -> None:
        self._log, self._task = log, task
        self.keeper: HoverRecords | None = HoverRecords()
        self.opened: Log | None = None

    def __enter__(self) -> "_Hover":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def health(self, result: Result) -> Health | None:
        """None where nothing hovers, unless the motion contradicts the airframe.

        Args:
            result: of the analysis.
        """
        found = replace(self._assessed(), source=self._log)
        health = beside_analysis(found, result)
        return health if health.reported else None

    def _assessed(self) -> Health:
        assert self.keeper is not None
        _, given, _, span = self._task
        return self.keeper.health(self._log, given, span)


class _HoverBeside(_Hover):
    """The same by another process, which reads the log for both; the numbers are the same.

    Raises:
        OSError: no process can be started.
    """

    def __init__(self, log: str, task: _HoverTask) -> None:
        from gcs_sysid.health.reader_process import ReaderProcess  # only long logs wait for it

        super().__init__(log, task)
        path, given, wanted, span = task
        self._reader = ReaderProcess(path, wanted, given, span)
        self.keeper, self.opened = None, self._reader.log

    def __exit__(self, *_: object) -> None:
        self._reader.close()

    def _assessed(self) -> Health:
        """As of `_Hover`; here, where the other process was ended."""
        found = self._reader.health()
        return health_of_log(*self._task) if found is None else found


def _hover_of(log: str, options: argparse.Namespace, airframe: Airframe) -> _Hover:
    """Beside the analysis where the log is long and a processor free."""
    task = Path(log), HealthOptions(airframe), options.vehicle, (options.start, options.end)
    try:
        if _processors() > 1 and Path(log).stat().st_size >= _LONG_LOG:
            return _HoverBeside(log, task)
    except OSError:  # a table and its mapping, what the analysis will complain of, or no process
        pass
    return _Hover(log, task)


def _processors() -> int:
    """Of this machine, that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


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


def _print(
    log: str,
    result: Result,
    truth: Mapping[str, float] | None,
    deliveries: output.Deliveries,
    *,
    table: bool,
) -> None:
    if result.verdict == "refused":
        why = "; ".join(result.reasons)
        output.say(f"gcs-sysid: {log}: cannot identify from this: {why}")
    known = any(e.value is not None and e.status != "given" for e in result.parameters.values())
    if table and known:
        deliveries.give(lambda: output.show(result_table(result, truth, output.terminal_width())))


def _tuning(method: str) -> EstimatorTuning:
    if method == "forward-td":
        return EstimatorTuning(smoother="td")
    if method == "forward-window":
        return EstimatorTuning(smoother="window")
    return EstimatorTuning(method=method)  # type: ignore[arg-type]
