"""Of several logs in one call, none takes the others with it."""

import json
from pathlib import Path

import pytest

from gcs_sysid.__main__ import main
from gcs_sysid.cli import analyze_command, health_command

SAMPLE = str(Path(__file__).parents[2] / "logs" / "sample.tlog")


class UnforeseenError(Exception):
    """Nobody foresaw it."""


def failing(monkeypatch, module, name):
    """Have a function fail with a defect for every log named bad.tlog."""
    real = getattr(module, name)

    def run(log, *arguments, **options):
        if Path(log).name == "bad.tlog":
            raise UnforeseenError("of a kind that nobody foresaw")
        return real(log, *arguments, **options)

    monkeypatch.setattr(module, name, run)


@pytest.mark.parametrize(
    ("command", "module", "name", "verdicts"),
    [
        ("health", health_command, "ReadLog", {"available"}),
        ("analyze", analyze_command, "analyze_whole", {"identified", "partial"}),
    ],
)
def test_a_defect_with_one_log_is_a_line(
    command, module, name, verdicts, monkeypatch, tmp_path, capsys
):
    monkeypatch.chdir(tmp_path)
    failing(monkeypatch, module, name)
    (tmp_path / "bad.tlog").write_bytes(b"x")
    words = [command, "bad.tlog", "absent.tlog", SAMPLE, "--airframe", "paper"]
    assert main([*words, "--json", "out.json"]) == 2
    documents = json.loads((tmp_path / "out.json").read_text())
    assert [document["source"] for document in documents] == [SAMPLE]
    assert {document["verdict"] for document in documents} <= verdicts
    said = capsys.readouterr().err
    assert "bad.tlog: internal error (UnforeseenError: of a kind that nobody foresaw)" in said
    assert "absent.tlog" in said
    assert "Traceback" not in said


def test_the_only_log_fails_as_the_call(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    failing(monkeypatch, health_command, "ReadLog")
    (tmp_path / "bad.tlog").write_bytes(b"x")
    assert main(["health", "bad.tlog", "--airframe", "paper"]) == 2
    assert "internal error (UnforeseenError" in capsys.readouterr().err
