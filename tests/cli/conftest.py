"""Commands as functions of a test."""

from collections.abc import Callable, Sequence

import pytest

from gcs_sysid.cli.program import run

Command = Callable[..., tuple[int, str, str]]


def command(name: str, capsys: pytest.CaptureFixture[str]) -> Command:
    """Runs a command with some words; (status, standard output, standard error)."""

    def called(*words: object) -> tuple[int, str, str]:
        status = run([name, *map(str, words)])
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return called


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs the program; the only line that it says, on standard error, ending with a status."""

    def called(words: Sequence[str], status: int = 2) -> str:
        assert run([*words]) == status
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("\n") == 1
        return err

    return called


@pytest.fixture
def analyze(capsys: pytest.CaptureFixture[str]) -> Command:
    return command("analyze", capsys)


@pytest.fixture
def inspect(capsys: pytest.CaptureFixture[str]) -> Command:
    return command("inspect", capsys)


@pytest.fixture
def plan(capsys: pytest.CaptureFixture[str]) -> Command:
    return command("plan", capsys)
