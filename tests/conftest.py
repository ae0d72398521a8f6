"""What several test folders share: emulated flights, each flown once, and onboard logs."""

import contextlib
import gc
import hashlib
import io
import json
import os
import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import hypothesis
import pytest

from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.results.result import Result
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.signals.records import Record
from gcs_sysid.telemetry.intake import Intake
from gcs_sysid.telemetry.tlog import TlogReader
from sim_bridge.cli import main as sim_bridge
from testbed.recordings import in_sequence

# The same examples in every run. Not all that is drawn must hold: of one damaged frame in 65 536
# the CRC is right by chance.
hypothesis.settings.register_profile("seeded", derandomize=True, database=None, deadline=None)
hypothesis.settings.load_profile("seeded")

AS_THE_ARTICLE = ("--mission", "paper", "--noise", "paper", "--sigma", "0.02", "--rate", "20")


@pytest.hookimpl(optionalhook=True)  # tools/mutate.py runs tests without xdist
def pytest_xdist_auto_num_workers() -> int:
    """One worker more than cores: a fifth of the time tests wait for links and processes."""
    return (os.cpu_count() or 1) + 1


def pytest_collectstart() -> None:
    gc.disable()


def pytest_collection_finish() -> None:
    """What is collected is there to the end, and is not looked through for garbage."""
    gc.freeze()
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests come first, so that no worker is left alone with one at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


ASKED = {"capsys", "capfd", "capsysbinary", "capfdbinary", "caplog"}
"""Fixtures of a test that asks for what is printed or logged."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A test fails of what it printed or logged, or what a process it started did, unasked."""
    report = yield
    stray = [f"{name}:\n{text}" for name, text in report.sections if name.endswith(" call")]
    asked = ASKED & set(getattr(item, "fixturenames", ()))
    if report.when == "call" and report.passed and stray and not asked:
        report.outcome = "failed"
        report.longrepr = "\n".join(["output that the test did not ask for", *stray])
    return report


@dataclass(frozen=True)
class Flight:
    """A recording of the emulator, and what is true of its vehicle."""

    tlog: Path
    truth_file: Path

    @property
    def truth(self) -> dict[str, float]:
        table: dict[str, float] = json.loads(self.truth_file.read_text())
        return table

    def records(self) -> list[Record]:
        """What the recording's frames say, as the chain takes it."""
        return in_sequence(Intake().frames(frame for _, frame in TlogReader(self.tlog)))


@pytest.fixture(scope="session")
def shared_logs() -> Path:
    """Recorded flights of real autopilots, where they lie beside the project."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "logs"
    if not folder.is_dir():
        pytest.skip("no ../shared/logs beside the project")
    return folder


@pytest.fixture(scope="session")
def shared_log(shared_logs: Path) -> Callable[[str], Path]:
    """One of them by its name; not all lie everywhere."""

    def found(name: str) -> Path:
        log = shared_logs / name
        if not log.exists():
            pytest.skip(f"{name} is not beside the project")
        return log

    return found


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A Chromium: the machine's own, or playwright's."""
    api = pytest.importorskip("playwright.sync_api")
    names = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
    found = next(filter(None, map(shutil.which, names)), None)
    with api.sync_playwright() as playwright:
        try:
            browser = playwright.chromium.launch(executable_path=found)
        except api.Error as error:
            pytest.skip(f"no browser here: {str(error).splitlines()[0]}")
        yield browser
        browser.close()


Make = Callable[[Path], None]
OnceFunction = Callable[[str, Make], Path]


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> OnceFunction:
    """A folder by its name, filled once for all workers: who comes while one fills it waits."""
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "shared"
    shared.mkdir(exist_ok=True)

    def once(name: str, make: Make) -> Path:
        folder = shared / name
        if not folder.exists():
            # Whoever ends lets go of it, however it ends.
            lock = sqlite3.connect(f"{folder}.lock", timeout=600.0, isolation_level=None)
            with contextlib.closing(lock):
                lock.execute("BEGIN EXCLUSIVE")
                if not folder.exists():
                    new = Path(tempfile.mkdtemp(dir=shared))
                    make(new)
                    new.rename(folder)
        return folder

    return once


FlyFunction = Callable[..., Flight]


@pytest.fixture(scope="session")
def fly(once: OnceFunction) -> FlyFunction:
    """Flies the emulator, without the second that a process of its own would take to start;
    options as on its command line. Tests share the recordings, and change none."""

    def fly(*options: str) -> Flight:
        def make(folder: Path) -> None:
            files = [f"--tlog={folder / 'flight.tlog'}", f"--truth={folder / 'truth.json'}"]
            said = io.StringIO()
            with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
                status = sim_bridge(["--airframe", "paper", *options, "--speed", "max", *files])
            assert status == 0, said.getvalue()

        folder = once(hashlib.sha256("\0".join(options).encode()).hexdigest()[:32], make)
        return Flight(folder / "flight.tlog", folder / "truth.json")

    return fly


