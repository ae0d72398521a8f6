"""Runs one harness in this process until its inputs or its time are used up."""

import argparse
import contextlib
import hashlib
import importlib
import importlib.util
import json
import os
import random
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections.abc import Sequence
from pathlib import Path

from testbed.fuzz.harness import Harness
from testbed.fuzz.mutate import Mutator

SLOW = 1.0
"""s of processor time: an input that takes longer is a finding."""
STUCK = 60.0
"""s on the clock after which an input counts as endless; generous, as others may run beside."""
MOST_MEMORY = 2**30
"""Bytes that an input of a few kilobytes may claim: more is a finding. By as much a process may
grow, as atheris keeps what comparisons of arrays give; then another goes on."""
_TELL_EVERY = 5.0


class Driver:
    """Feeds inputs to a harness, and keeps what it finds.

    Args:
        harness: to feed.
        inputs: how many.
        seconds: of the clock, at most.
        folder: for the figures and the inputs that found something.
    """

    def __init__(self, harness: Harness, inputs: int, seconds: float, folder: Path) -> None:
        self._harness = harness
        self._inputs = inputs
        self._until = time.monotonic() + seconds
        self._folder = folder
        self.count = 0
        self.longest = 0.0
        self.engine = ""
        self._kinds: dict[str, int] = {}
        self._now = b""
        self._waiting: list[bytes] = []
        self._told = 0.0
        self._full = _claimed() + MOST_MEMORY
        folder.mkdir(parents=True, exist_ok=True)

    def guard(self) -> None:
        """From now on an input that takes for ever ends the process, which must be our own."""
        threading.Thread(target=self._watch, daemon=True).start()

    def take(self, data: bytes) -> None:
        """One input, checked when there are enough; ends the process after the last."""
        self._waiting.append(data)
        joined = len(self._waiting)
        if joined < self._harness.together:
            return
        data = self._now = b"".join(self._waiting)
        self._waiting.clear()
        began = time.process_time()
        try:
            self._harness.check(data)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is the finding
            self._keep(_kind(error), data, error)
        took = time.process_time() - began
        self.longest = max(self.longest, took)
        if took > SLOW:
            self._keep("slow", data, None)
        self.count += joined
        if self.count & 63 == 0 or self.count >= self._inputs:
            now = time.monotonic()
            done = self.count >= self._inputs or now >= self._until or _claimed() > self._full
            if done or now - self._told > _TELL_EVERY:
                self._told = now
                self.tell()
            if done:
                sys.stdout.flush()
                os._exit(0)  # libFuzzer gives the thread back in no other way

    def _keep(self, kind: str, data: bytes, error: Exception | None) -> None:
        self._kinds[kind] = self._kinds.get(kind, 0) + 1
        if self._kinds[kind] == 1:
            name = f"{self._harness.name}-{hashlib.sha256(data).hexdigest()[:12]}"
            (self._folder / name).write_bytes(data)
            lines = traceback.format_exception(error) if error else [f"{kind}\n"]
            (self._folder / f"{name}.txt").write_text("".join(lines), errors="replace")

    def tell(self) -> None:
        """Write the figures so far."""
        figures = {
            "harness": self._harness.name,
            "engine": self.engine,
            "inputs": self.count,
            "longest": self.longest,
            "findings": self._kinds,
        }
        part = self._folder / f"{self._harness.name}.part"
        part.write_text(json.dumps(figures))
        part.replace(self._folder / f"{self._harness.name}.json")

    def _watch(self) -> None:
        last, since = -1, time.monotonic()
        while True:
            time.sleep(1.0)
            if self.count != last:
                last, since = self.count, time.monotonic()
            elif time.monotonic() - since > STUCK:
                self._keep("endless", self._now, None)
                self.tell()
                os._exit(1)


def _kind(error: Exception) -> str:
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} {Path(place.filename).name}:{place.lineno}"


def _claimed() -> int:
    """Bytes of this process; 0 where the system does not say."""
    with contextlib.suppress(ImportError, OSError):
        import resource

        return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    return 0


def _bound_memory() -> None:
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        most = _claimed() + 2 * MOST_MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def _harness(name: str) -> Harness:
    module = importlib.import_module("testbed.fuzz.harnesses")
    found: Harness = next(h for h in module.HARNESSES if h.name == name)
    return found


def _with_atheris(name: str, make: "argparse.Namespace") -> None:
    """Inputs led by what code they reach."""
    import atheris

    with atheris.instrument_imports(include=["gcs_sysid", "sim_bridge", "tomllib"]):
        harness = _harness(name)
    driver = Driver(harness, make.inputs, make.seconds, make.folder)
    driver.engine = "atheris"
    driver.guard()
    with tempfile.TemporaryDirectory(prefix="corpus-") as corpus:
        for number, seed in enumerate([*harness.seeds(), *harness.kept()]):
            (Path(corpus) / str(number)).write_bytes(seed)
        words = Path(corpus).with_suffix(".dict")
        words.write_text(
            "".join(
                '"{}"\n'.format("".join(f"\\x{byte:02x}" for byte in token))
                for token in harness.tokens
            )
        )
        options = [f"-seed={make.seed}", f"-max_len={harness.longest}", "-verbosity=0"]
        options += ["-timeout=600", "-rss_limit_mb=0"]
        if harness.tokens:  # an empty dictionary stops libFuzzer
            options.append(f"-dict={words}")
        atheris.Setup([sys.argv[0], *options, corpus], driver.take)
        _bound_memory()
        atheris.Fuzz()


def _with_random(name: str, make: "argparse.Namespace") -> None:
    """Inputs drawn near the seeds."""
    harness = _harness(name)
    driver = Driver(harness, make.inputs, make.seconds, make.folder)
    driver.engine = "random"
    driver.guard()
    _bound_memory()
    seeds = [*harness.seeds(), *harness.kept()]
    for seed in seeds:
        driver.take(seed)
    mutator = Mutator(seeds, harness.tokens, harness.longest, random.Random(make.seed))
    while True:
        driver.take(mutator.draw())


def has_atheris() -> bool:
    """Whether atheris is installed."""
    return importlib.util.find_spec("atheris") is not None


def main(argv: Sequence[str] | None = None) -> None:
    """One harness; started by the package's `__main__` for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("harness")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--inputs", type=int, required=True)
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--engine", choices=("atheris", "random"), required=True)
    options = parser.parse_args(argv)
    warnings.simplefilter("error", RuntimeWarning)  # users would see them
    (_with_atheris if options.engine == "atheris" else _with_random)(options.harness, options)


if __name__ == "__main__":
    main()
