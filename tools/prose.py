"""Check the words that users read: spelling, and the words that the glossary replaced.

    python tools/prose.py

Reads README, CHANGELOG, the pages of docs/ and every command's help, without code. codespell, with
British spellings and `tools/replaced_words.txt` added to its dictionary, and proselint look at it,
both offline. One line each: file, line, what is wrong. Exit status 1 if there is any.
"""

import argparse
import itertools
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from gcs_sysid.cli.commands import build_parser

ROOT = Path(__file__).resolve().parents[1]
REPLACED = ROOT / "tools" / "replaced_words.txt"
"""As codespell's dictionaries: a word that the glossary replaced, ->, the word in its place."""
NAMES = "NED,SITL,PARM,fro,nd"
"""What codespell takes for misspelt: names, "to and fro", "2nd"."""
# Quotes, dashes and ellipses are those of a terminal; a log's résumé is none.
_OFF = ("typography", "dates_times", "spelling.consistency")


def prose(text: str) -> str:
    """A page without what is no prose; every line stays in its place."""

    def blank(match: re.Match[str]) -> str:
        return "\n" * match[0].count("\n")

    text = re.sub(r"^(```|~~~).*?^\1$", blank, text, flags=re.M | re.S)
    text = re.sub(r"<!--.*?-->", blank, text, flags=re.S)
    text = re.sub(r"^(    |\t).*$", "", text, flags=re.M)
    text = re.sub(r"\]\([^)\n]*\)|https?://\S+", "", text)
    text = re.sub(r"[-+±−]?\d[\d.,e]*", "#", text)
    # A name is a word of its own; a heading and a cell end a sentence.
    number = itertools.count()
    text = re.sub(r"`[^`\n]*`", lambda _: f"v{next(number)}", text)
    text = re.sub(r"^(#.*[a-z])$", r"\1.", text, flags=re.M)
    return re.sub(r"\|", ". ", text)


def help_texts(
    parser: argparse.ArgumentParser | None = None, name: str = "gcs-sysid"
) -> Iterator[tuple[str, str]]:
    """Command and help of the whole command line, as `gcs-sysid COMMAND --help` prints it."""
    parser = parser or build_parser()
    # Indents are argparse's: a column, or a line that goes on.
    text = re.sub(r"^ {3,}|^ +(?=-)", "", parser.format_help(), flags=re.M)
    yield name, re.sub(r"(?<=\S)  +|^ +", ". ", re.sub(r"(?<=[A-Z}])\n", ". ", text), flags=re.M)
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command, below in action.choices.items():
                yield from help_texts(below, f"{name}-{command}")


def pages() -> dict[str, str]:
    """Name -> text of all that is checked."""
    docs = sorted({*(ROOT / "docs").rglob("*.md")} - {ROOT / "docs" / "terms.md"})
    paths = [ROOT / "README.md", ROOT / "CHANGELOG.md", *docs]  # the terms name what they replace
    found = {path.name: prose(path.read_text("utf-8")) for path in paths}
    return found | {f"{name}.help": text for name, text in help_texts()}


def findings(texts: dict[str, str]) -> list[str]:
    """What both programs find, a line each."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for page, text in texts.items():
            (folder / page).write_text(text, encoding="utf-8")
        config = folder / "proselint.json"
        config.write_text(json.dumps({"checks": dict.fromkeys(_OFF, False)}))
        words = [sys.executable, "-m", "codespell_lib", "--builtin", "clear,rare,en-GB_to_en-US"]
        words += ["--dictionary", "-", "--dictionary", str(REPLACED), "--ignore-words-list", NAMES]
        style = [sys.executable, "-m", "proselint", "check", "--config", str(config)]
        lines = []
        for command in (words, style):
            asked = [*command, *sorted(texts)]
            done = subprocess.run(asked, cwd=folder, capture_output=True, text=True, check=False)
            if done.returncode not in (0, 1, 65):
                raise SystemExit(f"{command[2]}: {done.stderr.strip()}")
            lines += done.stdout.splitlines()
    return [line.replace(f"{folder}/", "").removeprefix("./") for line in lines if line.strip()]


def main() -> int:
    """Print what is found."""
    found = findings(pages())
    print("\n".join(found) or "prose: nothing found")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
