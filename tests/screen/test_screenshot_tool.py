import pickle
import subprocess
import sys
from pathlib import Path

import pytest

from . import fake

TOOL = Path(__file__).parents[2] / "tools" / "screenshot.py"


@pytest.mark.slow
def test_picture_of_a_pickled_snapshot_names_no_remote_font(tmp_path):
    # The fake's own classes stay out of the pickle, so that the tool can read it anywhere.
    pickled, picture = tmp_path / "snapshot.pickle", tmp_path / "screen.svg"
    pickled.write_bytes(pickle.dumps(fake.snapshot()))
    command = [sys.executable, str(TOOL), "--pickle", str(pickled), "-o", str(picture)]
    subprocess.run([*command, "--size", "80x24", "--light"], check=True, timeout=60)
    svg = picture.read_text(encoding="utf-8")
    assert "identified" in svg
    assert svg.count("http") == 1  # the name space of SVG itself
    assert "http://www.w3.org/2000/svg" in svg
