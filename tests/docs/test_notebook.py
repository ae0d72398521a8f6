"""The notebook's code cells run in order, and say what their text promises."""

import contextlib
import io
import json

import pytest

from .pages import ROOT

NOTEBOOK = ROOT / "docs" / "notebook.ipynb"


@pytest.mark.thorough  # what is shown there is shown in python.md
def test_its_cells_run_and_hold_no_outputs(monkeypatch):
    monkeypatch.chdir(ROOT)
    names: dict[str, object] = {}
    said = io.StringIO()
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert notebook["nbformat"] == 4
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert len(cells) >= 6
    with contextlib.redirect_stdout(said):
        for i, cell in enumerate(cells):
            assert cell["outputs"] == []
            exec(compile("".join(cell["source"]), f"cell {i}", "exec"), names)
    samples = names["samples"]
    ratio, Izz = samples["k_M"] / samples["Izz"], samples["Izz"]
    # What the notebook says of them.
    assert ratio.std() / ratio.mean() < 0.4 * Izz.std() / Izz.mean()
    result = names["result"]
    assert result.history.t[-1] > 50.0
    assert result.prediction.r_squared == pytest.approx(
        list(result.validation["r_squared"].values()), abs=0.02
    )
    assert "1 sigma" in said.getvalue()
