"""The documentation's pages: their code blocks, links, headings."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SITE_CONFIG = ROOT / "mkdocs.yml"
PAGES = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md")))

_FENCE = re.compile(
    r"(?:<!-- (?P<directive>[a-z-]+)(?:: (?P<reason>[^>]+?))? -->\n)?"
    r"^```(?P<language>\w*)\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
_LINK = re.compile(r"\[[^\]]*\]\((?P<target>[^)\s]+)\)")
_HEADING = re.compile(r"^#{1,6} (?P<text>.+)$", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Attributes:
        line: of the page, where its text begins.
        language: behind the fence.
        text: within.
        directive: of a comment right above the fence: `no-run`, with a reason.
        reason: its reason.
    """

    line: int
    language: str
    text: str
    directive: str | None
    reason: str | None


def blocks(page: Path) -> Iterator[Block]:
    """The fenced blocks of a page."""
    text = page.read_text(encoding="utf-8")
    for found in _FENCE.finditer(text):
        yield Block(text.count("\n", 0, found.start("text")) + 1, found["language"], found["text"],
                    found["directive"], found["reason"])  # fmt: skip


def prose(page: Path) -> str:
    """A page without its fenced blocks."""
    return _FENCE.sub("", page.read_text(encoding="utf-8"))


def links(page: Path) -> list[str]:
    """Targets of the links and pictures of a page."""
    return [found["target"] for found in _LINK.finditer(prose(page))]


def anchors(page: Path) -> set[str]:
    """Names of a page's headings, as MkDocs and GitHub make them where they agree."""
    out: set[str] = set()
    for heading in _HEADING.finditer(prose(page)):
        text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading["text"]).lower()
        name = re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", text).strip())
        while name in out:
            name = re.sub(r"(?:_(\d+))?$", lambda m: f"_{int(m[1] or 0) + 1}", name, count=1)
        out.add(name)
    return out
