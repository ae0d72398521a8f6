"""`gcs-sysid completion`: the script that completes its commands with the tab key."""

import argparse
from importlib import resources

from gcs_sysid.cli.program import PROGRAM, build_parser
from gcs_sysid.setup_help.shell_completion import commands_of, script


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    print(script(options.shell, PROGRAM, commands_of(build_parser(), _airframes())), end="")
    return 0


def _airframes() -> list[str]:
    """Names of built-in airframes, without the module that reads them: NumPy takes its time."""
    folder = resources.files("gcs_sysid") / "model" / "airframes"
    return sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".toml"))
