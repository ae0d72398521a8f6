"""What is done with a log for a page: `python -m gcs_sysid.web.log_worker`, a process of its own.

A job comes as one line of JSON on standard input, progress and the end go as lines of JSON to
standard output. When standard input closes the process ends at once, so that none outlives the
page that wanted it or the server.
"""

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from gcs_sysid.errors import GcsSysidError
from gcs_sysid.health.assessment import HoverRecords
from gcs_sysid.health.health_file import document_of
from gcs_sysid.health.vehicle_health import HealthOptions
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.processes import end_after
from gcs_sysid.results.health_view import short_facts
from gcs_sysid.session.reported_layout import proposal, suggested_airframe
from gcs_sysid.strict_json import json_text
from gcs_sysid.telemetry.logs import open_log
from gcs_sysid.web.log_request import parse_request

OnProgress = Callable[[str, float], None]


def look(log: Path, on_progress: OnProgress) -> dict[str, Any]:
    """Whether all is right; who flew, for how long; the layout by the log, else one to try.

    Raises:
        InputError: the log cannot be read.
    """
    opened, keeper = open_log(log), HoverRecords()
    keeper.begin(opened)
    first, last = float("inf"), float("-inf")
    for block in opened.blocks():
        on_progress("reading", opened.share_read)
        keeper.add_records(block)
        for track in block.tracks:
            if len(track.t):
                first, last = min(first, float(track.t[0])), max(last, float(track.t[-1]))
    vehicle = opened.vehicle
    layout = keeper.layout()
    health = document_of(keeper.health(str(log), HealthOptions()))
    return {
        "answer": health["summary"],
        "facts": short_facts(health) if health["cg"] else [],
        "vehicle": None if vehicle is None else str(vehicle),
        "duration": max(last - first, 0.0) if last > first else 0.0,
        "airframe": None
        if layout is None
        else {
            "rotors": Airframe("log", layout.rotors).as_json()["rotors"],
            "arm": Airframe("log", layout.rotors).arm if layout.sized else None,
            "by": layout.by,
            "words": proposal(layout),
        },
        "suggestion": None if layout else suggested_airframe(opened.kind, vehicle),
    }


class Progress:
    """Says how far the work is, as often as there is something to see."""

    def __init__(self) -> None:
        self._stage, self._share = "", 0.0

    def show(self, stage: str, share: float) -> None:
        """Say it, if it has changed."""
        if stage != self._stage or abs(share - self._share) >= 0.01:
            self._stage, self._share = stage, share
            _say({"progress": round(min(share, 1.0), 3), "stage": stage})


def run(job: Mapping[str, Any], on_progress: OnProgress) -> Any:
    """Do a job.

    Raises:
        InputError: it cannot be done, or takes too much.
    """
    log = Path(job["log"])
    if job["do"] == "look":
        return look(log, on_progress)
    from gcs_sysid.web import log_analysis  # looking does not wait for it

    folder = Path(job["folder"])
    with log_analysis.limited():
        request = parse_request(job["request"])
        return log_analysis.analyze(log, job["name"], request, folder, on_progress)


def main() -> int:
    """Do the job on standard input; 2 where it cannot be done."""
    line = sys.stdin.readline()
    end_after(sys.stdin.read)
    job = json.loads(line)
    try:
        _say({"done": run(job, Progress().show)})
    except (GcsSysidError, OSError) as error:
        # Paths on this machine are not disclosed.
        text = str(error).replace(str(job["log"]), str(job.get("name", "the log")))
        _say({"error": text})
        return 2
    return 0


def _say(document: Mapping[str, Any]) -> None:
    print(json_text(document), flush=True)


if __name__ == "__main__":
    sys.exit(main())
