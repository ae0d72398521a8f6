"""The examples of the documentation are run, page by page, in the order of the page.

A page has a folder of its own, in which lie a recording `flight.tlog`, its airframe `my-quad.toml`,
results of it and of its parts, and the folder `logs` of a fleet. `console` blocks are commands with
their output; of what is shown the shape is compared: words, not numbers, and a line `...` stands
for any lines. `python` blocks share one name space, and a `text` block after one is what it
prints. A block that cannot be run says why, in a comment above it. Tutorials begin with nothing.
"""

import contextlib
import io
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest

from gcs_sysid.cli.program import run as gcs_sysid
from sim_bridge.cli import main as sim_bridge

from .pages import PAGES, ROOT, Block, blocks, prose

pytestmark = pytest.mark.slow

_NOT_RUN_YET = {"coach.md"}
"""Pages that may still have commands outside of fences."""
_PROGRAMS = {"gcs-sysid": gcs_sysid, "sim-bridge": sim_bridge}
_NUMBER = re.compile(r"(?<!\w)[-+>]?\d[\d_.,:]*(?:e[-+]?\d+)?")


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """What the pages take as given."""
    folder = tmp_path_factory.mktemp("workshop")
    shutil.copyfile(ROOT / "logs" / "sample.tlog", folder / "flight.tlog")
    paper = ROOT / "src" / "gcs_sysid" / "model" / "airframes" / "paper.toml"
    named = paper.read_text(encoding="utf-8").replace('"paper"', '"my-quad"')
    (folder / "my-quad.toml").write_text(named, encoding="utf-8")
    log, airframe = str(folder / "flight.tlog"), str(folder / "my-quad.toml")
    for name, part in (("result", []), ("before", ["--end", "40"]), ("after", ["--start", "20"])):
        file = str(folder / f"{name}.json")
        with contextlib.redirect_stdout(io.StringIO()):
            assert gcs_sysid(["analyze", log, "--airframe", airframe, "--json", file, *part]) == 0
    vehicle = folder / "logs" / "quad-7"
    vehicle.mkdir(parents=True)
    # A third of the flight: a report of all of it takes seven seconds.
    data = (folder / "flight.tlog").read_bytes()
    for part in (vehicle / "flight.tlog", folder / "logs" / "sample.tlog"):
        part.write_bytes(data[: len(data) // 3])
    shutil.copyfile(airframe, folder / "logs" / "airframe.toml")
    shutil.copyfile(airframe, vehicle / "airframe.toml")
    return folder


def shape(text: str) -> list[str]:
    """Lines without their numbers, spaces and colors."""
    lines = (re.sub(r"\s+", " ", _NUMBER.sub("0", line)).strip() for line in text.splitlines())
    return [line for line in lines if line]


def is_like(got: list[str], wanted: list[str]) -> bool:
    """Whether lines are as wanted, where `...` stands for any."""
    if not wanted:
        return not got
    if wanted[0] == "...":
        return any(is_like(got[i:], wanted[1:]) for i in range(len(got) + 1))
    return bool(got) and got[0] == wanted[0] and is_like(got[1:], wanted[1:])


def run_console(block: Block) -> None:
    """Run the commands of a block here, and compare what they print."""
    assert block.text.startswith("$ "), "a console block begins with a command"
    for command in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:]:
        line, _, wanted = command.partition("\n")
        program, *arguments = shlex.split(line, comments=True)
        program = program.removeprefix(".venv/bin/")
        assert program in _PROGRAMS, f"cannot run {program}"
        shown = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True)
        with contextlib.redirect_stdout(shown), contextlib.redirect_stderr(shown):
            try:
                status = _PROGRAMS[program](arguments)
            except SystemExit as ended:  # as `--help` does
                status = int(ended.code or 0)
        shown.seek(0)
        text = shown.read()
        assert status == 0, f"{line}\n{text}"
        if wanted:
            assert is_like(shape(text), shape(wanted)), f"{line}\n{text}"


def _sources() -> list[Path]:
    return [p for p in PAGES if any(b.language in ("console", "python") for b in blocks(p))]


def _parameters() -> list[Any]:
    """The pages; in `make test-all` alone are the one that flies and analyzes most, and those
    whose commands other tests and other pages run too."""
    long = {"tutorial-emulator", "emulator", "report", "replay", "twin", "batch"}
    marks = pytest.mark.thorough
    return [pytest.param(p, id=p.stem, marks=[marks] * (p.stem in long)) for p in _sources()]


@pytest.mark.parametrize("page", _parameters())
def test_examples_of(page, workshop, tmp_path, monkeypatch):
    if "gcs-sysid batch" in page.read_text(encoding="utf-8"):
        pytest.importorskip("pyarrow")
    folder = tmp_path / "page"
    if page.stem.startswith("tutorial-"):
        folder.mkdir()
    else:
        shutil.copytree(workshop, folder)
        if "--json result.json" in page.read_text(encoding="utf-8"):
            (folder / "result.json").unlink()  # the page makes its own
    monkeypatch.chdir(folder)
    names: dict[str, object] = {"__name__": "__page__"}
    printed: str | None = None
    for block in blocks(page):
        where = f"{page.name}:{block.line}"
        if block.directive == "no-run":
            assert block.reason, f"{where}: why is it not run?"
        elif block.language == "console":
            run_console(block)
        elif block.language == "python":
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                exec(compile(block.text, where, "exec"), names)
            printed = out.getvalue()
            continue
        elif block.language == "text" and printed is not None:
            assert is_like(shape(printed), shape(block.text)), f"{where}\n{printed}"
        printed = None


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_blocks_say_what_they_are(page):
    for block in blocks(page):
        assert block.language, f"{page.name}:{block.line}: a fence without a language"
        assert block.directive in (None, "no-run"), f"{page.name}:{block.line}"
    if page.name in _NOT_RUN_YET:
        return
    # A command outside a fence is one that nobody runs.
    command = re.compile(r"^ {4}(?:\$ )?(?:gcs-sysid|sim-bridge|from |import )", re.MULTILINE)
    assert not command.search(prose(page))
