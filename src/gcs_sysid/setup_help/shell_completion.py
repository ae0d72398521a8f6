"""Scripts that complete a command line with the tab key, made from its parser.

The scripts hold all they need, so that a press of the key starts no Python.
"""

import argparse
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Option:
    """An option of a command.

    Attributes:
        flags: all ways to write it.
        help: one line.
        takes: whether a value follows.
        values: what that can be, as far as that is known; files are always possible besides.
    """

    flags: Sequence[str]
    help: str
    takes: bool
    values: Sequence[str]


@dataclass(frozen=True)
class Command:
    """A command, with its own commands.

    Attributes:
        words: to type before its options; none for the program itself.
        help: one line.
        options: of this command.
        values: of its arguments without a flag, as far as that is known.
        commands: below it.
    """

    words: tuple[str, ...]
    help: str
    options: Sequence[Option]
    values: Sequence[str]
    commands: "Sequence[Command]"

    def walk(self) -> "Iterator[Command]":
        """The command itself and all below."""
        yield self
        for command in self.commands:
            yield from command.walk()


def commands_of(
    parser: argparse.ArgumentParser,
    airframes: Sequence[str],
    words: tuple[str, ...] = (),
    line: str = "",
) -> Command:
    """A parser as a tree of commands.

    Args:
        parser: of the command line.
        airframes: names that `--airframe` takes besides files.
        words: of the command that the parser is for.
        line: its help.
    """
    options, values, below = [], [], []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            below = [
                commands_of(
                    action.choices[entry.dest], airframes, (*words, entry.dest), entry.help or ""
                )
                for entry in action._choices_actions
            ]
        elif action.option_strings:
            chosen = airframes if "--airframe" in action.option_strings else action.choices
            options.append(
                Option(
                    tuple(action.option_strings),
                    _line(action.help),
                    action.nargs != 0,
                    tuple(map(str, chosen or ())),
                )
            )
        else:
            values += list(map(str, action.choices or ()))
    return Command(words, line, options, values, below)


def _line(text: str | None) -> str:
    """Help as one short line, without what the parser would fill in."""
    plain = re.sub(r"%\(\w+\)\w", "", text or "").replace("%%", "%")
    return re.sub(r"\s+", " ", plain).strip()[:100]


def script(shell: str, program: str, root: Command) -> str:
    """The script for a shell: bash, zsh or fish."""
    return {"bash": _bash, "zsh": _zsh, "fish": _fish}[shell](program, root)


_HEAD = "# Completion of {program} for {shell}, made by: {program} completion {shell}\n"


def _function(program: str) -> str:
    return "_" + re.sub(r"\W", "_", program)


def _bash(program: str, root: Command) -> str:
    """Words for the command that has been typed so far; else readline's own file names."""
    name = _function(program)
    known, cases, values = [], [], []
    for command in root.walk():
        path = " ".join(command.words)
        if path:
            known.append(f'"{path}"')
        flags = " ".join(flag for option in command.options for flag in option.flags)
        first = " ".join([*(below.words[-1] for below in command.commands), *command.values])
        cases.append(f'    "{path}") options="{flags}"; words="{first}" ;;')
        for option in command.options:
            # Of a value that can be anything, readline completes a file's name by itself.
            if option.takes and (option.values or first):
                pattern = "|".join(f'"{path} {flag}"' for flag in option.flags)
                values.append(f'    {pattern}) words="{" ".join(option.values)}"; options="" ;;')
    return (
        _HEAD.format(program=program, shell="bash")
        + f"""\
{name}() {{
  local cur="${{COMP_WORDS[COMP_CWORD]}}" prev="" path="" options="" words="" word i
  (( COMP_CWORD > 0 )) && prev="${{COMP_WORDS[COMP_CWORD-1]}}"
  # --flag=value comes in three words.
  if [[ "$cur" == "=" ]]; then cur=""
  elif [[ "$prev" == "=" ]]; then prev="${{COMP_WORDS[COMP_CWORD-2]}}"; fi
  for (( i = 1; i < COMP_CWORD; i++ )); do
    word="${{path:+$path }}${{COMP_WORDS[i]}}"
    case "$word" in
    {"|".join(known)}) path="$word" ;;
    esac
  done
  case "$path" in
{chr(10).join(cases)}
  esac
  case "$path $prev" in
{chr(10).join(values)}
  esac
  if [[ "$cur" == -* ]]; then words="$options"; fi
  COMPREPLY=( $(compgen -W "$words" -- "$cur") )
}}
complete -o bashdefault -o default -F {name} {program}
"""
    )


