"""What the documentation's site needs beyond MkDocs: formulas, the reference, pages from the root.

Fenced blocks marked `math` hold LaTeX, which GitHub shows as well. Here they become MathML while
the site is built, so that browsers need no script and no fonts from elsewhere.
"""

import re
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from markdown import Markdown
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT_PAGES = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
"""Pages that lie at the project's root, and their names on the site."""

_OFF_SITE = re.compile(r"\[([^]\n]+)\]\(((?:benchmarks|tools)/[^)\s]+)\)")
"""Links of those pages to what the project has and the site has not: there the path is named."""

EXPECTED_PAGES = ("coach.md",)
"""Pages that the navigation names already, written or not."""

FORMULA_PAGES = ("method.md", "errata.md", "glossary.md")
"""Pages whose text is full of symbols, as are those below `method`."""
_CODE = re.compile(r"(^```.*?^```$|`[^`\n]+`)", re.MULTILINE | re.DOTALL)
_SYMBOL = re.compile(r"(?<![\w/])([A-Za-zΩω])_(cg|max|[a-zA-Z]{1,2}|\d)(?![A-Za-z0-9_])")

_MATRIX = re.compile(r"<mo[^>]*>&#x0005B;</mo><mtable>(.*?)</mtable><mo[^>]*>&#x0005D;</mo>")
"""Brackets stretch with a mathematical font alone, which not every system has: those of matrices
are drawn by the style sheet."""


def math_fence(
    source: str, _language: str, _class: str, _options: dict[str, Any], _md: Markdown, **_: Any
) -> str:
    """A block of LaTeX as MathML."""
    formula = _MATRIX.sub(r'<mtable class="matrix">\1</mtable>', convert(source, display="block"))
    return f'<div class="math">{formula}</div>'


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Set the indices of symbols as indices, on the pages about the method, outside of code."""
    uri = page.file.src_uri
    if uri not in FORMULA_PAGES and not uri.startswith("method/"):
        return markdown
    parts = _CODE.split(markdown)
    parts[::2] = [_SYMBOL.sub(r"\1<sub>\2</sub>", part) for part in parts[::2]]
    return "".join(parts)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Show `math` blocks as formulas; leave out of the navigation what is not written yet."""
    config.nav = _written(config.nav or [], Path(config.docs_dir))
    fences = config.mdx_configs.setdefault("pymdownx.superfences", {})
    fences["custom_fences"] = [{"name": "math", "class": "math", "format": math_fence}]
    return config


def _written(entries: list[Any], docs: Path) -> list[Any]:
    """The navigation's entries without the expected pages that are not there."""
    out: list[Any] = []
    for entry in entries:
        ((title, target),) = entry.items()
        if isinstance(target, list):
            out.append({title: _written(target, docs)})
        elif target not in EXPECTED_PAGES or (docs / target).is_file():
            out.append(entry)
    return out


def _reference() -> dict[str, Callable[[], str]]:
    """The pages of `tools/reference.py`: hooks are loaded without what is beside them."""
    found = spec_from_file_location("reference", Path(__file__).with_name("reference.py"))
    assert found is not None
    assert found.loader is not None
    module = module_from_spec(found)
    found.loader.exec_module(module)
    pages: dict[str, Callable[[], str]] = module.PAGES
    return pages


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the reference, and the pages from the project's root; their links are seen from there."""
    root = Path(config.docs_dir).parent
    for name, page in ROOT_PAGES.items():
        text = re.sub(r"\]\(docs/", "](", (root / name).read_text(encoding="utf-8"))
        for other, its_page in ROOT_PAGES.items():
            text = text.replace(f"]({other}", f"]({its_page}")
        text = _OFF_SITE.sub(r"\1 (`\2`)", text)
        files.append(File.generated(config, page, content=text))
    for name, page in _reference().items():
        files.append(File.generated(config, name, content=page()))
    return files
