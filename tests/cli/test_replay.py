"""`replay` without a screen: the lines of `live`, the numbers of `analyze`."""

import json

import pytest

from gcs_sysid.cli.program import run

PAPER = ("--airframe", "paper")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log(fly):
    flight = fly("--mission", "all-axes", "--rate", "20", "--duration", "12", "--seed", "5")
    return str(flight.tlog)


@pytest.mark.thorough
def test_at_full_speed_it_prints_what_analyze_prints(log, tmp_path, capsys):
    replayed, analyzed = tmp_path / "replay.json", tmp_path / "analyze.json"
    assert run(["analyze", log, *PAPER, "--json", str(analyzed)]) == 0
    table = capsys.readouterr().out
    replay = ["replay", log, *PAPER, "--speed", "max", "--headless", "--json", str(replayed)]
    assert run(replay) == 0
    out, err = capsys.readouterr()
    assert out == table
    assert "rotors from ESC_STATUS" in err
    lines = [json.loads(line) for line in replayed.read_text().splitlines()]
    assert len(lines) > 1
    alone = json.loads(analyzed.read_text())
    assert alone.pop("health")["seconds_of_hover"] > 0.0  # of `analyze` alone
    assert alone.pop("summary")["line"]
    assert lines[-1] == alone


def test_without_a_terminal_it_ends_with_the_log(log, capsys):
    assert run(["replay", log, *PAPER, "--speed", "max"]) == 0
    assert "identified" in capsys.readouterr().out
