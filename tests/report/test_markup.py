"""Text is text, whatever it says."""

import html

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcs_sysid.report.parts import Markup, element, escaped, joined

from .reading import Page


@given(st.text())
def test_any_text_stays_text(text):
    shown = Page(element("p", text, title=text), plain=False).one("p")
    kept = html.unescape(escaped(text)).replace("\r\n", "\n").replace("\r", "\n")
    assert shown.text.replace("\r\n", "\n").replace("\r", "\n") == kept
    assert shown.attributes["title"] == html.unescape(escaped(text))


def test_markup_is_not_escaped_twice():
    assert element("p", element("b", "a < b"), "&", None) == "<p><b>a &lt; b</b>&amp;</p>"
    assert joined("<", Markup("<br>")) == "&lt;<br>"


@pytest.mark.parametrize("char", ["\x00", "\x1b", "\u202e", "\x85", "\udc80"])
def test_what_would_not_be_seen_is_shown(char):
    assert escaped(f"a{char}b") in ("a\N{REPLACEMENT CHARACTER}b", "a?b")
