"""What studies share: their command line, worker processes, processor time, what they keep."""

import argparse
import json
import math
import multiprocessing
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

PROJECT = Path(__file__).resolve().parents[1]
WORKERS = min(os.cpu_count() or 1, 2)
T = TypeVar("T")


def arguments(doc: str | None) -> argparse.ArgumentParser:
    """A parser that calls the study as `python -m` does, and prints its docstring as it is."""
    spec = sys.modules["__main__"].__spec__
    return argparse.ArgumentParser(
        prog=None if spec is None else f"python -m {spec.name.removesuffix('.__main__')}",
        description=doc,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def say(text: str, *, always: bool = False) -> None:
    """Progress, on a terminal; an empty text takes it away. `always`: elsewhere too, as lines."""
    if sys.stderr.isatty():
        print(f"\r{text[:120]}\033[K", end="", file=sys.stderr, flush=True)
    elif always:
        print(text, file=sys.stderr, flush=True)


def in_processes(
    run: Callable[[Any], T], inputs: Sequence[Any], workers: int = WORKERS, label: str = ""
) -> list[T]:
    """Outcomes of inputs, in their order.

    Forked processes have what was prepared here; where there is no fork each prepares it again.
    """
    methods = multiprocessing.get_all_start_methods()
    outcomes = []
    with multiprocessing.get_context("fork" if "fork" in methods else None).Pool(workers) as pool:
        for outcome in pool.imap(run, inputs):
            outcomes.append(outcome)
            say(f"{label}: {len(outcomes)}/{len(inputs)}")
        pool.close()
        pool.join()
    say("")
    return outcomes


def markdown(head: str | Sequence[str], rows: Iterable[Sequence[str]] = ()) -> list[str]:
    """Lines of a table; headings apart, or in a text with " | " between them."""
    names = head.split(" | ") if isinstance(head, str) else head
    table = ["| " + " | ".join(row) + " |" for row in (names, *rows)]
    return [table[0], "|---" * len(names) + "|", *table[1:]]


def number(value: float) -> str:
    """Three digits, in plain decimals: 3.6e-05 beside 0.12 is hard to read."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "never"
    if abs(value) >= 100.0:
        return f"{value:.0f}"
    return f"{value:.3g}" if abs(value) >= 1e-4 or value == 0.0 else f"{value:.5f}"


def gone_on_with(
    keep: Path | None, key: str, wanted: Iterable[int], make: Callable[[int], dict[str, Any]],
    most: int | None = None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Outcomes by number, of which a file keeps those that were made in earlier runs.

    Args:
        keep: JSON lines; None: nothing is kept.
        key: of the number in an outcome.
        wanted: numbers.
        make: the outcome of a number.
        most: outcomes that are made in this run; None: all.
    """
    done: dict[int, dict[str, Any]] = {}
    if keep is not None and keep.exists():
        done = {row[key]: row for row in map(json.loads, keep.read_text().splitlines())}
    wanted = list(wanted)
    for number in [n for n in wanted if n not in done][:most]:
        done[number] = make(number)
        if keep is not None:
            keep.parent.mkdir(parents=True, exist_ok=True)
            with keep.open("a") as file:
                file.write(json.dumps(done[number]) + "\n")
    return [done[n] for n in wanted if n in done]


@dataclass(frozen=True)
class Kept:
    """Outcomes by name as JSON, a file each, from one run to the next.

    Attributes:
        folder: below the project's build.
        version: of what is kept; what another version has kept is not there.
    """

    folder: Path
    version: int

    def write(self, name: str, outcomes: dict[str, Any]) -> None:
        """Keep outcomes."""
        self.folder.mkdir(parents=True, exist_ok=True)
        told = json.dumps({"version": self.version, "name": name, **outcomes})
        self._file(name).write_text(told, encoding="utf-8")

    def read(self, name: str) -> dict[str, Any] | None:
        """Those of a name."""
        file = self._file(name)
        return self.all([file]).get(name) if file.exists() else None

    def all(self, files: Iterable[Path] | None = None) -> dict[str, dict[str, Any]]:
        """All that are kept."""
        files = sorted(self.folder.glob("*.json")) if files is None else files
        found = [json.loads(file.read_text(encoding="utf-8")) for file in files]
        return {done["name"]: done for done in found if done.get("version") == self.version}

    def _file(self, name: str) -> Path:
        return self.folder / f"{name.replace(' ', '-').replace(chr(39), '')}.json"


def free_port() -> int:
    """A UDP port of this machine that is free at this moment."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass(frozen=True)
class Done:
    """A command that has ended.

    Attributes:
        status: exit status.
        seconds: of processor time.
        peak: bytes of memory at most.
        said: standard error.
        told: standard output.
    """

    status: int
    seconds: float
    peak: float
    said: str
    told: str = ""


def run(words: Sequence[str], tree: Path = PROJECT, folder: Path | None = None) -> Done:
    """Run a module's command, with this interpreter and its packages.

    Args:
        words: module and arguments, as after `python -m`; or "-c" and a program.
        tree: of the project, whose source counts.
        folder: to run in.
    """
    path = os.pathsep.join([str(tree / "src"), str(tree)])
    environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    command = words if words[0] == "-c" else ("-P", "-m", *words)
    with tempfile.TemporaryFile("w+") as said, tempfile.TemporaryFile("w+") as told:
        process = subprocess.Popen(
            [sys.executable, *command], stdin=subprocess.DEVNULL, stdout=told, stderr=said,
            env=environment, cwd=folder,
        )  # fmt: skip
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        told.seek(0)
        peak = usage.ru_maxrss * (1.0 if sys.platform == "darwin" else 1024.0)
        seconds = usage.ru_utime + usage.ru_stime
        return Done(process.returncode, seconds, peak, said.read(), told.read())


def sound(done: Done) -> Done:
    """A command that has ended well.

    Raises:
        RuntimeError: it has not.
    """
    if done.status:
        raise RuntimeError(done.said.strip() or f"exit status {done.status}")
    return done


def flown(words: Sequence[str], folder: Path) -> tuple[Path, dict[str, Any]]:
    """A flight of the emulator as its command line has it, as fast as it can be flown.

    Args:
        words: of `sim-bridge`.
        folder: for its files, which are replaced.

    Returns:
        The recording, and what is true.
    """
    log, truth = folder / "flight.tlog", folder / "truth.json"
    files = ("--tlog", str(log), "--truth", str(truth))
    sound(run(("sim_bridge", *words, "--speed", "max", "--force", *files)))
    return log, json.loads(truth.read_text(encoding="utf-8"))


def children_seconds() -> float:
    """Processor time of all child processes that have ended, s; not on Windows."""
    import resource

    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
