"""The reference pages hold every command, option and public name, and nothing that is not said."""

import argparse
import inspect
import re
import sys

import pytest

import gcs_sysid
from gcs_sysid.cli.commands import build_parser

from .pages import ROOT

sys.path.insert(0, str(ROOT / "tools"))
from reference import api_page, commands_page, parameters_page

from gcs_sysid.model.airframe import PRIORS
from gcs_sysid.model.parameters import REGISTRY

_COMMANDS = next(a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction))
_SHOWN = [choice.dest for choice in _COMMANDS._choices_actions]


@pytest.mark.parametrize("name", _SHOWN)
def test_every_option_of_every_command_is_told(name):
    parts = re.split(r"^## (\w+)$", commands_page(), flags=re.MULTILINE)
    told = dict(zip(parts[1::2], parts[2::2], strict=True))[name]
    for action in _COMMANDS.choices[name]._actions:
        if action.help is argparse.SUPPRESS or isinstance(action, argparse._HelpAction):
            continue
        for flag in action.option_strings:
            assert re.search(rf"^- .*`{flag}[ `]", told, re.MULTILINE), flag
        if action.help and "%" not in action.help and "_" not in action.help:
            first = action.help.split("`")[0].split("|")[0].split("*")[0].split("<")[0]
            assert first in told


@pytest.mark.parametrize("name", gcs_sysid.__all__)
def test_every_public_name_is_told_with_what_its_docstring_says(name):
    page = api_page()
    assert re.search(rf"^## {name}$", page, re.MULTILINE)
    each = getattr(gcs_sysid, name)
    first = (inspect.getdoc(each) or "").split(".")[0].split("\n")[0]
    assert first[:40].replace("_", r"\_").replace("|", r"\|").replace("*", r"\*")[:30] in page


def test_signatures_are_those_of_the_source():
    page = api_page()
    assert "read_result(path: str | Path) -> Result" in page
    assert "    start: float = 0.0,\n    end: float = float('inf'),\n" in page
    assert "    vehicle: tuple[int, int | None] | None = None,\n" in page
    assert "(self" not in page
    assert ">>> low, high = result.parameters" in page


def test_every_parameter_is_listed_with_what_its_status_refers_to():
    rows = [line.split(" | ") for line in parameters_page().splitlines() if line.startswith("| `")]
    assert [row[0] for row in rows] == [f"| `{name}`" for name in REGISTRY]
    assert [
        name for name, row in zip(REGISTRY, rows, strict=True) if row[-1].startswith("yes")
    ] == [*PRIORS]
    references = {name: row[5] for name, row in zip(REGISTRY, rows, strict=True)}
    assert references["mass"] == "the value"
    assert references["cg_x"] == "0.2 of the arm"
    assert references["rotor_inertia"] == "the value, or 0.002 of Izz in SI if larger"
    assert references["rotor_delay"] == "0.02 s"
    assert "`rot_damping` on the live screen" in parameters_page()
