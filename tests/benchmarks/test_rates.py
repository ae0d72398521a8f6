"""Coverage at slow rates: what a cell counts."""

import pytest

from benchmarks import rates


def found(z, status="identified"):
    return {"status": status, "z": z, "error": 0.0, "holds": abs(z) <= rates.Z95}


def test_a_cell_counts_what_is_claimed_and_names_the_worst(capsys, monkeypatch):
    outcomes = [
        {"verdict": "identified", "parameters": {"Ixx": found(1.0), "k_T": found(-4.9)}},
        {"verdict": "partial", "parameters": {"Ixx": found(0.5), "Izz": found(9.0, "weak")}},
        {"verdict": "refused", "error": "no flight"},
    ]
    cells, share = rates.row((20, "acro"), outcomes)
    assert share == pytest.approx(2 / 3)
    verdicts = "1 identified, 1 partial, 1 refused"
    assert cells == ["20 Hz", "acro", verdicts, "2 of 3", "66.7 %", "2.50 (k_T, seed 1)"]
    monkeypatch.setattr(rates, "in_processes", lambda *_: outcomes)
    assert rates.main(["--seeds", "3", "--rate", "20", "--mission", "acro"]) == 1
    assert capsys.readouterr().out.splitlines()[-1] == f"| {' | '.join(cells)} |"


def test_a_cell_without_claims_contradicts_nothing():
    cells, share = rates.row((10, "paper"), [{"verdict": "partial", "parameters": {}}])
    assert share == 1.0
    assert cells[3:] == ["0 of 0", "-", "-"]
