"""The audit of pinned versions: offline, by OSV's rules, and no trouble where nothing is known."""

import json
import re
from datetime import UTC, datetime
from pathlib import Path

import pytest

from tools import audit


def advisory(name, identifier="PYSEC-1", **affected):
    package = {"ecosystem": "PyPI", "name": name}
    return {"id": identifier, "summary": "bad", "affected": [{"package": package, **affected}]}


@pytest.fixture
def osv(tmp_path, monkeypatch):
    monkeypatch.setenv(audit.VARIABLE, str(tmp_path))
    monkeypatch.setattr(audit, "CONSTRAINTS", tmp_path / "constraints.txt")
    (tmp_path / "constraints.txt").write_text("# pins\nNumPy==2.4.6\nmy_lib==1.0\n")

    def keep(document):
        (tmp_path / f"{document['id']}.json").write_text(json.dumps(document))

    return keep


def spans(*events):
    return [{"type": "ECOSYSTEM", "events": [dict([event]) for event in events]}]


def test_without_advisories_it_says_so_and_passes(osv, capsys):
    assert audit.main() == 0
    assert "skipped" in capsys.readouterr().out


def test_a_release_that_could_not_be_checked_fails(osv, tmp_path, capsys):
    assert audit.main(["--release"]) == 2
    assert "no advisories" in capsys.readouterr().out
    osv(advisory("other", "A") | {"modified": "2026-01-01T00:00:00Z"})
    assert audit.main(["--release"], today=datetime(2026, 1, 20, tzinfo=UTC)) == 0
    assert audit.main(["--release"], today=datetime(2026, 3, 1, tzinfo=UTC)) == 2
    assert "2026-01-01" in capsys.readouterr().out
    (tmp_path / "half.json").write_text('{"id": ')
    assert audit.main(["--release"], today=datetime(2026, 1, 20, tzinfo=UTC)) == 2
    assert "half.json is no OSV advisory" in capsys.readouterr().out


def test_advisories_of_other_ecosystems_check_nothing(osv, capsys):
    osv({"id": "GO-1", "affected": [{"package": {"ecosystem": "Go", "name": "numpy"}}]})
    assert audit.main(["--release"]) == 2
    assert "not possible" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("affected", "hit"),
    [
        ({"versions": ["2.4.6"]}, True),
        ({"versions": ["2.4.5"]}, False),
        ({"ranges": spans(("introduced", "0"), ("fixed", "2.4.7"))}, True),
        ({"ranges": spans(("introduced", "0"), ("fixed", "2.4.6"))}, False),
        ({"ranges": spans(("introduced", "2.5"))}, False),
        ({"ranges": spans(("introduced", "2.0"), ("last_affected", "2.4.6"))}, True),
        ({"ranges": spans(("introduced", "2.0"), ("last_affected", "2.4.5"))}, False),
    ],
)
def test_a_pinned_version_that_is_affected_is_found(osv, capsys, affected, hit):
    osv(advisory("numpy", **affected))
    assert audit.main() == int(hit)
    assert ("numpy 2.4.6: PYSEC-1: bad" in capsys.readouterr().out) == hit


def test_others_and_withdrawn_and_allowed_ones_do_not_fail(osv, monkeypatch, capsys):
    osv(advisory("other", "A", versions=["2.4.6"]))
    osv(advisory("numpy", "B", versions=["2.4.6"]) | {"withdrawn": "2026-01-01T00:00:00Z"})
    osv(advisory("My.Lib", "C", versions=["1.0"]))
    assert audit.main() == 1
    monkeypatch.setitem(audit.ALLOWED, "C", "not called here")
    assert audit.main() == 0
    assert "allowed: not called here" in capsys.readouterr().out


def test_the_projects_own_pins_can_be_read():
    text = (Path(__file__).parents[2] / "constraints.txt").read_text(encoding="utf-8")
    versions = audit.pinned(text)
    assert versions["pymavlink"]
    assert all(re.fullmatch(r"[\w.]+", version) for version in versions.values())
