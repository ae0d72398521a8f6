"""HTML that is escaped by construction: text is text unless it was made here."""

import html
import re

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
