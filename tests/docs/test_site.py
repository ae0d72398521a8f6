"""The site as `make docs` builds it: strict, and without anything from elsewhere."""

import re
import subprocess
import sys

import pytest

from .pages import ROOT

pytest.importorskip("material", reason="needs mkdocs-material")
pytest.importorskip("latex2mathml", reason="needs latex2mathml")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    return folder


def test_nothing_is_loaded_from_elsewhere(site):
    loads = re.compile(r"<(?:script|img|iframe|link)\b[^>]*\b(?:src|href)=\"?(https?:)?//[^>]*>")
    for page in site.rglob("*.html"):
        found = loads.search(page.read_text(encoding="utf-8"))
        assert found is None, f"{page.name}: {found[0]}"
    for style in site.rglob("*.css"):
        assert not re.search(r"url\(\"?https?:|@import", style.read_text(encoding="utf-8"))


def test_formulas_are_mathml(site):
    pages = [site / "method.html", *sorted((site / "method").glob("*.html"))]
    method = "".join(page.read_text(encoding="utf-8") for page in pages)
    assert method.count("<math ") >= 8
    assert method.count('<mtable class="matrix">') >= 3
    assert "\\begin{" not in method
    for page in site.rglob("*.html"):
        assert "<merror" not in page.read_text(encoding="utf-8")


def test_the_search_finds_a_word_from_the_disk(site, browser):
    wrong = []
    page = browser.new_page()
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("request", lambda r: wrong.append(r.url) if r.url.startswith("http") else None)
    page.goto((site / "index.html").as_uri())
    query = page.get_by_placeholder("Search")
    query.click()
    query.press_sequentially("gyroscopic")
    page.locator(".md-search-result__item").first.wait_for()
    found = page.locator(".md-search-result__list").inner_text()
    page.close()
    assert "Results" in found
    assert wrong == []


@pytest.mark.parametrize(
    ("width", "scheme"),
    [
        pytest.param(390, "light", marks=pytest.mark.thorough),
        pytest.param(1280, "dark", marks=pytest.mark.thorough),
        pytest.param(390, "dark", marks=pytest.mark.thorough),
        pytest.param(1280, "light", marks=pytest.mark.thorough),
    ],
)
def test_pages_fit_the_window(site, browser, width, scheme):
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page = context.new_page()
    wide = []
    for file in sorted(site.rglob("*.html")):
        page.goto(file.as_uri())
        root = "document.documentElement"
        if page.evaluate(f"{root}.scrollWidth > {root}.clientWidth"):
            wide.append(file.name)
    shown = page.evaluate("document.body.dataset.mdColorScheme")
    context.close()
    assert wide == []
    assert shown == {"light": "default", "dark": "slate"}[scheme]
