"""Examples in docstrings run, and every public function has one."""

import doctest
import functools
import inspect
from importlib import import_module
from pathlib import Path

import pytest

import gcs_sysid

ROOT = Path(__file__).resolve().parents[2]
MODULES = [
    "api",
    "model.airframe",
    "model.flight_model",
    "results.comparison",
    "results.result",
    "results.result_file",
    "signals.recursions",
    "signals.smoothers",
    "signals.stream_buffer",
]


ANALYZED_ONCE = functools.cache(gcs_sysid.analyze)
"""Most examples begin with the analysis of the same flight."""


@pytest.mark.slow
@pytest.mark.parametrize("name", MODULES)
def test_examples_give_what_they_say(name, monkeypatch):
    monkeypatch.chdir(ROOT)  # for logs/sample.tlog
    monkeypatch.setattr(gcs_sysid, "analyze", ANALYZED_ONCE)
    failed, tried = doctest.testmod(import_module(f"gcs_sysid.{name}"))
    assert tried > 0
    assert failed == 0


def test_every_public_function_has_an_example():
    public = [getattr(gcs_sysid, name) for name in gcs_sysid.__all__]
    functions = [each for each in public if inspect.isfunction(each)]
    assert len(functions) == 5
    for function in functions:
        assert ">>>" in (function.__doc__ or ""), function.__name__
