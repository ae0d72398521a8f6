"""The parts of the metadata that pyproject.toml cannot hold: addresses, and a README without them.

A package index does not resolve the README's relative links. GCS_SYSID_URL, the project's address
as the publisher has it, makes them whole (pictures too, where GCS_SYSID_RAW_URL is given for them)
and gives the project's URLs. Without it pictures are left out and links become their text.
"""

import os
import re
from pathlib import Path

from setuptools import setup

ROOT = Path(__file__).parent
URL = os.environ.get("GCS_SYSID_URL", "").rstrip("/")
RAW_URL = os.environ.get("GCS_SYSID_RAW_URL", "").rstrip("/")
_LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!https?:|#|mailto:)([^)\s]+)\)")


def _whole(found: re.Match[str]) -> str:
    picture, text, path = found.groups()
    if picture:
        return f"![{text}]({RAW_URL}/{path})" if RAW_URL else ""
    return f"[{text}]({URL}/{path})" if URL else text


def readme() -> str:
    """README.md as a page that can stand anywhere."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    text = _LINK.sub(_whole, text)
    text = re.sub(r"<!--.*?-->\n?", "", text, flags=re.DOTALL)
    return re.sub(r"\n{3,}", "\n\n", text)


setup(
    long_description=readme(),
    long_description_content_type="text/markdown",
    project_urls={"Repository": URL} if URL else {},
)
