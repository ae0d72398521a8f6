"""What users write passes `mypy --strict` without casts."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPT = """
from pathlib import Path

import gcs_sysid


def ratio(log: Path) -> float:
    result = gcs_sysid.analyze(log, "paper", mass=1.5)
    Izz = result.identified("Izz")
    low, high = Izz.ci95
    share: float = (high - low) / Izz.value
    model = result.model(result.samples(10, seed=1))
    flown = model.simulate([0.0, 0.1], [[134.0] * 4] * 2, gcs_sysid.MotionState())
    last: float = float(flown.rates[0, -1, 0])
    twin = gcs_sysid.fly_twin(result, log)
    return share + last + twin.accuracy[1.0]["rates"].rms
"""


WRONG = """

def unsure(result: gcs_sysid.Result) -> float:
    return result.parameters["Izz"].value + 1.0
"""


@pytest.mark.thorough
@pytest.mark.parametrize("passes", [True, False])
def test_user_code_is_typed_through(tmp_path, passes):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT if passes else SCRIPT + WRONG)
    cache = ["--cache-dir", str(ROOT / ".mypy_cache" / "scripts")]
    options = ["--strict", "--config-file=", "--follow-imports=silent", "--ignore-missing-imports"]
    run = subprocess.run(
        [sys.executable, "-m", "mypy", *options, *cache, script],
        env={"MYPYPATH": str(ROOT / "src"), "PATH": ""},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (run.returncode == 0) == passes, run.stdout + run.stderr
    if not passes:
        assert 'Left operand is of type "float | None"' in run.stdout
