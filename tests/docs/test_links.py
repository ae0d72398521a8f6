"""Links between pages, their anchors, and what the site's navigation names."""

import re

import pytest

from .pages import PAGES, ROOT, SITE_CONFIG, anchors, links, prose

# Made while the site is built, from the pages at the root.
_GENERATED = {
    ROOT / "docs" / "contributing.md": ROOT / "CONTRIBUTING.md",
    ROOT / "docs" / "changelog.md": ROOT / "CHANGELOG.md",
}

_REFERENCE = {"api.md", "commands.md", "parameters.md"}
"""Made by `tools/reference.py`."""
_EXPECTED = {"coach.md"}
"""Named in the navigation, written or not; `EXPECTED_PAGES` of `tools/docs_hooks.py`."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for target in links(page):
        assert not target.startswith(("http:", "https:", "/")), target
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        file = _GENERATED.get(file, file)
        assert file.exists(), f"{page.name}: {target}"
        if anchor:
            assert anchor in anchors(file), f"{page.name}: {target}"


def test_every_page_is_in_the_navigation_and_every_entry_is_a_page():
    navigation = SITE_CONFIG.read_text(encoding="utf-8").partition("\nnav:\n")[2]
    named = re.findall(r": (\S+\.md)$", navigation, re.MULTILINE)
    docs = ROOT / "docs"
    there = {page.relative_to(docs).as_posix() for page in PAGES if docs in page.parents}
    there |= {page.name for page in _GENERATED} | _REFERENCE
    assert sorted(named) == sorted(there | _EXPECTED)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages_name_no_place_of_one_machine(page):
    text = prose(page)
    assert not re.search(r"(?<![\w.])/(?:home|tmp|work|root|Users)/", text)
    assert not re.search(r"\bissue #?\d", text, re.IGNORECASE)
