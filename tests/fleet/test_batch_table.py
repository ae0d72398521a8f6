"""The table as others read it."""

import json
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

pytest.importorskip("pyarrow", reason="needs the extra fleet")

from pyarrow import parquet

from gcs_sysid.cli import batch_command
from gcs_sysid.cli.program import run
from gcs_sysid.errors import InputError
from gcs_sysid.fleet.batch import read_table
from gcs_sysid.model.parameters import REGISTRY
from tests.fleet.conftest import OneThread, fill

DOCUMENT = Path(__file__).parents[2] / "docs" / "batch.md"


@pytest.fixture(scope="module")
def fleet(flights, tmp_path_factory):
    folder = tmp_path_factory.mktemp("fleet")
    fill(folder / "logs", flights)
    words = ["batch", str(folder / "logs"), "-o", str(folder / "fleet"), "--airframe", "paper"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batch_command, "LocalPool", OneThread)
        assert run(words) == 0
    return folder / "fleet" / "fleet.parquet"


@pytest.mark.slow
def test_columns_are_those_of_the_document(fleet):
    found = parquet.read_schema(fleet).names
    listed = DOCUMENT.read_text(encoding="utf-8").partition("## The table")[2].partition("```")[0]
    rows = [line.split("|")[1] for line in listed.splitlines() if line.startswith("| `")]
    told = [name for row in rows[:-1] for name in re.findall(r"`(\w+)`", row)]
    assert [name for name in found if name not in REGISTRY] == told
    assert found[len(told) :] == list(REGISTRY)
    first, last, *rest = (rows[-1].split(" ... ")[0], rows[-1].split(" ... ")[1])
    assert re.findall(r"`(\w+)`", first) == list(REGISTRY)[:2]
    assert re.findall(r"`(\w+)`", last) == list(REGISTRY)[-3:]
    assert not rest
    hovers = [row["health"] for row in read_table(fleet) if row["health"] is not None]
    assert len(hovers) == 4
    for health in hovers:
        assert health["seconds"] > 0.0
        # The paper's vehicle has its CG 100 mm forward and 50 mm right of the rotors' center.
        assert abs(health["cg_x"] - 0.1) < 4.0 * health["cg_x_std"]
        assert abs(health["cg_y"] - 0.05) < 4.0 * health["cg_y_std"]


@pytest.mark.slow
def test_duckdb_answers_the_queries_of_the_document(fleet):
    if find_spec("duckdb") is None:
        pytest.skip("without duckdb")
    blocks = re.findall(r"```sql\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    queries = [query for block in blocks for query in filter(str.strip, block.split(";\n"))]
    # In a process of its own: as one ends it says what it leaks.
    script = (
        "import duckdb, json, sys\n"
        "rows = [duckdb.execute(query).fetchall() for query in sys.argv[1:]]\n"
        "print(json.dumps(rows, default=str))"
    )
    words, there = [sys.executable, "-c", script, *queries], fleet.parent.parent
    done = subprocess.run(words, cwd=there, capture_output=True, text=True, check=True)
    over_time, nothing, scatter = json.loads(done.stdout)
    assert len(over_time) == 4
    vehicle, recorded, value, half, unit = over_time[0]
    assert (vehicle, unit) == ("paper 1:1", "kg m^2")
    assert recorded == "2025-01-01 00:00:00"
    assert abs(value - 0.0165) < 5.0 * half
    ((path, why),) = nothing
    assert path.endswith("broken.ulg")
    assert "not a .tlog" in why
    assert {row[1] for row in scatter} == {"Ixx", "Iyy", "Izz", "k_T"}
    assert all(row[2] == 4 for row in scatter)


def test_what_is_no_table_is_a_line(tmp_path):
    file = tmp_path / "other.parquet"
    file.write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"other.parquet: cannot read the table"):
        read_table(file)
    import pyarrow as pa

    parquet.write_table(pa.table({"path": ["a"]}), file)
    with pytest.raises(InputError, match=r"not a table of gcs-sysid batch"):
        read_table(file)
    with pytest.raises(InputError, match=r"gone.parquet: cannot read the table"):
        read_table(tmp_path / "gone.parquet")
