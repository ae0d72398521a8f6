"""`gcs-sysid batch`: identify from many logs."""

import argparse
import functools
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from gcs_sysid.cli.airframe_choice import airframe_of, given_of, given_scale, is_auto
from gcs_sysid.cli.output import Deliveries, on_signals, say
from gcs_sysid.errors import InputError, needed
from gcs_sysid.fleet import batch as table
from gcs_sysid.fleet.batch import (
    AIRFRAME_FILE,
    BatchRun,
    BatchTally,
    Store,
    find_logs,
    nearest_airframe,
)
from gcs_sysid.fleet.jobs import ClusterPool, Job, LocalPool, LogLimits, Pool, analyze_within
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.telemetry.log_formats import usual_endings


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 when no log allows an answer, 2 when none can be read."""
    needed("pyarrow.parquet", "the fleet's table")
    logs = find_logs(map(Path, options.logs), None if options.csv is None else Path(options.csv))
    if not logs:
        raise InputError(f"{', '.join(options.logs)}: contains no {usual_endings(' or ')} file")
    airframes = _airframes(options, logs)
    given = tuple(given_of(options))
    jobs = [Job(log, airframes[log], options.vehicle, options.offline, given) for log in logs]
    store = Store(Path(options.output), force=options.force)
    stop = threading.Event()
    work = functools.partial(analyze_within, LogLimits(options.log_timeout, options.log_memory))
    pool: Pool
    if options.scheduler is not None:
        pool = ClusterPool(options.scheduler, work)
    else:
        pool = LocalPool(min(options.workers or os.cpu_count() or 1, len(jobs)), work)
    batch = BatchRun(jobs, store, pool, _shower(), stop.is_set)
    rows = batch.tally.rows
    deliveries = Deliveries()
    with on_signals(stop.set):
        try:
            deliveries.give(batch.run)
        finally:
            pool.close()
        written = deliveries.give(lambda: table.write_table(store.table, rows))
    where = f": {store.table}" if written else ""
    say(f"gcs-sysid: {_summary(batch.tally)}{where}")
    deliveries.check()
    if len(rows) < len(jobs):
        print(
            f"gcs-sysid: interrupted; run the same command again for the other "
            f"{len(jobs) - len(rows)}",
            file=sys.stderr,
        )
        return 130  # as after Ctrl-C
    verdicts = batch.tally.verdicts
    if verdicts["identified"] or verdicts["partial"] or any(row["hover"] for row in rows):
        return 0
    return 1 if verdicts["refused"] else 2


def _airframes(options: argparse.Namespace, logs: list[Path]) -> dict[Path, Airframe | None]:
    """Every log's airframe: the one given, or that of the nearest airframe.toml; None: its own."""
    files = {log: None if is_auto(options) else options.airframe for log in logs}
    if options.airframe is None:
        files = {log: nearest_airframe(log) for log in logs}
    missing = [log for log, file in files.items() if file is None]
    if missing and given_scale(options) is None:
        more = f" (and for {len(missing) - 1} others)" if len(missing) > 1 else ""
        raise InputError(
            f"no airframe for {missing[0]}{more}: give --mass KG and --arm M for the layout that "
            f"each log shows, --airframe for all, or put an {AIRFRAME_FILE} beside the logs or in "
            "a folder above"
        )
    known: dict[object, Airframe | None] = {None: None}
    for file in dict.fromkeys(file for file in files.values() if file is not None):
        single = argparse.Namespace(**{**vars(options), "airframe": str(file)})
        try:
            known[file] = airframe_of(single)
        except InputError as error:
            prefix = "" if options.airframe or str(file) in str(error) else f"{file}: "
            raise InputError(f"{prefix}{error}") from error
    return {log: known[file] for log, file in files.items()}


def _summary(tally: BatchTally) -> str:
    counts = [f"{count} {word}" for word, count in tally.verdicts.items() if count]
    hovers = sum(bool(row["hover"]) for row in tally.rows if row["verdict"] == "refused")
    if hovers:
        counts.append(f"{hovers} of these with CG and rotor loads from hover")
    kept = f" ({tally.kept} done before)" if tally.kept else ""
    return f"{len(tally.rows)} of {tally.total} logs{kept}: {', '.join(counts) or 'none done'}"


def _shower() -> Callable[[table.Row, BatchTally], None]:
    """Reports failures as they come and, on a terminal, progress."""
    start, terminal = time.monotonic(), sys.stderr.isatty()

    def show(row: table.Row, tally: BatchTally) -> None:
        # Blanks, not an escape sequence: older consoles of Windows print those.
        clear = f"\r{' ' * (shutil.get_terminal_size().columns - 1)}\r" if terminal else ""
        if row["verdict"] is None:
            where = "" if row["path"] in row["error"] else f"{row['path']}: "
            print(f"{clear}gcs-sysid: {where}{row['error']}", file=sys.stderr)
        if terminal:
            left = _left(time.monotonic() - start, tally)
            print(f"{clear}{_summary(tally)}{left}", end="", file=sys.stderr, flush=True)
            if len(tally.rows) == tally.total:
                print(clear, end="", file=sys.stderr)

    return show


def _left(seconds: float, tally: BatchTally) -> str:
    done = len(tally.rows) - tally.kept
    if not done:
        return ""
    left = seconds / done * (tally.total - len(tally.rows))
    return f", about {left / 60.0:.0f} min left" if left >= 90.0 else f", about {left:.0f} s left"
