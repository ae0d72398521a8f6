"""`gcs-sysid completion`: the script that completes its commands with the tab key.

shtab writes it from the parser. Here is what a parser does not know: where files are meant, and
which airframes are built in. The script holds all it needs, so that the key starts no Python.
"""

import argparse
from collections.abc import Iterator, Sequence
from importlib import resources

import shtab

from gcs_sysid.cli.commands import PROGRAM, build_parser
from gcs_sysid.cli.output import show

_FILE_SIGNS = ("FILE", "LOG", "DIR", "PATH", "URL", ".json")
"""In the metavar of what may be a file; a URL may be a serial device."""

_EQUALS = r"""
# bash passes --flag=value as three words; the completion above knows --flag value.
_gcs_sysid() {
  local -a typed=()
  local i at=$COMP_CWORD
  for (( i = 0; i < ${#COMP_WORDS[@]}; i++ )); do
    if [[ "${COMP_WORDS[i]}" != "=" ]]; then typed+=("${COMP_WORDS[i]}")
    elif (( i < COMP_CWORD )); then (( at-- ))
    elif (( i == COMP_CWORD )); then typed+=(""); fi
  done
  local -a COMP_WORDS=("${typed[@]}")
  local COMP_CWORD=$at
  _shtab_gcs_sysid
}
complete -o bashdefault -o default -F _gcs_sysid gcs-sysid
"""


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    show(script(options.shell).removesuffix("\n"))
    return 0


def script(shell: str) -> str:
    """The script for a shell: bash, zsh, fish or powershell."""
    parser = build_parser()
    airframes = _airframes_or_files(_airframes())
    for action in _actions(parser):
        if "--airframe" in action.option_strings:
            action.complete = airframes  # type: ignore[attr-defined]
        elif not action.choices and any(sign in str(action.metavar) for sign in _FILE_SIGNS):
            action.complete = shtab.FILE  # type: ignore[attr-defined]
    return shtab.complete(parser, shell).rstrip() + "\n" + (_EQUALS if shell == "bash" else "")


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """What all commands take, flags left out. Each command gets its one line of help besides."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for entry in action._choices_actions:
                below = action.choices[entry.dest]
                below.description = entry.help  # shtab would show the description beside it
                yield from _actions(below)
        elif action.nargs != 0:
            yield action


def _airframes_or_files(names: Sequence[str]) -> dict[str, object]:
    """What shtab puts into each shell's script for `--airframe`: built-in names, and files."""
    words = " ".join(names)
    quoted = ", ".join(f"'{name}'" for name in names)
    name = f"_{PROGRAM.replace('-', '_')}_airframe_files"
    return {
        "bash": name,
        "zsh": name,
        "fish": f"{words} (__fish_complete_path (commandline -ct))",
        "powershell": name,
        "preamble": {
            "bash": f'{name}() {{ compgen -W "{words}" -- "$1"; compgen -f -- "$1"; }}',
            "zsh": f'{name}() {{ compadd "$@" {words}; _files "$@"; }}',
            "powershell": f"function {name} {{ param([string]$Word)\n"
            f'  {quoted} | Where-Object {{ $_ -like "$Word*" }}\n'
            "  _shtab_powershell_compgen_files $Word\n}",
        },
    }


def _airframes() -> list[str]:
    """Names of built-in airframes, without the module that reads them: NumPy takes its time."""
    folder = resources.files("gcs_sysid") / "model" / "airframes"
    return sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".toml"))
