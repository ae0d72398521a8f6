"""Every command with `python -X dev -W error`: no warning, nothing left open."""

import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from gcs_sysid.cli.commands import COMMANDS

SAMPLE = str(Path(__file__).parents[2] / "logs" / "sample.tlog")
PAPER = ("--airframe", "paper", "--mass", "1.5")
LINES = (
    ("analyze", SAMPLE, *PAPER, "--json", "a.json", "--report", "a.html"),
    ("inspect", SAMPLE, "--json", "i.json"),
    ("check", SAMPLE, *PAPER, "--json", "c.json"),
    ("health", SAMPLE, *PAPER, "--json", "h.json", "--picture", "h.svg"),
    ("params", SAMPLE, *PAPER, "--json", "s.json"),
    ("plan", "--airframe", "paper", "--json", "p.json", "--svg", "p.svg"),
    ("export", "a.json", "--to", "urdf", "-o", "a.urdf"),
    ("tune", "a.json", "--autopilot", "px4", "--json", "g.json"),
    ("twin", "a.json", SAMPLE, "--json", "w.json", "--picture", "w.svg"),
    ("compare", "a.json", "a.json"),
    ("batch", SAMPLE, *PAPER, "-o", "fleet"),
    ("trend", "fleet", "-o", "t.html"),
    ("airframe", "check", "paper"),
    ("doctor", "--duration", "0.5"),
    ("fetch", "udpin:127.0.0.1:{port}", "--list"),
    ("completion", "powershell"),
    ("replay", SAMPLE, *PAPER, "--headless", "--speed", "max"),
    ("demo", "--headless", "--speed", "max", "--duration", "5", "--record", "d.tlog"),
    ("live", "udpin:127.0.0.1:{port}", *PAPER, "--headless", "--duration", "1", "--no-record"),
)


def check(words, folder):
    done = subprocess.run(
        [sys.executable, "-X", "dev", "-W", "error", "-m", "gcs_sysid", *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
    )
    said = done.stdout + done.stderr
    assert re.search(r"Warning|Exception ignored|internal error|Traceback", said) is None, said
    # 1: nothing was heard, or no answer; 2: no vehicle to fetch from
    assert done.returncode in ((2,) if words[0] == "fetch" else (0, 1)), said


@pytest.mark.parametrize("words", [line for line in LINES if line[0] in ("airframe", "completion")])
def test_a_quick_command_warns_of_nothing(words, tmp_path):
    check(words, tmp_path)


@pytest.mark.thorough
def test_no_command_warns_of_anything(tmp_path):
    serves = {"web"}  # until it is interrupted
    assert {line[0] for line in LINES} | serves == {command.name for command in COMMANDS}
    for words in LINES:
        if words[0] in ("batch", "trend"):
            pytest.importorskip("pyarrow")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        check([word.replace("{port}", str(port)) for word in words], tmp_path)