def _zsh(program: str, root: Command) -> str:
    name = _function(program)
    cases = []
    for command in root.walk():
        specs = [_zsh_option(option) for option in command.options]
        if command.commands:
            entries = " ".join(
                _zsh_quote(f"{below.words[-1]}:{below.help}") for below in command.commands
            )
            first = f"commands=({entries}); _describe command commands"
        else:
            first = f"compadd -- {' '.join(command.values)}" if command.values else "_files"
        cases.append(
            f"    {_zsh_quote(' '.join(command.words))})\n"
            f"      specs=({' '.join(specs)})\n"
            f"      first={_zsh_quote(first)} ;;"
        )
    known = "|".join(_zsh_quote(" ".join(c.words)) for c in root.walk() if c.words)
    return (
        f"#compdef {program}\n"
        + _HEAD.format(program=program, shell="zsh")
        + f"""\
{name}() {{
  local so_far="" word first i context state state_descr line
  local -a specs commands
  for (( i = 2; i < CURRENT; i++ )); do
    word="${{so_far:+$so_far }}${{words[i]}}"
    case "$word" in
    {known}) so_far="$word" ;;
    esac
  done
  case "$so_far" in
{chr(10).join(cases)}
  esac
  _arguments -S $specs '*:argument:->rest' && return
  [[ $state == rest ]] && eval "$first"
}}
if [[ "$zsh_eval_context[-1]" == loadautofunc ]]; then
  {name} "$@"
else
  compdef {name} {program}
fi
"""
    )


def _zsh_option(option: Option) -> str:
    text = re.sub(r"([\[\]:\\])", r"\\\1", option.help)
    rest = ""
    if option.takes:
        # A braced action is evaluated; known words beside files.
        words = f"compadd -- {' '.join(option.values)}; " if option.values else ""
        rest = f":value:{{{words}_files}}"
    return " ".join(_zsh_quote(f"*{flag}[{text}]{rest}") for flag in option.flags)


def _zsh_quote(text: str) -> str:
    return "'" + text.replace("'", "'\\''") + "'"


def _fish(program: str, root: Command) -> str:
    lines = [_HEAD.format(program=program, shell="fish")]
    for command in root.walk():
        path = command.words
        when = [f"__fish_seen_subcommand_from {word}" for word in path]
        below = " ".join(c.words[-1] for c in command.commands)
        here = "; and ".join(when) if when else "__fish_use_subcommand"
        if below and when:
            here += f"; and not __fish_seen_subcommand_from {below}"
        start = f"complete -c {program} -n {_fish_quote(here)}"
        for inner in command.commands:
            help_text = _fish_quote(inner.help)
            lines.append(f"{start} -f -a {inner.words[-1]} -d {help_text}")
        if command.values:
            lines.append(f"{start} -f -a {_fish_quote(' '.join(command.values))}")
        for option in command.options:
            words = [
                f"-{'l' if flag.startswith('--') else 's'} {flag.lstrip('-')}"
                for flag in option.flags
            ]
            if option.takes:
                words.append("-r")
                if option.values:
                    words.append(f"-a {_fish_quote(' '.join(option.values))}")
            lines.append(f"{start} {' '.join(words)} -d {_fish_quote(option.help)}")
    return "\n".join(lines) + "\n"


def _fish_quote(text: str) -> str:
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"
