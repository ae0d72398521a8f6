"""One report of a short flight, made as a user makes it."""

import contextlib
import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from gcs_sysid.cli.program import run

from .reading import Page


@dataclass
class Report:
    path: Path
    result: dict[str, Any]

    @property
    def page(self) -> Page:
        return Page(self.path.read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def report(paper_flight, tmp_path_factory) -> Report:
    """The report of the paper's flight with the truth beside it, made once for all workers."""
    kept = paper_flight.tlog.parent / "report"
    folder = kept if kept.exists() else tmp_path_factory.mktemp("report")
    html, result = folder / "flight.html", folder / "result.json"
    if folder == kept:
        return Report(html, json.loads(result.read_text()))
    status = run(
        [
            *("analyze", str(paper_flight.tlog), "--airframe", "paper"),
            *("--truth", str(paper_flight.truth_file)),
            *("--report", str(html), "--json", str(result)),
        ]
    )
    assert status == 0
    shutil.copytree(folder, folder.with_name("whole"))
    with contextlib.suppress(OSError):  # another worker was first
        folder.with_name("whole").rename(kept)
    return Report(html, json.loads(result.read_text()))
