"""JSON has finite numbers: what is not is null when written, and refused when read."""

import ast
import json
import math
from pathlib import Path

import pytest

import gcs_sysid
from gcs_sysid.errors import InputError
from gcs_sysid.strict_json import json_text, parse_json

SOURCES = Path(gcs_sysid.__file__).parent
NO_NUMBERS = {
    "fleet/jobs.py", "report/data.py", "setup_help/airframe_file.py", "web/workbench.py",
    "telemetry/wanted_streams.py",
}  # fmt: skip
"""Names and whole numbers, what `json_text` has made already, or words between processes."""
NO_NULLS = {"exports/python_simulators.py"}
"""A simulator cannot fly with a number that is not known."""


def test_one_number_that_is_not_finite_costs_no_other():
    document = {"a": 1.5, "b": [math.inf, {"c": -math.inf}], "d": (math.nan, 2), "e": "text"}
    assert json.loads(json_text(document)) == {
        "a": 1.5, "b": [None, {"c": None}], "d": [None, 2], "e": "text"
    }  # fmt: skip


@pytest.mark.parametrize("text", ['{"a": NaN}', "[-Infinity]", "[1e999]", "{", "[" * 5000])
def test_what_is_no_strict_json_is_refused_with_its_name(text):
    with pytest.raises(InputError, match=r"^before\.json: not (valid|strict) JSON"):
        parse_json(text, "before.json")


def test_documents_are_written_in_one_place():
    own = {"strict_json.py"} | NO_NUMBERS | NO_NULLS
    for path in sorted(SOURCES.rglob("*.py")):
        name = path.relative_to(SOURCES).as_posix()
        called = {
            ast.unparse(node.func)
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Call)
        }
        if name not in own and not name.startswith("telemetry/dialect/"):
            assert not called & {"json.dumps", "json.dump"}, name
