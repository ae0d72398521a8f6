"""One report of a short flight, made as a user makes it."""

import json
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
def report(paper_flight, once) -> Report:
    """The report of the paper's flight with the truth beside it."""

    def make(folder: Path) -> None:
        files = ("--report", str(folder / "flight.html"), "--json", str(folder / "result.json"))
        words = (str(paper_flight.tlog), "--airframe", "paper")
        assert run(["analyze", *words, "--truth", str(paper_flight.truth_file), *files]) == 0

    folder = once("report", make)
    return Report(folder / "flight.html", json.loads((folder / "result.json").read_text()))
