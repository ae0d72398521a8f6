"""The comparison with the last release: what it is held against, and what it says without one."""

import sys

import pytest

from benchmarks import against


@pytest.fixture
def git(monkeypatch):
    """A history with one release."""
    told = {"log": b"abc1234\nold5678\n"}
    monkeypatch.setattr(against, "git", lambda *words: told[words[0]])
    return told


def test_the_release_is_the_commit_that_dated_its_section(git):
    assert against.last_release() == "old5678"
    git["log"] = b""
    with pytest.raises(ValueError, match="does not reach back to"):
        against.last_release()


def test_what_became_slower_ends_with_1(tmp_path, monkeypatch, capsys):
    seconds = {tmp_path: 1.0, against.PROJECT: 1.2}
    monkeypatch.setattr(against, "last_release", lambda: "abc1234")
    monkeypatch.setattr(against, "unpack", lambda commit, folder: tmp_path)
    monkeypatch.setattr(against, "cost", lambda tree, words: seconds[tree])
    monkeypatch.setattr(sys, "argv", ["against", "--repeats", "1"])
    assert against.main() == 0
    assert "1.20" in capsys.readouterr().out
    seconds[against.PROJECT] = 1.3
    assert against.main() == 1


def test_one_row_alone_flies_what_it_needs(tmp_path, monkeypatch, capsys):
    ran = []
    monkeypatch.setattr(against, "last_release", lambda: "abc1234")
    monkeypatch.setattr(against, "unpack", lambda commit, folder: tmp_path)
    monkeypatch.setattr(against, "cost", lambda tree, words: ran.append(words) or 1.0)
    monkeypatch.setattr(sys, "argv", ["against", "--repeats", "1", "--only", "on commands"])
    assert against.main() == 0
    assert len(capsys.readouterr().out.splitlines()) == 2
    flights = [words for words in ran if words[0] == "sim_bridge"]
    assert len(flights) == 1
    assert "--rotor-input" in flights[0]
    monkeypatch.setattr(sys, "argv", ["against", "--only", "nothing"])
    assert against.main() == 0
    assert "no row has 'nothing' in its name" in capsys.readouterr().out


def test_without_a_history_nothing_is_compared(monkeypatch, capsys):
    def gone(*_):
        raise FileNotFoundError("no git")

    monkeypatch.setattr(against, "git", gone)
    monkeypatch.setattr(sys, "argv", ["against"])
    assert against.main() == 0
    assert capsys.readouterr().out == "not compared with the last release: no git\n"
