"""What the documentation's site needs beyond MkDocs: formulas as MathML, pages from the root.

Fenced blocks marked `math` hold LaTeX, which GitHub shows as well. Here they become MathML while
the site is built, so that browsers need no script and no fonts from elsewhere.
"""

import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from markdown import Markdown
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT_PAGES = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
"""Pages that lie at the project's root, and their names on the site."""

_MATRIX = re.compile(r"<mo[^>]*>&#x0005B;</mo><mtable>(.*?)</mtable><mo[^>]*>&#x0005D;</mo>")
"""Brackets stretch with a mathematical font alone, which not every system has: those of matrices
are drawn by the style sheet."""


def math_fence(
    source: str, _language: str, _class: str, _options: dict[str, Any], _md: Markdown, **_: Any
) -> str:
    """A block of LaTeX as MathML."""
    formula = _MATRIX.sub(r'<mtable class="matrix">\1</mtable>', convert(source, display="block"))
    return f'<div class="math">{formula}</div>'


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Show `math` blocks as formulas."""
    fences = config.mdx_configs.setdefault("pymdownx.superfences", {})
    fences["custom_fences"] = [{"name": "math", "class": "math", "format": math_fence}]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages from the project's root; their links are seen from there."""
    root = Path(config.docs_dir).parent
    for name, page in ROOT_PAGES.items():
        text = (root / name).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=re.sub(r"\]\(docs/", "](", text)))
    return files
