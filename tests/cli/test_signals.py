"""Signals end a command cleanly; results and words hold up nobody."""

import io
import os
import signal
import threading

import pytest

from gcs_sysid.cli import output
from gcs_sysid.cli.output import JsonLines, on_signals
from gcs_sysid.errors import InputError

CLEAN = [name for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]


class AtOnceError(Exception):
    """Stands for the end of the process."""


@pytest.fixture
def ended(monkeypatch):
    """Exit statuses of what would have ended the process."""
    statuses = []

    def end(status):
        statuses.append(status)
        raise AtOnceError

    monkeypatch.setattr(os, "_exit", end)
    return statuses


@pytest.mark.parametrize("name", CLEAN)
def test_a_signal_asks_for_the_end_once(name, ended):
    number = getattr(signal, name)
    before = signal.getsignal(number)
    asked = []
    with on_signals(lambda: asked.append(name)):
        signal.raise_signal(number)
    assert asked == [name]
    assert ended == []
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("first", CLEAN)
def test_a_second_ctrl_c_ends_at_once(first, ended):
    with on_signals(lambda: None):
        signal.raise_signal(getattr(signal, first))
        with pytest.raises(AtOnceError):
            signal.raise_signal(signal.SIGINT)
    assert ended == [128 + signal.SIGINT]


def test_a_service_that_is_stopped_may_send_several(ended):
    asked = []
    with on_signals(lambda: asked.append(1)):
        for name in CLEAN:
            if name not in ("SIGINT", "SIGBREAK"):
                signal.raise_signal(getattr(signal, name))
                signal.raise_signal(getattr(signal, name))
    assert asked
    assert ended == []


class Line:
    """A result that says which one it is."""

    def __init__(self, number):
        self.number = number

    def dumps(self, indent=None):
        return str(self.number)


class Pipe(io.StringIO):
    """Whose reader takes nothing until it is told to, or has gone, or whose disk is full."""

    def __init__(self, error=None):
        super().__init__()
        self.error = error
        self.reads, self.reached = threading.Event(), threading.Event()
        self.lines = []

    def write(self, text):
        self.reached.set()
        assert self.reads.wait(60.0)
        if self.error is not None:
            raise self.error
        return super().write(text)

    def close(self):
        self.lines = self.getvalue().split()


def lines_to(pipe, monkeypatch):
    monkeypatch.setattr(output, "open_output", lambda _, *, force: pipe)
    return JsonLines("results.json", force=False)


def test_results_wait_for_a_slow_reader_and_the_session_does_not(monkeypatch):
    pipe = Pipe()
    writer = lines_to(pipe, monkeypatch)
    writer.write(Line(0))
    assert pipe.reached.wait(60.0)
    for number in range(1, 1001):  # returns at once, every time
        writer.write(Line(number))
    pipe.reads.set()
    writer.close()
    assert pipe.lines == ["0", *(str(n) for n in range(937, 1001))]


def test_a_reader_that_has_gone_is_told(monkeypatch):
    pipe, gone = Pipe(BrokenPipeError()), threading.Event()
    writer = lines_to(pipe, monkeypatch)
    writer.when_gone = gone.set
    pipe.reads.set()
    writer.write(Line(0))
    assert gone.wait(60.0)
    with pytest.raises(BrokenPipeError):
        writer.close()


def test_a_disk_that_is_full_is_told_at_once_and_at_the_end(monkeypatch, capsys):
    pipe = Pipe(OSError(28, "No space left on device"))
    writer = lines_to(pipe, monkeypatch)
    pipe.reads.set()
    writer.write(Line(0))
    with pytest.raises(InputError, match=r"results\.json: cannot write: No space left"):
        writer.close()
    assert "No space left on device; the session continues" in capsys.readouterr().err


def test_words_for_a_terminal_that_is_gone_cost_nothing(monkeypatch):
    class Gone(io.StringIO):
        def write(self, text):
            raise OSError(5, "Input/output error")

    monkeypatch.setattr("sys.stderr", Gone())
    output.say("nobody hears this")
