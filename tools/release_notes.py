"""The notes of a release, from CHANGELOG.md.

    python tools/release_notes.py VERSION [-o FILE]
    python tools/release_notes.py VERSION --cut YYYY-MM-DD

Prints the version's section, or before it is cut what stands under Unreleased, headings of one name
joined. --cut dates that section, and puts the version into the package and CITATION.cff.
"""

import argparse
import re
import sys
from collections.abc import Sequence
from datetime import date
from pathlib import Path

ROOT = Path(__file__).parents[1]
CHANGELOG, PACKAGE, CITATION = "CHANGELOG.md", "src/gcs_sysid/__init__.py", "CITATION.cff"
UNRELEASED = "Unreleased"
ORDER = ("Added", "Changed", "Deprecated", "Removed", "Fixed", "Security")


def sections(text: str) -> dict[str, str]:
    """Heading -> body of each second-level section, in order."""
    found = re.split(r"^## (.+)\n", text, flags=re.MULTILINE)[1:]
    return {
        head.strip(): body.strip("\n") for head, body in zip(found[::2], found[1::2], strict=True)
    }


def notes(text: str, version: str) -> str:
    """The notes of a version.

    Raises:
        ValueError: the changelog has neither the version nor anything unreleased.
    """
    by_head = sections(text)
    body = next((b for h, b in by_head.items() if h.partition(" ")[0] == version), "")
    body = body or by_head.get(UNRELEASED, "")
    if not body.strip():
        raise ValueError(f"{CHANGELOG} has no section {version} and nothing under {UNRELEASED}")
    lead, *parts = re.split(r"^### (.+)\n", body, flags=re.MULTILINE)
    joined: dict[str, list[str]] = {}
    for head, part in zip(parts[::2], parts[1::2], strict=True):
        entries = re.sub(r"\n{2,}(?=- )", "\n", part.strip())
        joined.setdefault(head.strip(), []).append(entries)
    heads = sorted(joined, key=lambda h: ORDER.index(h) if h in ORDER else len(ORDER))
    # Links of the changelog are relative to the repository; notes are read elsewhere.
    whole = [f"# gcs-sysid {version}", lead.strip()]
    whole += [f"## {head}\n" + "\n".join(joined[head]) for head in heads]
    text = "\n\n".join(part for part in whole if part) + "\n"
    return re.sub(r"\[([^\]]+)\]\((?!https?:)[^)]+\)", r"\1", text)


def cut(root: Path, version: str, day: date) -> None:
    """Date the unreleased section and set the version everywhere.

    Raises:
        ValueError: there is nothing to release, or the version exists.
    """
    changelog = root / CHANGELOG
    text = changelog.read_text(encoding="utf-8")
    by_head = sections(text)
    if any(head.partition(" ")[0] == version for head in by_head):
        raise ValueError(f"{CHANGELOG} has a section {version} already")
    if not by_head.get(UNRELEASED, "").strip():
        raise ValueError(f"{CHANGELOG} has nothing under {UNRELEASED}")
    edits = {
        CHANGELOG: (rf"^## {UNRELEASED}\n", f"## {UNRELEASED}\n\n## {version} - {day}\n"),
        PACKAGE: (r'^__version__ = ".*"', f'__version__ = "{version}"'),
        CITATION: (r"^version: .*", f"version: {version}\ndate-released: {day}"),
    }
    written = {}
    for name, (pattern, new) in edits.items():
        old = (root / name).read_text(encoding="utf-8")
        old = re.sub(r"^date-released:.*\n", "", old, flags=re.MULTILINE)
        written[name], count = re.subn(pattern, new, old, count=1, flags=re.MULTILINE)
        if not count:
            raise ValueError(f"{name} has no line like {pattern}")
    for name, new in written.items():
        (root / name).write_text(new, encoding="utf-8", newline="\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Print or cut."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("version", metavar="VERSION")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE")
    parser.add_argument("--cut", type=date.fromisoformat, metavar="YYYY-MM-DD")
    options = parser.parse_args(argv)
    try:
        if not re.fullmatch(r"\d+\.\d+\.\d+((a|b|rc)\d+)?", options.version):
            raise ValueError(f"{options.version}: a version is like 0.2.0 or 0.2.0rc1")
        if options.cut:
            cut(ROOT, options.version, options.cut)
        text = notes((ROOT / CHANGELOG).read_text(encoding="utf-8"), options.version)
        if options.output:
            options.output.write_text(text, encoding="utf-8", newline="\n")
        else:
            print(text, end="")
    except (ValueError, OSError) as error:
        print(f"release_notes: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
