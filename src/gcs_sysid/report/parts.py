"""Building blocks that several sections use.

HTML is escaped by construction: text is text unless it was made here.
"""

import base64
import hashlib
import html
import re
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from typing import Literal

_VOID = frozenset({"meta", "br", "hr", "col"})
_ATTRIBUTE = re.compile(r"[a-z][a-zA-Z0-9-]*")
_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ufffe\uffff]")
"""What HTML does not allow, and what turns the direction of the text around it."""


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


Child = str | None
"""Markup as it is, other text escaped, None left out."""


def escaped(text: str) -> Markup:
    """Text as HTML; control characters, which may come from a log, are shown as such."""
    if isinstance(text, Markup):
        return text
    # Lone surrogates stand for bytes of a file's name that are no text.
    text = text.encode("utf-8", "replace").decode("utf-8")
    return Markup(html.escape(_CONTROL.sub("\N{REPLACEMENT CHARACTER}", text), quote=True))


def element(
    name: str, /, *children: Child, **attributes: str | int | float | bool | None
) -> Markup:
    """An element; `class_` is class and `aria_label` is aria-label.

    Attributes that are None or False are left out, True ones have no value.

    Raises:
        ValueError: an attribute's name is none.
    """
    words = [name]
    for key, value in attributes.items():
        attribute = key.rstrip("_").replace("_", "-")
        if not _ATTRIBUTE.fullmatch(attribute):
            raise ValueError(f"no attribute's name: {key!r}")
        if value is None or value is False:
            continue
        words.append(attribute if value is True else f'{attribute}="{escaped(str(value))}"')
    head = f"<{' '.join(words)}>"
    if name in _VOID:
        return Markup(head)
    return Markup(f"{head}{joined(*children)}</{name}>")


def joined(*children: Child) -> Markup:
    """Children one after the other."""
    return Markup("".join(escaped(child) for child in children if child is not None))


def html_page(title: str, style: str, *body: Child, script: str = "") -> str:
    """A page that loads nothing, and obeys nothing but its own style and script.

    The body is header, main part, footer and data of the script, which runs at the end.
    """
    style_hash, script_hash = (
        "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        for text in (style, script)
    )
    scripts = f"script-src '{script_hash}'; " if script else ""
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element(
            "meta",
            http_equiv="Content-Security-Policy",
            content=f"default-src 'none'; style-src '{style_hash}'; {scripts}base-uri 'none'; "
            "form-action 'none'",
        ),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("meta", name="referrer", content="no-referrer"),
        element("title", f"{title} (gcs-sysid)"),
        element("style", Markup(style)),
    )
    end = element("script", Markup(script)) if script else None
    return f"<!DOCTYPE html>\n{element('html', head, element('body', *body, end), lang='en')}\n"


def asset(name: str, room: str = "report") -> str:
    """A file of a room's pages, with the line ends of every system."""
    file = resources.files("gcs_sysid") / room / "assets" / name
    return file.read_text(encoding="utf-8").replace("\r\n", "\n")


class NumbersTitle(str):
    """The title of a column of numbers."""

    __slots__ = ()


def numbers(*titles: str) -> list[NumbersTitle]:
    """Titles of columns of numbers, for `table`."""
    return [*map(NumbersTitle, titles)]


def section(name: str, title: str, *children: Child) -> Markup:
    """A section of the page with its heading."""
    heading = element("h2", title, id=f"{name}-title")
    return element("section", heading, *children, id=name, aria_labelledby=f"{name}-title")


def table(
    caption: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[Child]],
    *,
    layout: Literal["stacked", "axes", "plain"] = "stacked",
) -> Markup:
    """A table whose first column names the rows.

    Roles are explicit, because a table with another layout loses them. What becomes of it where the
    page is narrow: "stacked" rows become cards, each cell with its column's title; "axes" fits as
    it is, with words wrapped.
    """
    head = element(
        "tr",
        *(
            element(
                "th",
                column,
                scope="col",
                role="columnheader",
                class_="number" if isinstance(column, NumbersTitle) else None,
            )
            for column in columns
        ),
        role="row",
    )
    body = [
        element(
            "tr",
            *(
                element(
                    "td" if place else "th",
                    cell,
                    scope=None if place else "row",
                    role="cell" if place else "rowheader",
                    class_="number" if isinstance(column, NumbersTitle) else None,
                    data_title=column,
                )
                for place, (column, cell) in enumerate(zip(columns, row, strict=True))
            ),
            role="row",
        )
        for row in rows
    ]
    return element(
        "div",
        element(
            "table",
            element("caption", caption),
            element("thead", head, role="rowgroup"),
            element("tbody", *body, role="rowgroup"),
            role="table",
            class_=layout,
        ),
        class_="scroll",
    )


def facts(entries: Mapping[str, Child]) -> Markup:
    """Names and what they are."""
    return element(
        "dl",
        *(
            element("div", element("dt", name), element("dd", value))
            for name, value in entries.items()
        ),
        class_="facts",
    )


def figure(name: str, title: str, text: str = "", *, size: str = "wide") -> Markup:
    """A place that the page's script draws a figure in.

    The text says more, under the title; the size is "wide", "medium", "low", "small" or "strip".
    """
    caption = element(
        "figcaption",
        element("span", title, class_="title"),
        element("span", text, class_="more") if text else None,
        element("output", class_="readout"),
        element("button", "Reset zoom", type="button", class_="reset", hidden=True),
    )
    return element(
        "figure",
        caption,
        element(
            "div",
            class_=f"plot {size}",
            data_figure=name,
            tabindex=0,
            role="group",
            aria_roledescription="zoomable figure",
            aria_label=title,
            aria_describedby="keys",
        ),
        class_="drawn",
    )


def legend(*entries: tuple[str, str]) -> Markup:
    """What the lines mean: (class, words) each."""
    return element(
        "ul",
        *(
            element("li", element("span", class_=f"key {kind}", aria_hidden="true"), words)
            for kind, words in entries
        ),
        class_="legend",
    )


def note(*children: Child) -> Markup:
    """A paragraph that explains."""
    return element("p", *children, class_="note")


def grid(kind: str, children: Iterable[Child]) -> Markup:
    """Figures beside each other, where there is room."""
    return element("div", joined(*children), class_=f"grid {kind}")
