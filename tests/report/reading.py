"""Reads a page as a browser would, strictly."""

import json
import re
from dataclasses import dataclass
from html.parser import HTMLParser
from typing import Any

VOID = {"meta", "br", "hr", "col"}


@dataclass
class Element:
    """One element of a page, with the text that it holds."""

    name: str
    attributes: dict[str, str | None]
    parents: tuple["Element", ...]
    text: str = ""


class Page(HTMLParser):
    """A page taken apart; fails where elements do not close in order.

    Args:
        html: the page.
        plain: whether spaces that do not break are read as spaces.
    """

    def __init__(self, html: str, *, plain: bool = True) -> None:
        super().__init__()
        self._plain = plain
        self.html = html
        self.elements: list[Element] = []
        self._open: list[Element] = []
        self.feed(html)
        self.close()
        assert not self._open, f"never closed: {self._open}"

    def handle_starttag(self, tag, attrs):
        names = [name for name, _ in attrs]
        assert len(names) == len(set(names)), f"twice an attribute of {tag}: {names}"
        element = Element(tag, dict(attrs), tuple(self._open))
        self.elements.append(element)
        if tag not in VOID:
            self._open.append(element)

    def handle_endtag(self, tag):
        assert self._open, f"</{tag}> closes nothing"
        assert self._open.pop().name == tag

    def handle_data(self, data):
        if self._plain:
            data = data.replace("\N{NO-BREAK SPACE}", " ")
        for element in self._open:
            element.text += data

    def all(self, name, **attributes):
        return [
            e
            for e in self.elements
            if e.name == name and all(e.attributes.get(k) == v for k, v in attributes.items())
        ]

    def one(self, name, **attributes):
        (found,) = self.all(name, **attributes)
        return found

    @property
    def data(self) -> dict[str, Any]:
        return json.loads(self.one("script", id="data").text)

    @property
    def words(self) -> str:
        """The text of the page, without style and scripts."""
        return re.sub(r"\s+", " ", self.one("header").text + self.one("main").text)
