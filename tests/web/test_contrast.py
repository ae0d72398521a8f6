"""Contrasts of the page's and the screen's themes, by WCAG 2.2: AA is 4.5 for text, 3 for signs."""

import itertools
import re

import pytest
from textual.color import Color

from gcs_sysid.results.words import CHANGE, STATUS, VERDICT, WAITING
from gcs_sysid.web.site import asset

TEXT, SIGN = 4.5, 3.0
_BLOCK = re.compile(r"(:root[^{]*)\{([^}]*)\}")
_COLOR = re.compile(r"--([\w-]+): (#[0-9a-f]{6});")


def luminance(color):
    """WCAG 2.2, relative luminance; the color opaque."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in color.normalized]
    return sum(weight * c for weight, c in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


def contrast(one, other):
    bright, dim = sorted((luminance(one), luminance(other)), reverse=True)
    return (bright + 0.05) / (dim + 0.05)


def page_themes():
    return {
        re.search(r'"(\w+)"', heads)[1]: {n: Color.parse(v) for n, v in _COLOR.findall(body)}
        for heads, body in _BLOCK.findall(asset("page.css", "web"))
    }


def test_the_measure_is_that_of_the_standard():
    assert contrast(Color.parse("#000000"), Color.parse("#ffffff")) == pytest.approx(21.0)
    assert contrast(Color.parse("#777777"), Color.parse("#ffffff")) == pytest.approx(4.48, abs=0.01)


GROUNDS = ("page", "card", "tint")
WORDS = ("ink", "soft", "accent", "good", "warn", "bad")


@pytest.mark.parametrize("name", ["light", "dark", "sun"])
def test_the_pages_text_can_be_read(name):
    theme = page_themes()[name]
    pairs = [*itertools.product(WORDS, GROUNDS), ("on-accent", "accent"), ("card", "ink")]
    pairs += [("ink", "fill")]
    low = {pair: c for pair in pairs if (c := contrast(*(theme[n] for n in pair))) < TEXT}
    assert low == {}
    # Edges of what is touched, lines of the plot, bars.
    signs = [("edge", ground) for ground in GROUNDS]
    signs += [("accent", "card"), ("accent", "band"), ("ink", "band")]
    faint = {pair: c for pair in signs if (c := contrast(*(theme[n] for n in pair))) < SIGN}
    assert faint == {}
    if name == "sun":  # outdoors AAA is wanted
        strong = itertools.product(WORDS, ("page", "card"))
        assert min(contrast(theme[word], theme[ground]) for word, ground in strong) >= 7.0


def test_the_pages_colors_are_all_the_themes():
    """None stands elsewhere in the style sheet, where no theme and no test would see it."""
    css = _BLOCK.sub("", asset("page.css", "web"))
    assert set(re.findall(r"#[0-9a-fA-F]{3,8}\b", css)) == {"#000a", "#fff"}
    names = {name for theme in page_themes().values() for name in theme}
    assert set(re.findall(r"var\(--([\w-]+)\)", css)) <= names


def test_color_is_never_alone():
    """Every state has a sign of its own, and a word with it."""
    for table in (STATUS, VERDICT, CHANGE):
        signs = [word.sign for word in table.values()]
        assert len(set(signs)) == len(signs)
        assert all(word.meaning for word in table.values())
    assert WAITING.sign not in {word.sign for word in STATUS.values()}
