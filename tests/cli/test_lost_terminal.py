"""No process stays behind when the terminal is closed: a window, a tmux pane, a broken SSH line."""

import os
import shutil
import sys
from pathlib import Path

import pytest

from tests.terminals import OnTerminal

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs pseudo terminals"),
]
LOGS = Path(__file__).parents[2] / "logs"
SAMPLE = ("replay", str(LOGS / "sample.tlog"), "--airframe", "paper")
WAITING = (
    ("live", "udpout:127.0.0.1:45873", "--airframe", "paper", "--no-record"),
    b"no vehicle yet",
)
EMULATED = (("demo",), b"flying")
REPLAYED = (SAMPLE, b"flying")
OVER = ((*SAMPLE, "--speed", "max"), b"numbers are final")


def make(words):
    """A `make` that starts the program: it catches the hang-up and passes it to nobody."""
    if shutil.which("make") is None:
        pytest.skip("needs make")
    command = " ".join([sys.executable, "-m", "gcs_sysid", *words])
    Path("Makefile").write_text(f"session:\n\t@{command}\n", encoding="utf-8")
    return ("make", "session")


@pytest.mark.parametrize(
    "started", ["by make", pytest.param("directly", marks=pytest.mark.thorough)]
)
@pytest.mark.parametrize(
    ("words", "text"),
    [
        EMULATED,
        *(pytest.param(*case, marks=pytest.mark.thorough) for case in (WAITING, REPLAYED, OVER)),
    ],
)
def test_a_screen_ends_with_its_terminal(words, text, started, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = make(words) if started == "by make" else (sys.executable, "-m", "gcs_sysid", *words)
    program = OnTerminal(folder=tmp_path, command=command)
    try:
        assert program.shows(text), program.shown
        program.hang_up()
        assert program.shows(None), "still there"
    finally:
        program.end()
