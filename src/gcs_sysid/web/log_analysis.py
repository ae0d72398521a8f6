"""A log's analysis for a page: files in a folder."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from gcs_sysid.argument_types import given_words, with_given
from gcs_sysid.errors import InputError
from gcs_sysid.fleet.jobs import MEGABYTE, LogLimits, OverTime, within
from gcs_sysid.health.assessment import ReadLog
from gcs_sysid.health.health_file import document_of
from gcs_sysid.health.whole_analysis import analyze_whole
from gcs_sysid.model.airframe import Airframe, load_airframe
from gcs_sysid.report.page import health_picture
from gcs_sysid.session.chain import HISTORY_INTERVAL, ChainOptions
from gcs_sysid.session.reported_layout import airframe_of_layout
from gcs_sysid.strict_json import json_text
from gcs_sysid.web.log_report import Reporter, ReportJob
from gcs_sysid.web.log_request import PICTURE, REPORT, RESULT, AnalysisRequest

OnProgress = Callable[[str, float], None]


@contextlib.contextmanager
def limited() -> Iterator[None]:
    """Give up what takes too much time or memory.

    Raises:
        InputError: it does.
    """
    limits = LogLimits()
    try:
        with within(limits):
            yield
    except OverTime:
        raise InputError(f"not done after {limits.seconds:g} s") from None
    except MemoryError:
        most = 1e-9 * limits.megabytes * MEGABYTE
        raise InputError(f"needs more than {most:g} GB of memory") from None


def analyze(
    log: Path, name: str, request: AnalysisRequest, folder: Path, on_progress: OnProgress
) -> Any:
    """Identify, and leave result, report and health picture in a folder.

    `on_progress` is called with the step and the share of the work done.

    Raises:
        InputError: the log cannot be read, or the request makes no sense.
    """
    airframe = airframe_of(request, log)
    reporter = Reporter(ReportJob(log, folder / REPORT, airframe, _command(request, name)))
    with reporter as observers:
        found = analyze_whole(
            log,
            airframe,
            options=ChainOptions(history_interval=HISTORY_INTERVAL),
            progress=lambda share: on_progress("identifying", 0.6 * share),
            observers=observers,
            name=name,
        ).named(name)
        reporter.write(found, lambda share: on_progress("writing the report", 0.6 + 0.3 * share))
    if found.health.available:
        picture = health_picture(document_of(found.health))
        (folder / PICTURE).write_text(picture, encoding="utf-8")
    (folder / RESULT).write_text(json_text(found.as_json(), 2) + "\n", encoding="utf-8")
    return {
        "verdict": found.result.verdict,
        "reasons": list(found.result.reasons),
        "health": found.health.available,
    }


def airframe_of(request: AnalysisRequest, log: Path) -> Airframe:
    """The airframe with its scale, as a page asks for it.

    Raises:
        InputError: the log has no layout, or something given makes no sense.
    """
    if request.kind == "log":
        airframe = _reported_airframe(log, request.arm)
    elif request.kind == "builtin":
        airframe = load_airframe(request.name)
    elif request.kind == "file":
        path = log.with_suffix(".airframe.toml")
        try:
            path.write_text(request.text, encoding="utf-8")
            airframe = load_airframe(str(path))
        except InputError as error:
            raise InputError(str(error).replace(str(path), request.name)) from None
        finally:
            path.unlink(missing_ok=True)
    else:
        assert request.drawn is not None
        airframe = request.drawn
    if request.arm is not None:
        airframe = with_given(airframe, "arm", request.arm, "arm")
    if request.scale is not None:
        name, value = request.scale
        airframe = with_given(airframe, name, value, name)
    if airframe.anchor() is None:
        raise InputError("nothing sets the scale: weigh the vehicle and enter its mass")
    airframe.check_scale_fits()
    return airframe


def _reported_airframe(log: Path, arm: float | None) -> Airframe:
    layout = ReadLog(log).layout()
    if layout is None:
        raise InputError("the log does not hold the vehicle's layout: choose or draw the airframe")
    if arm is None and not layout.sized:
        raise InputError(
            f"the log gives the layout ({layout.by}) but no lengths: enter the arm, from the "
            "center to each motor"
        )
    return airframe_of_layout(layout, arm)


def _command(request: AnalysisRequest, name: str) -> tuple[str, ...]:
    """The command line that makes the same report."""
    airframe = {"log": "auto", "builtin": request.name, "file": request.name}.get(
        request.kind, "my-airframe.toml"
    )
    words = ["gcs-sysid", "analyze", name, "--airframe", airframe]
    if request.arm is not None:
        words += given_words("arm", request.arm)
    if request.scale is not None:
        words += given_words(*request.scale)
    return (*words, "--report", f"{Path(name).stem}.html")
