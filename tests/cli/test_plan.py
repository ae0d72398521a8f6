"""`gcs-sysid plan`: text, picture, JSON and exit status.

The text is compared with `golden/`, its figures rounded to one digit. After a change that is
meant: `UPDATE_GOLDEN=1 pytest tests/cli/test_plan.py`, then look at the difference.
"""

import json
import os
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

SIH = ("--airframe", "px4-sih", "--mass", "1")
GOLDEN = Path(__file__).parent / "golden" / "plan.txt"


def rounded(text):
    """With one digit of each share: processors differ in the last."""
    return re.sub(r"\d+\.\d+(?= %)", lambda m: f"{float(m[0]):.1g}", text)


def test_text(plan):
    status, out, err = plan("--airframe", "paper", "--target", "1%")
    assert status == 0
    assert err == ""
    if os.environ.get("UPDATE_GOLDEN"):
        GOLDEN.write_text(rounded(out), encoding="utf-8")
    assert max(map(len, out.splitlines())) < 80
    assert rounded(out) == GOLDEN.read_text(encoding="utf-8")


def test_json_alone_on_standard_output(plan):
    status, out, _ = plan(*SIH, "--json", "--target", "3")
    assert status == 0
    found = json.loads(out, parse_constant=lambda word: pytest.fail(f"{word} in the JSON"))
    assert found["schema"] == "gcs-sysid-plan/1"
    assert found["target"] == pytest.approx(0.03)
    assert found["enough"] is True
    assert max(found["expected"].values()) <= 0.03
    end = 0.0
    for manoeuvre in found["manoeuvres"]:
        assert manoeuvre["start"] >= end
        end = manoeuvre["start"] + manoeuvre["seconds"]
        assert abs(manoeuvre["roll_deg"]) <= 20.0
        assert manoeuvre["text"]
    assert found["seconds"] == end


def test_files_beside_the_text(plan, tmp_path):
    svg, path = tmp_path / "plan.svg", tmp_path / "plan.json"
    status, out, _ = plan("--airframe", "paper", "--svg", svg, "--json", path)
    assert status == 0
    assert out.startswith("Flight plan for paper")
    assert ET.parse(svg).getroot().tag.endswith("svg")
    assert json.loads(path.read_text(encoding="utf-8"))["airframe"] == "paper"


def test_limits_are_obeyed_and_said(plan):
    options = ("--airframe", "paper", "--max-tilt", "10", "--max-rate", "60")
    status, out, _ = plan(*options)
    assert status == 0
    assert "tilt 10°, rate 60°/s" in out
    assert max(map(int, re.findall(r"±(\d+)°", out))) <= 45
    assert "±20°" not in out


@pytest.mark.slow
def test_what_cannot_be_reached_is_said(plan):
    status, out, _ = plan("--airframe", "paper", "--target", "0.1%", "--max-tilt", "5")
    assert status == 1
    assert "not enough" in out
