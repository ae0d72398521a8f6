"""Calls within calls are told apart, and the long ones counted."""

import pytest

from benchmarks.reliability import long_calls
from benchmarks.reliability.long_calls import LongCalls


class Worker:
    """Calls that take as long as they are told, on a clock of their own."""

    now = 0.0

    def outer(self, own: float, inner: float) -> str:
        type(self).now += own
        self.inner(inner)
        return "done"

    def inner(self, seconds: float) -> None:
        type(self).now += seconds
        if seconds < 0.0:
            raise ValueError("backwards")


def test_a_call_is_counted_without_those_in_it(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = {"outside": (Worker, "outer"), "inside": (Worker, "inner")}
    monkeypatch.setattr(long_calls, "CALLS", calls)
    for name in ("outer", "inner"):
        monkeypatch.setattr(Worker, name, getattr(Worker, name))
    watched = LongCalls(lambda: Worker.now)
    watched.watch()
    worker = Worker()
    assert worker.outer(0.002, 0.030) == "done"
    worker.outer(0.020, 0.001)
    worker.outer(0.006, 0.010)
    with pytest.raises(ValueError, match="backwards"):
        worker.inner(-1.0)
    head, first, second = watched.table().splitlines()
    assert head.split()[:3] == ["call", "calls", ">"]
    assert first.split() == ["inside", "4", "2", "0.04", "30", "ms"]
    assert second.split() == ["outside", "3", "2", "0.03", "20", "ms"]
