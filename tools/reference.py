"""Reference pages of the documentation, from the docstrings and the parser of the command line.

    python tools/reference.py commands
    python tools/reference.py api
    python tools/reference.py parameters

prints a page; `make docs` puts them into the site (`tools/docs_hooks.py`). Examples in the
docstrings are run by `pytest tests/docs/test_docstrings.py`.
"""

import argparse
import ast
import inspect
import re
import sys
import textwrap
from typing import Any

import gcs_sysid
from gcs_sysid.cli.commands import COMMANDS, build_parser
from gcs_sysid.model.parameters import ARM, REGISTRY, Parameter
from gcs_sysid.model.rotor_input import RotorInput

_SECTION = re.compile(r"^(Args|Attributes|Returns|Raises|Example|Examples):$", re.MULTILINE)
_ENTRY = re.compile(r"^(\*{0,2}\w[\w.]*): ")
_SIGNS = re.compile(r"([<>*_|])")
_WIDTH = 92


def commands_page() -> str:
    """Every command of `gcs-sysid` with its arguments and options, in Markdown."""
    parser = build_parser()
    (commands,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    lines = [
        "# Commands",
        "",
        "All that `gcs-sysid COMMAND --help` says, generated from the parser. Exit status: 0 done; "
        "1 the data do not allow an answer; 2 wrong usage or unreadable input.",
        "",
        "| command | does |",
        "|---|---|",
        *(
            f"| [`{command.name}`](#{command.name}) | {_plain(command.summary)} |"
            for command in COMMANDS
        ),
        "",
    ]
    for command in COMMANDS:
        lines += _command(command.name, commands.choices[command.name])
    return "\n".join(lines)


def _command(name: str, command: argparse.ArgumentParser) -> list[str]:
    usage = " ".join(command.format_usage().removeprefix("usage: ").split())
    folded = textwrap.fill(usage, _WIDTH, subsequent_indent="    ", break_on_hyphens=False)
    lines = [f"## {name}", "", _plain(command.description or ""), "", "```text", folded, "```", ""]
    formatter = command._get_formatter()
    for group in command._action_groups:
        shown = [a for a in group._group_actions if a.help is not argparse.SUPPRESS]
        shown = [a for a in shown if not isinstance(a, argparse._HelpAction)]
        if not shown:
            continue
        title = (group.title or "").rstrip(":")
        lines += [f"**{title[:1].upper()}{title[1:]}**", ""]
        if group.description:
            lines += [_plain(group.description), ""]
        for action in shown:
            said = formatter._expand_help(action) if action.help else ""
            lines.append(f"- {_called(action)}: {_plain(said)}".rstrip(": "))
        lines.append("")
    return lines


def _called(action: argparse.Action) -> str:
    """How an argument is written, as code."""
    value = action.metavar or action.dest.upper()
    if isinstance(value, tuple):
        value = " ".join(value)
    if action.choices is not None and action.metavar is None:
        value = "{" + ",".join(map(str, action.choices)) + "}"
    if not action.option_strings:
        return f"`{value}`"
    words = f" {value}" if action.nargs != 0 else ""
    return ", ".join(f"`{flag}{words}`" for flag in action.option_strings)


def api_page() -> str:
    """Every public name of `gcs_sysid` with its signature and docstring, in Markdown."""
    public = {name: getattr(gcs_sysid, name) for name in gcs_sysid.__all__}
    functions = {n: each for n, each in public.items() if inspect.isfunction(each)}
    classes = {n: each for n, each in public.items() if inspect.isclass(each)}
    lines = [
        "# Python reference",
        "",
        "What `import gcs_sysid` offers, generated from the docstrings; how to use it is told "
        "under [Python and notebooks](python.md). Units are SI, body axes forward, right, down.",
        "",
    ]
    for name in sorted(functions):
        lines += [
            f"## {name}",
            "",
            *_callable(name, functions[name]),
            *_documented(functions[name]),
        ]
    for name in sorted(classes):
        lines += _class(name, classes[name])
    return "\n".join(lines)


def _class(name: str, each: type) -> list[str]:
    lines = [f"## {name}", "", *_documented(each)]
    for member, value in vars(each).items():
        if member.startswith("_"):
            continue
        if isinstance(value, staticmethod | classmethod):
            value = value.__func__
        if isinstance(value, property) or type(value).__name__ == "cached_property":
            doc = inspect.getdoc(value) or ""
            lines += [f"### {name}.{member}", "", *_markdown(doc)]
        elif inspect.isfunction(value):
            shown = f"{name}.{member}"
            lines += [f"### {shown}", "", *_callable(shown, value), *_documented(value)]
    return lines


def _callable(name: str, function: Any) -> list[str]:
    """A signature as the source has it, folded where it is long."""
    (node,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    assert isinstance(node, ast.FunctionDef)
    given = node.args
    own = {"self", "cls"} & {a.arg for a in given.args[:1]}
    if own:
        del given.args[0]
    back = " -> " + ast.unparse(node.returns).strip("'") if node.returns else ""
    told = re.sub(r"(: [^=,]+(?:\[[^=]*\])?[^=,]*)=", r"\1 = ", ast.unparse(given))
    line = f"{name}({told}){back}"
    if len(line) > _WIDTH:
        # At the commas between arguments, not at those within brackets.
        words = re.sub(r",\s(?![^\[(]*[\])])", ",\n    ", told)
        line = f"{name}(\n    {words},\n){back}"
    return ["```python", line, "```", ""]


def _documented(each: Any) -> list[str]:
    return _markdown(inspect.getdoc(each) or "")


def _markdown(doc: str) -> list[str]:
    """A docstring of Google's form as Markdown."""
    parts = _SECTION.split(doc)
    lines = _prose(parts[0])
    for title, body in zip(parts[1::2], parts[2::2], strict=True):
        text = textwrap.dedent(body.strip("\n"))
        lines += [f"**{title}**", ""]
        if title.startswith("Example"):
            lines += _prose(text)
        elif title == "Returns":
            lines += [_plain(" ".join(text.split())), ""]
        else:
            lines += [*_entries(text), ""]
    return lines


def _entries(text: str) -> list[str]:
    """`name: what it is` as a list; lines that are indented go on."""
    out: list[str] = []
    for line in text.splitlines():
        found = _ENTRY.match(line)
        if found:
            out.append(f"- `{found[1]}`: {_plain(line[found.end() :])}")
        elif line.strip() and out:
            out[-1] += f" {_plain(line.strip())}"
    return out


def _prose(text: str) -> list[str]:
    """Paragraphs; indented ones are equations, and `>>>` begins an example."""
    lines: list[str] = []
    for block in re.split(r"\n\s*\n", text.strip("\n")):
        if not block.strip():
            continue
        head, told = block, ""
        if ">>>" in block:
            begin = block.index(">>>")
            head, told = block[:begin], textwrap.dedent(block[begin:])
        if head.startswith("    "):
            lines += ["```text", textwrap.dedent(head).rstrip(), "```", ""]
        elif head.strip():
            lines += [_plain(" ".join(head.split())), ""]
        if told:
            lines += ["```pycon", told.rstrip(), "```", ""]
    return lines


def _plain(text: str) -> str:
    """Text whose signs mean nothing in Markdown, but for code in backquotes."""
    parts = re.split(r"(`[^`]*`)", text)
    parts[::2] = [_SIGNS.sub(r"\\\1", part) for part in parts[::2]]
    return "".join(parts)


def parameters_page() -> str:
    """Every parameter of `model.parameters`, in the order of results."""
    lines = [
        "# Parameters",
        "",
        "All that can be identified, in the order of results, screens and files. A status is the "
        "standard deviation over the [reference value](result.md#status); a prior is given in the "
        "[airframe file](airframe.md#priors).",
        "",
        "| name | symbol | unit | meaning | shown by | reference value | prior |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| `{name}` | {_plain(p.symbol)} | {p.unit.replace('^2', '²')} | {_plain(_meaning(p))} "
        f"| {p.excited_by} | {_plain(_reference_value(p))} | {'yes' if p.prior else ''} |"
        for name, p in REGISTRY.items()
    ]
    return "\n".join(lines)


def _meaning(parameter: Parameter) -> str:
    if parameter.label:
        return f"{parameter.meaning}; `{parameter.label}` on the live screen"
    if parameter.optional:
        return f"{parameter.meaning}, where the flight shows it"
    only = [kind.words for kind in RotorInput if kind in parameter.inputs]
    every = len(only) == len(RotorInput) or parameter.theta == parameter.name
    return parameter.meaning if every else f"{parameter.meaning} (with {' or '.join(only)})"


def _reference_value(parameter: Parameter) -> str:
    reference = parameter.reference
    if reference.fixed:
        return f"{reference.fixed:g} {parameter.unit}".removesuffix(" 1")
    if not reference.of:
        return "the value"
    names = [name if name != ARM else "the arm" for name in reference.of]
    what = names[0] if len(names) == 1 else f"the geometric mean of {' and '.join(names)}"
    size = what if reference.share == 1.0 else f"{reference.share:g} of {what}"
    return f"the value, or {size} in SI if larger" if reference.or_value else size


PAGES = {"commands.md": commands_page, "api.md": api_page, "parameters.md": parameters_page}
"""Names on the site."""


def main() -> int:
    """Print a page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("page", choices=[name.removesuffix(".md") for name in PAGES])
    print(PAGES[f"{parser.parse_args().page}.md"]())
    return 0


if __name__ == "__main__":
    sys.exit(main())