@pytest.fixture(scope="session")
def paper_flight(fly: FlyFunction) -> Flight:
    """The article's three modes with its noise at 20 Hz, seed 1."""
    return fly(*AS_THE_ARTICLE, "--seed", "1")


@pytest.fixture(scope="session")
def paper_records(paper_flight: Flight) -> list[Record]:
    """Its records."""
    return paper_flight.records()


@pytest.fixture(scope="session")
def paper_result(paper_flight: Flight) -> Result:
    """Its analysis, which many tests look at."""
    return analyze_log(paper_flight.tlog, load_airframe("paper"))


class UlogFile:
    """A PX4 log, put together entry by entry."""

    SUFFIX = ".ulg"

    SIZES = {  # noqa: RUF012
        "uint64_t": "Q", "uint32_t": "I", "uint8_t": "B", "int8_t": "b", "int32_t": "i",
        "float": "f", "bool": "?", "uint16_t": "H",
    }  # fmt: skip

    def __init__(self, start_us=1_000_000):
        self.data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", start_us)
        self._definitions = b""
        self._rows = b""
        self._topics = {}
        self._nested = {}

    @staticmethod
    def _entry(kind, content):
        return struct.pack("<HB", len(content), ord(kind)) + content

    def parameter(self, name, value, t=None):
        kind = "int32_t" if isinstance(value, int) else "float"
        key = f"{kind} {name}".encode()
        entry = self._entry(
            "P", bytes([len(key)]) + key + struct.pack("<" + self.SIZES[kind], value)
        )
        if t is None:
            self._definitions += entry
        else:
            self._rows += entry

    def _layout(self, fields):
        codes = ""
        for field in fields:
            kind, _, count = field.split()[0].rstrip("]").partition("[")
            inner = self._nested.get(kind)
            codes += inner * int(count or 1) if inner else f"{count}{self.SIZES[kind]}"
        return codes

    def nested(self, name, fields):
        """A type that topics may use as a field."""
        self._nested[name] = self._layout(fields)
        self._definitions += self._entry("F", f"{name}:{';'.join(fields)};".encode())

    def topic(self, name, fields, multi_id=0):
        """Fields as "type name" or "type[4] name"; a timestamp comes first by itself."""
        fields = ["uint64_t timestamp", *fields]
        if name not in [known for known, _ in self._topics]:
            text = f"{name}:{';'.join(fields)};"
            self._definitions += self._entry("F", text.encode())
        number = len(self._topics)
        self._topics[name, multi_id] = number, struct.Struct("<" + self._layout(fields))
        self._rows += self._entry("A", struct.pack("<BH", multi_id, number) + name.encode())

    def row(self, name, t, *values, multi_id=0):
        number, layout = self._topics[name, multi_id]
        content = struct.pack("<H", number) + layout.pack(round(t * 1e6), *values)
        self._rows += self._entry("D", content)

    def dropout(self, milliseconds):
        self._rows += self._entry("O", struct.pack("<H", milliseconds))

    def bytes(self):
        return self.data + self._definitions + self._rows


class DataflashFile:
    """An ArduPilot log, put together entry by entry."""

    SUFFIX = ".bin"

    CODES = {  # noqa: RUF012
        "Q": "Q", "B": "B", "f": "f", "H": "H", "h": "h", "c": "h", "C": "H", "I": "I",
        "N": "16s", "Z": "64s", "M": "B", "e": "i", "b": "b",
    }  # fmt: skip

    def __init__(self):
        self.data = b""
        self._types = {}
        self.type("FMT", "BBnNZ", "Type,Length,Name,Format,Columns", number=128, size=89)

    def type(self, name, letters, columns, number=None, size=None):
        number = number or len(self._types) + 1
        if size is None:
            layout = struct.Struct("<" + "".join(self.CODES[c] for c in letters))
            size = layout.size + 3
            self._types[name] = number, layout
        self.data += b"\xa3\x95\x80" + struct.pack(
            "<BB4s16s64s", number, size, name.encode(), letters.encode(), columns.encode()
        )

    def row(self, name, *values):
        number, layout = self._types[name]
        values = [v.encode() if isinstance(v, str) else v for v in values]
        self.data += b"\xa3\x95" + bytes([number]) + layout.pack(*values)

    def bytes(self):
        return self.data


@pytest.fixture
def ulog_file():
    return UlogFile()


@pytest.fixture
def dataflash_file():
    return DataflashFile()


@pytest.fixture(scope="session")
def state_homes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Folders of which none is there yet: pytest's own would look through all for each new one."""
    base = tmp_path_factory.mktemp("states")
    return (base / str(number) for number in count())


@pytest.fixture(autouse=True)
def state_home(state_homes: Iterator[Path], monkeypatch: pytest.MonkeyPatch) -> Path:
    """What sessions keep for the next one: of this test alone."""
    folder = next(state_homes)
    folder.mkdir()
    for name in ("XDG_STATE_HOME", "LOCALAPPDATA"):
        monkeypatch.setenv(name, str(folder))
    return folder


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path
