"""Processor time of the tests, by file: what `make test` spends it on.

    python tools/cost_of_tests.py [--tests] [PYTEST ARGUMENTS]

Of one process, its threads and the processes that it waited for, user and system, fixtures with the
first test that asks for them. `--tests` prints the most expensive tests too.
"""

import os
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def _spent() -> float:
    """Processor seconds until now."""
    return sum(os.times()[:4])


class Cost:
    """A plugin that adds up processor time."""

    def __init__(self) -> None:
        self.files: Counter[str] = Counter()
        self.tests: Counter[str] = Counter()
        self.count: Counter[str] = Counter()

    @pytest.hookimpl(wrapper=True)
    def pytest_make_collect_report(self, collector: pytest.Collector) -> Iterator[None]:
        """Importing a file is part of it."""
        began = _spent()
        report = yield
        if isinstance(collector, pytest.Module):
            self.files[collector.nodeid] += _spent() - began
        return report

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """A test with the fixtures that it sets up and tears down."""
        began = _spent()
        done = yield
        spent = _spent() - began
        name = item.nodeid.partition("::")[0]
        self.files[name] += spent
        self.tests[item.nodeid] += spent
        self.count[name] += 1
        return done


def main(arguments: list[str]) -> int:
    """Run the tests and print what they cost."""
    tests = "--tests" in arguments
    arguments = [a for a in arguments if a != "--tests"]
    os.chdir(ROOT)
    sys.path[:0] = [str(ROOT / "src"), str(ROOT)]
    os.environ["PYTHONPATH"] = os.pathsep.join(sys.path[:2])
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    cost = Cost()
    status = int(pytest.main(["-n", "0", *arguments], plugins=[cost]))
    for table in (cost.tests, cost.files) if tests else (cost.files,):
        for name, spent in table.most_common(60 if table is cost.tests else None):
            print(f"{spent:8.2f} s {cost.count.get(name, ''):>5}  {name}")
    print(f"{cost.files.total():8.2f} s {cost.count.total():>5}  in all")
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
